"""Measure the deformation of the tissue, sub-domain by sub-domain.

In each tile, frame and beat the deformation gradient F is the least-squares fit of x - x0 = F (X - X0), with X relaxed
positions in the tile, x their positions in the frame and X0, x0 the means: over the markers in it, or, where there is a
displacement field, over a regular lattice of points. (The fit over all pairs of points, as the paper writes it, is the
same: the sum over pairs is N times the centred sum.) Then E = (F'F - I)/2. Source: paper, "Sub-domain strain".

The axes are the tissue's: row across, col along. A tile with too few markers, or with markers on one line, has no
strain, and says why.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .config import Config, StrainParams
from .contraction import rest_weights
from .data import Beats, Bools, Floats, Ints, Masks, Strain, Tracks, known
from .field import Field, inside_tissue
from .geometry import rotation, to_image, to_tissue
from .tiles import Tiling, place_tiles

MIN_SPREAD = 0.08
"""Markers fill a tile when they spread by this share of its side in their narrowest direction (0.29 if even)."""
LATTICE_PX = 3.0
"""Distance of the points at which a field's strain is fitted."""
MIN_TEXTURE = 0.05
"""Texture of a tile, as a share of the tissue's, below which its strain would only be guessed from around it."""
MIN_TISSUE = 0.5
"""Share of a tile that must be tissue for a field's strain."""


@dataclass(frozen=True)
class Deformation:
    """What was measured in the tiles."""

    F: Floats
    """(T, S, 2, 2) in the tissue's axes."""
    shift: Floats
    """(T, S, 2): mean displacement in the tissue's axes."""
    count: Ints
    """(S,): points in each tile."""
    reason: tuple[str, ...]


def measure_strain(tracks: Tracks, beats: Beats, masks: Masks, config: Config) -> Strain:
    """Measure F of each sub-domain in each frame of each beat.

    Raises CannotMeasure where no sub-domain fits into the tissue.
    """
    tiling = place_tiles(masks, config)
    found = (_of_markers(tracks, beats, tiling, config) if tracks.field is None
             else _of_field(tracks.field, beats, tiling, masks.tissue))
    r0, r1, c0, c1 = tiling.boxes.T
    middle = np.stack([0.5 * (r0 + r1), 0.5 * (c0 + c1)], axis=1)
    return Strain(
        label=tiling.labels, grid=tiling.grid, side_px=tiling.side,
        corner_px=tiling.corner_px,
        angle_deg=float(np.degrees(np.arctan2(tiling.direction[0], tiling.direction[1]))),
        center_px=to_image(middle + found.shift, tiling.center, tiling.direction),
        F=found.F, count=found.count, reason=found.reason,
    )


def _of_markers(tracks: Tracks, beats: Beats, tiling: Tiling, config: Config) -> Deformation:
    boxes = tiling.boxes
    count, tiles = len(tracks.position_px), len(boxes)
    F, shift = np.full((count, tiles, 2, 2), np.nan), np.full((count, tiles, 2), np.nan)
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
    return Deformation(F, shift, number, tuple(reason))


def _of_field(field: Field, beats: Beats, tiling: Tiling, tissue: Bools) -> Deformation:
    """F is linear in the field's coefficients, so each tile needs one small set of weights for all frames."""
    tiles = weigh_tiles(field, tiling, tissue)
    gradient, shift = tiles.gradient(field.weighted(tiles.weights))
    F, moved = np.empty(gradient.shape), np.empty(shift.shape)
    for frames, weights in _rests(beats):  # a rest may hold frames of the beat before
        F[frames] = (np.eye(2) + gradient[frames]) @ np.linalg.inv(np.eye(2) + np.tensordot(weights, gradient, 1))
        moved[frames] = shift[frames] - np.tensordot(weights, shift, 1)
    return Deformation(F, moved, tiles.count, tiles.reason)


@dataclass(frozen=True)
class TileWeights:
    """How the gradient and the mean of a field's displacement in each tile follow from its coefficients."""

    weights: Floats
    """(3 S, K L): slope along the tissue's row and col axis, and mean, for each tile; zeros where it has no strain."""
    turn: Floats
    """(2, 2): from image to tissue axes."""
    count: Ints
    """(S,): points of the tile that are tissue."""
    reason: tuple[str, ...]
    """Why a tile has no strain, or the empty string."""

    def gradient(self, sums: Floats) -> tuple[Floats, Floats]:
        """Displacement gradient (T, S, 2, 2) and mean displacement (T, S, 2) in the tissue's axes, from the weighted
        sums (T, 3 S, 2) of the coefficients; NaN where there is no strain."""
        each = sums.reshape(len(sums), -1, 3, 2).astype(float)
        each[:, [bool(why) for why in self.reason]] = np.nan
        return self.turn @ np.swapaxes(each[:, :, :2], 2, 3), each[:, :, 2] @ self.turn.T


def weigh_tiles(field: Field, tiling: Tiling, tissue: Bools) -> TileWeights:
    """Find the weights of each tile's strain, by least squares over a lattice of points in its tissue."""
    tiles = len(tiling.boxes)
    weights = np.zeros((tiles, 3, field.coefficients.shape[2] * field.coefficients.shape[3]))
    number, reason = np.zeros(tiles, int), [""] * tiles
    lattices = [_lattice(box) for box in tiling.boxes]
    everywhere = inside_tissue(to_image(np.concatenate(lattices), tiling.center, tiling.direction), tissue)
    parts = np.split(everywhere, np.cumsum([len(points) for points in lattices])[:-1])
    for s, (points, inside) in enumerate(zip(lattices, parts, strict=True)):
        image = to_image(points, tiling.center, tiling.direction)
        number[s] = inside.sum()
        if inside.mean() < MIN_TISSUE:
            reason[s] = f"{inside.mean():.0%} of it is tissue, needs {MIN_TISSUE:.0%}"
            continue
        basis = field.basis(image[inside])
        texture = field.texture_at(image[inside])
        if texture < MIN_TEXTURE:
            reason[s] = f"its texture is {texture:.1%} of the tissue's, needs {MIN_TEXTURE:.0%}"
            continue
        dX = points[inside] - points[inside].mean(axis=0)
        weights[s, :2] = basis.T.dot(np.linalg.solve(dX.T @ dX, dX.T).T).T
        weights[s, 2] = np.asarray(basis.mean(axis=0))
    return TileWeights(weights.reshape(3 * tiles, -1), rotation(tiling.direction), number, tuple(reason))


def _lattice(box: Floats) -> Floats:
    """Points (P, 2) that fill a tile evenly."""
    r0, r1, c0, c1 = box
    rows, cols = (np.arange(a + 0.5 * LATTICE_PX, b, LATTICE_PX) for a, b in ((r0, r1), (c0, c1)))
    return np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)


def _rests(beats: Beats) -> list[tuple[Bools, Floats]]:
    """Frames (T,) of each beat, or nearest to it, and the weights (T,) of the frames that give its relaxed state."""
    relaxed = beats.relaxed
    if len(beats) == 0:
        return [(np.ones(len(relaxed), bool), relaxed / max(int(relaxed.sum()), 1))]
    nearest = beats.nearest_beat
    return [(nearest == b, weights) for b, weights in enumerate(rest_weights(relaxed, beats.peak))]


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
