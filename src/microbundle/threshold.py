"""Thresholds that part a histogram into classes.

Source: N. Otsu, A threshold selection method from gray-level histograms, IEEE Trans. Syst. Man Cybern. 9, 1979.
"""

from __future__ import annotations

import numpy as np

from .data import Floats, Image

FLOAT_BINS = 256
THREE_CLASS_BINS = 64
"""Enough for a proposal; all pairs of bins are tried."""
LARGEST_EXACT_RANGE = 2**16
"""Whole numbers up to this range get one bin for each value."""


def otsu(values: Image, shift: float = 0.0) -> float:
    """Find the threshold that parts values, of any shape, into the two classes farthest apart (Otsu 1979).

    Whole numbers get one bin for each value, others 256 bins. `shift` moves the threshold by that share of the
    distance between the means of the classes. Raises ValueError where all values are equal.
    """
    center, count = _histogram(values)
    low, high = np.cumsum(count)[:-1], np.cumsum(count[::-1])[-2::-1]
    total = np.cumsum(count * center)
    mean_low = total[:-1] / low
    mean_high = (total[-1] - total[:-1]) / high
    best = int(np.argmax(low * high * (mean_high - mean_low) ** 2))
    return float(center[best] + shift * (mean_high[best] - mean_low[best]))


def otsu_cuts(values: Floats) -> tuple[float, float, float]:
    """Otsu's threshold for two classes, and his two for three, of values (n,) that are not all equal."""
    center, count = _histogram(values, THREE_CLASS_BINS)
    n, total = np.append(0.0, np.cumsum(count)), np.append(0.0, np.cumsum(count * center))
    i, j = np.triu_indices(len(center), 1)
    i, j = i[i > 0], j[i > 0]
    mid = n[j] - n[i]
    between = (total[i] ** 2 / n[i] + (total[j] - total[i]) ** 2 / np.maximum(mid, 1)
               + (total[-1] - total[j]) ** 2 / (n[-1] - n[j]))
    best = int(np.argmax(between))
    return otsu(values), float(center[i[best] - 1]), float(center[j[best] - 1])


def _histogram(values: Image, bins: int = FLOAT_BINS) -> tuple[Floats, Floats]:
    """Centres and counts of the bins; the first and the last bin are never empty."""
    values = np.asarray(values).ravel()
    low, high = values.min(), values.max()
    if low == high:
        raise ValueError(f"values: expected at least two different ones, found only {low}")
    if values.dtype.kind in "iu" and int(high) - int(low) < LARGEST_EXACT_RANGE:
        count = np.bincount(values.astype(np.int64) - int(low))
        return np.arange(int(low), int(high) + 1, dtype=float), count.astype(float)
    counts, edges = np.histogram(values.astype(float), bins)
    return 0.5 * (edges[1:] + edges[:-1]), counts.astype(float)
