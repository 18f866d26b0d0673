"""Timing, size and speed of each beat of any signal: displacement, shortening, strain, force, calcium.

Between frames a signal is a cubic spline through its values. In each beat it is measured against its baseline: the
straight line through the mean of the relaxed frames before the peak and of those after it (of each rest the half
that lies farther from the peak), so that drift within the beat is no error. The peak is where the signal stands highest
above the baseline, and its height is the amplitude A. The level x % is the baseline plus x/100 of A; it is crossed
where the signal last passes it before the peak, and first after it. Times are those of the spline, not of frames.

Definitions: docs/metrics.md. Nothing here knows units: times are in frames (those of `clock`), and sizes in the
signal's own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .data import Beats, Bools, Floats

FINE = 16
"""Points between two frames at which the spline is looked at; straight lines join them."""
LEVELS = (10, 50, 90)
VELOCITY_WINDOW = 1.0
LEAST_KNOWN = 0.8
"""Share of a beat's frames that must be known."""
NAMES = ("amplitude", "peak_time", "onset_time", "half_rise_time", "time_to_peak", "time_to_peak_from_onset",
         "time_to_peak_from_valley", "relax50", "relax90", "t_up_20_80", "t_down_80_20", "contraction_velocity",
         "relaxation_velocity", "mean_contraction_velocity", "area")


def duration(level: int) -> str:
    """Name the contraction duration at a level of relaxation in percent: cd10, cd50, cd90."""
    return f"cd{level}"


def beat_shapes(signal: Floats, clock: Floats, beats: Beats, *, levels: Sequence[int] = LEVELS,
                velocity_window: float = VELOCITY_WINDOW) -> dict[str, Floats]:
    """Measure each beat of signals (T, n): name -> (B, n).

    `clock` (T,) is the time of each frame, in units of the median frame; contraction is positive. `velocity_window`, in
    frames, is the time over which a slope is taken, at least one frame. A number that the movie does not show is NaN: a
    peak at the movie's end, a level that is not crossed, a beat of which a fifth of the frames is missing. So are all
    numbers of a beat that was left out.
    """
    from scipy.interpolate import make_interp_spline

    count, parts = signal.shape
    names = (*NAMES, *(duration(level) for level in levels), "diastolic_interval")
    out = {name: np.full((len(beats), parts), np.nan) for name in names}
    known = np.isfinite(signal)
    usable = np.flatnonzero(known.sum(axis=0) > 3)
    if len(usable) == 0 or count < 4:
        return out
    curve = make_interp_spline(clock, np.stack([_filled(signal[:, i], clock) for i in usable], axis=1), k=3)
    ends = np.full((len(beats), parts), np.nan)
    for b, (start, stop) in enumerate(zip(beats.start, beats.stop, strict=True)):
        if beats.left_out[b]:  # so that no period, and no rest, begins or ends at it
            continue
        here = slice(int(start), int(min(stop + 1, count)))
        resting = _rest_lines(signal[here][:, usable], clock[here], beats.relaxed[here], float(clock[beats.peak[b]]))
        fine = np.linspace(clock[here][0], clock[here][-1], FINE * (here.stop - here.start - 1) + 1)
        shape = _Shape(fine, curve(fine) - resting(fine))
        half = 0.5 * max(velocity_window, 1.0)
        early, late = (np.clip(fine + side, clock[0], clock[-1]) for side in (-half, half))
        slope = (curve(late) - resting(late) - curve(early) + resting(early)) / (late - early)[:, None]
        measured = dict(_measure(shape, slope, levels))
        enough = known[here][:, usable].mean(axis=0) >= LEAST_KNOWN
        for name, values in measured.items():
            target = ends if name == "end" else out[name]
            target[b, usable] = np.where(enough, values, np.nan)
    out["diastolic_interval"][:-1] = out["onset_time"][1:] - ends[:-1]
    return out


@dataclass(frozen=True)
class _Shape:
    """One beat above its baseline: fine times (K,) and heights (K, n)."""

    time: Floats
    height: Floats

    @property
    def top(self) -> np.ndarray:
        """Index of the highest point (n,)."""
        return np.asarray(np.argmax(self.height, axis=0))

    def crossing(self, level: Floats, *, rising: bool) -> Floats:
        """Time (n,) at which heights last rise through levels (n,) before the peak, or first fall through them after
        it; NaN where they do not."""
        index = np.arange(len(self.time))[:, None]
        below = self.height <= level
        if rising:
            below &= index < self.top
            low = len(below) - 1 - np.argmax(below[::-1], axis=0)
            high = low + 1
        else:
            below &= index > self.top
            low = np.argmax(below, axis=0)
            high = low - 1
        there = below.any(axis=0)
        low, high = np.where(there, low, 1), np.where(there, high, 0)
        n = np.arange(self.height.shape[1])
        rise = self.height[high, n] - self.height[low, n]
        share = np.divide(level - self.height[low, n], rise, out=np.zeros(len(n)), where=rise != 0)
        return np.asarray(np.where(there, self.time[low] + share * (self.time[high] - self.time[low]), np.nan))


def _measure(shape: _Shape, slope: Floats, levels: Sequence[int]) -> Iterator[tuple[str, Floats]]:
    """Names and values (n,) of one beat; `end` is where it ends, at 10 % of its height."""
    top, n = shape.top, np.arange(shape.height.shape[1])
    amplitude = shape.height[top, n]
    seen = (top > 0) & (top < len(shape.time) - 1) & (amplitude > 0)
    amplitude = np.where(seen, amplitude, np.nan)
    inside = np.clip(top, 1, len(shape.time) - 2)
    left, here, right = (shape.height[inside + side, n] for side in (-1, 0, 1))
    peak = np.where(seen, shape.time[inside] + (shape.time[1] - shape.time[0]) * vertex(left, here, right), np.nan)
    rising = {x: shape.crossing(0.01 * x * amplitude, rising=True) for x in {10, 20, 50, 80, 90}}
    falling = {x: shape.crossing(0.01 * x * amplitude, rising=False) for x in {10, 20, 50, 80}}
    before = np.arange(len(shape.time))[:, None] <= top
    steepest = np.argmax(np.where(before, slope, -np.inf), axis=0)
    fastest = np.where(seen, slope[steepest, n], np.nan)
    onset = shape.time[steepest] - shape.height[steepest, n] / fastest
    valley = np.argmin(np.where(before, shape.height, np.inf), axis=0)
    yield "amplitude", amplitude
    yield "peak_time", peak
    yield "onset_time", onset
    yield "half_rise_time", rising[50]
    yield "time_to_peak", peak - rising[10]
    yield "time_to_peak_from_onset", peak - onset
    yield "time_to_peak_from_valley", peak - shape.time[valley]
    yield "relax50", falling[50] - peak
    yield "relax90", falling[10] - peak
    yield "t_up_20_80", rising[80] - rising[20]
    yield "t_down_80_20", falling[20] - falling[80]
    yield "contraction_velocity", fastest
    yield "relaxation_velocity", np.where(seen, np.where(before, np.inf, slope).min(axis=0), np.nan)
    yield "mean_contraction_velocity", 0.8 * amplitude / (rising[90] - rising[10])
    yield "area", np.where(seen, np.trapezoid(shape.height, shape.time, axis=0), np.nan)
    yield "end", falling[10]
    for level in levels:
        height = 0.01 * (100 - level) * amplitude
        yield duration(level), shape.crossing(height, rising=False) - shape.crossing(height, rising=True)


def vertex(left: Floats, here: Floats, right: Floats) -> Floats:
    """Place of the top of the parabola through three values one step apart, in steps from the middle one; 0 where the
    values do not bend down."""
    bend = left - 2 * here + right
    return np.asarray(np.divide(0.5 * (left - right), bend, out=np.zeros(np.shape(bend)), where=bend < 0))


@dataclass(frozen=True)
class _Line:
    """Straight lines in time: value (n,) at `at`, and slope (n,)."""

    at: float
    value: Floats
    slope: Floats

    def __call__(self, time: Floats) -> Floats:
        return self.value + (time - self.at)[:, None] * self.slope


def _rest_lines(signal: Floats, clock: Floats, relaxed: Bools, peak: float) -> _Line:
    """Baseline of a beat (t, n): through its rests on both sides; level where it has one rest, zero where none."""
    parts = signal.shape[1]
    rests = []
    usable = relaxed & np.isfinite(signal).all(axis=1)
    before, after = np.flatnonzero(usable & (clock < peak)), np.flatnonzero(usable & (clock > peak))
    # Of each rest the half that lies farther from the peak, where less of the beat's foot is left.
    for far in (before[:(len(before) + 1) // 2], after[len(after) // 2:]):
        if len(far):
            rests.append((float(clock[far].mean()), signal[far].mean(axis=0)))
    if not rests:
        return _Line(0.0, np.zeros(parts), np.zeros(parts))
    (t0, v0), (t1, v1) = rests[0], rests[-1]
    return _Line(t0, v0, (v1 - v0) / (t1 - t0) if t1 > t0 else np.zeros(parts))


def _filled(values: Floats, clock: Floats) -> Floats:
    """Values (T,) with straight lines over what is missing."""
    known = np.isfinite(values)
    return values if known.all() else np.interp(clock, clock[known], values[known])
