"""Open a movie: any folder of single-frame TIFFs, or a file of any format in `formats`, becomes a `Movie`.

Frames are decoded when they are asked for, so a movie of any length takes the same memory. The user's files are only
ever read. The optional preprocessing (crop, time window, filters, dropping of flashes) happens in memory, on the way.

Time stamps and pixel size are the file's own; the resolution tag of a plain TIFF is not used, because most programs
write a print resolution there.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from .config import Reading
from .data import Finding, Frames, Image, Movie
from .errors import ChoiceMissing, ConfigError, MovieUnreadable
from .formats import leica, nikon, tiff, tiff_folder, video, zeiss
from .formats.opened import Contents, Selection
from .formats.tiff_folder import natural_key as natural_key
from .mask_files import find_supplied_masks
from .prepare import Prepared, find_flashes

CACHE_BYTES = 64 * 2**20
"""Decoded frames that are kept, so that short movies are decoded once although several stages read them."""


def read_movie(path: Path | str, *, fps: float | None = None, um_per_px: float | None = None,
               tissue_mask: Path | str | None = None, series: int | None = None, channel: int | None = None,
               z: int | None = None) -> Movie:
    """Open a folder of single-frame TIFFs, or a TIFF, ND2, CZI, LIF, AVI, MP4, MOV or MKV file, as a `Movie`.

    A folder may be the paper's layout (`movie/` with the frames, `masks/` beside it) or hold the frames itself; the
    frames are taken in the natural order of their names (2 before 10). `fps` and `um_per_px` (micrometres) win over
    what the file says. `tissue_mask` is a file for `read_mask` and wins over the one in `masks/`. `series`, `channel`
    and `z` count from 0 and choose from a file that holds several.

    Raises MovieUnreadable (missing, damaged, no frames, several movies), ChoiceMissing (several series, channels or
    focal planes, and none chosen) and MaskUnusable.
    """
    path = Path(path).expanduser()
    _check_positive("fps", fps)
    _check_positive("um_per_px", um_per_px)
    opened = _guarded(path, "open_movie", Selection(series, channel, z))
    first = opened.frames[0]
    masks = find_supplied_masks(path, first.shape, tissue_mask)
    found = opened.calibration
    movie = Movie(
        name=movie_name(path), frames=Cached(opened.frames), shape=_shape(first), time_s=found.time_s,
        time_source=found.time_source, um_per_px=found.um_per_px, um_per_px_source=found.um_per_px_source,
        supplied_masks=masks, files=opened.files, findings=opened.all_findings, taken=opened.choice.taken,
    )
    return calibrated(movie, fps, um_per_px)


def describe(path: Path | str, *, series: int | None = None, channel: int | None = None,
             z: int | None = None) -> dict[str, Any]:
    """List what is inside a file or folder: its series, and the movie that one of them, or the chosen one, makes.

    The key `movie` is None where something has to be chosen first; `to_choose` then says what. Raises MovieUnreadable.
    """
    path = Path(path).expanduser()
    inside: Contents = _guarded(path, "contents")
    out: dict[str, Any] = {
        "file": str(path), "format": inside.format,
        "series": [{"name": s.name, "sizes": dict(s.sizes), "channels": list(s.channels), "bits": s.bits,
                    "compression": s.compression} for s in inside.series],
        "movie": None, "to_choose": None,
    }
    try:
        movie = read_movie(path, series=series, channel=channel, z=z)
    except ChoiceMissing as missing:
        return out | {"to_choose": str(missing).removeprefix(f"{path}: ")}
    return out | {"movie": {
        "name": movie.name, "frames": movie.count, "rows": movie.shape[0], "cols": movie.shape[1],
        "number_type": str(movie.frames[0].dtype), "taken": dict(movie.taken), "um_per_px": movie.um_per_px,
        "um_per_px_source": movie.um_per_px_source, "frames_per_s": movie.frames_per_s,
        "time_source": movie.time_source, "duration_s": None if movie.time_s is None else float(movie.time_s[-1]),
        "masks": sorted(movie.supplied_masks),
        "findings": [vars(f) for f in movie.findings]}}


def calibrated(movie: Movie, fps: float | None, um_per_px: float | None) -> Movie:
    """Give a movie the frame rate (frames/s) and pixel size (um) that the user states; None keeps the file's."""
    if fps is not None:
        movie = replace(movie, time_s=np.arange(movie.count) / fps, time_source="user")
    if um_per_px is not None:
        movie = replace(movie, um_per_px=um_per_px, um_per_px_source="user")
    return movie


def prepare(movie: Movie, reading: Reading) -> Movie:
    """Cut and filter a movie in memory as the settings ask; the frames stay decoded on demand.

    Raises MovieUnreadable where the crop or the time window lies outside the movie, and ConfigError where the settings
    choose another series, channel or focal plane than was opened.
    """
    for name in ("series", "channel", "z"):
        if (wanted := getattr(reading, name)) is not None and movie.taken.get(name) != wanted:
            raise ConfigError(f"{movie.name}: reading.{name} is {wanted}, but the movie was opened with "
                              f"{movie.taken.get(name)}. Give {name}={wanted} to read_movie")
    count, (rows, cols) = movie.count, movie.shape
    stop = count if reading.stop_frame is None else min(reading.stop_frame, count)
    if reading.first_frame >= stop:
        raise MovieUnreadable(f"{movie.name}: expected first_frame below {count}, the number of frames; "
                              f"found {reading.first_frame}")
    keep = np.arange(reading.first_frame, stop)
    findings = movie.findings
    if reading.drop_flashes:
        flashes = find_flashes(movie.frames, keep)
        keep = np.setdiff1d(keep, flashes)
        if len(flashes):
            gaps = "" if movie.time_s is not None else "; without frame times, periods across them are too short"
            findings += (Finding("flashes_dropped", "info" if not gaps else "review",
                                 f"{len(flashes)} flash frames were left out{gaps}", float(len(flashes))),)
    r0, r1, c0, c1 = reading.crop_px or (0, rows, 0, cols)
    if r1 > rows or c1 > cols:
        raise MovieUnreadable(f"{movie.name}: expected a crop inside {rows} x {cols} px; found {reading.crop_px}")
    filtered = reading.kernel is not None or reading.sharpen > 0 or reading.smooth_px > 0
    if not filtered and len(keep) == count and (r0, r1, c0, c1) == (0, rows, 0, cols):
        return movie
    return replace(
        movie, frames=Cached(Prepared(movie.frames, keep, (r0, r1, c0, c1), reading)), shape=(r1 - r0, c1 - c0),
        time_s=None if movie.time_s is None else movie.time_s[keep], findings=findings,
        supplied_masks={name: mask[r0:r1, c0:c1] for name, mask in movie.supplied_masks.items()},
    )


def content_hash(movie: Movie) -> str:
    """Compute the SHA-256 of the names and contents of a movie's files, "" for a movie made in memory."""
    if not movie.files:
        return ""
    total = hashlib.sha256()
    for file in movie.files:
        total.update(file.name.encode())
        try:
            with file.open("rb") as stream:
                total.update(hashlib.file_digest(stream, "sha256").digest())
        except OSError as error:
            raise MovieUnreadable(f"{file}: the file can no longer be read: {error.strerror or error}") from None
    return total.hexdigest()


class Cached:
    """Frames that keep what was decoded, up to a fixed number of bytes; a copy in another process starts empty."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._most = max(1, CACHE_BYTES // max(1, frames[0].nbytes))
        self._get = lru_cache(maxsize=self._most)(self._decode)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Image:
        count = len(self._frames)
        if not -count <= index < count:
            raise IndexError(f"frame {index} is not one of the {count} frames of this movie")
        return self._get(int(index) % count)

    def __getstate__(self) -> tuple[Frames, int]:
        return self._frames, self._most

    def __setstate__(self, state: tuple[Frames, int]) -> None:
        self._frames, self._most = state
        self._get = lru_cache(maxsize=self._most)(self._decode)

    def _decode(self, index: int) -> Image:
        frame = self._frames[index]
        frame.setflags(write=False)
        return frame


def _guarded(path: Path, task: str, *arguments: Any) -> Any:
    """Let the format of a file do a task; whatever goes wrong with the file itself is MovieUnreadable."""
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
        if not (is_folder or is_file):
            raise MovieUnreadable(f"{path}: expected a movie (a folder of TIFFs or a movie file); there is no such "
                                  "file")
        return getattr(_format(path, is_folder), task)(path, *arguments)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MovieUnreadable(f"{path}: the movie cannot be read: {reason}") from None


def _format(path: Path, is_folder: bool) -> Any:
    """Choose the module that reads a file, by its first bytes."""
    if is_folder:
        return tiff_folder
    try:
        with path.open("rb") as stream:
            magic = stream.read(64)
    except OSError as error:
        raise MovieUnreadable(f"{path}: the file cannot be read: {error.strerror or error}") from None
    if magic[:4] in tiff.MAGIC:
        return tiff
    if magic.startswith(nikon.MAGIC):
        return nikon
    if magic.startswith(zeiss.MAGIC):
        return zeiss
    if leica.is_leica(magic):
        return leica
    if video.format_of(magic):
        return video
    what = "an empty file" if not magic else f"a file that starts with {magic[:4]!r}"
    if magic.startswith(b"version https://git-lfs"):
        what = "a pointer of Git LFS, not the file itself; fetch it with `git lfs pull`"
    raise MovieUnreadable(f"{path}: expected a TIFF, ND2, CZI, LIF, AVI, MP4, MOV or MKV file; found {what}")


def movie_name(path: Path | str) -> str:
    """Name a movie after its file or folder."""
    path = Path(path).expanduser().resolve()
    if path.is_dir():
        return path.parent.name if path.name == "movie" else path.name
    return path.name.removesuffix(path.suffix).removesuffix(".ome")


def _shape(frame: Image) -> tuple[int, int]:
    return int(frame.shape[0]), int(frame.shape[1])


def _check_positive(name: str, value: float | None) -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise MovieUnreadable(f"{name}: expected a positive number; found {value}")


