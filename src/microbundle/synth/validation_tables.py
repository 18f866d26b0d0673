"""The table of a validation: the worst and the middle movie of each regime, beside the paper and the goals.

Source: paper, S1 Appendix, tables of errors without and with noise. The goals are those that the accurate method is
built to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import OutputError
from . import cases as regimes
from .coverage import LEVELS, QUANTITIES
from .validate import Row

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Published:
    """What others reached in a regime, in words: peak MAD error and worst E_cc error as shares of the peak."""

    paper: str
    goal: str


_LARGE, _SMALL = "5-15 %, 98 %", "1e3-1e4 % or failure"
BESIDE: dict[str, Published] = {
    regimes.CLEAN_LARGE: Published("2-7 %, 9.2 %", "0.5 %, 1.5 %"),
    regimes.CLEAN_SMALL: Published(_LARGE, "0.5 %, 3 %"),
    regimes.NOISY_LARGE: Published("14.4 %, 15-36 %", "1.5 %, 3 %"),
    regimes.NOISY_08: Published(_SMALL, ""),
    regimes.NOISY_04: Published(_SMALL, "5 %, 12 %"),
    regimes.NOISY_02: Published(_SMALL, "12 %, 12 %, or below the limit"),
    regimes.NOISY_01: Published(_SMALL, ""),
    regimes.STILL: Published("", "no beat"),
}
"""By regime: the paper's numbers, and the goals (at most)."""

SUMMARY = ("regime", "movies", "measured", "no beats", "failed", "peak MAD error, worst", "peak MAD error, middle",
           "E_cc MAE / peak, worst", "E_cc MAE / peak, middle", "RMSE px, worst", "beats missed",
           "extra", "paper", "goal")


def summary_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Make one line of text for each regime that has movies, in the order of `SUMMARY`."""
    out = []
    for group in [*regimes.GROUPS, *sorted({r.group for r in rows} - set(regimes.GROUPS))]:
        mine = [r for r in rows if r.group == group]
        if not mine:
            continue
        seen = [r for r in mine if r.measured]
        mad, ecc, rmse = (np.array([abs(r.scores[name]) for r in seen])
                          for name in ("mad_error_pct", "ecc_mae_pct", "rmse_px"))
        beside = BESIDE.get(group, Published("", ""))
        out.append((
            group, str(len(mine)), str(len(seen)), str(sum(r.status.startswith("no beats") for r in mine)),
            str(sum(r.status.startswith("failed") for r in mine)),
            *(_percent(f(v)) for v in (mad, ecc) for f in (_worst, _middle)), _number(_worst(rmse)),
            str(_total(mine, "missed_beats")), str(_total(mine, "extra_beats")), beside.paper, beside.goal))
    return out


SHORT = ("regime", "movies", "measured", "peak MAD error, worst", "E_cc MAE / peak, worst", "paper", "goal")
"""What fits on a screen."""

EXPECTED = ("regime", "movies", "measured", "peak MAD error, worst", "E_cc MAE / peak, worst", "RMSE px, worst",
            "beats missed")
"""What to expect on a microscope, by amplitude."""


def columns(rows: Sequence[tuple[str, ...]], chosen: Sequence[str]) -> list[tuple[str, ...]]:
    """Take columns of `summary_rows` by their names."""
    return [tuple(row[SUMMARY.index(name)] for name in chosen) for row in rows]


def case_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Make one line of text for each movie: case, amplitude, errors, status."""
    return [(r.case, _number(r.scores["true_mad_px"]), _percent(r.scores["mad_error_pct"], sign=True),
             _percent(r.scores["ecc_mae_pct"]), _number(r.scores["ecc_r2"]), _percent(r.scores["own_ecc_mae_pct"]),
             _number(r.scores["rmse_px"]), _percent(r.scores["gain_pct"], sign=True),
             _number(r.scores["drift_error_px"]), _number(r.scores["missed_beats"]), r.status.split(":")[0])
            for r in rows]


CASE = ("movie", "peak MAD px", "MAD error", "E_cc MAE / peak", "E_cc R2", "E_cc, own tiles", "RMSE px", "gain",
        "drift px", "missed", "status")


def held_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Make one line of text for each regime, and one for all: how often intervals of 95 % held the truth, by quantity
    the mean over movies."""
    at = LEVELS.index(0.95)
    out = []
    for group in [*regimes.GROUPS, "all"]:
        mine = [r for r in rows if r.held and group in (r.group, "all")]
        if mine:
            each = [[100 * r.held[q][at] for r in mine if q in r.held] for q in QUANTITIES]
            out.append((group, str(len(mine)), *(f"{np.mean(v):.0f} %" if v else "" for v in each)))
    return out


HELD = ("regime", "movies", *QUANTITIES)


def table(rows: Sequence[Row]) -> pd.DataFrame:
    """All scores, one row for each movie."""
    import pandas as pd

    return pd.DataFrame([{"case": r.case, "group": r.group, "status": r.status, "verdict": r.verdict, **r.scores,
                          "analysis_cpu_s": r.seconds, "drawing_cpu_s": r.drawing_seconds} for r in rows])


def write_tables(rows: Sequence[Row], folder: Path, title: str) -> list[Path]:
    """Write `scores.csv`, `summary.csv` and `summary.md` into a validation folder. Raises OutputError."""
    import pandas as pd

    summary = summary_rows(rows)
    text = [f"# {title}", "", markdown(SUMMARY, summary), "",
            "Percentages are of the truth; worst and middle (median) are over the movies that were measured.", "",
            markdown(CASE, case_rows(rows)), ""]
    if any(r.held for r in rows):
        text += ["How often an interval of 95 % holds the truth:", "", markdown(HELD, held_rows(rows)), ""]
    failed = [f"- {r.case}: {r.status}" for r in rows if not r.measured]
    files = [folder / name for name in ("scores.csv", "summary.csv", "summary.md")]
    try:
        table(rows).to_csv(files[0], index=False, float_format="%.6g", lineterminator="\n")
        pd.DataFrame(summary, columns=list(SUMMARY)).to_csv(files[1], index=False, lineterminator="\n")
        files[2].write_text("\n".join([*text, *failed, ""]), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{folder}: the tables cannot be written: {error.strerror or error}") from None
    return files


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a table in Markdown."""
    lines = [list(header), ["---"] * len(header), *[[cell.replace("|", "\\|") for cell in row] for row in rows]]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _worst(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else np.nan


def _middle(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else np.nan


def _total(rows: Sequence[Row], name: str) -> int:
    return int(np.nansum([r.scores[name] for r in rows]))


def _percent(value: float, *, sign: bool = False) -> str:
    if not np.isfinite(value):
        return ""
    digits = 2 if abs(value) < 1 else 1 if abs(value) < 100 else 0
    return f"{value:{'+' if sign else ''}.{digits}f} %"


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else ""
