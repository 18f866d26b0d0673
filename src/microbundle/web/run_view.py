"""How a run is told: its record, how far it is, and a row for each movie with its state and its numbers.

Small files (status, table of metrics, decisions) are read again only where they changed, so that a page of hundreds of
movies costs some milliseconds each time.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

from ..batch.collect import KEY_METRICS, UNITS, read_summary
from ..batch.plan import Task
from ..batch.state import RESULTS, STATUS, TABLE, Status, read_status
from ..config import Config
from ..decisions import decisions_hash, read_decisions, sidecar_of
from ..errors import ConfigError, MicrobundleError
from ..lookup import entries
from ..report import NAME
from ..report.terms import Term, best_unit, pretty
from .answers import Refused, not_there
from .progress import Progress
from .records import Home, Record
from .runs import Runs

SHOWN = frozenset(metric + unit for metric in KEY_METRICS for unit in UNITS)
FIRST = ("beat_rate_bpm", "amplitude_um", "amplitude_px", "shortening_amplitude", "e_cc_peak", "cd50_s", "cd50_frames",
         "twitch_force_un", "synchrony_sd_s")
"""Metrics that come first, and the others after them."""


@dataclass(frozen=True)
class Numbers:
    """Means and standard errors of a movie's metrics, by column."""

    mean: dict[str, float]
    error: dict[str, float]


class Views:
    """Makes the views of runs, and remembers the small files they are made of."""

    def __init__(self, runs: Runs) -> None:
        self.runs = runs
        self._lock = threading.Lock()
        self._kept: dict[str, tuple[tuple[int, int], Any]] = {}

    def listed(self) -> list[dict[str, Any]]:
        """All runs in short."""
        return [self.short(record) for record in self.runs.all()]

    def short(self, record: Record) -> dict[str, Any]:
        """A run in short: its state, and how far it is."""
        known = {"id": record.id, "title": record.title, "state": record.state, "created": record.created,
                 "message": record.message}
        if record.state == "preparing":
            return known | {"movies": record.wells, "done": 0, "failed": 0, "seconds_left": None,
                            "share": self.runs.preparing.get(record.id, 0.0)}
        progress = self.runs.progress(record.id)
        states = [one.state for one in progress.movies.values()]
        return known | {"movies": record.count, "done": progress.unchanged + states.count("done"),
                        "failed": states.count("failed"),
                        "share": 1.0 if record.state == "done" else round(progress.share, 4),
                        "seconds_left": progress.seconds_left(datetime.now(UTC)) if record.state == "running" else None}

    def run(self, id: str) -> dict[str, Any]:
        """A run with all of its movies."""
        record, home = self.runs.get(id), self.runs.home(id)
        message, notes, columns = record.message, list[str](), list[str]()
        tasks: Iterable[Task] = ()
        if record.state != "preparing":
            try:
                plan = self.runs.plan(id)
                tasks, columns, notes = plan.tasks, list(plan.columns), list(plan.notes)
                notes += [f"no pictures: {why}" for why in self.runs.progress(id).problems.values()]
            except (MicrobundleError, Refused) as error:
                tasks, message = self._kept_tasks(home), message or str(error)
        progress = self.runs.progress(id)
        rows = [self.movie(record, home, task, progress) for task in tasks]
        short = self.short(record)
        done = sum(row["state"] == "done" for row in rows)
        failed = sum(row["state"] == "failed" for row in rows)
        share = short["share"] if record.state in ("running", "preparing") else (done + failed) / max(1, len(rows))
        terms = shown_terms(name for row in rows for name in row["metrics"])
        return {
            "id": id, "title": record.title, "source": record.source, "at": self.runs.places.at(Path(record.source)),
            "state": record.state, "message": message, "created": record.created, "started": record.started,
            "ended": record.ended, "command": self.runs.shown_command(id), "settings": dict(record.settings),
            "pattern": record.pattern, "figures": record.figures, "movie_files": record.movies, "excel": record.excel,
            "columns": columns, "notes": notes, "cancelled": record.cancelled, "elsewhere": record.out is not None,
            "progress": {"stage": progress.stage if record.state == "running" else "", "done": done,
                         "failed": failed, "total": len(rows) or short["movies"],
                         "share": round(share, 4), "seconds_left": short["seconds_left"]},
            "metrics": [{"column": term.column, "label": term.name, "unit": term.unit, "tip": term.tip}
                        for term in terms],
            "movies": rows,
        }

    def movie(self, record: Record, home: Home, task: Task, progress: Progress) -> dict[str, Any]:
        """One movie of a run: its state, numbers and decisions."""
        result = home.out / RESULTS / task.key
        status: Status | None = self._file(home.out / STATUS / f"{task.key}.json",
                                           lambda: read_status(home.out, task))
        doing = progress.movies.get(task.movie) if record.state == "running" else None
        numbers: Numbers | None = self._file(result / TABLE, lambda: _numbers(result / TABLE))
        listed, replayed = self._file(sidecar_of(result), lambda: _decisions(result)) or ([], "")
        state, stale = "todo", False
        if status is not None and status.movie == task.movie:
            state = status.state
            stale = bool(task.settings) and (status.settings != task.settings or status.decisions != replayed)
        out = {
            "key": task.key, "movie": task.movie, "columns": dict(task.columns), "state": state, "stale": stale,
            "stage": "", "share": 1.0 if state in ("done", "failed") else 0.0,
            "verdict": status.verdict if status else "", "beats": status.beats if status else None,
            "kind": status.kind if status else "", "message": status.message if status else "",
            "metrics": numbers.mean if numbers else {}, "se": numbers.error if numbers else {},
            "accepted": accepted(listed), "decisions": len(listed), "report": (result / NAME).is_file(),
        }
        drawing = progress.drawing.get(task.movie) if record.state == "running" else None
        if drawing is not None:
            out |= {"state": "running", "stage": "drawing pictures", "share": drawing}
        elif doing is not None and doing.state == "running":
            out |= {"state": "running", "stage": doing.stage, "share": doing.share}
        elif state in ("done", "failed") and stale and doing is None and not numbers:
            out |= {"state": "todo", "share": 0.0}
        return out

    def task(self, id: str, key: str) -> Task:
        """Find a movie of a run, or of what it has measured where its source is gone. Raises Refused."""
        try:
            tasks = self.runs.plan(id).tasks
        except (MicrobundleError, Refused):
            tasks = tuple(self._kept_tasks(self.runs.home(id)))
        found = next((task for task in tasks if task.key == key), None)
        if found is None:
            raise not_there(f"{key[:100]}: there is no such movie in this run")
        return found

    def _kept_tasks(self, home: Home) -> list[Task]:
        """The movies that a run has measured, where its source is gone or may not be looked into."""
        out = []
        for file in sorted((home.out / STATUS).glob("*.json")):
            status: Status | None = self._file(file, lambda file=file: read_status(  # type: ignore[misc]
                home.out, Task("", Path(), file.stem, {}, Config(), "")))
            if status is not None:
                out.append(Task(status.movie, Path(status.movie), file.stem, {}, Config(), ""))
        return out

    def _file(self, file: Path, read: Callable[[], Any]) -> Any:
        """Read a small file, or give what was read where it has not changed; None where there is none."""
        try:
            about = os.stat(file)
        except OSError:
            return None
        seen = about.st_mtime_ns, about.st_size
        with self._lock:
            kept = self._kept.get(str(file))
        if kept is not None and kept[0] == seen:
            return kept[1]
        value = read()
        with self._lock:
            if len(self._kept) > 100_000:
                self._kept.clear()
            self._kept[str(file)] = seen, value
        return value


def accepted(listed: list[dict[str, Any]]) -> bool | None:
    """What a person last said of a movie: accepted, or not; None where nothing was said."""
    said = [one.get("accept") for one in listed if one.get("kind") == "verdict"]
    return bool(said[-1]) if said else None


def shown_terms(names: Iterable[str]) -> list[Term]:
    """The terms of columns, the most asked for first; of a length in px and um, that in um."""
    found = {name: term for name in dict.fromkeys(names) if (term := term_of(name)) is not None}
    terms = best_unit(found, list(found))
    return sorted(terms, key=lambda term: FIRST.index(term.column) if term.column in FIRST else len(FIRST))


@lru_cache(maxsize=2000)
def term_of(column: str) -> Term | None:
    """Find the term of a column of the summary; None for one that the dictionary does not know."""
    try:
        metric = entries(column)[0]
    except ConfigError:
        return None
    return Term(column, metric, pretty(column.removeprefix(metric.key).removeprefix("_")), None)


def _numbers(table: Path) -> Numbers:
    """Read the key metrics of a result; nothing from a table that is damaged."""
    mean, error = {}, {}
    try:
        for name, _, value, se, *_ in read_summary(table):
            if name in SHOWN and value:
                mean[name] = float(value)
                if se:
                    error[name] = float(se)
    except (MicrobundleError, OSError, ValueError):
        return Numbers({}, {})
    return Numbers(mean, error)


def _decisions(result: Path) -> tuple[list[dict[str, Any]], str]:
    """The decisions on a result, and the hash by which a run knows whether it has replayed them."""
    try:
        return read_decisions(result).as_list(), decisions_hash(result)
    except ConfigError:
        return [], decisions_hash(result)
