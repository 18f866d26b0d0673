"""Read Leica LIF and LOF files with the library liffile: images are series; it gives metres and seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..calibration import Calibration, rising, square
from ..data import Image
from ..errors import MicrobundleError
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


def is_leica(magic: bytes) -> bool:
    """Tell a LIF or LOF file by its first bytes."""
    return magic[:4] == b"\x70\0\0\0" and magic[8:9] == b"\x2a"


def contents(file: Path) -> Contents:
    """List the images of a LIF file. Raises MovieUnreadable."""
    handle, _, found = _inspect(file)
    handle.close()
    return found


def open_movie(file: Path, selection: Selection) -> Opened:
    """Open one image, channel and focal plane of a LIF file. Raises MovieUnreadable and ChoiceMissing."""
    handle, images, inside = _inspect(file)
    return open_part(file, inside, selection, lambda choice: LifFrames(file, choice, (handle, images)),
                     lambda frames: _calibration(images[frames.choice.series], frames.choice))


class LifFrames(FileFrames):
    """Frames of one image of a LIF file."""

    def _open(self) -> Any:
        return _inspect(self.file)[:2]

    def _read(self, index: int) -> tuple[Image, str]:
        image = self._handle[1][self.choice.series]
        at = {axis: i for axis, i in self.choice.at(index).items() if axis in image.sizes}
        sizes = image.frames.frame_sizes
        if set(sizes) - set(PLANE):
            raise ValueError(f"expected pictures of rows and columns; found the axes {', '.join(sizes)}")
        return np.asarray(image.frame(**at)), "".join(sizes)


def _inspect(file: Path) -> tuple[Any, list[Any], Contents]:
    liffile = require(file, "liffile", "lif", "Leica LIF")
    handle = None
    try:
        handle = liffile.LifFile(file.open("rb"))
        images = [image for image in handle.images if isinstance(image, liffile.LifImage)
                  and {"Y", "X"} <= set(image.sizes) and int(np.prod(list(image.sizes.values()))) > 1]
        series = tuple(_described(image) for image in images)
        found = Contents("Leica LIF", series)
        for image, one in zip(images, series, strict=True):
            check_series(file, Contents("Leica LIF", (one,)), int(image.dtype.itemsize))
    except MicrobundleError:
        raise
    except Exception as error:  # the library raises many kinds on damaged files
        if handle is not None:
            handle.close()
        raise undecodable(file, error) from None
    return handle, images, found


def _described(image: Any) -> Series:
    sizes = ordered(image.sizes)
    channels = list(image.xml_element.findall("./Data/Image/ImageDescription/Channels/ChannelDescription"))
    names = tuple(c.get("LUTName", "") for c in channels) if len(channels) == sizes.get("C", 1) else ()
    bits = int(channels[0].get("Resolution", "0")) or None if channels else None
    return Series(str(image.name), sizes, names, bits)


def _calibration(image: Any, choice: Choice) -> Calibration:
    coords = image.coords
    um = [float(abs(coords[axis][1] - coords[axis][0])) * 1e6 if axis in coords and len(coords[axis]) > 1 else None
          for axis in "YX"]
    return square(um[0], um[1], Calibration(_times(image, choice)))


def _times(image: Any, choice: Choice) -> Any:
    """Take the stamps of the chosen pictures, or else the time axis.

    Stamps are listed in the order of the pictures in the file, or one for each time.
    """
    if choice.axis != "T" or choice.count < 2:
        return None
    outer = {axis: n for axis, n in image.sizes.items() if axis not in PLANE}
    stamps = image.timestamps
    if stamps is not None:
        seconds = (stamps - stamps[0]) / np.timedelta64(1, "s")
        if len(seconds) == choice.count:
            return rising(seconds)
        if len(seconds) == int(np.prod(list(outer.values()))):
            places = [np.ravel_multi_index([choice.at(t).get(a, 0) for a in outer], list(outer.values()))
                      for t in range(choice.count)]
            return rising(seconds[places])
    axis = image.coords.get("T")
    return rising(np.asarray(axis, float)) if axis is not None and len(axis) == choice.count else None
