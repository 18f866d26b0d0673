"""What a long computation says while it works: one small protocol for bars, pages and tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Progress:
    """How far an analysis is."""

    stage: str
    """What is being done, in words for a person."""
    share: float
    """Share of the whole analysis that is done, 0 to 1."""


Tell = Callable[[Progress], None]


def ignore(event: object) -> None:
    """Hear an event and do nothing."""


def stage(tell: Tell, name: str, first: float, last: float) -> Callable[[float], None]:
    """Make a function that reports a stage's own progress (0 to 1) as progress of the whole."""
    tell(Progress(name, first))

    def within(share: float) -> None:
        tell(Progress(name, first + share * (last - first)))

    return within


@dataclass(frozen=True)
class Planned:
    """A run over many movies begins."""

    movies: int
    unchanged: int
    """Of them, those that an earlier run has done."""


@dataclass(frozen=True)
class Started:
    """A movie is being measured."""

    movie: str


@dataclass(frozen=True)
class Progressed:
    """How far a movie is."""

    movie: str
    stage: str
    share: float
    """Share of its analysis that is done, 0 to 1."""


@dataclass(frozen=True)
class Finished:
    """A movie has a result."""

    movie: str
    verdict: str
    seconds: float


@dataclass(frozen=True)
class Failed:
    """A movie has no result."""

    movie: str
    kind: str
    """Name of the error."""
    message: str


@dataclass(frozen=True)
class Drawing:
    """All movies are measured; the pictures of those with a result are drawn."""

    movies: int
    unchanged: int
    """Of them, those whose pictures an earlier run has drawn with the same limits."""


@dataclass(frozen=True)
class Drawn:
    """The pictures of a movie are there, or cannot be drawn."""

    movie: str
    seconds: float
    problem: str = ""
    """Why there are none; empty where they are there."""


@dataclass(frozen=True)
class Completed:
    """A run over many movies has ended, and its tables are written."""

    movies: int
    passed: int
    review: int
    fail: int
    """Results with the verdict "fail"."""
    failed: int
    """Movies without a result."""
    out: str


BatchEvent = Planned | Started | Progressed | Finished | Failed | Drawing | Drawn | Completed
TellBatch = Callable[[BatchEvent], None]


def as_dict(event: BatchEvent) -> dict[str, Any]:
    """Turn an event of a run into what is written as a line of JSON, its kind first."""
    return {"event": type(event).__name__.lower(), **asdict(event)}
