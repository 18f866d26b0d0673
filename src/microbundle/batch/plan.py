"""Plan a run: which movies, under which names, with which settings; nothing is opened for it.

The fingerprint of a movie is made of the names, sizes and times of change of its files, so that thousands of movies
are compared with an earlier run in seconds.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

from ..config import Config, merge
from ..errors import ConfigError, MovieUnreadable
from .find import FILES, find_movies
from .manifest import MOVIE, check_names, ordered, read_manifest, settings_of, unfit
from .names import Pattern

MANIFESTS = (".csv", ".tsv", ".txt")
LONGEST_KEY = 100
METADATA = "metadata.txt"
"""Where Micro-Manager writes the times of the frames of a folder."""


@dataclass(frozen=True)
class Task:
    """One movie that is to be measured."""

    movie: str
    """Its name in all tables: the path below the source, or as the manifest has it."""
    path: Path
    key: str
    """Name of its result folder and status file."""
    columns: Mapping[str, str]
    """What is known of it: plate, well, ..., settings and whatever else the manifest has."""
    config: Config
    settings: str
    """Hash of the settings and of what else is to be written."""


@dataclass(frozen=True)
class Plan:
    """All movies of a run, in the order of the tables."""

    source: Path
    tasks: tuple[Task, ...]
    columns: tuple[str, ...] = ()
    """Names of all columns that any movie has."""
    report: bool = True
    """Write a report for each movie, and an index over them."""
    figures: bool = False
    movies: bool = False
    """Draw figures of each result, and movies, with limits shared over all of them."""
    notes: tuple[str, ...] = ()
    pattern: str | None = None
    config: Config = field(default_factory=Config)
    """What all movies have in common of their settings."""
    version: str = field(default_factory=lambda: version("microbundle"))


def make_plan(source: Path | str, *, config: Config | None = None, pattern: str | None = None,
              report: bool = True, figures: bool = False, movies: bool = False) -> Plan:
    """Plan the movies of a folder tree, a manifest or a single file.

    `pattern` reads further columns from the names (see `Pattern`); what a manifest says wins. Columns that are settings
    win over `config`. Raises ConfigError for a wrong manifest, pattern or setting, MovieUnreadable where there is no
    such source.
    """
    source, config = Path(source).expanduser(), config or Config()
    listed: list[tuple[str, Path, dict[str, str]]]
    if source.is_dir():
        listed = [(movie, path, {}) for movie, path in find_movies(source)]
    elif not source.is_file():
        raise MovieUnreadable(f"{source}: expected a folder of movies, or a manifest (CSV); there is no such file")
    elif source.suffix.lower() in MANIFESTS:
        listed = read_manifest(source)
    elif source.suffix.lower() in FILES:
        listed = [(source.name, source, {})]
    else:
        raise ConfigError(f"{source}: expected a folder of movies, or a manifest, a CSV file with a column {MOVIE}; "
                          f"found a file {source.suffix}")
    notes: tuple[str, ...] = ()
    if pattern is not None:
        listed, notes = _with_names(listed, Pattern(pattern))
    names = list(dict.fromkeys(name for _, _, columns in listed for name in columns))
    keys = _keys([movie for movie, _, _ in listed])
    known: dict[str, tuple[Config, str]] = {}
    tasks = []
    for (movie, path, columns), key in zip(listed, keys, strict=True):
        given = settings_of(columns)
        if repr(given) not in known:
            own = Config.from_dict(merge(config.model_dump(exclude_unset=True), given), source=str(source))
            known[repr(given)] = own, _settings_hash(own, report)
        tasks.append(Task(movie, path, key, columns, *known[repr(given)]))
    return Plan(source, tuple(tasks), tuple(ordered(set(names), names)), report, figures, movies, notes,
                pattern, config)


def fingerprint(path: Path) -> str:
    """Hash the names, sizes and times of change of a movie's files and masks; "missing" where there is no movie."""
    total = hashlib.sha256()
    try:
        for name, about in _files(path.absolute()):
            total.update(f"{name}\0{about.st_size}\0{about.st_mtime_ns}\n".encode("utf-8", "surrogateescape"))
    except OSError:
        return "missing"
    return total.hexdigest()


def _files(path: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Files that the result of a movie depends on, in a fixed order."""
    if not path.is_dir():
        yield path.name, path.stat()
        return
    home = path / "movie" if (path / "movie").is_dir() else path
    masks = (path.parent if path.name == "movie" else path) / "masks"
    for folder, suffixes in ((home, (*FILES, METADATA)), (masks, "")):
        if folder.is_dir():
            with os.scandir(folder) as entries:
                wanted = [entry for entry in entries if not suffixes or entry.name.lower().endswith(suffixes)]
            yield from ((f"{folder.name}/{entry.name}", entry.stat())
                        for entry in sorted(wanted, key=lambda entry: entry.name))


def _with_names(listed: list[tuple[str, Path, dict[str, str]]], pattern: Pattern,
                ) -> tuple[list[tuple[str, Path, dict[str, str]]], tuple[str, ...]]:
    """Add the columns that a pattern finds in the names, and say which names it does not fit."""
    check_names(f"--pattern {pattern.text}", list(pattern.columns))
    if MOVIE in pattern.columns:
        raise ConfigError(f"--pattern {pattern.text}, column {MOVIE}: the movie's own name is in that column; call it "
                          "otherwise")
    out, unmatched = [], []
    for movie, path, columns in listed:
        found = pattern.read(movie)
        if not found:
            unmatched.append(movie)
        for name, value in found.items():
            reason = unfit(name, value)
            if reason:
                raise ConfigError(f"--pattern {pattern.text}, {movie}, column {name}: {reason}")
        said = {name: value for name, value in columns.items() if value}
        out.append((movie, path, {**columns, **found, **said}))
    if len(unmatched) == len(listed):
        raise ConfigError(f"--pattern {pattern.text}: expected a pattern that fits the names of the movies; it fits "
                          f"none of them, such as {unmatched[0]}")
    if unmatched:
        return out, (f"the pattern does not fit {len(unmatched)} of {len(listed)} names, such as {unmatched[0]}; "
                     "their columns are empty",)
    return out, ()


def _keys(movies: list[str]) -> list[str]:
    """Names of folders that are safe on any system, each of one movie alone whatever else is in the plan."""
    keys = [_key(movie) for movie in movies]
    alike = Counter(key.casefold() for key in keys)
    return [_hashed(key, movie) if alike[key.casefold()] > 1 else key for key, movie in zip(keys, movies, strict=True)]


def _key(movie: str) -> str:
    flat = movie.replace("/", "__")
    safe = re.sub(r"[^A-Za-z0-9._-]", "_", flat)
    if safe == flat and "__" not in movie and len(safe) <= LONGEST_KEY and safe[0].isalnum() and safe[-1] != ".":
        return safe
    return _hashed(safe.lstrip("._-"), movie)


def _hashed(key: str, movie: str) -> str:
    return f"{key[:LONGEST_KEY - 20]}-{hashlib.sha256(os.fsencode(movie)).hexdigest()[:8]}"


def _settings_hash(config: Config, report: bool) -> str:
    """Hash all that changes what is written; the number of threads does not."""
    counted = config.model_dump_json(exclude={"registration": {"threads"}})
    return hashlib.sha256(f"{counted} report={report}".encode()).hexdigest()
