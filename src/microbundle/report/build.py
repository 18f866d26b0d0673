"""The report of one movie: a page that stands alone, needs no network, and can be made again from the result file."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ..analysis import Analysis
from ..errors import OutputError
from ..folder import write_file
from . import sections, text
from .page import MARK, Html, joined, make_page, tag
from .pictures import data_uri, grey
from .traces import page_data

if TYPE_CHECKING:
    import pandas as pd

NAME = "report.html"
LARGEST_MOVIE = 4_000_000
"""Bytes of a movie that a page may hold; a larger one is only mentioned."""
STYLES = ("base.css", "chart.css", "report.css")
SCRIPTS = ("base.js", "chart.js", "map.js", "report.js")


def write_report(analysis: Analysis, path: Path | str, *, made: Mapping[str, pd.DataFrame] | None = None,
                 movie: Path | None = None, overwrite: bool = False) -> Path:
    """Write the report of a result: one HTML file with findings, numbers, maps, traces, tables and methods.

    `made` are the tables of `microbundle.tables`, where they are at hand; `movie` is an MP4 to show in it. The file
    appears whole or not at all. Returns its path. Raises OutputError where it cannot be written, or exists and may not
    be replaced.
    """
    page = report_page(analysis, made, movie)
    return write_file(Path(path), page, mark=MARK, overwrite=overwrite)


def report_page(analysis: Analysis, made: Mapping[str, pd.DataFrame] | None = None, movie: Path | None = None) -> str:
    """Make the page of a result, as text. Raises OutputError where the movie cannot be read."""
    from ..metrics import tables

    made = tables(analysis) if made is None else made
    verdict, meaning = sections.VERDICTS[analysis.verdict]
    listed = list(sections.tables(analysis, made))
    no_pillars = analysis.pillars is None
    beats = len(analysis.beats)
    return make_page("report.html", STYLES, SCRIPTS, page_data(analysis, made), {
        "name": analysis.name, "version": analysis.versions.get("microbundle", ""), "verdict": analysis.verdict,
        "verdict_name": verdict, "verdict_text": meaning, "what": text.summary_sentence(analysis),
        "findings": sections.findings(analysis.findings), "cards": sections.cards(analysis, made["summary"]),
        "picture": sections.picture(analysis, data_uri(grey(analysis.image))),
        "trace_reasons": _missing(analysis),
        "beats_reason": "" if beats else tag("p", sections.why_no_beats(analysis), class_="reason"),
        "loop_reason": tag("p", sections.why_no_pillars(analysis), class_="reason") if no_pillars else
                       "" if analysis.beats.complete.any() else
                       tag("p", "There is no whole beat, so there is no loop.", class_="reason"),
        "movie": "" if movie is None else _movie(analysis, movie),
        "tabs": joined(tag("button", title, type="button", role="tab", id=f"tab-{key}", aria_controls=f"panel-{key}")
                       for key, title, _ in listed),
        "panels": joined(tag("div", joined([tag("h3", title), body]), class_="panel", role="tabpanel",
                             id=f"panel-{key}", aria_labelledby=f"tab-{key}") for key, title, body in listed),
        "methods": sections.methods(analysis), "provenance": sections.provenance(analysis),
        "settings": sections.settings(analysis),
    })


def _missing(analysis: Analysis) -> Html:
    """Say which traces there are not, and why."""
    reasons = []
    if analysis.strain is None:
        reasons.append(("No strain. ", sections.why_no_strain(analysis)))
    if analysis.pillars is None:
        reasons.append(("No pillars. ", sections.why_no_pillars(analysis)))
    return joined(tag("p", joined([tag("strong", what), why]), class_="reason") for what, why in reasons)


def _movie(analysis: Analysis, movie: Path) -> Html:
    """Show a movie in the page, or name it where it is too large."""
    try:
        size = movie.stat().st_size
        content = movie.read_bytes() if size <= LARGEST_MOVIE else b""
    except OSError as error:
        raise OutputError(f"{movie}: expected a movie for the report; it cannot be read: {error.strerror or error}"
                          ) from None
    if not content:
        shown = tag("p", f"The movie {movie.name} is too large for this page ({size / 1e6:.1f} MB).", class_="reason")
    else:
        uri = f"data:video/mp4;base64,{base64.b64encode(content).decode()}"
        shown = joined([tag("video", "", src=uri, controls=True, muted=True, loop=True, class_="screen",
                            aria_label=f"Movie of {analysis.name}"),
                        tag("p", f"The file {movie.name}.", class_="note")])
    return tag("section", joined([tag("h2", "Movie", id="movie-title"), shown]), id="movie",
               aria_labelledby="movie-title")
