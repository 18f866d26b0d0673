"""The command `compare`: it reads a run, compares, writes and prints; `cli` registers it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from ..commands import Switch
from ..console import number, print_json, print_rows

if TYPE_CHECKING:
    import pandas as pd

    from .compare import Comparison


def compare(run: Path, *, out: Path | None = None, metric: Annotated[list[str] | None, Parameter()] = None,
            by: str | None = None, control: str | None = None, pair: str | None = None, before: str | None = None,
            after: str | None = None, only_pass: Switch = False, figures: bool = True, overwrite: Switch = False,
            quiet: Switch = False, json: Switch = False) -> int:
    """Compare the wells of a run: between groups, before and after, and over doses.

    Parameters
    ----------
    run
        Folder that `microbundle batch` wrote.
    out
        New folder for the tables and figures; by default RUN_comparison in the current folder.
    metric
        A metric of plate.csv, such as amplitude_um; may be given more than once. By default the key metrics.
    by
        Column of the groups; by default group.
    control
        Group that the others are compared with; by default one called control, vehicle or the like, else the first.
    pair
        Column that tells before from after; by default phase, where it has before and after, or baseline and drug.
    before
        Its value before.
    after
        Its value after.
    only_pass
        Leave out movies with the verdict review, too.
    figures
        Write the folder figures/, as PNG and PDF.
    overwrite
        Replace an older comparison in that folder.
    quiet
        Print nothing but errors.
    json
        Print one JSON object instead of the tables, for scripts.
    """
    from ..folder import check_free
    from .compare import compare as find
    from .write import KIND, write_comparison

    folder = out or Path(f"{run.resolve().name}_comparison")
    check_free(folder, KIND, overwrite)
    found = find(run, metrics=metric, by=by, control=control, pair=pair, before=before, after=after,
                 only_pass=only_pass)
    folder = write_comparison(found, folder, figures=figures, overwrite=overwrite)
    if json:
        print_json({"out": str(folder), "control": found.control, "metrics": list(found.run.metrics),
                    "notes": list(found.notes), **{name: _records(table) for name, table in found.tables.items()
                                                   if name != "wells"}})
    elif not quiet:
        _print_tables(found)
        print(f"results: {folder}")
    return 0


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]


def _print_tables(found: Comparison) -> None:
    tables = found.tables
    why: Counter[str] = Counter()
    if "comparison" in tables:
        rows = [(_named(row, "metric", "phase"), row["group"], _count(row), number(row["mean"]),
                 _with_interval(row, "difference"), number(row["p_holm"])) for row in _records(tables["comparison"])]
        print_rows(f"Groups, compared with {found.control}", ("metric", "group", "wells", "mean",
                                                              "difference (95 % interval)", "p (Holm)"), rows)
        why.update(tables["comparison"]["reason"])
    if "paired" in tables:
        first, second = found.run.columns.phases
        rows = [(row["metric"], row["group"], _count(row), number(row["before"]), _with_interval(row, "change"),
                 number(row["p_holm"])) for row in _records(tables["paired"])]
        print_rows(f"{second} less {first}", ("metric", "group", "wells", first, "change (95 % interval)", "p (Holm)"),
                   rows)
        why.update(tables["paired"]["reason"])
        why.update(tables["paired"]["difference_reason"])
    if "dose_response" in tables:
        rows = [(row["metric"], _named(row, "group", "compound"), _count(row), _with_interval(row, "ec50"),
                 number(row["hill"]), number(row["p_flat"])) for row in _records(tables["dose_response"])]
        print_rows(f"Dose-response, {found.run.columns.dose}", ("metric", "compound", "wells", "EC50 (95 % interval)",
                                                                "Hill slope", "p (flat)"), rows)
        why.update(tables["dose_response"]["reason"])
    for reason, times in why.items():
        if reason:
            print(f"info: not estimable: {reason}{f' ({times} times)' if times > 1 else ''}")
    for note in found.notes:
        print(f"info: {note}")


def _named(row: dict[str, Any], *columns: str) -> str:
    return ", ".join(row[name] for name in columns if row[name])


def _count(row: dict[str, Any]) -> str:
    plates = row["n_plates"]
    return str(row["n_wells"]) if plates < 2 else f"{row['n_wells']} on {plates} plates"


def _with_interval(row: dict[str, Any], name: str) -> str:
    """A value and its interval in words; where there is none, that it cannot be told (the table says why)."""
    if row[name] == row[name]:
        return f"{number(row[name])} ({number(row[f'{name}_low_95'])} to {number(row[f'{name}_high_95'])})"
    return "not estimable" if row["reason"] else ""
