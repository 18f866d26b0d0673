"""Find the peaks of a signal by their prominence and distance, as `scipy.signal.find_peaks` does.

Loading scipy.signal costs a tenth of what a short movie costs, and this is all that is needed of it.
"""

from __future__ import annotations

import math

import numpy as np

from .data import Floats, Ints


def find_peaks(signal: Floats, *, prominence: float, distance: float = 1.0) -> Ints:
    """Find the peaks (P,) of a signal (T,): frames that are higher than those beside them; of a plateau its middle.

    Of peaks that lie nearer than `distance` frames the higher one stays. Then those stay that rise by `prominence`
    above the higher of the two valleys that separate them from higher ground, or from the ends.
    """
    peaks = _local_maxima(signal)
    kept = np.ones(len(peaks), bool)
    nearest = math.ceil(distance)
    for p in np.argsort(signal[peaks])[::-1]:
        if kept[p]:
            kept &= np.abs(peaks - peaks[p]) >= nearest
            kept[p] = True
    peaks = peaks[kept]
    peaks = peaks[signal[peaks] - signal.min(initial=np.inf) >= prominence]  # most of the noise ends here, soon
    return np.array([p for p in peaks if _prominence(signal, int(p)) >= prominence], int)


def _local_maxima(signal: Floats) -> Ints:
    """Middles of the stretches of equal values that are higher than both their neighbours; the ends are none."""
    starts = np.append(0, np.flatnonzero(signal[1:] != signal[:-1]) + 1)[:len(signal)]
    stops = np.append(starts[1:], len(signal))
    level = signal[starts]
    inner = np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])) + 1
    return np.asarray((starts[inner] + stops[inner] - 1) // 2)


def _prominence(signal: Floats, peak: int) -> float:
    higher = np.flatnonzero(signal > signal[peak])
    before, after = higher[higher < peak], higher[higher > peak]
    left = signal[before[-1] + 1 if len(before) else 0:peak + 1].min()
    right = signal[peak:after[0] if len(after) else len(signal)].min()
    return float(signal[peak] - max(left, right))
