"""Give jobs to processes of this machine.

Each worker is a process with a pipe of its own, so that a worker that dies (killed, out of memory, a crash in a
library) names the movie it was at. Workers stay from one step of a run to the next.
"""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import wait
from types import TracebackType

from ..events import Progressed, Started, TellBatch
from .work import Died, End, Work, serve

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class Processes:
    """Workers of this machine, at most so many at a time; a context, at whose end they end."""

    def __init__(self, most: int) -> None:
        self.most = most
        self.notes: list[str] = []
        self._crew: list[_Worker] = []

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None,
                 ) -> None:
        self._stop()

    def work(self, jobs: list[Work], tell: TellBatch, *, alone: bool = False) -> Iterator[tuple[Work, End]]:
        """Do jobs, and yield each with what became of it, or with how its worker died; `alone` one after the other,
        with no other worker beside it."""
        waiting, most = deque(jobs), 1 if alone else self.most
        if alone and jobs:
            self._stop()
        while waiting or any(worker.job for worker in self._crew):
            idle = sum(worker.job is None for worker in self._crew)
            self._crew += [_Worker(self.most == 1)
                           for _ in range(min(most - len(self._crew), len(waiting) - idle))]
            for worker in self._crew:
                if worker.job is None and waiting:
                    tell(Started(waiting[0].task.movie))
                    worker.take(waiting.popleft())
            for pipe in wait([worker.pipe for worker in self._crew if worker.job]):
                worker = next(worker for worker in self._crew if worker.pipe is pipe)
                heard = worker.hear()
                if isinstance(heard, Progressed):
                    tell(heard)
                    continue
                job, worker.job = worker.job, None
                assert job is not None
                if isinstance(heard, Died):
                    self._crew.remove(worker)
                    worker.stop()
                yield job, heard

    def _stop(self) -> None:
        while self._crew:
            self._crew.pop().stop()


class _Worker:
    """A process that does one job at a time."""

    def __init__(self, only: bool) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.job: Work | None = None
        self.process = context.Process(target=serve, args=(theirs, only), daemon=True)
        with _environment({} if only else dict.fromkeys(THREADS, "1")):
            self.process.start()
        theirs.close()  # so that the pipe closes when the worker dies

    def take(self, job: Work) -> None:
        """Begin a job."""
        self.job = job
        with suppress(OSError):  # it died while it waited; `hear` will say so
            self.pipe.send(job)

    def hear(self) -> Progressed | End:
        """Wait for news: progress, what became of the job, or how the worker died."""
        try:
            heard: Progressed | End = self.pipe.recv()
            return heard
        except (EOFError, OSError):
            self.process.join()
            self.pipe.close()
            return Died(_ending(self.process.exitcode or 0))

    def stop(self) -> None:
        """End the process, at once where it is at work."""
        self.pipe.close()
        if self.job is not None:
            self.process.kill()
        self.process.join()


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
