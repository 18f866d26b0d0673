"""Measure what the frames of a movie look like, in one pass: light, grey scale, noise and sharpness.

Sharpness is how the tissue's power spectrum falls. The spectrum is that of what two consecutive frames share, so the
camera's noise, which they do not share, adds nothing to it; and only its shape counts, so contrast and light do not
matter. Defocus takes fine detail away before coarse.

Up to 600 frames are looked at, in runs of consecutive ones that are spread over the movie; one frame is held at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from .data import Bools, Floats, Image, Ints, Movie

MOST_FRAMES, RUN_FRAMES = 600, 50
GREY_FRAMES = 12
"""Frames whose grey values are counted."""
END_PERCENT = 0.2
"""A few hot or dead pixels do not decide where the grey scale ends."""
SPIKE = 4.0
"""The end of a grey scale is cut off where it holds this many times the pixels of the grey values next to it."""
MIDDLE_PERCENT = (1.0, 99.0)
LINES = 48
"""Rows of the picture in which frames are compared with the one before."""
AWAY_PX = 8
"""Distance of the background from the tissue."""
PATCH_PX, MOST_PATCHES, STEP_PX = 32, 64, 8
PAIRS, PARTS = 32, 4
"""Pairs of frames whose common spectrum is taken, and the parts of the movie that are compared."""
SHARPER = 0.75
"""Quantile of the pairs' sharpness that stands for a part."""
TEXTURE, COARSE, FINE = slice(2, 14), slice(2, 5), slice(5, 14)
"""Waves to a patch: texture is from 16 px down to 2.5 px, and fine below 6.4 px; coarser is shading."""

Complex = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True)
class Texture:
    """Power spectra of the tissue while it hardly moves, by waves to a patch, summed over directions."""

    shared: Floats
    """(waves,): power that consecutive frames share."""
    noise: Floats
    """(waves,): power of either frame that they do not."""
    sharpness_of_parts: Floats
    """(parts,): the sharpness of each quarter of the movie that shows anything, as it is in the sharper frames; for
    tissue may leave the focus with every beat, and motion blurs too."""

    @property
    def sharpness(self) -> float:
        """Share of the texture's power in details finer than 6.4 px."""
        return _fine(self.shared)

    @property
    def contrast_to_noise(self) -> float:
        """Power of the texture over that of the noise, in one frame."""
        noise = float(self.noise[TEXTURE].sum())
        return float(np.clip(self.shared[TEXTURE], 0, None).sum()) / noise if noise > 0 else float("inf")


@dataclass(frozen=True)
class Appearance:
    """What some frames of a movie look like."""

    frames: Ints
    """(n,): frames that were looked at, in order."""
    brightness: Floats
    """(n,): mean grey value of the frame, as a share of its median over frames."""
    change: Floats
    """(n, 2): how much fine detail differs from the frame before, in the background and in the tissue; NaN where the
    frame before was not looked at."""
    cut_off: tuple[float, float]
    """Share of the tissue that lies at the dark and at the bright end of the grey scale, where it is cut off there."""
    grey_levels: int
    """Grey values that the tissue takes, but for the outermost 2 %."""
    texture: Texture | None
    """None where the tissue is too small for a spectrum."""


def look(movie: Movie, tissue: Bools) -> Appearance:
    """Measure the appearance of a movie of one frame or more; `tissue` is its mask (R, C)."""
    chosen = frames_to_look_at(movie.count)
    follows = np.diff(chosen, prepend=-2) == 1
    grey_at = set(spread(chosen, GREY_FRAMES).tolist())
    pair_at = set(spread(chosen[follows], PAIRS).tolist())
    spectra, compare = _Spectra(tissue), _Lines(tissue)
    light, change = np.empty(len(chosen)), np.full((len(chosen), 2), np.nan)
    ends: list[tuple[float, float, float]] = []
    levels: list[Image] = []
    pairs: list[tuple[int, Floats, Floats]] = []
    before: tuple[Image, Floats] | None = None
    for i, t in enumerate(chosen.tolist()):
        frame = np.asarray(movie.frames[t])
        light[i] = frame.mean()
        fine = compare.cut(frame)
        if follows[i] and before is not None:
            change[i] = compare.differ(before[1], fine)
            if t in pair_at and len(spectra.corners):
                pairs.append((t, *spectra.of_pair(before[0], frame)))
        if t in grey_at:
            values, counts = np.unique(frame[tissue], return_counts=True)
            ends.append((*_cut_off(counts), float(values[0])))
            low, high = np.searchsorted(np.cumsum(counts), np.multiply(MIDDLE_PERCENT, counts.sum() / 100))
            levels.append(values[low:high + 1])
        before = frame, fine
    dark = min(float(np.median([lowest for *_, lowest in ends])), 0.0)  # where frames hold negative numbers
    usual = float(np.median(light)) - dark
    shares = np.median([pair[:2] for pair in ends], axis=0)
    return Appearance(chosen, (light - dark) / usual if usual > 0 else np.ones(len(light)), change,
                      (float(shares[0]), float(shares[1])), len(np.unique(np.concatenate(levels))),
                      _texture(pairs, movie.count))


def sharpness_at(movie: Movie, tissue: Bools, frames: Ints) -> Floats:
    """Compute the sharpness (n,) of the tissue (R, C) in frames (n,), each with the one after it.

    It is the share of the texture's power in details finer than 6.4 px, as in `Texture`; NaN in a tiny tissue.
    """
    spectra = _Spectra(tissue)
    if len(spectra.corners) == 0:
        return np.full(len(frames), np.nan)
    return np.array([_fine(spectra.of_pair(movie.frames[t], movie.frames[t + 1])[0]) for t in frames.tolist()])


def frames_to_look_at(count: int) -> Ints:
    """Choose the frames (n,) of a movie: all of them, or for a long movie runs of consecutive ones."""
    if count <= MOST_FRAMES:
        return np.arange(count)
    first = np.linspace(0, count - RUN_FRAMES, MOST_FRAMES // RUN_FRAMES).astype(int)
    return np.unique(first[:, None] + np.arange(RUN_FRAMES))


def spread(frames: Ints, most: int) -> Ints:
    """Choose at most so many of some frames, evenly."""
    if len(frames) == 0:
        return frames
    return np.asarray(frames[np.unique(np.linspace(0, len(frames) - 1, most).astype(int))])


def _cut_off(counts: Ints) -> tuple[float, float]:
    """Share of pixels at the dark and the bright end of the sorted grey values that have these counts."""
    return _end(counts), _end(counts[::-1])


def _end(counts: Ints) -> float:
    share = counts / counts.sum()
    end = int(np.searchsorted(np.cumsum(share), END_PERCENT / 100))
    inside = share[end + 1:end + 4]
    stands_out = len(inside) == 0 or share[end] > SPIKE * float(inside.mean())
    return float(share[:end + 1].sum()) if stands_out else 0.0


def _fine(power: Floats) -> float:
    kept = np.clip(power, 0, None)
    total = float(kept[TEXTURE].sum())
    return float(kept[FINE].sum()) / total if total > 0 else float("nan")


def _texture(pairs: list[tuple[int, Floats, Floats]], count: int) -> Texture | None:
    """Mean spectra over the half of the pairs that differ least in coarse detail: there, motion is least."""
    if not pairs:
        return None
    part_of = np.array([min(PARTS * t // count, PARTS - 1) for t, *_ in pairs])
    shared, noise = (np.array([pair[i] for pair in pairs]) for i in (1, 2))
    sharpness = np.array([_fine(power) for power in shared])
    shows = np.isfinite(sharpness)  # a blank frame shows nothing
    of_parts = [float(np.quantile(sharpness[shows & (part_of == part)], SHARPER)) for part in np.unique(part_of[shows])]
    common, differs = shared[:, COARSE].sum(axis=1), noise[:, COARSE].sum(axis=1)
    moved = np.divide(differs, common, out=np.full(len(pairs), np.inf), where=common > 0)
    calm = np.argsort(moved)[:-(-len(pairs) // 2)]
    return Texture(shared[calm].mean(axis=0), noise[calm].mean(axis=0), np.array(of_parts))


class _Lines:
    """Some rows of the picture, in the background and in the tissue."""

    def __init__(self, tissue: Bools) -> None:
        self.rows = np.unique(np.linspace(0, len(tissue) - 1, LINES).astype(int))
        away = ~ndimage.binary_dilation(tissue, iterations=AWAY_PX)
        self.parts = [part[self.rows][:, 1:-1] for part in (away, tissue)]

    def cut(self, frame: Image) -> Floats:
        """Second differences along the chosen rows, which hold little but noise."""
        line = frame[self.rows].astype(np.float32)
        return np.asarray(line[:, :-2] - 2 * line[:, 1:-1] + line[:, 2:])

    def differ(self, before: Floats, after: Floats) -> tuple[float, float]:
        """Mean absolute difference in the background and in the tissue, NaN where there is none."""
        away = np.abs(after - before)
        background, tissue = (float(away[part].mean()) if part.any() else float("nan") for part in self.parts)
        return background, tissue


class _Spectra:
    """Patches of the tissue, and the waves in them."""

    def __init__(self, tissue: Bools) -> None:
        # A patch lies inside where the sum over it is its area.
        total = np.pad(tissue.astype(np.int64), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
        n = PATCH_PX
        area = total[n:, n:] - total[:-n, n:] - total[n:, :-n] + total[:-n, :-n]
        corners = STEP_PX * np.argwhere(area[::STEP_PX, ::STEP_PX] == n * n)
        self.corners = corners[np.unique(np.linspace(0, len(corners) - 1, MOST_PATCHES).astype(int))] \
            if len(corners) else corners
        hann = (0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)).astype(np.float32)
        self.window = np.outer(hann, hann)
        row, col = fft.fftfreq(n)[:, None], fft.rfftfreq(n)[None, :]
        self.wave = np.rint(n * np.hypot(row, col)).astype(int).ravel()
        self.weight = np.broadcast_to(np.where((col > 0) & (col < 0.5), 2.0, 1.0), (n, n // 2 + 1)).ravel()

    def of_pair(self, before: Image, after: Image) -> tuple[Floats, Floats]:
        """Power (waves,) that two frames share, and that of either which they do not."""
        one, other = self._transform(before), self._transform(after)
        shared = (one * other.conj()).real.mean(axis=0).ravel()
        noise = 0.5 * (np.abs(one - other) ** 2).mean(axis=0).ravel()
        sums = [np.asarray(np.bincount(self.wave, self.weight * power), float) for power in (shared, noise)]
        return sums[0], sums[1]

    def _transform(self, frame: Image) -> Complex:
        n = PATCH_PX
        patches = np.stack([frame[r:r + n, c:c + n] for r, c in self.corners]).astype(np.float32)
        patches -= patches.mean(axis=(1, 2), keepdims=True)
        return np.asarray(fft.rfft2(patches * self.window))
