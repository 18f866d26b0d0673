"""Register a picture against a template: a cubic B-spline displacement, found by Gauss-Newton with a fixed gradient.

Minimised over the displacement u(X) = sum of c_k B_k(X) and six brightness parameters is the sum of squares of
g(X + u) - model(f(X)) over the mask, plus a bending energy of u. The template's gradient stands in for that of the
picture, so the matrix is the same for every picture and iteration: it is put together once, as a band, and factorised
once (Cholesky). Source: D. Rueckert et al., IEEE Trans. Med. Imaging 18, 1999 (free-form deformation); S. Baker and
I. Matthews, Int. J. Comput. Vis. 56, 2004 (constant gradient).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.linalg.lapack import spbtrs

from . import bspline
from .bspline import Float32, Runs
from .data import Bools, Floats
from .field import spline_basis

if TYPE_CHECKING:
    from collections.abc import Sequence

    from scipy.sparse import csr_matrix

BENDING = 1e-2
"""Weight of the bending energy, as a share of the mean diagonal of the matrix."""
LONGEST_STEP_PX = 1.0
"""The step of a knot is cut to this, for the gradient says nothing of what lies beyond a grain of the texture."""
GLINT = 5.0
"""Residuals beyond this many times their root mean square are cut off: a glint or a hot pixel, not tissue."""
SLOWEST = 0.5
"""A step is at most this share of the one before, where two steps have not told better."""
BRIGHTNESS = 6
"""Gain and offset, each constant, along row and along col."""


class Knots:
    """Knots of a cubic B-spline over a mask (R, C), `spacing` pixels apart, the first cell starting at pixel `lead`.

    They reach `reach` pixels beyond the mask at its lower and right ends; nothing may be sampled beyond the knots.
    """

    def __init__(self, mask: Bools, lead: int, spacing: int, reach: int = 0) -> None:
        self.runs = Runs.of(mask)
        self.lead, self.spacing = lead, spacing
        self.table = bspline.knot_weights(spacing)
        self.rows = int((self.runs.row.max() + reach - lead) // spacing) + 4
        self.cols = int((self.runs.stop.max() - 1 + reach - lead) // spacing) + 4
        self.count = 2 * self.rows * self.cols

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the coefficients: component, knot row, knot column."""
        return 2, self.rows, self.cols

    def flat(self, p: Any) -> Any:
        """Bring coefficients (..., 2, K, L) into the order of the unknowns (..., n): column by column of knots."""
        return np.ascontiguousarray(np.swapaxes(p, -1, -3)).reshape(*p.shape[:-3], self.count)

    def grid(self, v: Any) -> Any:
        """The inverse of `flat`."""
        return np.swapaxes(v.reshape(*v.shape[:-1], self.cols, self.rows, 2), -1, -3)

    def bending(self) -> csr_matrix:
        """Matrix (n, n) of the bending energy: squared second differences of neighbouring coefficients."""
        def difference(order: int, n: int) -> Any:
            steps = {1: [-1.0, 1.0], 2: [1.0, -2.0, 1.0]}[order]
            return sparse.diags(steps, range(order + 1), shape=(n - order, n))

        def square(order: int, n: int) -> Any:
            d = difference(order, n)
            return d.T @ d

        one = sparse.identity
        energy = (sparse.kron(one(self.cols), square(2, self.rows)) + sparse.kron(square(2, self.cols), one(self.rows))
                  + 2 * sparse.kron(square(1, self.cols), square(1, self.rows)))
        return sparse.csr_matrix(sparse.kron(energy, one(2)))

    def basis(self, points: Floats) -> csr_matrix:
        """Values of the B-splines at points (P, 2) of the picture: (P, K L)."""
        return spline_basis((np.asarray(points, float) - self.lead) / self.spacing, self.rows, self.cols)


@dataclass(frozen=True)
class Fit:
    """A picture registered against a template."""

    p: Float32
    """Coefficients (2, K, L)."""
    bright: Floats
    """(6,)"""
    rms: float
    """Root mean square of the residual."""
    iterations: int


class Template:
    """A relaxed picture, its gradient on the mask, and the factorised matrix for registering others against it.

    With `even_light`, brightness may change only for the whole picture at once.
    """

    def __init__(self, knots: Knots, coefficients: Float32, bending: float = BENDING, *,
                 even_light: bool = False) -> None:
        runs = knots.runs
        self.knots = knots
        self.f, self.gr, self.gc = (np.empty(runs.count, np.float32) for _ in range(3))
        still = np.zeros(knots.shape, np.float32)
        bspline.pull_back(coefficients, *runs.arrays, knots.table, knots.lead, still, self.f)
        bspline.slopes(coefficients, *runs.arrays, self.gr, self.gc)
        row, col = runs.pixels()
        extent = [2.0 / max(int(a.max() - a.min()), 1) for a in (row, col)]
        self.scale = np.array([self.f.mean(), row.mean(), extent[0], col.mean(), extent[1]], np.float32)
        band = np.zeros((2 * (3 * knots.rows + 4), knots.count))
        border, small = np.zeros((knots.count, BRIGHTNESS)), np.zeros((BRIGHTNESS, BRIGHTNESS))
        bspline.normal_matrix(*runs.arrays, knots.table, knots.lead, self.gr, self.gc, self.f, self.scale, band,
                              knots.rows, border, small)
        mean = float(band[0].mean())
        self.penalty = bending * mean * knots.bending()
        lower = sparse.tril(self.penalty).tocoo()
        band[lower.row - lower.col, lower.col] += lower.data
        band[0] += 1e-9 * mean  # knots far from the mask, where even the bending energy leaves a plane free
        factor = cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False)
        self.border = cho_solve_banded((factor, True), border, check_finite=False)
        hold = 1e6 if even_light else 1e-12  # of brightness that changes across the picture
        held = np.trace(small) * np.array([1e-12, hold, hold, 1e-12, hold, hold])
        self.schur = np.linalg.inv(small - border.T @ self.border + np.diag(held))
        self.factor = factor.astype(np.float32)

    def solve(self, right: Floats) -> Floats:
        """Solve with the factorised matrix for right-hand sides (n, m), to the precision of float32."""
        return np.asarray(spbtrs(self.factor, np.asarray(right, np.float32, order="F"), lower=1)[0])

    def contraction_size(self, direction: Floats) -> float:
        """Size, in the metric of the matrix, of an even shortening along `direction` (2,) by 1 px on average."""
        row, col = self.knots.runs.pixels()
        along = (row - row.mean()) * direction[0] + (col - col.mean()) * direction[1]
        change = along * (self.gr * direction[0] + self.gc * direction[1])
        return float(max(np.sqrt((change**2).sum()), 1e-12) / max(np.abs(along).mean(), 1e-12))

    def fit(self, pictures: Sequence[Float32], starts: Sequence[Float32], brights: Sequence[Floats], iterations: int,
            tolerance_px: float = 1e-4) -> list[Fit]:
        """Register several pictures (B-spline coefficients) at once, so that one pass over the factor serves all.

        Ends where no knot would move by more than `tolerance_px` in the next step.
        """
        knots, m = self.knots, len(pictures)
        p = [np.array(s, np.float32) for s in starts]
        b = [np.array(s, float) for s in brights]
        residual = np.empty(knots.runs.count, np.float32)
        squares, right, small = np.zeros(m), np.zeros((knots.count, m), order="F"), np.zeros((BRIGHTNESS, m))
        part = np.empty(knots.shape, np.float32)
        active = np.ones(m, bool)
        limit = np.full(m, np.float32(np.finfo(np.float32).max))
        used, before = np.zeros(m, int), np.zeros(m)
        for _ in range(iterations):
            for i in np.flatnonzero(active).tolist():
                squares[i] = bspline.sweep(pictures[i], *knots.runs.arrays, knots.table, knots.lead, p[i], self.f,
                                           self.gr, self.gc, self.scale, b[i].astype(np.float32), limit[i], residual,
                                           part, small[:, i])
                limit[i] = GLINT * np.sqrt(squares[i] / knots.runs.count)
                flat = knots.flat(p[i]).astype(float)
                right[:, i] = knots.flat(part) + self.penalty @ flat
                used[i] += 1
            now = np.flatnonzero(active)
            bright_step = self.schur @ (small[:, now] - self.border.T @ right[:, now])
            step = self.solve(right[:, now]) - self.border @ bright_step
            for j, i in enumerate(now.tolist()):
                largest = float(np.abs(step[:, j]).max())
                if not np.isfinite(largest):  # no texture at all: stay, and let the residual tell
                    active[i] = False
                    continue
                p[i] -= np.clip(knots.grid(step[:, j]), -LONGEST_STEP_PX, LONGEST_STEP_PX).astype(np.float32)
                b[i] -= bright_step[:, j]
                # Steps shrink by nearly the same share each time, which foretells the next one.
                active[i] = largest * min(largest / max(before[i], 1e-12), SLOWEST) > tolerance_px
                before[i] = largest
            if not active.any():
                break
        rms = np.sqrt(squares / knots.runs.count)
        return [Fit(p[i], b[i], float(rms[i]), int(used[i])) for i in range(m)]

    def residual(self, picture: Float32, fit: Fit) -> Float32:
        """Residual (P,) of a registered picture."""
        knots = self.knots
        out = np.empty(knots.runs.count, np.float32)
        bspline.sweep(picture, *knots.runs.arrays, knots.table, knots.lead, fit.p, self.f, self.gr, self.gc, self.scale,
                      fit.bright.astype(np.float32), np.finfo(np.float32).max, out,
                      np.empty(knots.shape, np.float32), np.empty(BRIGHTNESS))
        return out


def finer(p: Float32, shape: tuple[int, int, int]) -> Float32:
    """Carry coefficients (2, K, L) to knots half as far apart of a picture twice as large, exactly (two-scale
    relation of cubic B-splines); displacements double with the pixels."""
    for axis in (1, 2):
        n = p.shape[axis]
        up = np.zeros((*p.shape[:axis], 2 * n + 3, *p.shape[axis + 1:]), np.float32)
        at = [slice(None)] * 3
        for shift, weight in enumerate((1, 4, 6, 4, 1)):  # knot k goes to place 2 k + 1 of the padded row
            at[axis] = slice(shift, shift + 2 * n - 1, 2)
            up[tuple(at)] += np.float32(weight / 8) * p
        at[axis] = slice(3, 3 + shape[axis])
        p = up[tuple(at)]
        short = shape[axis] - p.shape[axis]
        if short > 0:
            p = np.pad(p, [(0, short if a == axis else 0) for a in range(3)], mode="edge")
    return np.float32(2) * p
