"""The part of the index with the maps of plates: as data for its script, and as tables for those who run none."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any
from urllib.parse import quote

from ..plates import Plate, Well, groups_of, limits_of
from ..wells import row_name
from .page import MISSING, Html, joined, number, tag
from .terms import label, term_of

VERDICTS = {"pass": "verdict pass", "review": "to be reviewed", "fail": "verdict fail: its numbers cannot be trusted",
            "failed": "no result"}
SHORT = {"pass": MISSING, "review": MISSING, "fail": "fail", "failed": "no result"}
LEGEND = ("Crossed: no result. Hatched: its numbers cannot be trusted. A corner: to be reviewed. Blank: no movie. All "
          "plates have one scale. Point at a well, or move with the arrow keys, to read about it; it leads to its "
          "report.")


def plate_data(plates: Sequence[Plate], metrics: Sequence[str]) -> dict[str, Any]:
    """Give the page's script all that it shows of plates; nothing where there are none."""
    if not plates:
        return {}
    scales = {metric: limits for metric in metrics if (limits := limits_of(plates, metric)) is not None}
    shown = []
    for metric, (low, high) in scales.items():
        term = term_of(metric)
        shown.append({"name": term.name, "unit": term.unit, "low": low, "high": high, "tip": term.metric.definition})
    return {"metrics": shown, "groups": groups_of(plates), "plates": [
        {"name": plate.name, "rows": plate.rows, "columns": plate.columns,
         "row_names": [row_name(row) for row in range(plate.rows)],
         "wells": [_well(well, list(scales)) for well in plate.wells]} for plate in plates]}


def _well(well: Well, metrics: Sequence[str]) -> dict[str, Any]:
    values = [[_digits(one) for one in well.reading(metric)] for metric in metrics]
    report = next((movie.report for movie in well.movies if movie.report), "")
    return {"name": well.name, "place": well.place, "group": well.group, "state": well.state, "told": list(_told(well)),
            "report": quote(report), "values": values}


def _told(well: Well) -> Iterator[str]:
    """What became of a well's movies."""
    if len(well.movies) > 1:
        yield f"mean of {sum(movie.state in ('pass', 'review') for movie in well.movies)} of {len(well.movies)} movies"
    for movie in well.movies:
        what = f"{VERDICTS[movie.state]}: {movie.kind}: {movie.message}" if movie.kind else VERDICTS[movie.state]
        yield f"{movie.movie}: {what}" if len(well.movies) > 1 else what


def _digits(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None


def plate_section(plates: Sequence[Plate], metrics: Sequence[str]) -> Html:
    """Write the section of the page; empty where there are no plates."""
    if not plates:
        return Html("")
    known = [metric for metric in metrics if limits_of(plates, metric) is not None]
    tables = joined(_table(plate, known[0] if known else None) for plate in plates)
    choice = tag("div", joined([tag("label", "Show", for_="metric"), tag("select", "", id="metric"),
                                tag("div", "", id="scale")]), class_="choice", hidden=True)
    return tag("section", joined([tag("h2", f"Plate{'s' * (len(plates) > 1)}", id="plates-title"), choice,
                                  tag("div", "", id="maps"), tag("div", tables, id="plate-tables"),
                                  tag("p", LEGEND, class_="note")]), id="plates", aria_labelledby="plates-title")


def _table(plate: Plate, metric: str | None) -> Html:
    """Write a plate as a table of one metric."""
    cells = {well.place: number(value, 3) if metric and math.isfinite(value := well.reading(metric)[0])
             else SHORT[well.state] for well in plate.wells}
    head = joined([tag("th", "", scope="col"), *(tag("th", str(c + 1), scope="col") for c in range(plate.columns))])
    rows = joined(tag("tr", joined([tag("th", row_name(r), scope="row"),
                                    *(tag("td", cells.get((r, c), "")) for c in range(plate.columns))]))
                  for r in range(plate.rows))
    term = term_of(metric) if metric else None
    said = joined([plate.name, ": " if plate.name else "", "" if term is None else label(term.name),
                   f" ({term.unit})" if term and term.unit else ""])
    return tag("table", joined([tag("caption", said), tag("thead", tag("tr", head)), tag("tbody", rows)]))
