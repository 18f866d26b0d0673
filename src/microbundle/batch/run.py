"""Measure all movies of a plan; what was done before and is unchanged is left alone.

The movies are measured by processes of this machine (`local`) or by the workers of a Dask cluster (`cluster`), both of
which say of each movie what became of it, or that its worker died. Such a movie is tried once more at the end, with no
other beside it. Pictures, where they are wanted, are drawn by the same workers when all is measured, for only then are
the limits known that they share.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ..decisions import decisions_hash
from ..errors import ConfigError
from ..events import Completed, Drawing, Drawn, Failed, Finished, Planned, TellBatch, ignore
from .cluster import Cluster
from .collect import Extras, write_tables
from .limits import read_limits, shared_limits
from .local import Processes
from .pictures import LimitsJob, picture_jobs
from .plan import Plan, Task, fingerprint
from .recipe import write_recipe
from .state import RESULTS, Status, clear_partial, current, guarded, run_folder, write_status
from .work import Died, End, Job, Work, job_of, result_of


@dataclass(frozen=True)
class Outcome:
    """What became of all movies of a plan."""

    out: Path
    statuses: Mapping[str, Status]
    """By the movies' names, in the order of the plan."""
    unchanged: int
    """Movies that an earlier run had done."""
    files: tuple[Path, ...]
    """Tables and index that were written."""
    notes: tuple[str, ...] = ()
    undrawn: Mapping[str, str] = field(default_factory=dict)
    """Movies whose pictures could not be drawn, and why."""

    @property
    def failed(self) -> list[Status]:
        """Movies without a result."""
        return [status for status in self.statuses.values() if status.state == "failed"]

    def count(self, verdict: str) -> int:
        """Number of results with this verdict."""
        return sum(status.verdict == verdict for status in self.statuses.values())


class Workers(Protocol):
    """Those who do the work, here or elsewhere."""

    notes: list[str]
    """What a person should know of them."""

    def work(self, jobs: list[Work], tell: TellBatch, *, alone: bool = False) -> Iterator[tuple[Work, End]]:
        """Do jobs and yield each, in any order, with what became of it; `alone` one after the other."""


def run_batch(plan: Plan, out: Path | str, *, workers: int | None = None, cluster: str | None = None,
              retry: bool = False, extras: Extras | None = None, tell: TellBatch = ignore) -> Outcome:
    """Measure the movies of a plan into a folder, and write the tables over all of them.

    `workers` are processes, by default one for each processor. With `cluster`, the address of a Dask scheduler or its
    scheduler file, that cluster's workers measure; `workers` is then the most that are used. Movies that an earlier run
    has done into this folder, with the same files, settings and version, are not measured again; with `retry` those
    that failed are. A movie that fails is a row of the tables. `extras` are made beside the tables. `tell` hears of
    everything. Raises OutputError where the folder is not ours, another run works in it, or the tables cannot be
    written; ConfigError for a wrong number of workers, or extras that cannot be made; ClusterUnusable where the cluster
    cannot be reached or used, or was lost: what is done is kept.
    """
    cores = processors()
    if workers is not None and workers < 1:
        raise ConfigError(f"workers: expected 1 or more; found {workers}")
    extras = extras or Extras()
    extras.check(plan)
    with run_folder(out) as folder:
        guarded(folder, lambda: write_recipe(folder, plan, excel=extras.excel, wells=extras.wells))
        known: dict[str, Status] = {}
        for task in plan.tasks:
            status = current(folder, plan, task)
            if status is not None and not (retry and status.state == "failed"):
                known[task.movie] = status
        todo = [task for task in plan.tasks if task.movie not in known]
        unchanged = len(known)
        tell(Planned(len(plan.tasks), unchanged))
        used = max(1, min(workers or cores, len(todo) or len(plan.tasks)))
        crew = Processes(used) if cluster is None else Cluster(cluster, plan, folder, workers)
        jobs: list[Work] = [job_of(task, folder, plan, max(1, cores // used)) for task in todo]
        try:
            with crew:
                known |= _measure_all(jobs, crew, tell)
                undrawn = _draw_all(plan, folder, known, crew, tell)
        finally:
            clear_partial(folder)
        statuses = {task.movie: known[task.movie] for task in plan.tasks}
        files: list[Path] = []
        notes = [*plan.notes, *crew.notes]
        guarded(folder, lambda: write_tables(folder, plan, statuses, files, notes, changed=bool(todo),
                                             extras=extras))
        outcome = Outcome(folder, statuses, unchanged, tuple(files), tuple(notes), undrawn)
    tell(Completed(len(plan.tasks), outcome.count("pass"), outcome.count("review"), outcome.count("fail"),
                   len(outcome.failed), str(folder)))
    return outcome


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _twice(jobs: list[Work], crew: Workers, tell: TellBatch) -> Iterator[tuple[Work, End]]:
    """Do all jobs; those whose worker died once more, one by one."""
    died: list[Work] = []
    for job, end in crew.work(jobs, tell):
        if isinstance(end, Died):
            died.append(job)
        else:
            yield job, end
    yield from crew.work(died, tell, alone=True)


def _measure_all(jobs: list[Work], crew: Workers, tell: TellBatch) -> dict[str, Status]:
    done: dict[str, Status] = {}
    for job, end in _twice(jobs, crew, tell):
        assert isinstance(job, Job)
        status = _record_death(job, end.how) if isinstance(end, Died) else end
        assert isinstance(status, Status)
        if status.state == "done":
            tell(Finished(status.movie, status.verdict, status.seconds))
        else:
            tell(Failed(status.movie, status.kind, status.message))
        done[status.movie] = status
    return done


def _draw_all(plan: Plan, out: Path, statuses: Mapping[str, Status], crew: Workers, tell: TellBatch) -> dict[str, str]:
    """Draw the pictures that a plan wants and that are not there with the limits of this run; say which cannot be."""
    if not (plan.figures or plan.movies):
        return {}
    undrawn: dict[str, str] = {}
    tasks = [task for task in plan.tasks if statuses[task.movie].state == "done"]
    without: list[Work] = [LimitsJob(task, out) for task in tasks if read_limits(out / RESULTS / task.key) is None]
    for job, end in _twice(without, crew, ignore):
        problem = _problem(job, end)
        if problem:
            undrawn[job.task.movie] = problem
            tell(Drawn(job.task.movie, 0.0, problem))
    found = {task.movie: read_limits(out / RESULTS / task.key) for task in tasks}
    shared = shared_limits({movie: own for movie, own in found.items() if own is not None},
                           {movie: statuses[movie].verdict for movie in found})
    jobs, unchanged = picture_jobs(plan, out, shared)
    tell(Drawing(len(shared), unchanged))
    for job, end in _twice([*jobs], crew, tell):
        problem = _problem(job, end)
        if problem:
            undrawn[job.task.movie] = problem
        tell(Drawn(job.task.movie, end.seconds if isinstance(end, Drawn) else 0.0, problem))
    return undrawn


def _problem(job: Work, end: End) -> str:
    if isinstance(end, Died):
        return f"{job.task.movie}: the process that drew its pictures {end.how}, twice"
    assert isinstance(end, Drawn)
    return end.problem


def _record_death(job: Job, how: str) -> Status:
    """Write down that the worker died at a movie, twice."""
    status = Status(job.task.movie, "failed", fingerprint(job.task.path), job.task.settings, job.version,
                    decisions_hash(result_of(job)), kind="WorkerDied", lasting=False,
                    message=f"{job.task.movie}: the process that measured it {how}, twice; the second time no other "
                            "ran beside it. Too little memory is the usual reason: see reading.crop_px")
    guarded(job.out, lambda: write_status(job.out, job.task.key, status))
    return status


def waiting_for(movies: Iterable[Task], out: Path, plan: Plan) -> dict[str, str]:
    """Tell for each movie what a run into this folder would do: "to do", or "done" or "failed" before and unchanged."""
    found: dict[str, str] = {}
    for task in movies:
        status = current(out, plan, task)
        found[task.movie] = "to do" if status is None else status.state
    return found
