"""Signals as other tools would see them: of the tissue, of each pillar, and of the distance between two pillars.

A beat is told from its peak frame, the highest of the signal within the beat, and from the valleys, the lowest frames
between the peaks. Beats are those of this program. Source: what each tool measures stands in `compat_definitions`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from .analysis import Analysis
from .data import Bools, Floats, Ints
from .force import forces, stiffness
from .numbers import beat_signal, clock, seconds_per_frame
from .uncertainty import added_by_noise
from .waveform import LEAST_KNOWN

Named = dict[str, Floats]
KPA = 1e3
"""mN/mm2 in a uN/um2."""
NJ = 1e-3
"""nJ in a uN um."""


@dataclass(frozen=True)
class Trace:
    """A signal (T,) and its beats, B of them."""

    name: str
    size: str
    """Unit of the values."""
    values: Floats
    """(T,), straight lines over what is missing."""
    time: Floats
    """(T,): of each frame, in the tool's unit, or in frames where the times are unknown."""
    start: Ints
    stop: Ints
    whole: Bools
    """(B,): neither cut off by the movie, nor without a fifth of its frames."""
    pillar: str = ""
    more: Named | None = None
    """Numbers of the beats (B,) that do not follow from the signal alone."""

    @property
    def peak(self) -> Ints:
        """(B,): highest frame of each beat."""
        return np.array([first + int(np.argmax(self.values[first:stop])) for first, stop in
                         zip(self.start, self.stop, strict=True)], dtype=int)

    @property
    def valley(self) -> Ints:
        """(B + 1,): lowest frames before the first peak, between the peaks, and after the last."""
        edges = [0, *self.peak, len(self.values)]
        return np.array([first + int(np.argmin(self.values[first:stop])) if stop > first else first
                         for first, stop in pairwise(edges)], dtype=int)

    @property
    def peaked(self) -> Bools:
        """(B,): beats whose peak is higher than the frames beside it."""
        y, p = self.values, np.clip(self.peak, 1, len(self.values) - 2)
        return np.asarray((p == self.peak) & (y[p] > y[p - 1]) & (y[p] >= y[p + 1]))

    @property
    def usable(self) -> Bools:
        """(B,): whole beats with a peak."""
        return self.whole & self.peaked

    def at(self, frame: Floats | Ints) -> Floats:
        """Time of places between frames, in the unit of `time`; NaN stays NaN."""
        place = np.asarray(frame, float)
        return np.asarray(np.where(np.isfinite(place), np.interp(place, np.arange(len(self.time)), self.time), np.nan))

    def of_usable(self, values: Floats | Ints) -> Floats:
        """Values (B,) of usable beats, NaN of the others."""
        return np.asarray(np.where(self.usable, values, np.nan))

    def prominence(self) -> Floats:
        """Height (B,) of each peak above the higher of the lowest values on both sides up to the next higher peak."""
        from scipy.signal import peak_prominences

        out = np.full(len(self.start), np.nan)
        out[self.usable] = peak_prominences(self.values, self.peak[self.usable])[0]
        return out

    def passed(self, below: float) -> tuple[Floats, Floats]:
        """Times (B,) of the rise and the fall through a share of the prominence below each peak."""
        from scipy.signal import peak_widths

        out = np.full((2, len(self.start)), np.nan)
        out[:, self.usable] = peak_widths(self.values, self.peak[self.usable], rel_height=below)[2:]
        return self.at(out[0]), self.at(out[1])


def trace_of(analysis: Analysis, name: str, size: str, values: Floats, pillar: str = "", *,
             per_second: float = 1.0) -> Trace:
    """Make a signal (T,), NaN where it is missing, a trace. `per_second` is the tool's unit of time: 1000 for ms."""
    step, beats = seconds_per_frame(analysis), analysis.beats
    seen, t = np.isfinite(values), np.arange(len(values))
    filled = np.interp(t, t[seen], values[seen]) if seen.any() else np.zeros(len(values))
    stop = np.minimum(beats.stop, len(values))
    enough = np.array([seen[a:b].mean() >= LEAST_KNOWN for a, b in zip(beats.start, stop, strict=True)], dtype=bool)
    return Trace(name, size, filled, clock(analysis) * (1.0 if step is None else step * per_second), beats.start, stop,
                 beats.complete & enough, pillar)


def length_unit(analysis: Analysis) -> str:
    """Unit in which lengths are given."""
    return "px" if analysis.um_per_px is None else "um"


def tissue(analysis: Analysis, *, per_second: float = 1.0) -> Iterator[Trace]:
    """The mean absolute displacement, less what noise adds to a mean of lengths."""
    values = beat_signal(analysis) - added_by_noise(analysis, beat_signal)
    yield trace_of(analysis, "mean absolute displacement", length_unit(analysis), values * (analysis.um_per_px or 1.0),
                   per_second=per_second)


def between_pillars(analysis: Analysis) -> Iterator[Trace]:
    """How much nearer two pillars are than at the largest distance; the tissue where that is not known."""
    motion, um, k = analysis.pillars, analysis.um_per_px, stiffness(analysis.config.pillars)
    if motion is None or um is None or len(motion.pillars) != 2:
        yield from tissue(analysis)
        return
    place = motion.pillars.center_px + motion.shift_px
    distance = um * np.linalg.norm(place[:, 0] - place[:, 1], axis=1)
    trace = trace_of(analysis, "pillar distance", "um", np.nanmax(distance) - distance)
    rise = trace.prominence()
    active = trace.of_usable(distance[trace.peak])
    more = {"deflection [um]": rise, "active length [um]": active, "passive length [um]": active + rise}
    if k is not None:
        force = 0.5 * k * trace.of_usable(trace.values[trace.peak])
        width = um * analysis.masks.axis.width_center_px
        more |= {"active force [uN]": force, "active stress [mN/mm2]": KPA * force / (0.25 * np.pi * width**2)}
        unloaded = analysis.config.pillars.unloaded_px
        if unloaded is not None and len(unloaded) == 2:
            free = um * float(np.linalg.norm(np.subtract(*unloaded)))
            most, least = free - active, free - active - rise
            more |= {"total force [uN]": 0.5 * k * most, "passive tension [uN]": 0.5 * k * least,
                     "work per contraction cycle [nJ]": NJ * 0.25 * k * (most**2 - least**2)}
    yield replace(trace, more=more)


def each_force(analysis: Analysis) -> Iterator[Trace]:
    """The force of each pillar; the tissue where no force is known."""
    found, motion = forces(analysis), analysis.pillars
    if found is None or motion is None or np.isnan(found.un_per_px):
        yield from tissue(analysis)
        return
    for p, name in enumerate(motion.pillars.names):
        yield trace_of(analysis, "pillar force", "uN", found.along_px[:, p] * found.un_per_px, name)


def each_pillar(analysis: Analysis) -> Iterator[Trace]:
    """How far each pillar is from its place in the reference frame, and the force of that where it is known; nothing
    without pillars."""
    motion, found = analysis.pillars, forces(analysis)
    if motion is None or found is None:
        return
    um, depth = analysis.um_per_px, analysis.config.pillars.depth_um
    away = np.linalg.norm(motion.shift_px, axis=2) * (um or 1.0)
    traces = [trace_of(analysis, "pillar displacement", length_unit(analysis), away[:, p], name)
              for p, name in enumerate(motion.pillars.names)]
    for trace in traces:
        if um is None or np.isnan(found.un_per_px):
            yield trace
            continue
        per_um = found.un_per_px / um
        more = {"pillar_force_abs (uN)": per_um * trace.of_usable(trace.values[trace.peak])}
        if depth is not None:
            force = per_um * np.mean([t.values for t in traces], axis=0)
            most = np.array([force[a:b].max() for a, b in zip(trace.start, trace.stop, strict=True)])
            more["tissue_stress (MPa)"] = trace.of_usable(most / (um * analysis.masks.axis.width_center_px * depth))
        yield replace(trace, more=more)
