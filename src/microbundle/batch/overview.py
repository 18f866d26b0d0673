"""What the index page shows of each movie, kept beside its result, so that the page is made without opening results."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..analysis import Analysis
from ..dictionary import METRICS
from ..report import NAME
from ..report.index import Summary, summarize, summary_of_folder
from ..report.terms import Term

if TYPE_CHECKING:
    import pandas as pd

FILE = "overview.json"


def write_overview(analysis: Analysis, summary: pd.DataFrame, folder: Path) -> None:
    """Write what the index shows into a result folder. Raises OSError."""
    one = summarize(analysis, summary)
    terms = {name: (METRICS.index(term.metric), term.unit, term.error_column) for name, term in one.terms.items()}
    metrics = {name: value for name, value in one.metrics.items() if math.isfinite(value)}
    kept = {"name": one.name, "verdict": one.verdict, "findings": one.findings, "beats": one.beats, "metrics": metrics,
            "terms": terms, "picture": one.picture}
    (folder / FILE).write_text(json.dumps(kept) + "\n", encoding="utf-8")


def read_overview(folder: Path, columns: Mapping[str, str] | None = None) -> Summary:
    """Read what the index shows of a result, with further columns. Raises ResultUnreadable where it is no result."""
    columns = columns or {}
    try:
        kept = json.loads((folder / FILE).read_text(encoding="utf-8"))
        terms = {name: Term(name, METRICS[number], unit, error)
                 for name, (number, unit, error) in kept["terms"].items()}
        return Summary(kept["name"], kept["verdict"], tuple(kept["findings"]), kept["beats"], kept["metrics"], terms,
                       kept["picture"], folder / NAME, columns)
    except (OSError, ValueError, TypeError, KeyError, IndexError):  # of another version, or damaged
        return replace(summary_of_folder(folder), columns=columns)
