"""A plate of small synthetic movies with known truth: a drug of known effect, and faults on request.

    OUT/plate.csv     the manifest that `microbundle batch` takes: movie, group, plate, well, day, fps, um_per_px, ...
    OUT/truth.csv     what each movie really shows, and what must be reported of it
    OUT/A1.tif, ...   a movie for each well

Amplitude and rate of a well are those of a control, times the drug's effect at the well's dose (a Hill curve), times a
variation from well to well. Each well has a texture, a phase and a noise of its own; the motion has one shape for all,
the field of `TissueMotion` without delay, times the activation in time. So it is inverted once for the plate, at the
Chebyshev nodes of its strength. A well's picture is drawn exactly at the Chebyshev nodes between rest and its own
largest strength, and its frames are interpolated between those; the error is far below a grey level.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from pathlib import Path

import numpy as np
from scipy import ndimage

from ..data import Bools, Floats, Movie
from ..errors import ConfigError
from ..events import Progress, Tell, ignore
from ..folder import write_whole
from ..wells import PLATES, Place, well_name
from .motion import Motion, Rhythm, TissueMotion
from .plate_faults import FAULTS, GOOD, MOTIONLESS, write_movie
from .render import Rendered, SyntheticMovie, Tapered, Truth, invert
from .scenes import painted
from .texture import SplineTexture, band_limited

SHAPE, FRAMES, FPS, UM_PER_PX = (128, 192), 75, 30.0, 4.0
MANIFEST, TRUTH = "plate.csv", "truth.csv"
PLATE, DAY, COMPOUND, CONTROL = "P1", "14", "examplamide", "vehicle"
DOSES_UM = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Doses, column by column of the plate; 0 is the control."""
HALF_DOSE_UM, SLOPE = 1.0, 1.5
AMPLITUDE_LOST, RATE_GAINED = 0.6, 0.35
"""Effect of an endless dose, as shares of the control."""
PEAK_PX, RATE_HZ = 2.6, 1.4
"""Displacement of the pillars, and beats a second, of a usual control."""
AMPLITUDE_CV, RATE_CV, MOST_SD = 0.08, 0.04, 2.5
"""Standard deviations from well to well as shares of the mean, and how many of them a well is away at most."""
ACTIVE, RISE = 0.6, 0.42
"""Share of a beat with a twitch, and share of the twitch until its peak."""
BEAT_CV = 0.02
"""Variation of strength from beat to beat; that of the length is half of it."""
READ_NOISE = 0.001
BAND_PX, GROWN_PX = 20.0, 6
"""Width of the transition to still ground, and by how much what moves is larger than the tissue of one seed: the
outlines of all seeds lie within."""
STRENGTHS, PICTURES, PICTURES_A_PX = 9, 7, 3
"""Chebyshev nodes of the strength for the motion's inverse; for a well's pictures, and more for each px of strength."""
TOP = 4095
"""Largest count of the camera: 12 of 16 bits are used."""


@dataclass(frozen=True)
class Well:
    """One well of the plate, before it is drawn."""

    place: Place
    dose_um: float
    seed: int
    amplitude_px: float
    """Displacement of the pillars at the peak of a usual beat."""
    rate_hz: float
    fault: str | None = None

    @property
    def name(self) -> str:
        """Such as B3."""
        return well_name(self.place)

    @property
    def group(self) -> str:
        """Control or dose."""
        return CONTROL if self.dose_um == 0 else f"{self.dose_um:g} uM"


@dataclass(frozen=True)
class Scaled:
    """A displacement of one shape, times a strength in each frame."""

    unit: Motion
    """Its first frame is the displacement of strength 1."""
    strength: Floats
    """(T,)"""

    @property
    def count(self) -> int:
        """Number of frames T."""
        return len(self.strength)

    def displacement_px(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.displacement_px`."""
        return np.asarray(self.strength[frame] * self.unit.displacement_px(points_px, 0))

    def gradient(self, points_px: Floats, frame: int) -> Floats:
        """See `Motion.gradient`."""
        return np.asarray(np.eye(2) + self.strength[frame] * (self.unit.gradient(points_px, 0) - np.eye(2)))


def effect(dose_um: float) -> tuple[float, float]:
    """Factors by which a dose changes amplitude and rate."""
    share = 0.0 if dose_um == 0 else 1 / (1 + (HALF_DOSE_UM / dose_um) ** SLOPE)
    return 1 - AMPLITUDE_LOST * share, 1 + RATE_GAINED * share


def plate_wells(wells: int = 96, seed: int = 0, faults: bool = False) -> tuple[Well, ...]:
    """Lay out a plate: doses column by column, and with `faults` one of each kind, in at most half of the wells.

    A number of wells that no usual plate has fills the first columns of the smallest that holds them. Raises
    ConfigError for a number out of range.
    """
    if not 2 <= wells <= max(PLATES):
        raise ConfigError(f"wells: expected 2 to {max(PLATES)}; found {wells}")
    rows, columns = next(size for count, size in PLATES.items() if count >= wells)
    columns = min(columns, max(2, -(-wells // rows)))
    doses = DOSES_UM if columns >= len(DOSES_UM) else (0.0, *DOSES_UM[len(DOSES_UM) - columns + 1:])
    rng = np.random.default_rng(np.random.SeedSequence([seed, 61]))
    chosen = rng.permutation(wells)[:min(len(FAULTS), wells // 2)].tolist()
    spoilt = dict(zip(chosen, FAULTS, strict=False)) if faults else {}
    out = []
    for k in range(wells):
        place = divmod(k, columns)
        dose, fault = doses[place[1] % len(doses)], spoilt.get(k)
        strength, faster = effect(dose)
        vary = np.clip(rng.standard_normal(2), -MOST_SD, MOST_SD)
        amplitude_px = PEAK_PX * strength * (1 + AMPLITUDE_CV * float(vary[0]))
        out.append(Well(place, dose, int(rng.integers(1, 2**31)), 0.0 if fault == MOTIONLESS else amplitude_px,
                        RATE_HZ * faster * (1 + RATE_CV * float(vary[1])), fault))
    return tuple(out)


def render_plate(folder: Path | str, wells: int = 24, *, faults: bool = False, seed: int = 0,
                 tell: Tell = ignore) -> Path:
    """Render a plate into a new folder, whole or not at all, and return the path of its manifest.

    Takes about a third of a second and 3.7 MB a well (75 frames of 128 x 192 px). The same seed gives the same bytes.
    Raises ConfigError for a number of wells out of range, OutputError where the folder exists and is not empty, or
    cannot be written.
    """
    listed = plate_wells(wells, seed, faults)

    def write(into: Path) -> None:
        rows, truths = [], []
        for k, well in enumerate(listed):
            tell(Progress(f"well {well.name}", k / len(listed)))
            synthetic = draw_well(well)
            movie = write_movie(into, well.name, synthetic, well.fault)
            amplitude_um, rate_bpm = true_numbers(synthetic)
            told = GOOD if well.fault is None else FAULTS[well.fault]
            rows.append((movie, FPS, UM_PER_PX, PLATE, well.name, well.group, DAY, COMPOUND, f"{well.dose_um:g}"))
            truths.append((movie, well.name, well.group, f"{well.dose_um:g}", f"{amplitude_um:.6g}", f"{rate_bpm:.6g}",
                           well.fault or "", told.state, told.kind, "|".join(told.verdicts), told.finding,
                           "right" if told.right else "not to be trusted"))
        _write_rows(into / MANIFEST, ("movie", "fps", "um_per_px", "plate", "well", "group", "day", "compound",
                                      "dose_um"), rows)
        _write_rows(into / TRUTH, ("movie", "well", "group", "dose_um", "amplitude_um", "beat_rate_bpm", "fault",
                                   "state", "failure_kind", "verdict", "finding", "numbers"), truths)
        tell(Progress("done", 1.0))

    return write_whole(Path(folder), "simulation", write) / MANIFEST


def draw_well(well: Well) -> SyntheticMovie:
    """Draw a well without its fault; the movie has all its frames (T, R, C)."""
    rng = np.random.default_rng(np.random.SeedSequence([well.seed, 62]))
    electrons, flicker = float(np.exp(rng.uniform(np.log(8e3), np.log(4e4)))), float(rng.uniform(0.0005, 0.003))
    rhythm = Rhythm(FRAMES, FPS / well.rate_hz, first_beat=float(rng.uniform(0.05, 0.35)), active=ACTIVE, rise=RISE,
                    amplitude_variation=BEAT_CV, period_variation=BEAT_CV / 2, seed=well.seed)
    picture = painted(SHAPE, well.seed)
    texture = band_limited(picture.image)
    strength = well.amplitude_px * rhythm.activation(np.arange(FRAMES, dtype=float))[0]
    bright = (_frames(texture, strength) * (1 + flicker * rng.standard_normal((FRAMES, 1, 1)))).astype(np.float32)
    spread = np.sqrt(np.maximum(bright, 0) / electrons + READ_NOISE**2)
    bright += spread.astype(np.float32) * rng.standard_normal(bright.shape, np.float32)
    frames = np.rint(np.clip(bright, 0, 1) * TOP).astype(np.uint16)
    motion = Scaled(_unit(), strength)
    movie = Movie(name=well.name, frames=frames, shape=SHAPE, time_s=np.arange(FRAMES) / FPS, time_source="user",
                  um_per_px=UM_PER_PX, um_per_px_source="user")
    return SyntheticMovie(movie, Truth(motion, picture.tissue, FPS, UM_PER_PX, rhythm),
                          Rendered(texture, motion, SHAPE), picture.pillars)


def true_numbers(synthetic: SyntheticMovie) -> tuple[float, float]:
    """Mean displacement of the tissue in the frame at the peak, in um, as a mean over the beats that peak in the movie;
    and the beats a minute between these peaks."""
    truth, rhythm = synthetic.truth, synthetic.truth.rhythm
    assert rhythm is not None
    points, peaks = truth.points_px(), rhythm.peak_frames
    sides = [truth.mad_px(points, side(peaks).astype(int)) for side in (np.floor, np.ceil)]
    return float(np.maximum(*sides).mean()) * truth.um_per_px, 60 * truth.fps / float(np.diff(peaks).mean())


def _frames(texture: SplineTexture, strength: Floats) -> Floats:
    """Perfect frames (T, R, C) of a texture that is moved by the plate's field with these strengths (T,)."""
    moving, solved = _solved()
    top = max(float(strength.max()), 1e-9)
    nodes = top * _nodes(PICTURES + PICTURES_A_PX * ceil(top))
    rest = texture.sample(_pixels())
    pictures = [texture.sample(X) for X in np.tensordot(_between(_largest() * _nodes(STRENGTHS), nodes), solved, 1)]
    out = np.tile(rest, (len(strength), 1))
    out[:, moving] = _between(nodes, strength) @ np.stack(pictures)
    return out.reshape(len(strength), *SHAPE)


@lru_cache(maxsize=1)
def _unit() -> Tapered:
    """Displacement of strength 1, with which the pillars move by one pixel."""
    picture = painted(SHAPE, 1)
    at_peak = Rhythm(1, 10.0, first_beat=-ACTIVE * RISE, active=ACTIVE, rise=RISE)
    motion = TissueMotion(at_peak, picture.center_px, picture.half_length_px, picture.half_width_px, 1.0,
                          delay_frames=0.0)
    return Tapered(motion, ndimage.binary_dilation(picture.body, iterations=GROWN_PX), BAND_PX)


@lru_cache(maxsize=1)
def _solved() -> tuple[Bools, Floats]:
    """Pixels (R C,) that ever move, and the material points (K, N, 2) that these show at the nodes of the strength."""
    moving = _unit().weight(_pixels()) > 0
    return moving, np.stack([invert(Scaled(_unit(), np.array([strength])), _pixels()[moving], 0)
                             for strength in _largest() * _nodes(STRENGTHS)])


def _largest() -> float:
    """Strength that no beat of any well exceeds."""
    return PEAK_PX * (1 + MOST_SD * AMPLITUDE_CV) * (1 + 6 * BEAT_CV)


def _pixels() -> Floats:
    return np.argwhere(np.ones(SHAPE, bool)).astype(float)


def _nodes(count: int) -> Floats:
    """Chebyshev nodes of the second kind from 0 to 1."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1)))


def _between(nodes: Floats, places: Floats) -> Floats:
    """Matrix (M, K) of the polynomial interpolation from Chebyshev nodes (K,) to places (M,)."""
    weights = np.where(np.arange(len(nodes)) % 2, -1.0, 1.0)
    weights[[0, -1]] /= 2
    off = np.asarray(places)[:, None] - nodes
    hit = off == 0
    share = np.where(hit.any(axis=1, keepdims=True), hit, weights / np.where(hit, 1.0, off))
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _write_rows(file: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with file.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(header)
        table.writerows(rows)
