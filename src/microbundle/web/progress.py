"""How far a run is, from the lines of JSON that its process writes; only what is new is read each time."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

FEWEST_SHARE = 0.01
"""Of a run that must be done before the time left is told."""


@dataclass
class Doing:
    """What the events say of one movie."""

    state: str
    stage: str = ""
    share: float = 0.0
    verdict: str = ""
    kind: str = ""
    message: str = ""


@dataclass
class Progress:
    """What the events of a run's last process say, as far as they were read."""

    file: Path
    at: int
    """Bytes of the file that were read."""
    movies: dict[str, Doing] = field(default_factory=dict)
    total: int = 0
    unchanged: int = 0
    pictures: int = 0
    """Results whose pictures are drawn, once all movies are measured."""
    drawn: int = 0
    drawing: dict[str, float] = field(default_factory=dict)
    """Share of the pictures of each movie that is drawn."""
    problems: dict[str, str] = field(default_factory=dict)
    """Why there are no pictures of a movie."""
    completed: bool = False
    first: datetime | None = None
    """When the first movie, or drawing the pictures, was begun."""
    last: datetime | None = None
    version: int = 0
    """Grows with each event."""

    def update(self) -> None:
        """Read what is new; a line that is not complete yet is left for later."""
        try:
            with self.file.open("rb") as stream:
                stream.seek(self.at)
                new = stream.read()
        except OSError:
            return
        whole = new[:new.rfind(b"\n") + 1]
        self.at += len(whole)
        for line in whole.splitlines():
            try:
                self.hear(json.loads(line))
            except (ValueError, KeyError, TypeError):  # a line that a full disk cut off
                continue

    def hear(self, event: dict[str, Any]) -> None:
        """Take in one event."""
        kind = event["event"]
        self.last = datetime.fromisoformat(event["at"])
        self.version += 1
        if kind == "planned":
            self.total, self.unchanged = event["movies"], event["unchanged"]
        elif kind == "started":
            self.first = self.first or self.last
            self.movies[event["movie"]] = Doing("running", "starting")
        elif kind == "drawing":
            self.pictures, self.drawn, self.first = event["movies"], event["unchanged"], self.last
        elif kind == "drawn":
            self.drawing.pop(event["movie"], None)
            self.drawn += 1
            if event["problem"]:
                self.problems[event["movie"]] = event["problem"]
        elif kind == "progressed" and self.pictures:
            self.drawing[event["movie"]] = event["share"]
        elif kind == "progressed":
            self.movies[event["movie"]] = Doing("running", event["stage"], event["share"])
        elif kind == "finished":
            self.movies[event["movie"]] = Doing("done", verdict=event["verdict"])
        elif kind == "failed":
            self.movies[event["movie"]] = Doing("failed", kind=event["kind"], message=event["message"])
        elif kind == "completed":
            self.completed = True

    @property
    def ended(self) -> int:
        """Movies that need no more work."""
        return self.unchanged + sum(one.state in ("done", "failed") for one in self.movies.values())

    @property
    def stage(self) -> str:
        """What is being done, where that is not the measurement of movies."""
        return "drawing pictures" if self.pictures and not self.completed else ""

    @property
    def share(self) -> float:
        """Share of the run, or of its pictures, that is done, movies in work included."""
        if self.pictures:
            return min(1.0, (self.drawn + sum(self.drawing.values())) / self.pictures)
        under_way = sum(one.share for one in self.movies.values() if one.state == "running")
        return min(1.0, (self.ended + under_way) / self.total) if self.total else 0.0

    def seconds_left(self, now: datetime) -> float | None:
        """Time that the rest will take, at the pace so far; None while that cannot be told."""
        whole, before = (self.pictures, 0) if self.pictures else (self.total, self.unchanged)
        if self.first is None or whole <= before:
            return None
        done = (self.share * whole - before) / (whole - before)
        if done < FEWEST_SHARE:
            return None
        return max(0.0, (now - self.first).total_seconds() * (1 - done) / done)
