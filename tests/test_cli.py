"""The command line: what it prints, where it writes, and its exit code for every kind of failure."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
import tifffile
from numpy.typing import NDArray

import microbundle
from microbundle import cli, pipeline
from microbundle.analysis import Analysis
from microbundle.config import Config
from microbundle.data import Movie
from microbundle.dictionary import METRICS
from microbundle.lookup import LEVELS
from microbundle.read import calibrated
from microbundle.store import load

Image = NDArray[Any]
Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def movie(tissue_array: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small tissue in one file, which carries neither times nor a pixel size."""
    file = tmp_path_factory.mktemp("cli") / "my tissue.tif"
    tifffile.imwrite(file, tissue_array[:60, 20:108])
    return file


@pytest.fixture(scope="module")
def result(movie: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result that the command line made of it."""
    folder = tmp_path_factory.mktemp("result") / "r"
    assert cli.run(["analyze", str(movie), "--fps", "30", "--um-per-px", "4", "--out", str(folder), "--quiet"]) == 0
    return folder


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Run every test in a folder of its own, with room for wide lines."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.chdir(home)
    monkeypatch.setenv("COLUMNS", "200")
    return home


@pytest.fixture
def measured(result: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the stored result, with the calibration that is asked for, where an analysis itself is not under test."""

    def stored(movie: Movie, config: Config, **_: Any) -> Analysis:
        known = calibrated(movie, config.fps, config.um_per_px)
        return replace(load(result), time_s=known.time_s, um_per_px=known.um_per_px, config=config)

    monkeypatch.setattr(pipeline, "analyze", stored)


def fails(arguments: list[str], code: int, captured: Captured) -> str:
    """Run a command that must fail: its exit code, one line on the error stream, nothing on the other, no files."""
    before = sorted(Path.cwd().rglob("*"))
    assert cli.run(arguments) == code
    out, err = captured.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert sorted(Path.cwd().rglob("*")) == before
    return err


# --- analyze --------------------------------------------------------------------------------------------------------


def test_analyze_prints_a_short_table_and_writes_beside(movie: Path, elsewhere: Path, capsys: Captured) -> None:
    assert cli.run(["analyze", str(movie), "--fps", "30", "--um-per-px", "4"]) == 0
    out, err = capsys.readouterr()
    folder = elsewhere / "my tissue_microbundle"
    assert err == ""
    for words in ("my tissue: ", "amplitude_um", "beat_rate_bpm", "tissue_width_um", f"results: {folder}"):
        assert words in out
    assert "not known" not in out
    assert load(folder).time_source == "user"
    assert [p.name for p in elsewhere.iterdir()] == [folder.name]
    assert sorted(p.name for p in movie.parent.iterdir()) == ["my tissue.tif"]


@pytest.mark.usefixtures("measured")
def test_analyze_says_what_is_not_known(movie: Path, capsys: Captured) -> None:
    assert cli.run(["analyze", str(movie), "--out", "r"]) == 0
    out, _ = capsys.readouterr()
    assert "info: not known, so no such units: pixel size (--um-per-px) and frame rate (--fps)" in out
    assert "amplitude_px" in out
    assert "amplitude_um" not in out


@pytest.mark.usefixtures("measured")
def test_quiet_prints_nothing(movie: Path, capsys: Captured) -> None:
    assert cli.run(["analyze", str(movie), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_json_is_one_object(movie: Path, elsewhere: Path, capsys: Captured) -> None:
    assert cli.run(["analyze", str(movie), "--fps", "30", "--json", "--out", "r"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert err == ""
    assert (found["name"], found["out"], found["frames"]) == ("my tissue", str(elsewhere / "r"), 60)
    assert found["metrics"]["beat_rate_hz"]["mean"] == pytest.approx(1.25, rel=0.05)
    assert not any(name.endswith("_um") for name in found["metrics"])


def test_settings_come_from_flags_over_a_file(movie: Path, elsewhere: Path) -> None:
    (elsewhere / "s.toml").write_text("fps = 10\nmethod = 'paper'\n[strain]\ntile_px = 20\n"
                                      "[reading]\nstop_frame = 58\n")
    assert cli.run(["analyze", str(movie), "--config", "s.toml", "--fps", "30", "--strain.tile-px", "25", "--out", "r",
                    "--quiet"]) in (0, 3)
    config = load("r").config
    assert (config.method, config.fps, config.strain.tile_px, config.reading.stop_frame) == ("paper", 30, 25, 58)


def test_a_given_tissue_mask_is_used(movie: Path, elsewhere: Path) -> None:
    mask = np.zeros((88, 192), np.uint8)
    mask[25:63, 30:160] = 1
    np.savetxt(elsewhere / "mask.txt", mask, fmt="%i")
    assert cli.run(["analyze", str(movie), "--tissue-mask", "mask.txt", "--out", "r", "--quiet"]) == 0
    found = load("r")
    assert found.masks.method == "supplied"
    np.testing.assert_array_equal(found.masks.tissue, mask > 0)


def test_a_still_movie_is_written_with_exit_code_3(tissue_array: Image, elsewhere: Path, capsys: Captured) -> None:
    tifffile.imwrite(elsewhere / "still.tif", np.stack([tissue_array[0]] * 6))
    assert cli.run(["analyze", "still.tif"]) == 3
    out, err = capsys.readouterr()
    assert "still: fail" in out
    assert "fail: " in out
    assert err == ""
    assert load(elsewhere / "still_microbundle").verdict == "fail"
    assert any(f.level == "fail" and f.message in out for f in load(elsewhere / "still_microbundle").findings)


@pytest.mark.usefixtures("measured")
def test_excel_and_other_tools_columns_come_beside(movie: Path, elsewhere: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("microbundle.store.tables", lambda _: pytest.fail("the tables were computed again"))
    assert cli.run(["analyze", str(movie), "--fps", "30", "--excel", "--compat", "pulse3d", "--compat", "musclemotion",
                    "--out", "r", "--quiet"]) == 0
    assert {"results.xlsx", "compat_pulse3d.csv", "compat_musclemotion.csv"} <= {p.name for p in Path("r").iterdir()}
    sheets = openpyxl.load_workbook(elsewhere / "r" / "results.xlsx").sheetnames
    assert {"summary", "quality", "settings", "compat_pulse3d", "compat_musclemotion"} <= set(sheets)
    header = (elsewhere / "r" / "compat_pulse3d.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.startswith("beat,pillar,complete,signal,Twitch Period (seconds)")


def test_without_the_writer_excel_fails_before_the_work(movie: Path, capsys: Captured,
                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "analyze", lambda *_, **__: pytest.fail("the work was begun"))
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert 'pip install "microbundle[excel]"' in fails(["analyze", str(movie), "--excel"], 2, capsys)


# --- metrics --------------------------------------------------------------------------------------------------------


def test_metrics_lists_every_key_by_level(capsys: Captured) -> None:
    assert cli.run(["metrics"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {metric.key for metric in METRICS} == {line.split()[0] for line in lines if line.startswith("  ")}
    assert {metric.level for metric in METRICS} == set(LEVELS)
    assert [line for line in lines if line and not line.startswith(" ")] == [f"{t} ({f})" for t, f in LEVELS.values()]


@pytest.mark.parametrize("name", ["amplitude", "amplitude_um", "amplitude_px", "amplitude_se_um"])
def test_metrics_tells_all_about_a_key_or_column(name: str, capsys: Captured) -> None:
    assert cli.run(["metrics", name]) == 0
    out = capsys.readouterr().out
    for words in ("amplitude\n", "px and um; px without calibration", "beats.csv, and over the whole beats summary.csv",
                  "amplitude_se_px, amplitude_se_um, se in summary.csv", "MUSCLEMOTION", "Kobeissi"):
        assert words in out


def test_metrics_in_json(capsys: Captured) -> None:
    assert cli.run(["metrics", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["metrics"]) == len(METRICS)
    assert cli.run(["metrics", "beat_rate", "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)["metrics"]
    assert (first["units_uncalibrated"], first["units_calibrated"]) == (["per_frame"], ["hz"])
    assert (second["units_uncalibrated"], second["units_calibrated"]) == ([], ["bpm"])
    assert first["standard_error"] is True


def test_an_unknown_metric_is_exit_code_2_and_named_with_near_ones(capsys: Captured) -> None:
    assert "found 'amplitud'. Near: amplitude" in fails(["metrics", "amplitud"], 2, capsys)
    assert "conduction_velocity" in fails(["metrics", "velocity"], 2, capsys)
    assert "lists them all" in fails(["metrics", "xxxxxx"], 2, capsys)


# --- failures -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("arguments", "said"), [
    (["analyse", "m"], 'Unknown command "analyse". Did you mean "analyze"?'),
    (["analyze"], "MOVIE is missing; `microbundle analyze --help` shows how"),
    (["export", "r"], "--out is missing; `microbundle export --help` shows how"),
    (["analyze", "m", "n"], "expected nothing after the movie or result; found n"),
    (["analyze", "m", "--fsp", "3"], "Unknown option: --fsp. Did you mean --fps?"),
    (["analyze", "m", "--fps"], "parameter --fps requires an argument"),
    (["analyze", "m", "--fps", "fast"], "fps: expected a valid number"),
    (["analyze", "m", "--fps", "0"], "fps: expected greater than 0; found '0'"),
    (["analyze", "m", "--method", "papre"], "method: expected 'default', 'accurate', 'fast' or 'paper'; found 'papre'"),
    (["analyze", "m", "--tracking.window-px", "3"], "tracking.window_px: expected greater than or equal to 5"),
    (["analyze", "m", "--strain.tiles", "3"], "parameter --strain.tiles requires 2"),
    (["analyze", "m", "--reading.crop-px", "9", "1", "0", "5"], "must be first row < end row"),
    (["analyze", "m", "--config", "nothing.toml"], "nothing.toml: expected a readable TOML file"),
    (["analyze", "m", "--compat", "musclemotio"], 'for --compat. Choose from: "musclemotion"'),
    (["export", "r", "--out", "e", "--layout", "excel"], "--layout: expected paper; found 'excel'"),
])
def test_a_wrong_command_line_is_exit_code_2(arguments: list[str], said: str, capsys: Captured) -> None:
    message = fails(arguments, 2, capsys)
    assert said in message
    assert "http" not in message


def test_an_unreadable_movie_mask_or_result_is_exit_code_4(movie: Path, elsewhere: Path, capsys: Captured) -> None:
    (elsewhere / "text.tif").write_text("hello")
    (elsewhere / "cut.tif").write_bytes(movie.read_bytes()[:-200_000])
    (elsewhere / "mask.txt").write_text("1 0\n0 1\n")
    assert "there is no such file" in fails(["analyze", "nothing"], 4, capsys)
    assert "expected a TIFF" in fails(["analyze", "text.tif"], 4, capsys)
    assert "cut.tif" in fails(["analyze", "cut.tif"], 4, capsys)
    assert "expected a mask of 88 x 192" in fails(["analyze", str(movie), "--tissue-mask", "mask.txt"], 4, capsys)
    assert "expected a microbundle result" in fails(["export", "nothing", "--out", "e"], 4, capsys)


def test_a_movie_that_cannot_be_measured_is_exit_code_5(elsewhere: Path, capsys: Captured) -> None:
    tifffile.imwrite(elsewhere / "short.tif", np.zeros((2, 64, 64), np.uint16))
    tifffile.imwrite(elsewhere / "grey.tif", np.full((12, 64, 64), 1000, np.uint16))
    assert "at least 3 frames; found 2" in fails(["analyze", "short.tif"], 5, capsys)
    fails(["analyze", "grey.tif"], 5, capsys)


@pytest.mark.usefixtures("measured")
def test_a_result_without_scale_cannot_be_exported(movie: Path, capsys: Captured) -> None:
    assert cli.run(["analyze", str(movie), "--fps", "30", "--out", "r", "--quiet"]) == 0
    assert "the pixel size is not known" in fails(["export", "r", "--out", "e"], 5, capsys)


def test_a_taken_folder_is_exit_code_6_before_the_work(movie: Path, elsewhere: Path, capsys: Captured,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "analyze", lambda *_, **__: pytest.fail("the work was begun"))
    (elsewhere / "taken").mkdir()
    (elsewhere / "taken" / "mine.txt").write_text("mine")
    for more in ([], ["--overwrite"]):
        message = fails(["analyze", str(movie), "--out", "taken", *more], 6, capsys)
        assert "holds something else, such as mine.txt, which is never replaced" in message
    assert "file of that name" in fails(["analyze", str(movie), "--out", "taken/mine.txt"], 6, capsys)
    assert "folder you work in" in fails(["analyze", str(movie), "--out", "."], 6, capsys)


@pytest.mark.usefixtures("measured")
def test_an_older_result_is_replaced_only_when_asked(movie: Path, result: Path, elsewhere: Path,
                                                     capsys: Captured) -> None:
    shutil.copytree(result, elsewhere / "r")
    assert "Replace them with --overwrite" in fails(["analyze", str(movie), "--out", "r"], 6, capsys)
    assert cli.run(["analyze", str(movie), "--out", "r", "--overwrite", "--quiet"]) == 0
    assert load("r").um_per_px is None


def test_errors_in_json_are_one_object(capsys: Captured) -> None:
    for arguments, kind, code in ((["analyze", "nothing"], "MovieUnreadable", 4),
                                  (["analyze", "m", "--fps", "-1"], "ConfigError", 2),
                                  (["analyze", "m", "--what"], "ConfigError", 2)):
        assert cli.run([*arguments, "--json"]) == code
        out, err = capsys.readouterr()
        error = json.loads(out)["error"]
        assert (error["kind"], error["exit_code"]) == (kind, code)
        assert err == f"error: {error['message']}\n"


@pytest.mark.parametrize("as_json", [False, True])
def test_an_interruption_is_exit_code_130_and_leaves_nothing(movie: Path, elsewhere: Path, capsys: Captured,
                                                             monkeypatch: pytest.MonkeyPatch, as_json: bool) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "analyze", interrupted)
    assert cli.run(["analyze", str(movie), *(["--json"] if as_json else [])]) == 130
    out, err = capsys.readouterr()
    assert err == "error: interrupted; nothing was written\n"
    assert (json.loads(out)["error"]["exit_code"] == 130) if as_json else out == ""
    assert list(elsewhere.iterdir()) == []


# --- export ---------------------------------------------------------------------------------------------------------


def test_export_writes_the_papers_files(result: Path, elsewhere: Path, capsys: Captured) -> None:
    assert cli.run(["export", str(result), "--out", "e"]) == 0
    assert capsys.readouterr().out == f"{elsewhere / 'e'}\n"
    assert (elsewhere / "e" / "results" / "beat_info.txt").is_file()
    assert "Replace them with --overwrite" in fails(["export", str(result), "--out", "e"], 6, capsys)
    assert cli.run(["export", str(result / "result.nc"), "--out", "e", "--overwrite", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_export_replaces_no_result_and_no_movie(result: Path, elsewhere: Path, capsys: Captured) -> None:
    shutil.copytree(result, elsewhere / "r")
    assert "never replaced" in fails(["export", "r", "--out", "r", "--overwrite"], 6, capsys)
    cli.run(["export", "r", "--out", "e", "--quiet"])
    (elsewhere / "e" / "movie").mkdir()
    (elsewhere / "e" / "movie" / "a.TIF").write_bytes(b"mine")
    assert "such as movie/a.TIF" in fails(["export", "r", "--out", "e", "--overwrite"], 6, capsys)


# --- real processes -------------------------------------------------------------------------------------------------


def microbundle_process(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "microbundle", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_program_fails_with_a_code_and_one_line(movie: Path, elsewhere: Path) -> None:
    done = microbundle_process("analyze", "nothing")
    assert (done.returncode, done.stdout) == (4, "")
    assert done.stderr.startswith("error: nothing: expected a movie")
    (elsewhere / "cut.tif").write_bytes(movie.read_bytes()[:-200_000])
    done = microbundle_process("analyze", "cut.tif")
    assert (done.returncode, done.stderr.count("\n")) == (4, 1)


def test_the_program_tells_its_version_and_shows_help() -> None:
    assert microbundle_process("--version").stdout.strip() == microbundle.__version__
    for arguments in ((), ("--help",)):
        done = microbundle_process(*arguments)
        assert (done.returncode, done.stderr) == (0, "")
        for command in ("analyze", "export", "demo"):
            assert command in done.stdout


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signal")
def test_the_program_works_in_a_pipe(movie: Path, elsewhere: Path) -> None:
    done = microbundle_process("analyze", str(movie), "--json", "--fps", "30", "--um-per-px", "4")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["verdict"] in ("pass", "review")
    assert load(elsewhere / "my tissue_microbundle").config == Config(fps=30, um_per_px=4)


# --- a real movie ---------------------------------------------------------------------------------------------------


def test_the_paper_method_on_the_real_movie(data_folder: Path, elsewhere: Path, capsys: Captured) -> None:
    assert cli.run(["analyze", str(data_folder / "type1_bright"), "--fps", "30", "--um-per-px", "4", "--method",
                    "paper", "--reading.stop-frame", "76", "--out", "r", "--json"]) == 0
    metrics = json.loads(capsys.readouterr().out)["metrics"]
    assert metrics["amplitude_um"]["mean"] == pytest.approx(5.32, rel=0.02)
    assert 105 < metrics["tissue_width_px"]["mean"] < 120
    assert sorted(p.name for p in elsewhere.iterdir()) == ["r"]


def test_a_trace_is_measured_from_the_command_line(tmp_path: Path, capsys: Captured) -> None:
    t = np.arange(400) / 100
    value = 100 * (1 + 0.3 * np.clip(np.sin(2 * np.pi * t / 0.8), 0, None) ** 2)
    np.savetxt(tmp_path / "calcium.csv", np.stack([t, value], axis=1), delimiter=",", header="time_s,F", comments="")
    assert cli.run(["trace", str(tmp_path / "calcium.csv"), "--out", str(tmp_path / "beats.csv"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["beats"] >= 4
    assert found["metrics"]["trace_amplitude"] == pytest.approx(0.3, rel=0.03)
    assert "trace_cd50_s" in (tmp_path / "beats.csv").read_text().splitlines()[0]
    assert cli.run(["trace", str(tmp_path / "calcium.csv"), "--out", str(tmp_path / "beats.csv")]) == 6


def test_stiffness_is_a_flag(tissue_folder: Path, tmp_path: Path, capsys: Captured) -> None:
    line = ["analyze", str(tissue_folder), "--stiffness-un-per-um", "2.677", "--out", str(tmp_path / "r"), "--json"]
    assert cli.run([*line, "--fps", "30"]) == 0
    assert json.loads(capsys.readouterr().out)["findings"]
    assert load(tmp_path / "r").config.pillars.stiffness_un_per_um == 2.677
