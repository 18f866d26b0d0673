"""What pictures show of a result, in the units they show it in, each computed once.

Lengths are in micrometres and times in seconds where the calibration is known, else in px and frames. Maps are means
over the whole beats at their peaks, or one beat; each beat counts from its own relaxed state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np

from .analysis import Analysis
from .data import Bools, Floats, Ints
from .errors import ConfigError
from .force import forces
from .levels import level_values
from .motion import Motion
from .numbers import beat_signal, clock, end_distance, seconds_per_frame, shapes_of
from .uncertainty import standard_errors

MARGIN = 0.06
"""Room around tissue and pillars in a picture, as a share of their longer side."""
BEYOND = 3
"""Points by which a map goes on beyond the tissue."""
MOST_POINTS = 60_000
"""Points of a map: a picture of 85 mm shows no more."""


class Shown:
    """A result as pictures show it. `beat` picks one beat for the maps; without it they are means over whole beats.

    Raises ConfigError for a beat that does not exist.
    """

    def __init__(self, analysis: Analysis, beat: int | None = None) -> None:
        self.analysis, self.beat = analysis, beat
        if beat is not None and not 0 <= beat < len(analysis.beats):
            raise ConfigError(f"beat: expected a number from 0 to {len(analysis.beats) - 1}; found {beat}")

    @property
    def px(self) -> float:
        """Size of a pixel in the unit of length."""
        return 1.0 if self.analysis.um_per_px is None else self.analysis.um_per_px

    @property
    def length_unit(self) -> str:
        return "px" if self.analysis.um_per_px is None else "µm"

    @property
    def time_unit(self) -> str:
        return "frames" if self.analysis.time_s is None else "s"

    @cached_property
    def time(self) -> Floats:
        """Time of each frame (T,) from the first one, in the unit of time."""
        return self.times(clock(self.analysis))

    def times(self, frames: Floats) -> Floats:
        """Turn times on the clock of the numbers into the unit of time."""
        step = seconds_per_frame(self.analysis)
        return np.asarray(frames if step is None else frames * step)

    @cached_property
    def beats(self) -> Ints:
        """The beats that are shown: the one asked for, the whole ones, or, where there are none, all."""
        if self.beat is not None:
            return np.array([self.beat])
        whole = np.flatnonzero(self.analysis.beats.complete)
        return whole if len(whole) else np.arange(len(self.analysis.beats))

    @property
    def beats_text(self) -> str:
        if self.beat is not None:
            return f"beat {self.beat}"
        return "one beat" if len(self.beats) == 1 else f"mean of {len(self.beats)} beats"

    @cached_property
    def box(self) -> tuple[int, int, int, int]:
        """First row, end row, first column and end column of the part of the image that is shown: the tissue and the
        pillars, with a margin."""
        seen = self.analysis.masks.tissue.copy()
        if self.analysis.pillars is not None:
            for mask in self.analysis.pillars.pillars.masks:
                seen |= mask
        rows, cols = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
        room = int(np.ceil(MARGIN * max(np.ptp(rows), np.ptp(cols)))) + 1
        r, c = seen.shape
        return (max(int(rows[0]) - room, 0), min(int(rows[-1]) + room + 1, r),
                max(int(cols[0]) - room, 0), min(int(cols[-1]) + room + 1, c))

    @cached_property
    def picture(self) -> Floats:
        """The relaxed image within the box, from black 0 to white 1."""
        r0, r1, c0, c1 = self.box
        part = np.asarray(self.analysis.image[r0:r1, c0:c1], float)
        low, high = np.percentile(part, [0.5, 99.5])
        return np.asarray(np.clip((part - low) / max(high - low, 1e-12), 0, 1))

    @cached_property
    def peak_displacement(self) -> tuple[Floats, Bools]:
        """Displacement (A, B, 2) at the peak in the unit of length, on a lattice that fills the box, and which points
        are tissue (A, B). It goes on for a few pixels beyond the tissue, so that maps reach its edge."""
        from scipy.ndimage import binary_dilation

        r0, r1, c0, c1 = self.box
        step = max(1.0, np.sqrt((r1 - r0) * (c1 - c0) / MOST_POINTS))
        rows, cols = (np.linspace(a, b - 1, max(round((b - a) / step), 2)) for a, b in ((r0, r1), (c0, c1)))
        points = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
        shape = len(rows), len(cols)
        inside = self.analysis.inside(points).reshape(shape)
        near = binary_dilation(inside, iterations=BEYOND)
        moved = np.full((*shape, 2), np.nan)
        motion = Motion(self.analysis, points[near.ravel()])
        moved[near] = np.mean([motion.from_rest(int(b)) for b in self.beats], axis=0)
        return moved * self.px, inside

    @cached_property
    def signal(self) -> Floats:
        """Mean absolute displacement (T,) from the movie's relaxed state, in the unit of length."""
        return np.asarray(self.analysis.beats.signal_px * self.px)

    @cached_property
    def half_rise(self) -> Floats:
        """Time (B,) at which each beat passes half of its rise, in the unit of time; where it is not known, the time of
        its peak frame."""
        signal = beat_signal(self.analysis)[:, None]
        found = shapes_of(self.analysis, {"beat": signal})["beat"]["half_rise_time"][:, 0]
        return np.where(np.isfinite(found), self.times(found), self.time[self.analysis.beats.peak])

    def frames_of(self, beat: int) -> slice:
        """Frames of one beat."""
        return slice(int(self.analysis.beats.start[beat]), int(self.analysis.beats.stop[beat]))

    def overlaid(self, values: Floats) -> list[tuple[Floats, Floats]]:
        """Times from the half rise and values (t, ...) of each beat that is shown."""
        return [(self.time[self.frames_of(b)] - self.half_rise[b], values[self.frames_of(b)]) for b in self.beats]

    @cached_property
    def strain(self) -> Floats:
        """E (S, 2, 2) of each sub-domain at the peak; only for a result with strain."""
        assert self.analysis.strain is not None
        each = self.analysis.strain.E[self.analysis.beats.peak[self.beats]]
        return mean_of_known(each)

    @cached_property
    def principal(self) -> tuple[Floats, Floats]:
        """Principal strains (S, 2) of the mean strain, smaller first, and the angle (S,) in degrees of the first one
        in the image, from the col axis towards +row."""
        strain = self.analysis.strain
        assert strain is not None
        value, vector = np.linalg.eigh(np.nan_to_num(self.strain))
        angle = np.degrees(np.arctan2(vector[:, 0, 0], vector[:, 1, 0])) + strain.angle_deg
        value[~np.isfinite(self.strain).all(axis=(1, 2))] = np.nan
        return value, angle

    @cached_property
    def delay(self) -> Floats:
        """Delay (S,) of each sub-domain, in the unit of time; NaN where it has none."""
        values = level_values(self.analysis, nulls=False)["subdomain"]
        return self.times(mean_of_known(values["delay"][self.beats]))

    @cached_property
    def pillar_path(self) -> Floats:
        """Deflection (T, P) of the pillars along their own motion, in the unit of length."""
        found = forces(self.analysis)
        assert found is not None
        return found.along_px * self.px

    @cached_property
    def un_per_length(self) -> float:
        """Force of a pillar in uN for a unit of length; NaN where it is not known."""
        found = forces(self.analysis)
        return float("nan") if found is None else found.un_per_px / self.px

    @cached_property
    def length(self) -> Floats:
        """Distance (T,) between the tissue's ends, in the unit of length."""
        return end_distance(self.analysis)[0] * self.px

    @cached_property
    def errors(self) -> Mapping[str, Floats]:
        """Standard errors, in the units of the values, of `signal` (T,), `E` (T, S, 2, 2) and `pillar_path` (T, P);
        empty where the method does not know them."""
        return standard_errors(self.analysis, _with_errors(self.px))


def _with_errors(px: float) -> Callable[[Analysis], dict[str, Floats]]:
    def numbers(analysis: Analysis) -> dict[str, Floats]:
        found, strain = forces(analysis), analysis.strain
        return {"signal": analysis.beats.signal_px * px, **({} if strain is None else {"E": strain.E}),
                **({} if found is None else {"pillar_path": found.along_px * px})}

    return numbers


def mean_of_known(values: Floats) -> Floats:
    """Mean over the first axis of what is known; NaN where nothing is."""
    seen = np.isfinite(values)
    total = np.where(seen, values, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, seen.sum(axis=0), out=np.full(total.shape, np.nan), where=seen.any(axis=0)))
