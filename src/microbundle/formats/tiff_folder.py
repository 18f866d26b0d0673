"""Read a folder of single-frame TIFFs, in the natural order of their names, and what Micro-Manager writes.

Micro-Manager makes `img_*.tif` with a `metadata.txt` (one folder for each position), or `*_MMStack_*.ome.tif`. Times
are those of its metadata (`ElapsedTime-ms`), which the camera's computer took for each frame.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from ..calibration import Calibration, rising, tiff_calibration
from ..data import Finding
from ..errors import MovieUnreadable
from . import tiff
from .grey import undecodable
from .opened import Choice, Contents, Opened, Selection, Series, choose
from .tiff import SUFFIXES, TiffFiles, colour_note, single_frame

NAMES = (re.compile(r"img_(?P<T>\d+)_(?P<C>.+)_(?P<Z>\d+)"),
         re.compile(r"img_channel(?P<C>\d+)_position(?P<P>\d+)_time(?P<T>\d+)_z(?P<Z>\d+)"))
"""File names of Micro-Manager 1 and 2."""

Places = dict[tuple[int, int, int], Path]
"""Files by time, channel and focal plane."""


def contents(folder: Path) -> Contents:
    """List what is in a folder. Raises MovieUnreadable."""
    home, files = _listing(folder)
    if not files:
        return _positions(home)[0]
    return tiff.contents(_only(files)) if _is_one_file(files) else _single(files)[0]


def open_movie(folder: Path, selection: Selection) -> Opened:
    """Open a folder of TIFFs. Raises MovieUnreadable and ChoiceMissing."""
    home, files = _listing(folder)
    if not files:
        inside, folders = _positions(home)
        number = choose(home, inside, selection).series
        opened = open_movie(folders[number], selection._replace(series=None))
        whole = choose(home, inside, selection)
        return Opened(inside, whole, opened.frames, opened.files, opened.calibration, opened.findings)
    if _is_one_file(files):
        return tiff.open_movie(_only(files), selection)
    inside, places = _single(files)
    choice = choose(home, inside, selection)
    if places:
        return _micromanager(home, inside, choice, places)
    frames = TiffFiles(files)
    try:
        with tifffile.TiffFile(files[0]) as first:
            found = tiff_calibration(first, len(files))
            colour = "S" in first.pages[0].axes
    except Exception as error:  # tifffile raises many kinds on damaged files
        raise undecodable(files[0], error) from None
    return Opened(inside, choice, frames, files, found, colour_note(colour) + name_notes(files))


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Make a sort key that puts `2` before `10`, whatever the case of the letters."""
    key: list[tuple[int, int | str]] = []
    digits = ""
    for char in name.casefold() + "\0":
        if char.isdecimal() and char.isascii():
            digits += char
            continue
        if digits:
            # Python refuses to read more digits than this as one number.
            key.append((0, int(digits[:4000])))
            digits = ""
        key.append((1, char))
    return key


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


def _listing(folder: Path) -> tuple[Path, tuple[Path, ...]]:
    try:
        home = folder / "movie" if (folder / "movie").is_dir() else folder
        return home, tuple(sorted((f for f in home.iterdir() if _is_tiff_name(f)),
                                  key=lambda f: (natural_key(f.name), f.name)))
    except OSError as error:
        raise MovieUnreadable(f"{folder}: the folder cannot be read: {error.strerror or error}") from None


def _is_tiff_name(file: Path) -> bool:
    return file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()


def _is_one_file(files: tuple[Path, ...]) -> bool:
    """Whether a folder holds one movie in one file, or in the files of one set of Micro-Manager."""
    if all("_MMStack" in file.name for file in files):
        return True
    pages, _ = _first(files[0])
    if pages > 1 and len(files) > 1:
        raise MovieUnreadable(f"{files[0].parent}: expected one frame in each file; {files[0].name} holds {pages}. "
                              "A folder of movies is not one movie: give one of its files")
    return pages > 1


def _only(files: tuple[Path, ...]) -> Path:
    _first(files[0])
    return files[0]


def _first(file: Path) -> tuple[int, Series]:
    """Look at the first file of a folder, which must be a TIFF."""
    try:
        with file.open("rb") as stream:
            magic = stream.read(4)
    except OSError as error:
        raise MovieUnreadable(f"{file}: the file cannot be read: {error.strerror or error}") from None
    if magic not in tiff.MAGIC:
        what = "an empty file" if not magic else f"a file that starts with {magic!r}"
        raise MovieUnreadable(f"{file}: expected a TIFF; found {what}")
    return single_frame(file)


def _single(files: tuple[Path, ...]) -> tuple[Contents, Places]:
    """Describe single-frame files; those that Micro-Manager named are sorted by time, channel and focal plane."""
    _, first = _first(files[0])
    found = [_place(file) for file in files]
    if not (files[0].parent / "metadata.txt").is_file() or any(place is None for place in found):
        return Contents("TIFF folder", (Series("", {"T": len(files), "Y": first.sizes["Y"], "X": first.sizes["X"]}, (),
                                                first.bits, first.compression),)), {}
    axes = {axis: sorted({place[axis] for place in found if place}, key=natural_key) for axis in "TCZ"}
    places = {(axes["T"].index(p["T"]), axes["C"].index(p["C"]), axes["Z"].index(p["Z"])): file
              for p, file in zip(found, files, strict=True) if p}
    sizes = {axis: len(values) for axis, values in axes.items()}
    series = Series(files[0].parent.name, {**sizes, "Y": first.sizes["Y"], "X": first.sizes["X"]}, tuple(axes["C"]),
                    first.bits, first.compression)
    return Contents("Micro-Manager folder", (series,)), places


def _place(file: Path) -> dict[str, str] | None:
    for pattern in reversed(NAMES):
        if match := pattern.fullmatch(file.stem):
            return match.groupdict()
    return None


def _positions(home: Path) -> tuple[Contents, list[Path]]:
    """Describe the positions of a recording of Micro-Manager, each in a folder with its metadata."""
    try:
        folders = sorted((f for f in home.iterdir() if f.is_dir() and (f / "metadata.txt").is_file()),
                         key=lambda f: natural_key(f.name))
    except OSError as error:
        raise MovieUnreadable(f"{home}: the folder cannot be read: {error.strerror or error}") from None
    if not folders:
        raise MovieUnreadable(f"{home}: expected TIFF files ({', '.join(SUFFIXES)}, any case); found none")
    return Contents("Micro-Manager folder", tuple(contents(folder).series[0] for folder in folders)), folders


def _micromanager(home: Path, inside: Contents, choice: Choice, places: Places) -> Opened:
    keys = [tuple(choice.at(t).get(axis, 0) for axis in "TCZ") for t in range(choice.count)]
    missing = [key for key in keys if key not in places]
    if missing:
        raise MovieUnreadable(f"{home}: expected a file for each time, channel and focal plane; found none for "
                              f"{len(missing)} of {choice.count} frames, such as frame {keys.index(missing[0])}")
    files = tuple(places[key] for key in keys)  # type: ignore[index]
    return Opened(inside, choice, TiffFiles(files), files, _metadata(home / "metadata.txt", files))


def _metadata(file: Path, files: tuple[Path, ...]) -> Calibration:
    """Take times and pixel size from Micro-Manager's list of frames."""
    try:
        text = file.read_text(encoding="utf-8", errors="replace").rstrip()
        try:
            raw = json.loads(text)
        except ValueError:
            raw = json.loads(text.rstrip(",") + "}")  # an acquisition that was stopped leaves the last bracket out
        entries = [e for e in raw.values() if isinstance(e, dict)]
        by_name = {Path(str(e.get("FileName") or key)).name: e for key, e in raw.items() if isinstance(e, dict)}
    except (OSError, ValueError, AttributeError, RecursionError):
        return Calibration(findings=(Finding("metadata_unreadable", "review", f"{file.name} cannot be read; times and "
                                             "pixel size are taken as unknown"),))
    found = [by_name.get(f.name, {}) for f in files]
    ms = [_number(e.get("ElapsedTime-ms", e.get("ElapsedTimeMs"))) for e in found]
    sizes = [_number(e.get("PixelSizeUm", e.get("PixelSize_um"))) for e in (*found[:1], *entries[:1])]
    um = next((size for size in sizes if size), None)
    return Calibration(rising(None if None in ms else np.array(ms, float) / 1000), um)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and np.isfinite(value) and value >= 0 else None
