"""The folders that a person may look into: those the app was started with, what was dropped, and the example.

A place is told as `root/relative/path`, and every path is followed to its end before it is used: one that leads out of
these folders, by `..` or by a link, is refused. These folders are only ever read, but
for the results of a run of `microbundle batch` that is opened to be looked over, decided on or continued.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from ..batch.find import FILES, is_folder, kind_of
from ..batch.manifest import MOVIE
from ..batch.plan import MANIFESTS
from ..batch.state import RESULTS, STATUS
from ..errors import ConfigError
from ..read import natural_key
from .answers import Refused, not_there

MOST_ENTRIES = 2000
"""Entries of a folder that are listed."""
LOOKED_AT = 40
"""Entries of a folder within that tell what it is."""
UPLOADS, EXAMPLE = "uploads", "example"


@dataclass(frozen=True)
class Root:
    """A folder that may be looked into."""

    id: str
    name: str
    path: Path


class Places:
    """All folders that may be looked into."""

    def __init__(self, folders: Iterable[Path], workspace: Path) -> None:
        """Take folders of the user; raises ConfigError for one that is none."""
        self.workspace = workspace
        self.roots: list[Root] = []
        for folder in dict.fromkeys(Path(folder).expanduser().resolve() for folder in folders):
            if not folder.is_dir():
                raise ConfigError(f"{folder}: expected a folder to open movies from; there is none")
            self._add(folder.name or str(folder), folder)
        for name, text in ((UPLOADS, "Dropped movies"), (EXAMPLE, "Example")):
            self._add(text, workspace / name, name)

    def _add(self, name: str, folder: Path, wanted: str = "") -> None:
        plain = wanted or re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-").lower() or "files"
        taken = {root.id for root in self.roots} | ({UPLOADS, EXAMPLE} if not wanted else set())
        number, found = 1, plain
        while found in taken:
            number += 1
            found = f"{plain}-{number}"
        self.roots.append(Root(found, name, folder))

    def path(self, at: str) -> Path:
        """Follow a place to its path. Raises Refused for one that is not there, or not within these folders."""
        name, _, rest = at.partition("/")
        root = next((root for root in self.roots if root.id == name), None)
        parts = rest.split("/") if rest else []
        if root is None or any(part in ("", ".", "..") or set(part) & {"\0", "\\"} for part in parts):
            raise not_there(f"{at[:200]}: there is no such place")
        try:
            path = root.path.joinpath(*parts).resolve(strict=True)
        except (OSError, RuntimeError, ValueError):
            raise not_there(f"{at[:200]}: there is no such file or folder") from None
        return self.within(path)

    def within(self, path: Path) -> Path:
        """Check that a path, followed to its end, lies within these folders, and return that end. Raises Refused."""
        try:
            end = path.resolve()
        except (OSError, RuntimeError):
            raise not_there(f"{path}: the path cannot be followed") from None
        if not any(end.is_relative_to(root.path) for root in self.roots):
            raise Refused(403, "Outside", f"{path}: leads out of the folders that the app was started with. Start it "
                          "with the folder in which these files really lie")
        return end

    def check_frames(self, movie: Path) -> None:
        """Check that no frame of a movie, and no mask beside it, is a link that leads out. Raises Refused."""
        self._check_links(movie, movie / "movie", movie / "masks")

    def check_results(self, out: Path) -> None:
        """Check that nothing in the folder of a run that a terminal began is a link that leads out. Raises Refused."""
        self._check_links(out, out / RESULTS, out / STATUS)

    def _check_links(self, *folders: Path) -> None:
        self.within(folders[0])
        for folder in folders:
            try:
                with os.scandir(folder) as entries:
                    links = [entry.path for entry in entries if entry.is_symlink()]
            except (FileNotFoundError, NotADirectoryError):
                continue
            for link in links:
                self.within(Path(link))

    def at(self, path: Path) -> str | None:
        """Tell the place of a path; None for one that is not within these folders."""
        fits = [root for root in self.roots if path.is_relative_to(root.path)]
        if not fits:
            return None
        root = max(fits, key=lambda root: len(root.path.parts))
        rest = path.relative_to(root.path).as_posix()
        return root.id if rest == "." else f"{root.id}/{rest}"

    def browse(self, at: str) -> dict[str, Any]:
        """List what a person can open at a place; the folders themselves at "". Raises Refused and OSError."""
        if not at:
            roots = [{"name": root.name, "at": root.id, "kind": "folder", "modified": None, "bytes": None}
                     for root in self.roots if root.path.is_dir()]
            return {"at": "", "kind": "folder", "crumbs": [], "entries": roots, "more": 0, "openable": False}
        path = self.path(at)
        parts = at.split("/")
        root = next(root for root in self.roots if root.id == parts[0])
        names = [root.name, *parts[1:]]
        crumbs = [{"name": name, "at": "/".join(parts[:i + 1])} for i, name in enumerate(names)]
        if not path.is_dir():
            kind = _kind_of_file(path)
            return {"at": at, "kind": kind, "crumbs": crumbs, "entries": [], "more": 0, "openable": kind is not None}
        kind = kind_of(path, LOOKED_AT)
        entries, more = ([], 0) if kind != "folder" else self._entries(path, at)
        openable = kind in ("movie", "batch") or any(one["kind"] in ("movie", "folder") for one in entries)
        return {"at": at, "kind": kind, "crumbs": crumbs, "entries": entries, "more": more, "openable": openable}

    def _entries(self, folder: Path, at: str) -> tuple[list[dict[str, Any]], int]:
        with os.scandir(folder) as listed:
            seen = [entry for entry in islice(listed, 20 * MOST_ENTRIES)
                    if not entry.name.startswith(".") and _writable(entry.name)]
        seen = [entry for entry in seen if is_folder(entry) or entry.name.lower().endswith((*FILES, *MANIFESTS))]
        seen.sort(key=lambda entry: (natural_key(entry.name), entry.name))
        out = []
        for entry in seen[:MOST_ENTRIES]:
            try:
                path = self.within(Path(entry.path)) if entry.is_symlink() else Path(entry.path)
                kind = kind_of(path, LOOKED_AT) if path.is_dir() else _kind_of_file(path)
                about = path.stat()
            except (Refused, OSError):  # a link that leads out, or a folder that may not be read
                continue
            if kind is None or kind == "app" or path == self.workspace:
                continue
            out.append({"name": entry.name, "at": f"{at}/{entry.name}", "kind": kind,
                        "modified": about.st_mtime, "bytes": about.st_size if path.is_file() else None})
        order = {"folder": 0, "movie": 1, "manifest": 2, "batch": 3, "result": 4}
        return sorted(out, key=lambda one: order[one["kind"]]), max(0, len(seen) - MOST_ENTRIES)


def _kind_of_file(path: Path) -> str | None:
    """Tell a movie's file, or a manifest, by its name and its first line; None for any other."""
    suffix = path.suffix.lower()
    if suffix in FILES:
        return "movie"
    if suffix not in MANIFESTS:
        return None
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as stream:
            head = stream.readline(4096)
    except OSError:
        return None
    cells = next(csv.reader([head], delimiter=max(",;\t", key=head.count)), [])
    return "manifest" if MOVIE in (cell.strip().lower() for cell in cells) else None


def _writable(name: str) -> bool:
    """Tell whether a name can be written in a page; names of bytes that are no text cannot."""
    try:
        return bool(name.encode())
    except UnicodeEncodeError:
        return False
