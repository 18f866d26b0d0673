"""The published tool's text layout: names, shapes and values, against arrays and against the published numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from microbundle.analysis import Analysis
from microbundle.config import Config
from microbundle.data import Movie
from microbundle.errors import CalibrationMissing
from microbundle.mask_files import read_mask
from microbundle.paper_layout import export_paper
from microbundle.pipeline import analyze
from microbundle.read import read_movie

PAIRS = ("beat{}", "rotated_beat{}", "rotated_translated_beat{}", "interpolation_beat{}")
STRAIN = ("row", "col", "Frr", "Frc", "Fcr", "Fcc")


def text(folder: Path, name: str) -> NDArray[Any]:
    return np.loadtxt(folder / "results" / f"{name}.txt", ndmin=2)


@pytest.fixture(scope="module")
def exported(tissue_analysis: Analysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of the small tissue, three whole beats."""
    return export_paper(tissue_analysis, tmp_path_factory.mktemp("paper") / "e")


def test_the_files_have_the_published_names(exported: Path) -> None:
    wanted = {"info", "beat_info", "tissue_info", "rot_info", "strain__sub_domain_info"}
    for beat in range(3):
        wanted |= {f"{pair.format(beat)}_{side}" for pair in PAIRS for side in ("row", "col")}
        wanted |= {f"strain__beat{beat}_{name}" for name in STRAIN}
    assert {f.stem for f in (exported / "results").iterdir()} == wanted
    assert [f.name for f in (exported / "masks").iterdir()] == ["tissue_mask.txt"]


def test_shapes_are_markers_or_tiles_by_frames(exported: Path, tissue_analysis: Analysis) -> None:
    a = tissue_analysis
    info = np.loadtxt(exported / "results" / "info.txt", dtype=int, ndmin=2)
    np.testing.assert_array_equal(info, np.stack([np.arange(3), a.beats.start, a.beats.stop], axis=1))
    assert a.strain is not None
    for beat, first, end in info:
        for side in ("row", "col"):
            assert text(exported, f"beat{beat}_{side}").shape == (a.tracks.kept.sum(), end - first)
        for name in STRAIN:
            assert text(exported, f"strain__beat{beat}_{name}").shape == (len(a.strain.label), end - first)


def test_positions_and_strain_are_those_of_the_result(exported: Path, tissue_analysis: Analysis) -> None:
    a, first, end = tissue_analysis, int(tissue_analysis.beats.start[1]), int(tissue_analysis.beats.stop[1])
    assert a.strain is not None
    for k, side in enumerate(("row", "col")):
        np.testing.assert_allclose(text(exported, f"beat1_{side}"), a.tracks.position_px[first:end, a.tracks.kept, k].T)
    for j, k, name in ((0, 0, "Frr"), (0, 1, "Frc"), (1, 0, "Fcr"), (1, 1, "Fcc")):
        np.testing.assert_allclose(text(exported, f"strain__beat1_{name}"), a.strain.F[first:end, :, j, k].T)


def test_turned_points_keep_their_distances_and_um_their_scale(exported: Path) -> None:
    plain, turned, scaled = (np.stack([text(exported, f"{name}_{side}") for side in ("row", "col")])
                             for name in ("beat0", "rotated_beat0", "rotated_translated_beat0"))
    away, turned_away, scaled_away = (np.hypot(*(points[:, 1:] - points[:, :1])) for points in (plain, turned, scaled))
    np.testing.assert_allclose(turned_away, away, rtol=1e-6)
    np.testing.assert_allclose(scaled_away, 4 * away, rtol=1e-6)


def test_rate_amplitude_and_width_are_those_of_the_tables(exported: Path, tissue_analysis: Analysis) -> None:
    rate, amplitude = np.loadtxt(exported / "results" / "beat_info.txt")
    assert rate == pytest.approx(1.25)
    assert 2.5 < amplitude < 6
    width = float(np.loadtxt(exported / "results" / "tissue_info.txt"))
    assert width == pytest.approx(tissue_analysis.masks.axis.width_center_px)


def test_the_mask_can_be_read_back(exported: Path, tissue_analysis: Analysis) -> None:
    tissue = tissue_analysis.masks.tissue
    np.testing.assert_array_equal(read_mask(exported / "masks" / "tissue_mask.txt", tissue.shape), tissue)


def test_without_strain_or_whole_beats_the_rest_is_written(tissue_analysis: Analysis, tmp_path: Path) -> None:
    a = tissue_analysis
    cut = replace(a, strain=None, beats=replace(a.beats, complete=np.zeros(len(a.beats), bool)))
    results = export_paper(cut, tmp_path / "e") / "results"
    assert {f.name for f in results.iterdir()} == {"info.txt", "beat_info.txt", "tissue_info.txt", "rot_info.txt"}
    assert (results / "info.txt").read_text() == ""
    assert np.isnan(np.loadtxt(results / "beat_info.txt")).all()


@pytest.mark.parametrize(("missing", "said"), [("time_s", "frame rate"), ("um_per_px", "pixel size")])
def test_unknown_calibration_is_refused_not_invented(tissue_analysis: Analysis, tmp_path: Path, missing: str,
                                                     said: str) -> None:
    with pytest.raises(CalibrationMissing, match=rf"tissue: the paper's layout gives Hz and um, and the {said} is not"):
        export_paper(replace(tissue_analysis, **{missing: None}), tmp_path / "e")
    assert list(tmp_path.iterdir()) == []


def test_the_paper_method_exports_too(tissue_movie: Movie, tmp_path: Path) -> None:
    result = analyze(tissue_movie, Config.from_dict({"method": "paper", "strain": {"tile_px": 20}}))
    folder = export_paper(result, tmp_path / "e")
    assert text(folder, "info").tolist() == [[0, 22, 46]]
    assert text(folder, "beat0_row").shape == (len(result.markers), 24)


# --- the published numbers ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def published(data_folder: Path, golden_folder: Path,
              tmp_path_factory: pytest.TempPathFactory) -> tuple[Analysis, Path]:
    """The real movie under `paper` on its first 76 frames, as a result and as its export."""
    movie = read_movie(data_folder / "type1_bright", fps=30, um_per_px=4)
    result = analyze(movie, Config.from_dict({"method": "paper", "reading": {"stop_frame": 76}}))
    assert golden_folder.is_dir()
    return result, export_paper(result, tmp_path_factory.mktemp("published") / "e")


def golden(folder: Path, name: str) -> dict[str, NDArray[Any]]:
    with np.load(folder / f"mbc_{name}.npz") as file:
        return {key: file[key] for key in file}


def test_beat_width_and_times_are_the_published(published: tuple[Analysis, Path], golden_folder: Path) -> None:
    folder, wanted = published[1], golden(golden_folder, "tracks")
    np.testing.assert_array_equal(text(folder, "info"), wanted["info"])
    rate, amplitude = np.loadtxt(folder / "results" / "beat_info.txt")
    assert rate == pytest.approx(1.25)
    assert amplitude == pytest.approx(5.318, abs=0.005)
    assert float(np.loadtxt(folder / "results" / "tissue_info.txt")) == 116
    np.testing.assert_array_equal(np.loadtxt(folder / "masks" / "tissue_mask.txt"), wanted["mask"])


@pytest.mark.parametrize(("name", "key"), [("beat0", "tracks"), ("rotated_beat0", "rotated")])
def test_tracks_are_the_published(published: tuple[Analysis, Path], golden_folder: Path, name: str, key: str) -> None:
    wanted = golden(golden_folder, key)
    for side in ("row", "col"):
        expected = wanted[f"tracker_{side}"][:, 28:52] if key == "tracks" else wanted[f"beat0_{side}"]
        away = np.abs(text(published[1], f"{name}_{side}") - expected)
        assert (away < 0.01).mean() >= 0.99, side


def test_axis_is_the_published(published: tuple[Analysis, Path], golden_folder: Path) -> None:
    found, wanted = text(published[1], "rot_info"), golden(golden_folder, "rotated")["rot_info"]
    np.testing.assert_allclose(found[0], wanted[0], atol=1e-6)
    np.testing.assert_allclose(found[1] / np.hypot(*found[1]), wanted[1] / np.hypot(*wanted[1]), atol=1e-6)


def test_strain_is_the_published(published: tuple[Analysis, Path], golden_folder: Path) -> None:
    wanted = golden(golden_folder, "strain")
    for name in ("Frr", "Frc", "Fcr", "Fcc"):
        found = text(published[1], f"strain__beat0_{name}")
        assert found.shape == wanted[f"beat0_{name}"].shape == (15, 24)
        np.testing.assert_allclose(found, wanted[f"beat0_{name}"], atol=1e-3)
    for side in ("row", "col"):
        np.testing.assert_allclose(text(published[1], f"strain__beat0_{side}"), wanted[f"beat0_{side}"], atol=0.05)
    np.testing.assert_allclose(text(published[1], "strain__sub_domain_info")[:2], wanted["sub_domain_info"][:2])


def test_interpolation_at_sample_points_is_the_published(published: tuple[Analysis, Path], golden_folder: Path) -> None:
    """This tissue lies level, so the published points and displacements are those of the image."""
    result, _ = published
    wanted = golden(golden_folder, "interp_rotated")
    moved = result.displacement_at(wanted["sample_row_col"], method="thin_plate", extrapolate=True)[28:52]
    for k, side in enumerate(("row", "col")):
        expected = (wanted[f"beat0_{side}"] - wanted[f"beat0_{side}"][:, :1]).T
        away = np.abs(moved[..., k] - moved[0, :, k] - expected)
        assert np.quantile(away, 0.99) < 0.05, side  # ours starts from the mean state at rest
