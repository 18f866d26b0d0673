"""An index over many reports: one page with a row for each movie, that sorts by any column, and maps of plates."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from ..analysis import Analysis
from ..data import Verdict
from ..errors import ConfigError, ResultUnreadable
from ..folder import write_file
from ..plates import Plate
from ..store import RESULT, load
from .build import NAME
from .page import MARK, MISSING, Html, joined, make_page, number, tag
from .pictures import thumbnail
from .plate_section import plate_data, plate_section
from .sections import CARDS, VERDICTS
from .terms import Term, explained, terms

if TYPE_CHECKING:
    import pandas as pd

STYLES = ("base.css", "index.css")
SCRIPTS = ("base.js", "plates.js", "index.js")
ORDER = {"failed": 0, "fail": 1, "review": 2, "pass": 3}
MOST_PICTURES = 200
"""Movies of a page with pictures; each is some kilobytes."""


@dataclass(frozen=True)
class Summary:
    """What the index shows of one movie."""

    name: str
    verdict: Verdict
    findings: tuple[str, ...]
    """Messages of what is to be looked at."""
    beats: int
    metrics: Mapping[str, float]
    """Means of the key metrics, by the column's name."""
    terms: Mapping[str, Term]
    picture: str
    """Thumbnail, as a data URI."""
    report: Path | None
    """The report, or None where there is none."""
    columns: Mapping[str, str] = field(default_factory=dict)
    """What else is known of the movie: plate, well, group, ..."""


@dataclass(frozen=True)
class NoResult:
    """What the index shows of a movie that could not be measured."""

    name: str
    kind: str
    """Name of the error."""
    message: str
    columns: Mapping[str, str] = field(default_factory=dict)


def summarize(analysis: Analysis, summary: pd.DataFrame, report: Path | None = None) -> Summary:
    """Take what the index shows from a result and its table `summary`; `report` is where its page lies."""
    known = terms(analysis)
    means = {str(row["metric"]): float(row["mean"]) for row in summary.to_dict("records") if row["n"] > 0}
    first = (next((name for name in choices if name in means), None) for choices in CARDS)
    wanted = {name: means[name] for name in first if name is not None}
    return Summary(analysis.name, analysis.verdict,
                   tuple(f.message for f in analysis.findings if f.level != "info"),
                   int(analysis.beats.complete.sum()), wanted, {name: known[name] for name in wanted},
                   thumbnail(analysis), report)


def write_index(reports: Iterable[Summary | NoResult | Path | str], path: Path | str, *, title: str = "Movies",
                plates: Sequence[Plate] = (), metrics: Sequence[str] = (), files: Sequence[Path] = (),
                overwrite: bool = False) -> Path:
    """Write an index page over many results, given as summaries or as result folders.

    It leads to each report, and to further `files`. Links are relative to the page, so that a folder with all of
    them can be moved; those of `plates`, of which the page shows maps of the `metrics` (names of columns), already
    are. Beyond 200 movies there are no pictures. Returns the page's path. Raises ConfigError for no results,
    ResultUnreadable for a folder that is not one, OutputError where the page cannot be written.
    """
    path = Path(path).expanduser()
    listed = [one if isinstance(one, Summary | NoResult) else summary_of_folder(Path(one)) for one in reports]
    if not listed:
        raise ConfigError("reports: expected at least one result for an index; found none")
    done = [one for one in listed if isinstance(one, Summary)]
    known, numbers = list(dict.fromkeys(name for one in listed for name in one.columns)), _columns(done)
    pictures, home = len(listed) <= MOST_PICTURES, path.resolve().parent
    body = joined((_row(one, known, numbers, home, pictures) if isinstance(one, Summary) else
                   _row_without(one, known, len(numbers)) for one in listed), "\n")
    head = joined([_head("Movie", text=True), *(_head(name, text=True) for name in known),
                   _head("Verdict", class_="told"), _head("Beats"),
                   *(_head(joined([explained(term), f" {term.unit}"])) for term in numbers.values())])
    counts = [f"{sum(one.verdict == verdict for one in done)} {told[0].lower()}" for verdict, told in VERDICTS.items()]
    if len(done) < len(listed):
        counts.append(f"{len(listed) - len(done)} without a result")
    what = f"{len(listed)} movie{'s' if len(listed) > 1 else ''}: {', '.join(counts)}."
    page = make_page("index.html", STYLES, SCRIPTS, plate_data(plates, metrics), {
        "title": title, "version": _version(), "what": what, "head": head, "body": body, "files": _links(files, home),
        "plates": plate_section(plates, metrics)})
    return write_file(path, page, mark=MARK, overwrite=overwrite)


def summary_of_folder(folder: Path) -> Summary:
    """Read what the index shows from a result folder; raises ResultUnreadable where it is not one."""
    import xarray as xr

    analysis = load(folder)
    file = folder / RESULT if folder.is_dir() else folder
    try:
        with xr.open_dataset(file, engine="h5netcdf", group="tables/summary") as data:
            table = data.to_dataframe()
    except OSError as error:
        raise ResultUnreadable(f"{file}: expected a result with its table of metrics; it cannot be read: {error}"
                               ) from None
    page = file.parent / NAME
    return summarize(analysis, table, page if page.is_file() else None)


def _columns(listed: Sequence[Summary]) -> dict[str, Term]:
    """The columns of the index, in the order of the key numbers: all that any movie has."""
    known = {name: term for one in listed for name, term in one.terms.items()}
    return {name: known[name] for choices in CARDS for name in choices if name in known}


def _head(content: object, *, text: bool = False, class_: str | None = None) -> Html:
    """Head of a column, a button that sorts by it; `text` is sorted as people sort names."""
    button = tag("button", joined([content, tag("span", "", class_="way", aria_hidden="true")]), type="button")
    return tag("th", button, scope="col", data_text=text, class_="known" if text else class_)


def _row(one: Summary, known: Sequence[str], numbers: Iterable[str], home: Path, pictures: bool) -> Html:
    picture = Html(f'<img src="{one.picture}" alt="" width="180" loading="lazy">') if pictures else ""
    name: Html | str = one.name
    if one.report is not None:
        name = tag("a", one.name, href=_way(one.report, home))
    cells = [tag("th", joined([picture, name]), scope="row", data_value=one.name), *_known(one.columns, known),
             _verdict(one.verdict, VERDICTS[one.verdict][0], one.findings),
             tag("td", str(one.beats), data_value=one.beats)]
    for column in numbers:
        value = one.metrics.get(column, np.nan)
        cells.append(tag("td", number(value), data_value=f"{value:.7g}" if np.isfinite(value) else None))
    return tag("tr", joined(cells))


def _links(files: Sequence[Path], home: Path) -> Html:
    """A line that leads to files; nothing where there are none."""
    if not files:
        return Html("")
    links = (tag("a", Path(os.path.relpath(file.resolve(), home)).as_posix(), href=_way(file, home)) for file in files)
    return tag("p", joined(["Tables: ", joined(links, ", ")]))


def _way(file: Path, home: Path) -> str:
    """Address of a file, as it is from a page in a folder."""
    return quote(Path(os.path.relpath(file.resolve(), home)).as_posix())


def _row_without(one: NoResult, known: Sequence[str], numbers: int) -> Html:
    return tag("tr", joined([tag("th", one.name, scope="row", data_value=one.name), *_known(one.columns, known),
                             _verdict("failed", "No result", (f"{one.kind}: {one.message}",)),
                             *[tag("td", MISSING)] * (1 + numbers)]))


def _known(columns: Mapping[str, str], known: Sequence[str]) -> Iterable[Html]:
    return (tag("td", columns.get(name, ""), data_value=columns.get(name) or None, class_="known") for name in known)


def _verdict(state: str, said: str, messages: Iterable[str]) -> Html:
    told = joined(tag("span", message) for message in messages)
    badge = tag("strong", said, class_=f"badge {'fail' if state == 'failed' else state}")
    return tag("td", joined([badge, told]), class_="told", data_value=ORDER[state])


def _version() -> str:
    from importlib.metadata import version

    return version("microbundle")
