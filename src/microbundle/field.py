"""Displacement at any point, from a spline on knots or from displacements at scattered markers.

The accurate method measures a `Field`, a cubic B-spline that covers the tissue. Scattered markers are interpolated:

`local` fits a plane to the 16 markers around each point, near ones counting more (moving least squares; P. Lancaster
and K. Salkauskas, Math. Comput. 37, 1981): it averages noise, and is exact for a uniform strain. `thin_plate` is the
paper's interpolation, a thin-plate spline through every marker; one factorisation serves all frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from .data import Bools, Floats, known

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from .draws import Draws

AROUND = 16
TEXTURE_CELL_PX = 4
CLOSE_PX = 3
"""Holes and gaps of the mask up to twice this width count as tissue."""
FRAMES_AT_ONCE = 200


@dataclass(frozen=True)
class Field:
    """Displacement of the tissue from the reference frame to every frame, as a cubic B-spline."""

    coefficients: Floats
    """(T, 2, K, L): component, knot row, knot column; in px."""
    origin_px: Floats
    """Image position (2,) of the corner of the first cell of knots."""
    spacing_px: float
    """Distance between knots."""
    texture: Floats
    """(A, B): how much texture there is in cells of 4 px from `origin_px` on, the mean squared slope of the grey value
    in any unit, NaN outside the tissue."""
    draws: Draws | None = None
    """What the displacement may be wrong by."""

    def basis(self, points_px: Floats) -> csr_matrix:
        """Weights (P, K L) of the knots at image points (P, 2) of the reference frame."""
        return spline_basis((np.asarray(points_px, float) - self.origin_px) / self.spacing_px,
                            self.coefficients.shape[2], self.coefficients.shape[3])

    def at(self, points_px: Floats) -> Floats:
        """Displacement (T, P, 2) in px of image points (P, 2) of the reference frame."""
        return self.weighted(self.basis(points_px))

    def from_rest(self, points_px: Floats, relaxed: Bools) -> Floats:
        """Displacement (T, P, 2) in px of points (P, 2) of the relaxed image, from the mean of the frames (T,) in
        which the tissue rests."""
        points = np.asarray(points_px, float)
        rest = self.at(points)[relaxed].mean(axis=0)
        moved = self.at(points - rest)  # the reference frame is itself only nearly at rest
        moved -= moved[relaxed].mean(axis=0)
        return moved

    def texture_at(self, points_px: Floats) -> float:
        """Mean texture around points (P, 2), as a share of the tissue's median."""
        cell = ((np.asarray(points_px, float) - self.origin_px) // TEXTURE_CELL_PX).astype(int)
        cell = np.clip(cell, 0, np.array(self.texture.shape) - 1)
        here, usual = self.texture[tuple(cell.T)], float(np.nanmedian(self.texture))
        here = here[np.isfinite(here)]
        return float(here.mean() / usual) if len(here) and usual > 0 else 0.0

    def weighted(self, weights: csr_matrix | Floats) -> Floats:
        """Weighted sums (T, P, 2) of the coefficients, for weights (P, K L)."""
        count = len(self.coefficients)
        out = np.empty((count, weights.shape[0], 2), np.float32)
        for first in range(0, count, FRAMES_AT_ONCE):  # so that memory does not grow with the frames
            part = self.coefficients[first:first + FRAMES_AT_ONCE]
            sums = weights @ part.reshape(2 * len(part), -1).T
            out[first:first + len(part)] = sums.T.reshape(len(part), 2, -1).transpose(0, 2, 1)
        return out


def spline_basis(place: Floats, rows: int, cols: int) -> csr_matrix:
    """Cubic B-splines of `rows` x `cols` knots at places (P, 2) counted in cells: (P, rows cols); beyond the knots the
    outermost cell's polynomial goes on for half a cell and then stays."""
    from scipy.sparse import csr_matrix

    cell = np.clip(np.floor(place).astype(int), 0, [rows - 4, cols - 4])
    f = np.clip(place - cell, -0.5, 1.5)
    weight = [np.stack([(1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3], axis=1) / 6
              for t in (f[:, 0], f[:, 1])]
    a, b = (i.ravel() for i in np.meshgrid(range(4), range(4), indexing="ij"))
    values = weight[0][:, a] * weight[1][:, b]
    index = (cell[:, :1] + a) * cols + cell[:, 1:] + b
    return csr_matrix((values.ravel(), (np.repeat(np.arange(len(place)), 16), index.ravel())),
                      shape=(len(place), rows * cols))


def interpolate(markers_px: Floats, displacement_px: Floats, points_px: Floats, *,
                method: Literal["local", "thin_plate"] = "local", tissue: Bools | None = None) -> Floats:
    """Interpolate displacements (T, N, 2) of markers (N, 2) at points (P, 2): (T, P, 2), all (row, col) in px.

    Where `tissue` (R, C) is given, points outside it are NaN. Markers that are missing in a frame (NaN) are filled
    from their neighbours. Raises ValueError for fewer than three usable markers.
    """
    points = checked_points(points_px)
    usable = np.asarray((known(displacement_px).mean(axis=0) >= 0.5) & known(markers_px))
    if usable.sum() < 3:
        raise ValueError(f"expected at least 3 markers with displacements; found {int(usable.sum())}")
    markers, moved = markers_px[usable].astype(float), filled(markers_px[usable], displacement_px[:, usable])
    out = np.full((len(moved), len(points), 2), np.nan, np.float32)
    inside = known(points) if tissue is None else inside_tissue(points, tissue)
    if inside.any():
        spread = _local if method == "local" else _thin_plate
        out[:, inside] = spread(markers, moved, points[inside])
    return out


def checked_points(points_px: Floats) -> Floats:
    """Take points as an array (P, 2); raises ValueError for another shape."""
    points = np.atleast_2d(np.asarray(points_px, float))
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"points_px: expected shape (points, 2) in the order (row, col), found {np.shape(points_px)}")
    return points


def inside_tissue(points_px: Floats, tissue: Bools) -> Bools:
    """Tell which points (P, 2) lie in the tissue (R, C), its small holes included: (P,)."""
    from scipy.ndimage import binary_closing

    closed = np.pad(tissue, 2 * CLOSE_PX)
    closed = binary_closing(closed, iterations=CLOSE_PX)[2 * CLOSE_PX:-2 * CLOSE_PX, 2 * CLOSE_PX:-2 * CLOSE_PX]
    row, col = np.rint(np.where(known(points_px)[:, None], points_px, -1)).astype(int).T
    within = (row >= 0) & (col >= 0) & (row < tissue.shape[0]) & (col < tissue.shape[1])
    return np.asarray(within & closed[np.where(within, row, 0), np.where(within, col, 0)])


def filled(markers_px: Floats, displacement_px: Floats) -> Floats:
    """Fill missing displacements (T, N, 2) with the mean of the nearest markers that are known in that frame."""
    from scipy.spatial import cKDTree

    missing = ~known(displacement_px)
    if not missing.any():
        return displacement_px
    out = displacement_px.copy()
    for t in np.flatnonzero(missing.any(axis=1)):
        lost = missing[t]
        if lost.all():
            continue
        near = min(AROUND, int((~lost).sum()))
        _, index = cKDTree(markers_px[~lost]).query(markers_px[lost], k=range(1, near + 1))
        out[t, lost] = displacement_px[t, ~lost][index].mean(axis=1)
    return out


def _local(markers: Floats, moved: Floats, points: Floats) -> Floats:
    weights, index = local_weights(markers, points)
    return np.stack([np.einsum("pk,pkd->pd", weights, u[index]) for u in moved])


def local_weights(markers: Floats, points: Floats) -> tuple[Floats, np.ndarray]:
    """Weights (P, K) and indices (P, K) of the markers whose plane fit gives the value at each point."""
    from scipy.spatial import cKDTree

    near = min(AROUND, len(markers))
    distance, index = map(np.asarray, cKDTree(markers).query(points, k=range(1, near + 1)))
    width = 0.6 * distance[:, -1:] + 1e-9
    weight = np.exp(-0.5 * (distance / width) ** 2)
    offset = (markers[index] - points[:, None]) / width[..., None]
    basis = np.concatenate([np.ones((*distance.shape, 1)), offset], axis=2)
    normal = np.einsum("pk,pki,pkj->pij", weight, basis, basis)
    # Collinear neighbours leave the slope across them open; a small ridge on the slopes settles it.
    normal[:, [1, 2], [1, 2]] += 1e-6 * weight.sum(axis=1)[:, None]
    first = np.linalg.solve(normal, np.broadcast_to(np.array([[1.0], [0.0], [0.0]]), (len(points), 3, 1)))[..., 0]
    return np.asarray(weight * np.einsum("pki,pi->pk", basis, first), np.float32), index


def _thin_plate(markers: Floats, moved: Floats, points: Floats) -> Floats:
    from scipy.interpolate import RBFInterpolator

    out = np.empty((len(moved), len(points), 2))
    for first in range(0, len(moved), FRAMES_AT_ONCE):
        part = moved[first:first + FRAMES_AT_ONCE].astype(float)
        columns = np.moveaxis(part, 0, 1).reshape(len(markers), -1)
        values = RBFInterpolator(markers, columns, kernel="thin_plate_spline", degree=1)(points)
        out[first:first + len(part)] = np.moveaxis(values.reshape(len(points), len(part), 2), 0, 1)
    return out
