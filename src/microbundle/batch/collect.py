"""What is made of all movies: the tables `plate.csv` and `movies.csv`, in Parquet too where pyarrow is installed, plate
maps, the comparison of groups, pairs and doses, the index page, and a workbook.

Rows stand in the order of the plan, and numbers as they stand in each result's `summary.csv`, so that two runs over the
same movies give the same bytes.
"""

from __future__ import annotations

import csv
import hashlib
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from operator import itemgetter
from pathlib import Path
from typing import Any, cast

from ..errors import ConfigError, ResultUnreadable
from ..folder import remove_whole
from ..plate_maps import write_maps
from ..plate_workbook import TIDY, write_plate_workbook
from ..plates import Plate, State, WellMovie, plates_of
from ..report import NAME
from ..statistics.wells import comparable
from ..workbook import check_writer, settings
from .manifest import PLACES, SETTINGS
from .plan import Plan
from .state import RESULTS, TABLE, Status, whole

STATISTICS = ("n", "mean", "se", "sd", "low_95", "high_95")
KEY_METRICS = ("tissue_width", "tissue_length", "beat_rate_bpm", "beat_period", "amplitude", "shortening_amplitude",
               "e_cc_peak", "e_cc_min", "cd50", "cd90", "relax50", "contraction_velocity", "relaxation_velocity",
               "twitch_force", "stress_rectangle", "stress_ellipse", "synchrony_sd")
"""Metrics of `movies.csv`, in all the units in which any movie has them."""
UNITS = ("", "_um", "_px", "_s", "_frames", "_un", "_kpa", "_um_per_s", "_px_per_s", "_um_per_frame", "_px_per_frame")
DRAWN = ("amplitude", "beat_rate_bpm", "shortening_amplitude", "e_cc_peak", "cd50", "contraction_velocity",
         "twitch_force", "synchrony_sd")
"""Metrics of which plate maps are drawn; the index and the workbook show all of `KEY_METRICS`."""
PLATE, MOVIES, INDEX, COMPARISON = "plate.csv", "movies.csv", "index.html", "comparison"
MADE_OF = ".tables"
"""Hash of the tables that the index and the comparison were made of; a run that was killed before it wrote them leaves
that of older ones."""
MEAN, ERROR = 1 + STATISTICS.index("mean"), 1 + STATISTICS.index("se")


@dataclass(frozen=True)
class Extras:
    """What is made of a run beside its tables."""

    excel: bool = False
    """Also write a workbook."""
    wells: int | None = None
    """Size of the plates; None for the smallest usual ones that have all wells of the plan."""

    def check(self, plan: Plan) -> None:
        """Check before a run that all can be made. Raises ConfigError."""
        if self.excel:
            check_writer()
        if self.wells is not None:
            plates_of((WellMovie(task.movie, task.columns, "failed", {}) for task in plan.tasks), self.wells)


def write_tables(out: Path, plan: Plan, statuses: Mapping[str, Status], files: list[Path], notes: list[str], *,
                 changed: bool, extras: Extras | None = None) -> None:
    """Write the tables of a run, the maps of its plates, and the index where anything `changed`; adds what was written
    to `files`, and what was left out to `notes`. Raises OSError, and ResultUnreadable for a result that was tampered
    with."""
    names = [name for metric in KEY_METRICS for name in (metric + unit for unit in UNITS)]
    wanted = set(names)
    extras = extras or Extras()
    means: dict[str, dict[str, str]] = {}
    readings: dict[str, dict[str, tuple[float, float]]] = {}
    with whole(out / PLATE) as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["movie", *plan.columns, "metric", *STATISTICS, "verdict"])
        for task in plan.tasks:
            status = statuses[task.movie]
            if status.state != "done":
                continue
            about = [task.movie, *(task.columns.get(name, "") for name in plan.columns)]
            here, read = means[task.movie], readings[task.movie] = {}, {}
            for row in read_summary(out / RESULTS / task.key / TABLE):
                table.writerow([*about, *row, status.verdict])
                here[row[0]] = row[MEAN]
                if row[0] in wanted and row[MEAN]:
                    read[row[0]] = float(row[MEAN]), float(row[ERROR] or "nan")
    known = {name for found in means.values() for name, mean in found.items() if mean}
    shown = [name for name in names if name in known]
    with whole(out / MOVIES) as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["movie", *plan.columns, "state", "verdict", "failure_kind", "failure", "beats", *shown,
                        "result"])
        for task in plan.tasks:
            status, done = statuses[task.movie], task.movie in means
            table.writerow([task.movie, *(task.columns.get(name, "") for name in plan.columns), status.state,
                            status.verdict, status.kind, " ".join(status.message.split()),
                            status.beats if done else "",
                            *(means[task.movie].get(name, "") if done else "" for name in shown),
                            f"{RESULTS}/{task.key}" if done else ""])
    files += [out / PLATE, out / MOVIES]
    if find_spec("pyarrow") is None:
        notes.append('no Parquet tables: they need pyarrow (pip install "microbundle[parquet]")')
    else:
        numbers = {*STATISTICS, "beats", *shown}
        files += [write_parquet(out / name, numbers) for name in (PLATE, MOVIES)]
    plates = _plates(plan, statuses, readings, extras, notes)
    metrics = _in_one_unit(shown, (*DRAWN, *(name for name in KEY_METRICS if name not in DRAWN)))
    if plates:
        drawn = write_maps(plates, _in_one_unit(shown, DRAWN), out)
        files += [drawn] if drawn else []
    if extras.excel:
        tables = {"movies": out / MOVIES, TIDY: out / PLATE}
        files.append(write_plate_workbook(out, tables, plates, metrics, _about(plan), [*plan.notes, *notes]))
    made_of = hashlib.sha256(b"".join((out / name).read_bytes() for name in (PLATE, MOVIES)))
    made_of.update(f"{plan.version} {extras.wells}".encode())
    changed |= _text(out / MADE_OF) != made_of.hexdigest()
    _comparison(out, files, notes, wanted=comparable(plan.columns) and bool(means), changed=changed)
    if plan.report and means:
        _index(out, plan, statuses, plates, metrics, files, changed=changed)
    if changed:
        with whole(out / MADE_OF) as stream:
            stream.write(made_of.hexdigest())


def read_summary(file: Path) -> Iterator[tuple[str, ...]]:
    """Read the metrics of a result and their `STATISTICS`, as text. Raises ResultUnreadable for another table."""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = csv.reader(stream)
        try:
            header = next(rows, [])
            pick = itemgetter(*(header.index(name) for name in ("metric", *STATISTICS)))
            yield from map(pick, rows)
        except (ValueError, IndexError):
            raise ResultUnreadable(f"{file}: expected the table of a result, with the columns metric, "
                                   f"{', '.join(STATISTICS)}; found another. Delete the folder {file.parent.name}, and "
                                   "run the same line again") from None


def write_parquet(table: Path, numbers: set[str]) -> Path:
    """Write a CSV table as Parquet beside it; columns are text but for `numbers`. Needs pyarrow. Raises OSError."""
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    with table.open(encoding="utf-8", newline="") as stream:
        header = next(csv.reader(stream))
    types = {name: pa.float64() if name in numbers else pa.string() for name in header}
    read = pyarrow.csv.read_csv(table, convert_options=pyarrow.csv.ConvertOptions(
        column_types=types, strings_can_be_null=False), parse_options=pyarrow.csv.ParseOptions(newlines_in_values=True))
    handle, partial = tempfile.mkstemp(prefix=f".{table.stem}.partial-", dir=table.parent)
    os.close(handle)
    try:
        pyarrow.parquet.write_table(read, partial)
        Path(partial).chmod(0o644)
        os.replace(partial, table.with_suffix(".parquet"))
    finally:
        Path(partial).unlink(missing_ok=True)
    return table.with_suffix(".parquet")


def _plates(plan: Plan, statuses: Mapping[str, Status], readings: Mapping[str, Mapping[str, tuple[float, float]]],
            extras: Extras, notes: list[str]) -> list[Plate]:
    """Put the movies into their plates; none where the plan has no wells."""
    if "well" not in plan.columns:
        return []
    movies = []
    for task in plan.tasks:
        status = statuses[task.movie]
        done = task.movie in readings
        state = cast(State, status.verdict if done else "failed")
        movies.append(WellMovie(task.movie, task.columns, state, readings.get(task.movie, {}), status.kind,
                                " ".join(status.message.split()),
                                f"{RESULTS}/{task.key}/{NAME}" if done and plan.report else ""))
    plates, left_out = plates_of(movies, extras.wells)
    if left_out:
        notes.append(f"movies on no plate map, for they name no well such as A1: {left_out}")
    return plates


def _about(plan: Plan) -> Iterator[tuple[str, str, Any, str]]:
    """Everything that says how a run was made: part, name, value, meaning."""
    yield "run", "source", str(plan.source), ""
    yield "run", "movies", len(plan.tasks), ""
    yield "run", "microbundle", plan.version, ""
    each = [list(settings(config)) for config in {task.settings: task.config for task in plan.tasks}.values()]
    for same in zip(*each, strict=True):
        name, value, meaning = same[0]
        alike = all(other[1] == value for other in same)
        yield "setting", name, value if alike else "differs between movies", meaning


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""


def _in_one_unit(shown: Sequence[str], metrics: Sequence[str]) -> list[str]:
    """Columns of metrics that any movie has, each in the first of its units: in um rather than px."""
    found = (next((metric + unit for unit in UNITS if metric + unit in shown), None) for metric in metrics)
    return [name for name in found if name is not None]


def _index(out: Path, plan: Plan, statuses: Mapping[str, Status], plates: Sequence[Plate], metrics: Sequence[str],
           files: list[Path], *, changed: bool) -> None:
    """Write the page over all movies, where it would be another than the one that is there."""
    from ..report import write_index
    from ..report.index import NoResult, Summary
    from .overview import read_overview

    page = out / INDEX
    if changed or not page.exists():
        known = [name for name in plan.columns if name in PLACES or
                 (name not in SETTINGS and len({task.columns.get(name, "") for task in plan.tasks}) > 1)]
        listed: list[Summary | NoResult] = []
        for task in plan.tasks:
            status, columns = statuses[task.movie], {name: task.columns.get(name, "") for name in known}
            listed.append(read_overview(out / RESULTS / task.key, columns) if status.state == "done" else
                          NoResult(task.movie, status.kind, status.message, columns))
        tables = [out / MOVIES, out / PLATE, *sorted((out / COMPARISON).glob("*.csv"))]
        write_index(listed, page, title=plan.source.resolve().stem, plates=plates, metrics=metrics, files=tables,
                    overwrite=True)
    files.append(page)


def _comparison(out: Path, files: list[Path], notes: list[str], *, wanted: bool, changed: bool) -> None:
    """Compare groups, pairs and doses, where the comparison would be another than the one that is there; an older one
    goes where nothing can be compared any more."""
    folder, told = out / COMPARISON, ""
    if not wanted and not folder.exists():
        return
    from ..statistics.write import KIND, write_into

    if wanted and (changed or not folder.exists()):
        try:
            write_into(out, folder, figures=True)
        except ConfigError as why:
            wanted, told = False, str(why)
    if wanted:
        files.append(folder)
    elif folder.exists() and not remove_whole(folder, KIND):
        told = f"{told or 'the run has nothing to compare'}. The folder {COMPARISON} is of an earlier run"
    if told:
        notes.append(f"no comparison: {told}")
