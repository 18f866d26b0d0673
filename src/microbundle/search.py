"""Find patches of a reference frame in all others, frame by frame, and tell where they are not to be found.

Every frame is compared with one reference frame, so errors do not add up. The search (`patches`) starts from where the
last two frames point to, and where that fails or fits badly once more from pyramidal Lucas-Kanade, and from what the
others do. Several searches go through a movie together, so that each frame is decoded once for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np

from .bspline import Float32
from .data import Bools, Floats, Image, Movie
from .data import known as known_points
from .errors import CannotMeasure, ConfigError, MaskUnusable
from .patches import MARGIN_PX, Found, Part, Patches

BORDER_PX = 3
"""Pixels this near to the picture's border are left out: their splines need pixels beyond it."""
DOUBT, LEAST_DOUBT = 2.0, 0.03
"""The search starts once more where the share that is not found again is this many times the least so far."""
ODD, ODD_FLOOR = 4.0, 0.25
"""A patch shows something else in frames where that share is this many times the usual."""
STILL = np.eye(2, 3)
PYRAMID, MOST_WINDOW_PX = 3, 31
GLARE_PERCENT = (0.5, 99.5)


class Search:
    """The search for all patches of a reference frame, in one frame after the other; from the warps (T, N, 2, 3), where
    they are known."""

    def __init__(self, picture: Float32, patches: Patches, anchors: Floats, known: Floats | None = None) -> None:
        """Take the patches of a picture, and the points (N, M, 2) of each that Lucas-Kanade follows."""
        self.patches, self.anchors, self.known = patches, anchors, known
        self.first = eight_bits(picture)
        self.window = min(max(patches.f.shape[1:]), MOST_WINDOW_PX)
        self.still = np.tile(STILL, (len(patches.center), 1, 1))
        self.least = np.full(len(self.still), np.inf)
        self.begin()

    def begin(self) -> None:
        """Start, or start anew, at the reference frame."""
        self.last, self.pace = self.still, np.zeros((len(self.still), 2, 1))

    def find(self, t: int, frame: Image, *, reference: bool) -> tuple[Part, Found]:
        """Find the patches in the next frame, which is number `t`, and may be the reference frame itself."""
        patches, still = self.patches, self.still
        start = self.known[t] if self.known is not None else np.concatenate(
            [self.last[:, :, :2], self.last[:, :, 2:] + self.pace], axis=2)
        part = Part.of(frame, patches, start)
        found = patches.find(part, start, patches.good)
        trusted = DOUBT * np.where(np.isfinite(self.least), self.least, LEAST_DOUBT)
        for way in (self._anchors_shift, _common_shift):
            sure = found.ok & (1 - found.match <= trusted)
            again = np.where((patches.good & ~sure)[:, None], way(frame, found, sure), np.nan)
            missed = known_points(again)
            if missed.any():
                start = np.where(missed[:, None, None], np.dstack([still[:, :, :2], again]), start)
                part = Part.of(frame, patches, start)
                found = _either(found, patches.find(part, start, missed))
        if not reference:
            self.least = np.where(found.ok, np.minimum(np.maximum(1 - found.match, LEAST_DOUBT), self.least),
                                  self.least)
        if self.known is None:
            seen = found.ok[:, None, None]
            self.pace = np.where(seen, (found.warp - self.last)[:, :, 2:], 0.0)
            self.last = np.where(seen, found.warp, self.last)
        return part, found

    def _anchors_shift(self, frame: Image, _found: Found, sure: Bools) -> Floats:
        """Median shift (N, 2) of each patch's anchors by Lucas-Kanade from the reference frame, NaN where it is sure
        already or none is found."""
        out = np.full((len(sure), 2), np.nan)
        chosen = np.flatnonzero(self.patches.good & ~sure)
        if not len(chosen):
            return out
        begin = np.ascontiguousarray(self.anchors[chosen].reshape(-1, 2)[:, ::-1], np.float32)
        end, status, _ = cv2.calcOpticalFlowPyrLK(self.first, eight_bits(frame), begin, begin.copy(), maxLevel=PYRAMID,
                                                  winSize=(self.window, self.window))
        moved = np.where(status > 0, end - begin, np.nan)[:, ::-1].reshape(len(chosen), -1, 2)
        for i, shifts in zip(chosen, moved, strict=True):
            known = shifts[known_points(shifts)]
            if len(known):
                out[i] = np.median(known, axis=0)
        return out


def through(movie: Movie, reference: int, searches: Sequence[Search]) -> Iterator[tuple[int, int, Part, Found]]:
    """Let searches go through a movie together, from the reference frame to both ends; yields frame, number of the
    search, and what it has found."""
    for order in (range(reference, movie.count), range(reference - 1, -1, -1)):
        for search in searches:
            search.begin()
        for t in order:
            frame = movie.frames[t]
            if frame.dtype.kind == "f" and not np.isfinite(frame).all():
                frame = np.zeros(frame.shape, np.float32)  # in which nothing is found
            for i, search in enumerate(searches):
                yield t, i, *search.find(t, frame, reference=t == reference)


def odd(unlike: Floats, ok: Bools) -> Bools:
    """Tell where (T, N) the share of a patch that is not found again is far from usual."""
    return np.asarray(unlike > np.maximum(ODD * usual(unlike, ok), ODD_FLOOR))


def usual(values: Floats, ok: Bools) -> Floats:
    """Median (N,) of values (T, N) where they are ok; 0 where none is."""
    return np.array([np.median(v[k]) if k.any() else 0.0 for v, k in zip(values.T, ok.T, strict=True)])


def reference_picture(movie: Movie, frame: int) -> Float32:
    """Give the reference frame in single precision. Raises ConfigError and CannotMeasure for one that cannot be."""
    if not 0 <= frame < movie.count:
        raise ConfigError(f"reference_frame: expected 0 to {movie.count - 1}, a frame of {movie.name}; found {frame}")
    if min(movie.shape) < 2 * MARGIN_PX:
        raise CannotMeasure(f"{movie.name}: expected frames of {2 * MARGIN_PX} x {2 * MARGIN_PX} px or more; found "
                            f"{movie.shape[0]} x {movie.shape[1]}")
    picture = np.array(movie.frames[frame], np.float32, order="C")
    if not np.isfinite(picture).all():
        raise CannotMeasure(f"{movie.name}: expected a reference frame of finite grey values; frame {frame} holds NaN "
                            "or infinity. Choose another reference_frame")
    return picture


def usable_pixels(movie: Movie, mask: Bools | None) -> Bools:
    """Tell which pixels (R, C) may count: those of a mask, or all, but for the border. Raises MaskUnusable."""
    usable = np.zeros(movie.shape, bool)
    inner = slice(BORDER_PX, -BORDER_PX)
    usable[inner, inner] = True
    if mask is None:
        return usable
    mask = np.asarray(mask)
    if mask.dtype != np.bool_ or mask.shape != movie.shape:
        raise MaskUnusable(f"mask: expected a bool array of {movie.shape} like the frames of {movie.name}; found "
                           f"{mask.dtype} of {mask.shape}. Read a file with microbundle.read_mask")
    if not mask.any():
        raise MaskUnusable("mask: expected some pixels; it is empty")
    return usable & mask


def eight_bits(frame: Image) -> Image:
    """Scale a frame by its own range of grey values, whatever the light."""
    low, high = np.percentile(frame[::4, ::4], GLARE_PERCENT)
    return np.asarray(np.clip((frame - low) * (255 / max(high - low, 1e-12)), 0, 255), np.uint8)


def _common_shift(_frame: Image, found: Found, sure: Bools) -> Floats:
    """Median shift (N, 2) of the patches that are surely found, NaN where there are none."""
    return np.broadcast_to(np.median(found.warp[sure, :, 2], axis=0) if sure.any() else np.nan, (len(sure), 2))


def _either(first: Found, second: Found) -> Found:
    """Of each patch the search that fits better."""
    better = second.ok & (~first.ok | (second.match > first.match))

    def pick(a: Any, b: Any) -> Any:
        return np.where(better.reshape(-1, *[1] * (a.ndim - 1)), b, a)

    return Found(**{name: pick(getattr(first, name), getattr(second, name)) for name in vars(first)})
