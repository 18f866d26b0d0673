"""Many movies: what is planned, that one bad movie or a killed process costs nothing, and that runs agree."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from numpy.typing import NDArray
from rich.console import Console

from microbundle import cli
from microbundle.analysis import Analysis
from microbundle.batch.overview import read_overview
from microbundle.batch.plan import fingerprint, make_plan
from microbundle.batch.run import Outcome, run_batch
from microbundle.batch.show import Screen, Tally
from microbundle.batch.state import current
from microbundle.config import Config
from microbundle.errors import ConfigError, OutputError
from microbundle.events import BatchEvent, Completed, Drawing, Drawn, Failed, Finished, Planned, Progressed, Started
from microbundle.report.index import summary_of_folder
from microbundle.store import save

Image = NDArray[Any]
Captured = pytest.CaptureFixture[str]
SETTINGS = Config(method="fast", fps=30, um_per_px=4)
FLAGS = ["--method", "fast", "--fps", "30", "--um-per-px", "4", "--no-report"]


@pytest.fixture(scope="module")
def ran(plate: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, list[BatchEvent]]:
    """A run over the plate with two workers, and all that was told of it."""
    told: list[BatchEvent] = []
    plan = make_plan(plate, config=SETTINGS, pattern="{well}")
    return run_batch(plan, tmp_path_factory.mktemp("ran") / "out", workers=2, tell=told.append), told


def table(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


def contents(out: Path) -> tuple[bytes, bytes]:
    return (out / "plate.csv").read_bytes(), (out / "movies.csv").read_bytes()


# --- one bad movie never stops the rest -----------------------------------------------------------------------------


def test_faults_become_rows_with_kind_and_message(ran: tuple[Outcome, list[BatchEvent]]) -> None:
    outcome, _ = ran
    rows = {row["movie"]: row for row in table(outcome.out / "movies.csv")}
    assert {name: (row["state"], row["failure_kind"]) for name, row in rows.items()} == {
        "A1.tif": ("done", ""), "A2": ("done", ""), "B1.tif": ("failed", "MovieUnreadable"),
        "B2": ("failed", "MaskUnusable"), "C1.tif": ("done", ""), "C2.tif": ("failed", "MovieUnreadable")}
    assert "found an empty file" in rows["B1.tif"]["failure"]
    assert "expected a mask of 88 x 192 px" in rows["B2"]["failure"]
    assert (rows["C1.tif"]["verdict"], rows["C1.tif"]["beats"], rows["C1.tif"]["amplitude_um"]) == ("fail", "0", "")
    assert rows["A1.tif"]["amplitude_um"] == rows["A2"]["amplitude_um"] != ""
    assert [rows[name]["well"] for name in rows] == ["A1", "A2", "B1", "B2", "C1", "C2"]
    assert (outcome.out / rows["A2"]["result"] / "result.nc").is_file()
    assert rows["B1.tif"]["result"] == ""


def test_the_tidy_table_has_a_row_for_each_movie_and_metric(ran: tuple[Outcome, list[BatchEvent]]) -> None:
    rows = table(ran[0].out / "plate.csv")
    assert list(rows[0]) == ["movie", "well", "metric", "n", "mean", "se", "sd", "low_95", "high_95", "verdict"]
    assert list(dict.fromkeys(row["movie"] for row in rows)) == ["A1.tif", "A2", "C1.tif"]
    assert len({(row["movie"], row["metric"]) for row in rows}) == len(rows)
    amplitude, = (row for row in rows if (row["movie"], row["metric"]) == ("A1.tif", "amplitude_um"))
    single = {row["metric"]: row for row in table(ran[0].out / "results" / "A1.tif" / "summary.csv")}["amplitude_um"]
    assert all(amplitude[name] == single[name] for name in ("n", "mean", "se", "sd", "low_95", "high_95"))
    assert float(amplitude["mean"]) > 1


def test_an_index_leads_to_each_report(ran: tuple[Outcome, list[BatchEvent]]) -> None:
    page = (ran[0].out / "index.html").read_text(encoding="utf-8")
    assert 'href="results/A2/report.html"' in page
    assert 'href="results/B1.tif/report.html"' not in page
    assert 'Tables: <a href="movies.csv">movies.csv</a>, <a href="plate.csv">plate.csv</a></p>' in page
    assert "MovieUnreadable: " in page
    assert "6 movies: 0 pass, 2 review, 1 fail, 3 without a result." in page
    folder = ran[0].out / "results" / "A2"
    kept, made = read_overview(folder), summary_of_folder(folder)
    assert replace(kept, metrics={}) == replace(made, metrics={})
    assert kept.metrics == pytest.approx(made.metrics)


def test_events_tell_of_everything_in_order(ran: tuple[Outcome, list[BatchEvent]]) -> None:
    told = ran[1]
    assert told[0] == Planned(6, 0)
    assert isinstance(told[-1], Completed)
    assert (told[-1].movies, told[-1].passed + told[-1].review, told[-1].fail, told[-1].failed) == (6, 2, 1, 3)
    for movie in ("A1.tif", "A2"):
        mine = [event for event in told if getattr(event, "movie", "") == movie]
        assert isinstance(mine[0], Started)
        assert isinstance(mine[-1], Finished)
        shares = [event.share for event in mine[1:-1] if isinstance(event, Progressed)]
        assert shares == sorted(shares)
    assert sum(isinstance(event, Failed) for event in told) == 3


def test_the_same_line_again_measures_nothing_and_writes_the_same_bytes(
        ran: tuple[Outcome, list[BatchEvent]], plate: Path) -> None:
    before = contents(ran[0].out)
    again = run_batch(make_plan(plate, config=SETTINGS, pattern="{well}"), ran[0].out)
    assert again.unchanged == 6
    assert contents(again.out) == before


def test_a_changed_movie_setting_or_program_is_measured_again(
        ran: tuple[Outcome, list[BatchEvent]], plate: Path) -> None:
    out = ran[0].out
    plan = make_plan(plate, config=SETTINGS)
    task = plan.tasks[0]
    assert current(out, plan, task) is not None
    threads = SETTINGS.model_copy(update={"registration": SETTINGS.registration.model_copy(update={"threads": 5})})
    assert current(out, plan, make_plan(plate, config=threads).tasks[0]) is not None
    assert current(out, plan, make_plan(plate, config=Config(fps=30)).tasks[0]) is None
    assert current(out, plan, make_plan(plate, config=SETTINGS, report=False).tasks[0]) is None
    other = make_plan(plate, config=SETTINGS)
    object.__setattr__(other, "version", "0.0.1")
    assert current(out, other, task) is None
    was = task.path.stat().st_mtime_ns
    os.utime(task.path, ns=(was, was + 1))
    assert current(out, plan, task) is None
    os.utime(task.path, ns=(was, was))
    assert current(out, plan, task) is not None


def test_fingerprints_see_frames_and_masks(tmp_path: Path) -> None:
    (tmp_path / "m" / "movie").mkdir(parents=True)
    (tmp_path / "m" / "movie" / "1.tif").write_bytes(b"1")
    seen = [fingerprint(tmp_path / "m")]
    (tmp_path / "m" / "movie" / "2.tif").write_bytes(b"2")
    seen.append(fingerprint(tmp_path / "m"))
    (tmp_path / "m" / "masks").mkdir()
    (tmp_path / "m" / "masks" / "tissue_mask.txt").write_text("1")
    seen.append(fingerprint(tmp_path / "m"))
    (tmp_path / "m" / "movie" / "metadata.txt").touch()
    seen.append(fingerprint(tmp_path / "m"))
    (tmp_path / "m" / "notes.txt").touch()
    assert len(set(seen)) == 4
    assert fingerprint(tmp_path / "m") == seen[-1]
    assert fingerprint(tmp_path / "gone") == "missing"


# --- nothing is lost ------------------------------------------------------------------------------------------------


def children(pid: int) -> list[int]:
    """Processes that a process started; needs /proc."""
    tasks = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in tasks.read_text().split()] if tasks.exists() else []


def workers(pid: int) -> list[int]:
    return [child for child in children(pid)
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


linux = pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="looks for processes in /proc")


@pytest.fixture
def four(plate: Path, tmp_path: Path) -> Path:
    """A manifest of four movies, one of them empty."""
    folder = tmp_path / "movies"
    folder.mkdir()
    for name in ("M1", "M2", "M3"):
        (folder / f"{name}.tif").symlink_to(plate / "A1.tif")
    (folder / "M4.tif").symlink_to(plate / "B1.tif")
    manifest = folder / "plate.csv"
    manifest.write_text("movie,plate,dose\n" + "".join(f"M{n}.tif,P1,{n}\n" for n in (3, 1, 2, 4)))
    return manifest


def killing(at: str, times: int) -> Callable[[BatchEvent], None]:
    """Hear a run, and kill the worker when it has begun a movie, a number of times."""
    left = [times]

    def tell(event: BatchEvent) -> None:
        if isinstance(event, Progressed) and event.movie == at and left[0] > 0:
            left[0] -= 1
            for pid in workers(os.getpid()):
                os.kill(pid, signal.SIGKILL)

    return tell


@linux
def test_a_killed_worker_costs_nothing(four: Path, tmp_path: Path) -> None:
    plan = make_plan(four, config=SETTINGS, report=False)
    outcome = run_batch(plan, tmp_path / "out", workers=1, tell=killing("M1.tif", 1))
    assert [status.movie for status in outcome.failed] == ["M4.tif"]
    assert [row["movie"] for row in table(outcome.out / "movies.csv")] == ["M3.tif", "M1.tif", "M2.tif", "M4.tif"]
    assert [name for name in os.listdir(outcome.out / "results") if name.startswith(".")] == []


@linux
def test_a_movie_whose_worker_dies_twice_is_a_row_and_is_tried_again_later(four: Path, tmp_path: Path) -> None:
    plan = make_plan(four, config=SETTINGS, report=False)
    outcome = run_batch(plan, tmp_path / "out", workers=1, tell=killing("M1.tif", 2))
    assert {status.movie: status.kind for status in outcome.failed} == {"M1.tif": "WorkerDied",
                                                                        "M4.tif": "MovieUnreadable"}
    assert "was killed by SIGKILL, twice" in outcome.statuses["M1.tif"].message
    told: list[BatchEvent] = []
    outcome = run_batch(plan, tmp_path / "out", workers=1, tell=told.append)
    assert told[0] == Planned(4, 3)
    assert [status.movie for status in outcome.failed] == ["M4.tif"]


@linux
def test_a_run_that_is_killed_at_any_moment_goes_on_to_the_same_tables(four: Path, tmp_path: Path) -> None:
    line = [sys.executable, "-m", "microbundle", "batch", str(four), *FLAGS, "--workers", "2", "--quiet"]
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert subprocess.run([*line, "--out", str(whole)], check=False).returncode == 3
    events = tmp_path / "events"
    rng = np.random.default_rng()
    for event, delay_s in (("progressed", rng.uniform(0, 0.6)), ("finished", rng.uniform(0, 0.05))):
        events.unlink(missing_ok=True)
        run = subprocess.Popen([*line, "--out", str(killed), "--events", str(events)])
        end = time.monotonic() + 60
        while run.poll() is None and time.monotonic() < end:
            if events.exists() and f'"{event}"' in events.read_text():
                break
            time.sleep(0.01)
        time.sleep(delay_s)
        orphans = workers(run.pid)
        run.kill()
        run.wait()
        while any(Path(f"/proc/{pid}").exists() and workers_of_state(pid) for pid in orphans):
            assert time.monotonic() < end, "workers must end with their run"
            time.sleep(0.01)
    assert subprocess.run([*line, "--out", str(killed)], check=False).returncode == 3
    assert contents(killed) == contents(whole)
    assert sorted(os.listdir(killed / "results")) == ["M1.tif", "M2.tif", "M3.tif"]
    assert sorted(os.listdir(killed / "status")) == [f"M{n}.tif.json" for n in (1, 2, 3, 4)]


def workers_of_state(pid: int) -> bool:
    """Tell whether a process is alive, and no remains of one."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_half_done_work_is_cleared_away_and_a_result_stepped_aside_comes_back(
        ran: tuple[Outcome, list[BatchEvent]], plate: Path) -> None:
    results = ran[0].out / "results"
    (results / ".A9.partial-x").mkdir()
    (results / ".A9.partial-x" / "result.nc").touch()
    (ran[0].out / ".plate.csv.partial-y").touch()
    (results / ".A2.old-z").mkdir()
    (results / "A2").rename(results / ".A2.old-z" / "A2")
    again = run_batch(make_plan(plate, config=SETTINGS, pattern="{well}"), ran[0].out)
    assert again.unchanged == 6
    assert sorted(os.listdir(results)) == ["A1.tif", "A2", "C1.tif"]
    assert not (ran[0].out / ".plate.csv.partial-y").exists()


def test_a_full_disk_is_a_row_and_is_tried_again(four: Path, tmp_path: Path) -> None:
    plan = make_plan(four, config=SETTINGS, report=False)
    out = tmp_path / "out"
    (out / "results").mkdir(parents=True)
    (out / "status").mkdir()
    (out / "results" / "M1.tif").write_text("no folder can have this name")
    outcome = run_batch(plan, out, workers=2)
    assert {status.movie: status.kind for status in outcome.failed} == {"M1.tif": "OutputError",
                                                                        "M4.tif": "MovieUnreadable"}
    (out / "results" / "M1.tif").unlink()
    assert [status.movie for status in run_batch(plan, out, workers=1).failed] == ["M4.tif"]


def test_a_disk_that_fills_up_while_a_result_is_written_is_told_as_such(
        tissue_analysis: Analysis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise RuntimeError("file write failed: file descriptor = 6, errno = 28, error message = '...'")

    monkeypatch.setattr(xarray.Dataset, "to_netcdf", full)
    with pytest.raises(OutputError, match="No space left on device"):
        save(tissue_analysis, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_only_one_run_works_in_a_folder_and_never_in_another_kind(four: Path, tmp_path: Path) -> None:
    plan = make_plan(four)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.doc").touch()
    with pytest.raises(OutputError, match=r"it holds something else, such as thesis\.doc"):
        run_batch(plan, foreign)
    fcntl = pytest.importorskip("fcntl")
    (tmp_path / "out").mkdir()
    with (tmp_path / "out" / ".microbundle.lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(OutputError, match="no other run writes into"):
            run_batch(plan, tmp_path / "out")
    with pytest.raises(ConfigError, match="workers: expected 1 or more"):
        run_batch(plan, tmp_path / "out", workers=0)


# --- the command ----------------------------------------------------------------------------------------------------


def test_events_for_programs_and_the_exit_code(
        ran: tuple[Outcome, list[BatchEvent]], plate: Path, tmp_path: Path, capsys: Captured) -> None:
    line = ["batch", str(plate), "--out", str(ran[0].out), "--pattern", "{well}", *FLAGS[:-1]]
    assert cli.run([*line, "--json", "--events", str(tmp_path / "events")]) == 3
    out, _ = capsys.readouterr()
    told = [json.loads(text) for text in out.splitlines()]
    assert [event["event"] for event in told] == ["planned", "completed"]
    assert told[1]["failed"] == 3
    assert (tmp_path / "events").read_text() == out
    assert cli.run(line) == 3
    out, _ = capsys.readouterr()
    assert "6 movies: " in out
    assert "3 without a result; 6 of them unchanged since an earlier run" in out
    assert "B1.tif: MovieUnreadable: " in out


def test_a_person_sees_counts_and_what_is_being_measured() -> None:
    tally = Tally()
    screen = Screen(tally)
    for event in (Planned(20, 2), *(Started(f"plate/{n}.tif") for n in range(11)), Finished("plate/0.tif", "pass", 1.0),
                  Failed("plate/1.tif", "MovieUnreadable", ""), Progressed("plate/2.tif", "tracking", 0.5)):
        tally.tell(event)
    console = Console(width=80, file=io.StringIO())
    console.print(screen())
    console.file.flush()
    seen = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert seen[0].startswith("4/20 movies ")
    assert seen[1].strip() == "1 pass  1 without a result"
    assert [part for part in seen[2].split() if part[0].isalnum() or "/" in part] == ["plate/2.tif", "tracking"]
    assert seen[-1] == "  and 1 more"
    assert tally.done == 2.5
    tally.tell(Drawing(10, 3))
    tally.tell(Drawn("plate/2.tif", 1.0))
    console.print(screen())
    assert "pictures of 1/7 movies" in console.file.getvalue()  # type: ignore[attr-defined]


def test_a_dry_run_shows_the_plan_and_writes_nothing(
        ran: tuple[Outcome, list[BatchEvent]], plate: Path, tmp_path: Path, capsys: Captured) -> None:
    assert cli.run(["batch", str(plate), "--out", str(tmp_path / "o"), "--dry-run", "--pattern", "{well}"]) == 0
    out, _ = capsys.readouterr()
    assert "6 movies: 6 to do" in out
    assert list(tmp_path.iterdir()) == []
    line = ["batch", str(plate), "--out", str(ran[0].out), "--dry-run", "--json", *FLAGS[:-1]]
    assert cli.run(line) == 0
    states = {movie["movie"]: movie["state"] for movie in json.loads(capsys.readouterr()[0])["movies"]}
    assert states == {"A1.tif": "done", "A2": "done", "B1.tif": "failed", "B2": "failed", "C1.tif": "done",
                      "C2.tif": "failed"}
    assert cli.run([*line, "--retry-failed"]) == 0
    states = {movie["movie"]: movie["state"] for movie in json.loads(capsys.readouterr()[0])["movies"]}
    assert list(states.values()).count("to do") == 3


def test_ten_thousand_movies_are_planned_and_resumed_in_ten_seconds(tmp_path: Path) -> None:
    from microbundle.batch.state import Status, run_folder, write_status

    source, count = tmp_path / "plates", 10_000
    for p in range(count // 100):
        (source / f"P{p}").mkdir(parents=True)
        for w in range(100):
            (source / f"P{p}" / f"{'ABCD'[w // 25]}{w % 25 + 1}_cam.tif" if w % 2 else
             source / f"P{p}" / f"{'ABCD'[w // 25]}{w % 25 + 1}.tif").touch()
    start = time.perf_counter()
    plan = make_plan(source, pattern="{plate}/{well}*")
    planned_s = time.perf_counter() - start
    assert len(plan.tasks) == count
    assert plan.tasks[-1].columns == {"plate": "P99", "well": "D25"}
    with run_folder(tmp_path / "out") as out:
        for task in plan.tasks:
            write_status(out, task.key, Status(task.movie, "failed", fingerprint(task.path), task.settings,
                                               plan.version, kind="MovieUnreadable", message="empty"))
    start = time.perf_counter()
    outcome = run_batch(plan, out)
    resumed_s = time.perf_counter() - start
    assert outcome.unchanged == count
    assert planned_s + resumed_s < 10


@pytest.mark.skipif(importlib.util.find_spec("pyarrow") is None, reason="pyarrow is not installed")
def test_parquet_holds_the_same_table(ran: tuple[Outcome, list[BatchEvent]]) -> None:
    import pyarrow.parquet

    read = pyarrow.parquet.read_table(ran[0].out / "plate.parquet")
    rows = table(ran[0].out / "plate.csv")
    assert read.num_rows == len(rows)
    assert read["well"].to_pylist() == [row["well"] for row in rows]
    assert read["mean"].to_pylist() == [float(row["mean"]) if row["mean"] else None for row in rows]
