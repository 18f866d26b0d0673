"""A small plate from end to end: faults, plate maps, page, workbook, and a run that is killed."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import openpyxl
import pytest

from microbundle import cli
from microbundle.batch.collect import Extras
from microbundle.batch.plan import make_plan
from microbundle.batch.run import Outcome, run_batch
from microbundle.config import Config
from microbundle.errors import ConfigError

BENCHMARK = Path(__file__).parent.parent.parent / "benchmarks" / "plate.py"
SETTINGS = Config(method="fast", fps=30, um_per_px=4)


@pytest.fixture(scope="module")
def ran(plate: Path, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """A run over the plate of one movie of each fault, with a workbook where that can be written."""
    excel = importlib.util.find_spec("xlsxwriter") is not None
    plan = make_plan(plate, config=SETTINGS, pattern="{well}")
    return run_batch(plan, tmp_path_factory.mktemp("ran") / "out", workers=2, extras=Extras(excel=excel, wells=12))


def test_a_run_over_wells_draws_maps_and_lists_them(ran: Outcome) -> None:
    folder = ran.out / "plate_maps"
    assert folder in ran.files
    assert (folder / "plate_amplitude_um.png").stat().st_size > 5000
    assert (folder / "plate_amplitude_um.pdf").read_bytes().startswith(b"%PDF")
    page = (ran.out / "index.html").read_text("utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert found is not None
    shown, = json.loads(found[1])["plates"]
    assert (shown["rows"], shown["columns"]) == (3, 4)
    states = {well["name"]: well["state"] for well in shown["wells"]}
    assert {name for name, state in states.items() if state == "failed"} == {"B1", "B2", "C2"}
    assert states["C1"] == "fail"
    assert shown["wells"][0]["report"] == "results/A1.tif/report.html"


def test_the_same_run_again_leaves_maps_and_page_alone(ran: Outcome, plate: Path) -> None:
    kept = [*(ran.out / "plate_maps").iterdir(), ran.out / "index.html"]
    before = [file.stat().st_mtime_ns for file in kept]
    plan = make_plan(plate, config=SETTINGS, pattern="{well}")
    run_batch(plan, ran.out, extras=Extras(wells=12))
    assert [file.stat().st_mtime_ns for file in kept] == before
    (ran.out / ".tables").write_text("of a run that was killed before it wrote the page")
    run_batch(plan, ran.out, extras=Extras(wells=12))
    assert (ran.out / "index.html").stat().st_mtime_ns > before[-1]


@pytest.mark.skipif(importlib.util.find_spec("xlsxwriter") is None, reason="XlsxWriter is not installed")
def test_the_workbook_holds_tables_plates_and_settings(ran: Outcome) -> None:
    book = openpyxl.load_workbook(ran.out / "plate.xlsx")
    assert book.sheetnames[:3] == ["movies", "tidy", "amplitude_um"]
    assert book.sheetnames[-3:] == ["settings", "notes", "metrics"]
    grid = [[cell.value for cell in row][:3] for row in book["amplitude_um"]]
    assert grid[2][1] == grid[2][2] > 1
    assert grid[3][1:] == ["MovieUnreadable", "MaskUnusable"]
    assert grid[4][1:] == ["fail", "MovieUnreadable"]
    said = {row[1].value: row[2].value for row in book["settings"]}
    assert (said["movies"], said["fps"]) == (6, 30)


def test_a_plate_that_is_too_small_is_refused_before_anything_runs(
        plate: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["batch", str(plate), "--pattern", "{well}", "--out", str(tmp_path / "o")]
    assert cli.run([*line, "--wells", "6"]) == 2
    assert "plate of 6 wells (to B3); found C2" in capsys.readouterr().err
    assert cli.run([*line, "--wells", "10"]) == 2
    assert not (tmp_path / "o").exists()
    with pytest.raises(ConfigError):
        Extras(wells=6).check(make_plan(plate, pattern="{well}"))


@pytest.mark.skipif(not BENCHMARK.exists() or not Path("/proc/self/stat").exists(), reason="needs the benchmark, /proc")
def test_a_plate_with_planted_faults_is_reported_as_planted_and_survives_being_killed(tmp_path: Path) -> None:
    line = [sys.executable, str(BENCHMARK), "--wells", "6", "--kills", "1", "--method", "fast", "--seed", "1"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=tmp_path, env=os.environ)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "NO" not in done.stdout
    assert "are the same, byte for byte" in done.stdout
