"""Patches of one picture, ready to be found in others: the search, and what its result may be wrong by.

A patch is a box of pixels, not all of which need count. It is found by inverse-compositional Gauss-Newton
(S. Baker and I. Matthews, Int. J. Comput. Vis. 56, 2004) with an affine, rigid or translational warp, and what is
minimised is the zero-mean normalised sum of squared differences: gain and offset are solved along. Pictures are
interpolated by quintic B-splines.

Slopes are blurred a little: residuals are weighted by them, and any weights lead to the same place, but noise is
worst in slopes. Standard errors follow from how each pixel's noise moves the result, and from size and correlation of
the residual.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import ndimage

from . import bspline
from .bspline import Float32, Runs, inlined, jit, spline_value
from .data import Bools, Floats, Image, Ints

Model = Literal["affine", "rigid", "translation"]

MARGIN_PX = 16
"""Of the part of a frame that is interpolated, around the places where the patches are expected."""
FEWEST_PIXELS = 60
LEAST_INSIDE = 0.75
"""Share of a patch's pixels that must be in the picture."""
MOST_STEPS, TOLERANCE_PX, LONGEST_STEP_PX = 30, 1e-3, 2.0
LEAST_GAIN, MOST_STRAIN = 0.1, 0.3
LEAST_MATCH = 0.5
"""Share of a patch's variance that must be found again; in pure noise a search finds 0.1."""
BLUR_PX, BLURRED_NOISE = 0.7, 0.44
"""Blur of slopes, and the mean product of slopes with and without it for white noise of unit variance."""
INTERPOLATION_PX = 0.0004
"""Standard error of a place by interpolation alone, as found on movies without noise."""
SINGULAR = 1e-7
"""Smallest ratio of eigenvalues of the normal matrix, its columns of equal size."""
LAGS = tuple((i, j) for i in range(3) for j in range(-2, 3) if (i, j) >= (0, 0))
"""Distances between pixels whose noise may correlate, one of each opposite pair."""
LAG_WEIGHT = np.array([1.0] + [2.0] * (len(LAGS) - 1))
NOISE_FRAMES = 24
"""Frames in which the correlation of the residual is looked at."""
LEAST_NOISE = 0.25
"""The correlation lowers no variance below this share of that for white noise."""

_FREE = {
    "affine": np.eye(6),
    "rigid": np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 1, -1, 0]], float).T,
    "translation": np.eye(6)[:, :2],
}
"""What each model leaves free of (shift row, shift col, F_rr - 1, F_rc, F_cr, F_cc - 1)."""


@dataclass(frozen=True)
class Found:
    """Patches of the reference in one frame."""

    warp: Floats
    """(N, 2, 3): a pixel at x from the patch's centre c is at c + warp [x, 1]."""
    ok: Bools
    """(N,)"""
    variance: Floats
    """(N,): of the residual, in squared grey values of the reference."""
    match: Floats
    """(N,): squared correlation of the patch with the frame."""
    light: Floats
    """(N, 2): gain and offset of the frame's grey values against the reference's."""
    residual: Float32
    """(N, h, w), 0 where a pixel does not count."""


class Patches:
    """Boxes of h x w pixels of one picture, with all that does not change from frame to frame."""

    def __init__(self, picture: Float32, usable: Bools, corner: Ints, size: tuple[int, int], center: Floats,
                 model: Model) -> None:
        self.corner, self.center, self.rigid = corner, center, model != "affine"
        rows, cols = (corner[:, axis, None] + np.arange(size[axis]) for axis in (0, 1))
        at = tuple(np.clip(place, 0, n - 1) for place, n in zip((rows[:, :, None], cols[:, None]), picture.shape,
                                                              strict=True))
        self.use = usable[at] & (rows[:, :, None] == at[0]) & (cols[:, None] == at[1])
        sharp = _slopes(picture, usable)
        soft = _slopes(ndimage.gaussian_filter(picture, BLUR_PX), usable)
        self.f, self.gr, self.gc = (image[at] for image in (picture, *soft))
        own = np.stack([image[at] for image in sharp], axis=1)
        self.pixels = self.use.sum(axis=(1, 2))
        self.free = _FREE[model].shape[1]
        n = len(corner)
        self.good = np.zeros(n, bool)
        self.contrast = np.ones(n)
        """Variance of the grey values."""
        self.step: Floats = np.zeros((n, 6, 6))
        """What the sums of residual times slope add to the warp."""
        self.spread: Floats = np.zeros((n, len(LAGS), 6))
        """What noise of unit covariance at each distance adds to the warp's variances."""
        self.taken: Floats = np.zeros((n, len(LAGS)))
        """What the fit takes from the residual's products at each distance, for white noise of unit variance."""
        self.slope2: Floats = np.zeros((n, 2))
        """Mean product of slopes with and without blur, along row and col."""
        for i in np.flatnonzero(self.pixels >= FEWEST_PIXELS).tolist():
            self._prepare(i, own[i], rows[i] - center[i, 0], cols[i] - center[i, 1], _FREE[model])

    def _prepare(self, i: int, own: Float32, y: Floats, x: Floats, free: Floats) -> None:
        use = self.use[i]
        f = np.where(use, self.f[i] - self.f[i][use].mean(), 0.0)
        contrast = (f**2).sum() / self.pixels[i]
        if contrast <= 1e-12 * max(float((self.f[i][use] ** 2).mean()), 1e-300):
            return
        self.contrast[i] = contrast
        soft = np.stack([self.gr[i], self.gc[i]])
        self.slope2[i] = (soft * own * use).sum(axis=(1, 2)) / self.pixels[i]
        light = np.stack([use / np.sqrt(self.pixels[i]), f / np.sqrt((f**2).sum())])
        weight, change = (_changes(slope, y, x, light) for slope in (soft, own))
        flat = free.T @ weight.reshape(6, -1)
        size = np.sqrt((flat**2).sum(axis=1))
        if not (size > 0).all() or np.linalg.eigvalsh(flat @ flat.T / np.outer(size, size))[0] < SINGULAR:
            return
        self.good[i] = True
        self.step[i] = free @ np.linalg.inv(flat @ change.reshape(6, -1).T @ free) @ free.T
        pull = np.tensordot(self.step[i], weight, 1)
        for k, lag in enumerate(LAGS):
            self.spread[i, k] = _products(pull, pull, lag)
            self.taken[i, k] = _products(pull, change, lag).sum() + _products(light, light, lag).sum()

    def noisy_slopes(self, variance: Floats) -> Floats:
        """How much (N, 2) larger errors are where noise of a variance (N,) has made the slopes too large."""
        true = self.slope2 - BLURRED_NOISE * variance[:, None]
        return np.asarray(np.divide(self.slope2, true, out=np.full(true.shape, np.inf), where=true > 0))

    def find(self, part: Part, warp: Floats, chosen: Bools) -> Found:
        """Search the chosen patches (N,) in a frame from the warp (N, 2, 3) on."""
        n, h, w = self.f.shape
        out, numbers = np.array(warp, float), np.zeros((n, 6))
        residual = np.zeros(self.f.shape, np.float32)
        _search(part.coefficients, part.origin, np.flatnonzero(chosen & self.good), self.corner, self.center, self.use,
                self.f, self.gr, self.gc, self.step, 0.5 * max(h, w), self.rigid, out, residual, numbers)
        ended, pixels, squares, match, gain, offset = numbers.T
        variance = squares / np.maximum(pixels - self.free - 2, 1)
        return Found(out, (ended > 0) & (match >= LEAST_MATCH), variance, match, np.stack([gain, offset], axis=1),
                      residual)


@dataclass(frozen=True)
class Part:
    """Spline coefficients of the part of a frame that begins at `origin`."""

    coefficients: Float32
    origin: Ints

    @classmethod
    def of(cls, frame: Image, patches: Patches, warp: Floats) -> Part:
        """The part around the places where the patches are expected."""
        first = patches.corner + warp[:, :, 2]
        low, high = first.min(axis=0) - MARGIN_PX, first.max(axis=0) + patches.f.shape[1:] + MARGIN_PX
        stop = np.clip(np.ceil(high).astype(int), 2 * MARGIN_PX, frame.shape)
        start = np.clip(np.floor(low).astype(int), 0, stop - 2 * MARGIN_PX).clip(min=0)
        out = np.array(frame[start[0]:stop[0], start[1]:stop[1]], np.float32, order="C")
        bspline.prefilter(out)
        return cls(out, start)


@inlined
def _pull(C: Any, origin: Any, corner: Any, center: Any, use: Any, warp: Any, g: Any, seen: Any) -> Any:
    """Interpolate at the warped pixels of a box: g (h, w) where `seen` (h, w) says that the pixel is in the picture.
    Returns their number."""
    H, W = C.shape
    flat = C.ravel()
    count = 0
    for r in range(use.shape[0]):
        dy = corner[0] + r - center[0]
        dx = corner[1] - center[1]
        y = center[0] - origin[0] + warp[0, 2] + warp[0, 0] * dy + warp[0, 1] * dx
        x = center[1] - origin[1] + warp[1, 2] + warp[1, 0] * dy + warp[1, 1] * dx
        for c in range(use.shape[1]):
            iy, ix = int(y), int(x)
            inside = use[r, c] and y >= 2 and x >= 2 and iy < H - 4 and ix < W - 3
            seen[r, c] = inside
            if inside:
                g[r, c] = spline_value(flat, np.int64(iy - 2) * W + (ix - 2), W, np.float32(y - iy), np.float32(x - ix))
                count += 1
            y += warp[0, 1]
            x += warp[1, 1]
    return count


@jit
def _search(C: Any, origin: Any, chosen: Any, corner: Any, center: Any, use: Any, f: Any, gr: Any, gc: Any, step: Any,
            reach: Any, rigid: Any, warps: Any, residual: Any, numbers: Any) -> None:
    """Gauss-Newton for each chosen patch: its warp (2, 3) in place, its residual (h, w), and six numbers: 1 if the
    search ended, pixels, sum of squares, squared correlation, gain, offset."""
    h, w = f.shape[1], f.shape[2]
    g, seen, s, d = np.empty((h, w), np.float32), np.empty((h, w), np.bool_), np.empty(6), np.empty(6)
    for i in chosen:
        warp, e = warps[i], residual[i]
        fewest = LEAST_INSIDE * use[i].sum()
        shift = f[i, h // 2, w // 2]  # keeps the sums small
        for _ in range(MOST_STEPS):
            n = _pull(C, origin, corner[i], center[i], use[i], warp, g, seen)
            if n < fewest:
                break
            sf, sg, ff, fg, gg = 0.0, 0.0, 0.0, 0.0, 0.0
            for r in range(h):
                for c in range(w):
                    if seen[r, c]:
                        a, b = np.float64(f[i, r, c] - shift), np.float64(g[r, c] - shift)
                        sf += a
                        sg += b
                        ff += a * a
                        fg += a * b
                        gg += b * b
            ff, fg, gg = ff - sf * sf / n, fg - sf * sg / n, gg - sg * sg / n
            if not fg > LEAST_GAIN * ff:
                break
            gain = fg / ff
            offset = sg / n - gain * sf / n
            squares = 0.0
            s[:] = 0.0
            for r in range(h):
                y = corner[i, 0] + r - center[i, 0]
                a0, a1, a2, a3 = 0.0, 0.0, 0.0, 0.0
                for c in range(w):
                    if not seen[r, c]:
                        e[r, c] = 0
                        continue
                    x = corner[i, 1] + c - center[i, 1]
                    e[r, c] = (g[r, c] - shift - offset) / gain - (f[i, r, c] - shift)
                    squares += e[r, c] * e[r, c]
                    down, right = np.float64(e[r, c] * gr[i, r, c]), np.float64(e[r, c] * gc[i, r, c])
                    a0 += down
                    a1 += right
                    a2 += down * x
                    a3 += right * x
                s[0] += a0
                s[1] += a1
                s[2] += y * a0
                s[3] += a2
                s[4] += y * a1
                s[5] += a3
            for j in range(6):
                d[j] = 0.0
                for k in range(6):
                    d[j] += step[i, j, k] * s[k]
            size = (max(abs(d[0]), abs(d[1]))
                    + reach * max(max(abs(d[2]), abs(d[3])), max(abs(d[4]), abs(d[5]))))
            if size > LONGEST_STEP_PX:
                d *= LONGEST_STEP_PX / size
            # The warp after the inverse of the step.
            det = (1 + d[2]) * (1 + d[5]) - d[3] * d[4]
            i00, i01, i10, i11 = (1 + d[5]) / det, -d[3] / det, -d[4] / det, (1 + d[2]) / det
            for j in range(2):
                u, v = warp[j, 0], warp[j, 1]
                warp[j, 0], warp[j, 1] = u * i00 + v * i10, u * i01 + v * i11
            if rigid:
                scale = np.sqrt(warp[0, 0] * warp[1, 1] - warp[0, 1] * warp[1, 0])
                warp[:, :2] /= scale
            for j in range(2):
                warp[j, 2] -= warp[j, 0] * d[0] + warp[j, 1] * d[1]
            if not rigid and max(max(abs(warp[0, 0] - 1), abs(warp[0, 1])),
                                 max(abs(warp[1, 0]), abs(warp[1, 1] - 1))) > MOST_STRAIN:
                break
            if size < TOLERANCE_PX:
                numbers[i] = np.array([1.0, n, squares, fg * fg / (ff * gg), gain, offset + shift * (1 - gain)])
                break


@jit
def _pull_back(C: Any, origin: Any, corner: Any, center: Any, use: Any, warp: Any, g: Any, seen: Any) -> None:
    """Interpolate at the warped pixels of one box, see `_pull`."""
    _pull(C, origin, corner, center, use, warp, g, seen)


class Mean:
    """The mean of all frames pulled back to the reference, in and around a body."""

    def __init__(self, around: Bools, center: Floats) -> None:
        corner, size = box(around)
        self.corner, self.center = corner[0], center[0]
        self.box = tuple(slice(first, first + n) for first, n in zip(self.corner, size, strict=True))
        self.use = around[self.box]
        self.total: Floats = np.zeros(size)
        self.frames: Ints = np.zeros(size, int)

    def add(self, part: Part, found: Found) -> None:
        """Add a frame, its gain and offset undone."""
        g, seen = np.zeros(self.use.shape, np.float32), np.zeros(self.use.shape, bool)
        _pull_back(part.coefficients, part.origin, self.corner, self.center, self.use, found.warp[0], g, seen)
        gain, offset = found.light[0]
        self.total += np.where(seen, (g - offset) / gain, 0.0)
        self.frames += seen

    def picture(self, reference: Float32) -> Float32:
        """The reference with the mean in place of the body."""
        out = reference.copy()
        part = out[self.box]
        often = self.frames > 0.5 * self.frames.max()
        part[often] = self.total[often] / self.frames[often]
        return out


class Noise:
    """How the residual correlates from pixel to pixel, pooled over patches and some frames."""

    def __init__(self, patches: Patches, count: int) -> None:
        self.patches = patches
        self.chosen = set(np.linspace(0, count - 1, min(count, NOISE_FRAMES)).astype(int).tolist())
        self.sums: Floats = np.zeros(len(LAGS))
        self.pairs: Floats = np.zeros(len(LAGS))

    def add(self, t: int, found: Found) -> None:
        """Look at one frame."""
        seen = found.ok & (found.variance > 0)
        if t in self.chosen and seen.any():
            part = found.residual[seen] / np.sqrt(found.variance[seen])[:, None, None].astype(np.float32)
            use = self.patches.use[seen].astype(np.float32)
            for k, lag in enumerate(LAGS):
                self.sums[k] += _products(part, part, lag).sum() + self.patches.taken[seen, k].sum()
                self.pairs[k] += _products(use, use, lag).sum()

    def standard_error(self, variance: Floats, rows: tuple[int, ...]) -> Floats:
        """Standard errors (T, N, k) of some rows of the warp for residuals of a variance (T, N)."""
        correlation = np.eye(len(LAGS))[0]
        if self.pairs.all() and self.sums[0] > 0:
            correlation = self.sums / self.pairs
            correlation /= correlation[0]
        white = self.patches.spread[:, 0, rows]
        spread = np.einsum("l,nlk->nk", LAG_WEIGHT * correlation, self.patches.spread[:, :, rows])
        total = variance[:, :, None] * np.maximum(spread, LEAST_NOISE * white)
        return np.asarray(np.sqrt(total + INTERPOLATION_PX**2))


def _products(a: Any, b: Any, lag: tuple[int, int]) -> Any:
    """Sum over pixels (..., h, w) of a at each pixel times b at a distance, for lag = (rows >= 0, cols)."""
    i, j = lag
    h, w = a.shape[-2:]
    here = a[..., :h - i, max(-j, 0):w - max(j, 0)]
    there = b[..., i:, max(j, 0):w + min(j, 0)]
    return np.einsum("...ij,...ij->...", here, there)


def _changes(slope: Float32, y: Floats, x: Floats, light: Floats) -> Floats:
    """Change (6, h, w) of the grey values with the warp, less what gain and offset (2, h, w) can do."""
    down, right = slope
    out = np.stack([down, right, down * y[:, None], down * x, right * y[:, None], right * x]) * (light[0] > 0)
    return np.asarray(out - np.tensordot(np.tensordot(out, light, ((1, 2), (1, 2))), light, 1))


def box(mask: Bools) -> tuple[Ints, tuple[int, int]]:
    """Corner (1, 2) and size of the smallest box around a mask."""
    at = np.argwhere(mask) if mask.any() else np.zeros((1, 2), int)
    height, width = at.max(axis=0) - at.min(axis=0) + 1
    return at.min(axis=0)[None], (int(height), int(width))


def _slopes(picture: Float32, usable: Bools) -> tuple[Float32, Float32]:
    """Derivatives (R, C) along row and col at the usable pixels, 0 elsewhere."""
    coefficients = picture.copy()
    bspline.prefilter(coefficients)
    runs = Runs.of(usable)
    values = np.empty((2, runs.count), np.float32)
    bspline.slopes(coefficients, *runs.arrays, *values)
    out = np.zeros((2, *picture.shape), np.float32)
    out[:, usable] = values
    return out[0], out[1]
