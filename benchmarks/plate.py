"""A whole plate with planted faults and a drug of known effect, measured by the command line, and killed many times.

    python benchmarks/plate.py [--wells 96] [--kills 10] [--workers 2] [--method accurate] [--seed 0] [--keep FOLDER]

The plate is that of `microbundle example-plate --faults`. Three things are checked, and a table is printed of each:
every planted fault is reported as planted, and no other movie is lost; the drug's effect on amplitude and rate (ratio
of a dose to the control, Welch's t-interval of the logarithms of the wells' means) is the true one; and a run that is
killed at random moments, whole or one worker alone, and started again, ends with the same bytes in all tables as the
undisturbed run. Ends with code 1 where a fault is not reported, a table differs, or less than 80 % of the intervals
hold the truth.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

METRICS = {"amplitude_um": "amplitude", "beat_rate_bpm": "beat rate"}
LEAST_HELD = 0.8
TABLES = ("plate.csv", "movies.csv", "index.html")


def table(file: Path) -> list[dict[str, str]]:
    """Rows of a CSV file."""
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def reported(plate: Path, out: Path) -> tuple[list[tuple[str, ...]], int]:
    """A row for each planted fault, what must be and what was reported; and how many movies are reported wrongly."""
    import microbundle

    movies = {row["movie"]: row for row in table(out / "movies.csv")}
    rows, wrong = [], 0
    for truth in table(plate / "truth.csv"):
        found = movies[truth["movie"]]
        keys: set[str] = set()
        if found["state"] == "done":
            keys = {f.key for f in microbundle.load(out / found["result"]).findings}
        right = ((found["state"], found["failure_kind"]) == (truth["state"], truth["failure_kind"])
                 and (found["state"] == "failed" or found["verdict"] in truth["verdict"].split("|"))
                 and (not truth["finding"] or truth["finding"] in keys))
        if right and truth["numbers"] == "right":
            off = [abs(float(found[name]) / float(truth[name]) - 1) for name in METRICS]
            right = max(off) < 0.1
        wrong += not right
        if truth["fault"] or not right:
            expected = truth["failure_kind"] or " or ".join(truth["verdict"].split("|"))
            said = found["failure_kind"] or found["verdict"]
            if truth["finding"]:
                expected += f", {truth['finding']}"
                said += f", {truth['finding']}" if truth["finding"] in keys else ""
            rows.append((truth["fault"] or "none", truth["well"], expected, said, "yes" if right else "NO"))
    return rows, wrong


def effects(plate: Path, out: Path) -> tuple[list[tuple[str, ...]], float, list[str]]:
    """A row for each dose and metric; the share of intervals that hold the truth; and the error of single wells."""
    from scipy import stats

    from microbundle.synth.plate import effect

    truths = {row["movie"]: row for row in table(plate / "truth.csv")}
    movies = [row for row in table(out / "movies.csv") if row["verdict"] in ("pass", "review")]
    rows, held, told = [], [], []
    for k, (name, label) in enumerate(METRICS.items()):
        logs: dict[float, list[float]] = {}
        for row in movies:
            if row[name]:
                logs.setdefault(float(truths[row["movie"]]["dose_um"]), []).append(np.log(float(row[name])))
        for dose in sorted(set(logs) - {0.0}):
            here, control = np.array(logs[dose]), np.array(logs[0.0])
            truth = effect(dose)[k]
            if min(len(here), len(control)) < 2:
                continue
            found = stats.ttest_ind(here, control, equal_var=False)
            low, high = np.exp(found.confidence_interval(0.95))
            held.append(bool(low <= truth <= high))
            ratio = np.exp(here.mean() - control.mean())
            rows.append((label, f"{dose:g}", str(len(here)), f"{truth:.3f}", f"{ratio:.3f}", f"{low:.3f} to {high:.3f}",
                         "yes" if held[-1] else "no"))
        off = [100 * abs(float(row[name]) / float(truths[row["movie"]][name]) - 1) for row in movies
               if row[name] and truths[row["movie"]]["numbers"] == "right"]
        told.append(f"{label} of a sound well: median error {np.median(off):.2f} %, largest {max(off):.2f} %")
    return rows, float(np.mean(held)) if held else 1.0, told


def killed(line: list[str], out: Path, kills: int, usual_s: float, rng: np.random.Generator) -> tuple[int, int]:
    """Start a run again and again, kill a worker, then all of it, at random moments; at last let it end.

    Returns how many times the whole run, and a single worker, was killed.
    """
    whole = single = 0
    for _ in range(kills):
        run = subprocess.Popen([*line, "--out", str(out)], start_new_session=True, stdout=subprocess.DEVNULL)
        end = time.monotonic() + rng.uniform(0.02, 1.3) * max(usual_s / kills, 4.0)
        one = time.monotonic() + rng.uniform(0.3, 1.0) * (end - time.monotonic())
        while run.poll() is None and time.monotonic() < end:
            if time.monotonic() > one:
                one = np.inf
                for pid in workers(run.pid)[:1]:
                    os.kill(pid, signal.SIGKILL)
                    single += 1
            time.sleep(0.02)
        if run.poll() is None:
            os.killpg(run.pid, signal.SIGKILL)
            whole += 1
        run.wait()
    subprocess.run([*line, "--out", str(out)], check=False, stdout=subprocess.DEVNULL)
    return whole, single


def workers(pid: int) -> list[int]:
    """Processes that a run has started to measure, on Linux."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == pid and b"spawn_main" in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return sorted(found)


def printed(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table in Markdown."""
    for row in (header, ("---",) * len(header), *rows):
        print("|" + "|".join(f" {cell} " if cell != "---" else cell for cell in row) + "|")
    print(flush=True)


def main() -> int:
    """Run and print all; 1 where anything is wrong."""
    from microbundle.synth.plate import render_plate

    arguments = argparse.ArgumentParser()
    arguments.add_argument("--wells", type=int, default=96)
    arguments.add_argument("--kills", type=int, default=10)
    arguments.add_argument("--workers", type=int, default=2)
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--method", default="accurate")
    arguments.add_argument("--keep", type=Path)
    wanted = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = wanted.keep or Path(folder)
        start = time.process_time()
        manifest = render_plate(home / "plate", wanted.wells, faults=True, seed=wanted.seed)
        spent_s = (time.process_time() - start) / wanted.wells
        print(f"{wanted.wells} wells rendered: {spent_s:.2f} CPU s each\n", flush=True)
        line = [sys.executable, "-m", "microbundle", "batch", str(manifest), "--workers", str(wanted.workers),
                "--method", wanted.method, "--quiet"]
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([*line, "--out", str(home / "whole")], check=False)
        wall_s, used = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s = used.ru_utime + used.ru_stime - before.ru_utime - before.ru_stime
        faults, wrong = reported(home / "plate", home / "whole")
        printed(("fault", "well", "must be reported", "was reported", "right"), faults)
        doses, held, told = effects(home / "plate", home / "whole")
        header = ("metric", "dose, uM", "wells", "true ratio to control", "measured", "95 % interval",
                  "holds the truth")
        printed(header, doses)
        print("\n".join(told))
        print(f"{wanted.wells} movies, {wanted.workers} workers: {cpu_s / wanted.wells:.2f} CPU s and "
              f"{wall_s / wanted.wells:.2f} s wall-clock a movie, with reports, plate maps and index; load "
              f"{os.getloadavg()[0]:.1f}", flush=True)
        whole, single = killed(line, home / "killed", wanted.kills, wall_s, np.random.default_rng(wanted.seed))
        differ = [name for name in TABLES
                  if (home / "whole" / name).read_bytes() != (home / "killed" / name).read_bytes()]
        print(f"killed {whole} times, and {single} single workers: " + (
            f"{', '.join(differ)} differ" if differ else f"{', '.join(TABLES)} are the same, byte for byte"))
    return int(bool(wrong or differ or held < LEAST_HELD))


if __name__ == "__main__":
    sys.exit(main())
