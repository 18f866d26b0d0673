"""A person's decisions: written down, replayed on every rerun, and told; what no longer fits is told as well."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import microbundle
from microbundle import cli
from microbundle.analysis import Analysis
from microbundle.config import Config
from microbundle.data import Movie
from microbundle.decide import decide, keep_mask
from microbundle.decisions import Decisions, decisions_hash, read_decisions, sidecar_of, write_decisions
from microbundle.errors import ConfigError, MaskUnusable, OutputError
from microbundle.pipeline import analyze
from microbundle.store import load

Image = NDArray[Any]
FAST = Config.from_dict({"method": "fast", "strain": {"tile_px": 20}})


def decided(movie: Movie, *listed: dict[str, Any], home: Path | str = "", config: Config = FAST) -> Analysis:
    return analyze(movie, config, decisions=Decisions.from_list(listed, home=home))


def keys(analysis: Analysis) -> list[str]:
    return [finding.key for finding in analysis.findings]


@pytest.fixture(scope="module")
def plain(tissue_array: Image) -> Analysis:
    return analyze(Movie.from_array(tissue_array, fps=30, um_per_px=4, name="tissue"), FAST)


# --- beats ----------------------------------------------------------------------------------------------------------


def test_a_beat_that_is_left_out_counts_nowhere(tissue_movie: Movie, plain: Analysis) -> None:
    found = decided(tissue_movie, {"kind": "drop_beat", "peak_frame": int(plain.beats.peak[1]), "by": "AB",
                                   "why": "touched", "at": "2026-11-25T10:11:12+01:00"})
    assert found.beats.complete.tolist() == [True, False, True]
    assert found.beats.left_out.tolist() == [False, True, False]
    before, after = (microbundle.tables(one) for one in (plain, found))
    n = {name: dict(zip(made["summary"]["metric"], made["summary"]["n"], strict=True))
         for name, made in (("before", before), ("after", after))}
    assert (n["before"]["amplitude_um"], n["after"]["amplitude_um"]) == (3, 2)
    assert (n["before"]["beat_period_s"], n["after"]["beat_period_s"]) == (2, 0)
    assert after["beats"]["amplitude_um"].isna().tolist() == [False, True, False]
    assert after["beats"]["beat_period_s"].isna().all()
    assert after["beats"]["left_out"].tolist() == [False, True, False]
    mean = before["beats"]["amplitude_um"][[0, 2]].mean()
    told = after["summary"].set_index("metric").loc["amplitude_um", "mean"]
    assert told == pytest.approx(mean, rel=1e-3)
    message = next(f.message for f in found.findings if f.key == "beat_left_out")
    assert "“touched”, AB, 2026-11-25 10:11" in message
    assert found.beats.label(1) == "beat 2 (left out)"


def test_no_beat_left_is_a_failure_that_says_why(tissue_movie: Movie, plain: Analysis) -> None:
    found = decided(tissue_movie, *({"kind": "drop_beat", "peak_frame": int(p)} for p in plain.beats.peak))
    assert found.verdict == "fail"
    assert any("every beat is left out" in f.message for f in found.findings)


def test_a_marked_beat_takes_the_place_of_what_was_found(tissue_movie: Movie, plain: Analysis) -> None:
    start, stop = int(plain.beats.start[0]), int(plain.beats.stop[1])
    found = decided(tissue_movie, {"kind": "mark_beat", "start_frame": start, "peak_frame": int(plain.beats.peak[1]),
                                   "stop_frame": stop})
    assert found.beats.start.tolist() == [start, int(plain.beats.start[2])]
    assert found.beats.peak.tolist() == plain.beats.peak[1:].tolist()
    between = int(plain.beats.stop[0])
    assert plain.beats.relaxed[between]
    assert not found.beats.relaxed[between - 3:between + 4].any()
    assert found.beats.relaxed[[start, stop - 1]].all()
    assert "beat_marked" in keys(found)


def test_a_beat_can_be_marked_where_none_was_found(tissue_movie: Movie, plain: Analysis) -> None:
    strict = Config.from_dict({"method": "fast", "beats": {"min_amplitude_px": 50}})
    assert len(analyze(tissue_movie, strict).beats) == 0
    a, p, z = (int(one[1]) for one in (plain.beats.start, plain.beats.peak, plain.beats.stop))
    found = decided(tissue_movie, {"kind": "mark_beat", "start_frame": a, "peak_frame": p, "stop_frame": z},
                    config=strict)
    assert found.verdict != "fail"
    amplitude = microbundle.tables(found)["beats"]["amplitude_um"][0]
    assert amplitude == pytest.approx(microbundle.tables(plain)["beats"]["amplitude_um"][1], rel=0.1)


def test_neighbours_end_where_a_marked_beat_begins(tissue_movie: Movie, plain: Analysis) -> None:
    p = int(plain.beats.peak[1])
    found = decided(tissue_movie, {"kind": "mark_beat", "start_frame": p - 18, "peak_frame": p, "stop_frame": p + 18})
    assert found.beats.stop[0] == p - 18
    assert found.beats.start[2] == p + 18


@pytest.mark.parametrize(("decision", "why"), [
    ({"kind": "drop_beat", "peak_frame": 5000}, "no beat was found at frame 5000"),
    ({"kind": "mark_beat", "start_frame": 60, "peak_frame": 80, "stop_frame": 100}, "the movie has only 75 frames")])
def test_a_decision_that_no_longer_fits_is_told(tissue_movie: Movie, plain: Analysis, decision: dict[str, Any],
                                                why: str) -> None:
    found = decided(tissue_movie, decision)
    assert found.beats.peak.tolist() == plain.beats.peak.tolist()
    finding = next(f for f in found.findings if f.key == "decision_not_replayed")
    assert finding.level == "review"
    assert why in finding.message


# --- masks, settings, verdict ---------------------------------------------------------------------------------------


def test_a_decided_mask_is_taken_whatever_the_settings_say(tissue_movie: Movie, plain: Analysis,
                                                           tmp_path: Path) -> None:
    mask = np.array(plain.masks.tissue)
    mask[:, :60] = False
    name = keep_mask(tmp_path / "result", "tissue", mask)
    otsu = Config.from_dict({"method": "fast", "mask": {"method": "otsu"}})
    found = decided(tissue_movie, {"kind": "use_mask", "name": "tissue", "file": name}, home=tmp_path, config=otsu)
    assert np.array_equal(found.masks.tissue, mask)
    assert "mask_decided" in keys(found)


def test_a_decided_mask_of_another_size_is_an_error(tissue_movie: Movie, tmp_path: Path) -> None:
    name = keep_mask(tmp_path / "result", "tissue", np.ones((5, 5), bool))
    with pytest.raises(MaskUnusable, match="expected a mask of 128 x 192 px"):
        decided(tissue_movie, {"kind": "use_mask", "name": "tissue", "file": name}, home=tmp_path)


def test_decided_settings_win_and_are_told(tissue_movie: Movie) -> None:
    found = decided(tissue_movie, {"kind": "settings", "settings": {"um_per_px": 2, "strain": {"tile_px": 30}}},
                    {"kind": "settings", "settings": {"um_per_px": 3}})
    assert (found.um_per_px, found.config.strain.tile_px, found.config.method) == (3, 30, "fast")
    assert sum(key == "settings_decided" for key in keys(found)) == 2
    assert any("strain.tile_px = 30" in f.message for f in found.findings)


def test_accepting_lifts_review_but_not_fail_and_rejecting_fails(tissue_movie: Movie, plain: Analysis) -> None:
    drop = {"kind": "drop_beat", "peak_frame": int(plain.beats.peak[0])}
    yes, no = ({"kind": "verdict", "accept": accept} for accept in (True, False))
    assert decided(tissue_movie, drop).verdict == "review"
    assert decided(tissue_movie, drop, yes).verdict == "pass"
    assert decided(tissue_movie, drop, no, yes).verdict == "pass"
    assert decided(tissue_movie, no).verdict == "fail"
    every = [{"kind": "drop_beat", "peak_frame": int(p)} for p in plain.beats.peak]
    assert decided(tissue_movie, *every, yes).verdict == "fail"


def test_a_result_keeps_its_decisions_and_the_report_lists_them(tissue_movie: Movie, plain: Analysis,
                                                                tmp_path: Path) -> None:
    found = decided(tissue_movie, {"kind": "drop_beat", "peak_frame": int(plain.beats.peak[1]), "why": "<touched>"},
                    {"kind": "note", "text": "cloudy medium"})
    microbundle.save(found, tmp_path / "r")
    again = microbundle.load(tmp_path / "r")
    assert again.decisions.as_list() == found.decisions.as_list()
    assert np.array_equal(again.beats.left_out, found.beats.left_out)
    page = microbundle.write_report(again, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "cloudy medium" in page
    assert "“&lt;touched&gt;”" in page
    assert "beat 2 (left out)" in page
    assert "1 beat that a person left out" in page


# --- the file -------------------------------------------------------------------------------------------------------


def test_decisions_lie_beside_the_result_and_read_back(tmp_path: Path) -> None:
    made = Decisions.from_list([{"kind": "drop_beat", "peak_frame": 3, "by": "Ä"}, {"kind": "note", "text": "x"}])
    file = write_decisions(tmp_path / "A1_microbundle", made)
    assert file == tmp_path / "A1_microbundle.decisions.json" == sidecar_of(tmp_path / "A1_microbundle")
    assert read_decisions(tmp_path / "A1_microbundle").as_list() == made.as_list()
    assert read_decisions(tmp_path / "A2_microbundle").listed == ()
    write_decisions(tmp_path / "A1_microbundle", Decisions())
    assert not file.exists()


@pytest.mark.parametrize(("content", "told"), [
    ("", "cannot be read"), ("[1]", "cannot be read"), ("{}", "there is no such key"),
    ('{"microbundle_decisions": {}}', "holds no list"),
    ('{"microbundle_decisions": [{"kind": "explode"}]}', "explode"),
    ('{"microbundle_decisions": [{"kind": "drop_beat"}]}', "peak_frame"),
    ('{"microbundle_decisions": [{"kind": "drop_beat", "peak_frame": -1}]}', "peak_frame"),
    ('{"microbundle_decisions": [{"kind": "mark_beat", "start_frame": 5, "peak_frame": 4, "stop_frame": 9}]}',
     "follow"),
    ('{"microbundle_decisions": [{"kind": "use_mask", "name": "../x", "file": "a.png"}]}', "name"),
    ('{"microbundle_decisions": [{"kind": "settings", "settings": {"tile": 3}}]}', "tile"),
    ("[" * 100_000, "cannot be read")])
def test_a_damaged_file_of_decisions_is_one_clear_error(tmp_path: Path, content: str, told: str) -> None:
    sidecar_of(tmp_path / "r").write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match=told) as caught:
        read_decisions(tmp_path / "r")
    assert "r.decisions.json" in str(caught.value)


def test_a_file_of_another_is_never_replaced(tmp_path: Path) -> None:
    sidecar_of(tmp_path / "r").write_text("mine", encoding="utf-8")
    with pytest.raises(OutputError, match="never replaced"):
        write_decisions(tmp_path / "r", Decisions.from_list([{"kind": "note", "text": "x"}]))
    assert sidecar_of(tmp_path / "r").read_text(encoding="utf-8") == "mine"


def test_decisions_can_be_taken_back(tmp_path: Path) -> None:
    decide(tmp_path / "r", drop_beats=[3, 40], accept=True, by="AB")
    left = decide(tmp_path / "r", forget=[0, 2])
    assert [(one.kind, getattr(one, "peak_frame", None)) for one in left.listed] == [("drop_beat", 40)]
    with pytest.raises(ConfigError, match="0 to 0, to forget; found 7"):
        decide(tmp_path / "r", forget=[7])


def test_a_mask_is_copied_and_counts_for_the_hash(tmp_path: Path) -> None:
    mask = tmp_path / "mine_pillar_2.png"
    mask.write_bytes(b"anything")
    assert decisions_hash(tmp_path / "r") == ""
    found = decide(tmp_path / "r", masks=[mask])
    copy = found.masks["pillar_2"]
    assert copy.parent == tmp_path
    assert copy.read_bytes() == b"anything"
    before = decisions_hash(tmp_path / "r")
    copy.unlink()
    assert decisions_hash(tmp_path / "r") != before


# --- command line ---------------------------------------------------------------------------------------------------


def test_the_command_line_writes_down_and_replays(tissue_folder: Path, tmp_path: Path,
                                                  capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    line = ["analyze", str(tissue_folder), "--out", str(out), "--fps", "30", "--method", "fast", "--no-report",
            "--json"]
    assert cli.run(line) == 0
    first = json.loads(capsys.readouterr().out)
    said = ["--drop-beat", "34", "--accept", "--by", "AB", "--why", "touched", "--json"]
    assert cli.run(["decide", str(out), *said]) == 0
    assert [one["kind"] for one in json.loads(capsys.readouterr().out)["decisions"]] == ["drop_beat", "verdict"]
    assert cli.run([*line, "--overwrite"]) == 0
    second = json.loads(capsys.readouterr().out)
    assert (first["beats"], second["beats"], second["verdict"]) == (3, 2, "pass")
    assert cli.run(["decide", str(out)]) == 0
    assert "drop_beat" in capsys.readouterr().out
    assert cli.run(["decide", str(out), "--accept", "--reject"]) == 2
    assert cli.run(["decide", str(out), "--mark-beat", "9", "4", "12"]) == 2
    assert "follow each other" in capsys.readouterr().err


def test_a_movie_with_decisions_is_measured_again_in_a_batch(tissue_array: Image, tmp_path: Path) -> None:
    from microbundle.batch.plan import make_plan
    from microbundle.batch.run import run_batch

    (tmp_path / "plate").mkdir()
    for name in ("A1", "A2"):
        tifffile.imwrite(tmp_path / "plate" / f"{name}.tif", tissue_array[:, 20:108])
    plan = make_plan(tmp_path / "plate", config=Config(method="fast", fps=30), report=False)
    first = run_batch(plan, tmp_path / "out", workers=1)
    decide(tmp_path / "out" / "results" / "A1.tif", drop_beats=[34])
    again = run_batch(plan, tmp_path / "out", workers=1)
    assert (first.unchanged, again.unchanged) == (0, 1)
    assert [status.beats for status in again.statuses.values()] == [2, 3]
    assert run_batch(plan, tmp_path / "out", workers=1).unchanged == 2


def test_a_verdict_is_written_without_measuring_again(tissue_array: Image, tmp_path: Path) -> None:
    from microbundle.batch.plan import make_plan
    from microbundle.batch.work import job_of, measure

    (tmp_path / "plate").mkdir()
    movie = tmp_path / "plate" / "A1.tif"
    tifffile.imwrite(movie, tissue_array[:, 20:108])
    out = tmp_path / "out"
    for folder in ("results", "status"):
        (out / folder).mkdir(parents=True)
    result = out / "results" / "A1.tif"

    def again() -> tuple[str, list[str]]:
        """Verdict, and the stages of a measurement that were heard of."""
        plan = make_plan(tmp_path / "plate", config=Config(fps=30))
        heard: list[str] = []
        status = measure(job_of(plan.tasks[0], out, plan, 1), lambda event: heard.append(event.stage))
        assert status.state == "done"
        return status.verdict, heard

    first, heard = again()
    assert "tracking" in heard
    before = {file.name: file.read_bytes() for file in result.glob("*.csv")}
    decide(result, accept=False, why="blurred")
    assert (first, again()) == ("pass", ("fail", []))
    assert {file.name: file.read_bytes() for file in result.glob("*.csv")} == before
    assert "blurred" in (result / "report.html").read_text("utf-8")
    assert load(result).verdict == "fail"
    decide(result, drop_beats=[34])  # changes numbers
    assert "tracking" in again()[1]
    decide(result, accept=True)
    assert again() == ("pass", [])
    os.utime(movie, (1, 1))
    assert "tracking" in again()[1]
    (result / "result.nc").write_bytes(b"damaged")
    decide(result, accept=False)
    assert "tracking" in again()[1]


def test_a_note_measures_nothing_again(tmp_path: Path) -> None:
    decide(tmp_path / "r", note="cloudy")
    assert decisions_hash(tmp_path / "r") == ""
    decide(tmp_path / "r", accept=True)
    before = decisions_hash(tmp_path / "r")
    assert before
    decide(tmp_path / "r", note="still cloudy")
    assert decisions_hash(tmp_path / "r") == before
