"""Measure how the stage moves, by the background that the tissue does not touch.

The background is divided into cells of 16 px; the ones with most texture are registered against the reference frame
with one common shift (Gauss-Newton, quintic B-spline interpolation, each cell's brightness left free). Cells that do
not move with the others, such as a pillar or a floating speck, are left out; the scatter of the rest is the standard
error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from . import bspline
from .bspline import Float32, Runs
from .data import Beats, Bools, Finding, Floats, Ints, Masks, Movie

MARGIN_PX = 24
"""Distance from tissue and pillars, which move, shine and throw shadows."""
BORDER_PX = 12
"""Distance from the picture's border, so that a shift does not lead out of it."""
CELL_PX = 16
MOST_CELLS, FEWEST_CELLS = 24, 6
KNOT_PX = 64
MOST_STEPS, TOLERANCE_PX = 8, 0.005
"""One more step is taken in the end, over the cells that are kept."""
MOST_NOISE = 0.7
"""A cell shows texture where two frames of it differ by less than this share of its own variance (noise alone: 2)."""
ODD = 3.0
"""A cell does not belong to the background where its own shift is off by this many times the usual."""
MOST_FRAMES = 40
"""Longer movies are looked at in this many frames, and straight lines are drawn between them."""
LARGEST_ERROR_PX, SMALLEST_MOTION_PX = 0.05, 0.1
WITH_THE_BEAT = 0.7


@dataclass(frozen=True)
class StageMotion:
    """The stage's shift against the reference frame."""

    shift_px: Floats
    """(T, 2)"""
    error_px: float
    """Standard error of one component in one frame, root mean square over frames."""
    cells: int
    """Cells of background that it was measured on."""


def measure_stage(movie: Movie, masks: Masks, reference_frame: int) -> StageMotion | None:
    """Measure the rigid shift of the background in every frame; None where the background does not show it.

    It is shown where there is background well away from tissue and pillars, with texture enough for a standard error
    below 0.05 px.
    """
    pillars = [m for name, m in movie.supplied_masks.items() if name.startswith("pillar")]
    reference = np.asarray(movie.frames[reference_frame], np.float32)
    cells = _cells(reference, np.logical_or.reduce([masks.tissue, *pillars]))
    if cells is None:
        return None
    patch = _Patches(reference, cells)
    chosen = np.unique(np.linspace(0, movie.count - 1, min(movie.count, MOST_FRAMES)).astype(int))
    shift, right = np.zeros((len(chosen), 2)), np.zeros((len(chosen), patch.count, 2))
    noise = np.zeros((len(chosen), patch.count))
    start: Floats = np.zeros(2)
    for i, t in enumerate(chosen):
        start, right[i], noise[i] = patch.register(np.asarray(movie.frames[int(t)], np.float32), start)
        shift[i] = start
    textured = np.median(noise, axis=0) < MOST_NOISE
    if textured.sum() < FEWEST_CELLS:
        return None
    own = np.einsum("nij,tnj->tni", np.linalg.inv(patch.normal), right)  # what each cell would add to the shift
    away = np.sqrt((own**2).sum(axis=2).mean(axis=0))
    good = textured & (away < ODD * np.median(away[textured]))
    if good.sum() < FEWEST_CELLS:
        return None
    shift += np.linalg.solve(patch.normal[good].sum(axis=0), right[:, good].sum(axis=1).T).T
    weight = np.trace(patch.normal[good], axis1=1, axis2=2)
    weight /= weight.sum()
    scatter = own[:, good] - (weight[:, None] * own[:, good]).sum(axis=1, keepdims=True)
    error = float(np.sqrt(((weight**2)[:, None] * scatter**2).sum(axis=1).mean()))
    if not error < LARGEST_ERROR_PX:
        return None
    every = np.stack([np.interp(np.arange(movie.count), chosen, s) for s in shift.T], axis=1)
    return StageMotion(every, error, int(good.sum()))


def stage_finding(stage: StageMotion | None, beats: Beats) -> tuple[Finding, ...]:
    """Say that the stage moves, where it does by more than 0.1 px and clearly more than the error."""
    if stage is None:
        return ()
    size = float(np.hypot(*np.ptp(stage.shift_px, axis=0)))
    if size < max(SMALLEST_MOTION_PX, 6 * stage.error_px):
        return ()
    fits = [abs(_together(s, beats.signal_px)) for s in stage.shift_px.T if np.ptp(s) > 0.5 * size]
    beating = len(beats) > 0 and max(fits, default=0.0) > WITH_THE_BEAT
    how = "in time with the beat, so the stage, or what holds the tissue, shakes" if beating else "so the stage drifts"
    return (Finding("stage_motion", "review" if beating else "info", f"the background moves by {size:.2g} px "
                    f"(standard error {stage.error_px:.1g} px), {how}", size, SMALLEST_MOTION_PX),)


def _together(shift: Floats, signal: Floats) -> float:
    """Correlation of two series (T,) without their trends; frames that were lost do not count."""
    seen = np.isfinite(signal)
    t = np.arange(len(signal))[seen]
    a, b = (s[seen] - np.polyval(np.polyfit(t, s[seen], 1), t) for s in (shift, signal))
    size = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _cells(reference: Float32, moving: Bools) -> Ints | None:
    """Mask (R, C) of the cells of background with most texture, numbered from 1; None where there are too few."""
    near = ndimage.distance_transform_edt(~moving) <= MARGIN_PX
    near[:BORDER_PX] = near[-BORDER_PX:] = near[:, :BORDER_PX] = near[:, -BORDER_PX:] = True
    near |= ndimage.binary_dilation(ndimage.binary_opening(reference == 0, iterations=2), iterations=4)  # padding
    rows, cols = (n // CELL_PX for n in reference.shape)

    def cut(image: Any) -> Any:
        part = image[:rows * CELL_PX, :cols * CELL_PX]
        return part.reshape(rows, CELL_PX, cols, CELL_PX).swapaxes(1, 2).reshape(rows * cols, -1)

    gr, gc = np.gradient(ndimage.gaussian_filter(reference, 1.0))
    rr, rc, cc = (cut(p).mean(axis=1) for p in (gr * gr, gr * gc, gc * gc))
    weakest = 0.5 * (rr + cc) - np.hypot(0.5 * (rr - cc), rc)  # texture in the direction that has least of it
    weakest[cut(near).any(axis=1)] = 0.0
    best = np.argsort(weakest)[::-1][:MOST_CELLS]
    best = best[weakest[best] > 0]
    if len(best) < FEWEST_CELLS:
        return None
    number = np.zeros(rows * cols, int)
    number[best] = np.arange(1, len(best) + 1)
    out = np.zeros(reference.shape, int)
    out[:rows * CELL_PX, :cols * CELL_PX] = np.kron(number.reshape(rows, cols), np.ones((CELL_PX, CELL_PX), int))
    return out


class _Patches:
    """The reference frame's cells, and their normal matrices."""

    def __init__(self, reference: Float32, cells: Ints) -> None:
        self.runs = Runs.of(cells > 0)
        row, col = self.runs.pixels()
        self.cell = cells[row, col] - 1
        self.count = int(cells.max())
        self.size = np.bincount(self.cell, minlength=self.count)
        self.table = bspline.knot_weights(KNOT_PX)
        self.knots = tuple(n // KNOT_PX + 5 for n in reference.shape)
        picture = _coefficients(reference)
        self.f = self._at(picture, np.zeros(2))
        self.variance = self._sums(self._centred(self.f) ** 2)
        slopes = np.empty((2, self.runs.count), np.float32)
        bspline.slopes(picture, *self.runs.arrays, *slopes)
        self.slope = np.stack([self._centred(s) for s in slopes], axis=1)
        products = self.slope[:, :, None] * self.slope[:, None, :]
        self.normal = np.stack([self._sums(p) for p in products.reshape(-1, 4).T], axis=1).reshape(-1, 2, 2)
        # Noise gives a cell some texture in every direction, so no matrix is singular; this is for drawn pictures.
        self.normal += 1e-9 * np.trace(self.normal.sum(axis=0)) * np.eye(2)

    def register(self, frame: Float32, start: Floats) -> tuple[Floats, Floats, Floats]:
        """Common shift (2,) of a frame; of each cell, the right-hand side (n, 2) that is left, and the share (n,) of
        its variance in the reference that differs."""
        picture, d = _coefficients(frame), start
        whole = self.normal.sum(axis=0)
        for _ in range(MOST_STEPS):
            left = self._centred(self._at(picture, d) - self.f)
            right = -np.stack([self._sums(s * left) for s in self.slope.T], axis=1)
            step = np.linalg.solve(whole, right.sum(axis=0))
            if np.abs(step).max() < TOLERANCE_PX:
                break
            d = d + np.clip(step, -1, 1)
        return d, right, self._sums(left**2) / np.maximum(self.variance, 1e-12)

    def _at(self, picture: Float32, shift: Floats) -> Float32:
        p = np.empty((2, *self.knots), np.float32)
        p[:] = shift[:, None, None]
        out = np.empty(self.runs.count, np.float32)
        bspline.pull_back(picture, *self.runs.arrays, self.table, 0, p, out)
        return out

    def _sums(self, values: Floats) -> Floats:
        return np.asarray(np.bincount(self.cell, values, self.count), float)

    def _centred(self, values: Floats) -> Floats:
        """Less the mean of each cell, for the light may change."""
        return np.asarray(values - (self._sums(values) / self.size)[self.cell])


def _coefficients(frame: Float32) -> Float32:
    out = np.array(frame, np.float32, order="C")
    bspline.prefilter(out)
    return out
