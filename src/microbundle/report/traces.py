"""What the page's charts and maps draw, as numbers: traces, beats, strain of each sub-domain, displacement on the grid.

Traces are numbers of four digits. The displacement on the grid is quantised to 16 bits, which is far below its error,
and thinned in time where a long movie would make the page large.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis import Analysis
from ..data import Floats
from ..numbers import clock, seconds_per_frame
from .pictures import view_box
from .terms import Term, terms

if TYPE_CHECKING:
    import pandas as pd

MOST_VALUES = 1_200_000
"""16-bit numbers of the displacement map in a page; longer movies show every second, third ... frame."""
FULL = 32000
"""Largest number of the 16 bits that is used; -32768 stands for what is not known."""
UNKNOWN = -32768


def page_data(analysis: Analysis, made: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """Collect everything that the page's scripts draw."""
    step, beats = seconds_per_frame(analysis), analysis.beats
    time = clock(analysis) * (step or 1.0)
    return {
        "name": analysis.name,
        "time": rounded(time, 6), "time_unit": "s" if step is not None else "frames",
        "length_unit": "px" if analysis.um_per_px is None else "µm", "view": view_box(analysis),
        "beats": [{"start": int(beats.start[b]), "peak": int(beats.peak[b]), "stop": int(beats.stop[b]),
                   "complete": bool(beats.complete[b]), "left_out": bool(beats.left_out[b]), "name": beats.label(b),
                   "time": at}
                  for b, at in enumerate(rounded(_peak_times(analysis, made["beats"], time), 6))],
        "signals": signals(analysis, made), "strain": strain(analysis, made["strain"]),
        "map": displacement(analysis), "loop": loop(analysis, made),
    }


def _peak_times(analysis: Analysis, rows: pd.DataFrame, time: Floats) -> Floats:
    """Time of each beat's peak (B,): between frames where it could be measured, else that of its frame."""
    at_frame = time[analysis.beats.peak]
    term = written_as(terms(analysis), rows, "peak_time")
    if term is None:
        return at_frame
    measured = rows[term.column].to_numpy(float)
    return np.where(np.isfinite(measured), measured, at_frame)


def signals(analysis: Analysis, made: Mapping[str, pd.DataFrame]) -> list[dict[str, Any]]:
    """Describe the traces of the tissue and the pillars: what they are called, their unit, values, errors."""
    known, frames = terms(analysis), made["frames"]
    out = []
    for key, text in (("mean_absolute_displacement", "Mean displacement"), ("shortening", "Fractional shortening")):
        term = written_as(known, frames, key)
        if term is not None:
            out.append({"id": key, "title": text, "unit": term.unit, "tip": term.metric.definition,
                        "lines": [_line("tissue", frames, term)]})
    pillars = made["pillar_frames"]
    if len(pillars):
        term, title = pillar_term(analysis, pillars)
        out.append({"id": "pillars", "title": title, "unit": term.unit, "tip": term.metric.definition,
                    "lines": [_line(f"pillar {name}", pillars[pillars["pillar"] == name], term)
                              for name in dict.fromkeys(pillars["pillar"])]})
    return out


def pillar_term(analysis: Analysis, pillars: pd.DataFrame) -> tuple[Term, str]:
    """Choose what to show of the pillars: their force, or their deflection where no force is known."""
    known = terms(analysis)
    force = written_as(known, pillars, "pillar_force")
    if force is not None and pillars[force.column].notna().any():
        return force, "Pillar force"
    deflection = written_as(known, pillars, "pillar_deflection_axis")
    assert deflection is not None
    return deflection, "Pillar deflection"


def written_as(known: Mapping[str, Term], table: pd.DataFrame, key: str) -> Term | None:
    """Find the column of a metric in a table, in um rather than px; None where it has none."""
    found = [term for term in known.values() if term.metric.key == key and term.column in table]
    return found[-1] if found else None


def _line(name: str, table: pd.DataFrame, term: Term) -> dict[str, Any]:
    error = term.error_column if term.error_column in table else None
    return {"name": name, "y": rounded(table[term.column].to_numpy(float)),
            "se": None if error is None else rounded(table[error].to_numpy(float), 3)}


def strain(analysis: Analysis, table: pd.DataFrame) -> dict[str, Any] | None:
    """Describe the sub-domains: corners, traces of E (frames, sub-domains) and of the error of E_cc; None without."""
    found = analysis.strain
    if found is None:
        return None
    shape = found.F.shape[:2]
    parts = {name: rounded(found.E[..., i, j]) for name, i, j in (("cc", 1, 1), ("rr", 0, 0), ("rc", 0, 1))}
    se = rounded(table["E_cc_se"].to_numpy(float).reshape(shape), 3) if "E_cc_se" in table else None
    return {"labels": list(found.label), "cols": found.grid[1], "reasons": list(found.reason),
            "corners": rounded(found.corner_px + 0.5, 5), "E": parts, "se": se}


def displacement(analysis: Analysis) -> dict[str, Any] | None:
    """Describe the displacement on the grid: int16 (frames, points, along and across the tissue), row by row, and the
    affine map from grid indices to the picture; None where nothing is known."""
    grid, scale = analysis.grid, analysis.um_per_px or 1.0
    rows, cols = grid.shape
    moved = np.asarray(grid.displacement_px)
    every = max(1, -(-moved.size // MOST_VALUES))
    moved = moved[::every]
    size = float(np.nanmax(np.abs(moved))) if np.isfinite(moved).any() else 0.0
    if size == 0 or rows < 2 or cols < 2:
        return None
    along = analysis.masks.axis.direction
    turned = np.stack([moved @ along, moved @ np.array([along[1], -along[0]])], axis=-1)
    limit = float(np.nanmax(np.abs(turned)))
    coded = np.where(np.isfinite(turned), np.rint(turned * (FULL / limit)), UNKNOWN).astype("<i2")
    point = grid.point_px.reshape(rows, cols, 2) + 0.5
    return {
        "every": every, "rows": rows, "cols": cols, "count": len(moved), "unit_size": limit * scale / FULL,
        "px_size": limit / FULL, "along": rounded(along, 8), "origin": rounded(point[0, 0], 7),
        "row_step": rounded((point[-1, 0] - point[0, 0]) / (rows - 1), 7),
        "col_step": rounded((point[0, -1] - point[0, 0]) / (cols - 1), 7),
        "data": base64.b64encode(coded.tobytes()).decode(),
    }


def loop(analysis: Analysis, made: Mapping[str, pd.DataFrame]) -> dict[str, Any] | None:
    """Describe the loop of the pillars' mean force over the tissue's shortening; None without pillars."""
    pillars, frames = made["pillar_frames"], made["frames"]
    if len(pillars) == 0:
        return None
    term, title = pillar_term(analysis, pillars)
    mean = pillars[term.column].to_numpy(float).reshape(analysis.frame_count, -1).mean(axis=1)
    return {"x": rounded(frames["shortening"].to_numpy(float)), "y": rounded(mean), "unit": term.unit,
            "title": f"{title}, mean of the pillars"}


def rounded(values: Floats, digits: int = 4) -> Any:
    """Round an array to a number of digits, as nested lists with None for what is not known."""
    flat: list[Any] = [float(f"%.{digits}g" % value) if np.isfinite(value) else None
                       for value in np.ravel(values).tolist()]
    for size in reversed(np.shape(values)[1:]):
        flat = [flat[i:i + size] for i in range(0, len(flat), size)]
    return flat
