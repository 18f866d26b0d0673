"""What error to expect on one's own microscope: the user's tissue, moved by a known field, under the user's noise.

The relaxed frame of a real movie becomes the texture, its own tissue mask and axis place the motion, and the noise is
that of the movie itself, measured pixel by pixel from frames in which the tissue rests. The result is scored like
any validation movie, at several amplitudes.

Limits: the texture is one frame with its noise in it, low-passed at 0.4 cycles per pixel; noise is taken to be
independent from pixel to pixel and frame to frame (`Noise.correlation` says how far that holds); motion out of the
plane and changes of focus are left out. So the true error can be larger, hardly smaller.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage

from ..analysis import Analysis
from ..config import Config
from ..data import Bools, Floats, Image, Movie
from ..errors import CannotMeasure
from ..mask import find_masks
from ..pipeline import analyze
from ..read import calibrated, prepare
from ..reference import find_relaxed_frame
from .cases import Case
from .motion import Inclusion, Motion, Rhythm, RigidMotion, TissueMotion
from .noise import NoiseModel
from .scenes import UM_PER_PX, USUAL_FRAMES, Domain, Picture

AMPLITUDES_PX = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Peaks over time of the mean absolute displacement of the whole tissue."""
MAX_STRAIN = 0.2
"""Amplitudes that would shorten the tissue by more than this somewhere are left out."""
MARGIN_PX = 48
TRIPLES = 40
LEVELS = 12
FEWEST_FRAMES = 5


@dataclass(frozen=True)
class Noise:
    """The noise of a movie from frame to frame; amounts are shares of full scale."""

    model: NoiseModel
    """Shot and read noise that fit it."""
    ground: float
    """Standard deviation outside the tissue."""
    tissue: float
    """Standard deviation in the tissue at rest."""
    correlation: float
    """Correlation of the noise of neighbouring pixels; 0 for an ideal camera, more after compression or binning."""


@dataclass(frozen=True)
class Framed:
    """A real relaxed frame in analytic motion; a Scene."""

    amplitude_px: float
    """Peak of the mean absolute displacement of the whole tissue, at a beat of usual strength."""
    digest: str
    """Hash of the frame and its mask."""
    um_per_px: float = UM_PER_PX
    frames: int = 84
    seed: int = 0
    shown: Picture | None = field(default=None, repr=False, compare=False)

    @property
    def rhythm(self) -> Rhythm:
        """When it beats."""
        return Rhythm(self.frames, 24.0, amplitude_variation=0.05, period_variation=0.03, seed=self.seed)

    def prepare(self) -> None:
        """See `Scene.prepare`; nothing is slow here."""

    def picture(self) -> Picture:
        """See `Scene.picture`."""
        if self.shown is None:
            raise ValueError("Framed: expected a picture")
        return self.shown

    def domain(self, picture: Picture) -> Domain:
        """See `Scene.domain`."""
        return Domain(picture.center_px, min(90.0, 1.6 * picture.half_width_px), picture.angle_deg)

    def motion(self, picture: Picture) -> tuple[Motion, RigidMotion | None]:
        """See `Scene.motion`."""
        return self._moved(picture, self.amplitude_px / self._unit_mad(picture)), None

    def largest_strain(self) -> float:
        """Largest shortening along the axis, about."""
        picture = self.picture()
        return 1.65 * self.amplitude_px / self._unit_mad(picture) / picture.half_length_px

    def _moved(self, picture: Picture, peak_px: float, rhythm: Rhythm | None = None) -> TissueMotion:
        middle = self.domain(picture).points_px[3].mean(axis=0)
        passive = Inclusion((float(middle[0]), float(middle[1])), 0.2 * picture.half_width_px)
        return TissueMotion(rhythm or self.rhythm, picture.center_px, picture.half_length_px, picture.half_width_px,
                            peak_px, angle_deg=picture.angle_deg, inclusion=passive)

    def _unit_mad(self, picture: Picture) -> float:
        points = np.argwhere(picture.tissue)[::37].astype(float)
        unit = self._moved(picture, 1.0, Rhythm(USUAL_FRAMES, 24.0))
        peaks = np.rint(unit.rhythm.peak_frames).astype(int)
        near = {int(t) for p in peaks for t in range(p - 1, p + 3) if 0 <= t < unit.count}
        return max(float(np.hypot(*unit.displacement_px(points, t).T).mean()) for t in near)


def texture_cases(movie: Movie, config: Config, amplitudes_px: Sequence[float] = AMPLITUDES_PX,
                  seeds: Sequence[int] = (0, 1)) -> tuple[tuple[Case, ...], Noise]:
    """Make a case of each amplitude and seed from a real movie, and tell the noise that was found in it.

    Raises CannotMeasure where the movie is too short to tell its noise, and what `analyze` raises.
    """
    analysis = analyze(movie, config)
    movie = prepare(calibrated(movie, config.fps, config.um_per_px), config.reading)
    top = full_scale(analysis.image)
    noise = measure_noise(movie, analysis, top)
    picture = framed(analysis.image / top, analysis.masks.tissue, analysis.masks.axis.center_px,
                     analysis.masks.axis.angle_deg, analysis.masks.axis.length_px, analysis.masks.axis.width_center_px)
    cases = []
    for scene in (framed_scene(picture, a, s) for a in amplitudes_px for s in seeds):
        if scene.largest_strain() <= MAX_STRAIN:
            cases.append(Case(f"{movie.name}-{scene.amplitude_px:g}px-{scene.seed}", f"{scene.amplitude_px:g} px",
                              scene, replace(noise.model, seed=scene.seed)))
    return tuple(cases), noise


def framed_scene(picture: Picture, amplitude_px: float, seed: int, frames: int = 84) -> Framed:
    """Make the scene of a real picture in motion."""
    return Framed(amplitude_px, _digest(picture), frames=frames, seed=seed, shown=picture)


def relaxed_picture(movie: Movie, config: Config) -> Picture:
    """Take the relaxed frame of a real movie for a picture, with its tissue and axis; nothing is tracked."""
    movie = prepare(calibrated(movie, config.fps, config.um_per_px), config.reading)
    masks = find_masks(movie, config.mask, axis_deg=config.axis_deg)
    image = movie.frames[find_relaxed_frame(movie, masks, config)]
    return framed(image / full_scale(image), masks.tissue, masks.axis.center_px, masks.axis.angle_deg,
                  masks.axis.length_px, masks.axis.width_center_px)


def framed(image: Floats, tissue: Bools, center_px: Floats, angle_deg: float, length_px: float,
           width_px: float) -> Picture:
    """Cut a relaxed frame to its tissue and a margin, and place the two pillars where bundles have them."""
    rows, cols = np.flatnonzero(tissue.any(axis=1)), np.flatnonzero(tissue.any(axis=0))
    r0, c0 = max(int(rows[0]) - MARGIN_PX, 0), max(int(cols[0]) - MARGIN_PX, 0)
    box = slice(r0, int(rows[-1]) + MARGIN_PX + 1), slice(c0, int(cols[-1]) + MARGIN_PX + 1)
    inner = tissue[box]
    return Picture(np.asarray(image[box], float), inner, ndimage.binary_fill_holes(inner), (),
                   (float(center_px[0]) - r0, float(center_px[1]) - c0), 0.37 * length_px, 0.5 * width_px, angle_deg)


def full_scale(image: Image) -> float:
    """Largest number that a frame's type holds; for floating point a little above its largest value."""
    if np.issubdtype(image.dtype, np.integer):
        return float(np.iinfo(image.dtype).max)
    return max(1.05 * float(image.max()), 1e-12)


def measure_noise(movie: Movie, analysis: Analysis, top: float) -> Noise:
    """Measure the noise of a movie from second differences in time, in frames in which the tissue rests.

    The variance of each pixel, by its brightness, is fitted by shot noise (proportional) and read noise (constant).
    Raises CannotMeasure for a movie of fewer than five frames.
    """
    count = movie.count
    if count < FEWEST_FRAMES:
        raise CannotMeasure(f"{movie.name}: expected at least {FEWEST_FRAMES} frames to tell the noise; found {count}")
    signal = analysis.beats.signal_px
    change = np.abs(np.convolve(signal, [1, -2, 1], mode="valid")) + np.abs(signal[2:] - signal[:-2])
    calm = np.sort(np.argsort(change, kind="stable")[:max(1, min(TRIPLES, (count - 2) // 3))])
    total, mean, beside, own = (np.zeros(movie.shape) for _ in range(4))
    for t in calm:
        a, b, c = (movie.frames[int(t) + k].astype(float) / top for k in range(3))
        d = (a - 2 * b + c) / np.sqrt(6)
        d -= np.median(d)                         # flicker of the lamp is no noise of the pixels
        total += d**2
        mean += b
        beside[:, 1:] += d[:, 1:] * d[:, :-1]
        own[:, 1:] += 0.5 * (d[:, 1:] ** 2 + d[:, :-1] ** 2)
    variance, mean = total / len(calm), mean / len(calm)
    tissue = analysis.masks.tissue
    ground = ~ndimage.binary_dilation(tissue, iterations=8)
    electrons, read = _fit(mean[tissue | ground], variance[tissue | ground])
    bits = 8 if np.dtype(movie.frames[0].dtype) == np.uint8 else 16
    model = NoiseModel(full_well_electrons=electrons, read_noise=read, bits=bits)  # type: ignore[arg-type]
    level = [float(np.sqrt(np.mean(variance[m]))) if m.any() else np.nan for m in (ground, tissue)]
    correlation = float(beside.sum() / own.sum()) if own.sum() > 0 else 0.0
    return Noise(model, level[0], level[1], correlation)


def _fit(brightness: Floats, variance: Floats) -> tuple[float | None, float]:
    """Full well in electrons (None for no shot noise) and read noise, from pixels' brightness and variance."""
    edges = np.quantile(brightness, np.linspace(0, 1, LEVELS + 1))
    level = np.clip(np.searchsorted(edges, brightness, side="right") - 1, 0, LEVELS - 1)
    used = [k for k in range(LEVELS) if (level == k).sum() >= 20]
    x = np.array([brightness[level == k].mean() for k in used])
    # The lower half of each level: pixels at edges that still move a little are above it.
    y = np.array([np.mean(variance[level == k][variance[level == k] <= np.quantile(variance[level == k], 0.9)])
                  for k in used])
    from scipy.optimize import nnls

    weight = 1 / np.maximum(y, 1e-12)
    slope, constant = nnls(np.stack([x, np.ones(len(x))], axis=1) * weight[:, None], y * weight)[0]
    return (1.0 / slope if slope > 1e-9 else None), float(np.sqrt(constant))


def _digest(picture: Picture) -> str:
    return hashlib.sha256(np.ascontiguousarray(picture.image).tobytes()
                          + np.packbits(picture.tissue).tobytes()).hexdigest()[:16]
