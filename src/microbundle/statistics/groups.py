"""Compare groups with the control, metric by metric: the table `comparison`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data import Floats
from .estimates import Estimate, difference, holm, ratio
from .wells import Run, counts, merged, numbers, places

if TYPE_CHECKING:
    import pandas as pd

    from .wells import Well

COLUMNS = ("metric", "phase", "group", "control", "n_wells", "n_plates", "n_days", "mean", "sd", "difference",
           "difference_low_95", "difference_high_95", "ratio", "ratio_low_95", "ratio_high_95", "p", "p_holm", "df",
           "unit", "reason")


def group_wells(run: Run, phase: str) -> list[Well]:
    """Wells of a phase that belong to a group; at several doses, the mean over them."""
    chosen = [well for well in run.wells if well.group and well.phase == phase]
    return merged(chosen, lambda well: (well.day, well.plate, well.well, well.group))


def compare_groups(run: Run, control: str) -> pd.DataFrame:
    """Compare each group with the control, in each phase by itself; `COLUMNS` says what there is of each.

    Means and SD are those of the wells; the difference is that of the design (see `estimates`), and the ratio the same
    analysis of the wells' logarithms. p is adjusted over the groups of a metric and phase, and not over metrics.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for metric in run.metrics:
        for phase in run.columns.phases:
            rows += _rows(run, metric, phase, control)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(run: Run, metric: str, phase: str, control: str) -> Iterator[dict[str, Any]]:
    wells, value = numbers(group_wells(run, phase), metric)
    where, number = places(wells, run, run.groups), run.groups.index(control)
    found = [Estimate() if group == control else difference(value, where, g, number)
             for g, group in enumerate(run.groups)]
    adjusted = holm(np.array([one.p for one in found]))
    for g, group in enumerate(run.groups):
        mine = where.group == g
        row = {"metric": metric, "phase": phase, "group": group, "control": control,
               **counts([well for well, here in zip(wells, mine, strict=True) if here]), **moments(value[mine])}
        if group == control:
            row |= {"unit": "", "reason": ""}
        else:
            by_logs = ratio(value, where, g, number)
            row |= {**interval("difference", found[g]), **interval("ratio", by_logs), "p": found[g].p,
                    "p_holm": adjusted[g], "df": found[g].df, "unit": found[g].unit,
                    "reason": found[g].reason or by_logs.reason}
        yield row


def moments(value: Floats) -> dict[str, float]:
    """Mean and standard deviation over wells."""
    return {"mean": float(value.mean()) if len(value) else np.nan,
            "sd": float(value.std(ddof=1)) if len(value) > 1 else np.nan}


def interval(name: str, found: Estimate) -> dict[str, float]:
    """Columns of a value and its interval."""
    return {name: found.value, f"{name}_low_95": found.low, f"{name}_high_95": found.high}
