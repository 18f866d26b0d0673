"""Runs in real processes: queue, cancel, a server that is killed and started again, a killed process, a full disk."""

from __future__ import annotations

import csv
import io
import json
import os
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import tifffile
from starlette.testclient import TestClient

from microbundle.config import Config
from microbundle.web.process import Ending, ending
from microbundle.web.progress import Progress
from microbundle.web.records import Home, Record, toml

from .conftest import Image, Opened, Server, ended, run_of, said, until

Measured = tuple[TestClient, str]
Serve = Callable[..., Server]


def test_a_run_is_a_batch_run_of_the_command_line(measured: Measured) -> None:
    client, id = measured
    view = said(client.get(f"/api/runs/{id}"))
    states = {one["movie"]: (one["state"], one["verdict"], one["kind"]) for one in view["movies"]}
    assert states == {"P_A1.tif": ("done", states["P_A1.tif"][1], ""), "P_B2": ("done", states["P_B2"][1], ""),
                      "P_B3.tif": ("failed", "", "MovieUnreadable")}
    assert (view["progress"]["done"], view["progress"]["failed"], view["progress"]["share"]) == (2, 1, 1.0)
    assert view["columns"] == ["plate", "well"]
    out = client.desk.workspace / "runs" / id  # type: ignore[attr-defined]
    with (out / "movies.csv").open(newline="") as stream:
        rows = {row["movie"]: row for row in csv.DictReader(stream)}
    movie = next(one for one in view["movies"] if one["movie"] == "P_B2")
    assert movie["metrics"]["amplitude_um"] == pytest.approx(float(rows["P_B2"]["amplitude_um"]))
    assert {one["column"] for one in view["metrics"]} <= {name for one in view["movies"] for name in one["metrics"]}
    assert "amplitude_px" not in {one["column"] for one in view["metrics"]}
    assert all(one["tip"] and one["label"] for one in view["metrics"])


def test_the_shown_command_makes_the_same_again(measured: Measured) -> None:
    client, id = measured
    words = shlex.split(said(client.get(f"/api/runs/{id}"))["command"])
    assert words[:2] == ["microbundle", "batch"]
    told = subprocess.run([sys.executable, "-m", *words, "--dry-run", "--json"], capture_output=True, text=True,
                          check=True).stdout
    assert {one["state"] for one in json.loads(told)["movies"]} == {"done", "failed"}


def test_everything_comes_as_one_archive(measured: Measured) -> None:
    client, id = measured
    for movies, there in (("all", True), ("P_A1.tif", False)):
        answer = client.get(f"/api/runs/{id}/zip", params={"movies": movies})
        assert answer.headers["content-disposition"] == f'attachment; filename="{id}.zip"'
        with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
            assert archive.testzip() is None
            names = archive.namelist()
            assert f"microbundle batch {client.desk.runs.get(id).source}" in (  # type: ignore[attr-defined]
                archive.read(f"{id}/command.txt").decode())
            assert archive.read(f"{id}/results/P_A1.tif/summary.csv") == client.get(
                f"/api/runs/{id}/files/results/P_A1.tif/summary.csv").content
        assert {f"{id}/plate.csv", f"{id}/results/P_A1.tif/report.html"} <= set(names)
        assert (f"{id}/results/P_B2/report.html" in names) is there
        assert not [name for name in names if "/." in name or ".." in name]
    assert client.get(f"/api/runs/{id}/zip?movies=nothing").status_code == 404


@pytest.mark.parametrize("path", ["../RUN.json", "results/../../RUN.json", "%2e%2e/RUN.json", ".microbundle.lock",
                                  "results/.hidden", "results", "nothing", "..%5cRUN.json", "results//x", ""])
def test_only_files_of_the_run_are_given_away(measured: Measured, path: str) -> None:
    client, id = measured
    assert client.get(f"/api/runs/{id}/files/{path.replace('RUN', id)}").status_code in (403, 404)


def test_files_are_saved_and_never_run(measured: Measured) -> None:
    client, id = measured
    answer = client.get(f"/api/runs/{id}/files/results/P_A1.tif/report.html?inline=1")
    assert answer.headers["content-disposition"].startswith("attachment")
    assert answer.headers["content-security-policy"].startswith("sandbox; default-src 'none'")
    link = client.desk.workspace / "runs" / id / "link.csv"  # type: ignore[attr-defined]
    link.symlink_to("/etc/passwd")
    try:
        assert client.get(f"/api/runs/{id}/files/link.csv").status_code == 404
        with zipfile.ZipFile(io.BytesIO(client.get(f"/api/runs/{id}/zip").content)) as archive:
            assert f"{id}/link.csv" not in archive.namelist()
    finally:
        link.unlink()


def test_wells_stand_where_they_are_on_the_plate(measured: Measured) -> None:
    client, id = measured
    plate, = said(client.get(f"/api/runs/{id}/plate"))["plates"]
    assert (plate["name"], plate["rows"], plate["cols"]) == ("P", 2, 3)
    assert [(one["well"], one["row"], one["col"]) for one in plate["wells"]] == [("A1", 0, 0), ("B2", 1, 1),
                                                                               ("B3", 1, 2)]


# --- settings and drafts --------------------------------------------------------------------------------------------


def test_settings_are_checked_and_reach_the_run_as_they_are(open_app: Opened, movies: Path) -> None:
    client = open_app(movies)
    id = said(client.post("/api/open", json={"at": "plate1"}))["run"]
    assert said(client.post("/api/open", json={"at": "plate1"}))["run"] == id
    assert said(client.post("/api/open", json={"at": "plate1", "new": True}))["run"] != id
    for wrong, kind in (({"settings": {"fps": -1}}, "ConfigError"), ({"settings": {"nothing": 1}}, "ConfigError"),
                        ({"pattern": "("}, "ConfigError"), ({"pattern": "{well}_x"}, "ConfigError")):
        answer = client.patch(f"/api/runs/{id}", json=wrong)
        assert (answer.status_code, answer.json()["error"]["kind"]) == (422, kind)
    for wrong in ({"id": "x"}, {"settings": []}, {"title": 3}, {"source": "/etc"}, {"state": "done"}):
        assert client.patch(f"/api/runs/{id}", json=wrong).status_code == 400
    assert said(client.get(f"/api/runs/{id}"))["settings"] == {}


def test_settings_as_toml_are_read_back_the_same() -> None:
    settings = {"fps": 30, "um_per_px": 0.5, "method": "fast",
                "strain": {"tiles": [2, 5], "extents_px": [1, 2.5, 3, 4.5]},
                "reading": {"kernel": [[0, 1, 0]], "drop_flashes": True},
                "pillars": {"unloaded_px": [[1, 2], [3, 4]]}}
    assert tomllib.loads(toml(settings)) == settings
    assert Config.from_dict(tomllib.loads(toml(settings))) == Config.from_dict(settings)


def test_what_the_files_do_not_say_is_counted(open_app: Opened, movies: Path) -> None:
    client = open_app(movies)
    id = said(client.post("/api/open", json={"at": "plate1"}))["run"]
    found = until(lambda: said(client.get(f"/api/runs/{id}"))["missing"])
    assert found == {"fps": 2, "um_per_px": 2}
    said(client.patch(f"/api/runs/{id}", json={"settings": {"fps": 30}}))
    assert until(lambda: said(client.get(f"/api/runs/{id}"))["missing"]) == {"fps": 0, "um_per_px": 2}


def test_a_source_that_is_gone_is_told_and_results_stay(open_app: Opened, small: Image, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    tifffile.imwrite(tmp_path / "data" / "one.tif", small)
    client = open_app(tmp_path / "data")
    id = run_of(client, "data/one.tif")
    (tmp_path / "data" / "one.tif").unlink()
    client.desk.runs._plans.clear()  # type: ignore[attr-defined]
    view = said(client.get(f"/api/runs/{id}"))
    assert ("there is no such file" in view["message"], view["movies"]) == (True, [])
    assert client.post(f"/api/runs/{id}/start", json={}).status_code == 422


# --- how a process ends ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("code", "completed", "cancelled", "said", "state", "message"), [
    (0, True, False, "", "done", ""), (3, True, False, "", "done", ""), (None, True, False, "", "done", ""),
    (0, True, True, "", "done", ""), (130, False, True, "error: interrupted; 1 of 2 are kept", "stopped", "Cancelled"),
    (130, False, False, "error: interrupted", "stopped", "Interrupted from outside"),
    (-9, False, False, "", "stopped", "killed by SIGKILL"), (None, False, False, "", "stopped", "without a word"),
    (6, False, False, "x\nerror: /out: No space left", "failed", "/out: No space left"),
    (1, False, False, "Traceback\n  File\nKeyError: 'x'", "failed", "the program failed: KeyError: 'x'")])
def test_how_a_process_ended_is_told(tmp_path: Path, code: int | None, completed: bool, cancelled: bool, said: str,
                                     state: str, message: str) -> None:
    home = Home(tmp_path, "r")
    home.log.write_text(f"error: of an earlier process\n{said}\n")
    record = Record("r", "", "", "", cancelled=cancelled, log_from=len("error: of an earlier process\n"))
    found = ending(home, record, code, completed)
    assert isinstance(found, Ending)
    assert found.state == state
    assert message in found.message


def test_progress_is_read_piece_by_piece_and_survives_a_cut_line(tmp_path: Path) -> None:
    file = tmp_path / "events"
    at = '"at": "2026-01-01T00:00:0{}+00:00"'
    file.write_text(f'{{"event": "planned", "movies": 3, "unchanged": 1, {at.format(0)}}}\n{{"event": "star')
    progress = Progress(file, 0)
    progress.update()
    assert (progress.total, progress.movies, progress.share) == (3, {}, pytest.approx(1 / 3))
    with file.open("a") as stream:
        stream.write(f'ted", "movie": "a", {at.format(1)}}}\nnonsense\n{{"event": "progressed", "movie": "a", '
                     f'"stage": "tracking", "share": 0.5, {at.format(2)}}}\n')
    progress.update()
    assert (progress.movies["a"].stage, progress.share) == ("tracking", 0.5)
    assert progress.first is not None
    assert progress.seconds_left(progress.first.replace(second=4)) == pytest.approx(3 * 0.75 / 0.25)


# --- processes ------------------------------------------------------------------------------------------------------


@pytest.fixture
def slow(small: Image, tmp_path: Path) -> Path:
    """A folder with movies that take some seconds."""
    folder = tmp_path / "slow"
    folder.mkdir()
    for i in range(2):
        tifffile.imwrite(folder / f"M{i}.tif", small)
    return folder


def measuring(client: Any, id: str) -> dict[str, Any] | None:
    """The run, once a movie of it is being measured."""
    view = said(client.get(f"/api/runs/{id}"))
    assert view["state"] in ("queued", "running"), view["message"]
    return view if any(one["state"] == "running" for one in view["movies"]) else None


def test_runs_wait_for_their_turn_can_leave_the_queue_and_stop(open_app: Opened, slow: Path, tmp_path: Path) -> None:
    client = open_app(slow)
    first, second = run_of(client, "slow"), run_of(client, "slow/M1.tif")
    third = said(client.post("/api/open", json={"at": "slow", "new": True}))["run"]
    for id in (first, second, third):
        said(client.post(f"/api/runs/{id}/start", json={}))
    assert [said(client.get(f"/api/runs/{id}"))["state"] for id in (first, second, third)] == ["running", "queued",
                                                                                            "queued"]
    for method, path, body in (("POST", "start", {}), ("PATCH", "", {"settings": {}}), ("DELETE", "", None)):
        answer = client.request(method, f"/api/runs/{first}/{path}".rstrip("/"), json=body)
        assert (answer.status_code, answer.json()["error"]["kind"]) == (409, "Busy")
    assert said(client.post(f"/api/runs/{third}/cancel", json={}))["state"] == "draft"
    until(lambda: measuring(client, first))
    said(client.post(f"/api/runs/{first}/cancel", json={}))
    view = ended(client, first)
    assert (view["state"], view["message"][:9]) == ("stopped", "Cancelled")
    assert ended(client, second)["state"] == "done"
    assert client.post(f"/api/runs/{second}/cancel", json={}).status_code == 409
    said(client.delete(f"/api/runs/{second}"))
    assert client.get(f"/api/runs/{second}").status_code == 404
    kept, = (tmp_path / "workspace" / "trash").iterdir()
    assert (kept / second / "results" / "M1.tif" / "result.nc").is_file()
    assert (slow / "M1.tif").is_file()


def test_a_run_outlives_its_server_and_goes_on_after_it_was_killed(serve: Serve, slow: Path, tmp_path: Path) -> None:
    for i in range(2, 6):
        shutil.copy(slow / "M0.tif", slow / f"M{i}.tif")
    server = serve(slow, tmp_path / "ws")
    client, record = server.client, tmp_path / "ws" / "runs"
    id, waiting = run_of(client, "slow"), run_of(client, "slow/M1.tif")
    said(client.post(f"/api/runs/{id}/start", json={}))
    said(client.post(f"/api/runs/{waiting}/start", json={}))
    until(lambda: said(client.get(f"/api/runs/{id}"))["progress"]["done"] >= 1)
    pid = json.loads((record / f"{id}.json").read_text())["pid"]
    os.killpg(pid, signal.SIGSTOP)  # so that it is not done before the next server looks
    server.stop(signal.SIGKILL)

    again = serve(slow, tmp_path / "ws")
    client = again.client
    assert again.kept == server.kept  # the page that is still open finds it at the same address, with its own cookie
    states = {one["id"]: one["state"] for one in said(client.get("/api/runs"))["runs"]}
    assert states == {id: "running", waiting: "queued"}
    said(client.post(f"/api/runs/{waiting}/cancel", json={}))

    os.killpg(pid, signal.SIGKILL)
    view = ended(client, id)
    assert (view["state"], "Continue goes on from there" in view["message"]) == ("stopped", True)
    before = view["progress"]["done"]
    assert 1 <= before < 6
    said(client.post(f"/api/runs/{id}/start", json={}))
    view = ended(client, id)
    assert (view["state"], view["progress"]["done"]) == ("done", 6)
    events = (record / f"{id}.events.jsonl").read_text().splitlines()
    first, second = (json.loads(line)["unchanged"] for line in events if '"planned"' in line)
    assert first == 0
    assert before <= second < 6  # a movie may be done whose event was not written any more
    assert again.stop() == 0


def test_a_process_of_another_program_is_never_taken_for_a_run(open_app: Opened, movies: Path) -> None:
    client = open_app(movies)
    id = run_of(client, "plate1")
    runs = client.desk.runs  # type: ignore[attr-defined]
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    try:
        from dataclasses import replace

        with runs._lock:
            runs._keep(replace(runs.get(id), state="running", pid=other.pid))
        view = ended(client, id)
        assert view["state"] == "stopped"
        assert other.poll() is None
    finally:
        other.kill()
        other.wait()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of little room of its own, where this system lets us make one."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if shutil.which("mount") is None or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", disk], capture_output=True, check=False).returncode:
        pytest.skip("no small disk can be made: that takes the rights of an administrator")
    yield disk
    subprocess.run(["umount", "-l", disk], check=True)


def test_a_full_disk_is_told_and_takes_nothing_with_it(serve: Serve, slow: Path, small_disk: Path) -> None:
    server = serve(slow, small_disk / "ws")
    client = server.client
    id = run_of(client, "slow/M0.tif")
    said(client.post(f"/api/runs/{id}/start", json={}))
    view = ended(client, id)
    assert [(one["state"], one["kind"]) for one in view["movies"]] == [("failed", "OutputError")]
    assert "No space left on device" in view["movies"][0]["message"]
    dropped = client.post("/api/uploads", files=[("files", ("big.tif", b"x" * 900_000))])
    assert (dropped.status_code, dropped.json()["error"]["kind"]) == (507, "OutputError")

    (small_disk / "filler").write_bytes(b"")
    with (small_disk / "filler").open("ab", buffering=0) as stream, suppress(OSError):
        while True:
            stream.write(b"x" * 4096)
    answer = client.patch(f"/api/runs/{id}", json={"title": "Another name"})
    assert (answer.status_code, answer.json()["error"]["kind"]) == (507, "DiskFull")
    view = said(client.get(f"/api/runs/{id}"))
    assert (view["state"], view["title"]) == ("done", "M0.tif")
    assert client.post(f"/api/runs/{id}/start", json={}).status_code == 507
    (small_disk / "filler").unlink()
    assert said(client.patch(f"/api/runs/{id}", json={"title": "Another name"}))["title"] == "Another name"


def test_an_upload_that_finds_no_room_leaves_nothing(serve: Serve, slow: Path, tmp_path: Path) -> None:
    def little_room() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    client = serve(slow, tmp_path / "ws", limit=little_room).client
    dropped = client.post("/api/uploads", files=[("files", ("big.tif", b"x" * 100_000))])
    assert (dropped.status_code, dropped.json()["error"]["kind"]) == (507, "OutputError")
    assert "File too large" in dropped.json()["error"]["message"]
    assert not list((tmp_path / "ws" / "uploads").iterdir())


def test_the_example_is_rendered_once_and_opens(open_app: Opened, movies: Path) -> None:
    client = open_app(movies)
    assert client.post("/api/example", json={"wells": 7}).status_code == 400
    id = said(client.post("/api/example", json={"wells": 6}))["run"]
    assert said(client.post("/api/example", json={"wells": 6}))["run"] == id
    view = ended(client, id)
    assert (view["state"], len(view["movies"])) == ("draft", 6)
    plate, = said(client.get(f"/api/runs/{id}/plate"))["plates"]
    assert len(plate["wells"]) == 6
    assert {"group", "dose_um", "fps", "um_per_px"} <= set(view["columns"])
    assert until(lambda: said(client.get(f"/api/runs/{id}"))["missing"]) == {"fps": 0, "um_per_px": 0}
    said(client.patch(f"/api/runs/{id}", json={"figures": True, "movies": True, "excel": True}))
    assert said(client.get(f"/api/runs/{id}"))["command"].endswith(" --figures --movies --excel")


# --- runs that a terminal began -------------------------------------------------------------------------------------


@pytest.fixture
def written(measured: Measured, movies: Path, tmp_path: Path) -> Path:
    """A folder with the movies, and beside them what microbundle batch wrote of them in a terminal."""
    client, id = measured
    home = tmp_path / "lab"
    shutil.copytree(movies, home / "plate1")  # keeps the times, by which a run knows its movies
    (home / "settings.toml").write_text(toml(client.desk.runs.get(id).settings))  # type: ignore[attr-defined]
    shutil.copytree(client.desk.workspace / "runs" / id, home / "results")  # type: ignore[attr-defined]
    subprocess.run([sys.executable, "-m", "microbundle", "batch", home / "plate1", "--config", home / "settings.toml",
                    "--pattern", "{plate}_{well}", "--out", home / "results", "--quiet"], check=False)
    return home


def test_a_run_of_the_terminal_opens_is_judged_and_goes_on(open_app: Opened, written: Path) -> None:
    client = open_app(written)
    assert {one["name"]: one["kind"] for one in said(client.get("/api/browse?at=lab"))["entries"]} == {
        "plate1": "folder", "results": "batch"}
    id = said(client.post("/api/open", json={"at": "lab/results"}))["run"]
    assert said(client.post("/api/open", json={"at": "lab/results"}))["run"] == id
    view = said(client.get(f"/api/runs/{id}"))
    assert (view["state"], view["settings"]["fps"], view["pattern"]) == ("done", 30, "{plate}_{well}")
    assert [(one["movie"], one["state"], one["stale"]) for one in view["movies"]] == [
        ("P_A1.tif", "done", False), ("P_B2", "done", False), ("P_B3.tif", "failed", False)]
    assert said(client.get(f"/api/runs/{id}/movies/P_A1.tif/traces"))
    judged = [{"kind": "verdict", "accept": False}]
    said(client.put(f"/api/runs/{id}/movies/P_B2/decisions", json={"decisions": judged}))
    assert (written / "results/results/P_B2.decisions.json").is_file()
    before = (written / "results/results/P_A1.tif/summary.csv").stat()
    said(client.post(f"/api/runs/{id}/start", json={}))
    assert ended(client, id)["state"] == "done"
    rows = {one["movie"]: one for one in said(client.get(f"/api/runs/{id}"))["movies"]}
    assert (rows["P_B2"]["verdict"], rows["P_B2"]["stale"]) == ("fail", False)
    assert (written / "results/results/P_A1.tif/summary.csv").stat().st_mtime_ns == before.st_mtime_ns
    said(client.delete(f"/api/runs/{id}"))
    assert (written / "results/movies.csv").is_file()
    assert said(client.get("/api/runs"))["runs"] == []


def test_a_run_whose_movies_are_elsewhere_is_still_looked_at(open_app: Opened, written: Path) -> None:
    client = open_app(written / "results")
    id = said(client.post("/api/open", json={"at": "results"}))["run"]
    view = said(client.get(f"/api/runs/{id}"))
    assert [one["state"] for one in view["movies"]] == ["done", "done", "failed"]
    assert "leads out of the folders" in view["message"]
    assert said(client.get(f"/api/runs/{id}/movies/P_A1.tif/traces"))
    assert client.get(f"/api/runs/{id}/movies/P_A1.tif/frame?t=0").status_code == 403
    assert client.post(f"/api/runs/{id}/start", json={}).status_code == 403


def test_folders_that_are_no_such_run_are_refused(open_app: Opened, written: Path, tmp_path: Path) -> None:
    client = open_app(written)
    answer = client.post("/api/open", json={"at": "lab/results/results/P_B2"})
    assert (answer.status_code, "result of one movie" in answer.text) == (400, True)
    (tmp_path / "secret").mkdir()
    link = written / "results" / "results" / "linked"
    link.symlink_to(tmp_path / "secret")
    assert client.post("/api/open", json={"at": "lab/results"}).status_code == 403
    link.unlink()
    for damage in ("", "[]", '{"source": 3}', '{"source": "x", "wells": "7"}',
                   '{"source": "x", "settings": {"nothing": 1}}'):
        (written / "results" / "run.json").write_text(damage)
        answer = client.post("/api/open", json={"at": "lab/results"})
        assert (answer.status_code, answer.json()["error"]["kind"]) == (422, "ResultUnreadable")
