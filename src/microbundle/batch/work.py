"""One movie in a worker: measured, its result written, then what became of it. Whatever happens is told, not raised.

A worker is a process that takes jobs from its pipe (`serve`), or one of a cluster's. One of this machine ends when the
run ends, even where that was killed.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from ..decisions import Decisions, decisions_hash, read_decisions, same_measurement
from ..errors import MicrobundleError, OutputError, ResultUnreadable
from ..events import Drawn, Progress, Progressed, Tell
from .pictures import LimitsJob, PicturesJob, place
from .plan import Plan, Task, fingerprint
from .state import RESULTS, Status, read_status, write_status

if TYPE_CHECKING:
    from ..analysis import Analysis

BETWEEN_EVENTS_S = 0.25
"""Progress within a movie is told no more often than this."""


@dataclass(frozen=True)
class Job:
    """What a worker needs to know of its task."""

    task: Task
    out: Path
    version: str
    report: bool
    threads: int
    limits: bool = False
    """Write beside the result which limits its pictures would have."""


@dataclass(frozen=True)
class Died:
    """What became of a job whose worker died."""

    how: str


Work = Job | LimitsJob | PicturesJob
End = Status | Drawn | Died


def result_of(job: Job) -> Path:
    """Folder of the result of a job."""
    return job.out / RESULTS / job.task.key


def job_of(task: Task, out: Path, plan: Plan, threads: int) -> Job:
    """Make the job of a task of a plan."""
    absolute = replace(task, path=task.path.absolute())  # a worker may work in another folder
    return Job(absolute, out, plan.version, plan.report, threads, plan.figures or plan.movies)


def serve(pipe: Connection, alone: bool) -> None:
    """Take jobs from the pipe until it closes, and send back progress and what became of each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run decides when to stop
    threading.Thread(target=_end_with_run, daemon=True).start()
    settle(None if alone else 1)
    while True:
        try:
            job = pipe.recv()
            pipe.send(do(job, _telling(pipe, job.task.movie)))
        except (EOFError, OSError):
            return


def settle(threads: int | None) -> None:
    """Make a process a worker: OpenCV takes so many threads, and libraries keep quiet about damaged files."""
    import logging

    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)
    if threads is not None:
        import cv2

        cv2.setNumThreads(threads)


def do(job: Work, tell: Tell) -> Status | Drawn:
    """Do a job of any kind, and give back the memory that it took; never raises."""
    try:
        return measure(job, tell) if isinstance(job, Job) else job.do(tell)
    finally:
        _let_go()


def _let_go() -> None:
    """Free what is no longer needed but holds itself in circles, and return to the system what glibc would keep.

    Without it a worker grows by some 20 MB with each movie.
    """
    gc.collect()
    if gc.get_freeze_count() == 0:  # modules and caches are there to stay; looking through them takes 0.2 s each time
        gc.freeze()
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library than glibc
            ctypes.CDLL(None).malloc_trim(0)


def measure(job: Job, tell: Tell) -> Status:
    """Measure one movie, write its result folder and then its status; never raises."""
    task, start = job.task, time.perf_counter()
    status = Status(task.movie, "failed", fingerprint(task.path), task.settings, job.version,
                    decisions_hash(result_of(job)))
    try:
        verdict, beats = _measured(job, status, tell)
        status = replace(status, state="done", verdict=verdict, beats=beats)
    except MicrobundleError as error:
        status = replace(status, kind=type(error).__name__, message=str(error),
                         lasting=not isinstance(error, OutputError))
    except MemoryError:
        status = replace(status, kind="MemoryError", lasting=False,
                         message=f"{task.movie}: expected room in memory for this movie; there was none. Use fewer "
                                 "workers, or a crop (reading.crop_px)")
    except Exception as error:  # a mistake in the program must not take the other movies along
        status = replace(status, kind=type(error).__name__, lasting=False,
                         message=f"{task.movie}: the program failed: {error} ({place(error)}); please report this")
    status = replace(status, seconds=round(time.perf_counter() - start, 3))
    try:
        write_status(job.out, task.key, status)
    except OSError as error:
        status = replace(status, state="failed", verdict="", kind=OutputError.__name__, lasting=False,
                         message=f"{job.out}: what became of {task.movie} cannot be written: "
                                 f"{error.strerror or error}")
    return status


def _measured(job: Job, status: Status, tell: Tell) -> tuple[str, int]:
    from ..metrics import tables
    from ..report import NAME, write_report
    from ..store import save
    from .limits import write_limits
    from .overview import write_overview

    decided = read_decisions(result_of(job))
    analysis = _kept(job, status, decided) or _analyzed(job, decided, tell)
    made = tables(analysis)

    def beside(folder: Path) -> None:
        if job.report:
            write_report(analysis, folder / NAME, made=made)
            write_overview(analysis, made["summary"], folder)
        if job.limits:
            write_limits(analysis, folder)

    save(analysis, result_of(job), overwrite=True, made=made, extra=beside)
    return analysis.verdict, int(analysis.beats.complete.sum())


def _analyzed(job: Job, decided: Decisions, tell: Tell) -> Analysis:
    from ..config import Config, merge
    from ..pipeline import analyze
    from ..read import read_movie

    config = decided.over(job.task.config)
    if config.registration.threads is None:
        config = Config.from_dict(merge(config.model_dump(exclude_unset=True),
                                        {"registration": {"threads": job.threads}}))
    part = config.reading
    opened = read_movie(job.task.path, series=part.series, channel=part.channel, z=part.z)
    return analyze(replace(opened, name=job.task.movie), config, decisions=decided, tell=tell)


def _kept(job: Job, status: Status, decided: Decisions) -> Analysis | None:
    """The result that is there, where since then a person has only accepted or rejected it: that measures nothing."""
    from ..store import load

    before = read_status(job.out, job.task)
    if before is None or before.state != "done" or not same_measurement(before.decisions, status.decisions) or any(
            getattr(before, name) != getattr(status, name) for name in ("movie", "input", "settings", "version")):
        return None
    with suppress(ResultUnreadable):
        return replace(load(result_of(job)), decisions=decided)
    return None


def _telling(pipe: Connection, movie: str) -> Tell:
    """Send progress through the pipe, now and then."""
    last = 0.0

    def tell(event: Progress) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= BETWEEN_EVENTS_S:
            last = now
            pipe.send(Progressed(movie, event.stage, round(event.share, 3)))

    return tell


def _end_with_run() -> None:
    run = parent_process()
    if run is not None:
        run.join()
        os._exit(1)

