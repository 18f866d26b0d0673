"""Displacement at any point, from displacements at scattered markers.

`local` fits a plane to the 16 markers around each point, near ones counting more (moving least squares; P. Lancaster
and K. Salkauskas, Math. Comput. 37, 1981): it averages noise, and is exact for a uniform strain. `thin_plate` is the
paper's interpolation, a thin-plate spline through every marker; one factorisation serves all frames.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from .data import Bools, Floats, known

AROUND = 16
CLOSE_PX = 3
"""Holes and gaps of the mask up to twice this width count as tissue."""
FRAMES_AT_ONCE = 500


def interpolate(markers_px: Floats, displacement_px: Floats, points_px: Floats, *,
                method: Literal["local", "thin_plate"] = "local", tissue: Bools | None = None) -> Floats:
    """Interpolate displacements (T, N, 2) of markers (N, 2) at points (P, 2): (T, P, 2), all (row, col) in px.

    Where `tissue` (R, C) is given, points outside it are NaN. Markers that are missing in a frame (NaN) are filled
    from their neighbours. Raises ValueError for fewer than three usable markers.
    """
    points = np.atleast_2d(np.asarray(points_px, float))
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"points_px: expected shape (points, 2) in the order (row, col), found {np.shape(points_px)}")
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
