"""Read Nikon ND2 files with the library nd2: positions are series; times are those of each frame's acquisition."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..calibration import Calibration, rising, square
from ..data import Image
from ..errors import MicrobundleError
from .grey import undecodable
from .opened import Contents, FileFrames, Opened, Selection, Series, check_series, open_part, ordered, require

MAGIC = (b"\xda\xce\xbe\x0a", b"\0\0\0\x0cjP  ")
"""Of files since 2008, and of the older ones, which are JPEG 2000."""


def contents(file: Path) -> Contents:
    """List the positions of an ND2 file. Raises MovieUnreadable."""
    handle, found = _inspect(file)
    handle.close()
    return found


def open_movie(file: Path, selection: Selection) -> Opened:
    """Open one position, channel and focal plane of an ND2 file. Raises MovieUnreadable and ChoiceMissing."""
    handle, inside = _inspect(file)
    return open_part(file, inside, selection, lambda choice: Nd2Frames(file, choice, handle),
                     lambda frames: _calibration(handle, [frames.number(t) for t in range(len(frames))]))


class Nd2Frames(FileFrames):
    """Frames of one position of an ND2 file."""

    def _open(self) -> Any:
        return _inspect(self.file)[0]

    def number(self, frame: int) -> int:
        """Find a frame's place in the file's own order."""
        at = self.choice.at(frame) | {"P": self.choice.series}
        sizes: dict[str, int] = dict(self._handle.sizes)
        loops = [(axis, n) for axis, n in sizes.items() if axis not in "CYXS"]
        if not loops:
            return 0
        wanted = {axis: at.get(axis, 0) for axis, _ in loops}
        if not hasattr(self, "_numbers"):
            self._numbers = {tuple(index.get(a, 0) for a, _ in loops): i
                             for i, index in enumerate(self._handle.loop_indices)}
        return int(self._numbers[tuple(wanted.values())])

    def _read(self, index: int) -> tuple[Image, str]:
        frame = np.array(self._handle.read_frame(self.number(index)))
        sizes = self._handle.sizes
        axes = "".join(axis for axis in "CYXS" if sizes.get(axis, 1) > 1 or axis in "YX")
        frame = frame.reshape([sizes.get(axis, 1) for axis in axes])
        if "C" in axes:
            frame, axes = frame[self.choice.at(index).get("C", 0)], axes[1:]
        if not frame.any():
            # nd2 gives zeros for a frame that is not in the file.
            raise ValueError("the frame is missing: all its values are zero")
        return frame, axes


class _Unmapped(io.FileIO):
    """A file that the library cannot map into memory: a mapped file that shrinks would end the program."""

    def fileno(self) -> NoReturn:
        raise OSError("not mapped")


def _inspect(file: Path) -> tuple[Any, Contents]:
    nd2 = require(file, "nd2", "nd2", "Nikon ND2")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            handle = nd2.ND2File(_Unmapped(file))
            sizes: dict[str, int] = dict(handle.sizes)
            attributes = handle.attributes
            channels = tuple(str(c.channel.name) for c in _channels(handle))
            names = [p.name for loop in handle.experiment if loop.type == "XYPosLoop" for p in loop.parameters.points]
            bits = int(attributes.bitsPerComponentSignificant)
            compression = str(attributes.compressionType or "none")
            itemsize = int(handle.dtype.itemsize)
        inner = ordered({axis: n for axis, n in sizes.items() if axis != "P"})
        count = sizes.get("P", 1)
        series = tuple(Series((names[i] if i < len(names) else None) or (f"position {i}" if count > 1 else ""), inner,
                              channels, bits, compression) for i in range(count))
        found = Contents("Nikon ND2", series)
        check_series(file, found, itemsize * inner.get("C", 1))
    except MicrobundleError:
        raise
    except Exception as error:  # the library raises many kinds on damaged files
        raise undecodable(file, error) from None
    return handle, found


def _channels(handle: Any) -> list[Any]:
    """Give what the file says of its channels; nothing where the library cannot read that."""
    try:
        return list(handle.metadata.channels or ())
    except Exception:  # pictures and times do not hang on it
        return []


def _calibration(handle: Any, numbers: list[int]) -> Calibration:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        records = handle.events(orient="records")
    seconds = {int(r["Index"]): float(r["Time [s]"]) for r in records
               if isinstance(r.get("Index"), int | float) and np.isfinite(r["Index"]) and "Time [s]" in r}
    times = rising(np.array([seconds[n] for n in numbers])) if all(n in seconds for n in numbers) else None
    found = Calibration(times)
    channels = _channels(handle)
    if not channels or not channels[0].volume.axesCalibrated[0]:
        return found
    um_col, um_row = (float(size) for size in channels[0].volume.axesCalibration[:2])
    return square(um_row, um_col, found)
