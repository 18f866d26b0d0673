"""What every format hands over: what a file holds, which part of it was taken, and its frames.

A file may hold several series (scenes, positions), channels and focal planes. Where there is one, it is taken; where
there are several, the user chooses, and nothing is guessed. Numbers count from 0.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from ..calibration import Calibration
from ..data import Finding, Frames, Image
from ..errors import ChoiceMissing, MicrobundleError, MovieUnreadable
from .grey import check_size, grey, undecodable

OfFrames = TypeVar("OfFrames", bound="FileFrames")

PLANE = "YXS"
"""Axes of a single picture: row, column, colour."""
FLAGS = {"series": "--reading.series", "C": "--reading.channel", "Z": "--reading.z"}


class Selection(NamedTuple):
    """Which part of a file is wanted, None where the user does not say."""

    series: int | None = None
    channel: int | None = None
    z: int | None = None


@dataclass(frozen=True)
class Series:
    """One recording in a file: its name, and the length of each of its axes."""

    name: str
    sizes: Mapping[str, int]
    """Length by axis: T, Z, C, ..., and Y and X."""
    channels: tuple[str, ...] = ()
    bits: int | None = None
    """Bits of a grey value."""
    compression: str = "none"

    def __str__(self) -> str:
        inside = ", ".join(f"{axis} {n}" for axis, n in self.sizes.items() if axis not in PLANE and n > 1)
        size = f"{self.sizes['Y']} x {self.sizes['X']} px{', ' if inside else ''}{inside}"
        return f"{self.name} ({size})" if self.name else size


@dataclass(frozen=True)
class Contents:
    """All that is inside a file."""

    format: str
    series: tuple[Series, ...]


@dataclass(frozen=True)
class Choice:
    """The part of a file that is taken as the movie."""

    series: int
    axis: str
    """The axis whose pictures are the movie's frames."""
    count: int
    fixed: Mapping[str, int]
    """Index on each other axis."""
    findings: tuple[Finding, ...] = ()

    def at(self, frame: int) -> dict[str, int]:
        """Give the index on every axis for one frame."""
        return {**self.fixed, self.axis: frame}

    @property
    def taken(self) -> dict[str, int]:
        """The series, channel and focal plane that were taken, without those that are the movie's frames."""
        return {"series": self.series} | {name: self.fixed[axis] for axis, name in (("C", "channel"), ("Z", "z"))
                                          if axis in self.fixed}


@dataclass(frozen=True)
class Opened:
    """A file with the frames of the chosen part."""

    contents: Contents
    choice: Choice
    frames: Frames
    files: tuple[Path, ...]
    calibration: Calibration = field(default_factory=Calibration)
    findings: tuple[Finding, ...] = ()

    @property
    def all_findings(self) -> tuple[Finding, ...]:
        return self.findings + self.choice.findings + self.calibration.findings


def choose(file: Path, contents: Contents, wanted: Selection) -> Choice:
    """Take the part of a file that the user wants, or its only one.

    Focal planes or channels alone are taken as time, with a finding. Raises ChoiceMissing, which lists what there is,
    and MovieUnreadable for a number that does not exist.
    """
    if not contents.series:
        raise MovieUnreadable(f"{file}: expected a recording in this {contents.format} file; found none")
    if wanted.series is None and len(contents.series) > 1:
        raise ChoiceMissing(f"{file}: expected the choice of one of {len(contents.series)} series; found "
                            f"{_listed([str(s) for s in contents.series])}. Give {FLAGS['series']}")
    number = _index(file, "series", wanted.series, len(contents.series))
    series = contents.series[number]
    fixed = {axis: _index(file, name, index, series.sizes.get(axis, 1))
             for axis, name, index in (("C", "channel", wanted.channel), ("Z", "z", wanted.z))
             if index is not None or series.sizes.get(axis, 1) == 1}
    free = {axis: n for axis, n in series.sizes.items() if axis not in PLANE and axis not in fixed and n > 1}
    if len(free) > 1:
        raise ChoiceMissing(f"{file}: expected one series of grey frames over time; found axes "
                            f"{', '.join(f'{a} {n}' for a, n in free.items())}. {_advice(series, free)}")
    axis, count = next(iter(free.items()), (next((a for a in "TZC" if a in series.sizes and a not in fixed), "T"), 1))
    fixed |= {other: 0 for other in series.sizes if other not in PLANE and other != axis and other not in fixed}
    return Choice(number, axis, count, {k: v for k, v in fixed.items() if k != axis},
                  _axis_note(axis, count) + _taken_note(contents, series, number, fixed))


def open_part(file: Path, contents: Contents, wanted: Selection, frames: Callable[[Choice], OfFrames],
              calibration: Callable[[OfFrames], Calibration]) -> Opened:
    """Open the part of a file that the user wants, with the frames and the calibration that a format gives.

    Raises ChoiceMissing and MovieUnreadable.
    """
    opened = frames(choose(file, contents, wanted))
    try:
        found = calibration(opened)
    except Exception as error:  # the libraries raise many kinds on damaged files
        raise undecodable(file, error) from None
    return Opened(contents, opened.choice, opened, (file,), found)


def require(file: Path, library: str, extra: str, what: str) -> Any:
    """Import the library that reads a format; raises MovieUnreadable with the line that installs it."""
    try:
        return import_module(library)
    except ImportError:
        raise MovieUnreadable(f'{file}: reading {what} needs another package: pip install "microbundle[{extra}]"'
                              ) from None


def ordered(sizes: Mapping[str, int]) -> dict[str, int]:
    """Bring the lengths of a library's axes in our order: the others, then Y and X; colour is no axis of ours."""
    others = {str(axis): int(n) for axis, n in sizes.items() if axis not in PLANE}
    return {**others, "Y": int(sizes.get("Y", 1)), "X": int(sizes.get("X", 1))}


class FileFrames(ABC):
    """Frames of one file that stays open between them.

    One thread reads at a time. A copy that was sent to another process opens the file again by itself. Raises
    MovieUnreadable for a frame that cannot be decoded, has another size, or comes from a file that has changed.
    """

    def __init__(self, file: Path, choice: Choice, handle: Any = None) -> None:
        self.file, self.choice = file, choice
        self._stamp = stamp(file)
        self._shape: tuple[int, ...] | None = None
        self._handle, self._lock = handle, threading.Lock()

    def __len__(self) -> int:
        return self.choice.count

    def __getitem__(self, index: int) -> Image:
        try:
            with self._lock:
                if stamp(self.file) != self._stamp:
                    raise MovieUnreadable(f"{self.file}: the file has changed since it was opened. Wait until it is "
                                          "written, and start again")
                if self._handle is None:
                    self._handle = self._open()
                frame, axes = self._read(index)
        except MicrobundleError:
            raise
        except Exception as error:  # the libraries raise many kinds on damaged files
            raise undecodable(self.file, error, index) from None
        frame = grey(frame, axes, self.file, self._shape, index)
        self._shape = frame.shape
        return frame

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_handle", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._handle, self._lock = None, threading.Lock()

    @abstractmethod
    def _open(self) -> Any:
        """Open the file, for `_handle`."""

    @abstractmethod
    def _read(self, index: int) -> tuple[Image, str]:
        """Decode one frame, with its axes such as YX or YXS."""


def stamp(file: Path) -> tuple[int, int]:
    """Give a file's size and time of change, which tell whether it is still the same."""
    try:
        state = file.stat()
    except OSError as error:
        raise MovieUnreadable(f"{file}: the file can no longer be read: {error.strerror or error}") from None
    return state.st_size, state.st_mtime_ns


def check_series(file: Path, contents: Contents, itemsize: int = 2) -> None:
    """Refuse what a damaged header says: pictures without pixels, or too large for any memory."""
    for series in contents.series:
        check_size(file, series.sizes["Y"], series.sizes["X"], itemsize)


def _index(file: Path, name: str, index: int | None, count: int) -> int:
    if index is None:
        return 0
    if not 0 <= index < count:
        raise MovieUnreadable(f"{file}: expected {name} from 0 to {count - 1}, which the file has; found {index}")
    return index


def _listed(names: list[str], most: int = 12) -> str:
    shown = [f"{i}: {name}" for i, name in enumerate(names[:most])]
    return "; ".join(shown) + (f"; ... to {len(names) - 1}" if len(names) > most else "")


def _advice(series: Series, free: Mapping[str, int]) -> str:
    """Say how the axes that are too many can be narrowed to one."""
    parts = []
    for axis, n in free.items():
        if axis in FLAGS:
            names = f"{_listed(list(series.channels))}" if axis == "C" and series.channels else f"0 to {n - 1}"
            parts.append(f"{FLAGS[axis]} ({names})")
    if not parts:
        return "Save one of them as a movie of its own"
    return f"Choose with {' and '.join(parts)}"


def _axis_note(axis: str, count: int) -> tuple[Finding, ...]:
    """Say where frames that the file does not call times are taken for them."""
    if axis == "Z" and count > 1:
        return (Finding("z_as_time", "info", "the file calls its frames focal planes (Z); they are taken as time"),)
    if axis == "C" and count > 1:
        return (Finding("c_as_time", "review", "the file calls its frames channels (C); they are taken as time"),)
    return ()


def _taken_note(contents: Contents, series: Series, number: int, fixed: Mapping[str, int]) -> tuple[Finding, ...]:
    """Say what was taken, where there was something to choose."""
    parts = [f"series {number} of {len(contents.series)} ({series})"] if len(contents.series) > 1 else []
    for axis, name in (("C", "channel"), ("Z", "focal plane")):
        if axis in fixed and series.sizes.get(axis, 1) > 1:
            label = f" ({series.channels[fixed[axis]]})" if axis == "C" and fixed[axis] < len(series.channels) else ""
            parts.append(f"{name} {fixed[axis]} of {series.sizes[axis]}{label}")
    return (Finding("part_taken", "info", f"taken from the file, counted from 0: {', '.join(parts)}"),) if parts else ()
