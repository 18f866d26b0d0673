"""Read TIFF: multi-page, ImageJ hyperstack, OME-TIFF (also of several files), and folders of single-frame TIFFs.

A file that was cut off, or whose pages differ in size, is refused: to leave frames out silently would falsify the times
of the others. Nothing is memory-mapped, as a mapped file that shrinks while it is read would end the program.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from ..calibration import tiff_calibration
from ..data import Finding, Image
from ..errors import MicrobundleError, MovieUnreadable
from .grey import check_size, grey, undecodable
from .opened import PLANE, Choice, Contents, FileFrames, Opened, Selection, Series, choose, ordered, stamp

SUFFIXES = (".tif", ".tiff")
MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
MOST_TAGS = 4096
MOST_PACKED = 2000
"""No usual compression makes a picture smaller than this; deflate reaches 1032."""


def contents(file: Path) -> Contents:
    """List the series of a TIFF. Raises MovieUnreadable."""
    handle = _Handle.open(file)
    handle.tiff.close()
    return handle.contents


def open_movie(file: Path, selection: Selection) -> Opened:
    """Open one series, channel and focal plane of a TIFF. Raises MovieUnreadable and ChoiceMissing."""
    handle = _Handle.open(file)
    choice = choose(file, handle.contents, selection)
    frames = TiffFrames(file, choice, handle)
    colour = "S" in handle.series[choice.series].axes
    try:
        found = tiff_calibration(handle.tiff, choice.count, choice.series, choice.axis, choice.fixed,
                                 lambda t: handle.page(choice, t))
        files = handle.files(choice.series)
    except Exception as error:  # tifffile raises many kinds on damaged files
        raise undecodable(file, error) from None
    return Opened(handle.contents, choice, frames, files, found, colour_note(colour))


def colour_note(colour: bool) -> tuple[Finding, ...]:
    """Say that the frames are in colour."""
    if not colour:
        return ()
    return (Finding("colour_converted", "info", "the frames are in colour; their luminance was used"),)


@dataclass
class _Handle:
    """An open TIFF with the series in it that can be movies."""

    tiff: tifffile.TiffFile
    series: list[Any]
    contents: Contents

    @classmethod
    def open(cls, file: Path) -> _Handle:
        tiff = None
        try:
            check_chain(file)
            tiff = tifffile.TiffFile(file)
            form = "OME-TIFF" if tiff.is_ome else "ImageJ TIFF" if tiff.is_imagej else "TIFF"
            series = _movies(tiff, file)
            for one in series:
                _check_header(one, file)
            _check_whole(tiff, file)
            return cls(tiff, series, Contents(form, tuple(_described(tiff, one, i) for i, one in enumerate(series))))
        except Exception as error:  # tifffile raises many kinds on damaged files
            if tiff is not None:
                tiff.close()
            raise error if isinstance(error, MicrobundleError) else undecodable(file, error) from None

    def number(self, choice: Choice, frame: int) -> int:
        """Find the page of a frame."""
        series, at = self.series[choice.series], choice.at(frame)
        outer = [(at.get(a, 0), n) for a, n in zip(series.axes, series.shape, strict=True) if a not in PLANE]
        return int(np.ravel_multi_index([i for i, _ in outer], [n for _, n in outer])) if outer else 0

    def page(self, choice: Choice, frame: int) -> Any:
        series = self.series[choice.series]
        return None if series.is_truncated else series.pages[self.number(choice, frame)]

    def files(self, number: int) -> tuple[Path, ...]:
        series = self.series[number]
        pages = [] if series.is_truncated else [p for p in series.pages if p is not None]
        names = dict.fromkeys(page.parent.filehandle.path for page in pages) or [self.tiff.filehandle.path]
        return tuple(Path(name) for name in names)


class TiffFrames(FileFrames):
    """Frames of one series of a TIFF."""

    def _open(self) -> _Handle:
        return _Handle.open(self.file)

    def _read(self, index: int) -> tuple[Image, str]:
        handle: _Handle = self._handle
        series = handle.series[self.choice.series]
        if series.is_truncated:
            return _from_block(handle.tiff, series, handle.number(self.choice, index)), "YX"
        page = handle.page(self.choice, index)
        if page is None:
            raise ValueError("the file that holds this frame is missing")
        if page.parent.filehandle.closed:
            page.parent.filehandle.open()
        return page.asarray(), page.axes


class TiffFiles:
    """Frames of a folder with one TIFF each."""

    def __init__(self, files: tuple[Path, ...]) -> None:
        self._files = files
        self._stamps = [stamp(file) for file in files]
        self._shape: tuple[int, ...] | None = None
        self._shape = self[0].shape

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> Image:
        file = self._files[index]
        if stamp(file) != self._stamps[index]:
            raise MovieUnreadable(f"{file}: the file has changed since the movie was opened. Wait until it is written, "
                                  "and start again")
        try:
            # One file of a set in OME's layout names the others; here each file stands for itself.
            check_chain(file)
            with tifffile.TiffFile(file, is_ome=False) as tiff:
                count, page = page_count(tiff), tiff.pages[0]
                _check_header(tiff.series[0], file)
                frame = page.asarray() if count == 1 else None
        except MicrobundleError:
            raise
        except Exception as error:  # tifffile raises many kinds on damaged files
            raise undecodable(file, error) from None
        if frame is None:
            raise MovieUnreadable(f"{file}: expected one frame, as in {self._files[0].name}; found {count}")
        return grey(frame, page.axes, file, self._shape)


def single_frame(file: Path) -> tuple[int, Series]:
    """Count the frames in one TIFF of a folder, and describe its picture. Raises MovieUnreadable."""
    try:
        check_chain(file)
        with tifffile.TiffFile(file, is_ome=False) as tiff:
            _check_header(tiff.series[0], file)
            return page_count(tiff), _described(tiff, tiff.series[0], 0)
    except MicrobundleError:
        raise
    except Exception as error:  # tifffile raises many kinds on damaged files
        raise undecodable(file, error) from None


def check_chain(file: Path) -> None:
    """Refuse a file whose pages follow each other in a circle, or have more tags than any page: tifffile would not end.

    Raises MovieUnreadable.
    """
    with file.open("rb") as stream:
        head = stream.read(16)
        order = "<" if head[:2] == b"II" else ">"
        big = head[2:4] in (b"+\0", b"\0+")
        count, tag, link, first = ("Q", 20, "Q", head[8:16]) if big else ("H", 12, "I", head[4:8])
        seen: set[int] = set()
        while len(first) == struct.calcsize(link) and (place := struct.unpack(order + link, first)[0]):
            stream.seek(min(place, 2**62))
            number = stream.read(struct.calcsize(count))
            if len(number) < struct.calcsize(count):
                return
            tags = struct.unpack(order + count, number)[0]
            if place in seen or tags > MOST_TAGS:
                what = "they follow each other in a circle" if place in seen else f"one has {tags} tags"
                raise MovieUnreadable(f"{file}: expected a list of pages with an end; {what}. The TIFF is damaged")
            seen.add(place)
            stream.seek(tags * tag, 1)
            first = stream.read(struct.calcsize(link))


def page_count(tiff: tifffile.TiffFile) -> int:
    """Count the pictures of a TIFF's first series."""
    series = tiff.series[0]
    return int(np.prod([n for a, n in zip(series.axes, series.shape, strict=True) if a not in PLANE], initial=1))


def _movies(tiff: tifffile.TiffFile, file: Path) -> list[Any]:
    """Pick the series that may be movies, without previews."""
    found = [s for s in tiff.series if "Y" in s.axes and "X" in s.axes and not s.keyframe.is_reduced]
    sizes = {s.shape[s.axes.index("Y"):] for s in found}
    if len(sizes) > 1 and not tiff.is_ome:
        raise MovieUnreadable(f"{file}: expected frames of one size; found "
                              f"{' and '.join(' x '.join(map(str, size)) for size in sorted(sizes))}")
    return found


def _described(tiff: tifffile.TiffFile, series: Any, number: int) -> Series:
    page = series.keyframe
    sizes = ordered(dict(zip(series.axes, series.shape, strict=True)))
    labels: Any = (tiff.imagej_metadata or {}).get("Labels", ()) if tiff.is_imagej and number == 0 else ()
    names = tuple(str(name) for name in labels) if len(labels) == sizes.get("C", 1) > 1 else ()
    return Series(series.name if tiff.is_ome else "", sizes, names, int(page.bitspersample),
                  str(page.compression.name).lower())


def _check_header(series: Any, file: Path) -> None:
    """Refuse what cannot be true: a frame larger than the file can hold."""
    page = series.keyframe
    check_size(file, page.imagelength, page.imagewidth, max(1, page.dtype.itemsize if page.dtype else 1))
    if page.nbytes > MOST_PACKED * page.parent.filehandle.size:
        raise MovieUnreadable(f"{file}: expected whole frames of {page.imagelength} x {page.imagewidth} px, as its "
                              f"header says; the file has only {page.parent.filehandle.size} bytes. It is damaged")


def _from_block(tiff: tifffile.TiffFile, series: Any, number: int) -> Image:
    """Read a frame of a file that lists only its first page, the others following it in one block (ImageJ)."""
    shape = series.keyframe.shape
    handle = tiff.filehandle
    dtype = np.dtype(series.dtype).newbyteorder(tiff.byteorder)
    count = int(np.prod(shape))
    handle.seek(series.dataoffset + number * count * dtype.itemsize)
    return np.frombuffer(handle.read(count * dtype.itemsize), dtype, count).reshape(shape)


def _check_whole(tiff: tifffile.TiffFile, file: Path) -> None:
    """Refuse a file that was cut off."""
    for series in tiff.series:
        if series.is_truncated and (series.dataoffset is None or "S" in series.axes
                                    or tiff.filehandle.size < series.dataoffset + series.nbytes):
            raise MovieUnreadable(f"{file}: expected {len(series)} whole frames, as the file says; it is cut off")
    form, handle, last = tiff.tiff, tiff.filehandle, tiff.pages[-1]
    handle.seek(last.offset)
    tags = struct.unpack(form.tagnoformat, handle.read(form.tagnosize))[0]
    handle.seek(last.offset + form.tagnosize + tags * form.tagsize)
    following = handle.read(form.offsetsize)
    if len(following) < form.offsetsize or struct.unpack(form.offsetformat, following)[0] != 0:
        raise MovieUnreadable(f"{file}: expected a whole TIFF; it is cut off after {len(tiff.pages)} pages")
