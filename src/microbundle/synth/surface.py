"""Motion of the upper surface as a smooth field: the truth that a movie is drawn from and scored against.

A P2 displacement is continuous, but its gradient jumps from element to element. A truth with jumps has strains that
no image can show, and a score against it would measure the mesh. So by definition the true motion is a bicubic
spline on a regular grid, whose gradient is smooth and exact: the L2 projection of the P2 field on the upper surface,
plus a small penalty on its second derivatives, which continues the field smoothly (nearly linearly) around the
tissue. Where the tissue meets a pillar its strain really jumps; the spline spreads that jump over about one grid
step. `gap_um` and `gap_F` say how far spline and finite elements are apart.

In time, displacement is a cubic spline in the activation through the solved levels. Both splines are linear in the
nodal values, so a frame is a weighted sum of coefficients, then an evaluation in space. Gradients go through a sparse
matrix that is kept for the last set of points.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage, sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from ..data import Floats, Ints
from ..errors import CannotMeasure

MARGIN = 8
"""Grid steps that the spline reaches beyond the tissue; further out the displacement stays what it is there."""

SMOOTHING = 1e-4
"""Weight of the squared second derivatives (in units of the grid step) beside the squared misfit."""


@dataclass(frozen=True)
class SplineGrid:
    """A regular grid of cubic B-splines over (row, col)."""

    low_um: Floats
    """(2,): where the first cell starts."""
    step_um: float
    cells: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of coefficients."""
        return self.cells[0] + 3, self.cells[1] + 3

    @classmethod
    def around(cls, point_um: Floats, step_um: float) -> SplineGrid:
        """Cover points (N, 2) and a margin."""
        low = point_um.min(axis=0) - MARGIN * step_um
        cells = np.ceil((point_um.max(axis=0) + MARGIN * step_um - low) / step_um).astype(int)
        return cls(low, step_um, (int(cells[0]), int(cells[1])))

    def operator(self, point_um: Floats, derivative: tuple[int, int] = (0, 0)) -> sparse.csr_array:
        """Give the matrix (N, coefficients) that evaluates a derivative (per um) at points (N, 2)."""
        t = (point_um - self.low_um) / self.step_um
        cell = np.clip(np.floor(t), 0, np.array(self.cells) - 1).astype(np.int32)
        s = np.clip(t - cell, 0.0, 1.0)
        wr, wc = (_weights(s[:, k], derivative[k]) / self.step_um ** derivative[k] for k in (0, 1))
        for k, w in ((0, wr), (1, wc)):
            if derivative[k]:
                w[(t[:, k] < 0) | (t[:, k] > self.cells[k])] = 0.0               # constant beyond the grid
        columns = ((cell[:, :1] + np.arange(4, dtype=np.int32)) * np.int32(self.shape[1]))[:, :, None] + (
            cell[:, 1:] + np.arange(4, dtype=np.int32))[:, None, :]
        data = wr[:, :, None] * wc[:, None, :]
        starts = np.arange(0, 16 * len(point_um) + 1, 16, dtype=np.int32)
        return sparse.csr_array((data.ravel(), columns.ravel(), starts),
                                shape=(len(point_um), self.shape[0] * self.shape[1]))

    def value(self, coefficient: Floats, point_um: Floats) -> Floats:
        """Evaluate one spline (coefficients,) at points (N, 2): the same as `operator`, faster for points seen once."""
        t = np.clip((point_um - self.low_um) / self.step_um, 0, self.cells) + 1.0
        return np.asarray(ndimage.map_coordinates(coefficient.reshape(self.shape), t.T, order=3, prefilter=False,
                                                  mode="nearest"))

    def roughness(self) -> sparse.csr_array:
        """Give the matrix of the integral of squared second derivatives, by the midpoint rule, in grid steps."""
        r, c = np.meshgrid(*(np.arange(0.25, n, 0.5) for n in self.cells), indexing="ij")
        at = self.low_um + self.step_um * np.stack([r.ravel(), c.ravel()], axis=1)
        total = sparse.csr_array((self.shape[0] * self.shape[1],) * 2)
        for derivative, weight in (((2, 0), 1.0), ((1, 1), 2.0), ((0, 2), 1.0)):
            D = self.operator(at, derivative) * self.step_um**2
            total = total + (D.T @ D) * (weight / 4)
        return total


def _weights(s: Floats, derivative: int) -> Floats:
    """The four cubic B-splines (N, 4) that are not zero at s in [0, 1] of a cell, or their derivative."""
    w: tuple[Floats, ...]
    if derivative == 0:
        w = ((1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3)
    elif derivative == 1:
        w = (-3 * (1 - s) ** 2, 9 * s**2 - 12 * s, -9 * s**2 + 6 * s + 3, 3 * s**2)
    else:
        w = (6 * (1 - s), 18 * s - 12, 6 - 18 * s, 6 * s)
    return np.stack(w, axis=1) / 6


@dataclass(frozen=True)
class SmoothSurface:
    """Spline coefficients of the upper surface's in-plane displacement at each solved activation."""

    grid: SplineGrid
    coefficient_um: Floats
    """(K, coefficients, 2)"""
    gap_um: float
    """Largest distance between spline and finite elements at the sample points, over all levels."""
    gap_rms_um: float
    gap_F: float
    """Root mean square difference of the in-plane deformation gradient (all four entries) at the highest level."""
    jump_F: float
    """For comparison: root mean square jump of the finite elements' own gradient across the surface's inner edges."""


def fit_surface(point_um: Floats, six: Ints, displacement_um: Floats, step_um: float) -> SmoothSurface:
    """Project P2 displacements on a bicubic spline.

    `point_um` (n, 2) are the rest positions, `six` (S, 6) the nodes of the upper triangles (three corners, then the
    middles of sides 01, 12, 20), `displacement_um` (K, n, 2 or more) the levels.
    """
    bary = _samples()
    shape, slope = p2_shapes(bary)
    corner = point_um[six[:, :3]]
    at = (bary @ corner).reshape(-1, 2)                                             # (S q, 2)
    edges = np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2)                        # dX/d(l1, l2)
    area = np.abs(np.linalg.det(edges)) / 2
    u = displacement_um[..., :2][:, six]                                            # (K, S, 6, 2)
    value = (shape @ u).reshape(len(u), -1, 2)

    grid = SplineGrid.around(point_um[np.unique(six)], step_um)
    W = grid.operator(at)
    weight = np.repeat(area, len(bary)) / len(bary) / step_um**2
    matrix = sparse.csc_array((W.T * weight) @ W + SMOOTHING * grid.roughness())
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    right = np.concatenate([(W.T * weight) @ v for v in value], axis=1)             # (coefficients, 2 K)
    coefficient = factors.solve(right).reshape(right.shape[0], len(u), 2).transpose(1, 0, 2)

    miss = np.stack([W @ c for c in coefficient]) - value
    distance = np.hypot(miss[..., 0], miss[..., 1])
    G = slope @ np.linalg.inv(edges)[:, None]                                       # (S, q, 6, 2)
    F_fe = np.einsum("sai,sqaj->sqij", u[-1], G).reshape(-1, 2, 2)
    F_spline = np.stack([grid.operator(at, k) @ coefficient[-1] for k in ((1, 0), (0, 1))], axis=-1)
    return SmoothSurface(grid, coefficient, float(distance.max()), float(np.sqrt((distance[-1] ** 2).mean())),
                         float(np.sqrt(((F_spline - F_fe) ** 2).sum(axis=(1, 2)).mean())),
                         _jump(point_um, six, u[-1]))


def p2_shapes(bary: Floats) -> tuple[Floats, Floats]:
    """Evaluate the six quadratic shape functions at barycentric points (q, 3): values (q, 6), slopes (q, 6, 2).

    The slopes are along the second and the third barycentric coordinate.
    """
    l0, l1, l2 = bary.T
    value = np.stack([l0 * (2 * l0 - 1), l1 * (2 * l1 - 1), l2 * (2 * l2 - 1),
                      4 * l0 * l1, 4 * l1 * l2, 4 * l2 * l0], axis=1)
    zero = np.zeros_like(l0)
    d1 = np.stack([1 - 4 * l0, 4 * l1 - 1, zero, 4 * (l0 - l1), 4 * l2, -4 * l2], 1)
    d2 = np.stack([1 - 4 * l0, zero, 4 * l2 - 1, -4 * l1, 4 * l1, 4 * (l0 - l2)], 1)
    return value, np.stack([d1, d2], axis=-1)


def with_middles(point_um: Floats, triangle: Ints) -> Ints:
    """Find the P2 nodes (S, 6) of triangles (S, 3): their corners and the nodes at the middle of their sides."""
    pairs = triangle[:, [[0, 1], [1, 2], [2, 0]]]
    middle = point_um[pairs].mean(axis=2)
    gap, node = cKDTree(point_um).query(middle)
    if np.max(gap) > 1e-6 * np.ptp(point_um):
        raise ValueError("with_middles: the points hold no node at the middle of some side")
    return np.hstack([triangle, node])


def _samples() -> Floats:
    """Middles of the 16 equal parts of a triangle, as barycentric coordinates."""
    n, out = 4, []
    for i in range(n):
        for j in range(n - i):
            out.append(((i + 1 / 3) / n, (j + 1 / 3) / n))
            if i + j < n - 1:
                out.append(((i + 2 / 3) / n, (j + 2 / 3) / n))
    ij = np.array(out)
    return np.column_stack([1 - ij.sum(axis=1), ij])


def _jump(point_um: Floats, six: Ints, u: Floats) -> float:
    """Root mean square jump of the P2 gradient over the middles of the edges that two triangles share."""
    bary = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]])
    slope = p2_shapes(bary)[1]
    corner = point_um[six[:, :3]]
    G = slope @ np.linalg.inv(np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2))[:, None]
    F = np.einsum("sai,sqaj->sqij", u, G).reshape(-1, 4)
    edge, owner, count = np.unique(six[:, 3:].ravel(), return_inverse=True, return_counts=True)
    order = np.argsort(owner, kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]])[count == 2]
    jump = F[order[first]] - F[order[first + 1]]
    return float(np.sqrt((jump**2).sum(axis=1).mean())) if len(edge) else 0.0


@dataclass(frozen=True)
class SurfaceMotion:
    """True motion of a tissue's upper surface in the pixels and frames of a movie.

    Displacement is measured from the unloaded state (activation 0), forward: it belongs to the material point that
    rests at `points_px`. Vectors and tensors are in the order (row, col).
    """

    surface: SmoothSurface
    levels: Floats
    """(K,): solved activations."""
    activation: Floats
    """(T,)"""
    um_per_px: float
    origin_px: tuple[float, float] = (0.0, 0.0)
    """Pixel (row, col) at which the tissue's coordinates are (0, 0) um."""
    _weights: Floats = field(init=False, repr=False)
    _kept: list[tuple[Floats, sparse.csr_array]] = field(init=False, repr=False, default_factory=list)

    def __post_init__(self) -> None:
        low, high = float(self.activation.min()), float(self.activation.max())
        if low < self.levels[0] - 1e-12 or high > self.levels[-1] + 1e-12:
            raise CannotMeasure(f"tissue motion: the activation runs from {low:.4f} to {high:.4f}, but the tissue was "
                                f"solved from {self.levels[0]:.4f} to {self.levels[-1]:.4f}. Solve it at more levels.")
        weights = CubicSpline(self.levels, np.eye(len(self.levels)))(self.activation)
        object.__setattr__(self, "_weights", np.asarray(weights))

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.activation)

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """Give the displacement (N, 2) in pixels, from the unloaded state to `frame`, of material points (N, 2)."""
        at = self._um(points_px)
        return np.stack([self.surface.grid.value(c, at) for c in self._coefficients(frame).T], 1) / self.um_per_px

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """Give the in-plane deformation gradient F = I + du/dX (N, 2, 2) of material points (N, 2)."""
        at = self._um(points_px)
        if not self._kept or not np.array_equal(self._kept[0][0], at):
            grid = self.surface.grid
            matrix = sparse.vstack([grid.operator(at, d) for d in ((1, 0), (0, 1))])
            self._kept[:] = [(at, sparse.csr_array(matrix))]
        slopes = (self._kept[0][1] @ self._coefficients(frame)).reshape(2, -1, 2)
        return np.asarray(np.eye(2) + slopes.transpose(1, 2, 0))

    def _coefficients(self, frame: int) -> Floats:
        if not 0 <= frame < self.count:
            raise IndexError(f"frame {frame}: the motion has frames 0 to {self.count - 1}")
        return np.asarray(np.tensordot(self._weights[frame], self.surface.coefficient_um, axes=1))

    def _um(self, points_px: Floats) -> Floats:
        points = np.asarray(points_px, float)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"points_px: expected shape (N, 2), found {points.shape}")
        return np.asarray((points - np.asarray(self.origin_px)) * self.um_per_px)
