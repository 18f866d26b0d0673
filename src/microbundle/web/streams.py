"""What changes, as it changes: server-sent events of one run, and of the list of runs.

A page gets the whole at first, and then, at most twice a second, what is new: of a large run only the movies that
changed.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from starlette.responses import StreamingResponse

from ..console import plain
from .answers import Refused
from .desk import Desk
from .missing import missing

BETWEEN_S = 0.5
IDLE_S = 3.0
"""How often a run is looked at of which nothing is heard."""
QUIET_S = 15.0
"""After so long without news, an empty line shows that the connection lives."""
FEW = 40
"""Movies of a run that is always sent whole."""


async def run_told(desk: Desk, id: str) -> dict[str, Any]:
    """A run with all that a page shows of it. Raises Refused."""
    view: dict[str, Any] = await desk.do("light", desk.views.run, id)
    return view | {"missing": missing(desk, id)}


def run_events(desk: Desk, id: str) -> StreamingResponse:
    """Stream a run."""
    return _stream(desk, "run", lambda: run_told(desk, id), _changes, lambda: desk.runs.news(id))


def list_events(desk: Desk) -> StreamingResponse:
    """Stream the list of runs."""
    async def look() -> dict[str, Any]:
        return {"runs": await desk.do("light", desk.views.listed)}

    return _stream(desk, "runs", look, lambda _, new: new, lambda: desk.runs.news())


def _changes(old: dict[str, Any] | None, new: dict[str, Any]) -> dict[str, Any]:
    """What is new of a run since it was sent last."""
    if old is None or len(new["movies"]) <= FEW or len(new["movies"]) != len(old["movies"]):
        return new
    changed = [now for before, now in zip(old["movies"], new["movies"], strict=True) if before != now]
    return {key: value for key, value in new.items() if key != "movies"} | {"movies_changed": changed}


def _stream(desk: Desk, name: str, look: Callable[[], Awaitable[dict[str, Any]]],
            changes: Callable[[dict[str, Any] | None, dict[str, Any]], dict[str, Any]],
            news: Callable[[], object]) -> StreamingResponse:
    async def events() -> AsyncIterator[str]:
        sent, heard, said_s, looked_s = None, None, time.monotonic(), 0.0
        while not desk.stopping:
            now, told = time.monotonic(), await desk.do("light", news)
            if told != heard or now - looked_s > IDLE_S:  # files may change without the app, but seldom
                heard, looked_s = told, now
                try:
                    found = plain(await look())
                except Refused as error:  # the run was removed
                    yield _event("gone", {"error": {"kind": error.kind, "message": str(error)}})
                    return
                if found != sent:
                    yield _event(name, changes(sent, found))
                    sent, said_s = found, now
            if now - said_s > QUIET_S:
                yield ": still here\n\n"
                said_s = now
            await asyncio.sleep(BETWEEN_S)

    return StreamingResponse(events(), media_type="text/event-stream", headers={"x-accel-buffering": "no"})


def _event(name: str, content: dict[str, Any]) -> str:
    return f"event: {name}\ndata: {json.dumps(content, allow_nan=False, separators=(',', ':'))}\n\n"
