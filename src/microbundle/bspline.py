"""Compiled kernels of the registration: B-spline interpolation of pictures, and one Gauss-Newton sweep over a mask.

Pictures are interpolated by quintic B-splines (M. Unser, IEEE Signal Process. Mag. 16, 1999); the displacement is a
cubic B-spline on knots that lie a whole number of pixels apart, so its weights come from a table and the basis is
never stored. A mask is a list of runs, pixels that follow one another in a row. All pictures are float32.

The kernels are compiled by numba at their first use and kept on disk; that takes about ten seconds once.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
POLES = (-0.43057534709997, -0.04309628820326)
"""Of the quintic B-spline's recursive prefilter."""
HORIZON = 14
"""Samples after which the larger pole's memory is below the resolution of float32."""

jit: Any = numba.njit(fastmath=True, nogil=True, cache=True, error_model="numpy")
inlined: Any = numba.njit(inline="always")
written: Any = intrinsic


@dataclass(frozen=True)
class Runs:
    """A mask (R, C) as runs: pixels first ... stop - 1 of a row, numbered from `start` on."""

    row: NDArray[np.int64]
    first: NDArray[np.int64]
    stop: NDArray[np.int64]
    start: NDArray[np.int64]
    count: int
    """Number of pixels P."""

    @classmethod
    def of(cls, mask: NDArray[np.bool_]) -> Runs:
        """List the runs of a mask, row by row."""
        edge = np.diff(np.pad(mask.astype(np.int8), ((0, 0), (1, 1))), axis=1)
        row, first = np.nonzero(edge == 1)
        stop = np.nonzero(edge == -1)[1]
        length = stop - first
        start = np.concatenate([[0], np.cumsum(length)[:-1]]) if len(length) else length
        return cls(row.astype(np.int64), first.astype(np.int64), stop.astype(np.int64), start.astype(np.int64),
                   int(length.sum()))

    @property
    def arrays(self) -> tuple[NDArray[np.int64], ...]:
        """What the kernels take."""
        return self.row, self.first, self.stop, self.start

    def pixels(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Row and column (P,) of each pixel."""
        length = self.stop - self.first
        return np.repeat(self.row, length), np.arange(self.count) - np.repeat(self.start - self.first, length)


def knot_weights(spacing: int) -> Float32:
    """Weights (spacing, 4) of the four knots around each pixel of a cell."""
    f = np.arange(spacing) / spacing
    return np.stack([(1 - f) ** 3, 4 - 6 * f**2 + 3 * f**3, 1 + 3 * f + 3 * f**2 - 3 * f**3, f**3], axis=1).astype(
        np.float32) / np.float32(6)


@jit
def prefilter(image: Float32) -> None:
    """Turn a picture (R, C) into its quintic B-spline coefficients, in place; it is mirrored at its edges."""
    rows, cols = image.shape
    one = np.float32(1)
    for pole in POLES:
        z = np.float32(pole)
        end = z / (z * z - one)
        gain = (one - z) * (one - one / z)
        gain *= gain  # of both directions, put in with the second
        for c in range(cols):
            total, power = image[0, c], z
            for k in range(1, min(rows, HORIZON)):
                total += power * image[k, c]
                power *= z
            image[0, c] = total
        for r in range(1, rows):
            for c in range(cols):
                image[r, c] += z * image[r - 1, c]
        for c in range(cols):
            image[rows - 1, c] = end * (image[rows - 1, c] + z * image[rows - 2, c])
        for r in range(rows - 2, -1, -1):
            for c in range(cols):
                image[r, c] = z * (image[r + 1, c] - image[r, c])
        for r0 in range(0, rows, 8):  # eight rows at once hide the latency of the recursion
            r1 = min(r0 + 8, rows)
            for r in range(r0, r1):
                total, power = image[r, 0], z
                for k in range(1, min(cols, HORIZON)):
                    total += power * image[r, k]
                    power *= z
                image[r, 0] = total
            for c in range(1, cols):
                for r in range(r0, r1):
                    image[r, c] += z * image[r, c - 1]
            for r in range(r0, r1):
                image[r, cols - 1] = end * gain * (image[r, cols - 1] + z * image[r, cols - 2])
            for c in range(cols - 2, -1, -1):
                for r in range(r0, r1):
                    image[r, c] = z * (image[r, c + 1] - gain * image[r, c])


def _taps() -> NDArray[np.float32]:
    """Weights of the six coefficients around a place, as polynomials (6, 8) of its fraction between two pixels; each
    row is a power, and two columns of zeros make it a vector of eight."""
    taps = np.zeros((6, 8))
    for k in range(6):
        for j in range(6 - k):
            powers = [comb(5, d) * float(5 - k - j) ** (5 - d) for d in range(6)]  # of (f + 5 - k - j)^5
            taps[:, k] += (-1) ** j * comb(6, j) * np.array(powers) / 120
    return taps.astype(np.float32)


@written
def spline_value(_typing: Any, flat: Any, _first: Any, _width: Any, _down: Any, _right: Any) -> Any:
    """Interpolate at the fractions (down, right) inside the six rows of six coefficients from flat[first] on.

    Written for vectors of eight, for a compiler finds no vectors here; of two more coefficients than it needs it reads
    whatever stands there.
    """
    f32, i32 = ir.FloatType(), ir.IntType(32)
    vector, order = ir.VectorType(f32, 8), ir.VectorType(i32, 8)
    blank, fast, taps = ir.Constant(vector, ir.Undefined), ("fast",), _taps().tolist()

    def codegen(context: Any, b: Any, signature: Any, args: Any) -> Any:
        def picked(v: Any, lanes: list[int]) -> Any:
            return b.shuffle_vector(v, blank, ir.Constant(order, lanes))

        def weights(fraction: Any) -> Any:
            f = picked(b.insert_element(blank, fraction, ir.Constant(i32, 0)), [0] * 8)
            total = ir.Constant(vector, taps[5])
            for power in taps[4::-1]:
                total = b.fadd(b.fmul(total, f, fast), ir.Constant(vector, power), fast)
            return total

        data = context.make_array(signature.args[0])(context, b, args[0]).data
        at, rows = args[1], weights(args[3])
        total = ir.Constant(vector, [0.0] * 8)
        for k in range(6):
            line = b.load(b.bitcast(b.gep(data, [at]), vector.as_pointer()), align=4)
            total = b.fadd(total, b.fmul(line, picked(rows, [k] * 8), fast), fast)
            at = b.add(at, args[2])
        total = b.fmul(total, weights(args[4]), fast)
        for half in (4, 2, 1):
            total = b.fadd(total, picked(total, [(lane + half) % 8 for lane in range(8)]), fast)
        return b.extract_element(total, ir.Constant(i32, 0))

    return types.float32(flat, types.int64, types.int64, types.float32, types.float32), codegen


@inlined
def _sample_run(flat, W, y, x, n, out):
    """Interpolate a picture's coefficients, W to a row, at n places (y, x) into out."""
    for i in range(n):
        iy, ix = np.int32(y[i]), np.int32(x[i])
        out[i] = spline_value(flat, np.int64(iy - 2) * W + (ix - 2), W, y[i] - np.float32(iy), x[i] - np.float32(ix))


@inlined
def _move_cells(p, table, h, lead, cell, c0, c1, moved):
    """Displacement p along one row of cells: what its four rows of knots add in columns c0 ... c1 - 1, (2, 4, W)."""
    for i in range(2):
        for a in range(4):
            for k in range((c0 - lead) // h, (c1 - 1 - lead) // h + 1):
                b = lead + k * h
                p0, p1, p2, p3 = p[i, cell + a, k], p[i, cell + a, k + 1], p[i, cell + a, k + 2], p[i, cell + a, k + 3]
                for q in range(max(b, c0), min(b + h, c1)):
                    moved[i, a, q] = (p0 * table[q - b, 0] + p1 * table[q - b, 1] + p2 * table[q - b, 2]
                                      + p3 * table[q - b, 3])


@inlined
def _add(weight, values, out):
    """out += weight * values, in a loop so plain that it becomes vectors."""
    for i in range(out.size):
        out[i] += weight * values[i]


@inlined
def _move_run(moved, weights, r, a0, a1, H, W, y, x):
    """Places (y, x) to which the pixels a0 ... a1 - 1 of row r are moved, kept inside the picture. One row more is
    kept free below, for `spline_value` reads two coefficients too many."""
    F = np.float32
    y, x = y[:a1 - a0], x[:a1 - a0]
    for i in range(a1 - a0):
        y[i], x[i] = F(r), F(a0 + i)
    for a in range(4):
        _add(weights[a], moved[0, a, a0:a1], y)
        _add(weights[a], moved[1, a, a0:a1], x)
    for i in range(a1 - a0):
        y[i] = min(max(y[i], F(2)), F(H - 5))
        x[i] = min(max(x[i], F(2)), F(W - 4))


@jit
def pull_back(C, row, first, stop, start, table, lead, p, out):
    """Interpolate a picture (coefficients C) at the displaced pixels of the runs: out (P,)."""
    H, W = C.shape
    h, flat = table.shape[0], C.ravel()
    c0, c1 = first.min(), stop.max()
    moved = np.empty((2, 4, W), np.float32)
    y, x = np.empty(W, np.float32), np.empty(W, np.float32)
    cell = np.int64(-1)
    for s in range(row.size):
        r, a0, a1 = row[s], first[s], stop[s]
        if (r - lead) // h != cell:
            cell = (r - lead) // h
            _move_cells(p, table, h, lead, cell, c0, c1, moved)
        _move_run(moved, table[r - lead - cell * h], r, a0, a1, H, W, y, x)
        _sample_run(flat, W, y, x, a1 - a0, out[start[s]:])


@inlined
def _gather_cells(seen, table, h, lead, cell, c0, c1, rhs):
    """The transpose of `_move_cells`: add what one row of cells has seen, (2, 4, W), to the knots."""
    F = np.float32
    for i in range(2):
        for a in range(4):
            for k in range((c0 - lead) // h, (c1 - 1 - lead) // h + 1):
                b = lead + k * h
                s0, s1, s2, s3 = F(0), F(0), F(0), F(0)
                for q in range(max(b, c0), min(b + h, c1)):
                    u = seen[i, a, q]
                    s0 += u * table[q - b, 0]
                    s1 += u * table[q - b, 1]
                    s2 += u * table[q - b, 2]
                    s3 += u * table[q - b, 3]
                    seen[i, a, q] = 0
                rhs[i, cell + a, k] += s0
                rhs[i, cell + a, k + 1] += s1
                rhs[i, cell + a, k + 2] += s2
                rhs[i, cell + a, k + 3] += s3


@jit
def sweep(C, row, first, stop, start, table, lead, p, f, gr, gc, scale, bright, limit, res, rhs, rhs_b):
    """One Gauss-Newton sweep: residual (P,) of a picture against the template f (P,) at displacement p (2, K, L), and
    the right-hand sides J'res for the knots (2, K, L) and for the six brightness parameters. Returns sum res^2.

    The model is f + (f - mean) (b0 + b1 y + b2 x) + (b3 + b4 y + b5 x), with scale = (mean, row centre, 1 / row half
    extent, column centre, 1 / column half extent). Residuals are cut to `limit`, so that a glint does not rule.
    """
    F = np.float32
    H, W = C.shape
    h, flat = table.shape[0], C.ravel()
    c0, c1 = first.min(), stop.max()
    moved, seen = np.empty((2, 4, W), np.float32), np.zeros((2, 4, W), np.float32)
    y, x, g = np.empty(W, np.float32), np.empty(W, np.float32), np.empty(W, np.float32)
    rhs[:] = 0
    rhs_b[:] = 0
    squares = np.float64(0)
    mean, ym, ys, xm, xs = scale[0], scale[1], scale[2], scale[3], scale[4]
    cell = np.int64(-1)
    for s in range(row.size):
        r, a0, a1, o = row[s], first[s], stop[s], start[s]
        n = a1 - a0
        if (r - lead) // h != cell:
            if cell >= 0:
                _gather_cells(seen, table, h, lead, cell, c0, c1, rhs)
            cell = (r - lead) // h
            _move_cells(p, table, h, lead, cell, c0, c1, moved)
        weights = table[r - lead - cell * h]
        _move_run(moved, weights, r, a0, a1, H, W, y, x)
        _sample_run(flat, W, y, x, n, g)
        ly = (F(r) - ym) * ys
        A, B = bright[0] + bright[1] * ly, bright[3] + bright[4] * ly
        A1, B1 = bright[2], bright[5]
        q0, q1, q2, q3, sq = F(0), F(0), F(0), F(0), F(0)
        relaxed, residual = f[o:o + n], res[o:o + n]
        for i in range(n):
            lx = (F(a0 + i) - xm) * xs
            d = relaxed[i] - mean
            e = g[i] - relaxed[i] - d * (A + A1 * lx) - (B + B1 * lx)
            e = min(max(e, -limit), limit)
            residual[i] = e
            sq += e * e
            q0 += d * e
            q1 += d * e * lx
            q2 += e
            q3 += e * lx
        squares += sq
        rhs_b[0] -= q0
        rhs_b[1] -= q0 * ly
        rhs_b[2] -= q1
        rhs_b[3] -= q2
        rhs_b[4] -= q2 * ly
        rhs_b[5] -= q3
        down, right, slope_r, slope_c = y[:n], x[:n], gr[o:o + n], gc[o:o + n]
        for i in range(n):
            down[i], right[i] = residual[i] * slope_r[i], residual[i] * slope_c[i]
        for a in range(4):
            _add(weights[a], down, seen[0, a, a0:a1])
            _add(weights[a], right, seen[1, a, a0:a1])
    _gather_cells(seen, table, h, lead, cell, c0, c1, rhs)
    return squares


@inlined
def _along(C, r, c, dr, dc):
    """Value of the quintic spline at a pixel, taken along one axis only."""
    F = np.float32
    return (F(66 / 120) * C[r, c] + F(26 / 120) * (C[r - dr, c - dc] + C[r + dr, c + dc])
            + F(1 / 120) * (C[r - 2 * dr, c - 2 * dc] + C[r + 2 * dr, c + 2 * dc]))


@jit
def slopes(C, row, first, stop, start, gr, gc):
    """Derivatives (P,) along row and col of a picture (coefficients C) at the pixels of the runs."""
    F = np.float32
    d1, d2 = F(50 / 120), F(5 / 120)
    for s in range(row.size):
        r, o = row[s], start[s] - first[s]
        for c in range(first[s], stop[s]):
            gr[o + c] = (d1 * (_along(C, r + 1, c, 0, 1) - _along(C, r - 1, c, 0, 1))
                         + d2 * (_along(C, r + 2, c, 0, 1) - _along(C, r - 2, c, 0, 1)))
            gc[o + c] = (d1 * (_along(C, r, c + 1, 1, 0) - _along(C, r, c - 1, 1, 0))
                         + d2 * (_along(C, r, c + 2, 1, 0) - _along(C, r, c - 2, 1, 0)))


@jit
def normal_matrix(row, first, stop, start, table, lead, gr, gc, f, scale, band, knots, border, small):
    """Add up J'J: lower band (D, n) of the knots' part, its border (n, 6) with the brightness, and that (6, 6).

    Unknown 2 (k K + j) + i is component i of knot (j, k) of `knots` = K rows. Pixels of a row inside one cell are
    summed along the columns first, for all pairs of the cell's four columns of knots.
    """
    h = table.shape[0]
    mean, ym, ys, xm, xs = scale[0], scale[1], scale[2], scale[3], scale[4]
    L, light = np.empty(6), np.empty((4, 2, 6))
    squares = np.empty((4, 4, 3))
    for s in range(row.size):
        r = row[s]
        cr = (r - lead) // h
        w = table[r - lead - cr * h]
        c = first[s]
        while c < stop[s]:
            cc = (c - lead) // h
            end = min(lead + (cc + 1) * h, stop[s])
            squares[:] = 0
            light[:] = 0
            for q in range(c, end):
                o = start[s] + q - first[s]
                v = table[q - lead - cc * h]
                y, x = np.float64(gr[o]), np.float64(gc[o])
                d = np.float64(f[o] - mean)
                ly, lx = (r - ym) * ys, (q - xm) * xs
                L[0], L[1], L[2], L[3], L[4], L[5] = -d, -d * ly, -d * lx, -1.0, -ly, -lx
                for b in range(4):
                    for a in range(b + 1):
                        both = v[a] * v[b]
                        squares[b, a, 0] += both * y * y
                        squares[b, a, 1] += both * y * x
                        squares[b, a, 2] += both * x * x
                    for t in range(6):
                        light[b, 0, t] += v[b] * y * L[t]
                        light[b, 1, t] += v[b] * x * L[t]
                for t in range(6):
                    for u in range(6):
                        small[t, u] += L[t] * L[u]
            for b in range(4):
                for i in range(4):
                    n = 2 * ((cc + b) * knots + cr + i)
                    for t in range(6):
                        border[n, t] += w[i] * light[b, 0, t]
                        border[n + 1, t] += w[i] * light[b, 1, t]
                    for a in range(b + 1):
                        yy, yx, xx = squares[b, a, 0], squares[b, a, 1], squares[b, a, 2]
                        for j in range(4 if a < b else i + 1):
                            m = 2 * ((cc + a) * knots + cr + j)
                            both = w[i] * w[j]
                            band[n - m, m] += both * yy
                            band[n - m, m + 1] += both * xx
                            band[n + 1 - m, m] += both * yx
                            if n > m:
                                band[n - m - 1, m + 1] += both * yx
            c = end
