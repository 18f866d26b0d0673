"""Compare each well with itself, before and after: the table `paired`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .estimates import Estimate, difference, exponential, holm, mean_of
from .groups import interval
from .wells import Run, Well, counts, merged, places

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("metric", "group", "control", "n_wells", "n_plates", "n_days", "before", "after", "change", "change_low_95",
           "change_high_95", "ratio", "ratio_low_95", "ratio_high_95", "p", "p_holm", "df", "unit", "reason",
           "difference", "difference_low_95", "difference_high_95", "difference_p", "difference_p_holm",
           "difference_df", "difference_unit", "difference_reason")


def pairs(run: Run) -> list[tuple[Well, Well]]:
    """Wells that were measured before and after; at several doses, the mean over them."""
    before, after = (_by_place(run, phase) for phase in run.columns.phases)
    return [(before[place], after[place]) for place in before if place in after]


def unpaired(run: Run) -> list[tuple[str, str]]:
    """Wells that were measured in one phase only, and which."""
    before, after = (_by_place(run, phase) for phase in run.columns.phases)
    first, second = run.columns.phases
    return [(" ".join(name for name in place if name), f"only {here} in column {run.columns.pair}")
            for here, these, others in ((first, before, after), (second, after, before))
            for place in these if place not in others]


def compare_pairs(run: Run, control: str) -> pd.DataFrame:
    """Measure the change of each group's wells, and its difference from the control's; `COLUMNS` says what there is.

    The change is the mean over plates of the wells' after less before, and its interval that of the plates' spread (of
    the wells' on one plate); the ratio is the same analysis of the logarithms of after over before. The difference
    compares the wells' changes as `compare_groups` does their numbers. `control` is empty where there are no groups.
    """
    import pandas as pd

    there = pairs(run)
    rows = [row for metric in run.metrics for row in _rows(run, there, metric, control)]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _by_place(run: Run, phase: str) -> dict[tuple[str, ...], Well]:
    chosen = [well for well in run.wells if well.phase == phase and (well.group or not run.columns.by)]
    return {_place(well): well for well in merged(chosen, _place)}


def _place(well: Well) -> tuple[str, ...]:
    return well.day, well.plate, well.well, well.group


def _rows(run: Run, there: Sequence[tuple[Well, Well]], metric: str, control: str) -> Iterator[dict[str, Any]]:
    known = [(a, b) for a, b in there if metric in a.values and metric in b.values]
    groups = run.groups or ("",)
    first, second = (np.array([pair[i].values[metric] for pair in known], float) for i in (0, 1))
    where = places([a for a, _ in known], run, groups)
    mine = [where.group == g for g in range(len(groups))]
    changes = [mean_of((second - first)[here], where[here]) for here in mine]
    number = groups.index(control) if control else -1
    against = [difference(second - first, where, g, number) if control and group != control else Estimate()
               for g, group in enumerate(groups)]
    adjusted = holm(np.array([one.p for one in changes]))
    adjusted_against = holm(np.array([one.p for one in against]))
    for g, group in enumerate(groups):
        a, b, change, other = first[mine[g]], second[mine[g]], changes[g], against[g]
        if (a * b > 0).all():
            ratio = exponential(mean_of(np.log(b / a), where[mine[g]]))
        else:
            ratio = Estimate(reason="no ratio: numbers of both signs, or 0")
        yield {"metric": metric, "group": group, "control": control,
               **counts([well for (well, _), here in zip(known, mine[g], strict=True) if here]),
               "before": a.mean() if len(a) else np.nan, "after": b.mean() if len(b) else np.nan,
               **interval("change", change), **interval("ratio", ratio), "p": change.p, "p_holm": adjusted[g],
               "df": change.df, "unit": change.unit, "reason": change.reason or ratio.reason,
               **interval("difference", other), "difference_p": other.p, "difference_p_holm": adjusted_against[g],
               "difference_df": other.df, "difference_unit": other.unit, "difference_reason": other.reason}
