"""What a run has written: the files of a run and of each movie, its report, its traces, its plates."""

from __future__ import annotations

import mimetypes
import re
from collections import OrderedDict
from collections.abc import Iterable
from pathlib import Path
from threading import Lock
from typing import Any

from starlette.responses import FileResponse, HTMLResponse, Response

from ..analysis import Analysis
from ..batch.collect import INDEX, MOVIES, PLATE
from ..batch.plan import Task
from ..batch.state import RESULTS
from ..data import Finding
from ..errors import OutputError, ResultUnreadable
from ..folder import LIST
from ..metrics import tables
from ..plates import WellMovie, plates_of
from ..report import NAME
from ..report.page import data_of
from ..report.traces import page_data
from ..store import RESULT, glance, load
from ..wells import well_name
from .answers import Refused, not_there
from .records import Home

POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)"')
SANDBOX = "sandbox allow-scripts; frame-ancestors 'self'"
SHOWN_INLINE = (".png", ".jpg", ".gif", ".mp4")
"""Files that a page may show, rather than save."""
WHAT = {
    PLATE: "Every metric of every movie: a row for each.", MOVIES: "A row for each movie, with its key numbers.",
    INDEX: "A page over all movies that leads to each report.",
    "plate.parquet": "Every metric of every movie, for programs.",
    "movies.parquet": "A row for each movie, for programs.",
    "plate.xlsx": "All tables and plates in one workbook.",
}
FOLDERS = {"plate_maps": "A plate as a picture, for papers.", "comparison": "How groups, phases or doses compare.",
           "comparison/prism": "A table to paste into Prism.", "comparison/figures": "A figure of the comparison."}
"""Folders of a run, beside its movies' own, and what their files are."""


class Results:
    """Results that were read lately; reading one takes a second, and some 30 kB a frame."""

    MOST = 2

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[tuple[str, int, int], Analysis] = OrderedDict()
        self._traces: OrderedDict[tuple[str, int, int], dict[str, Any]] = OrderedDict()

    def load(self, result: Path) -> Analysis:
        """Read a result. Raises Refused where there is none, ResultUnreadable where it is damaged."""
        key = _stamp(result)
        with self._lock:
            if key in self._kept:
                return self._kept[key]
        analysis = load(result)
        with self._lock:
            self._kept[key] = analysis
            while len(self._kept) > self.MOST:
                self._kept.popitem(last=False)
        return analysis

    def traces(self, result: Path) -> dict[str, Any]:
        """What the report draws of a result, but for its maps: from the report, or anew where there is none."""
        key = _stamp(result)
        with self._lock:
            if key in self._traces:
                return self._traces[key]
        try:
            data = data_of((result / NAME).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            analysis = self.load(result)
            data = page_data(analysis, tables(analysis))
        data.pop("map", None)
        with self._lock:
            self._traces[key] = data
            while len(self._traces) > 4 * self.MOST:
                self._traces.popitem(last=False)
        return data


def _stamp(result: Path) -> tuple[str, int, int]:
    try:
        about = (result / RESULT).stat()
    except OSError:
        raise Refused(404, "NoResult", f"{result.name}: this movie has no result yet; start the run first") from None
    return str(result), about.st_mtime_ns, about.st_size


def report_page(result: Path) -> Response:
    """Answer with the report of a movie: its own scripts run, but know nothing of the app. Raises Refused."""
    try:
        text = (result / NAME).read_text(encoding="utf-8")
    except OSError:
        raise Refused(404, "NoResult", f"{result.name}: this movie has no report yet; start the run first") from None
    found = POLICY.search(text[:8192])
    policy = found[1].replace("&#x27;", "'").replace("&#39;", "'") if found else "default-src 'none'"
    return HTMLResponse(text, headers={"content-security-policy": f"{policy}; {SANDBOX}"})


def findings_of(result: Path) -> list[dict[str, Any]]:
    """Read what was found of a movie, without reading the whole result; nothing where there is none."""
    if not (result / RESULT).is_file():
        return []
    try:
        return [told(finding) for finding in glance(result).findings]
    except ResultUnreadable as error:
        return [told(Finding("result_unreadable", "fail", str(error)))]


def told(finding: Finding) -> dict[str, Any]:
    """A finding as the pages take it."""
    return {"key": finding.key, "level": finding.level, "message": finding.message, "value": finding.value,
            "limit": finding.limit}


def files_of(home: Home, result: Path) -> list[dict[str, Any]]:
    """List the files of one result, by their paths below the run."""
    found = [file for file in sorted(result.rglob("*")) if file.is_file() and not file.name.startswith(".")]
    return [{"name": file.relative_to(result).as_posix(), "path": file.relative_to(home.out).as_posix(),
             "bytes": file.stat().st_size} for file in found]


def outputs_of(home: Home) -> list[dict[str, Any]]:
    """List the files that are about a whole run, with a sentence each."""
    found = []
    for folder in ("", *FOLDERS):
        if (home.out / folder).is_dir():
            found += [file for file in sorted((home.out / folder).iterdir())
                      if file.is_file() and not file.name.startswith(".") and file.name != LIST]
    out = []
    for file in found:
        inside = file.relative_to(home.out).parent.as_posix()
        what = WHAT.get(file.name, "A file of this run.") if inside == "." else FOLDERS[inside]
        out.append({"path": file.relative_to(home.out).as_posix(), "bytes": file.stat().st_size, "what": what})
    return out


def run_file(home: Home, path: str, *, inline: bool) -> Response:
    """Answer with a file of a run. Raises Refused for one that is not there, hidden, or not within the run."""
    parts = path.split("/")
    if any(part in ("", "..") or part.startswith(".") or "\0" in part or "\\" in part for part in parts):
        raise not_there(f"{path[:200]}: there is no such file")
    try:
        file = home.out.joinpath(*parts).resolve(strict=True)
    except (OSError, RuntimeError):
        raise not_there(f"{path[:200]}: there is no such file") from None
    if not file.is_relative_to(home.out.resolve()) or not file.is_file():
        raise not_there(f"{path[:200]}: there is no such file")
    kind = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
    shown = "inline" if inline and file.suffix.lower() in SHOWN_INLINE else "attachment"
    return FileResponse(file, media_type=kind, filename=file.name, content_disposition_type=shown,
                        headers={"content-security-policy": "sandbox; default-src 'none'; frame-ancestors 'none'"})


def plates_told(tasks: Iterable[Task]) -> list[dict[str, Any]]:
    """Put the movies of a run into their plates: rows and columns of each, and which movie is in which well."""
    known = {task.movie: task for task in tasks}
    plates, _ = plates_of(WellMovie(task.movie, task.columns, "failed", {}) for task in known.values())
    return [{"name": plate.name, "rows": plate.rows, "cols": plate.columns, "wells": [
        {"well": well_name(well.place), "row": well.place[0], "col": well.place[1], "key": known[movie.movie].key,
         "columns": dict(movie.columns)} for well in plate.wells for movie in well.movies]} for plate in plates]


def check_room(folder: Path, wanted: int) -> None:
    """Check that a disk has room for something. Raises OutputError."""
    import shutil

    free = shutil.disk_usage(folder).free
    if free < wanted:
        raise OutputError(f"{folder}: expected room for {wanted / 1e6:.0f} MB on this disk; {free / 1e6:.0f} MB are "
                          "free")


def result_of(home: Home, key: str) -> Path:
    """Where the result of a movie lies."""
    return home.out / RESULTS / key
