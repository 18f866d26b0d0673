"""Single movies in the app: frames, masks, decisions of two windows, results, clicks, blind review, settings."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from starlette.testclient import TestClient

from microbundle.config import Config
from microbundle.decisions import read_decisions
from microbundle.mask import find_masks, overlap
from microbundle.mask_files import polygon_mask
from microbundle.read import read_movie
from microbundle.store import load
from microbundle.strain import measure_strain
from microbundle.web import frames
from microbundle.web.frames import Movies, timing
from microbundle.web.settings import sections

from .conftest import Image, Opened, mask_png, run_of, said

Measured = tuple[TestClient, str]
A1 = "/api/runs/{}/movies/P_A1.tif"


@pytest.fixture
def fresh(open_app: Opened, movies: Path) -> Measured:
    """A run that was not started."""
    client = open_app(movies)
    return client, run_of(client, "plate1")


def picture(answer: Any) -> Image:
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "image/jpeg"
    return cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_GRAYSCALE)


def drawn(png: str) -> Image:
    data = base64.b64decode(png.removeprefix("data:image/png;base64,"))
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) > 0


# --- frames ---------------------------------------------------------------------------------------------------------


def test_frames_are_those_of_the_movie_with_limits_that_stay(fresh: Measured, small: Image) -> None:
    client, id = fresh
    room = A1.format(id)
    about = said(client.get(room))
    assert (about["info"]["frames"], about["info"]["rows"], about["info"]["cols"]) == small.shape
    assert (about["info"]["frames_per_s"], about["info"]["time_source"]) == (pytest.approx(30), "user")
    assert (about["previous"], about["next"], about["missing"]) == (None, "P_B2", [])
    grey = said(client.get(f"{room}/grey"))
    assert grey["min"] <= grey["low"] < grey["high"] <= grey["max"]
    assert sum(grey["histogram"]) > 0
    for t in (0, 9, 39):
        expected = 255 * np.clip((small[t] - grey["low"]) / (grey["high"] - grey["low"]), 0, 1)
        assert np.abs(picture(client.get(f"{room}/frame?t={t}")) - expected).mean() < 4
    assert about["info"]["time_s"] is None
    dark = picture(client.get(f"{room}/frame?t=0&low=0&high=1000000"))
    assert dark.max() < 30
    assert picture(client.get(f"{room}/frame?t=0&width=64")).shape == (round(88 * 64 / 192), 64)


def test_frames_that_are_not_evenly_spaced_have_their_own_times() -> None:
    assert timing(None) == {"frames_per_s": None, "time_s": None}
    assert timing(2 + np.arange(9) / 30) == {"frames_per_s": pytest.approx(30), "time_s": None}
    assert timing(np.array([1.0, 1.1, 1.2, 1.35])) == {"frames_per_s": pytest.approx(10), "time_s": [0, 0.1, 0.2, 0.35]}


def test_a_frame_is_sent_once(fresh: Measured) -> None:
    client, id = fresh
    address = f"{A1.format(id)}/frame?t=3"
    tag = client.get(address).headers["etag"]
    again = client.get(address, headers={"if-none-match": tag})
    assert (again.status_code, again.content) == (304, b"")
    assert client.get(f"{A1.format(id)}/frame?t=4").headers["etag"] != tag


@pytest.mark.parametrize(("query", "status"), [
    ("t=-1", 404), ("t=40", 404), ("t=x", 400), ("t=1e400", 400), ("t=0&low=nan", 400), ("t=0&high=inf", 400),
    ("t=0&width=999999999", 200), ("t=0&width=-5", 200), ("t=0&low=5&high=5", 200), ("t=99999999999999999999", 400)])
def test_frames_that_are_not_there_are_refused(fresh: Measured, query: str, status: int) -> None:
    client, id = fresh
    assert client.get(f"{A1.format(id)}/frame?{query}").status_code == status


def test_a_movie_that_cannot_be_opened_is_told(fresh: Measured) -> None:
    client, id = fresh
    about = said(client.get(f"/api/runs/{id}/movies/P_B3.tif"))
    assert (about["info"], about["problem"]["kind"]) == (None, "MovieUnreadable")
    assert client.get(f"/api/runs/{id}/movies/P_B3.tif/frame?t=0").json()["error"]["kind"] == "MovieUnreadable"
    assert client.get(f"/api/runs/{id}/movies/nothing").status_code == 404


def test_pictures_and_open_movies_are_bounded(movies: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, config = Movies(), Config()
    one = len(kept.picture(kept.open(movies / "P_A1.tif", config), 0))
    monkeypatch.setattr(frames, "MOST_BYTES", 5 * one)
    for t in range(40):
        kept.picture(kept.open(movies / "P_A1.tif", config), t)
    assert kept._bytes == sum(map(len, kept._pictures.values())) <= 5 * one
    for fps in range(1, 10):
        kept.open(movies / "P_A1.tif", Config(fps=fps))
    assert len(kept._open) == frames.MOST_OPEN


def test_a_movie_that_changed_is_opened_again(open_app: Opened, small: Image, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    tifffile.imwrite(tmp_path / "data" / "M.tif", small[:5])
    client = open_app(tmp_path / "data")
    room = f"/api/runs/{run_of(client, 'data')}/movies/M.tif"
    before = picture(client.get(f"{room}/frame?t=0"))
    tifffile.imwrite(tmp_path / "data" / "M.tif", small[:9, ::-1])
    assert said(client.get(room))["info"]["frames"] == 9
    assert np.abs(picture(client.get(f"{room}/frame?t=0"))[::-1].astype(float) - before).mean() < 6


# --- masks ----------------------------------------------------------------------------------------------------------


def test_the_mask_of_the_page_is_that_of_the_analysis(fresh: Measured, movies: Path) -> None:
    client, id = fresh
    movie = read_movie(movies / "P_A1.tif")
    expected = find_masks(movie, Config().mask)
    found = said(client.post(f"{A1.format(id)}/masks", json={}))
    assert (drawn(found["tissue_png"]) == expected.tissue).all()
    assert found["axis"]["angle_deg"] == pytest.approx(expected.axis.angle_deg)
    assert (found["method"], found["stability"]) == (expected.method, pytest.approx(expected.stability))
    outline = np.array(found["tissue"][0], float)
    filled = polygon_mask(outline, movie.shape)
    for hole in found["holes"]:
        filled &= ~polygon_mask(np.array(hole, float), movie.shape)
    assert overlap(filled, expected.tissue) > 0.95
    assert said(client.post(f"{A1.format(id)}/masks", json={"method": "otsu", "frame": 3}))["method"] == "otsu"


def test_a_drawn_mask_is_measured_and_saved_for_the_command_line(fresh: Measured, small: Image) -> None:
    client, id = fresh
    mask = np.zeros(small.shape[1:], bool)
    mask[30:60, 40:150] = True
    found = said(client.post(f"{A1.format(id)}/masks", json={"tissue_png": mask_png(mask), "pillar_pngs": {}}))
    assert found["tissue_png"] == mask_png(mask)
    assert (found["method"], found["pillars"], found["axis"]["length_px"]) == ("supplied", [], 110)
    boxes = np.array(found["tiles"])
    again = said(client.post(f"{A1.format(id)}/masks", json={
        "tissue_png": mask_png(mask), "pillar_pngs": {}, "strain": {"extents_px": found["extents_px"]}}))
    assert np.allclose(again["tiles"], boxes, atol=0.01)

    kept = said(client.put(f"{A1.format(id)}/decisions", json={
        "decisions": [{"kind": "use_mask", "name": "tissue", "by": "AB"}], "masks": {"tissue": mask_png(mask)},
        "version": "none"}))
    file = kept["decisions"][0]["file"]
    result = client.desk.workspace / "runs" / id / "results" / "P_A1.tif"  # type: ignore[attr-defined]
    assert read_decisions(result).masks == {"tissue": result.parent / file}
    assert cv2.imread(str(result.parent / file), cv2.IMREAD_UNCHANGED).shape == small.shape[1:]
    for address in (f"{A1.format(id)}/masks/tissue", f"/api/runs/{id}/files/results/{file}"):
        content = client.get(address).content
        assert (cv2.imdecode(np.frombuffer(content, np.uint8), 0) > 0).tolist() == mask.tolist()
    assert client.get(f"{A1.format(id)}/masks/pillar_1").status_code == 404


def test_a_mask_drawn_on_a_cropped_frame_is_kept_in_the_size_of_the_file(fresh: Measured, small: Image) -> None:
    client, id = fresh
    said(client.patch(f"/api/runs/{id}", json={"settings": {"reading": {"crop_px": [10, 80, 20, 180]}}}))
    assert said(client.get(A1.format(id)))["info"]["rows"] == 70
    assert picture(client.get(f"{A1.format(id)}/frame?t=0")).shape == (70, 160)
    mask = np.zeros((70, 160), bool)
    mask[20:50, 20:130] = True
    kept = said(client.put(f"{A1.format(id)}/decisions", json={
        "decisions": [{"kind": "use_mask", "name": "tissue"}], "masks": {"tissue": mask_png(mask)}}))
    result = client.desk.workspace / "runs" / id / "results"  # type: ignore[attr-defined]
    whole = cv2.imread(str(result / kept["decisions"][0]["file"]), 0) > 0
    assert whole.shape == small.shape[1:]
    assert (whole[10:80, 20:180] == mask).all()
    assert whole.sum() == mask.sum()
    shown = client.get(f"{A1.format(id)}/masks/tissue").content
    assert (cv2.imdecode(np.frombuffer(shown, np.uint8), 0) > 0).tolist() == mask.tolist()


def test_what_cannot_be_found_is_told_and_a_person_can_go_on(open_app: Opened, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    tifffile.imwrite(tmp_path / "data" / "blank.tif", np.full((5, 64, 96), 7, "u2"))
    client = open_app(tmp_path / "data")
    room = f"/api/runs/{run_of(client, 'data')}/movies/blank.tif"
    found = said(client.post(f"{room}/masks", json={}))
    assert (found["tissue"], found["verdict"], found["findings"][0]["key"]) == ([], "fail", "no_tissue")
    mask = np.zeros((64, 96), bool)
    mask[30:34, 40:50] = True
    found = said(client.post(f"{room}/masks", json={"tissue_png": mask_png(mask), "pillar_pngs": {}}))
    assert (len(found["tissue"]), found["tiles"], found["findings"][-1]["key"]) == (1, [], "no_strain")
    empty = said(client.post(f"{room}/masks", json={"tissue_png": mask_png(mask & False)}))
    assert empty["findings"][0]["key"] == "mask_unusable"
    assert picture(client.get(f"{room}/frame?t=0")).shape == (64, 96)


def bomb(rows: int, cols: int) -> str:
    """A small PNG that says it is huge."""
    def piece(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 0)
    pieces = piece(b"IHDR", head) + piece(b"IDAT", zlib.compress(b"\0" * 1000)) + piece(b"IEND", b"")
    return "data:image/png;base64," + base64.b64encode(b"\x89PNG\r\n\x1a\n" + pieces).decode()


@pytest.mark.parametrize("png", [bomb(50_000, 50_000), bomb(10, 10), "nonsense", "data:image/png;base64,AAAA", 7, [],
                                 "data:image/svg+xml;base64,PHN2Zz4=", ""])
def test_pictures_that_are_no_masks_are_refused_before_they_are_unpacked(fresh: Measured, png: Any) -> None:
    client, id = fresh
    for answer in (client.post(f"{A1.format(id)}/masks", json={"tissue_png": png}),
                   client.put(f"{A1.format(id)}/decisions", json={
                       "decisions": [{"kind": "use_mask", "name": "tissue"}], "masks": {"tissue": png}})):
        assert answer.status_code in (400, 422)
    assert said(client.get(A1.format(id)))["decisions"] == []


@pytest.mark.parametrize("asked", [{"method": "magic"}, {"strain": []}, {"strain": {"tiles": [0, 0]}}, {"frame": -1},
                                   {"pillar_pngs": {"../x": ""}}, {"axis_deg": "north"}])
def test_wrong_questions_about_masks_are_refused(fresh: Measured, asked: dict[str, Any]) -> None:
    client, id = fresh
    assert client.post(f"{A1.format(id)}/masks", json=asked).status_code in (400, 422)


# --- decisions ------------------------------------------------------------------------------------------------------


def test_two_windows_do_not_undo_each_other(fresh: Measured) -> None:
    client, id = fresh
    room = f"{A1.format(id)}/decisions"
    note = {"kind": "note", "text": "<b>first</b>", "by": "AB"}
    one = said(client.put(room, json={"decisions": [note], "version": "none"}))
    assert one["decisions"] == [note]
    late = client.put(room, json={"decisions": [{"kind": "note", "text": "second"}], "version": "none"})
    assert (late.status_code, late.json()["decisions"], late.json()["version"]) == (409, [note], one["version"])
    two = said(client.put(room, json={"decisions": [note, {"kind": "verdict", "accept": True}],
                                      "version": one["version"]}))
    assert said(client.get(A1.format(id)))["version"] == two["version"]
    assert next(row for row in said(client.get(f"/api/runs/{id}"))["movies"] if row["key"] == "P_A1.tif")["accepted"]
    assert said(client.put(room, json={"decisions": [], "version": two["version"]}))["version"] == "none"


@pytest.mark.parametrize("wrong", [
    None, {}, [1], [{"kind": "nothing"}], [{"kind": "note"}], [{"kind": "drop_beat", "peak_frame": -1}],
    [{"kind": "note", "text": "x"}] * 1001, [{"kind": "settings", "settings": {"fps": -1}}],
    [{"kind": "mark_beat", "start_frame": 5, "peak_frame": 4, "stop_frame": 9}],
    [{"kind": "use_mask", "name": "tissue", "file": "../../../etc/passwd"}], [{"kind": "use_mask", "name": "tissue"}],
    [{"kind": "use_mask", "name": "tissue", "file": "/etc/passwd"}],
    [{"kind": "use_mask", "name": "tissue", "file": "someone_elses.png"}],
    [{"kind": "use_mask", "name": "tissue", "file": "..\\x.png"}]])
def test_what_is_no_decision_is_refused_and_nothing_changes(fresh: Measured, wrong: Any) -> None:
    client, id = fresh
    answer = client.put(f"{A1.format(id)}/decisions", json={"decisions": wrong})
    assert answer.status_code in (400, 422)
    assert said(client.get(A1.format(id)))["decisions"] == []


def test_a_damaged_list_of_decisions_is_told_and_left_alone(fresh: Measured) -> None:
    client, id = fresh
    results = client.desk.workspace / "runs" / id / "results"  # type: ignore[attr-defined]
    results.mkdir(parents=True)
    (results / "P_A1.tif.decisions.json").write_text("{")
    assert client.get(A1.format(id)).json()["error"]["kind"] == "ConfigError"
    assert client.put(f"{A1.format(id)}/decisions", json={"decisions": []}).status_code == 422
    assert len(said(client.get(f"/api/runs/{id}"))["movies"]) == 3
    assert (results / "P_A1.tif.decisions.json").read_text() == "{"


# --- results --------------------------------------------------------------------------------------------------------


def test_the_report_runs_its_own_scripts_and_nothing_else(measured: Measured) -> None:
    client, id = measured
    answer = client.get(f"{A1.format(id)}/report")
    policy = answer.headers["content-security-policy"]
    assert "sandbox allow-scripts" in policy
    assert "allow-same-origin" not in policy
    assert "script-src 'sha256-" in policy
    assert "frame-ancestors 'self'" in policy
    assert "unsafe" not in policy
    assert client.get(f"/api/runs/{id}/movies/P_B3.tif/report").json()["error"]["kind"] == "NoResult"


def test_traces_are_those_of_the_report(measured: Measured) -> None:
    client, id = measured
    found = said(client.get(f"{A1.format(id)}/traces"))
    assert (len(found["time"]), found["time_unit"], "map" in found) == (40, "s", False)
    assert {one["id"] for one in found["signals"]} >= {"mean_absolute_displacement", "shortening"}
    out = client.desk.workspace / "runs" / id / "results" / "P_A1.tif"  # type: ignore[attr-defined]
    report = (out / "report.html").read_text()
    try:
        (out / "report.html").unlink()
        client.desk.results._traces.clear()  # type: ignore[attr-defined]
        assert said(client.get(f"{A1.format(id)}/traces")) == found
    finally:
        (out / "report.html").write_text(report)
    assert client.get(f"/api/runs/{id}/movies/P_B3.tif/traces").status_code == 404


def test_a_movie_tells_what_was_found_and_written(measured: Measured) -> None:
    client, id = measured
    about = said(client.get(A1.format(id)))
    analysis = load(client.desk.workspace / "runs" / id / "results" / "P_A1.tif")  # type: ignore[attr-defined]
    assert sorted(one["key"] for one in about["result"]["findings"]) == sorted(f.key for f in analysis.findings)
    assert {"summary.csv", "result.nc", "report.html"} <= {one["name"] for one in about["result"]["files"]}
    assert analysis.strain is not None
    again = measure_strain(analysis.tracks, analysis.beats, analysis.masks, analysis.config)
    assert np.allclose(again.corner_px, analysis.strain.corner_px)


def test_clicks_are_held_against_the_tracks(measured: Measured) -> None:
    client, id = measured
    analysis = load(client.desk.workspace / "runs" / id / "results" / "P_A1.tif")  # type: ignore[attr-defined]
    rest = analysis.beats.relaxed_px[np.isfinite(analysis.displacement_px).all(axis=(0, 2))]
    home = rest[[np.argmin(rest[:, 1]), np.argmax(rest[:, 1])]]
    moved = home + analysis.displacement_at(home)
    points = [{"point": k, "frame": t, "row": moved[t, k, 0], "col": moved[t, k, 1]} for k in (0, 1)
              for t in (0, 4, 8, 10, 12)]
    found = said(client.post(f"{A1.format(id)}/clicks", json={"points": points}))
    assert found["difference_px"] < 0.1
    assert found["difference_um"] == pytest.approx(4 * found["difference_px"])
    assert [one["compared"] for one in found["points"]] == [4, 4]
    off = [one | {"col": one["col"] + (5 if one["frame"] else 0)} for one in points]
    found = said(client.post(f"{A1.format(id)}/clicks", json={"points": off}))
    assert (found["agrees"], found["difference_px"]) == (False, pytest.approx(5, abs=0.3))
    still = [one | {"row": 44.0, "col": 90.0} for one in points]
    assert said(client.post(f"{A1.format(id)}/clicks", json={"points": still}))["agrees"] is None
    for wrong in ([], None, [{"point": 1}], points[:1], [one | {"frame": 999} for one in points],
                  [one | {"row": "x"} for one in points], [one | {"row": float("1e30")} for one in points]):
        assert client.post(f"{A1.format(id)}/clicks", json={"points": wrong}).status_code in (400, 422)


def test_a_review_is_blind_and_its_verdicts_are_kept(measured: Measured) -> None:
    client, id = measured
    judged, shown = [], []
    for accept in (True, None):
        found = said(client.post(f"/api/runs/{id}/review/next", json={"reviewer": "AB"}))
        assert found["of"] == 2
        room = f"/api/review/{found['token']}"
        told = json.dumps([said(client.get(f"{room}{part}")) for part in ("", "/grey", "/traces")])
        for secret in ("P_A1", "P_B2", "plate1", id, str(client.desk.workspace)):  # type: ignore[attr-defined]
            assert secret not in told
        assert picture(client.get(f"{room}/frame?t=1")).shape == (88, 192)
        shown.append(json.loads(told)[0])
        said(client.post(room, json={"accept": accept, "why": "seen"}))
        judged.append(found["token"])
    assert said(client.post(f"/api/runs/{id}/review/next", json={"reviewer": "AB"})) == {"token": None, "n": 2, "of": 2}
    assert said(client.post(f"/api/runs/{id}/review/next", json={"reviewer": "CD"}))["token"]
    assert shown[0]["outlines"]["tissue"]
    assert shown[0]["numbers"]
    rows = said(client.get(f"/api/runs/{id}"))["movies"]
    assert sorted(str(row["accepted"]) for row in rows) == ["None", "None", "True"]
    assert sum(row["decisions"] for row in rows) == 2
    assert all(row["stale"] == bool(row["accepted"]) for row in rows)  # a note alone changes no number
    for wrong in ({"reviewer": " "}, {}, {"reviewer": "x" * 101}):
        assert client.post(f"/api/runs/{id}/review/next", json=wrong).status_code == 400
    assert client.post("/api/review/nothing", json={"accept": True}).status_code == 404
    assert client.post(f"/api/review/{judged[0]}", json={"accept": "yes"}).status_code == 400
    for key in ("P_A1.tif", "P_B2"):  # for the other tests of this run
        said(client.put(f"/api/runs/{id}/movies/{key}/decisions", json={"decisions": []}))


def test_the_form_of_settings_is_that_of_the_command_line() -> None:
    fields = {one["key"]: one for section in sections() for one in section["fields"]}
    flat: dict[str, Any] = {}
    for name, value in Config():
        nested = hasattr(value, "model_fields_set")
        flat |= {f"{name}.{part}": inner for part, inner in value} if nested else {name: value}
    assert set(fields) == set(flat)
    for key, value in flat.items():
        default = fields[key]["default"]
        assert (tuple(default) if isinstance(default, list) else default) == value
        assert fields[key]["text"]
    knot = fields["registration.knot_px"]
    assert (knot["type"], knot["minimum"], knot["maximum"], knot["unit"]) == ("integer", 6, 48, "px")
    assert fields["fps"]["above"] == 0
    assert fields["mask.method"]["choices"] == ["auto", "otsu", "sobel", "minimum", "maximum"]
