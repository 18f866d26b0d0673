"""Turn a run over many movies into conclusions: groups, pairs and doses, whichever its columns tell.

    comparison = microbundle.compare("plate_1_results")
    comparison.tables["comparison"]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from .dose import Response, fit_responses, response_table
from .groups import compare_groups
from .paired import compare_pairs, unpaired
from .wells import Run, natural_control, read_run

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Comparison:
    """What a run tells: tables by name, and what was used for them and left out."""

    run: Run
    control: str
    """The group that others are compared with; empty where there are no groups."""
    tables: Mapping[str, pd.DataFrame]
    """`wells` and `left_out`, and of `comparison`, `paired`, `dose_response` those that the run's columns allow."""
    responses: tuple[Response, ...]
    """The fitted curves, with what they were fitted to."""
    notes: tuple[str, ...]


def compare(run: Path | str, *, metrics: Sequence[str] | None = None, by: str | None = None,
            control: str | None = None, pair: str | None = None, before: str | None = None, after: str | None = None,
            only_pass: bool = False) -> Comparison:
    """Compare the wells of a run of `microbundle batch`: between groups, before and after, and over doses.

    `run` is its folder; nothing in it is changed. `metrics` are names as in `plate.csv`, by default the key metrics of
    `movies.csv`. `by` is the column of groups (default `group`), `control` the group that the others are compared with
    (default one called control, vehicle or the like, else the first). `pair` is a column of which `before` and `after`
    are two values (default `phase`, where it has before and after, or baseline and drug). Doses are in a column whose
    name starts with `dose`, compounds in `compound`. `only_pass` leaves out movies with the verdict review.

    Raises ResultUnreadable where the folder is no run, ConfigError for a column, value or metric that it has not, and
    where it has no column to compare by. docs/statistics.md says how numbers are come by.
    """
    read = read_run(run, metrics=metrics, by=by, pair=pair, before=before, after=after, only_pass=only_pass)
    notes, left_out = list(read.notes), list(read.left_out)
    chosen = _control(read, control, notes)
    made: dict[str, pd.DataFrame] = {}
    if chosen:
        made["comparison"] = compare_groups(read, chosen)
    if read.columns.pair:
        made["paired"] = compare_pairs(read, chosen)
        left_out += unpaired(read)
    responses: tuple[Response, ...] = ()
    if read.columns.dose:
        responses = fit_responses(read)
        made["dose_response"] = response_table(read, responses)
    if left_out:
        notes.append(f"{len(read.left_out)} movies and {len(left_out) - len(read.left_out)} unpaired wells are left "
                     "out; left_out.csv lists them" if read.columns.pair else
                     f"{len(left_out)} movies are left out; left_out.csv lists them")
    made |= {"wells": _wells_table(read), "left_out": _left_out_table(left_out)}
    return Comparison(read, chosen, made, responses, tuple(notes))


def _control(run: Run, asked: str | None, notes: list[str]) -> str:
    """Choose the control, and say which; empty where there are no groups to compare. Raises ConfigError."""
    groups, by = run.groups, run.columns.by
    if not by or not groups:
        if asked is not None:
            raise ConfigError(f"--control {asked}: expected groups; there is no column group, or it is empty. Name "
                              "another with --by")
        return ""
    if asked is not None and asked not in groups:
        raise ConfigError(f"--control {asked}: column {by} has no such value; it has {', '.join(groups)}")
    control = asked or natural_control(groups)
    if len(groups) == 1:
        if not (run.columns.pair or run.columns.dose):
            raise ConfigError(f"column {by}: expected two groups or more to compare; found {control} alone. Name "
                              "another column with --by")
        notes.append(f"column {by} has one value, {control}: there are no groups to compare")
        return ""
    if asked is None:
        notes.append(f"groups are compared with {control}; choose another with --control")
    several = {group: {well.dose for well in run.wells if well.group == group and np.isfinite(well.dose)}
               for group in groups}
    mixed = [group for group in groups if len(several[group]) > 1]
    if mixed:
        notes.append(f"group {mixed[0]} holds {len(several[mixed[0]])} doses, which its numbers in comparison.csv are "
                     f"taken over; --by {run.columns.dose} compares doses")
    return control


def _wells_table(run: Run) -> pd.DataFrame:
    """The data behind: a row for each well and metric, with the columns that the run has."""
    import pandas as pd

    columns = run.columns
    there = {"day": run.has_days, "plate": run.has_plates, "well": True, "group": bool(columns.by),
             "phase": bool(columns.pair), "compound": bool(columns.compound), "dose": bool(columns.dose)}
    shown = [name for name, known in there.items() if known]
    rows = [(*(getattr(well, name) for name in shown), well.movies, metric, well.values[metric])
            for metric in run.metrics for well in run.wells if metric in well.values]
    return pd.DataFrame(rows, columns=[*shown, "movies", "metric", "value"])


def _left_out_table(left_out: Sequence[tuple[str, str]]) -> pd.DataFrame:
    import pandas as pd

    return pd.DataFrame(left_out, columns=["movie_or_well", "reason"])
