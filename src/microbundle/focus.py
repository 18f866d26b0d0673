"""Tell motion from a focus that breathes.

When the focus changes, every grain of the texture swells or shrinks in its place, and seems to move by some hundredths
of a pixel. Such a movement has no part that the whole tissue shares, and goes with the sharpness of the frames; that of
a beating tissue is mostly shared, whatever its sharpness does.
"""

from __future__ import annotations

import numpy as np

from .data import Bools, Floats, Frames, known

SMALLEST_SHARE = 0.35
"""Of beating tissues, shifts, turns and even strain make up 0.43 to 0.9; of a breathing focus 0.04 to 0.27."""
LARGEST_PX = 0.2
"""A breathing focus moves nothing farther; where it was seen, by 0.03 px."""
CLEARLY = 0.8
"""Correlation of the signal with sharpness."""
MOST_FRAMES = 120


def shared_part(displacement_px: Floats, points_px: Floats) -> float:
    """Compute the share, from 0 to 1, of the mean square of displacements (N, 2) at points (N, 2) that a shift, a turn
    and an even strain make up."""
    seen = known(displacement_px) & known(points_px)
    u, x = displacement_px[seen], points_px[seen]
    affine = np.concatenate([np.ones((len(x), 1)), x - x.mean(axis=0)], axis=1)
    left = u - affine @ np.linalg.lstsq(affine, u, rcond=None)[0]
    return float(1 - (left**2).sum() / max(float((u**2).sum()), 1e-300))


def sharpness_correlation(frames: Frames, tissue: Bools, signal: Floats) -> float:
    """Correlate a signal (T,) with the sharpness of the frames: mean squared slope in the tissue (R, C), over the mean
    squared."""
    chosen = np.unique(np.linspace(0, len(signal) - 1, MOST_FRAMES).astype(int))
    rows, cols = np.flatnonzero(tissue.any(axis=1)), np.flatnonzero(tissue.any(axis=0))
    box = np.s_[rows[0]:rows[-1] + 1, cols[0]:cols[-1] + 1]
    inside = tissue[box]
    sharpness = np.empty(len(chosen))
    for i, t in enumerate(chosen):
        frame = frames[int(t)][box].astype(np.float32)
        # Over two pixels, so that the camera's noise weighs less.
        slopes = (frame[2:, 1:-1] - frame[:-2, 1:-1]) ** 2 + (frame[1:-1, 2:] - frame[1:-1, :-2]) ** 2
        sharpness[i] = slopes[inside[1:-1, 1:-1]].mean() / max(float(frame[inside].mean()) ** 2, 1e-300)
    both = np.isfinite(signal[chosen]) & np.isfinite(sharpness)
    if both.sum() < 5 or sharpness[both].std() == 0 or signal[chosen][both].std() == 0:
        return 0.0
    return float(np.corrcoef(signal[chosen][both], sharpness[both])[0, 1])
