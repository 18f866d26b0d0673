"""Decode grey frames from TIFF files, one when it is asked for, and refuse what is not one whole movie.

A page is brought to 2-D grey in the numbers the file holds (colour to its luminance, ITU-R BT.601). A file that was cut
off, or whose pages differ in size, is refused: to leave frames out silently would falsify the times of the others.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from .data import Finding, Image
from .errors import MicrobundleError, MovieUnreadable

SUFFIXES = (".tif", ".tiff")


class TiffFiles:
    """Frames of a folder with one TIFF each."""

    def __init__(self, files: tuple[Path, ...]) -> None:
        self._files = files
        self._shape: tuple[int, ...] | None = None
        self._shape = self[0].shape

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> Image:
        file = self._files[index]
        try:
            # One file of a set in OME's layout names the others; here each file stands for itself.
            with tifffile.TiffFile(file, is_ome=False) as tiff:
                count = time_length(file, tiff.series[0].axes, tiff.series[0].shape)
                page = tiff.pages[0]
                frame = page.asarray() if count == 1 else None
        except MicrobundleError:
            raise
        except Exception as error:  # tifffile raises many kinds on damaged files
            raise undecodable(file, error) from None
        if frame is None:
            raise MovieUnreadable(f"{file}: expected one frame, as in {self._files[0].name}; found {count}")
        return grey(frame, page.axes, file, self._shape)


class TiffPages:
    """Frames of one multi-page TIFF."""

    def __init__(self, file: Path) -> None:
        self._file = file
        try:
            self.tiff = tifffile.TiffFile(file)
            series = self.tiff.series[0]
            self.axes: str = series.axes
            self._count = time_length(file, series.axes, series.shape)
            self._pages = series.pages
            self._block = _block(self.tiff, file, self._count) if series.is_truncated else None
            _check_whole(self.tiff, file)
        except MicrobundleError:
            raise
        except Exception as error:  # tifffile raises many kinds on damaged files
            raise undecodable(file, error) from None
        self._shape: tuple[int, ...] | None = None
        self._shape = self[0].shape

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Image:
        try:
            if self._block is not None:
                return grey(np.array(self._block[index]), "YX", self._file, self._shape, index)
            page = self._pages[index]
            if page is None:
                raise ValueError("the file that holds this frame is missing")
            frame = page.asarray()
        except MicrobundleError:
            raise
        except Exception as error:  # tifffile raises many kinds on damaged files
            raise undecodable(self._file, error, index) from None
        return grey(frame, page.axes, self._file, self._shape, index)


def page_count(file: Path) -> int:
    """Count the frames in one TIFF of a folder. Raises MovieUnreadable."""
    check_magic(file)
    try:
        with tifffile.TiffFile(file, is_ome=False) as tiff:
            return time_length(file, tiff.series[0].axes, tiff.series[0].shape)
    except MicrobundleError:
        raise
    except Exception as error:  # tifffile raises many kinds on damaged files
        raise undecodable(file, error) from None


def check_magic(file: Path) -> None:
    """Tell a TIFF by its first bytes, whatever its name. Raises MovieUnreadable for anything else."""
    try:
        with file.open("rb") as stream:
            magic = stream.read(4)
    except OSError as error:
        raise MovieUnreadable(f"{file}: the file cannot be read: {error.strerror or error}") from None
    if magic[:2] not in (b"II", b"MM") or magic[2:] not in (b"*\0", b"\0*", b"+\0", b"\0+"):
        what = "an empty file" if not magic else f"a file that starts with {magic!r}"
        raise MovieUnreadable(f"{file}: expected a TIFF; found {what}")


def time_length(file: Path, axes: str, shape: tuple[int, ...]) -> int:
    """Count the frames of a TIFF series, which must hold no more than one axis besides row, col and colour."""
    long = {a: n for a, n in zip(axes, shape, strict=True) if a not in "YXS" and n > 1}
    if len(long) > 1:
        sizes = ", ".join(f"{a} {n}" for a, n in long.items())
        raise MovieUnreadable(f"{file}: expected one series of grey frames over time; found axes {sizes}. "
                              "Save one channel and one focal plane as a movie of its own")
    return next(iter(long.values()), 1)


def axis_note(axes: str) -> tuple[Finding, ...]:
    """Say where frames that the file does not call times are taken for them."""
    if "Z" in axes and "T" not in axes:
        return (Finding("z_as_time", "info", "the file calls its frames focal planes (Z); they are taken as time"),)
    if "C" in axes and "T" not in axes:
        return (Finding("c_as_time", "review", "the file calls its frames channels (C); they are taken as time"),)
    return ()


def colour_note(file: Path) -> tuple[Finding, ...]:
    """Say where the frames are in colour."""
    with tifffile.TiffFile(file, is_ome=False) as tiff:
        if "S" in tiff.series[0].axes:
            return (Finding("colour_converted", "info", "the frames are in colour; their luminance was used"),)
    return ()


def grey(frame: Image, axes: str, file: Path, shape: tuple[int, ...] | None, index: int | None = None) -> Image:
    """Bring a decoded page to 2-D grey, and check it against the shape of the first one."""
    where = _where(file, index)
    if "S" in axes and frame.ndim == len(axes):
        frame = np.moveaxis(frame, axes.index("S"), -1)
    frame = np.squeeze(frame) if frame.ndim > 2 else frame
    if frame.ndim == 3 and frame.shape[-1] in (2, 3, 4):
        frame = luminance(frame)
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


def luminance(frame: Image) -> Image:
    """Turn RGB or RGBA (R, C, 3 or 4), or grey with opacity (R, C, 2), to grey of the same number type."""
    rgb = frame[..., :3]
    if frame.shape[-1] == 2 or ((rgb[..., 0] == rgb[..., 1]).all() and (rgb[..., 0] == rgb[..., 2]).all()):
        return np.ascontiguousarray(rgb[..., 0])
    weighted = np.asarray(rgb @ np.array([0.299, 0.587, 0.114]))  # ITU-R BT.601
    if np.issubdtype(frame.dtype, np.integer):
        weighted = np.rint(weighted)
    return weighted.astype(frame.dtype)


def undecodable(file: Path, error: Exception, index: int | None = None) -> MovieUnreadable:
    """Make the error for a file or frame that the TIFF library gives up on."""
    reason = str(error).strip().splitlines()
    hint = "; this compression needs another package: pip install imagecodecs" if "imagecodecs" in str(error) else ""
    return MovieUnreadable(f"{_where(file, index)}: the TIFF cannot be decoded: "
                           f"{reason[0] if reason else type(error).__name__}{hint}")


def _where(file: Path, index: int | None) -> str:
    return f"{file}" if index is None else f"{file}, frame {index}"


def _block(tiff: tifffile.TiffFile, file: Path, count: int) -> Any:
    """Map the frames of a file that lists only its first page, the others following it in one block (ImageJ)."""
    series = tiff.series[0]
    if series.dataoffset is None or "S" in series.axes or tiff.filehandle.size < series.dataoffset + series.nbytes:
        raise MovieUnreadable(f"{file}: expected {count} whole frames, as the file says; it is cut off")
    block = tifffile.memmap(file, series=0, mode="r")
    return block.reshape(count, *block.shape[-2:])


def _check_whole(tiff: tifffile.TiffFile, file: Path) -> None:
    """Refuse a file that was cut off, and one with pages of several sizes, previews apart."""
    form, handle, last = tiff.tiff, tiff.filehandle, tiff.pages[-1]
    handle.seek(last.offset)
    tags = struct.unpack(form.tagnoformat, handle.read(form.tagnosize))[0]
    handle.seek(last.offset + form.tagnosize + tags * form.tagsize)
    following = handle.read(form.offsetsize)
    if len(following) < form.offsetsize or struct.unpack(form.offsetformat, following)[0] != 0:
        raise MovieUnreadable(f"{file}: expected a whole TIFF; it is cut off after {len(tiff.pages)} pages")
    sizes = {series.shape[series.axes.index("Y"):] for series in tiff.series
             if "Y" in series.axes and not series.keyframe.is_reduced}
    if len(sizes) > 1:
        raise MovieUnreadable(f"{file}: expected frames of one size; found "
                              f"{' and '.join(' x '.join(map(str, size)) for size in sorted(sizes))}")
