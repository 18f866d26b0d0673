"""Open a movie: any folder of single-frame TIFFs, or a multi-page TIFF, becomes a `Movie`.

Frames are decoded when they are asked for, so a movie of any length takes the same memory. The user's files are only
ever read. The optional preprocessing (crop, time window, filters, dropping of flashes) happens in memory, on the way.

Time stamps and pixel size are taken from OME and ImageJ metadata; the resolution tag of a plain TIFF is not used,
because most programs write a print resolution there.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import tifffile

from .calibration import Calibration, tiff_calibration
from .config import Reading
from .data import Finding, Frames, Image, Movie
from .errors import MicrobundleError, MovieUnreadable
from .mask_files import find_supplied_masks, read_mask
from .prepare import Prepared, find_flashes

SUFFIXES = (".tif", ".tiff")
CACHE_BYTES = 96 * 2**20
"""Decoded frames that are kept, so that short movies are decoded once although several stages read them."""


def read_movie(path: Path | str, *, fps: float | None = None, um_per_px: float | None = None,
               tissue_mask: Path | str | None = None) -> Movie:
    """Open a folder of single-frame TIFFs or a multi-page TIFF as a `Movie`.

    A folder may be the paper's layout (`movie/` with the frames, `masks/` beside it) or hold the frames itself; the
    frames are taken in the natural order of their names (2 before 10). `fps` and `um_per_px` (micrometres) win over
    what the file says. `tissue_mask` is a file for `read_mask` and wins over the one in `masks/`.

    Raises MovieUnreadable (missing, damaged, no frames, several movies) and MaskUnusable.
    """
    path = Path(path)
    _check_positive("fps", fps)
    _check_positive("um_per_px", um_per_px)
    if path.is_dir():
        frames, files, findings, found = _open_folder(path)
    elif path.is_file():
        frames, files, findings, found = _open_file(path)
    else:
        raise MovieUnreadable(f"{path}: expected a movie (a folder of TIFFs or a TIFF file); there is no such file")

    first = frames[0]
    masks = find_supplied_masks(path, first.shape)
    if tissue_mask is not None:
        masks["tissue"] = read_mask(tissue_mask, first.shape)
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
        return self._get(index)

    def _decode(self, index: int) -> Image:
        frame = self._frames[index]
        frame.setflags(write=False)
        return frame


class TiffFiles:
    """Frames of a folder with one TIFF each."""

    def __init__(self, files: tuple[Path, ...]) -> None:
        self._files = files
        self._shape = self[0].shape

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> Image:
        file = self._files[index]
        try:
            frame = tifffile.imread(file)
        except Exception as error:  # tifffile raises many kinds on damaged files
            raise _undecodable(file, error) from None
        return _grey(frame, file, getattr(self, "_shape", None))


class TiffPages:
    """Frames of one multi-page TIFF."""

    def __init__(self, file: Path) -> None:
        self._file = file
        try:
            self._tiff = tifffile.TiffFile(file)
            series = self._tiff.series[0]
            pages, axes, shape = series.pages, series.axes, series.shape
        except Exception as error:  # tifffile raises many kinds on damaged files
            raise _undecodable(file, error) from None
        self.axes, self.series_shape = axes, shape
        self._pages = pages
        self._count = _time_length(file, axes, shape)
        self._shape: tuple[int, ...] | None = None
        self._shape = self[0].shape

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Image:
        try:
            page = self._pages[index]
            if page is None:
                raise ValueError(f"page {index} is missing")
            frame = page.asarray()
        except Exception as error:  # tifffile raises many kinds on damaged files
            raise _undecodable(self._file, error, index) from None
        return _grey(frame, self._file, self._shape, index)

    @property
    def tiff(self) -> tifffile.TiffFile:
        """The open file, for its metadata."""
        return self._tiff


Opened = tuple[Frames, tuple[Path, ...], tuple[Finding, ...], Calibration]


def _open_folder(folder: Path) -> Opened:
    try:
        home = folder / "movie" if (folder / "movie").is_dir() else folder
        files = tuple(sorted((f for f in home.iterdir() if _is_tiff_name(f)), key=lambda f: natural_key(f.name)))
    except OSError as error:
        raise MovieUnreadable(f"{folder}: the folder cannot be read: {error.strerror or error}") from None
    if not files:
        raise MovieUnreadable(f"{home}: expected TIFF files ({', '.join(SUFFIXES)}, any case); found none")
    pages = _page_count(files[0])
    if pages > 1 and len(files) > 1:
        raise MovieUnreadable(f"{home}: expected one frame in each file; {files[0].name} holds {pages}. "
                              "A folder of movies is not one movie: give one of its files")
    if len(files) == 1 and pages > 1:
        return _open_file(files[0])
    return TiffFiles(files), files, _colour_note(files[0]), Calibration()


def _open_file(file: Path) -> Opened:
    _check_magic(file)
    pages = TiffPages(file)
    return pages, (file,), _colour_note(file) + _axis_note(pages.axes), tiff_calibration(pages.tiff, len(pages))


def _page_count(file: Path) -> int:
    _check_magic(file)
    try:
        with tifffile.TiffFile(file) as tiff:
            return _time_length(file, tiff.series[0].axes, tiff.series[0].shape)
    except MicrobundleError:
        raise
    except Exception as error:  # tifffile raises many kinds on damaged files
        raise _undecodable(file, error) from None


def _check_magic(file: Path) -> None:
    """Tell a TIFF by its first bytes, whatever its name."""
    try:
        with file.open("rb") as stream:
            magic = stream.read(4)
    except OSError as error:
        raise MovieUnreadable(f"{file}: the file cannot be read: {error.strerror or error}") from None
    if magic[:2] not in (b"II", b"MM") or magic[2:] not in (b"*\0", b"\0*", b"+\0", b"\0+"):
        what = "an empty file" if not magic else f"a file that starts with {magic!r}"
        raise MovieUnreadable(f"{file}: expected a TIFF; found {what}")


def _time_length(file: Path, axes: str, shape: tuple[int, ...]) -> int:
    """Number of frames of a TIFF series, which must hold exactly one axis besides row, col and colour."""
    long = {a: n for a, n in zip(axes, shape, strict=True) if a not in "YXS" and n > 1}
    if len(long) > 1:
        sizes = ", ".join(f"{a} {n}" for a, n in long.items())
        raise MovieUnreadable(f"{file}: expected one series of grey frames over time; found axes {sizes}. "
                              "Save one channel and one focal plane as a movie of its own")
    return next(iter(long.values()), 1)


def _axis_note(axes: str) -> tuple[Finding, ...]:
    if "Z" in axes and "T" not in axes:
        return (Finding("z_as_time", "info", "the file calls its frames focal planes (Z); they are taken as time"),)
    if "C" in axes and "T" not in axes:
        return (Finding("c_as_time", "review", "the file calls its frames channels (C); they are taken as time"),)
    return ()


def _colour_note(file: Path) -> tuple[Finding, ...]:
    with tifffile.TiffFile(file) as tiff:
        if "S" in tiff.series[0].axes:
            return (Finding("colour_converted", "info", "the frames are in colour; their luminance was used"),)
    return ()


def _grey(frame: Image, file: Path, shape: tuple[int, ...] | None, index: int | None = None) -> Image:
    """Bring a decoded frame to 2-D grey, and check it against the first one."""
    where = f"{file}" if index is None else f"{file}, frame {index}"
    frame = np.squeeze(frame) if frame.ndim > 2 else frame
    if frame.ndim == 3 and frame.shape[-1] in (3, 4):
        frame = _luminance(frame)
    if frame.ndim != 2 or min(frame.shape) < 1:
        raise MovieUnreadable(f"{where}: expected one grey or colour frame; found an array of shape {frame.shape}")
    if shape is not None and frame.shape != shape:
        raise MovieUnreadable(f"{where}: expected {shape[0]} x {shape[1]} px as in the first frame; "
                              f"found {frame.shape[0]} x {frame.shape[1]}")
    if frame.dtype == np.bool_ or np.iscomplexobj(frame):
        raise MovieUnreadable(f"{where}: expected grey values; found {frame.dtype}")
    if np.issubdtype(frame.dtype, np.floating) and not np.isfinite(frame).all():
        raise MovieUnreadable(f"{where}: expected numbers; found NaN or infinity in {int((~np.isfinite(frame)).sum())} "
                              "pixels")
    return frame.astype(frame.dtype.newbyteorder("="), copy=False)


def _luminance(frame: Image) -> Image:
    rgb = frame[..., :3]
    if (rgb[..., 0] == rgb[..., 1]).all() and (rgb[..., 0] == rgb[..., 2]).all():
        return np.ascontiguousarray(rgb[..., 0])
    grey = rgb @ np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
    return np.rint(grey).astype(frame.dtype) if np.issubdtype(frame.dtype, np.integer) else grey.astype(frame.dtype)


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


def _undecodable(file: Path, error: Exception, index: int | None = None) -> MovieUnreadable:
    where = f"{file}" if index is None else f"{file}, frame {index}"
    reason = str(error).strip().splitlines()
    hint = ""
    if "imagecodecs" in str(error):
        hint = '; this compression needs another package: pip install imagecodecs'
    return MovieUnreadable(f"{where}: the TIFF cannot be decoded: "
                           f"{reason[0] if reason else type(error).__name__}{hint}")


def _check_positive(name: str, value: float | None) -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise MovieUnreadable(f"{name}: expected a positive number; found {value}")


