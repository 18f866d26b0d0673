"""Blind review: a person judges movies without knowing which they are, in an order of their own.

A movie under review is known to the page by a token alone; its name and columns stay here. The order is shuffled by
the reviewer's name, so that it is the same after an interruption, and another for each reviewer.
"""

from __future__ import annotations

import hashlib
import secrets
from collections import OrderedDict
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING, Any

from ..batch.plan import Task
from ..decide import now
from . import decided
from .answers import Refused, not_there
from .results import result_of

if TYPE_CHECKING:
    from .desk import Desk

NOT_SURE = "Blind review: not sure."
"""Note of a reviewer who looked at a movie, and neither accepts nor rejects it."""
MOST = 1000
"""Tokens that are known at a time."""


@dataclass(frozen=True)
class Case:
    """A movie under review."""

    run: str
    key: str
    reviewer: str


class Reviews:
    """The movies under review, by their tokens."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._cases: OrderedDict[str, Case] = OrderedDict()

    def next(self, desk: Desk, run: str, reviewer: str, seed: str = "") -> dict[str, Any]:
        """Give the next movie that this reviewer has not judged yet: its token, and how many there are."""
        reviewer = reviewer.strip()
        if not reviewer:
            raise Refused(400, "BadRequest", "reviewer: expected a name, under which the verdicts are kept")
        home = desk.runs.home(run)
        tasks = [task for task in desk.runs.plan(run).tasks if (result_of(home, task.key) / "result.nc").is_file()]
        tasks.sort(key=lambda task: hashlib.sha256(f"{seed}\0{reviewer}\0{task.key}".encode()).digest())
        todo = [task for task in tasks if not self._judged(desk, run, task, reviewer)]
        n = len(tasks) - len(todo)
        if not todo:
            return {"token": None, "n": n, "of": len(tasks)}
        token = secrets.token_urlsafe(16)
        with self._lock:
            self._cases[token] = Case(run, todo[0].key, reviewer)
            while len(self._cases) > MOST:
                self._cases.popitem(last=False)
        return {"token": token, "n": n + 1, "of": len(tasks)}

    def case(self, token: str) -> Case:
        """Find the movie of a token. Raises Refused."""
        with self._lock:
            if token not in self._cases:
                raise not_there("this movie is no longer under review here; go on with the next one")
            return self._cases[token]

    def judge(self, desk: Desk, token: str, accept: bool | None, why: str) -> None:
        """Keep a reviewer's verdict on a movie, or that there is none, beside what was decided on it before.

        Raises Refused, ConfigError and OutputError.
        """
        case = self.case(token)
        result = result_of(desk.runs.home(case.run), case.key)
        what = {"kind": "note", "text": NOT_SURE} if accept is None else {"kind": "verdict", "accept": accept}
        decided.add(result, {**what, "why": why, "by": case.reviewer, "at": now()})
        desk.runs.touch()

    def _judged(self, desk: Desk, run: str, task: Task, reviewer: str) -> bool:
        listed, _ = decided.read(result_of(desk.runs.home(run), task.key))
        return any(one.get("by") == reviewer and (one["kind"] == "verdict" or one.get("text") == NOT_SURE)
                   for one in listed)
