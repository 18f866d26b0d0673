"""What a long computation says while it works: one small protocol for bars, pages and tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far an analysis is."""

    stage: str
    """What is being done, in words for a person."""
    share: float
    """Share of the whole analysis that is done, 0 to 1."""


Tell = Callable[[Progress], None]


def ignore(event: Progress) -> None:
    """Hear an event and do nothing."""


def stage(tell: Tell, name: str, first: float, last: float) -> Callable[[float], None]:
    """Make a function that reports a stage's own progress (0 to 1) as progress of the whole."""
    tell(Progress(name, first))

    def within(share: float) -> None:
        tell(Progress(name, first + share * (last - first)))

    return within
