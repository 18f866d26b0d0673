"""How many movies of a run do not say their frame rate or pixel size: found out beside everything else, once."""

from __future__ import annotations

import threading

from ..batch.plan import Plan
from ..errors import MicrobundleError
from .desk import Desk


def missing(desk: Desk, id: str) -> dict[str, int] | None:
    """Count the movies of a run without calibration; None while that is being found out, or cannot be."""
    plan = desk.runs.known_plan(id)
    if plan is None:
        return None
    with _LOCK:
        kept = desk.kept.setdefault("missing", {})
        if id in kept and kept[id][0] is plan:
            found: dict[str, int] | None = kept[id][1]
            return found
        kept[id] = plan, None
    threading.Thread(target=_find_out, args=(desk, id, plan), daemon=True, name=f"calibration {id}").start()
    return None


_LOCK = threading.Lock()
_ONE = threading.Semaphore(1)


def _find_out(desk: Desk, id: str, plan: Plan) -> None:
    count = {"fps": 0, "um_per_px": 0}
    known: dict[str, tuple[bool, bool]] = desk.kept.setdefault("said", {})
    with _ONE:
        for task in plan.tasks:
            given = task.config.fps is not None, task.config.um_per_px is not None
            if all(given):
                continue
            if desk.stopping or desk.runs.known_plan(id) is not plan:
                return
            where = str(task.path)
            try:
                if where not in known:
                    movie = desk.movies.read(task.path, task.config.reading)
                    known[where] = movie.time_s is not None, movie.um_per_px is not None
            except MicrobundleError:
                continue
            count["fps"] += not (given[0] or known[where][0])
            count["um_per_px"] += not (given[1] or known[where][1])
    with _LOCK:
        desk.kept["missing"][id] = plan, count
    desk.runs.touch()
