"""The synthetic plate: its truth, its effect, its faults, and that fast drawing is exact drawing."""

from __future__ import annotations

import csv
import time
from pathlib import Path

import numpy as np
import pytest
import tifffile

from microbundle import cli
from microbundle.batch.plan import make_plan
from microbundle.errors import ConfigError, OutputError
from microbundle.synth.plate import (
    AMPLITUDE_CV,
    DOSES_UM,
    PEAK_PX,
    RATE_HZ,
    SHAPE,
    _frames,
    _unit,
    draw_well,
    effect,
    plate_wells,
    render_plate,
    true_numbers,
)
from microbundle.synth.plate_faults import FAULTS, SPOIL, write_movie


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plate with six wells of which three are spoilt."""
    return render_plate(tmp_path_factory.mktemp("plate") / "p", 6, faults=True, seed=3).parent


def test_fast_drawing_is_exact_drawing() -> None:
    well = max(plate_wells(24, seed=1), key=lambda one: one.amplitude_px)
    synthetic = draw_well(well)
    strength = synthetic.truth.motion.strength  # type: ignore[attr-defined]
    fast = _frames(synthetic.rendered.texture, strength)  # type: ignore[arg-type]
    for t in (0, int(strength.argmax()), int(strength.argmax()) + 3):
        assert fast[t] == pytest.approx(synthetic.rendered.perfect(t), abs=2e-5)
    noise = np.asarray(synthetic.movie.frames) / 4095 - fast
    assert 0.002 < noise.std() < 0.02
    assert abs(noise.mean()) < 1e-3


def test_the_field_is_undisturbed_in_the_tissue_of_any_seed() -> None:
    for well in plate_wells(8, seed=5):
        points = np.argwhere(draw_well(well).truth.mask).astype(float)
        assert _unit().weight(points).min() == 1
        assert points.min() >= 0
        assert (points.max(axis=0) < SHAPE).all()


def test_the_drug_changes_amplitude_and_rate_by_a_hill_curve() -> None:
    assert effect(0) == (1, 1)
    assert effect(1.0) == pytest.approx((0.7, 1.175))
    assert effect(1e9) == pytest.approx((0.4, 1.35))
    wells = plate_wells(1536, seed=2)
    assert {well.dose_um for well in wells} == set(DOSES_UM)
    for dose in DOSES_UM:
        mine = [well for well in wells if well.dose_um == dose]
        strength, rate = effect(dose)
        assert np.mean([w.amplitude_px for w in mine]) == pytest.approx(PEAK_PX * strength, rel=0.02)
        assert np.mean([w.rate_hz for w in mine]) == pytest.approx(RATE_HZ * rate, rel=0.01)
        assert np.std([w.amplitude_px for w in mine]) == pytest.approx(AMPLITUDE_CV * PEAK_PX * strength, rel=0.2)


@pytest.mark.parametrize(("count", "doses"), [(2, 2), (6, 3), (8, 3), (12, 4), (24, 6), (96, 6)])
def test_any_number_of_wells_has_a_control_and_different_places(count: int, doses: int) -> None:
    wells = plate_wells(count)
    assert len({well.place for well in wells}) == count
    assert len({well.dose_um for well in wells}) == doses
    assert 0.0 in {well.dose_um for well in wells}
    spoilt = [well.fault for well in plate_wells(count, faults=True) if well.fault]
    assert spoilt
    assert sorted(spoilt) == sorted(list(FAULTS)[:min(len(FAULTS), count // 2)])


def test_the_truth_is_that_of_the_motion() -> None:
    well = plate_wells(6)[0]
    synthetic = draw_well(well)
    amplitude_um, rate_bpm = true_numbers(synthetic)
    mad = synthetic.truth.mad_px(synthetic.truth.points_px())
    assert amplitude_um == pytest.approx(4 * mad.max(), rel=0.1)
    assert rate_bpm == pytest.approx(60 * well.rate_hz, rel=0.05)


def test_a_plate_is_a_manifest_that_the_batch_takes_with_its_truth_beside_it(plate: Path) -> None:
    plan = make_plan(plate / "plate.csv")
    assert [task.columns["well"] for task in plan.tasks] == ["A1", "A2", "A3", "B1", "B2", "B3"]
    assert plan.tasks[0].config.fps == 30
    truth = rows(plate / "truth.csv")
    assert [row["movie"] for row in truth] == [task.movie for task in plan.tasks]
    assert sorted(row["fault"] for row in truth) == ["", "", "", "motionless", "out of focus", "truncated file"]
    good = next(row for row in truth if not row["fault"])
    frames = tifffile.imread(plate / good["movie"])
    assert (frames.shape, frames.dtype) == ((75, *SHAPE), np.uint16)
    assert float(good["amplitude_um"]) > 2
    still = next(row for row in truth if row["fault"] == "motionless")
    assert (float(still["amplitude_um"]), still["verdict"]) == (0, "fail")
    cut = next(row for row in truth if row["fault"] == "truncated file")
    assert (plate / cut["movie"]).stat().st_size < (plate / good["movie"]).stat().st_size / 2


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(plate: Path, tmp_path: Path) -> None:
    again = render_plate(tmp_path / "again", 6, faults=True, seed=3).parent
    for name in ("plate.csv", "truth.csv", "A1.tif", "B3.tif"):
        assert (again / name).read_bytes() == (plate / name).read_bytes()
    other = render_plate(tmp_path / "other", 2, seed=4).parent
    assert (other / "A1.tif").read_bytes() != (plate / "A1.tif").read_bytes()


def test_every_fault_is_made(tmp_path: Path) -> None:
    synthetic = draw_well(plate_wells(2)[0])
    frames = np.asarray(synthetic.movie.frames)
    for fault, spoil in SPOIL.items():
        spoilt = spoil(synthetic, frames)
        assert spoilt.dtype == np.uint16, fault
        assert not np.array_equal(spoilt, frames), fault
    size = frames.nbytes
    for k, fault in enumerate(set(FAULTS) - set(SPOIL)):
        path = tmp_path / write_movie(tmp_path, f"A{k}", synthetic, fault)
        if fault == "half-size mask":
            assert np.loadtxt(path / "masks" / "tissue_mask.txt").shape == (64, 96)
        elif fault == "missing file":
            assert not path.exists()
        else:
            assert (path.stat().st_size >= size) == (fault == "motionless"), fault


def test_a_well_is_drawn_in_a_fraction_of_a_second() -> None:
    wells = plate_wells(4, seed=9)
    draw_well(wells[0])
    start = time.process_time()
    for well in wells:
        draw_well(well)
    assert (time.process_time() - start) / len(wells) < 1.0


def test_wrong_numbers_and_full_folders_are_refused(plate: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ConfigError, match="expected 2 to 1536; found 1"):
        plate_wells(1)
    with pytest.raises(OutputError, match="holds simulation already"):
        render_plate(plate, 2)
    assert cli.run(["example-plate", "--out", str(plate), "--wells", "2000"]) == 2
    assert "found 2000" in capsys.readouterr().err


def test_the_command_prints_the_manifest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["example-plate", "--out", str(tmp_path / "p"), "--wells", "2", "--seed", "1"]) == 0
    assert Path(capsys.readouterr().out.strip()) == tmp_path / "p" / "plate.csv"
