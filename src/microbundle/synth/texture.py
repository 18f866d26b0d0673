"""Pictures that can be sampled at any point, the paint of a synthetic movie.

Three kinds. `band_limited` makes one of a real frame: a low-pass filter removes what a shift by a part of a pixel
would alias, and the result is kept on a grid twice as fine with a quintic B-spline through it, so that the picture
between pixels is known to about 1e-5 of its contrast. `Gratings` is a sum of sinusoids, whose value is known at any
point without interpolation; tests hold the renderer against it. `procedural_tissue` paints a bundle from a seed, for
movies that need no real data: its proportions, grey levels and power spectrum follow a brightfield frame of a Type 1
bundle (512 x 512 pixels at 4 um/px).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import fft, ndimage

from ..data import Bools, Floats

_FINER = 2
"""Samples per pixel of a spline texture. Quintic interpolation of a wave of f cycles per sample is off by about
(f/(1-f))^6 of its amplitude: 0.03 at f = 0.36, but 1e-4 at half of it."""


class Texture(Protocol):
    """A picture of the relaxed tissue that is defined at every point."""

    def sample(self, points_px: Floats) -> Floats:
        """Brightness (N,) at points (N, 2)."""
        ...


@dataclass(frozen=True)
class SplineTexture:
    """A picture on a grid with a quintic B-spline through it; made by `band_limited`."""

    coefficients: Floats
    """B-spline coefficients on a grid finer than the pixels, with a border around the picture."""
    border_px: int
    shape: tuple[int, int]
    """Rows and columns of the picture, in pixels."""
    cut_off: float
    """Highest frequency it holds, in cycles per pixel."""

    def sample(self, points_px: Floats) -> Floats:
        """Brightness (N,) at points (N, 2); further out than the border it stays what it is at the border."""
        where = (np.asarray(points_px, float).T + self.border_px) * _FINER
        return np.asarray(ndimage.map_coordinates(self.coefficients, where, order=5, mode="nearest", prefilter=False))


@dataclass(frozen=True)
class Gratings:
    """A sum of sinusoids, known exactly at every point."""

    frequency: Floats
    """(K, 2): cycles per pixel along (row, col)."""
    amplitude: Floats
    """(K,)"""
    phase_rad: Floats
    """(K,)"""
    mean: float = 0.5

    @classmethod
    def random(cls, count: int = 40, highest: float = 0.3, lowest: float = 0.02, contrast: float = 0.12,
               seed: int = 0) -> Gratings:
        """Draw sinusoids of random directions and phases with a standard deviation `contrast` of the sum."""
        rng = np.random.default_rng(seed)
        size = np.exp(rng.uniform(np.log(lowest), np.log(highest), count))
        angle = rng.uniform(0, np.pi, count)
        frequency = size[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
        amplitude = np.full(count, contrast * np.sqrt(2 / count))
        return cls(frequency, amplitude, rng.uniform(0, 2 * np.pi, count))

    def sample(self, points_px: Floats) -> Floats:
        """Brightness (N,) at points (N, 2)."""
        out = np.full(len(points_px), self.mean)
        for f, a, p in zip(self.frequency, self.amplitude, self.phase_rad, strict=True):
            out += a * np.cos(2 * np.pi * (points_px @ f) + p)
        return out


def band_limited(image: Floats, *, cut_off: float = 0.4, border_px: int = 32,
                 fill: Bools | None = None) -> SplineTexture:
    """Make a texture of a frame (R, C), without the frequencies that alias when it moves.

    The filter passes frequencies below 0.75 `cut_off` cycles per pixel, in any direction, and none above `cut_off`.
    Tissue that shortens by 10 % raises them by as much, so 0.4 keeps every frame below the 0.5 that pixels can hold.
    The picture is continued past its sides by mirroring. `fill`, a mask (R, C), first replaces what lies outside of
    it by the nearest pixel inside, for a frame whose background was cut away.
    """
    image = np.asarray(image, float)
    if image.ndim != 2 or not np.isfinite(image).all():
        raise ValueError(f"image: expected finite numbers (rows, cols), found {image.dtype} of shape {image.shape}")
    if not 0 < cut_off <= 0.5:
        raise ValueError(f"cut_off: expected more than 0 and at most 0.5 cycles per pixel, found {cut_off}")
    if fill is not None:
        rows, cols = ndimage.distance_transform_edt(~fill, return_distances=False, return_indices=True)
        image = image[rows, cols]
    # Mirroring the whole picture makes it periodic without a step, so the Fourier filter sees no false edge.
    rows_px, cols_px = image.shape
    border = min(border_px, *image.shape)
    mirrored = np.pad(image, ((0, rows_px), (0, cols_px)), mode="symmetric")
    spectrum = fft.fftshift(fft.fft2(mirrored))
    f = np.hypot(*np.meshgrid(*(fft.fftshift(fft.fftfreq(n)) for n in mirrored.shape), indexing="ij"))
    spectrum *= _roll_off(f, 0.75 * cut_off, cut_off)
    pads = [(n // 2, n // 2) for n in mirrored.shape]
    finer = fft.ifft2(fft.ifftshift(np.pad(spectrum, pads))).real * _FINER**2
    finer = np.roll(finer, (border * _FINER, border * _FINER), axis=(0, 1))
    finer = finer[: (rows_px + 2 * border) * _FINER, : (cols_px + 2 * border) * _FINER]
    return SplineTexture(ndimage.spline_filter(finer, order=5, mode="nearest"), border, (rows_px, cols_px), cut_off)


@dataclass(frozen=True)
class TissuePicture:
    """A painted bundle and where its parts are."""

    image: Floats
    """(R, C), 0 black to 1 white."""
    tissue: Bools
    """(R, C): the bundle without its pillars, as in the masks of real movies."""
    pillars: tuple[Bools, Bools]
    """Caps of the first and second pillar, each (R, C)."""
    center_px: tuple[float, float]
    half_length_px: float
    """Distance from the centre to the middle of either pillar."""
    half_width_px: float
    """Half of the width in the middle."""
    angle_deg: float
    """Angle from the col axis to the tissue's axis, positive clockwise on the screen."""

    @property
    def body(self) -> Bools:
        """Tissue and pillars together (R, C): everything that moves."""
        return self.tissue | self.pillars[0] | self.pillars[1]


def procedural_tissue(shape: tuple[int, int] = (512, 512), seed: int = 0, *, angle_deg: float = 0.0,
                      contrast: float = 1.0, walls: bool = True) -> TissuePicture:
    """Paint a bundle between two pillars that looks like a brightfield frame.

    `contrast` multiplies the tissue's inner texture, `walls` adds the sides of the channel. The bundle spans the
    smaller side of the picture; grains and fibres keep their size in pixels, as for an objective of that resolution.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 21]))
    rows, cols = shape
    unit = min(shape) / 512.0
    center = ((rows - 1) / 2, (cols - 1) / 2)
    a = np.deg2rad(angle_deg)
    y, x = np.meshgrid(np.arange(rows) - center[0], np.arange(cols) - center[1], indexing="ij")
    s = (x * np.cos(a) + y * np.sin(a)) / unit
    n = (y * np.cos(a) - x * np.sin(a)) / unit
    # From here on lengths along s and n are those of a picture of 512 pixels.
    pillar_s, waist, head = 180.0, 57.0, 95.0

    # Each side of the outline has slow waves of its own.
    half_width = _outline(s, waist, head, pillar_s) + np.where(n > 0, _wave(rng, s), _wave(rng, s))
    across = n / half_width
    # Distance into the tissue; the end is a large rounded corner.
    end = 242.0 - np.abs(s)
    depth = half_width - np.abs(n)
    corner = np.hypot(np.clip(40 - depth, 0, None), np.clip(40 - end, 0, None))
    inside = np.where(corner > 0, 40 - corner, np.minimum(depth, end)) * unit
    tissue_edge = _edge(inside, 0.9)

    ground = 0.905 + 0.016 * _grain(rng, shape, 7 * unit, 7 * unit)
    ground += 0.009 * _grain(rng, shape, 1.2, 1.2) + 0.012 * _grain(rng, shape, 2.5, 2.5)
    ground += _debris(rng, shape, unit)
    ground -= 0.05 * np.exp(-((inside / unit + 4) / 3) ** 2) + 0.03 * np.exp(-((inside / unit + 12) / 5) ** 2)

    body = 0.40 + contrast * _fibres(rng, shape, s * unit, across, unit)
    body += 0.05 * np.exp(-((np.abs(across) - 0.75) / 0.2) ** 2) - 0.10 * np.exp(-inside / (2.0 * unit)).clip(max=1)

    image: Floats = ground + (body - ground) * tissue_edge
    if walls:
        image = _channel(rng, image, n, unit)
    pillars = []
    for sign in (-1.0, 1.0):
        image, cap = _pillar(rng, image, s - sign * pillar_s, n - 2 * rng.standard_normal(), unit)
        pillars.append(cap)
    image *= 1.0 - 0.06 * ((x / cols) ** 2 + (y / rows) ** 2) * 4 + 0.02 * x / cols
    image = ndimage.gaussian_filter(image, 0.45)
    caps = (pillars[0], pillars[1])
    return TissuePicture(np.clip(image, 0.02, 0.98), (inside > 0) & ~caps[0] & ~caps[1], caps, center,
                         pillar_s * unit, waist * unit, angle_deg)


def _outline(s: Floats, waist: float, head: float, pillar_s: float) -> Floats:
    """Half of the tissue's width at a distance s from its centre: a waist, a head around each pillar, round ends."""
    t = np.clip(np.abs(s) / pillar_s, 0, 1)
    neck = waist + (head - waist) * t**3 * (10 - 15 * t + 6 * t**2)
    past = np.clip((np.abs(s) - pillar_s) / 80.0, 0, 1)
    return np.asarray(neck * np.sqrt(1 - 0.7 * past**2))


def _fibres(rng: np.random.Generator, shape: tuple[int, int], s: Floats, across: Floats, unit: float) -> Floats:
    """Inner texture (R, C): streaks that follow the outline, over cells without direction, over slow shading."""
    # Streaks are drawn in straightened coordinates (s along, `across` between the two sides), then bent into place.
    length, width = int(s.max() - s.min()) + 65, int(2.4 * 75 * unit) + 33
    row = (across * 75 * unit) + width / 2
    col = s - s.min() + 32
    out: Floats = np.zeros(shape)
    sizes = ((0.8, 2.2, 0.020), (1.3, 5.0, 0.028), (2.5, 10.0, 0.032), (5.0, 22.0, 0.026))
    for sigma_across, sigma_along, weight in sizes:
        streak = ndimage.gaussian_filter(rng.standard_normal((width, length)), (sigma_across, sigma_along))
        out += weight * ndimage.map_coordinates(streak / streak.std(), [row, col], order=3, mode="reflect")
    for size, weight in ((0.0, 0.004), (0.75, 0.028), (1.6, 0.022), (5.0, 0.016), (18 * unit, 0.032)):
        out += weight * _grain(rng, shape, size, size)
    return out


def _pillar(rng: np.random.Generator, image: Floats, s: Floats, n: Floats, unit: float) -> tuple[Floats, Bools]:
    """Paint a pillar (lengths from its middle in 1/512 of the picture) and give its cap."""
    r = np.hypot(s, n)
    # The shadow is a rounded square, as the pillar's head has corners; its rim fades into the tissue.
    square = (np.abs(s) ** 5 + np.abs(n) ** 5) ** 0.2
    # It is softer on some sides than on others, because the pillar leans.
    lean = rng.uniform(0, 2 * np.pi)
    soft = 4.0 + 2.5 * np.cos(np.arctan2(n, s) - lean)
    shadow = 1 / (1 + np.exp((square - 57.0) / soft))
    wide = 0.2 * np.exp(-(((square - 57.0) / 22.0).clip(min=0)) ** 2) * (0.5 + 0.5 * np.cos(np.arctan2(n, s) - lean))
    image = image * (1 - shadow) * (1 - wide) + 0.04 * shadow
    radius = 47.0
    cap = _edge((radius - r) * unit, 1.2)
    rings = 0.035 * np.cos(2 * np.pi * r / 9.0 + 1.5 * np.arctan2(n, s)) * (r / radius)
    glass = 0.71 + rings + 0.06 * np.exp(-(r / 16) ** 2)
    for size, weight in ((2.2 * unit + 0.6, 0.05), (10 * unit, 0.03)):
        glass = glass + weight * _grain(rng, (image.shape[0], image.shape[1]), size, size)
    return image * (1 - cap) + glass * cap, r < radius


def _channel(rng: np.random.Generator, image: Floats, n: Floats, unit: float) -> Floats:
    """Paint the sides of the channel: dark bands, and plain grey beyond them."""
    for sign, near, far in ((-1.0, 187.0, 213.0), (1.0, 215.0, 227.0)):
        beyond = _edge((sign * n - far) * unit, 1.0)
        band = _edge((sign * n - near) * unit, 1.0) * (1 - beyond)
        shape = (image.shape[0], image.shape[1])
        grey = 0.62 + 0.03 * _grain(rng, shape, 5 * unit, 12 * unit) + 0.012 * _grain(rng, shape, 0.8, 0.8)
        image = image * (1 - band) * (1 - beyond) + 0.05 * band + grey * beyond
    return image


def _debris(rng: np.random.Generator, shape: tuple[int, int], unit: float) -> Floats:
    """Faint rings of cells out of focus on the ground (R, C)."""
    out = np.zeros(shape)
    y, x = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij", sparse=True)
    for _ in range(40):
        r = np.hypot(y - rng.uniform(0, shape[0]), x - rng.uniform(0, shape[1]))
        size = unit * rng.uniform(4, 12)
        out -= rng.uniform(0.01, 0.06) * np.exp(-((r - size) / (1.0 + 1.2 * unit)) ** 2)
    return out


def _grain(rng: np.random.Generator, shape: tuple[int, int], sigma_row: float, sigma_col: float) -> Floats:
    """Blurred white noise (R, C) of standard deviation 1."""
    grain = ndimage.gaussian_filter(rng.standard_normal(shape), (sigma_row, sigma_col), mode="wrap")
    return np.asarray(grain / grain.std())


def _wave(rng: np.random.Generator, s: Floats) -> Floats:
    """A slow random wave along the outline, of a few units."""
    length, phase = rng.uniform(100, 400, 4), rng.uniform(0, 2 * np.pi, 4)
    return np.asarray(sum(1.6 * np.sin(2 * np.pi * s / l + p) for l, p in zip(length, phase, strict=True)))


def _edge(distance_px: Floats, width_px: float) -> Floats:
    """0 outside to 1 inside across an edge, by the signed distance from it."""
    return np.asarray(0.5 + 0.5 * np.tanh(np.clip(distance_px / width_px, -30, 30)))


def _roll_off(f: Floats, passes: float, stops: float) -> Floats:
    t = np.clip((f - passes) / (stops - passes), 0, 1)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * t))
