"""Make a mesh of a bundle: contour -> triangles -> prisms -> tetrahedra.

Triangles: points along the contour and the pillars' outlines and a hexagonal lattice between them, joined by
Delaunay's rule. A side of an outline is an edge of that triangulation when no other point lies in the circle on it
(Gabriel's condition), so sides are halved and lattice points dropped until that holds. Some rounds of moving every
free point to the mean of its neighbours make the triangles rounder.

Tetrahedra: the triangles are repeated over the layers, and each prism is cut in three along diagonals that run from
its lower-numbered lower corner to its higher-numbered upper one; two prisms then agree on the face they share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from ..data import Floats, Ints
from ..errors import ConfigError
from .outline import Bundle, inside, resample

TISSUE = 0
"""Region of a cell: 0 is tissue, k > 0 the k-th pillar."""

MIN_ANGLE_DEG = 12.0
"""A triangle with a sharper corner makes the mesh unusable (P2 elements lose accuracy slowly above this)."""


@dataclass(frozen=True)
class PlaneMesh:
    """Triangles of the tissue and the pillars' cross-sections, seen from above."""

    point_um: Floats
    """(V, 2)"""
    triangle: Ints
    """(M, 3)"""
    region: Ints
    """(M,): 0 for tissue, k for the k-th pillar."""

    @property
    def min_angle_deg(self) -> float:
        """Smallest corner of all triangles."""
        return float(np.degrees(_angles(self.point_um[self.triangle]).min()))


@dataclass(frozen=True)
class SolidMesh:
    """Tetrahedra of the tissue and its pillars; coordinates are (row, col, depth), depth 0 on top and growing down."""

    point_um: Floats
    """(V, 3)"""
    cell: Ints
    """(M, 4)"""
    region: Ints
    """(M,): 0 for tissue, k for the k-th pillar."""
    top: Ints
    """(S, 3): triangles of the upper surface, tissue and pillar heads."""
    top_region: Ints
    """(S,)"""


def triangulate(bundle: Bundle, spacing_um: float) -> PlaneMesh:
    """Cover a bundle with triangles of about `spacing_um` that respect its contour and its pillars' outlines.

    Raises ConfigError where a pillar does not lie inside the contour, two pillars overlap, or no triangles without
    sharp corners are found.
    """
    outline = resample(bundle.outline_um, spacing_um)
    rings = [pillar.polygon_um(spacing_um) for pillar in bundle.pillars]
    for k, ring in enumerate(rings):
        if not inside(ring, bundle.outline_um).all():
            raise ConfigError(f"pillar {k + 1} at {bundle.pillars[k].center_um} um does not lie inside the tissue's "
                              "contour. Move it inward, or make it smaller.")
        if any(inside(ring, other).any() for j, other in enumerate(rings) if j != k):
            raise ConfigError(f"pillar {k + 1} overlaps another one; place them apart.")
    fixed, side = _protected([outline, *rings])
    center = fixed[side].mean(axis=1)
    radius = np.hypot(*(fixed[side[:, 0]] - fixed[side[:, 1]]).T) / 2

    free = _lattice(outline, spacing_um)
    free = np.vstack([free, *[np.mean(ring, axis=0)[None] for ring in rings]])
    free = free[inside(free, outline)]
    points = fixed
    for _ in range(12):
        near, which = cKDTree(center).query(free)
        # the circle on each side stays empty (with some room), or the side would not be an edge
        free = free[near > 1.15 * radius[which]]
        local = np.minimum(spacing_um, 2 * radius[cKDTree(center).query(free)[1]])
        free = free[cKDTree(fixed).query(free)[0] > 0.6 * local]
        points = np.vstack([fixed, free])
        triangle = _clean(points, Delaunay(points).simplices, outline)
        free = _relaxed(points, triangle)[len(fixed):]
    near, which = cKDTree(center).query(free)
    points = np.vstack([fixed, free[near > radius[which]]])
    triangle = _clean(points, Delaunay(points).simplices, outline)

    used = np.unique(triangle)
    edge = {tuple(sorted(pair)) for t in triangle.tolist() for pair in ((t[0], t[1]), (t[1], t[2]), (t[0], t[2]))}
    missing = sum(tuple(sorted(s)) not in edge for s in side.tolist())
    region = np.zeros(len(triangle), int)
    middle = points[triangle].mean(axis=1)
    for k, ring in enumerate(rings):
        region[inside(middle, ring)] = k + 1
    mesh = PlaneMesh(points[used], np.searchsorted(used, triangle), region)
    if missing or mesh.min_angle_deg < MIN_ANGLE_DEG:
        raise ConfigError(f"no good mesh with triangles of {spacing_um:.0f} um: {missing} sides of the outlines are "
                          f"missing, the sharpest corner has {mesh.min_angle_deg:.0f} degrees (at least "
                          f"{MIN_ANGLE_DEG:.0f} wanted). Smooth the contour, move the pillars away from it, or refine.")
    return mesh


def extrude(plane: PlaneMesh, depth_um: Floats, shaft_depth_um: Sequence[Floats]) -> SolidMesh:
    """Repeat a plane mesh over depths and cut the prisms into tetrahedra.

    `depth_um` are the layers of tissue and pillar heads, from 0 down; `shaft_depth_um[k]` continues pillar k + 1 from
    the lower side of the tissue to its base.
    """
    count = len(plane.point_um)
    prism, region = [], []
    points = [np.column_stack([plane.point_um, np.full(count, z)]) for z in depth_um]
    corner = np.sort(plane.triangle, axis=1)
    for layer in range(len(depth_um) - 1):
        prism.append(np.hstack([corner + layer * count, corner + (layer + 1) * count]))
        region.append(plane.region)
    total = count * len(depth_um)
    for k, depths in enumerate(shaft_depth_um, start=1):
        mine = corner[plane.region == k]
        vertex = np.unique(mine)
        upper = np.full(count, -1)
        upper[vertex] = vertex + (len(depth_um) - 1) * count
        for z in depths[1:]:
            lower = np.full(count, -1)
            lower[vertex] = total + np.arange(len(vertex))
            points.append(np.column_stack([plane.point_um[vertex], np.full(len(vertex), z)]))
            prism.append(np.hstack([upper[mine], lower[mine]]))
            region.append(np.full(len(mine), k))
            total, upper = total + len(vertex), lower
    six = np.concatenate(prism)
    cell = six[:, [[0, 1, 2, 5], [0, 1, 4, 5], [0, 3, 4, 5]]].reshape(-1, 4)
    return SolidMesh(np.concatenate(points), cell, np.repeat(np.concatenate(region), 3), plane.triangle, plane.region)


def _protected(rings: Sequence[Floats]) -> tuple[Floats, Ints]:
    """Halve sides until the circle on each holds no other point; gives points (n, 2) and sides (n, 2)."""
    rings = list(rings)
    for _ in range(10):
        points = np.vstack(rings)
        tree = cKDTree(points)
        changed = False
        for k, ring in enumerate(rings):
            ahead = np.roll(ring, -1, axis=0)
            middle, radius = (ring + ahead) / 2, np.hypot(*(ahead - ring).T) / 2
            third = np.asarray(tree.query(middle, k=3)[0])[:, 2]           # the two nearest are at best its own ends
            split = third < 1.02 * radius
            if split.any():
                changed = True
                rings[k] = np.insert(ring, np.flatnonzero(split) + 1, middle[split], axis=0)
        if not changed:
            break
    else:
        raise ConfigError("the contour and the pillars' outlines come too close to each other for a mesh; "
                          "move the pillars inward, or smooth the contour.")
    start = np.cumsum([0, *[len(ring) for ring in rings]])
    side = np.vstack([np.stack([np.arange(len(ring)), np.roll(np.arange(len(ring)), -1)], axis=1) + s
                      for ring, s in zip(rings, start, strict=False)])
    return np.vstack(rings), side


def _lattice(outline: Floats, spacing_um: float) -> Floats:
    low, high = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(low[0], high[0], spacing_um * np.sqrt(3) / 2)
    cols = np.arange(low[1], high[1] + spacing_um, spacing_um)
    r, c = np.meshgrid(rows, cols, indexing="ij")
    c = c - np.where(np.arange(len(rows)) % 2, spacing_um / 2, 0.0)[:, None]
    return np.stack([r.ravel(), c.ravel()], axis=1)


def _clean(points: Floats, triangle: Ints, outline: Floats) -> Ints:
    corner = points[triangle]
    flat = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) < 1e-9 * np.ptp(points)**2
    return np.asarray(triangle[inside(corner.mean(axis=1), outline) & ~flat])


def _relaxed(points: Floats, triangle: Ints) -> Floats:
    """Move every point to the mean of its neighbours (the caller keeps only the free ones)."""
    i = triangle[:, [0, 1, 2, 1, 2, 0]].ravel()
    j = triangle[:, [1, 2, 0, 0, 1, 2]].ravel()
    weight = np.maximum(np.bincount(i, minlength=len(points)), 1)
    mean = np.stack([np.bincount(i, points[j, k], minlength=len(points)) / weight for k in (0, 1)], axis=1)
    return np.where(np.bincount(i, minlength=len(points))[:, None] > 0, mean, points)


def _angles(corner: Floats) -> Floats:
    a, b = np.roll(corner, -1, axis=1) - corner, np.roll(corner, 1, axis=1) - corner
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.asarray(np.arctan2(np.abs(cross), (a * b).sum(axis=-1)))
