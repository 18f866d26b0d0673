"""Measure the deformation of the tissue, sub-domain by sub-domain.

A rectangle in the middle of the tissue is divided into tiles. In each tile, frame and beat the deformation gradient
F is the least-squares fit of x - x0 = F (X - X0) over the tile's markers, with X their relaxed positions, x their
positions in the frame and X0, x0 the means. (The fit over all pairs of markers, as the paper writes it, is the same:
the sum over pairs is N times the centred sum.) Then E = (F'F - I)/2. Source: paper, "Sub-domain strain".

The axes are the tissue's: row across, col along. A tile with too few markers, or with markers on one line, has no
strain, and says why.
"""

from __future__ import annotations

from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np

from .axis import largest_region
from .config import Config, StrainParams
from .data import Beats, Bools, Floats, Ints, Masks, Strain, Tracks, known
from .errors import CannotMeasure
from .geometry import rotation, to_image, to_tissue
from .published import paper_box, paper_frame

MIN_SPREAD = 0.08
"""Markers fill a tile when they spread by this share of its side in their narrowest direction (0.29 if even)."""


@dataclass(frozen=True)
class Tiling:
    """Where the sub-domains are, in the tissue's axes."""

    corner: Floats
    """Upper left corner (2,) of the grid."""
    grid: tuple[int, int]
    side: tuple[float, float]
    center: Floats
    """Point (2,) about which the tissue's axes are turned."""
    direction: Floats

    @property
    def boxes(self) -> Floats:
        """First row, end row, first column and end column of each tile (S, 4)."""
        row, col = np.divmod(np.arange(self.grid[0] * self.grid[1]), self.grid[1])
        r0, c0 = self.corner[0] + row * self.side[0], self.corner[1] + col * self.side[1]
        return np.stack([r0, r0 + self.side[0], c0, c0 + self.side[1]], axis=1)

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"{_letters(r)}{c + 1}" for r in range(self.grid[0]) for c in range(self.grid[1]))


def measure_strain(tracks: Tracks, beats: Beats, masks: Masks, config: Config) -> Strain:
    """Measure F of each sub-domain in each frame of each beat.

    Raises CannotMeasure where no sub-domain fits into the tissue.
    """
    tiling = place_tiles(masks, config)
    boxes = tiling.boxes
    count, tiles = len(tracks.position_px), len(boxes)
    F = np.full((count, tiles, 2, 2), np.nan)
    shift = np.full((count, tiles, 2), np.nan)
    turn = rotation(tiling.direction)
    usable = tracks.kept & known(beats.relaxed_px)
    home = to_tissue(beats.relaxed_px, tiling.center, tiling.direction)
    number, reason = np.zeros(tiles, int), [""] * tiles
    groups = _paper_groups(beats) if config.method == "paper" else _groups(beats, count)
    for s, box in enumerate(boxes):
        members = usable & _inside(home, box)
        number[s], reason[s] = members.sum(), _why_not(home[members], tiling.side, config.strain)
        for frames, relaxed in groups:
            at = to_tissue(relaxed, tiling.center, tiling.direction)
            if config.method == "paper":  # membership is decided anew at each beat's first frame
                members = usable & _inside(at, box)
            seen = members & known(at)
            if _why_not(at[seen], tiling.side, config.strain):
                continue
            x = to_tissue(tracks.position_px[frames][:, seen], tiling.center, tiling.direction)
            F[frames, s], shift[frames, s] = fit_gradient(at[seen], x, config.strain.min_markers)
    middle = to_image(np.stack([boxes[:, :2].mean(axis=1), boxes[:, 2:].mean(axis=1)], axis=1),
                      tiling.center, tiling.direction)
    r0, r1, c0, c1 = boxes.T
    corners = np.stack([np.stack([r0, c0], 1), np.stack([r0, c1], 1), np.stack([r1, c1], 1), np.stack([r1, c0], 1)], 1)
    return Strain(
        label=tiling.labels, grid=tiling.grid, side_px=tiling.side,
        corner_px=to_image(corners, tiling.center, tiling.direction),
        angle_deg=float(np.degrees(np.arctan2(tiling.direction[0], tiling.direction[1]))),
        center_px=middle + shift @ turn, F=F, count=number, reason=tuple(reason),
    )


def fit_gradient(X: Floats, x: Floats, min_markers: int = 3) -> tuple[Floats, Floats]:
    """Fit F (T, 2, 2) and the mean displacement (T, 2) that carry points X (n, 2) to x (T, n, 2) by least squares.

    Points that are missing (NaN) in a frame are left out of that frame; with fewer than `min_markers` it is NaN.
    """
    seen = known(x)
    n = seen.sum(axis=1)
    weight = seen[..., None] / np.maximum(n, 1)[:, None, None]
    x = np.where(seen[..., None], x, 0.0)
    X0, x0 = (weight * X).sum(axis=1), (weight * x).sum(axis=1)
    dX = (X - X0[:, None]) * seen[..., None]
    dx = (x - x0[:, None]) * seen[..., None]
    M = np.einsum("tni,tnj->tij", dX, dX)
    N = np.einsum("tni,tnj->tij", dx, dX)
    enough = (n >= max(min_markers, 3)) & (np.linalg.det(M) > 1e-9 * np.maximum(np.trace(M, axis1=1, axis2=2), 1) ** 2)
    F = np.full((len(x), 2, 2), np.nan)
    F[enough] = np.swapaxes(np.linalg.solve(np.swapaxes(M[enough], 1, 2), np.swapaxes(N[enough], 1, 2)), 1, 2)
    return F, np.where(enough[:, None], x0 - X0, np.nan)


def place_tiles(masks: Masks, config: Config) -> Tiling:
    """Place the grid of sub-domains in the middle of the tissue, as the settings ask.

    Raises CannotMeasure where none fits.
    """
    params = config.strain
    if config.method == "paper":
        return _paper_tiles(masks.tissue, params)
    center, direction = masks.axis.center_px, masks.axis.direction
    if params.extents_px is not None:
        r0, r1, c0, c1 = params.extents_px
    else:
        row, col = to_tissue(np.argwhere(largest_region(masks.tissue)).astype(float), center, direction).T
        c0, c1 = _clipped(float(col.min()), float(col.max()), params.clip_columns)
        part = row[(col >= c0) & (col <= c1)]
        if part.size == 0:
            raise CannotMeasure("strain: no tissue is left between the clipped ends; lower strain.clip_columns")
        r0, r1 = _clipped(float(part.min()), float(part.max()), params.clip_rows)
    r0, r1 = _clipped(r0, r1, params.shrink_rows)
    c0, c1 = _clipped(c0, c1, params.shrink_columns)
    grid, side = _fit(r1 - r0, c1 - c0, params)
    corner = 0.5 * np.array([r0 + r1 - grid[0] * side, c0 + c1 - grid[1] * side])
    return Tiling(corner, grid, (side, side), center, direction)


def _paper_tiles(tissue: Bools, params: StrainParams) -> Tiling:
    """The published tool's tiles, with its rounding to whole pixels."""
    frame = paper_frame(tissue)
    if params.extents_px is not None:
        r0, r1, c0, c1 = params.extents_px
    else:
        level = frame.level.copy()
        for axis, share in ((1, params.clip_columns), (0, params.clip_rows)):
            box = paper_box(level)
            cut = int(0.5 * share * (box[:, axis].max() - box[:, axis].min()))
            place = np.arange(level.shape[axis])
            outside = (place < box[:, axis].min() + cut) | (place >= box[:, axis].max() - cut)
            if cut > 0:
                level &= ~np.expand_dims(outside, 1 - axis)
        box = paper_box(level)
        (r0, c0), (r1, c1) = box.min(axis=0), box.max(axis=0)
    margin = int(0.5 * params.shrink_rows * (r1 - r0)), int(0.5 * params.shrink_columns * (c1 - c0))
    r0, r1, c0, c1 = r0 + margin[0], r1 - margin[0], c0 + margin[1], c1 - margin[1]
    grid, side = _fit(r1 - r0, c1 - c0, params)
    corner = np.floor(0.5 * np.array([r0 + r1 - grid[0] * side, c0 + c1 - grid[1] * side]))
    return Tiling(corner, grid, (side, side), frame.center, frame.strain_direction)


def _fit(height: float, width: float, params: StrainParams) -> tuple[tuple[int, int], float]:
    if params.tiles is not None:
        rows, cols = params.tiles
        side = float(np.floor(min(height / rows, width / cols)))
    else:
        side = params.tile_px
        rows, cols = int(height // side), int(width // side)
    if rows < 1 or cols < 1 or side < 1:
        raise CannotMeasure(f"strain: expected room for at least one sub-domain of {params.tile_px:g} px; the middle "
                            f"of the tissue has {height:.0f} x {width:.0f} px. Lower strain.tile_px, "
                            "strain.clip_columns or the margins, or give strain.tiles or strain.extents_px")
    return (rows, cols), side


def _clipped(first: float, last: float, share: float) -> tuple[float, float]:
    """Take a share off a range, half at each end."""
    cut = 0.5 * share * (last - first)
    return first + cut, last - cut


def _groups(beats: Beats, count: int) -> list[tuple[Ints, Floats]]:
    """Frames and relaxed positions of each beat; frames between beats belong to the nearest one."""
    if len(beats) == 0:
        return [(np.arange(count), beats.relaxed_px)]
    nearest = beats.nearest_beat
    return [(np.flatnonzero(nearest == b), beats.beat_relaxed_px[b]) for b in range(len(beats))]


def _paper_groups(beats: Beats) -> list[tuple[Ints, Floats]]:
    return [(np.arange(a, b), beats.beat_relaxed_px[i])
            for i, (a, b) in enumerate(zip(beats.start, beats.stop, strict=True))]


def _inside(points: Floats, box: Floats) -> Bools:
    r0, r1, c0, c1 = box
    row, col = points.T
    return np.asarray((row > r0) & (row < r1) & (col > c0) & (col < c1))


def _why_not(points: Floats, side: tuple[float, float], params: StrainParams) -> str:
    if len(points) < params.min_markers:
        return f"{len(points)} markers, needs {params.min_markers}"
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(points))
    if spread < MIN_SPREAD * min(side):
        return f"{len(points)} markers lie almost on one line"
    return ""


def _letters(row: int) -> str:
    """A to Z, then AA, AB, ..."""
    return (ascii_uppercase[row // 26 - 1] if row >= 26 else "") + ascii_uppercase[row % 26]
