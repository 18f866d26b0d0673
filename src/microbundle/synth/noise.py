"""What a microscope and its camera do to a perfect picture, repeatable frame by frame.

Each frame draws from a generator of its own, seeded with the model's seed and the frame's number, so a frame is the
same in whatever order and however often frames are made. Brightness runs from 0 (black) to 1 (full scale) until
`quantise` turns it into counts. The order is that of the light: defocus, illumination, structured (Perlin) noise,
shot noise, read noise, quantisation.

Perlin noise follows the paper (S1 Appendix, and the published `Add_Noise.py`): one layer of gradient noise [Perlin
1985] with `octaves` square lattice cells along the picture's longer side, stretched to run from 0 to 1 and added with
`ratio` times the picture's largest brightness, a new pattern in every frame. The published script covers a region of
about 90 pixels with 18 to 40 cells, thus 2.3 to 5 pixels a cell; keep the pixels per cell when the picture is larger.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import ndimage

from ..data import Floats, Image

Bits = Literal[8, 12, 16]


@dataclass(frozen=True)
class NoiseModel:
    """Everything that disturbs a synthetic movie. The default disturbs nothing but rounds to 16 bits.

    Amounts are shares of full scale unless a name says otherwise.
    """

    perlin_ratio: float = 0.0
    """Height of the Perlin noise as a share of the picture's largest brightness; the paper uses 0.02 to 0.12."""
    perlin_octaves: float = 40.0
    """Lattice cells along the longer side of the picture; the paper uses 18 to 40 on square pictures."""
    full_well_electrons: float | None = None
    """Electrons at full scale, which set the shot noise; None for none. 10 000 gives 0.7 % of a grey of 0.5 full scale
    its square root, as scientific cameras do."""
    read_noise: float = 0.0
    """Standard deviation of the noise that does not depend on brightness."""
    flicker_gain: float = 0.0
    """Standard deviation of each frame's brightness factor, around 1."""
    flicker_offset: float = 0.0
    """Standard deviation of each frame's brightness offset."""
    lamp_drift: float = 0.0
    """Change of the brightness factor from the first to the last frame."""
    shading_drift: float = 0.0
    """Change from the first to the last frame of the brightness factor at the right side against the left."""
    defocus_px: float = 0.0
    """Standard deviation of the blur that every frame has."""
    defocus_swing_px: float = 0.0
    """Additional blur that comes and goes once in `defocus_period_frames`."""
    defocus_period_frames: float = 100.0
    hot_pixels: float = 0.0
    """Share of pixels that are stuck at full scale, in the same places throughout the movie."""
    bits: Bits = 16
    """Depth of the counts: 8 (uint8), 12 or 16 (both uint16)."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("perlin_ratio", "read_noise", "flicker_gain", "flicker_offset", "defocus_px", "defocus_swing_px",
                     "hot_pixels"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: expected a number that is not negative, found {getattr(self, name)}")
        if self.full_well_electrons is not None and not self.full_well_electrons > 0:
            raise ValueError(f"full_well_electrons: expected more than 0 or None, found {self.full_well_electrons}")
        if self.bits not in (8, 12, 16):
            raise ValueError(f"bits: expected 8, 12 or 16, found {self.bits}")

    def disturb(self, image: Floats, frame: int, count: int) -> Floats:
        """Disturb the perfect picture (R, C) of one frame of a movie of `count` frames; the result is not clipped."""
        out: Floats = np.array(image, float)
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, 31, frame]))
        # Drawn first and always, so that switching one disturbance on leaves the pattern of the others as it was.
        gain, offset = rng.standard_normal(2)
        sigma = self.defocus_px + self.defocus_swing_px * np.sin(np.pi * frame / self.defocus_period_frames) ** 2
        if sigma > 0:
            out = ndimage.gaussian_filter(out, sigma, mode="nearest")
        elapsed = frame / max(count - 1, 1)
        out *= (1 + self.flicker_gain * gain) * (1 + self.lamp_drift * elapsed)
        if self.shading_drift:
            out *= 1 + self.shading_drift * elapsed * np.linspace(-0.5, 0.5, out.shape[1])
        out += self.flicker_offset * offset
        if self.perlin_ratio:
            out += self.perlin_ratio * out.max() * perlin(out.shape, self.perlin_octaves, (self.seed, frame))
        if self.full_well_electrons is not None:
            shot = np.random.default_rng(np.random.SeedSequence([self.seed, 32, frame]))
            out = shot.poisson(np.clip(out, 0, None) * self.full_well_electrons) / self.full_well_electrons
        if self.read_noise:
            read = np.random.default_rng(np.random.SeedSequence([self.seed, 33, frame]))
            out += self.read_noise * read.standard_normal(out.shape)
        if self.hot_pixels:
            hot = np.random.default_rng(np.random.SeedSequence([self.seed, 34]))
            out[hot.random(out.shape) < self.hot_pixels] = 1.0
        return out

    def quantise(self, image: Floats) -> Image:
        """Round brightness to counts, clipped at black and at full scale: uint8 for 8 bits, otherwise uint16."""
        top = 2**self.bits - 1
        counts = np.rint(np.clip(image, 0.0, 1.0) * top)
        return np.asarray(counts.astype(np.uint8 if self.bits == 8 else np.uint16))


def perlin(shape: tuple[int, ...], octaves: float, seed: int | tuple[int, ...]) -> Floats:
    """Make a layer of gradient noise (R, C) from 0 to 1, with `octaves` square lattice cells along the longer side."""
    if not octaves > 0:
        raise ValueError(f"octaves: expected more than 0, found {octaves}")
    entropy = [seed, 35] if isinstance(seed, int) else [*seed, 35]
    rng = np.random.default_rng(np.random.SeedSequence(entropy))
    cells = int(np.ceil(octaves)) + 1
    slope = rng.uniform(-1, 1, (2, cells + 1, cells + 1))

    # Along each side: the lattice line before each pixel, the distance past it, and the fading weight of the next.
    axes = [np.arange(n) * (octaves / max(shape)) for n in shape]
    (i, j) = (a.astype(int) for a in axes)
    (y, x) = (a - a.astype(int) for a in axes)
    (v, u) = (t**3 * (10 - 15 * t + 6 * t**2) for t in (y, x))
    out = np.zeros(shape)
    for di, wi in ((0, 1 - v), (1, v)):
        for dj, wj in ((0, 1 - u), (1, u)):
            corner = np.ix_(i + di, j + dj)
            ramp = slope[0][corner] * (y - di)[:, None] + slope[1][corner] * (x - dj)[None, :]
            out += ramp * (wi[:, None] * wj[None, :])
    low, high = out.min(), out.max()
    return np.asarray((out - low) / max(high - low, 1e-300))
