"""One signed number per frame that says how far the tissue is contracted.

The signal is the projection of all displacements on their strongest common pattern (the first principal component
over time). Noise that differs from point to point averages out in it, and unlike a mean of lengths it is not pushed
up by noise. Its sign is chosen so that contraction is positive: the tissue gets shorter along its axis where that is
clear, else it rests for longer than it contracts.
"""

from __future__ import annotations

import numpy as np

from .data import Bools, Floats, Ints, known

MAX_POINTS = 250
CLEARLY_REPEATS = 0.8
"""White noise correlates with itself less than this, but for a handful of frames."""


def contraction_signal(displacement_px: Floats, points_px: Floats, direction: Floats) -> Floats:
    """Project displacements (T, N, 2) of points (N, 2) on their common pattern: (T,) in px, root mean square over
    points, contraction positive. `direction` (2,) is the tissue's axis. A still movie gives zeros.

    Points that are missing in a frame (NaN) take the median of the others there; frames without any, what lies
    between the frames around them.
    """
    step = max(1, len(points_px) // MAX_POINTS)
    u, x = displacement_px[:, ::step].astype(float), points_px[::step]
    flat = filled_in(u)
    moving = without_trend(flat)
    _, vectors = np.linalg.eigh(moving.T @ moving)
    pattern = vectors[:, -1]
    signal = flat @ pattern / np.sqrt(len(x))
    if not signal.any():
        return np.zeros(len(flat))
    return np.asarray(signal * _sign(without_trend(signal[:, None])[:, 0], pattern.reshape(-1, 2), x, direction))


def rest_weights(relaxed: Bools, peak: Ints) -> Floats:
    """Weigh the relaxed frames (T,) so that they give the relaxed state at the peak of each beat: (B, T), of sum 1.

    It is the mean of the rest before the peak and of that after it, joined by a straight line in time, so that steady
    drift cancels whatever the rests' lengths. A beat with a rest on one side only takes its mean; one without, the mean
    of all relaxed frames.
    """
    t, out = np.arange(len(relaxed)), np.zeros((len(peak), len(relaxed)))
    limits = [-1, *peak.tolist(), len(relaxed)]
    for b, top in enumerate(peak.tolist()):
        before, after = relaxed & (t > limits[b]) & (t < top), relaxed & (t > top) & (t < limits[b + 2])
        if before.any() and after.any():
            first, last = t[before].mean(), t[after].mean()
            out[b, before] = (last - top) / (last - first) / before.sum()
            out[b, after] = (top - first) / (last - first) / after.sum()
        else:
            some = before | after if (before | after).any() else relaxed
            out[b, some] = 1 / max(int(some.sum()), 1)
    return out


def rest_path(values: Floats, relaxed: Bools, times: Floats) -> Floats:
    """Join the relaxed states of series (T, ...), the mean of each run of relaxed frames, by straight lines in time."""
    edges = np.flatnonzero(np.diff(np.pad(relaxed.astype(np.int8), 1)))
    flat = values.reshape(len(values), -1)
    middles, means = [], []
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        if np.isfinite(flat[first:stop]).all(axis=1).any():
            middles.append(times[first:stop].mean())
            means.append(np.nanmean(flat[first:stop], axis=0))
    if not middles:
        return np.zeros(values.shape)
    level = np.stack(means, axis=1)
    return np.stack([np.interp(times, middles, one) for one in level], axis=1).reshape(values.shape)


def mean_absolute(displacement_px: Floats) -> Floats:
    """Average the lengths of displacements (T, N, 2) over the points that are known: (T,), NaN where none is."""
    seen = known(displacement_px)
    total = np.where(seen, np.hypot(displacement_px[..., 0], displacement_px[..., 1]), 0).sum(axis=1, dtype=float)
    return np.asarray(np.divide(total, seen.sum(axis=1), out=np.full(len(total), np.nan), where=seen.any(axis=1)))


def filled_in(displacement_px: Floats) -> Floats:
    """Fill what is missing in displacements (T, N, 2), first from the other points, then from other frames: (T, 2N)."""
    seen = known(displacement_px)
    some = seen.any(axis=1)
    if not some.any():
        return np.zeros((len(seen), 2 * seen.shape[1]))
    out = np.where(seen[..., None], displacement_px, np.nan)
    out[some] = np.where(seen[some][..., None], out[some], np.nanmedian(out[some], axis=1, keepdims=True))
    flat = out.reshape(len(out), -1)
    if not some.all():
        lost, there = np.flatnonzero(~some), np.flatnonzero(some)
        flat[lost] = np.stack([np.interp(lost, there, column) for column in flat[there].T], axis=1)
    return flat


def without_trend(series: Floats) -> Floats:
    """Subtract from each column of (T, n) its straight line in time, so that a drifting stage is not taken for the
    beat."""
    t = np.linspace(-1, 1, len(series))[:, None]
    centred = series - series.mean(axis=0)
    return np.asarray(centred - t * (t * centred).sum(axis=0) / max(float((t * t).sum()), 1e-12))


def _sign(signal: Floats, pattern: Floats, points_px: Floats, direction: Floats) -> float:
    """+1 where the pattern shortens the tissue, or where the positive side is the one visited briefly."""
    along = (points_px - points_px.mean(axis=0)) @ direction
    stretch = (pattern - pattern.mean(axis=0)) @ direction
    size = float(np.sqrt((stretch**2).sum() * (along**2).sum()))
    shortening = -float((along * stretch).sum()) / size if size > 0 else 0.0
    spread = float(signal.std())
    skew = float(np.mean((signal - signal.mean()) ** 3)) / spread**3 if spread > 0 else 0.0
    # Both are near 1 where they are clear; a rigid shift has no shortening, a sine wave no skew.
    vote = shortening + 0.5 * skew
    if abs(vote) < 0.05:
        return 1.0 if signal[0] <= np.median(signal) else -1.0
    return 1.0 if vote > 0 else -1.0


def frame_noise(signal: Floats) -> float:
    """Estimate the standard deviation of a signal's frame-to-frame noise from its quiet parts.

    The second difference removes slow change; its lower quartile comes from the frames in which the tissue rests.
    Where beats are so short that hardly any frame is quiet, what repeats from beat to beat is not noise either.
    """
    if len(signal) < 5:
        return float("nan")
    second = np.abs(signal[:-2] - 2 * signal[1:-1] + signal[2:])
    quiet = float(np.quantile(second, 0.25) / (0.3186 * np.sqrt(6.0)))  # quartile of |N(0, 1)|; 1 + 4 + 1
    steady = without_trend(signal[:, None])[:, 0]
    repeats = repeating_share(steady)
    return min(quiet, float(steady.std() * np.sqrt(1 - repeats))) if repeats > CLEARLY_REPEATS else quiet


def repeating_share(signal: Floats) -> float:
    """Correlation of a signal with itself one period later; the period is where it is largest, up to half the signal's
    length and after the correlation has first been negative."""
    lags = range(1, len(signal) // 2 + 1)
    correlation = np.array([_correlation(signal[:-lag], signal[lag:]) for lag in lags])
    negative = np.flatnonzero(correlation < 0)
    return float(correlation[negative[0]:].max()) if len(negative) else 0.0


def _correlation(one: Floats, other: Floats) -> float:
    size = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum()) / size if size > 0 else 0.0
