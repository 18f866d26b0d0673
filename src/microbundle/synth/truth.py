"""The beats of a synthetic movie as they really are, found from its exact motion.

A finite-element bundle under red noise is never quite at rest, a stage may drift and turn, and no camera sees an
unloaded state. So rest is read from the motion itself: what is left of the displacement after the best rigid motion
is taken off is the tissue's own deformation, and the tissue rests where that is small and does not change.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..data import Bools, Floats, Ints
from .render import Truth

SLOW = 0.015
"""The tissue rests where its deformation changes by less than this share of its range from frame to frame ..."""
SMALL = 0.08
"""... and is below this share; the paper's clipped cosine jumps from 0.1 to 0."""
PROMINENCE = 0.3
STILL_PX = 1e-4
"""Deformation below this is no motion."""


@dataclass(frozen=True)
class TrueBeats:
    """When the tissue beats and rests; T frames, B beats."""

    deformation_px: Floats
    """(T,): root mean square displacement over the tissue after the best rigid motion is taken off."""
    resting: Bools
    """(T,)"""
    start: Ints
    """(B,): frame after which a beat's window begins, in the middle of the rest before it."""
    peak: Ints
    """(B,): frame of the largest deformation."""
    stop: Ints
    """(B,): end of the window, in the middle of the rest after it."""
    complete: Bools
    """(B,): the tissue rests before and after it."""

    def __len__(self) -> int:
        return len(self.peak)

    def rest_frames(self, beat: int) -> Ints:
        """Frames of a beat's window in which the tissue rests; all of the movie's where it has none."""
        window = np.arange(self.start[beat], self.stop[beat])
        here = window[self.resting[window]]
        return here if len(here) else np.flatnonzero(self.resting)


def true_beats(truth: Truth, spacing_px: float = 8.0) -> TrueBeats:
    """Find beats and rests of a truth, over points of the tissue."""
    points = truth.points_px(spacing_px)
    signal = np.array([_deformation(points, truth.displacement_px(points, t)) for t in range(truth.motion.count)])
    return cut(signal)


def cut(signal: Floats) -> TrueBeats:
    """Cut a noise-free signal of deformation (T,) into beats."""
    from scipy.signal import find_peaks

    count = len(signal)
    height = float(signal.max())
    if height < STILL_PX:
        none = np.zeros(0, int)
        return TrueBeats(signal, np.ones(count, bool), none, none, none, np.zeros(0, bool))
    speed = np.abs(np.gradient(signal))
    resting = (signal <= SMALL * height) & (speed <= SLOW * height)
    if not resting.any():
        resting = signal <= signal.min() + 0.02 * height
    peaks = find_peaks(np.pad(signal, 1), prominence=PROMINENCE * height)[0] - 1
    edges = [0, *(int(p) for p in peaks), count - 1]
    cuts, rests = [], []
    for i, (a, b) in enumerate(pairwise(edges)):
        between = np.arange(a, b + 1)
        quiet = between[resting[between]]
        rests.append(len(quiet) > 0)
        if i == 0:
            cuts.append(0)
        elif i == len(edges) - 2:
            cuts.append(count)
        else:
            cuts.append(int(np.median(quiet)) if len(quiet) else int(a + np.argmin(signal[a:b + 1])))
    start, stop = np.array(cuts[:-1], int), np.array(cuts[1:], int)
    complete = np.array([x and y for x, y in pairwise(rests)], bool)
    return TrueBeats(signal, resting, start, np.array(peaks, int), stop, complete)


def _deformation(points: Floats, u: Floats) -> float:
    """Root mean square of displacement (N, 2) less its best rigid motion (for small turns)."""
    x = points - points.mean(axis=0)
    v = u - u.mean(axis=0)
    across = np.stack([-x[:, 1], x[:, 0]], axis=1)
    turn = float((across * v).sum() / (across**2).sum())
    # A turn by a larger angle also pulls points inward: cos - 1.
    return float(np.sqrt(np.mean((v - turn * across + 0.5 * turn**2 * x) ** 2) * 2))
