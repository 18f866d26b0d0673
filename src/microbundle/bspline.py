"""Compiled kernels of the registration: B-spline interpolation of pictures, and one Gauss-Newton sweep over a mask.

Pictures are interpolated by quintic B-splines (M. Unser, IEEE Signal Process. Mag. 16, 1999); the displacement is a
cubic B-spline on knots that lie a whole number of pixels apart, so its weights come from a table and the basis is
never stored. A mask is a list of runs, pixels that follow one another in a row. All pictures are float32.

The kernels are compiled by numba at their first use and kept on disk; that takes about ten seconds once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
POLES = (-0.43057534709997, -0.04309628820326)
"""Of the quintic B-spline's recursive prefilter."""
HORIZON = 14
"""Samples after which the larger pole's memory is below the resolution of float32."""

jit: Any = numba.njit(fastmath=True, nogil=True, cache=True, error_model="numpy")
inlined: Any = numba.njit(inline="always")


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


@inlined
def _flank(f: Any) -> Any:
    """Weight of the second coefficient from the left."""
    F = np.float32
    inner = F(20 / 120) + f * (F(-20 / 120) + f * F(5 / 120))
    return F(26 / 120) + f * (F(-50 / 120) + f * (F(20 / 120) + f * inner))


@inlined
def _quintic(f: Any) -> Any:
    """Weights of the six coefficients around a place at fraction f between two pixels."""
    F = np.float32
    g = F(1) - f
    f2, g2 = f * f, g * g
    left = F(66 / 120) + f2 * (F(-60 / 120) + f2 * (F(30 / 120) - f * F(10 / 120)))
    right = F(66 / 120) + g2 * (F(-60 / 120) + g2 * (F(30 / 120) - g * F(10 / 120)))
    return g2 * g2 * g * F(1 / 120), _flank(f), left, right, _flank(g), f2 * f2 * f * F(1 / 120)


@inlined
def _sample_run(C, W, R, S, index, y, x, n, out):
    """Interpolate a picture's coefficients at n places (y, x) into out."""
    flat = C.ravel()
    for i in range(n):
        iy, ix = np.int32(y[i]), np.int32(x[i])
        index[i] = (iy - 2) * W + ix - 2
        a0, a1, a2, a3, a4, a5 = _quintic(y[i] - np.float32(iy))
        b0, b1, b2, b3, b4, b5 = _quintic(x[i] - np.float32(ix))
        R[0, i], R[1, i], R[2, i], R[3, i], R[4, i], R[5, i] = a0, a1, a2, a3, a4, a5
        S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i] = b0, b1, b2, b3, b4, b5
    for i in range(n):
        j = np.int64(index[i])
        s0, s1, s2, s3, s4, s5 = S[0, i], S[1, i], S[2, i], S[3, i], S[4, i], S[5, i]
        total = R[0, i] * (s0 * flat[j] + s1 * flat[j + 1] + s2 * flat[j + 2] + s3 * flat[j + 3] + s4 * flat[j + 4]
                           + s5 * flat[j + 5])
        j += W
        total += R[1, i] * (s0 * flat[j] + s1 * flat[j + 1] + s2 * flat[j + 2] + s3 * flat[j + 3] + s4 * flat[j + 4]
                            + s5 * flat[j + 5])
        j += W
        total += R[2, i] * (s0 * flat[j] + s1 * flat[j + 1] + s2 * flat[j + 2] + s3 * flat[j + 3] + s4 * flat[j + 4]
                            + s5 * flat[j + 5])
        j += W
        total += R[3, i] * (s0 * flat[j] + s1 * flat[j + 1] + s2 * flat[j + 2] + s3 * flat[j + 3] + s4 * flat[j + 4]
                            + s5 * flat[j + 5])
        j += W
        total += R[4, i] * (s0 * flat[j] + s1 * flat[j + 1] + s2 * flat[j + 2] + s3 * flat[j + 3] + s4 * flat[j + 4]
                            + s5 * flat[j + 5])
        j += W
        out[i] = total + R[5, i] * (s0 * flat[j] + s1 * flat[j + 1] + s2 * flat[j + 2] + s3 * flat[j + 3]
                                    + s4 * flat[j + 4] + s5 * flat[j + 5])


@inlined
def _move_run(p, table, h, lead, r, a0, a1, H, W, line, y, x):
    """Places (y, x) to which the displacement p carries the pixels a0 ... a1 - 1 of row r, kept inside the picture."""
    F = np.float32
    cell = (r - lead) // h
    f = r - lead - cell * h
    for k in range((a0 - lead) // h, (a1 - 1 - lead) // h + 4):
        u, v = F(0), F(0)
        for a in range(4):
            u += table[f, a] * p[0, cell + a, k]
            v += table[f, a] * p[1, cell + a, k]
        line[0, k], line[1, k] = u, v
    c = a0
    while c < a1:
        k = (c - lead) // h
        b = lead + k * h
        e = min(b + h, a1)
        u0, u1, u2, u3 = line[0, k], line[0, k + 1], line[0, k + 2], line[0, k + 3]
        v0, v1, v2, v3 = line[1, k], line[1, k + 1], line[1, k + 2], line[1, k + 3]
        for q in range(c, e):
            w0, w1, w2, w3 = table[q - b, 0], table[q - b, 1], table[q - b, 2], table[q - b, 3]
            y[q - a0] = min(max(F(r) + u0 * w0 + u1 * w1 + u2 * w2 + u3 * w3, F(2)), F(H - 4))
            x[q - a0] = min(max(F(q) + v0 * w0 + v1 * w1 + v2 * w2 + v3 * w3, F(2)), F(W - 4))
        c = e


@jit
def pull_back(C, row, first, stop, start, table, lead, p, out):
    """Interpolate a picture (coefficients C) at the displaced pixels of the runs: out (P,)."""
    H, W = C.shape
    h = table.shape[0]
    line = np.empty((2, p.shape[2]), np.float32)
    y, x, index = np.empty(W, np.float32), np.empty(W, np.float32), np.empty(W, np.int32)
    R, S = np.empty((6, W), np.float32), np.empty((6, W), np.float32)
    for s in range(row.size):
        r, a0, a1 = row[s], first[s], stop[s]
        _move_run(p, table, h, lead, r, a0, a1, H, W, line, y, x)
        _sample_run(C, W, R, S, index, y, x, a1 - a0, out[start[s]:])


@jit
def sweep(C, row, first, stop, start, table, lead, p, f, gr, gc, scale, bright, limit, res, rhs, rhs_b):
    """One Gauss-Newton sweep: residual (P,) of a picture against the template f (P,) at displacement p (2, K, L), and
    the right-hand sides J'res for the knots (2, K, L) and for the six brightness parameters. Returns sum res^2.

    The model is f + (f - mean) (b0 + b1 y + b2 x) + (b3 + b4 y + b5 x), with scale = (mean, row centre, 1 / row half
    extent, column centre, 1 / column half extent). Residuals are cut to `limit`, so that a glint does not rule.
    """
    F = np.float32
    H, W = C.shape
    h = table.shape[0]
    line, acc = np.empty((2, p.shape[2]), np.float32), np.empty((2, p.shape[2]), np.float32)
    y, x, g = np.empty(W, np.float32), np.empty(W, np.float32), np.empty(W, np.float32)
    index = np.empty(W, np.int32)
    R, S = np.empty((6, W), np.float32), np.empty((6, W), np.float32)
    rhs[:] = 0
    rhs_b[:] = 0
    squares = np.float64(0)
    mean, ym, ys, xm, xs = scale[0], scale[1], scale[2], scale[3], scale[4]
    for s in range(row.size):
        r, a0, a1, o = row[s], first[s], stop[s], start[s]
        n = a1 - a0
        _move_run(p, table, h, lead, r, a0, a1, H, W, line, y, x)
        _sample_run(C, W, R, S, index, y, x, n, g)
        ly = (F(r) - ym) * ys
        A, B = bright[0] + bright[1] * ly, bright[3] + bright[4] * ly
        A1, B1 = bright[2], bright[5]
        q0, q1, q2, q3, sq = F(0), F(0), F(0), F(0), F(0)
        for i in range(n):
            lx = (F(a0 + i) - xm) * xs
            d = f[o + i] - mean
            e = g[i] - f[o + i] - d * (A + A1 * lx) - (B + B1 * lx)
            e = min(max(e, -limit), limit)
            g[i] = e
            res[o + i] = e
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
        acc[:, (a0 - lead) // h:(a1 - 1 - lead) // h + 4] = 0
        c = a0
        while c < a1:
            k = (c - lead) // h
            b = lead + k * h
            e1 = min(b + h, a1)
            s0, s1, s2, s3, t0, t1, t2, t3 = F(0), F(0), F(0), F(0), F(0), F(0), F(0), F(0)
            for q in range(c, e1):
                e = g[q - a0]
                u, v = e * gr[o + q - a0], e * gc[o + q - a0]
                w0, w1, w2, w3 = table[q - b, 0], table[q - b, 1], table[q - b, 2], table[q - b, 3]
                s0 += u * w0
                s1 += u * w1
                s2 += u * w2
                s3 += u * w3
                t0 += v * w0
                t1 += v * w1
                t2 += v * w2
                t3 += v * w3
            acc[0, k] += s0
            acc[0, k + 1] += s1
            acc[0, k + 2] += s2
            acc[0, k + 3] += s3
            acc[1, k] += t0
            acc[1, k + 1] += t1
            acc[1, k + 2] += t2
            acc[1, k + 3] += t3
            c = e1
        cell = (r - lead) // h
        fr = r - lead - cell * h
        for k in range((a0 - lead) // h, (a1 - 1 - lead) // h + 4):
            for a in range(4):
                rhs[0, cell + a, k] += table[fr, a] * acc[0, k]
                rhs[1, cell + a, k] += table[fr, a] * acc[1, k]
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

    Unknown 2 (k K + j) + i is component i of knot (j, k) of `knots` = K rows.
    """
    h = table.shape[0]
    mean, ym, ys, xm, xs = scale[0], scale[1], scale[2], scale[3], scale[4]
    w = np.empty(16)
    at = np.empty(16, np.int64)
    L = np.empty(6)
    for s in range(row.size):
        r = row[s]
        cr = (r - lead) // h
        fr = r - lead - cr * h
        for c in range(first[s], stop[s]):
            o = start[s] + c - first[s]
            cc = (c - lead) // h
            fc = c - lead - cc * h
            y, x = np.float64(gr[o]), np.float64(gc[o])
            for b in range(4):
                for a in range(4):
                    w[4 * b + a] = table[fr, a] * table[fc, b]
                    at[4 * b + a] = 2 * ((cc + b) * knots + cr + a)
            d = np.float64(f[o] - mean)
            ly, lx = (r - ym) * ys, (c - xm) * xs
            L[0], L[1], L[2], L[3], L[4], L[5] = -d, -d * ly, -d * lx, -1.0, -ly, -lx
            for i in range(16):
                n = at[i]
                for j in range(i + 1):
                    m = at[j]
                    q = w[i] * w[j]
                    band[n - m, m] += q * y * y
                    band[n - m, m + 1] += q * x * x
                    band[n + 1 - m, m] += q * x * y
                    if i != j:
                        band[n - m - 1, m + 1] += q * y * x
                for t in range(6):
                    border[n, t] += w[i] * y * L[t]
                    border[n + 1, t] += w[i] * x * L[t]
            for t in range(6):
                for u in range(6):
                    small[t, u] += L[t] * L[u]
