"""Open a movie: any folder of single-frame TIFFs, or a multi-page TIFF, becomes a `Movie`.

Frames are decoded when they are asked for, so a movie of any length takes the same memory. The user's files are only
ever read. The optional preprocessing (crop, time window, filters, dropping of flashes) happens in memory, on the way.

Time stamps and pixel size are taken from OME and ImageJ metadata; the resolution tag of a plain TIFF is not used,
because most programs write a print resolution there.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import tifffile

from .calibration import Calibration, tiff_calibration
from .config import Reading
from .data import Finding, Frames, Image, Movie
from .errors import MovieUnreadable
from .mask_files import find_supplied_masks
from .prepare import Prepared, find_flashes
from .tiff import SUFFIXES, TiffFiles, TiffPages, axis_note, check_magic, colour_note, page_count

CACHE_BYTES = 64 * 2**20
"""Decoded frames that are kept, so that short movies are decoded once although several stages read them."""


def read_movie(path: Path | str, *, fps: float | None = None, um_per_px: float | None = None,
               tissue_mask: Path | str | None = None) -> Movie:
    """Open a folder of single-frame TIFFs or a multi-page TIFF as a `Movie`.

    A folder may be the paper's layout (`movie/` with the frames, `masks/` beside it) or hold the frames itself; the
    frames are taken in the natural order of their names (2 before 10). `fps` and `um_per_px` (micrometres) win over
    what the file says. `tissue_mask` is a file for `read_mask` and wins over the one in `masks/`.

    Raises MovieUnreadable (missing, damaged, no frames, several movies) and MaskUnusable.
    """
    path = Path(path).expanduser()
    _check_positive("fps", fps)
    _check_positive("um_per_px", um_per_px)
    try:
        is_folder, is_file = path.is_dir(), path.is_file()
    except OSError as error:
        raise MovieUnreadable(f"{path}: the movie cannot be read: {error.strerror or error}") from None
    if not (is_folder or is_file):
        raise MovieUnreadable(f"{path}: expected a movie (a folder of TIFFs or a TIFF file); there is no such file")
    frames, files, findings, found = _open_folder(path) if is_folder else _open_file(path)

    first = frames[0]
    masks = find_supplied_masks(path, first.shape, tissue_mask)
    movie = Movie(
        name=_name(path), frames=Cached(frames), shape=_shape(first), time_s=found.time_s,
        time_source=found.time_source, um_per_px=found.um_per_px, um_per_px_source=found.um_per_px_source,
        supplied_masks=masks, files=files, findings=findings,
    )
    return calibrated(movie, fps, um_per_px)


def calibrated(movie: Movie, fps: float | None, um_per_px: float | None) -> Movie:
    """Give a movie the frame rate (frames/s) and pixel size (um) that the user states; None keeps the file's."""
    if fps is not None:
        movie = replace(movie, time_s=np.arange(movie.count) / fps, time_source="user")
    if um_per_px is not None:
        movie = replace(movie, um_per_px=um_per_px, um_per_px_source="user")
    return movie


def prepare(movie: Movie, reading: Reading) -> Movie:
    """Cut and filter a movie in memory as the settings ask; the frames stay decoded on demand.

    Raises MovieUnreadable where the crop or the time window lies outside the movie.
    """
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
    """Frames that keep what was decoded, up to a fixed number of bytes."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        first = frames[0]
        self._get = lru_cache(maxsize=max(1, CACHE_BYTES // max(1, first.nbytes)))(self._decode)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Image:
        count = len(self._frames)
        if not -count <= index < count:
            raise IndexError(f"frame {index} is not one of the {count} frames of this movie")
        return self._get(int(index) % count)

    def _decode(self, index: int) -> Image:
        frame = self._frames[index]
        frame.setflags(write=False)
        return frame


Opened = tuple[Frames, tuple[Path, ...], tuple[Finding, ...], Calibration]


def _open_folder(folder: Path) -> Opened:
    try:
        home = folder / "movie" if (folder / "movie").is_dir() else folder
        files = tuple(sorted((f for f in home.iterdir() if _is_tiff_name(f)),
                             key=lambda f: (natural_key(f.name), f.name)))
    except OSError as error:
        raise MovieUnreadable(f"{folder}: the folder cannot be read: {error.strerror or error}") from None
    if not files:
        raise MovieUnreadable(f"{home}: expected TIFF files ({', '.join(SUFFIXES)}, any case); found none")
    pages = page_count(files[0])
    if pages > 1 and len(files) > 1:
        raise MovieUnreadable(f"{home}: expected one frame in each file; {files[0].name} holds {pages}. "
                              "A folder of movies is not one movie: give one of its files")
    if len(files) == 1 and pages > 1:
        return _open_file(files[0])
    frames = TiffFiles(files)
    with tifffile.TiffFile(files[0]) as tiff:
        found = tiff_calibration(tiff, len(files))
    return frames, files, colour_note(files[0]) + name_notes(files) + found.findings, found


def _open_file(file: Path) -> Opened:
    check_magic(file)
    pages = TiffPages(file)
    found = tiff_calibration(pages.tiff, len(pages))
    return pages, (file,), colour_note(file) + axis_note(pages.axes) + found.findings, found


def name_notes(files: tuple[Path, ...]) -> tuple[Finding, ...]:
    """Say where the names of the frames suggest that some are missing, or that they are of several movies."""
    stems = [file.stem.casefold() for file in files]
    patterns = sorted({re.sub(r"\d+", "#", stem) for stem in stems})
    if len(patterns) > 1:
        return (Finding("names_differ", "review", f"the file names follow {len(patterns)} patterns "
                        f"({patterns[0]}, {patterns[1]}{', ...' if len(patterns) > 2 else ''}); all were taken as one "
                        "movie, in the natural order of their names", float(len(patterns)), 1.0),)
    numbers = np.array([[float(n) for n in re.findall(r"\d+", stem)] for stem in stems])
    counting = numbers[:, np.ptp(numbers, axis=0) > 0]
    if counting.shape[1] != 1:
        return ()
    steps = np.diff(counting[:, 0])
    jumps = np.flatnonzero(steps > steps.min())
    if not jumps.size:
        return ()
    return (Finding("frames_missing", "review", f"the numbers in the file names jump after {files[jumps[0]].name}"
                    f"{f' and {jumps.size - 1} times more' if jumps.size > 1 else ''}; where frames are missing, times "
                    "and periods are wrong", float(jumps.size), 0.0),)


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Make a sort key that puts `2` before `10`, whatever the case of the letters."""
    key: list[tuple[int, int | str]] = []
    digits = ""
    for char in name.casefold() + "\0":
        if char.isdecimal() and char.isascii():
            digits += char
            continue
        if digits:
            key.append((0, int(digits)))
            digits = ""
        key.append((1, char))
    return key


def _is_tiff_name(file: Path) -> bool:
    return file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()


def _name(path: Path) -> str:
    path = path.resolve()
    if path.is_dir():
        return path.parent.name if path.name == "movie" else path.name
    return path.name.removesuffix(path.suffix).removesuffix(".ome")


def _shape(frame: Image) -> tuple[int, int]:
    return int(frame.shape[0]), int(frame.shape[1])


def _check_positive(name: str, value: float | None) -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise MovieUnreadable(f"{name}: expected a positive number; found {value}")


