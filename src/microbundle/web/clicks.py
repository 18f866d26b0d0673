"""Points that a person followed by hand on a few frames, beside what was measured there."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..analysis import Analysis
from ..errors import CannotMeasure
from ..synth.manual import Clicks, compare_clicks, displacements
from .answers import Refused

MOST = 2000
PERSON = "you"
HAND_PX = 1.0
"""What a careful hand misses by, in pixels of the picture."""
HAND_SHARE = 0.15
"""What it misses by in large movements, as a share of them: spots change their looks on the way."""
TELLING = 2.0
"""Movements that are not so many times larger than what a hand misses by say nothing."""


def agreement(analysis: Analysis, points: Any) -> dict[str, Any]:
    """Compare clicked points with a result: each point, and all of them. Raises Refused and CannotMeasure."""
    clicks = _read(points)
    scale = analysis.um_per_px
    by_hand, found = displacements(analysis, clicks)
    known = np.isfinite(by_hand).all(axis=1) & np.isfinite(found).all(axis=1)
    if not known.any():
        raise CannotMeasure("clicks: expected a point in the tissue that was clicked in two frames or more; found none")
    off = np.hypot(*(found - by_hand).T)
    each = []
    for point in np.unique(clicks.point):
        mine = known & (clicks.point == point)
        size = float(off[mine].mean()) if mine.any() else None
        each.append({"point": str(point), "clicks": int((clicks.point == point).sum()), "compared": int(mine.sum()),
                     "difference_px": size, "difference_um": _scaled(size, scale),
                     "by_hand_px": by_hand[mine].tolist(), "found_px": found[mine].tolist(),
                     "frames": clicks.frame[mine].tolist()})
    overall, moved = float(off[known].mean()), float(np.hypot(*by_hand[known].T).max())
    r2: dict[str, float | None] = {"row": None, "col": None}
    if known.sum() >= 3:
        whole = compare_clicks(analysis, clicks)[-1]
        r2 = {"row": whole.r2_row, "col": whole.r2_col}
    allowed = max(HAND_PX, HAND_SHARE * moved)
    agrees = None if moved < TELLING * HAND_PX and overall <= allowed else overall <= allowed
    return {"points": each, "difference_px": overall, "difference_um": _scaled(overall, scale), "largest_px": moved,
            "r2": r2, "agrees": agrees, "verdict": _sentence(agrees, overall, moved, allowed, scale)}


def _sentence(agrees: bool | None, overall: float, moved: float, allowed: float, scale: float | None) -> str:
    unit, by = ("µm", scale) if scale is not None else ("px", 1.0)
    told = (f"Your clicks and the measurement differ by {overall * by:.2g} {unit} on average, where the largest "
            f"movement that you clicked is {moved * by:.2g} {unit}.")
    if agrees is None:
        return (f"{told} Such small movements cannot be judged by hand, which misses by about {allowed * by:.2g} "
                f"{unit}: click spots that move more, at rest and at the peak of a beat.")
    if agrees:
        return f"{told} That is within what a hand can do ({allowed * by:.2g} {unit}): they agree."
    return (f"{told} That is more than a hand misses by ({allowed * by:.2g} {unit}). Look at the masks and the "
            "findings, or click again on spots that can be recognised well.")


def _scaled(value: float | None, scale: float | None) -> float | None:
    return None if value is None or scale is None else value * scale


def _read(points: Any) -> Clicks:
    """Check clicked points. Raises Refused."""
    if not isinstance(points, list) or not 0 < len(points) <= MOST:
        raise Refused(400, "BadRequest", f"points: expected a list of 1 to {MOST} clicks")
    try:
        numbers = np.array([[float(one[name]) for name in ("frame", "row", "col")] for one in points])
        names = np.array([str(one["point"])[:50] for one in points])
    except (TypeError, KeyError, ValueError):
        raise Refused(400, "BadRequest", "points: expected point, frame, row and col of each click") from None
    if not np.isfinite(numbers).all() or np.abs(numbers).max() > 1e9:
        raise Refused(400, "BadRequest", "points: expected numbers for frame, row and col")
    return Clicks(np.full(len(names), PERSON), names, numbers[:, 0].astype(int), numbers[:, 1:])
