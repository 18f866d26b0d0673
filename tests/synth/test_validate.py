"""A validation runs as users run the pipeline, goes on where it was stopped, and never breaks off."""

import json

import numpy as np
import pytest

from microbundle.config import Config
from microbundle.errors import ConfigError, OutputError
from microbundle.synth import commands
from microbundle.synth import validate as module
from microbundle.synth.cases import GROUPS, SETS, case_set
from microbundle.synth.coverage import LEVELS, QUANTITIES
from microbundle.synth.scenes import FPS
from microbundle.synth.validate import LEDGER, MEASURED, Row, run_validation
from microbundle.synth.validation_figures import write_figures
from microbundle.synth.validation_tables import SUMMARY, held_rows, summary_rows, write_tables


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("validation") / "smoke"
    return folder, run_validation(case_set("smoke"), Config(), folder)


def test_the_pipeline_is_scored_on_small_movies(run):
    _, (clean, noisy, still) = run
    assert [r.status for r in (clean, noisy, still)] == [MEASURED] * 3
    for row in (clean, noisy):
        assert abs(row.scores["mad_error_pct"]) < 15
        assert row.scores["ecc_mae_pct"] < 20
        assert row.scores["rmse_px"] < 0.15
        assert row.scores["missed_beats"] == 0
        assert row.scores["covered_pct"] > 90
        assert row.seconds > 0
    assert still.scores["extra_beats"] == 0
    assert still.scores["true_mad_px"] == 0


def test_a_second_run_computes_nothing_and_a_stopped_one_goes_on(run, monkeypatch, tmp_path):
    folder, rows = run
    ran = []
    real = module.run_case

    def counted(case, *rest):
        ran.append(case.name)
        return real(case, *rest)

    monkeypatch.setattr(module, "run_case", counted)
    again = run_validation(case_set("smoke"), Config(), folder)
    assert ran == []
    assert [r.as_json() for r in again] == [r.as_json() for r in rows]

    # Killed in the middle of a line: the whole lines count, and the next run adds to them.
    stopped = tmp_path / "stopped"
    stopped.mkdir()
    lines = (folder / LEDGER).read_text().splitlines()
    (stopped / LEDGER).write_text("\n".join(lines[:2]) + "\n" + lines[2][:40])
    after = run_validation(case_set("smoke"), Config(), stopped)
    assert ran == ["smoke-still"]
    assert [r.case for r in after] == [r.case for r in rows]
    assert len(list(module.read_ledger(stopped))) == 3


def test_other_settings_and_another_program_are_scored_anew(monkeypatch):
    case = case_set("smoke")[0]
    key = module.row_key(case, Config())
    assert module.row_key(case, Config(method="paper")) != key
    assert module.row_key(case_set("smoke")[1], Config()) != key
    monkeypatch.setattr(module, "program", lambda: "another")
    assert module.row_key(case, Config()) != key


def test_a_movie_that_cannot_be_measured_is_a_row(tmp_path):
    impossible = Config.from_dict({"strain": {"min_markers": 3}, "reading": {"first_frame": 500}})
    (row,) = run_validation(case_set("smoke")[2:], impossible, tmp_path / "v")
    assert row.status.startswith("failed: MovieUnreadable")
    assert not row.measured
    (line,) = summary_rows([row])
    assert line[SUMMARY.index("failed")] == "1"
    write_tables([row], tmp_path / "v", "t")
    assert "MovieUnreadable" in (tmp_path / "v" / "summary.md").read_text()


def test_tables_and_figures(run):
    folder, rows = run
    files = write_tables(rows, folder, "Smoke")
    text = files[2].read_text()
    assert "smoke-noisy" in text
    assert "2-7 %, 9.2 %" in text
    pytest.importorskip("matplotlib")
    pictures = write_figures(case_set("smoke"), rows, folder)
    assert {p.stem for p in pictures} == {"error_by_amplitude", "calibration", "curves_smoke-clean",
                                            "curves_smoke-noisy"}
    assert all(p.with_suffix(".pdf").stat().st_size > 1000 for p in pictures)


def test_the_command(tmp_path, capsys):
    out = tmp_path / "v"
    assert commands.validate(cases="smoke", only="*-still", out=out, figures=False) == 0
    said = capsys.readouterr().out
    assert "1/1 smoke-still: measured" in said
    assert "motionless" in said
    assert {p.name for p in out.iterdir()} == {LEDGER, "traces", "scores.csv", "summary.csv", "summary.md"}
    with pytest.raises(ConfigError, match="no case fits"):
        commands.validate(cases="smoke", only="none*", out=out)
    with pytest.raises(ConfigError, match="--workers"):
        commands.validate(cases="smoke", workers=0, out=out)


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="other files"):
        run_validation(case_set("smoke"), Config(), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_rows_survive_json():
    row = Row("a", "g", "k", "failed: x")
    assert "NaN" not in row.as_json()
    again = Row.from_json(row.as_json())
    assert np.isnan(again.seconds)
    assert np.isnan(again.scores["rmse_px"])
    with pytest.raises((KeyError, TypeError)):
        Row.from_json(json.dumps({"case": "a"}))


def test_sets_are_what_they_say():
    sets = {name: case_set(name) for name in SETS}
    assert {n: len(s) for n, s in sets.items()} == {"paper": 416, "type2": 3, "frontier": 30, "still": 8,
                                                    "patchwork": 4, "smoke": 3}
    for cases in sets.values():
        assert len({c.name for c in cases}) == len({c.key for c in cases}) == len(cases)
        assert {c.group.removesuffix(" (patchwork)") for c in cases} <= set(GROUPS)
    assert len({c.scene_key for c in sets["paper"]}) == 16
    assert sum(c.noise.perlin_ratio == 0 for c in sets["paper"]) == 16
    # Every movie of the frontier has a texture of its own.
    assert len({c.scene.seed for c in sets["frontier"]}) == 30
    with pytest.raises(ConfigError, match="frontier"):
        case_set("fronteer")


def test_a_case_is_the_same_movie_every_time():
    case = case_set("smoke")[1]
    first, second = case.make(), case_set("smoke")[1].make()
    np.testing.assert_array_equal(first.movie.frames[7], second.movie.frames[7])
    assert first.movie.frames_per_s == pytest.approx(FPS)
    # Frames drawn once and disturbed later are those of the case itself.
    clean = np.stack([first.rendered.perfect(t).astype(np.float32) for t in range(3)])
    later = first.rendered.noise.quantise(first.rendered.noise.disturb(clean[2], 2, first.movie.count))
    assert np.abs(later.astype(int) - first.movie.frames[2]).max() <= 1


def test_intervals_hold_the_truth_about_as_often_as_they_say(run):
    rows = run[1]
    held = rows[1].held
    assert set(held) == set(QUANTITIES)
    assert all(len(shares) == len(LEVELS) and sorted(shares) == shares for shares in held.values())
    assert held["displacement"][LEVELS.index(0.95)] > 0.8
    assert held["displacement"][LEVELS.index(0.5)] < 0.85
    assert held_rows(rows)[-1][0] == "all"
