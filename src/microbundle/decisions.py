"""What a person decided about a movie: a small file beside its result, which every rerun reads and replays.

    my_movie_microbundle/                      the result, replaced as a whole when the movie is measured again
    my_movie_microbundle.decisions.json        the decisions, in the order in which they were made
    my_movie_microbundle.tissue-1f0c9a3e.png   a mask that one of them names

Decisions say which beats count, where a beat lies, which mask and which settings are right for this movie, whether its
numbers are accepted, and what is worth a note. Each can carry why, by whom and when. They change nothing but what they
say: the program's own findings stay beside them.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from annotated_types import Ge
from pydantic import Field, ValidationError, model_validator

from .config import Config, Params, explain, flat, merge
from .errors import ConfigError, OutputError
from .folder import write_file

SUFFIX = ".decisions.json"
MARK = '"microbundle_decisions"'
"""Text near the start of every such file, by which one that we wrote is known."""
SAID, REMEMBERED = "verdict", "note"
"""Kinds of decisions on numbers that are there, and of those that change nothing; all others are measured with."""
LARGEST_BYTES = 4_000_000
"""A larger file is no list of decisions."""


class Decision(Params):
    """Base of all decisions."""

    why: str = ""
    """Reason, in the person's words."""
    by: str = ""
    """Who decided."""
    at: str = ""
    """When: date and time as in ISO 8601."""

    @property
    def signed(self) -> str:
        """Why, by whom and when, in brackets, as far as that is known."""
        parts = [f"“{self.why}”" if self.why else "", self.by, self.at[:16].replace("T", " ")]
        told = ", ".join(part for part in parts if part)
        return f" ({told})" if told else ""


class DropBeat(Decision):
    """Leave out the beat that this frame belongs to: no number counts it, and no period begins or ends at it."""

    kind: Literal["drop_beat"] = "drop_beat"
    peak_frame: Annotated[int, Ge(0)]
    """Frame of its peak, or any other frame of it."""


class MarkBeat(Decision):
    """A beat lies here, in place of what was found there."""

    kind: Literal["mark_beat"] = "mark_beat"
    start_frame: Annotated[int, Ge(0)]
    """First frame, in which the tissue rests."""
    peak_frame: Annotated[int, Ge(0)]
    """Frame of the largest contraction."""
    stop_frame: Annotated[int, Ge(1)]
    """First frame after the beat."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.start_frame < self.peak_frame < self.stop_frame - 1:
            raise ValueError(f"start_frame {self.start_frame}, peak_frame {self.peak_frame} and stop_frame "
                             f"{self.stop_frame} must follow each other")
        return self


class UseMask(Decision):
    """Take this mask of the tissue or of a pillar in place of any other."""

    kind: Literal["use_mask"] = "use_mask"
    name: Annotated[str, Field(pattern=r"^(tissue|pillar_[1-9][0-9]?)$")]
    """`tissue`, `pillar_1`, `pillar_2`, ..."""
    file: str
    """A file for `microbundle.read_mask`; its path counts from the folder of the decisions."""


class UseSettings(Decision):
    """Take these settings for this movie; they win over all others."""

    kind: Literal["settings"] = "settings"
    settings: dict[str, Any]
    """As in a TOML file of settings: {"fps": 30, "strain": {"tile_px": 30}}."""

    def named(self) -> Iterator[tuple[str, Any]]:
        """Give each setting by its full name, such as strain.tile_px, and its value."""
        yield from flat(self.settings)

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            Config.from_dict(self.settings, source="settings")
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return self


class Judge(Decision):
    """Accept the numbers of this movie, or reject them. A result that failed stays failed."""

    kind: Literal["verdict"] = "verdict"
    accept: bool
    """True to accept, False to reject."""


class Note(Decision):
    """Remember this."""

    kind: Literal["note"] = "note"
    text: str
    """What is worth a note."""


AnyDecision = Annotated[DropBeat | MarkBeat | UseMask | UseSettings | Judge | Note, Field(discriminator="kind")]


class Decisions(Params):
    """All decisions on one movie, in the order in which they were made; of two that disagree the later one counts."""

    listed: tuple[AnyDecision, ...] = ()
    """The decisions."""
    home: Path = Field(default=Path(), exclude=True)
    """Folder from which the paths of masks count."""

    @classmethod
    def from_list(cls, listed: Iterable[Mapping[str, Any]], *, home: Path | str = "",
                  source: str = "decisions") -> Decisions:
        """Check decisions given as dicts; raises ConfigError that names each wrong one and `source`."""
        try:
            return cls.model_validate({"listed": list(listed), "home": Path(home)})
        except ValidationError as error:
            raise ConfigError(explain(error, source)) from None

    def as_list(self) -> list[dict[str, Any]]:
        """Give the decisions as dicts, without what was left empty."""
        whole = (one.model_dump(mode="json") for one in self.listed)
        return [{key: value for key, value in one.items() if value != ""} for one in whole]

    def and_then(self, *more: DropBeat | MarkBeat | UseMask | UseSettings | Judge | Note) -> Decisions:
        """Add decisions."""
        return Decisions(listed=(*self.listed, *more), home=self.home)

    def over(self, config: Config) -> Config:
        """Lay the decided settings over others. A decided mask is taken whatever the settings say of masks."""
        settings = config.model_dump(exclude_unset=True)
        for one in self.listed:
            if isinstance(one, UseSettings):
                settings = merge(settings, one.settings)
        masks = {name.partition("_")[0] for name in self.masks}
        if "tissue" in masks:
            settings = merge(settings, {"mask": {"method": "auto"}})
        if "pillar" in masks:
            settings = merge(settings, {"pillars": {"masks": "auto"}})
        return Config.from_dict(settings, source="decisions") if self.listed else config

    @property
    def masks(self) -> dict[str, Path]:
        """File of each decided mask, by its name."""
        return {one.name: self.home / one.file for one in self.listed if isinstance(one, UseMask)}

    @property
    def accepted(self) -> bool | None:
        """Whether a person accepted or rejected the numbers; None where nobody judged."""
        judged = [one.accept for one in self.listed if isinstance(one, Judge)]
        return judged[-1] if judged else None


def sidecar_of(result: Path | str) -> Path:
    """Name the file of decisions that belongs to a folder of results."""
    return Path(os.path.abspath(Path(result).expanduser()) + SUFFIX)


def read_decisions(result: Path | str) -> Decisions:
    """Read the decisions that lie beside a folder of results; none where there is no such file.

    Raises ConfigError where the file is damaged, or holds what is no decision.
    """
    file = sidecar_of(result)
    try:
        if not file.exists():
            return Decisions()
        with file.open("rb") as stream:
            raw = stream.read(LARGEST_BYTES + 1)
        if len(raw) > LARGEST_BYTES:
            raise ValueError(f"it is larger than {LARGEST_BYTES} bytes")
        listed = json.loads(raw)["microbundle_decisions"]
        if not isinstance(listed, list):
            raise ValueError("the key microbundle_decisions holds no list")
    except KeyError:
        raise ConfigError(f"{file}: expected decisions on a movie, under the key microbundle_decisions; there is no "
                          "such key") from None
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise ConfigError(f"{file}: expected decisions on a movie, as JSON; it cannot be read: {error}") from None
    return Decisions.from_list(listed, home=file.parent, source=str(file))


def write_decisions(result: Path | str, decisions: Decisions) -> Path:
    """Write decisions beside a folder of results, in place of older ones, whole or not at all; returns the file.

    With no decisions an older file is removed. Raises OutputError.
    """
    file = sidecar_of(result)
    if not decisions.listed:
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"{file}: the decisions cannot be removed: {error.strerror or error}") from None
        return file
    text = json.dumps({"microbundle_decisions": decisions.as_list()}, indent=1, ensure_ascii=False)
    return write_file(file, text + "\n", mark=MARK, overwrite=True)


def decisions_hash(result: Path | str) -> str:
    """Hash what a rerun would make another result of: the decisions beside a folder of results, but for notes, and the
    masks that they name; the empty string where there are none. Before its dot stands what would be measured otherwise
    (see `same_measurement`), after it what a person said of the numbers."""
    file = sidecar_of(result)
    if not file.exists():
        return ""
    try:
        decided = read_decisions(result)
    except ConfigError as error:  # measuring again will say so
        return hashlib.sha256(str(error).encode()).hexdigest()
    listed = decided.as_list()
    counted = [one for one in listed if one["kind"] not in (SAID, REMEMBERED)]
    said = [one for one in listed if one["kind"] == SAID]
    if not counted and not said:
        return ""
    total = hashlib.sha256(json.dumps(counted, sort_keys=True).encode())
    for name, mask in sorted(decided.masks.items()):
        try:
            about = mask.stat()
            total.update(f"{name}\0{about.st_size}\0{about.st_mtime_ns}".encode())
        except OSError:
            total.update(f"{name}\0missing".encode())
    word = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    return f"{total.hexdigest() if counted else ''}.{word.hexdigest() if said else ''}"


def same_measurement(one: str, other: str) -> bool:
    """Tell whether two hashes of decisions differ at most in what a person said of the numbers."""
    return one.partition(".")[0] == other.partition(".")[0]
