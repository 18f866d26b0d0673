"""The pictures of a result in a run: figures and movies in its folder, with limits that all results of the run share.

They are drawn from the result, when all movies have been measured. Each folder of pictures appears whole, and holds the
limits that it was drawn with (`limits.json`), by which a later run knows whether they are still the same.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..analysis import Analysis
from ..errors import MicrobundleError
from ..events import Drawn, Progress, Tell
from ..folder import write_within
from .limits import FILE, add_limits, as_drawn, check_drawn
from .plan import Plan, Task
from .state import RESULTS


@dataclass(frozen=True)
class LimitsJob:
    """Find the limits of a result that an earlier run has written without them."""

    task: Task
    out: Path

    def do(self, tell: Tell) -> Drawn:
        """Add them to the result; never raises."""
        return _told(self.task, lambda: add_limits(_load(self, tell), self.out / RESULTS / self.task.key))


@dataclass(frozen=True)
class PicturesJob:
    """Draw the pictures of a result."""

    task: Task
    out: Path
    sections: Mapping[str, Mapping[str, tuple[float, float]]]
    """Folders that are wanted, "figures" or "movies", each with its limits."""

    def do(self, tell: Tell) -> Drawn:
        """Write the folders; never raises."""
        return _told(self.task, lambda: self._draw(tell))

    def _draw(self, tell: Tell) -> None:
        analysis, result = _load(self, tell), self.out / RESULTS / self.task.key
        for n, (section, limits) in enumerate(self.sections.items(), 1):
            def write(folder: Path, section: str = section, limits: Any = limits) -> None:
                folder.mkdir()
                self._write(analysis, section, folder, limits)
                (folder / FILE).write_text(json.dumps(as_drawn(limits)) + "\n", encoding="utf-8")

            write_within(result, section, write)
            tell(Progress("drawing", 0.1 + 0.9 * n / len(self.sections)))

    def _write(self, analysis: Analysis, section: str, folder: Path, limits: Any) -> None:
        if section == "figures":
            from ..figures import save_all as save_figures

            save_figures(analysis, folder, limits=limits)
            return
        from ..movies import save_all as save_movies
        from ..read import read_movie

        part = analysis.config.reading
        movie = read_movie(self.task.path, series=part.series, channel=part.channel, z=part.z)
        save_movies(movie, analysis, folder, limits=limits)


def picture_jobs(plan: Plan, out: Path, shared: Mapping[str, Mapping[str, Any]]) -> tuple[list[PicturesJob], int]:
    """List what is to be drawn for the movies with limits, and count those whose pictures are there already."""
    wanted = [section for section in ("figures", "movies") if getattr(plan, section)]
    jobs = []
    for task in plan.tasks:
        if task.movie in shared:
            own = {section: shared[task.movie][section] for section in wanted
                   if not check_drawn(out / RESULTS / task.key, section, shared[task.movie][section])}
            if own:
                jobs.append(PicturesJob(replace(task, path=task.path.absolute()), out, own))
    return jobs, len(shared) - len(jobs)


def place(error: Exception) -> str:
    """Name file and line in which an error arose."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "" if trace is None else f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"


def _load(job: LimitsJob | PicturesJob, tell: Tell) -> Analysis:
    from ..store import load

    tell(Progress("drawing", 0.0))
    return load(job.out / RESULTS / job.task.key)


def _told(task: Task, work: Callable[[], None]) -> Drawn:
    """Do it, and tell what became of it."""
    start, problem = time.perf_counter(), ""
    try:
        work()
    except MicrobundleError as error:
        problem = str(error)
    except MemoryError:
        problem = f"{task.movie}: expected room in memory for the pictures of this movie; there was none"
    except Exception as error:  # a mistake in the program must not take the other movies along
        problem = f"{task.movie}: the program failed: {error} ({place(error)}); please report this"
    return Drawn(task.movie, round(time.perf_counter() - start, 3), problem)
