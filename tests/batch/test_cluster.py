"""A run on a Dask cluster of real processes: the same tables, and nothing lost when a part of it dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from microbundle import cli
from microbundle.batch.plan import make_plan
from microbundle.batch.run import run_batch
from microbundle.config import Config
from microbundle.errors import ClusterUnusable
from microbundle.events import BatchEvent, Progressed, Started

pytest.importorskip("distributed")

SETTINGS = Config(method="fast", fps=30, um_per_px=4)
SCHEDULER = """
import asyncio, sys
from distributed import Scheduler
async def main():
    async with Scheduler(port=0, host="127.0.0.1", dashboard=False, dashboard_address=None) as scheduler:
        print(scheduler.address, flush=True)
        await scheduler.finished()
asyncio.run(main())
"""
WORKER = """
import asyncio, os, sys
from distributed import Worker
{before}
async def main():
    async with Worker(sys.argv[1], nthreads={threads}, name="{name}", dashboard=False,
                      local_directory=sys.argv[2]) as worker:
        print(worker.address, flush=True)
        await worker.finished()
asyncio.run(main())
"""


class Nodes:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.processes = folder, list[subprocess.Popen[str]]()
        self.scheduler, self.address = self.start(SCHEDULER)

    def start(self, code: str, *arguments: str) -> tuple[subprocess.Popen[str], str]:
        process = subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE,
                                   stderr=subprocess.DEVNULL, text=True, cwd=self.folder)
        self.processes.append(process)
        assert process.stdout is not None
        return process, process.stdout.readline().strip()

    def worker(self, name: str, *, threads: int = 1, before: str = "") -> subprocess.Popen[str]:
        code = WORKER.format(name=name, threads=threads, before=before)
        return self.start(code, self.address, str(self.folder))[0]


@contextmanager
def nodes(folder: Path) -> Iterator[Nodes]:
    folder.mkdir(exist_ok=True)
    held = Nodes(folder)
    try:
        yield held
    finally:
        for process in held.processes:
            process.kill()
            process.wait()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Nodes]:
    """A scheduler without workers."""
    with nodes(tmp_path / "nodes") as held:
        yield held


@pytest.fixture
def three(plate: Path, tmp_path: Path) -> Path:
    """A manifest of three movies, one of them empty."""
    folder = tmp_path / "movies"
    folder.mkdir()
    for name, source in (("M1", "A1"), ("M2", "A1"), ("M3", "B1")):
        (folder / f"{name}.tif").symlink_to(plate / f"{source}.tif")
    (folder / "plate.csv").write_text("movie,dose\nM2.tif,2\nM1.tif,1\nM3.tif,3\n")
    return folder / "plate.csv"


def contents(out: Path) -> tuple[bytes, bytes]:
    return (out / "plate.csv").read_bytes(), (out / "movies.csv").read_bytes()


def once(at: str, do: Callable[[], object]) -> tuple[Callable[[BatchEvent], None], list[BatchEvent]]:
    """Hear a run, and do something when it has begun a movie."""
    told: list[BatchEvent] = []

    def tell(event: BatchEvent) -> None:
        first = not any(isinstance(one, Progressed) and one.movie == at for one in told)
        told.append(event)
        if first and isinstance(event, Progressed) and event.movie == at:
            do()

    return tell, told


def test_the_same_tables_and_events_as_on_this_machine(
        three: Path, tmp_path: Path, cluster: Nodes, monkeypatch: pytest.MonkeyPatch) -> None:
    cluster.worker("a", threads=2)
    cluster.worker("b")
    monkeypatch.chdir(three.parent)
    plan = make_plan("plate.csv", config=SETTINGS)  # a path that means nothing elsewhere
    told: list[BatchEvent] = []
    there = run_batch(plan, tmp_path / "there", cluster=cluster.address, tell=told.append)
    here = run_batch(plan, tmp_path / "here", workers=1)
    assert contents(there.out) == contents(here.out)
    assert [type(event).__name__ for event in (told[0], told[-1])] == ["Planned", "Completed"]
    for movie in ("M1.tif", "M2.tif"):
        mine = [event for event in told if getattr(event, "movie", "") == movie]
        assert isinstance(mine[0], Started)
        assert any(isinstance(event, Progressed) for event in mine)
        assert type(mine[-1]).__name__ == "Finished"
    again = run_batch(plan, there.out, cluster=cluster.address)
    assert (again.unchanged, again.notes) == (3, there.notes)
    assert [name for name in os.listdir(there.out) if "partial" in name] == []


def test_a_killed_worker_costs_nothing_and_a_movie_at_which_two_die_is_a_row(
        three: Path, tmp_path: Path, cluster: Nodes) -> None:
    crew = [cluster.worker("0")]
    killed: list[str] = []

    def tell(event: BatchEvent) -> None:
        if isinstance(event, Progressed) and killed.count(event.movie) < {"M1.tif": 2, "M2.tif": 1}[event.movie]:
            killed.append(event.movie)
            crew[-1].send_signal(signal.SIGKILL)
            crew[-1].wait()
            crew.append(cluster.worker(f"{len(crew)}"))

    outcome = run_batch(make_plan(three, config=SETTINGS, report=False), tmp_path / "out", cluster=cluster.address,
                        tell=tell)
    assert killed == ["M2.tif", "M1.tif", "M1.tif"]
    assert {status.movie: status.kind for status in outcome.failed} == {"M1.tif": "WorkerDied",
                                                                        "M3.tif": "MovieUnreadable"}
    assert "was lost (the worker tcp://" in outcome.statuses["M1.tif"].message


def test_a_lost_scheduler_is_one_error_and_what_is_done_is_kept(
        three: Path, tmp_path: Path, cluster: Nodes, capsys: pytest.CaptureFixture[str]) -> None:
    cluster.worker("a")
    out, plan = tmp_path / "out", make_plan(three, config=SETTINGS, report=False)
    tell, _ = once("M1.tif", cluster.scheduler.kill)
    with pytest.raises(ClusterUnusable, match=r"the scheduler was lost.*What is done is kept"):
        run_batch(plan, out, cluster=cluster.address, tell=tell)
    assert (out / "results" / "M2.tif" / "result.nc").is_file()
    assert [name for name in os.listdir(out) if "partial" in name] == []
    time.sleep(1.5)  # the worker that still measures M1 sees that its run is over
    assert not (out / "status" / "M1.tif.json").exists()
    line = ["batch", str(three), "--out", str(out), "--method", "fast", "--fps", "30", "--um-per-px", "4",
            "--no-report", "--cluster"]
    assert cli.run([*line, cluster.address]) == 7
    assert capsys.readouterr().err.startswith(f"error: {cluster.address}: expected the address of a Dask scheduler")
    with nodes(tmp_path / "others") as others:
        others.worker("b")
        assert cli.run([*line, others.address]) == 3
    assert "1 without a result; 1 of them unchanged since an earlier run" in capsys.readouterr().out


def test_workers_that_cannot_do_the_work_are_told(three: Path, tmp_path: Path, cluster: Nodes) -> None:
    cluster.worker("old", before="import importlib.metadata as m\n"
                                 "m.version = lambda name, was=m.version: "
                                 "'0.0.1' if name == 'microbundle' else was(name)")
    plan = make_plan(three.parent / "M3.tif", config=SETTINGS, report=False)
    with pytest.raises(ClusterUnusable, match=r"expected a worker.*expected microbundle .* on it; found 0\.0\.1"):
        run_batch(plan, tmp_path / "out", cluster=cluster.address)
    cluster.worker("good")
    outcome = run_batch(plan, tmp_path / "out", cluster=cluster.address)
    assert [status.kind for status in outcome.failed] == ["MovieUnreadable"]
    assert ["found 0.0.1" in note for note in outcome.notes if "is not used" in note] == [True]


def test_a_worker_without_microbundle_is_told(three: Path, tmp_path: Path, cluster: Nodes) -> None:
    cluster.worker("none", before="import importlib.metadata as m\n"
                                  "def gone(name): raise m.PackageNotFoundError(name)\n"
                                  "m.version = gone")
    with pytest.raises(ClusterUnusable, match="found No package metadata was found for microbundle"):
        run_batch(make_plan(three, config=SETTINGS), tmp_path / "out", cluster=cluster.address)


def test_a_worker_that_cannot_load_microbundle_is_told(
        three: Path, tmp_path: Path, cluster: Nodes, monkeypatch: pytest.MonkeyPatch) -> None:
    cluster.worker("broken", before="sys.modules['microbundle'] = None")
    monkeypatch.setattr("microbundle.batch.cluster.CHECK_S", 2.0)
    monkeypatch.setattr("microbundle.batch.cluster.WITHOUT_WORKERS_S", 6.0)
    # Dask's worker falls silent, or ends, by how soon it looks at what it cannot load.
    with pytest.raises(ClusterUnusable, match=r"expected an answer within 2 s|the cluster has had none"):
        run_batch(make_plan(three, config=SETTINGS), tmp_path / "out", cluster=cluster.address)


def test_folders_out_of_reach_are_told(three: Path, tmp_path: Path, cluster: Nodes) -> None:
    cluster.worker("a", before="import pathlib; was = pathlib.Path.read_text\n"
                               "def gone(self, *a, **k):\n"
                               "    if '.cluster' in self.name: raise FileNotFoundError(self)\n"
                               "    return was(self, *a, **k)\n"
                               "pathlib.Path.read_text = gone")
    with pytest.raises(ClusterUnusable, match=r"expected to reach the folder .*out; it does not"):
        run_batch(make_plan(three, config=SETTINGS), tmp_path / "out", cluster=cluster.address)


def test_without_dask_the_line_that_installs_it_is_told(three: Path, tmp_path: Path,
                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("microbundle.batch.cluster.find_spec", lambda _: None)
    with pytest.raises(ClusterUnusable, match=r'pip install "microbundle\[cluster\]"'):
        run_batch(make_plan(three), tmp_path / "out", cluster="tcp://127.0.0.1:1")
