"""Pool all frames: keep the motion patterns that recur in time, and drop what is only noise.

The displacement of a beating tissue is a few spatial patterns times their courses in time (proper orthogonal
decomposition). In the metric of the registration's matrix noise is the same in every direction, so the patterns come
out strongest first. A pattern is kept where its course is smoother than noise could be, or where it stands far above
the noise and is not a single bad frame. Where nothing moves, none is kept. Nothing is smoothed in time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .bspline import Float32
from .data import Bools, Floats

FRAMES_AT_ONCE = 500
"""Longer movies are pooled in stretches, so that memory does not grow with the frames."""
MOST_MODES = 20
NOISE_FACTOR = 6.0
"""Standard deviations by which a beat must stand out."""
HEIGHT_SD = 2.8
"""Height of a twitch that lasts for half of each period, over the standard deviation of its course."""


@dataclass(frozen=True)
class Modes:
    """The temporal patterns that were kept."""

    course: Floats
    """(T, M): orthonormal courses in time of the kept modes; the mean is kept besides."""
    strength: Floats
    """(M,): size of each kept mode in the metric."""
    noise: float
    """Standard deviation of the noise of one frame in any one direction of the metric."""
    faintest: float
    """Peak size, in the metric, of the smallest beats that would stand out of this noise."""

    def project(self, series: Floats) -> Floats:
        """Keep of series (T, ...) their mean and what follows the kept courses."""
        flat = series.reshape(len(series), -1)
        mean = flat.mean(axis=0)
        kept = self.course @ (self.course.T @ (flat - mean)) + mean
        return np.asarray(kept.reshape(series.shape), series.dtype)


def find_modes(unknowns: Floats, factor: Float32) -> Modes:
    """Find the modes of unknowns (T, n) in the metric of the matrix whose Cholesky factor (D, n) is given as a band."""
    centred = unknowns - unknowns.mean(axis=0)
    weighted = np.zeros(centred.shape)
    width, n = factor.shape
    for d in range(min(width, n)):  # weighted = centred @ L, diagonal by diagonal
        weighted[:, :n - d] += centred[:, d:] * factor[d, :n - d]
    square, course = np.linalg.eigh(weighted @ weighted.T)
    strength = np.sqrt(np.maximum(square[::-1], 0.0))
    return _kept(course[:, ::-1], strength, len(unknowns), n)


def _kept(course: Floats, strength: Floats, frames: int, unknowns: int) -> Modes:
    strong = course[:, :MOST_MODES]
    smooth = (strong[1:] * strong[:-1]).sum(axis=0)
    noise = float(np.median(strength[:max(frames - 1, 1)])) * _edge(frames, unknowns)
    above = strength[:MOST_MODES] / max(noise, 1e-12)
    single = (strong**2).max(axis=0) > 0.5
    chance = 1 / np.sqrt(frames)  # standard deviation of the autocorrelation of white noise
    keep: Bools = (smooth > 3.5 * chance) | ((above > 1.3) & (smooth > 2.5 * chance)) | ((above > 4) & ~single)
    if keep.any():  # something moves, so what stands out of the noise is its finer detail, brief or not
        keep |= (above > 1.1) & ~single
    freedom = max(frames - 1 - int(keep.sum()), 1) * max(unknowns - int(keep.sum()), 1)
    discarded = (strength**2).sum() - (strength[:MOST_MODES][keep] ** 2).sum()
    noises = np.concatenate([strength[:MOST_MODES][~keep], strength[MOST_MODES:]]) ** 2
    return Modes(strong[:, keep], strength[:MOST_MODES][keep], float(np.sqrt(max(discarded, 0.0) / freedom)),
                 faintest_peak(noises[:max(frames - 1 - int(keep.sum()), 1)], frames))


def faintest_in(series: Floats) -> float:
    """Predict the peak size of the smallest beats that are found in series (T, n), from what is not smooth in them."""
    centred = series - series.mean(axis=0)
    square, course = np.linalg.eigh(centred @ centred.T)
    smooth = (course[1:] * course[:-1]).sum(axis=0) > 3.5 / np.sqrt(len(series))
    smooth[:-MOST_MODES] = False
    return faintest_peak(square[~smooth][1:], len(series))


def faintest_peak(noise_squares: Floats, frames: int) -> float:
    """Predict the peak size of the smallest beats that are found, half of them, in noise with the given squared
    singular values.

    The strongest pattern of noisy frames shows only a share of the beat's course; the share follows from the noise and
    from the number of directions it has (F. Benaych-Georges and R. Nadakuditi, J. Multivar. Anal. 111, 2012). It must
    be large enough for the course to stand NOISE_FACTOR standard deviations out of its own noise.
    """
    mean, spread = float(noise_squares.mean()), float(noise_squares.var())
    if mean <= 0.0:
        return 0.0
    directions = (len(noise_squares) + 1) * mean**2 / max(spread, 1e-12 * mean**2)
    b = frames / directions
    wrong = 1 / (1 + (NOISE_FACTOR / HEIGHT_SD) ** 2)
    squared = ((1 - wrong) * b + np.sqrt(((1 - wrong) * b) ** 2 + 4 * wrong * b)) / (2 * wrong)
    return float(HEIGHT_SD * np.sqrt(squared * mean / frames))


def _edge(frames: int, unknowns: int) -> float:
    """Largest over median singular value of pure noise (M. Gavish and D. Donoho, IEEE Trans. Inf. Theory 60, 2014)."""
    b = min(frames, unknowns) / max(frames, unknowns)
    return 0.56 * b**3 - 0.95 * b**2 + 1.82 * b + 1.43
