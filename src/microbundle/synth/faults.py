"""Spoil a movie on purpose, one fault at a time, to see whether it is noticed.

Each function takes a good movie and gives one with a fault; frames are spoilt when they are asked for, always in the
same way, and keep their number type. Amounts are shares of the grey value unless a name says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..data import Floats, Frames, Image, Ints, Movie

Spoil = Callable[[Floats, int], Floats]
"""Makes a spoilt frame (R, C) of a good one and its number."""


@dataclass(frozen=True)
class Spoilt:
    """Frames that are changed when they are asked for."""

    good: Frames
    spoil: Spoil

    def __len__(self) -> int:
        return len(self.good)

    def __getitem__(self, index: int) -> Image:
        frame = self.good[index]
        out = self.spoil(np.asarray(frame, float), index % len(self))
        if np.issubdtype(frame.dtype, np.integer):
            limits = np.iinfo(frame.dtype)
            out = np.clip(np.rint(out), limits.min, limits.max)
        return np.asarray(out.astype(frame.dtype))


@dataclass(frozen=True)
class Picked:
    """Some frames of others, in any order and as often as wanted."""

    good: Frames
    index: Ints

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, index: int) -> Image:
        return np.asarray(self.good[int(self.index[index])])


def blurred(movie: Movie, sigma_px: float) -> Movie:
    """Put every frame out of focus by a Gaussian; the noise is blurred too, as by binning or compression."""
    return _spoilt(movie, lambda frame, _: _blur(frame, sigma_px))


def losing_focus(movie: Movie, sigma_px: float) -> Movie:
    """Let the focus drift away: the variance of the blur grows evenly, to `sigma_px` in the last frame."""
    last = max(movie.count - 1, 1)
    return _spoilt(movie, lambda frame, t: _blur(frame, sigma_px * np.sqrt(t / last)))


def blurred_in_step(movie: Movie, sigma_px: Floats) -> Movie:
    """Blur each frame by its own amount (T,), as tissue that leaves the focus with every beat."""
    return _spoilt(movie, lambda frame, t: _blur(frame, float(sigma_px[t])))


def faded(movie: Movie, contrast: float, noise: float, seed: int = 0) -> Movie:
    """Lower the contrast to a share of what it was, around the first frame's mean, and add white noise of a standard
    deviation in grey values."""
    middle = float(np.mean(movie.frames[0]))

    def spoil(frame: Floats, t: int) -> Floats:
        rng = np.random.default_rng(np.random.SeedSequence([seed, 41, t]))
        return np.asarray(middle + contrast * (frame - middle) + noise * rng.standard_normal(frame.shape))
    return _spoilt(movie, spoil)


def clipped(movie: Movie, low: float, high: float) -> Movie:
    """Cut grey values off below and above."""
    return _spoilt(movie, lambda frame, _: np.clip(frame, low, high))


def posterised(movie: Movie, step: float) -> Movie:
    """Round grey values to multiples of a step."""
    return _spoilt(movie, lambda frame, _: step * np.rint(frame / step))


def flickering(movie: Movie, share: float, seed: int = 0) -> Movie:
    """Multiply each frame by its own random factor, of that standard deviation around 1."""
    gain = 1 + share * np.random.default_rng(np.random.SeedSequence([seed, 42])).standard_normal(movie.count)
    return _spoilt(movie, lambda frame, t: frame * gain[t])


def flashing(movie: Movie, frames: Sequence[int], share: float) -> Movie:
    """Make single frames brighter, or darker where `share` is negative."""
    return _spoilt(movie, lambda frame, t: frame * (1 + share if t in frames else 1.0))


def dimming(movie: Movie, share: float) -> Movie:
    """Let the light fall evenly, by `share` until the last frame."""
    last = max(movie.count - 1, 1)
    return _spoilt(movie, lambda frame, t: frame * (1 - share * t / last))


def repeating(movie: Movie, frames: Sequence[int]) -> Movie:
    """Show the frame before in place of some frames."""
    index = np.arange(movie.count)
    for t in sorted(frames):
        index[t] = index[t - 1]
    return replace(movie, frames=Picked(movie.frames, index))


def without_frames(movie: Movie, frames: Sequence[int]) -> Movie:
    """Leave frames out; the others keep their time stamps, where there are any."""
    keep = np.setdiff1d(np.arange(movie.count), frames)
    return replace(movie, frames=Picked(movie.frames, keep), files=(),
                   time_s=None if movie.time_s is None else movie.time_s[keep])


def _spoilt(movie: Movie, spoil: Spoil) -> Movie:
    return replace(movie, frames=Spoilt(movie.frames, spoil), files=())


def _blur(frame: Floats, sigma_px: float) -> Floats:
    return np.asarray(ndimage.gaussian_filter(frame, sigma_px, mode="nearest")) if sigma_px > 0 else frame
