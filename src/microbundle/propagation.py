"""How the contraction travels: a delay for each sub-domain, and the speed along the tissue.

The delay of a sub-domain is the time at which its E_cc passes half of its rise, less the median of those that shorten.
A straight front gives delay = s.x with the slowness s, fitted by least squares to the mean delays of the sub-domains'
centres x; its speed is 1/|s|. A camera cannot tell delays shorter than half a frame apart: where all of them lie within
that, there are none. A speed needs 100 frames/s, for cardiac tissue conducts over a whole microbundle within a few
hundredths of a second, and a slowness that stands out of its own error.
"""

from __future__ import annotations

import numpy as np

from .data import Floats

CLEAR_SHARE = 0.25
"""A sub-domain has a delay where its strain is at least this share of the largest."""
RESOLUTION_FRAMES = 0.5
"""Delays that all lie within this time are none."""
LEAST_FRAMES_PER_S = 100.0
"""Frame rate from which on a speed of conduction is given."""
FEWEST = 4
"""Sub-domains with a delay that a front is fitted to."""
CLEAR_ERRORS = 2.0
"""A slowness is a fact from this many of its standard errors on."""


def delays(half_rise_time: Floats, extreme: Floats) -> Floats:
    """Compute the time (B, S) by which each sub-domain contracts later than the middle one, in the unit of the times.

    NaN where a sub-domain hardly shortens; all NaN where the delays are below the time resolution.
    """
    late = np.full(half_rise_time.shape, np.nan)
    if np.isfinite(extreme).any():
        clear = extreme < CLEAR_SHARE * min(float(np.nanmin(extreme)), 0.0)
        rises = np.where(clear, half_rise_time, np.nan)
        for b in np.flatnonzero(np.isfinite(rises).any(axis=1)):
            late[b] = rises[b] - np.nanmedian(rises[b])
    return late if _extent(late) >= RESOLUTION_FRAMES else np.full(late.shape, np.nan)


def front(delay: Floats, center_px: Floats, frames_per_s: float | None) -> dict[str, Floats]:
    """Fit a straight front to delays (B, S) at centres (S, 2): `delay_range`, and of a movie that is fast enough
    `slowness_across` and `slowness_along` in frames a px, NaN where there are too few delays."""
    mean = _mean_delay(delay)
    out = {"delay_range": np.array(_extent(delay))}
    seen = np.isfinite(mean)
    slowness = np.full(2, np.nan)
    if frames_per_s is not None and frames_per_s >= LEAST_FRAMES_PER_S and seen.sum() >= FEWEST:
        x = center_px[seen] - center_px[seen].mean(axis=0)
        if np.linalg.matrix_rank(x, tol=1.0) == 2:
            slowness = np.linalg.lstsq(x, mean[seen] - mean[seen].mean(), rcond=None)[0]
    return out | {"slowness_across": slowness[0], "slowness_along": slowness[1]}


def speed(slowness: Floats, error: Floats) -> tuple[float, float, float, float]:
    """Turn a slowness (2,) and its standard error (2,) into the front's speed and direction, and their errors.

    Speed in px a frame, direction in degrees from the col axis towards +row; all NaN where the slowness does not stand
    out of its error, or that is not known.
    """
    size = float(np.hypot(*slowness))
    wrong = float(np.hypot(*(slowness * error))) / size if size > 0 else np.nan
    if not (size > CLEAR_ERRORS * wrong):
        return np.nan, np.nan, np.nan, np.nan
    across = float(np.hypot(*(slowness[::-1] * error))) / size
    return (1 / size, float(np.degrees(np.arctan2(slowness[0], slowness[1]))), wrong / size**2,
            float(np.degrees(across / size)))


def _mean_delay(delay: Floats) -> Floats:
    """Mean over beats (S,) of delays (B, S), of the sub-domains that have one in at least half of the beats."""
    seen = np.isfinite(delay)
    enough = seen.sum(axis=0) * 2 >= max(len(delay), 1)
    total = np.where(seen, delay, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, seen.sum(axis=0), out=np.full(delay.shape[1], np.nan), where=enough))


def _extent(delay: Floats) -> float:
    """Range of the mean delays over the sub-domains; 0 where there are fewer than two."""
    mean = _mean_delay(delay)
    mean = mean[np.isfinite(mean)]
    return float(np.ptp(mean)) if len(mean) > 1 else 0.0
