"""Bring frames to the 8 bits that OpenCV's tracker takes.

The default scales the whole movie by one range, taken from the tissue, so that neither a hot pixel nor a changing
background alters it. The published tool stretches every frame by its own extremes; that is kept for `paper`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .data import Bools, Floats, Image, Movie

Gray8 = NDArray[np.uint8]

SAMPLED_FRAMES = 16
TAILS_PERCENT = (0.5, 99.5)
FLICKER = 0.01
"""Changes of the tissue's mean brightness above this share are undone; smaller ones come from the motion itself."""


@dataclass(frozen=True)
class Scaling:
    """One range of grey values for a whole movie, and the region whose brightness is held constant."""

    low: float
    high: float
    tissue: Bools
    box: tuple[slice, slice]
    """Part of the frame that is needed: the tissue and a margin."""
    dark: float
    """Grey value without light: 0, or less where the frames hold negative numbers."""
    light: float
    """Usual mean of the tissue's grey values above the dark."""

    def __call__(self, frame: Image) -> Gray8:
        """Cut a frame to the box and scale it to 8 bits, undoing flicker."""
        part = frame[self.box].astype(np.float32)
        part -= self.dark
        light = float(part[self.tissue].mean())
        steady = light <= 0 or abs(light / self.light - 1) <= FLICKER
        gain = 1.0 if steady else self.light / light
        step = 255.0 / (self.high - self.low)
        part *= gain * step
        part += (self.dark - self.low) * step
        np.clip(part, 0, 255, out=part)
        part += 0.5
        return part.astype(np.uint8)

    @property
    def origin(self) -> Floats:
        """Upper left corner (row, col) of the box."""
        return np.array([self.box[0].start, self.box[1].start], float)


def movie_scaling(movie: Movie, tissue: Bools, margin_px: int = 32) -> Scaling:
    """Measure the range of grey values of the tissue over a sample of the movie's frames."""
    rows, cols = np.flatnonzero(tissue.any(axis=1)), np.flatnonzero(tissue.any(axis=0))
    box = (slice(max(int(rows[0]) - margin_px, 0), int(rows[-1]) + margin_px + 1),
           slice(max(int(cols[0]) - margin_px, 0), int(cols[-1]) + margin_px + 1))
    sample = np.unique(np.linspace(0, movie.count - 1, SAMPLED_FRAMES).astype(int))
    seen = [movie.frames[int(t)][tissue] for t in sample]
    low, high = np.median([np.percentile(values, TAILS_PERCENT) for values in seen], axis=0)
    high = max(high, low + 1e-6 * max(abs(low), 1.0))
    dark = min(float(low), 0.0)
    light = float(np.median([values.mean() for values in seen])) - dark
    return Scaling(float(low), float(high), tissue[box], box, dark, max(light, 1e-6 * (high - low)))


def stretch_each(frame: Image) -> Gray8:
    """Stretch one frame by its own extremes to 8 bits, as the published tool does."""
    if np.issubdtype(frame.dtype, np.integer):
        top, step = float(np.iinfo(frame.dtype).max), (np.iinfo(frame.dtype).max + 1) / 256
    else:
        top, step = 1.0, 1 / 255
    low, high = float(frame.min()), float(frame.max())
    stretched = (frame.astype(float) - low) / max(high - low, 1e-300) * top
    if np.issubdtype(frame.dtype, np.integer):
        return (stretched.astype(frame.dtype) // int(step)).astype(np.uint8)
    return np.clip(np.rint(stretched / step), 0, 255).astype(np.uint8)
