"""Find the movies in a tree of folders by names, and by a glance at one file of a folder.

A movie is a folder in the paper's layout (`movie/`), a folder of single-frame TIFFs, or a file. Several TIFFs in one
folder can be either; the header of the first one that is a TIFF at all tells, and where none is, their names do. Other
files beside the frames of a movie are taken to belong to it.
"""

from __future__ import annotations

import json
import os
import re
import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from ..errors import ConfigError, MovieUnreadable
from ..folder import LIST
from ..read import natural_key

FRAMES = (".tif", ".tiff")
"""Names of files that may hold one frame of a movie each."""
FILES = (*FRAMES, ".nd2", ".czi", ".lif", ".avi", ".mp4", ".mov", ".mkv")
"""Names of files that may hold a whole movie."""
DESCRIPTION = 270
"""TIFF tag of the text in which ImageJ counts the frames of a file that lists only the first."""
KINDS = ("results", "batch", "app")
"""Kinds of folders that microbundle wrote, in which no movies are looked for."""
LOOKED_AT = 5
"""Files of a folder that are looked at until one is a TIFF."""


def find_movies(source: Path) -> list[tuple[str, Path]]:
    """List the movies below a folder, as (name, path) in natural order of the names; a name is the path from there.

    Hidden folders and those with results of microbundle are left out. Raises MovieUnreadable where the folder cannot be
    read, and ConfigError where it holds no movie.
    """
    try:
        found = [(path.relative_to(source).as_posix(), path) for path in _below(source, frozenset())]
    except OSError as error:
        raise MovieUnreadable(f"{error.filename or source}: the folder cannot be read: {error.strerror or error}"
                              ) from None
    if not found:
        raise ConfigError(f"{source}: expected movies (folders of TIFFs, or files {', '.join(FILES)}); found none")
    found = [(source.resolve().name if name == "." else name, path) for name, path in found]
    return sorted(found, key=lambda one: (natural_key(one[0]), one[0]))


def _below(folder: Path, above: frozenset[tuple[int, int]]) -> Iterator[Path]:
    about = folder.stat()
    here = (about.st_dev, about.st_ino)
    if here in above:  # a link that leads back
        return
    with os.scandir(folder) as entries:
        listed = [entry for entry in entries if not entry.name.startswith(".")]
    if any(entry.name == LIST for entry in listed) and _holds_results(folder):
        return
    folders, files = _sorted(listed)
    layout = _has_layout(folder, folders)
    if layout or _one_movie(folder, files):
        yield folder
    else:
        yield from (folder / name for name in files)
    for name in sorted(folders - ({"movie", "masks"} if layout else {"masks"} if files else set())):
        yield from _below(folder / name, above | {here})


def kind_of(folder: Path, looked_at: int) -> str:
    """Tell what a folder is: "movie", "result" (of one movie), "batch", "app", or just a "folder", by at most so many
    of its entries. Raises OSError."""
    written = _written(folder)
    if written in KINDS:
        return written.removesuffix("s")
    with os.scandir(folder) as entries:
        listed = [entry for entry in islice(entries, looked_at) if not entry.name.startswith(".")]
    folders, files = _sorted(listed)
    return "movie" if _has_layout(folder, folders) or _one_movie(folder, files) else "folder"


def _sorted(listed: list[os.DirEntry[str]]) -> tuple[set[str], list[str]]:
    """Folders, and files that may be movies in natural order."""
    folders = {entry.name for entry in listed if is_folder(entry)}
    return folders, sorted((entry.name for entry in listed
                            if entry.name.lower().endswith(FILES) and entry.name not in folders),
                           key=lambda name: (natural_key(name), name))


def is_folder(entry: os.DirEntry[str]) -> bool:
    """Tell whether an entry is a folder, or leads to one; a loop of links leads nowhere."""
    try:
        return entry.is_dir()
    except OSError:
        return False


def _has_layout(folder: Path, folders: set[str]) -> bool:
    """Tell whether a folder is a movie in the paper's layout."""
    return "movie" in folders and any(name.lower().endswith(FRAMES) for name in os.listdir(folder / "movie"))


def _holds_results(folder: Path) -> bool:
    """Tell whether microbundle wrote its results into a folder, rather than a rendered movie."""
    return _written(folder) in KINDS


def _written(folder: Path) -> str:
    """What microbundle wrote into a folder; nothing for any other."""
    try:
        return str(json.loads((folder / LIST).read_text(encoding="utf-8"))["kind"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


def _one_movie(folder: Path, files: list[str]) -> bool:
    """Tell whether the files of a folder are the frames of one movie."""
    frames = [name for name in files if name.lower().endswith(FRAMES)]
    if len(frames) < 2:
        return False
    for name in frames[:LOOKED_AT]:
        single = _single_frame(folder / name)
        if single is not None:
            return single
    return len({re.sub(r"\d+", "#", name.casefold()) for name in frames}) == 1


def _single_frame(file: Path) -> bool | None:
    """Tell whether a TIFF holds one frame, from its first directory alone; None where it is no whole TIFF."""
    try:
        with file.open("rb") as stream:
            start = stream.read(16)
            order = {b"II": "<", b"MM": ">"}[start[:2]]
            big = struct.unpack(order + "H", start[2:4])[0] == 43
            offset, = struct.unpack_from(order + ("Q" if big else "I"), start, 8 if big else 4)
            stream.seek(offset)
            count, = struct.unpack(order + ("Q" if big else "H"), stream.read(8 if big else 2))
            size = 20 if big else 12
            tags = stream.read(count * size)
            following, = struct.unpack(order + ("Q" if big else "I"), stream.read(8 if big else 4))
            for at in range(0, len(tags), size):
                code, _, length, where = struct.unpack_from(order + ("HHQQ" if big else "HHII"), tags, at)
                if code == DESCRIPTION and length > 8:
                    stream.seek(where)
                    counted = re.search(rb"(?:images|frames)=(\d+)", stream.read(min(length, 1000)))
                    if counted and int(counted[1]) > 1:
                        return False
            return bool(following == 0)
    except (OSError, KeyError, struct.error):
        return None
