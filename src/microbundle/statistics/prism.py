"""Tables in the shapes of GraphPad Prism: Column, Nested, paired Column and XY, a CSV file for each metric and shape.

Datasets stand side by side and are filled up with empty cells; a title stands above the first of its subcolumns.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

from .dose import curve_name, dose_wells
from .groups import group_wells
from .paired import pairs
from .wells import Run, Well, file_name

Cells = list[list[str]]


def write_prism(run: Run, folder: Path) -> list[Path]:
    """Write the tables of every metric into a folder, and return their files. Raises OSError."""
    files = []
    for metric in run.metrics:
        for name, rows in tables(run, metric):
            folder.mkdir(exist_ok=True)
            file = folder / f"{metric}_{name}.csv"
            with file.open("w", encoding="utf-8", newline="") as stream:
                csv.writer(stream, lineterminator="\n").writerows(rows)
            files.append(file)
    return files


def tables(run: Run, metric: str) -> Iterator[tuple[str, Cells]]:
    """Make the tables of a metric that its wells allow, with their names."""
    for phase in run.columns.phases if run.columns.by else ():
        wells = [well for well in group_wells(run, phase) if metric in well.values]
        groups = {group: [well for well in wells if well.group == group] for group in run.groups}
        if wells:
            after = f"_{file_name(phase)}" if phase else ""
            yield f"column{after}", _columns({name: [_text(w.values[metric]) for w in mine]
                                              for name, mine in groups.items()})
            yield f"nested{after}", _nested(metric, groups)
    if run.columns.pair:
        rows = list(_paired(run, metric))
        if len(rows) > 1:
            yield "paired", rows
    if run.columns.dose:
        rows = _xy(run, metric)
        if len(rows) > 1:
            yield "xy", rows


def _columns(named: Mapping[str, Sequence[str]]) -> Cells:
    return [list(named), *([*row] for row in zip_longest(*named.values(), fillvalue=""))]


def _nested(metric: str, groups: Mapping[str, Sequence[Well]]) -> Cells:
    """Groups side by side, each with as many subcolumns, of which each is a plate; two rows of titles."""
    plates = {group: dict.fromkeys((well.day, well.plate) for well in wells) for group, wells in groups.items()}
    wide = max(len(mine) for mine in plates.values())
    titles, names, columns = [], [], []
    for group, mine in plates.items():
        titles += [group, *[""] * (wide - 1)]
        names += [" ".join(name for name in plate if name) for plate in mine] + [""] * (wide - len(mine))
        columns += [[_text(w.values[metric]) for w in groups[group] if (w.day, w.plate) == plate] for plate in mine]
        columns += [[]] * (wide - len(mine))
    return [titles, names, *([*row] for row in zip_longest(*columns, fillvalue=""))]


def _paired(run: Run, metric: str) -> Iterator[list[str]]:
    """A row for each well: its name, then before and after in the columns of its group."""
    groups = run.groups or ("",)
    yield ["well", *(f"{group} {phase}".strip() for group in groups for phase in run.columns.phases)]
    for before, after in pairs(run):
        if metric in before.values and metric in after.values:
            row = [""] * (2 * len(groups))
            at = 2 * groups.index(before.group)
            row[at:at + 2] = _text(before.values[metric]), _text(after.values[metric])
            yield [" ".join(name for name in (before.day, before.plate, before.well) if name), *row]


def _xy(run: Run, metric: str) -> Cells:
    """A row for each dose: the dose, then the wells of each curve, as many subcolumns to each."""
    at: dict[str, dict[float, list[str]]] = {}
    for names, wells in dose_wells(run).items():
        found = at.setdefault(curve_name(*names), {})
        for well in wells:
            if metric in well.values:
                found.setdefault(well.dose, []).append(_text(well.values[metric]))
    doses = sorted({dose for found in at.values() for dose in found})
    wide = max((len(values) for found in at.values() for values in found.values()), default=1)
    titles = [run.columns.dose]
    for name in at:
        titles += [name or metric, *[""] * (wide - 1)]
    rows = [[_text(dose)] for dose in doses]
    for found in at.values():
        for row, dose in zip(rows, doses, strict=True):
            values = found.get(dose, [])
            row += values + [""] * (wide - len(values))
    return [titles, *rows]


def _text(value: float) -> str:
    return f"{value:.7g}"
