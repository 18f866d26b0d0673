"""All that one app holds: its folders, runs and open movies, and the threads in which work is done.

Nothing that reads a file or computes runs on the event loop. Each kind of work has a limit of its own, so that a long
one (finding masks, reading a result) never keeps frames waiting, and the memory of one at a time is enough.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import anyio
import anyio.to_thread

from .frames import Movies
from .masks import Found
from .places import Places
from .results import Results
from .review import Reviews
from .run_view import Views
from .runs import Runs

P = ParamSpec("P")
T = TypeVar("T")
Kind = Literal["light", "plan", "frames", "open", "masks", "results", "files", "uploads"]
AT_ONCE: dict[Kind, int] = {"light": 8, "plan": 1, "frames": 2, "open": 1, "masks": 1, "results": 1, "files": 4,
                            "uploads": 4}
LOOK_S = 0.4
"""How often the runs' processes are looked at."""

log = logging.getLogger(__name__)


class Desk:
    """Everything of one app."""

    def __init__(self, folders: list[Path], workspace: Path) -> None:
        self.workspace = workspace
        self.places = Places(folders, workspace)
        self.runs = Runs(workspace, self.places)
        self.views = Views(self.runs)
        self.movies, self.found, self.results, self.reviews = Movies(), Found(), Results(), Reviews()
        self.stopping = False
        self.limits = {kind: anyio.CapacityLimiter(n) for kind, n in AT_ONCE.items()}
        self.kept: dict[str, Any] = {}

    async def do(self, kind: Kind, work: Callable[P, T], *args: P.args, **named: P.kwargs) -> T:
        """Do blocking work in a thread, when its kind's turn comes."""
        return await anyio.to_thread.run_sync(partial(work, *args, **named), limiter=self.limits[kind])

    async def watch(self) -> None:
        """Look after the runs for as long as the app is there."""
        while not self.stopping:
            try:
                await self.do("light", self.runs.look)
            except Exception:  # the next look may do better, and the app must go on
                log.exception("runs")
            await asyncio.sleep(LOOK_S)
