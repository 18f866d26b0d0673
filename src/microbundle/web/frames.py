"""Movies that are looked at: opened once, frames decoded when they are asked for, and pictures kept in bounded memory.

What is shown are the frames as they are measured: cut and filtered as the settings ask. Grey limits are one pair for a
whole movie, from a sample of its frames, so that a movie does not flicker while it plays.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np

from ..config import Config, Reading
from ..data import Floats, Movie
from ..formats.opened import stamp
from ..read import calibrated, prepare, read_movie
from .answers import Refused, not_there

V = TypeVar("V")

MOST_OPEN = 3
"""Movies that stay open; each keeps up to 64 MB of decoded frames."""
MOST_BYTES = 64 * 2**20
"""Of pictures that are kept."""
SAMPLED = 12
"""Frames that the grey limits are taken from."""
LOW_PCT, HIGH_PCT = 1.0, 99.5
BINS = 64
QUALITY = 85
NARROWEST, WIDEST = 16, 4096
EVEN_WITHIN = 0.05
"""Frames that are no farther from even times than this share of a step are evenly spaced."""


def timing(time_s: Floats | None) -> dict[str, Any]:
    """Say how fast a movie is played, and when its frames were taken where they are not evenly spaced."""
    if time_s is None or len(time_s) < 2:
        return {"frames_per_s": None, "time_s": None}
    step, since = float(np.median(np.diff(time_s))), time_s - time_s[0]
    even = np.allclose(since, step * np.arange(len(since)), rtol=0, atol=EVEN_WITHIN * step)
    return {"frames_per_s": 1 / step, "time_s": None if even else since.round(4).tolist()}


@dataclass(frozen=True)
class Grey:
    """Grey values of a movie."""

    low: float
    high: float
    least: float
    most: float
    histogram: tuple[int, ...]
    """Pixels of the sampled frames in equal steps from the least to the most."""


@dataclass(frozen=True)
class Shown:
    """A movie that is open."""

    whole: Movie
    """As the file has it, calibrated."""
    movie: Movie
    """As it is measured."""
    crop_px: tuple[int, int, int, int] | None
    """Which part of the file's frames is measured, None for all."""
    key: tuple[str, tuple[int, int]]
    """What tells its pictures from those of another movie, or of an older file."""


class Kept(Generic[V]):
    """The last few values that were made: each once, for all who ask for it at the same time."""

    def __init__(self, most: int) -> None:
        self.most, self._lock = most, threading.Lock()
        self._values: OrderedDict[Hashable, V] = OrderedDict()
        self._making: dict[Hashable, threading.Lock] = {}

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: Hashable, make: Callable[[], V]) -> V:
        """Give the value of a key, which is made where it is not there."""
        with self._lock:
            one_at_a_time = self._making.setdefault(key, threading.Lock())
        with one_at_a_time:
            try:
                found = self._values.get(key)
                if found is None:
                    found = make()
            except BaseException:
                with self._lock:
                    self._making.pop(key, None)
                raise
            with self._lock:
                self._values[key] = found
                self._values.move_to_end(key)
                while len(self._values) > self.most:
                    gone, _ = self._values.popitem(last=False)
                    self._making.pop(gone, None)
        return found


class Movies:
    """The movies that are open, and their pictures. All methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._files: Kept[Movie] = Kept(MOST_OPEN)
        self._open: Kept[Shown] = Kept(MOST_OPEN)
        self._grey: dict[tuple[Any, ...], Grey] = {}
        self._pictures: OrderedDict[tuple[Any, ...], bytes] = OrderedDict()
        self._bytes = 0

    def open(self, path: Path, config: Config) -> Shown:
        """Open a movie as the settings ask, or take it from those that are open. Raises MicrobundleError."""
        key = f"{path}\0{config.reading.model_dump_json()}\0{config.fps}\0{config.um_per_px}", stamp(path)

        def shown() -> Shown:
            whole = calibrated(self.read(path, config.reading), config.fps, config.um_per_px)
            return Shown(whole, prepare(whole, config.reading), config.reading.crop_px, key)

        return self._open.get(key, shown)

    def read(self, path: Path, part: Reading) -> Movie:
        """Read what a file says of its movie, before it is calibrated and cut. Raises MicrobundleError."""
        key = path, part.series, part.channel, part.z, stamp(path)
        return self._files.get(key, lambda: read_movie(path, series=part.series, channel=part.channel, z=part.z))

    def grey(self, shown: Shown) -> Grey:
        """Grey limits and histogram of a movie."""
        found = self._grey.get(shown.key)
        if found is None:
            found = measure_grey(shown.movie)
            if len(self._grey) > 1000:
                self._grey.clear()
            self._grey[shown.key] = found
        return found

    def picture(self, shown: Shown, t: int, low: float | None = None, high: float | None = None,
                width: int | None = None) -> bytes:
        """Make the JPEG of a frame, between grey limits, and not wider than `width`. Raises Refused."""
        if not 0 <= t < shown.movie.count:
            raise not_there(f"expected a frame from 0 to {shown.movie.count - 1}; found {t}")
        if low is None or high is None:
            limits = self.grey(shown)
            low, high = (limits.low if low is None else low), (limits.high if high is None else high)
        if width is not None:
            width = min(max(width, NARROWEST), WIDEST)
        key = (shown.key, t, low, high, width)
        with self._lock:
            if key in self._pictures:
                self._pictures.move_to_end(key)
                return self._pictures[key]
        made = jpeg(eight_bits(shown.movie.frames[t], low, high), width)
        with self._lock:
            if key not in self._pictures:
                self._pictures[key] = made
                self._bytes += len(made)
            while self._bytes > MOST_BYTES and self._pictures:
                _, old = self._pictures.popitem(last=False)
                self._bytes -= len(old)
        return made


def measure_grey(movie: Movie) -> Grey:
    """Measure grey limits on frames spread over a movie."""
    sample = [np.asarray(movie.frames[int(t)], np.float32) for t in
              np.unique(np.linspace(0, movie.count - 1, min(SAMPLED, movie.count)).astype(int))]
    values = np.concatenate([frame[::max(1, frame.shape[0] // 256), ::max(1, frame.shape[1] // 256)].ravel()
                             for frame in sample])
    values = values[np.isfinite(values)]
    if values.size == 0:
        raise Refused(422, "MovieUnreadable", f"{movie.name}: expected numbers in the frames; found none")
    low, high = (float(v) for v in np.percentile(values, [LOW_PCT, HIGH_PCT]))
    least, most = float(values.min()), float(values.max())
    counts, _ = np.histogram(values, BINS, (least, most if most > least else least + 1))
    return Grey(low, high if high > low else low + 1, least, most, tuple(int(n) for n in counts))


def eight_bits(frame: np.ndarray, low: float, high: float) -> np.ndarray:
    """Scale a frame to 8 bits between grey limits."""
    scale = 255.0 / (high - low) if high > low else 255.0
    scaled = np.asarray(frame, np.float32) * np.float32(scale) - np.float32(low * scale)
    return np.asarray(np.clip(np.nan_to_num(scaled), 0, 255), np.uint8)


def jpeg(picture: np.ndarray, width: int | None) -> bytes:
    """Write a picture as JPEG, reduced where it is wider than `width`."""
    if width is not None and width < picture.shape[1]:
        rows = max(1, round(picture.shape[0] * width / picture.shape[1]))
        picture = cv2.resize(picture, (width, rows), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()

