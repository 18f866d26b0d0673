"""The tables over all movies: `plate.csv`, `movies.csv`, Parquet where pyarrow is installed, and the index page.

Rows stand in the order of the plan, and numbers as they stand in each result's `summary.csv`, so that two runs over the
same movies give the same bytes.
"""

from __future__ import annotations

import csv
import os
import tempfile
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from operator import itemgetter
from pathlib import Path

from ..errors import ResultUnreadable
from .plan import Plan
from .state import RESULTS, TABLE, Status, whole

STATISTICS = ("n", "mean", "se", "sd", "low_95", "high_95")
KEY_METRICS = ("tissue_width", "tissue_length", "beat_rate_bpm", "beat_period", "amplitude", "shortening_amplitude",
               "e_cc_peak", "e_cc_min", "cd50", "cd90", "relax50", "contraction_velocity", "relaxation_velocity",
               "twitch_force", "stress_rectangle", "stress_ellipse", "synchrony_sd")
"""Metrics of `movies.csv`, in all the units in which any movie has them."""
UNITS = ("", "_um", "_px", "_s", "_frames", "_un", "_kpa", "_um_per_s", "_px_per_s", "_um_per_frame", "_px_per_frame")
PLATE, MOVIES, INDEX = "plate.csv", "movies.csv", "index.html"
LARGEST_INDEX = 500
"""Movies on an index page; each is a picture of some kilobytes."""
MEAN = 1 + STATISTICS.index("mean")


def write_tables(out: Path, plan: Plan, statuses: Mapping[str, Status], files: list[Path], notes: list[str], *,
                 changed: bool) -> None:
    """Write the tables of a run, and the index where anything `changed`; adds what was written to `files`, and what
    was left out to `notes`. Raises OSError, and ResultUnreadable for a result that was tampered with."""
    names = [name for metric in KEY_METRICS for name in (metric + unit for unit in UNITS)]
    means: dict[str, dict[str, str]] = {}
    with whole(out / PLATE) as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(["movie", *plan.columns, "metric", *STATISTICS, "verdict"])
        for task in plan.tasks:
            status = statuses[task.movie]
            if status.state != "done":
                continue
            about = [task.movie, *(task.columns.get(name, "") for name in plan.columns)]
            here = means[task.movie] = {}
            for row in read_summary(out / RESULTS / task.key / TABLE):
                table.writerow([*about, *row, status.verdict])
                here[row[0]] = row[MEAN]
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
    if plan.report and means:
        _index(out, plan, list(means), files, notes, changed=changed)


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


def _index(out: Path, plan: Plan, movies: list[str], files: list[Path], notes: list[str], *, changed: bool) -> None:
    """Write the page over all results."""
    from ..report import write_index
    from .overview import read_overview

    if len(movies) > LARGEST_INDEX:
        notes.append(f"no index page: it would hold {len(movies)} movies, of at most {LARGEST_INDEX}")
        return
    page = out / INDEX
    if changed or not page.exists():
        keys = {task.movie: task.key for task in plan.tasks}
        shown = [read_overview(out / RESULTS / keys[movie]) for movie in movies]
        write_index(shown, page, title=plan.source.resolve().stem, overwrite=True)
    files.append(page)
