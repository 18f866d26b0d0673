"""Measure all movies of a plan in processes of this machine; what was done before and is unchanged is left alone.

Each worker is a process with a pipe of its own, so that a worker that dies (killed, out of memory, a crash in a
library) names the movie it was at. That movie is tried once more at the end, with no other beside it.
"""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import wait
from pathlib import Path

from ..errors import ConfigError
from ..events import Completed, Failed, Finished, Planned, Progressed, Started, TellBatch, ignore
from .collect import Extras, write_tables
from .plan import Plan, Task, fingerprint
from .state import Status, clear_partial, current, guarded, run_folder, write_status
from .work import Job, job_of, serve

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
MOST_MOVIES = 10
"""A worker makes room for a new one after so many movies, for its memory grows with each."""


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

    @property
    def failed(self) -> list[Status]:
        """Movies without a result."""
        return [status for status in self.statuses.values() if status.state == "failed"]

    def count(self, verdict: str) -> int:
        """Number of results with this verdict."""
        return sum(status.verdict == verdict for status in self.statuses.values())


def run_batch(plan: Plan, out: Path | str, *, workers: int | None = None, retry: bool = False,
              extras: Extras | None = None, tell: TellBatch = ignore) -> Outcome:
    """Measure the movies of a plan into a folder, and write the tables over all of them.

    `workers` are processes, by default one for each processor. Movies that an earlier run has done into this folder,
    with the same files, settings and version, are not measured again; with `retry` those that failed are. A movie that
    fails is a row of the tables. `extras` are made beside the tables. `tell` hears of everything. Raises OutputError
    where the folder is not ours, another run works in it, or the tables cannot be written; ConfigError for a wrong
    number of workers, or extras that cannot be made.
    """
    cores = processors()
    workers = cores if workers is None else workers
    if workers < 1:
        raise ConfigError(f"workers: expected 1 or more; found {workers}")
    extras = extras or Extras()
    extras.check(plan)
    with run_folder(out) as folder:
        known: dict[str, Status] = {}
        for task in plan.tasks:
            status = current(folder, plan, task)
            if status is not None and not (retry and status.state == "failed"):
                known[task.movie] = status
        todo = [task for task in plan.tasks if task.movie not in known]
        unchanged = len(known)
        tell(Planned(len(plan.tasks), unchanged))
        workers = max(1, min(workers, len(todo)))
        jobs = [job_of(task, folder, plan, max(1, cores // workers)) for task in todo]
        try:
            known |= _measure_all(jobs, workers, tell)
        finally:
            clear_partial(folder)
        statuses = {task.movie: known[task.movie] for task in plan.tasks}
        files: list[Path] = []
        notes: list[str] = []
        guarded(folder, lambda: write_tables(folder, plan, statuses, files, notes, changed=bool(todo),
                                              extras=extras))
        outcome = Outcome(folder, statuses, unchanged, tuple(files), (*plan.notes, *notes))
    tell(Completed(len(plan.tasks), outcome.count("pass"), outcome.count("review"), outcome.count("fail"),
                   len(outcome.failed), str(folder)))
    return outcome


def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _measure_all(jobs: list[Job], workers: int, tell: TellBatch) -> dict[str, Status]:
    """Measure all jobs; those whose worker died once more, one by one."""
    done: dict[str, Status] = {}
    died: list[Job] = []
    for job, end in _rounds(jobs, workers, tell):
        if isinstance(end, Status):
            done[job.task.movie] = end
        else:
            died.append(job)
    for job, end in _rounds(died, 1, tell):
        if not isinstance(end, Status):
            end = _record_death(job, end)
            tell(Failed(job.task.movie, end.kind, end.message))
        done[job.task.movie] = end
    return done


def _rounds(jobs: list[Job], workers: int, tell: TellBatch) -> Iterator[tuple[Job, Status | str]]:
    """Give the jobs to workers, and yield each with what became of it, or with how its worker died."""
    waiting, crew = deque(jobs), list[_Worker]()
    try:
        while waiting or any(worker.job for worker in crew):
            crew += [_Worker(workers == 1) for _ in range(min(workers - len(crew), len(waiting)))]
            for worker in crew:
                if worker.job is None and waiting:
                    tell(Started(waiting[0].task.movie))
                    worker.take(waiting.popleft())
            for pipe in wait([worker.pipe for worker in crew if worker.job]):
                worker = next(worker for worker in crew if worker.pipe is pipe)
                heard = worker.hear()
                if isinstance(heard, Progressed):
                    tell(heard)
                    continue
                job, worker.job = worker.job, None
                assert job is not None
                worker.ended += 1
                if isinstance(heard, str) or worker.ended == MOST_MOVIES:
                    crew.remove(worker)
                    worker.stop()
                if isinstance(heard, str):
                    yield job, heard
                    continue
                if heard.state == "done":
                    tell(Finished(heard.movie, heard.verdict, heard.seconds))
                else:
                    tell(Failed(heard.movie, heard.kind, heard.message))
                yield job, heard
    finally:
        for worker in crew:
            worker.stop()


class _Worker:
    """A process that measures one movie at a time."""

    def __init__(self, alone: bool) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.job: Job | None = None
        self.ended = 0
        self.process = context.Process(target=serve, args=(theirs, alone), daemon=True)
        with _environment({} if alone else dict.fromkeys(THREADS, "1")):
            self.process.start()
        theirs.close()  # so that the pipe closes when the worker dies

    def take(self, job: Job) -> None:
        """Begin a job."""
        self.job = job
        with suppress(OSError):  # it died while it waited; `hear` will say so
            self.pipe.send(job)

    def hear(self) -> Progressed | Status | str:
        """Wait for news: progress, what became of the movie, or how the worker died."""
        try:
            heard: Progressed | Status = self.pipe.recv()
            return heard
        except (EOFError, OSError):
            self.process.join()
            self.pipe.close()
            return _ending(self.process.exitcode or 0)

    def stop(self) -> None:
        """End the process, at once where it is at work."""
        self.pipe.close()
        if self.job is not None:
            self.process.kill()
        self.process.join()


def _record_death(job: Job, ending: str) -> Status:
    """Write down that the worker died at a movie, twice."""
    status = Status(job.task.movie, "failed", fingerprint(job.task.path), job.task.settings, job.version,
                    kind="WorkerDied", lasting=False,
                    message=f"{job.task.movie}: the process that measured it {ending}, twice; the second time no other "
                            "ran beside it. Too little memory is the usual reason: see reading.crop_px")
    guarded(job.out, lambda: write_status(job.out, job.task.key, status))
    return status


def _ending(code: int) -> str:
    if code >= 0:
        return f"ended with code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"


@contextmanager
def _environment(wanted: Mapping[str, str]) -> Iterator[None]:
    """Set variables of the environment that a process which starts in this block inherits."""
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def waiting_for(movies: Iterable[Task], out: Path, plan: Plan) -> dict[str, str]:
    """Tell for each movie what a run into this folder would do: "to do", or "done" or "failed" before and unchanged."""
    found: dict[str, str] = {}
    for task in movies:
        status = current(out, plan, task)
        found[task.movie] = "to do" if status is None else status.state
    return found


