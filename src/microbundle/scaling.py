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
    mean: float
    """Mean of the tissue's scaled values in the middle of the movie's range."""

    def __call__(self, frame: Image) -> Gray8:
        """Cut a frame to the box and scale it to 8 bits, undoing flicker."""
        part = frame[self.box].astype(np.float32)
        part -= self.low
        part *= 255.0 / (self.high - self.low)
        np.clip(part, 0, 255, out=part)
        mean = float(part[self.tissue].mean())
        if mean > 0 and abs(mean / self.mean - 1) > FLICKER:
            part *= self.mean / mean
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
    values = np.stack([np.percentile(movie.frames[int(t)][tissue], TAILS_PERCENT) for t in sample])
    low, high = np.median(values, axis=0)
    high = max(high, low + 1e-6 * max(abs(low), 1.0))
    middle = np.clip((movie.frames[int(sample[len(sample) // 2])][tissue] - low) / (high - low) * 255, 0, 255)
    return Scaling(float(low), float(high), tissue[box], box, max(float(middle.mean()), 1.0))


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
