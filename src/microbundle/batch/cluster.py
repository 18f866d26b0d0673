"""Give jobs to the workers of a Dask cluster.

A job is bound to one worker, which does one at a time and may use all threads that it was given: so no worker does more
than it has processors for, few jobs wait in the scheduler, and a worker that is lost names the movie it was at. Before
its first job a worker is checked: the same version of microbundle, and the folders of results and movies within reach.

The run holds a file in its folder while it goes on. A worker that does not find it any more gives its job up, so that
nothing is written by a run that was stopped.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from queue import Empty, Queue
from types import TracebackType
from typing import Any
from uuid import uuid4

from ..errors import ClusterUnusable
from ..events import Drawn, Progress, Progressed, Started, Tell, TellBatch
from .plan import Plan, fingerprint
from .state import RESULTS, Status, guarded
from .work import BETWEEN_EVENTS_S, Died, End, Job, Work, do, settle

CONNECT_S = 20.0
CHECK_S = 120.0
"""So long a worker may take to answer before its first job, for which it loads microbundle."""
LOOK_S = 1.0
"""So often is looked which workers there are."""
WITHOUT_WORKERS_S = 300.0
"""So long a run waits for a worker where there is none."""
RUN_LOOKS_S = 1.0
"""So often a worker looks whether its run still goes on."""
_one_at_a_time = threading.Lock()
"""A worker with several threads does one job with all of them; matplotlib would mix up two."""


@dataclass
class _Post:
    """A worker of the cluster, and what it is at."""

    threads: int
    future: Any
    asked: float
    """Since when it is being checked."""
    same: bool = False
    """It has this version of microbundle."""
    fit: bool = False
    """It can do the work."""
    job: Work | None = None


class Cluster:
    """The workers of a Dask cluster, at most so many; a context, at whose end what waits there is taken back.

    `address` is that of the scheduler, or its scheduler file. Raises ClusterUnusable where Dask is not installed, the
    scheduler cannot be reached or is lost, or none of its workers can do the work.
    """

    def __init__(self, address: str, plan: Plan, out: Path, most: int | None = None) -> None:
        self.address, self.plan, self.out, self.most = address, plan, out, most
        self.notes: list[str] = []
        """Of workers that cannot be used, each with the reason."""
        self._held = ExitStack()
        self._posts: dict[str, _Post] = {}
        self._unfit: set[str] = set()
        self._news: Queue[Any] = Queue()
        self._topic = f"microbundle-{uuid4().hex}"
        self._run = out / f".cluster.partial-{uuid4().hex}"

    def __enter__(self) -> Cluster:
        if find_spec("distributed") is None:
            raise ClusterUnusable("--cluster: expected the packages dask and distributed; they are not installed. "
                                  'Install them with pip install "microbundle[cluster]"')
        from distributed import Client

        open_client: Any = Client
        with ExitStack() as held:
            held.enter_context(_quiet())
            where = {"scheduler_file": self.address} if Path(self.address).is_file() else {"address": self.address}
            try:
                self._client: Any = open_client(**where, timeout=CONNECT_S, set_as_default=False)
            except Exception as error:  # a wrong address, nobody there, another version of Dask, wrong certificates
                raise ClusterUnusable(f"{self.address}: expected the address of a Dask scheduler, such as "
                                      f"tcp://10.0.0.1:8786, or its scheduler file; found none there: {_short(error)}"
                                      ) from None
            held.callback(self._leave)
            guarded(self.out, self._begin)
            held.callback(lambda: self._run.unlink(missing_ok=True))
            self._asking(lambda: self._client.subscribe_topic(self._topic, self._heard))
            self._held = held.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None,
                 ) -> None:
        self._held.close()

    def work(self, jobs: list[Work], tell: TellBatch, *, alone: bool = False) -> Iterator[tuple[Work, End]]:
        """Do jobs, and yield each with what became of it, or with how its worker was lost; `alone` one after the
        other."""
        waiting = deque(jobs)
        looked, seen = 0.0, time.monotonic()
        while waiting or any(post.job for post in self._posts.values()):
            now = time.monotonic()
            if now - looked >= LOOK_S:
                looked = now
                yield from self._look(bool(waiting))
                seen = now if self._posts else seen
                if now - seen > WITHOUT_WORKERS_S:
                    raise ClusterUnusable(f"{self.address}: expected workers; the cluster has had none for "
                                          f"{WITHOUT_WORKERS_S / 60:.0f} minutes. {_KEPT}")
            for name, post in self._posts.items():
                busy = sum(other.job is not None for other in self._posts.values())
                if waiting and post.fit and post.job is None and busy < (1 if alone else self.most or busy + 1):
                    tell(Started(waiting[0].task.movie))
                    self._give(name, post, waiting.popleft())
            with suppress(Empty):
                news = self._news.get(timeout=LOOK_S)
                if isinstance(news, Progressed):
                    if any(post.job and post.job.task.movie == news.movie for post in self._posts.values()):
                        tell(news)
                else:
                    yield from self._ended(*news)

    def _look(self, needed: bool) -> Iterator[tuple[Work, End]]:
        """See which workers there are: check new ones, and tell of the jobs of those that are lost."""
        there = self._asking(self._client.nthreads)
        for name in set(self._posts) - set(there):
            post = self._posts[name]
            if post.job is not None and post.future.done():  # it ended its job before, which the next news says
                continue
            del self._posts[name]
            if post.job is not None:
                self._asking(partial(self._client.cancel, [post.future], force=True))
                yield post.job, Died(f"was lost (the worker {name} is gone)")
        for name, post in list(self._posts.items()):
            if not post.fit and time.monotonic() - post.asked > CHECK_S:  # Dask falls silent where it cannot unpickle
                self._refuse(name, f"expected an answer within {CHECK_S:.0f} s; there was none. It needs the same "
                                   "packages as this machine")
        for name, threads in there.items():
            if needed and name not in self._posts and name not in self._unfit:
                self._posts[name] = _Post(threads, self._send(name, version, "microbundle"), time.monotonic())
        if self._unfit and needed and not self._posts:
            raise ClusterUnusable(f"{self.address}: expected a worker that can do the work; found none. "
                                  f"{self.notes[-1]}")

    def _refuse(self, name: str, reason: str) -> None:
        del self._posts[name]
        self._unfit.add(name)
        self.notes.append(f"the worker {name} is not used: {reason}")

    def _give(self, name: str, post: _Post, job: Work) -> None:
        sent = replace(job, threads=post.threads) if isinstance(job, Job) else job
        post.job, post.future = job, self._send(name, _done, sent, str(self._run), self._topic, post.threads)

    def _send(self, name: str, work: Callable[..., Any], *arguments: Any) -> Any:
        future = self._asking(lambda: self._client.submit(work, *arguments, workers=[name], pure=False))
        future.add_done_callback(lambda done: self._news.put((name, done)))
        return future

    def _ended(self, name: str, future: Any) -> Iterator[tuple[Work, End]]:
        """Take in that a check or a job has ended."""
        post = self._posts.get(name)
        if post is None or post.future.key != future.key:
            return
        problem, end = "", None
        if future.status == "finished":
            try:
                end = future.result(timeout=CONNECT_S)
            except Exception:  # its worker is gone, and what became of the job with it
                self._asking(self._client.nthreads)
                problem = f"the worker {name} is gone"
        elif future.status == "error":
            problem = _short(self._asking(lambda: future.exception(timeout=CONNECT_S)))
        else:
            self._asking(self._client.nthreads)  # where the scheduler was lost, Dask calls all jobs cancelled
            problem = "its job was cancelled"
        if post.job is not None:
            job, post.job = post.job, None
            assert end is None or isinstance(end, Status | Drawn)
            yield job, Died(f"was lost ({problem})") if end is None else end
        elif not post.same:
            post.same = end == self.plan.version
            if post.same:
                post.future = self._send(name, _checked, str(self._run), *_sample(self.plan))
            else:
                self._refuse(name, f"expected microbundle {self.plan.version} on it; found {problem or end}")
        elif problem or end:
            self._refuse(name, problem or str(end))
        else:
            post.fit = True

    def _asking(self, ask: Callable[[], Any]) -> Any:
        """Ask the scheduler for something. Raises ClusterUnusable where it does not answer."""
        try:
            if self._client.status != "running":
                raise OSError(f"the connection is {self._client.status}")
            return ask()
        except Exception as error:  # Dask and its connections raise many kinds
            raise ClusterUnusable(f"{self.address}: the scheduler was lost: {_short(error)}. {_KEPT}") from None

    def _begin(self) -> None:
        self._run.write_text(self._run.name, encoding="utf-8")

    def _heard(self, event: tuple[float, Any]) -> None:
        movie, stage, share = event[1]
        self._news.put(Progressed(movie, stage, share))

    def _leave(self) -> None:
        """Take back what waits, and let the scheduler go, even where it is gone."""
        with suppress(Exception):
            if self._client.status == "running":
                self._client.cancel([post.future for post in self._posts.values() if post.job], force=True)
        with suppress(Exception):
            self._client.close(timeout=2)


_KEPT = "What is done is kept: the same line goes on there"


class _Stopped(BaseException):
    """The run that wanted a job goes on no more."""


def _checked(run: str, movie: str | None, seen: str) -> str:
    """On a worker: tell why it cannot do the work; empty where it can."""
    file = Path(run)
    with suppress(OSError):
        if file.read_text(encoding="utf-8") != file.name:
            return f"expected to find the file {run} as this machine wrote it; found another"
        if not os.access(file.parent / RESULTS, os.W_OK):
            return f"expected to write into the folder {file.parent / RESULTS}; it may not"
        if movie is not None and fingerprint(Path(movie)) != seen:
            return (f"expected to see the movie {movie} as this machine does; it sees another, or none. Movies and "
                    "results must lie in folders that all machines share, under the same names")
        return ""
    return (f"expected to reach the folder {file.parent}; it does not. Movies and results must lie in folders that all "
            "machines share, under the same names")


def _done(job: Work, run: str, topic: str, threads: int) -> Status | Drawn:
    """On a worker: do a job, for as long as its run goes on."""
    from distributed import get_worker

    with _one_at_a_time:
        settle(threads)
        return do(job, _telling(get_worker(), Path(run), topic, job.task.movie))


def _telling(worker: Any, run: Path, topic: str, movie: str) -> Tell:
    """Send progress to the run, now and then, and stop where the run has ended."""
    told = looked = 0.0

    def tell(event: Progress) -> None:
        nonlocal told, looked
        now = time.monotonic()
        if now - looked >= RUN_LOOKS_S or event.share == 1:
            looked = now
            if not run.exists():
                raise _Stopped
        if now - told >= BETWEEN_EVENTS_S:
            told = now
            worker.log_event(topic, (movie, event.stage, round(event.share, 3)))

    return tell


def _sample(plan: Plan) -> tuple[str | None, str]:
    """A movie of the plan that is there, and its fingerprint."""
    for task in plan.tasks:
        seen = fingerprint(task.path)
        if seen != "missing":
            return str(task.path.absolute()), seen
    return None, ""


def _short(error: BaseException | None) -> str:
    """Say in one line what an error of Dask means."""
    while error is not None and error.__cause__ is not None:
        error = error.__cause__
    if type(error).__name__ == "KilledWorker":
        return "several workers died at it"
    text = " ".join(str(error).split())
    return text if len(text) > 20 else f"{type(error).__name__} {text}".strip()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Dask logs off the error stream: what matters in it becomes one of our errors."""
    levels = {name: logging.getLogger(name).level for name in logging.root.manager.loggerDict
              if name.partition(".")[0] == "distributed"}  # each has a level of its own
    for name in levels:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
