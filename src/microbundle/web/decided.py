"""What a person decided on a movie, as the pages read and write it: the whole list at once, if nobody changed it since.

The file, and what it means, are those of `microbundle.decisions`; the command line reads and writes the same.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from ..config import Config
from ..data import Bools, Movie
from ..decide import keep_mask
from ..decisions import Decisions, read_decisions, sidecar_of, write_decisions
from ..errors import MaskUnusable
from ..mask_files import read_mask
from .answers import Refused

Listed = list[dict[str, Any]]

MOST = 1000
NONE = "none"
_writing = Lock()


def read(result: Path) -> tuple[Listed, str]:
    """Read the decisions on a result, and what tells this list from another. Raises ConfigError."""
    listed = read_decisions(result).as_list()
    return listed, hashlib.sha256(json.dumps(listed, sort_keys=True).encode()).hexdigest() if listed else NONE


def write(result: Path, listed: Any, masks: Mapping[str, Bools], version: str | None) -> tuple[Listed, str]:
    """Replace the decisions on a result, if nobody else did since `version`; returns them and the new version.

    `masks` are kept as files, which the decisions to use them then name. Raises Refused for another version, with the
    decisions that are there; ConfigError for what is no decision; MaskUnusable for an empty mask; OutputError.
    """
    if not isinstance(listed, list) or len(listed) > MOST or not all(isinstance(one, dict) for one in listed):
        raise Refused(400, "BadRequest", f"decisions: expected a list of at most {MOST}")
    home = sidecar_of(result).parent
    for one in listed:
        if one.get("kind") == "use_mask" and one.get("file") and not _is_ours(result, home, one["file"]):
            raise Refused(400, "BadRequest", "file: expected the name of a mask that was kept for this movie")
    unkept = {one.get("name") for one in listed if one.get("kind") == "use_mask" and not one.get("file")}
    if not unkept <= set(masks):
        raise Refused(400, "BadRequest", "masks: expected a picture for each mask that is to be used")
    with _writing:
        known, now = read(result)
        if version is not None and version != now:
            raise Refused(409, "Changed", "another window, or another person, has changed what was decided on this "
                          "movie", decisions=known, version=now)
        named = [one if one.get("name") not in masks or one.get("kind") != "use_mask" or one.get("file")
                 else {**one, "file": str(one["name"])} for one in listed]
        Decisions.from_list(named, home=home)  # before anything is written
        files = {name: keep_mask(result, name, mask) for name, mask in masks.items()}
        named = [{**one, "file": files[one["name"]]} if one.get("kind") == "use_mask" and not one.get("file") else one
                 for one in listed]
        write_decisions(result, Decisions.from_list(named, home=home))
        return read(result)


def _is_ours(result: Path, home: Path, file: Any) -> bool:
    """Tell whether a name is that of a mask beside the decisions on a result, and no path to anywhere else."""
    return (isinstance(file, str) and re.fullmatch(rf"{re.escape(result.name)}\.[a-z0-9_-]+\.[a-z]+", file) is not None
            and (home / file).is_file() and not (home / file).is_symlink())


def add(result: Path, one: dict[str, Any]) -> None:
    """Add a decision to those on a result. Raises ConfigError and OutputError."""
    with _writing:
        known = read_decisions(result)
        write_decisions(result, Decisions.from_list([*known.as_list(), one], home=known.home))


def config_of(result: Path, config: Config) -> Config:
    """Lay the settings that a person decided on over those of the run. Raises ConfigError."""
    return read_decisions(result).over(config)


def whole_mask(mask: Bools, movie: Movie, crop_px: tuple[int, int, int, int] | None) -> Bools:
    """Put a mask that was drawn on a cropped frame into one of the file's own size, as decided masks are."""
    if crop_px is None:
        return mask
    out = np.zeros(movie.shape, bool)
    r0, r1, c0, c1 = crop_px
    out[r0:r1, c0:c1] = mask
    return out


def drawn_masks(result: Path, movie: Movie, crop_px: tuple[int, int, int, int] | None) -> dict[str, Bools]:
    """Read the masks that a person decided on, on the frames as they are measured; those that do not fit are left out.

    `movie` is that of the file, before it is cropped. Raises ConfigError.
    """
    out = {}
    for name, file in read_decisions(result).masks.items():
        try:
            mask = read_mask(file, movie.shape)
        except MaskUnusable:
            continue
        if crop_px is not None:
            r0, r1, c0, c1 = crop_px
            mask = mask[r0:r1, c0:c1]
        out[name] = mask
    return out
