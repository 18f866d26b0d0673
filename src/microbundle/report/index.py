"""An index over many reports: one page with a row for each movie, that sorts by any column."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from ..analysis import Analysis
from ..data import Verdict
from ..errors import ConfigError, ResultUnreadable
from ..folder import write_file
from ..store import RESULT, load
from .build import NAME
from .page import MARK, Html, joined, make_page, number, tag
from .pictures import thumbnail
from .sections import CARDS, VERDICTS
from .terms import Term, explained, terms

if TYPE_CHECKING:
    import pandas as pd

STYLES = ("base.css", "index.css")
SCRIPTS = ("base.js", "index.js")
ORDER = {"fail": 0, "review": 1, "pass": 2}


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


def write_index(reports: Iterable[Summary | Path | str], path: Path | str, *, title: str = "Movies",
                overwrite: bool = False) -> Path:
    """Write an index page over many results, given as summaries or as result folders.

    Links are relative to the page, so that a folder with all of them can be moved. Returns the page's path. Raises
    ConfigError for no results, ResultUnreadable for a folder that is not one, OutputError where the page cannot be
    written.
    """
    path = Path(path).expanduser()
    listed = [one if isinstance(one, Summary) else summary_of_folder(Path(one)) for one in reports]
    if not listed:
        raise ConfigError("reports: expected at least one result for an index; found none")
    columns = _columns(listed)
    body = joined(_row(one, columns, path.resolve().parent) for one in listed)
    head = joined([_head("Movie"), _head("Verdict"), _head("Beats"), *(_head(joined([explained(term), f" {term.unit}"]))
                                                                      for term in columns.values())])
    counts = ", ".join(f"{sum(one.verdict == verdict for one in listed)} {told[0].lower()}"
                       for verdict, told in VERDICTS.items())
    what = f"{len(listed)} movie{'s' if len(listed) > 1 else ''}: {counts}."
    page = make_page("index.html", STYLES, SCRIPTS, {}, {"title": title, "version": _version(), "what": what,
                                                         "head": head, "body": body})
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


def _head(content: object) -> Html:
    return tag("th", tag("button", joined([content, tag("span", "", class_="way", aria_hidden="true")]), type="button"),
               scope="col")


def _row(one: Summary, columns: Mapping[str, Any], home: Path) -> Html:
    picture = Html(f'<img src="{one.picture}" alt="" width="180" loading="lazy">')
    name: Html | str = one.name
    if one.report is not None:
        link = quote(Path(os.path.relpath(one.report.resolve(), home)).as_posix())
        name = tag("a", one.name, href=link)
    told = joined(tag("span", message) for message in one.findings)
    cells = [tag("th", joined([picture, name]), scope="row", data_value=one.name),
             tag("td", joined([tag("strong", VERDICTS[one.verdict][0], class_=f"badge {one.verdict}"), told]),
                 class_="told", data_value=ORDER[one.verdict]),
             tag("td", str(one.beats), data_value=one.beats)]
    for column in columns:
        value = one.metrics.get(column, np.nan)
        cells.append(tag("td", number(value), data_value=repr(value) if np.isfinite(value) else None))
    return tag("tr", joined(cells))


def _version() -> str:
    from importlib.metadata import version

    return version("microbundle")
