"""Compare a result with points that people followed by hand, as in the paper (S1 Appendix, "Manual tracking").

The CSV has the columns person, point, frame, row, col (pixels and frames of the movie as it was analyzed; frames count
from 0). Each point's displacement counts from its own first clicked frame, in the clicks and in the result alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..analysis import Analysis
from ..data import Floats, Ints
from ..errors import CannotMeasure, MovieUnreadable
from .scores import r_squared

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("person", "point", "frame", "row", "col")


@dataclass(frozen=True)
class Clicks:
    """Hand-clicked positions, one entry a click; K clicks."""

    person: np.ndarray
    """(K,)"""
    point: np.ndarray
    """(K,)"""
    frame: Ints
    """(K,)"""
    position_px: Floats
    """(K, 2)"""


@dataclass(frozen=True)
class Agreement:
    """How well one person's clicks and the result agree, or, for `person` "all", the means over people."""

    person: str
    points: int
    clicks: int
    r2_row: float
    r2_col: float
    mae_row_px: float
    """Mean absolute difference of the displacement."""
    mae_col_px: float
    spread_px: float
    """Mean distance between this person's displacements and those of each other person for the same clicks; NaN for
    one person alone."""


def read_clicks(path: Path | str) -> Clicks:
    """Read hand-clicked points from a CSV file. Raises MovieUnreadable where a column or a number is missing."""
    import pandas as pd

    path = Path(path)
    try:
        table: Any = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise MovieUnreadable(f"{path}: expected a CSV file with the columns {', '.join(COLUMNS)}: {error}") from None
    table.columns = [str(c).strip().lower() for c in table.columns]
    missing = [c for c in COLUMNS if c not in table.columns]
    if missing:
        raise MovieUnreadable(f"{path}: expected the columns {', '.join(COLUMNS)}; {', '.join(missing)} not found")
    numbers = table[["frame", "row", "col"]].apply(pd.to_numeric, errors="coerce")
    bad = numbers.isna().any(axis=1).to_numpy()
    if bad.any() or not len(table):
        where = f"line {int(np.argmax(bad)) + 2} holds none" if len(table) else "the file holds no clicks"
        raise MovieUnreadable(f"{path}: expected a number for frame, row and col; {where}")
    return Clicks(table["person"].astype(str).to_numpy(), table["point"].astype(str).to_numpy(),
                  numbers["frame"].to_numpy().astype(int), numbers[["row", "col"]].to_numpy(float))


def compare_clicks(analysis: Analysis, clicks: Clicks) -> list[Agreement]:
    """Compare displacements of clicked points with the result's at the same places, person by person, then all.

    Raises CannotMeasure where a frame is not in the movie, or no clicked point can be compared.
    """
    by_hand, found = displacements(analysis, clicks)
    people = sorted(set(clicks.person))
    spread = _spread(clicks, by_hand, people)
    out = []
    for person in people:
        mine = (clicks.person == person) & np.isfinite(by_hand).all(axis=1) & np.isfinite(found).all(axis=1)
        if mine.sum() < 3:
            continue
        r2 = [r_squared(by_hand[mine, k], found[mine, k]) for k in (0, 1)]
        mae = np.abs(found[mine] - by_hand[mine]).mean(axis=0)
        out.append(Agreement(person, len(set(clicks.point[mine])), int(mine.sum()), r2[0], r2[1], float(mae[0]),
                             float(mae[1]), spread[person]))
    if not out:
        raise CannotMeasure("clicks: none of the clicked points lies in the tissue in two frames or more")
    mean = {name: float(np.mean([getattr(a, name) for a in out]))
            for name in ("r2_row", "r2_col", "mae_row_px", "mae_col_px")}
    return [*out, Agreement("all", max(a.points for a in out), sum(a.clicks for a in out), **mean,
                            spread_px=float(np.mean([a.spread_px for a in out])))]


def displacements(analysis: Analysis, clicks: Clicks) -> tuple[Floats, Floats]:
    """Displacement (K, 2) of each click from its point's first one, by hand and in the result; the first are NaN.

    Raises CannotMeasure where a frame is not in the movie.
    """
    if clicks.frame.min() < 0 or clicks.frame.max() >= analysis.frame_count:
        raise CannotMeasure(f"clicks: expected frames from 0 to {analysis.frame_count - 1}; found "
                            f"{clicks.frame.min()} to {clicks.frame.max()}")
    by_hand, found = np.full(clicks.position_px.shape, np.nan), np.full(clicks.position_px.shape, np.nan)
    tracks = _tracks(clicks)
    first = np.array([track[0] for track in tracks])
    here, when = clicks.position_px[first], clicks.frame[first]
    # The relaxed place of what was clicked: its displacement there and then is taken off, twice to settle.
    home = here
    for _ in range(2):
        home = here - np.nan_to_num(analysis.displacement_at(home)[when, np.arange(len(home))])
    moved = analysis.displacement_at(home)
    for k, track in enumerate(tracks):
        rest = track[1:]
        by_hand[rest] = clicks.position_px[rest] - here[k]
        found[rest] = moved[clicks.frame[rest], k] - moved[when[k], k]
    return by_hand, found


def table(agreements: list[Agreement]) -> pd.DataFrame:
    """One row for each person, and one for all."""
    import pandas as pd

    return pd.DataFrame([vars(a) for a in agreements])


def _tracks(clicks: Clicks) -> list[Ints]:
    """Indices of the clicks of each person and point, in the order of frames."""
    key = np.char.add(np.char.add(clicks.person.astype(str), "\0"), clicks.point.astype(str))
    tracks = [np.flatnonzero(key == k) for k in np.unique(key)]
    return [t[np.argsort(clicks.frame[t], kind="stable")] for t in tracks]


def _spread(clicks: Clicks, by_hand: Floats, people: list[str]) -> dict[str, float]:
    """Mean distance of each person's displacements from the others' for the same point and frame."""
    place = {(str(p), str(k), int(f)): i
             for i, (p, k, f) in enumerate(zip(clicks.person, clicks.point, clicks.frame, strict=True))}
    apart: dict[str, list[float]] = {p: [] for p in people}
    keys = {(k, f) for _, k, f in place}
    for a, b in combinations(people, 2):
        for k, f in keys:
            i, j = place.get((a, k, f)), place.get((b, k, f))
            if i is not None and j is not None and np.isfinite(by_hand[[i, j]]).all():
                distance = float(np.hypot(*(by_hand[i] - by_hand[j])))
                apart[a].append(distance)
                apart[b].append(distance)
    return {p: float(np.mean(d)) if d else np.nan for p, d in apart.items()}
