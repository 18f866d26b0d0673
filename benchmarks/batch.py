"""Many movies: scaling over workers, time and memory of each, and what is spent beside the measuring.

    python benchmarks/batch.py [--movies 8] [--frames 75] [--kept 12]

The movies are rendered tissues of 256 x 448 px with known motion, as `microbundle simulate` makes them. A first run
warms up (it compiles and caches), and is not counted. Seconds are wall-clock; overhead is what a run takes beyond the
sum of its movies' own times. Memory is the peak resident size of the largest worker, and what one worker keeps after
each of `--kept` movies (Linux). Planning and resuming are measured on 10,000 empty files, which earlier runs seem to
have done, with the tables of a real result, and whose index they have written.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def cpu_s() -> float:
    """CPU seconds of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(plan, out: Path, workers: int) -> tuple[float, float, float]:
    """Wall-clock seconds of a run into a new folder, the sum over its movies, and CPU seconds."""
    from microbundle.batch.run import run_batch

    shutil.rmtree(out, ignore_errors=True)
    start, before = time.perf_counter(), cpu_s()
    outcome = run_batch(plan, out, workers=workers)
    assert not outcome.failed
    spent = time.perf_counter() - start
    return spent, sum(status.seconds for status in outcome.statuses.values()), cpu_s() - before


def kept_mb(home: Path, count: int) -> list[float]:
    """Resident size in MB of a process after each of so many movies."""
    from multiprocessing import get_context

    with get_context("spawn").Pool(1) as pool:
        return pool.apply(_kept_mb, (home, count))


def _kept_mb(home: Path, count: int) -> list[float]:
    from microbundle.batch.plan import make_plan
    from microbundle.batch.state import run_folder
    from microbundle.batch.work import do, job_of, settle
    from microbundle.config import Config
    from microbundle.events import ignore

    settle(1)
    plan, sizes = make_plan(home / "movies", config=Config(fps=30, um_per_px=4)), []
    with run_folder(home / "kept") as out:
        for n in range(count):
            do(job_of(plan.tasks[n % len(plan.tasks)], out, plan, 1), ignore)
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            sizes.append(pages * os.sysconf("SC_PAGE_SIZE") / 2**20)
    return sizes


def listing(home: Path, count: int, table: Path) -> tuple[float, float]:
    """Seconds to plan so many empty files, and to resume a run that has done them all."""
    from microbundle.batch.overview import FILE as OVERVIEW
    from microbundle.batch.plan import fingerprint, make_plan
    from microbundle.batch.run import run_batch
    from microbundle.batch.state import RESULTS, Status, run_folder, write_status

    for p in range(count // 100):
        (home / "empty" / f"P{p}").mkdir(parents=True)
        for w in range(100):
            (home / "empty" / f"P{p}" / f"{'ABCD'[w // 25]}{w % 25 + 1}.tif").touch()
    start = time.perf_counter()
    plan = make_plan(home / "empty", pattern="{plate}/{place}")
    planned_s = time.perf_counter() - start
    with run_folder(home / "listed") as out:
        for task in plan.tasks:
            (out / RESULTS / task.key).mkdir()
            for file in (table, table.parent / OVERVIEW):
                shutil.copy(file, out / RESULTS / task.key)
            write_status(out, task.key, Status(task.movie, "done", fingerprint(task.path), task.settings, plan.version,
                                               verdict="pass"))
    run_batch(plan, home / "listed")  # writes the index once
    start = time.perf_counter()
    run_batch(plan, home / "listed")
    return planned_s, time.perf_counter() - start


def main() -> None:
    """Print the table."""
    from microbundle import cli
    from microbundle.batch.plan import make_plan
    from microbundle.config import Config

    arguments = argparse.ArgumentParser()
    arguments.add_argument("--movies", type=int, default=8)
    arguments.add_argument("--frames", type=int, default=75)
    arguments.add_argument("--kept", type=int, default=12)
    wanted = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        for n in range(wanted.movies):
            code = cli.run(["simulate", "--out", str(home / "movies" / f"A{n + 1}"), "--frames", str(wanted.frames),
                            "--seed", str(n), "--quiet"])
            assert code == 0
        plan = make_plan(home / "movies", config=Config(fps=30, um_per_px=4))
        measured(plan, home / "out", 1)
        print(f"{wanted.movies} movies of {wanted.frames} frames, 256 x 448 px; load {os.getloadavg()[0]:.1f}")
        print("| workers | wall s | CPU s | movies' own s, each | overhead s, each |")
        print("|---|---|---|---|---|")
        for workers in (1, 2):
            wall_s, own_s, spent_s = measured(plan, home / "out", workers)
            each = f"{(wall_s - own_s) / wanted.movies:.2f}" if workers == 1 else ""
            print(f"| {workers} | {wall_s:.1f} | {spent_s:.1f} | {own_s / wanted.movies:.2f} | {each} |", flush=True)
        peak_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # Linux counts in kB
        print(f"peak memory of a worker: {peak_kb / 1024:.0f} MB")
        if Path("/proc/self/statm").exists():
            sizes = kept_mb(home, wanted.kept)
            print(f"kept by a worker after each movie, MB: {' '.join(f'{size:.0f}' for size in sizes)}")
        planned_s, resumed_s = listing(home, 10_000, home / "out" / "results" / "A1" / "summary.csv")
        print(f"10,000 movies: planned in {planned_s:.1f} s, resumed in {resumed_s:.1f} s")


if __name__ == "__main__":
    main()
