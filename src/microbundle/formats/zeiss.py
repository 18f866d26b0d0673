"""Read Zeiss CZI files with the library czifile, which needs Python 3.12 or newer: scenes are series."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..calibration import Calibration, rising, square
from ..data import Floats, Image
from ..errors import MicrobundleError, MovieUnreadable
from .grey import undecodable
from .opened import (
    PLANE,
    Choice,
    Contents,
    FileFrames,
    Opened,
    Selection,
    Series,
    check_series,
    open_part,
    ordered,
    require,
)

MAGIC = b"ZISRAWFILE"
DAYS = (3e4, 8e4)
"""Stamps in this range with tiny steps are days since 1899-12-30, as some versions of ZEN write them."""
DAY_S = 86400.0
PICTURES_AT, ATTACHMENTS_AT = 84, 104
"""Where the header names the places of the lists of pictures and of what else is attached."""
DIRECTORY = b"ZISRAWDIRECTORY"
MOST_AXES = 64
MOST_ENLARGED = 2**28
"""Pixels that a picture of a pyramid, which stores fewer, may stand for."""


def contents(file: Path) -> Contents:
    """List the scenes of a CZI file. Raises MovieUnreadable."""
    handle, _, found = _inspect(file)
    handle.close()
    return found


def open_movie(file: Path, selection: Selection) -> Opened:
    """Open one scene, channel and focal plane of a CZI file. Raises MovieUnreadable and ChoiceMissing."""
    handle, scenes, inside = _inspect(file)
    return open_part(file, inside, selection, lambda choice: CziFrames(file, choice, (handle, scenes)),
                     lambda frames: _calibration(handle, scenes[frames.choice.series], frames.choice))


class CziFrames(FileFrames):
    """Frames of one scene of a CZI file."""

    def _open(self) -> Any:
        return _inspect(self.file)[:2]

    def _read(self, index: int) -> tuple[Image, str]:
        scene = self._handle[1][self.choice.series]
        # czifile counts from where the file begins, which need not be 0.
        start = dict(zip(scene.dims, scene.start, strict=True))
        at = {a: start[a] + i for a, i in self.choice.at(index).items() if a in start}
        picture = scene(**at) if at else scene
        frame = np.asarray(picture.asarray(maxworkers=1))
        return frame.reshape([n for a, n in picture.sizes.items() if a in PLANE]), \
            "".join(a for a in picture.dims if a in PLANE)


def _inspect(file: Path) -> tuple[Any, list[Any], Contents]:
    if sys.version_info < (3, 12):
        raise MovieUnreadable(f"{file}: reading Zeiss CZI needs Python 3.12 or newer; this is "
                              f"{sys.version_info[0]}.{sys.version_info[1]}. With a newer one: "
                              'pip install "microbundle[czi]"')
    czifile = require(file, "czifile", "czi", "Zeiss CZI")
    handle = None
    try:
        _check_directories(file)
        handle = czifile.CziFile(str(file))
        scenes = [handle.scenes[key] for key in handle.scenes]
        series = tuple(_described(scene, len(scenes)) for scene in scenes)
        found = Contents("Zeiss CZI", series)
        check_series(file, found, max((int(scene.dtype.itemsize) for scene in scenes), default=1))
    except MicrobundleError:
        raise
    except Exception as error:  # the library raises many kinds on damaged files
        if handle is not None:
            handle.close()
        raise undecodable(file, error) from None
    return handle, scenes, found


def _check_directories(file: Path) -> None:
    """Refuse a file without its list of pictures, or with lists of more than it has room for: czifile would search all
    of it, or read without end."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        if _list_of(stream, PICTURES_AT, size) != DIRECTORY:
            raise MovieUnreadable(f"{file}: expected its list of pictures; there is none. The file is damaged, or was "
                                  "not closed by the microscope")
        count = _count(file, stream, 32, size)
        for _ in range(count):
            axes = int.from_bytes(stream.read(32)[28:], "little")
            if axes > MOST_AXES:
                raise MovieUnreadable(f"{file}: expected pictures of at most {MOST_AXES} axes; found {axes}. The file "
                                      "is damaged")
            _check_axes(file, stream.read(20 * axes))
        _list_of(stream, ATTACHMENTS_AT, size)
        _count(file, stream, 128, size)


def _list_of(stream: BinaryIO, place: int, size: int) -> bytes:
    """Go to the list of which the header names the place, behind its own header; returns what that calls itself."""
    stream.seek(place)
    stream.seek(min(int.from_bytes(stream.read(8), "little"), size))
    return stream.read(32)[:16].rstrip(b"\0")


def _count(file: Path, stream: BinaryIO, entry: int, size: int) -> int:
    """Read how many entries, of so many bytes at least, a list says that it has."""
    count = int.from_bytes(stream.read(128)[:4], "little")
    if count * entry > size:
        raise MovieUnreadable(f"{file}: expected a list of pictures that fits into the file; found one of {count} "
                              "entries. The file is damaged")
    return count


def _check_axes(file: Path, axes: bytes) -> None:
    """Refuse a picture that is said to cover far more than it stores: czifile would repeat its pixels, without end."""
    covered = stored = 1
    for _, _, size, _, kept in struct.iter_unpack("<4siifi", axes):
        covered *= size
        stored *= kept or size
    if covered != stored and covered > MOST_ENLARGED:
        raise MovieUnreadable(f"{file}: expected pictures that cover at most {MOST_ENLARGED} px; found one of {stored} "
                              f"px that covers {covered}. The file is damaged, or holds no movie")


def _described(scene: Any, count: int) -> Series:
    sizes = ordered(scene.sizes)
    names = tuple(str(name) for name in scene.channels)
    return Series(str(scene.name) if count > 1 else "", sizes, names if len(names) == sizes.get("C", 1) else (),
                  8 * int(scene.dtype.itemsize), str(scene.compression.name).lower().replace("uncompressed", "none"))


def _calibration(handle: Any, scene: Any, choice: Choice) -> Calibration:
    um_col, um_row = scene.mpp or (None, None)
    times = _times(handle, scene, choice) if choice.axis == "T" and choice.count > 1 else None
    return square(um_row, um_col, Calibration(times))


def _times(handle: Any, scene: Any, choice: Choice) -> Floats | None:
    """Take the stamps of the frames, or else the interval."""
    stamps = handle.timestamps
    if stamps is not None and len(stamps) == choice.count:
        seconds = np.asarray(stamps, float)
        in_days = (seconds > DAYS[0]).all() and (seconds < DAYS[1]).all() and np.median(np.diff(seconds)) < 1e-4
        found = rising((seconds - seconds[0]) * DAY_S if in_days else seconds)
        if found is not None:
            return found
    step = scene.coord_scales.get("T")
    return np.arange(choice.count) * float(step) if step and step > 0 else None
