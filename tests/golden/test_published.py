"""The method `paper` gives the published tool's numbers on the first 76 frames of a real movie.

Markers, tracks, beats, tiles, deformation gradients and interpolation agree to rounding. What differs on purpose: the
tissue axis of results under `default`, and the units in tables; see the docs on the method `paper`.
"""

import numpy as np
import pytest

import microbundle
from microbundle.field import interpolate
from microbundle.tiles import place_tiles

FRAMES = 76


@pytest.fixture(scope="module")
def analysis(data_folder):
    movie = microbundle.read_movie(data_folder / "type1_bright", fps=30, um_per_px=4)
    return microbundle.analyze(movie, microbundle.Config(method="paper", reading={"stop_frame": FRAMES}))


@pytest.fixture(scope="module")
def golden_tracks(golden_folder):
    with np.load(golden_folder / "mbc_tracks.npz") as golden:
        position = np.stack([golden["tracker_row"], golden["tracker_col"]], axis=-1).transpose(1, 0, 2)
        return {"position": position, **{name: golden[name] for name in golden}}


def test_markers_are_the_same(analysis, golden_tracks):
    assert len(analysis.markers) == 1143
    assert analysis.markers.spacing_px == 5
    np.testing.assert_array_equal(analysis.markers.position_px, golden_tracks["position"][0])


def test_tracks_agree(analysis, golden_tracks):
    assert analysis.tracks.window_px == 10
    away = np.hypot(*np.moveaxis(analysis.tracks.position_px - golden_tracks["position"], -1, 0))
    assert (away < 0.01).mean() >= 0.99
    np.testing.assert_allclose(analysis.beats.signal_px, golden_tracks["timeseries_mean_abs"], atol=2e-3)


def test_beats_are_the_same(analysis, golden_tracks):
    first_stop = np.stack([analysis.beats.start, analysis.beats.stop], axis=1)
    np.testing.assert_array_equal(first_stop, golden_tracks["info"][:, 1:])
    np.testing.assert_array_equal(analysis.beats.peak, golden_tracks["peaks"][1:-1])


def test_strain_agrees_tile_by_tile(analysis, golden_folder):
    with np.load(golden_folder / "mbc_strain.npz") as golden:
        F = np.stack([np.stack([golden["beat0_Frr"], golden["beat0_Frc"]], -1),
                      np.stack([golden["beat0_Fcr"], golden["beat0_Fcc"]], -1)], -2).transpose(1, 0, 2, 3)
        center = np.stack([golden["beat0_row"], golden["beat0_col"]], -1).transpose(1, 0, 2)
        E_cc = golden["beat0_Ecc"].T
        grid = tuple(golden["sub_domain_info"][0])
    beat = slice(28, 52)
    assert analysis.strain.grid == grid == (3, 5)
    np.testing.assert_allclose(analysis.strain.center_px[beat], center, atol=0.02)
    np.testing.assert_allclose(analysis.strain.F[beat], F, atol=1e-3)
    np.testing.assert_allclose(analysis.strain.E[beat, :, 1, 1], E_cc, atol=1e-3)
    assert analysis.strain.label[:6] == ("A1", "A2", "A3", "A4", "A5", "B1")


def test_tile_grid_is_the_published_one(analysis):
    tiling = place_tiles(analysis.masks, analysis.config)
    np.testing.assert_array_equal(tiling.corner, [202, 152])
    assert tiling.side == (40, 40)


def test_thin_plate_interpolation_agrees(analysis, golden_folder):
    beat = slice(28, 52)
    position = analysis.tracks.position_px[beat].astype(float)
    with np.load(golden_folder / "mbc_interp_rotated.npz") as golden:
        points = golden["sample_row_col"]
        expected = np.stack([golden["beat0_row"], golden["beat0_col"]], -1).transpose(1, 0, 2)
    moved = interpolate(position[0], position - position[0], points, method="thin_plate")
    np.testing.assert_allclose(points + moved, expected, atol=1e-3)


def test_metrics_are_those_published(analysis, tmp_path):
    published = np.loadtxt(microbundle.export_paper(analysis, tmp_path / "paper") / "results" / "beat_info.txt")
    assert published[1] == pytest.approx(5.318, rel=1e-3)
    # The tables' amplitude is that of the curve between frames.
    assert microbundle.tables(analysis)["beats"]["amplitude_um"].iloc[0] == pytest.approx(5.318, rel=5e-3)
    assert (analysis.beats.stop - analysis.beats.start)[0] / 30 == pytest.approx(1 / 1.25)


def test_default_and_paper_agree_on_what_both_can_see(data_folder):
    movie = microbundle.read_movie(data_folder / "type1_bright", fps=30, um_per_px=4)
    amplitude = {}
    for method in ("default", "paper"):
        result = microbundle.analyze(movie, microbundle.Config(method=method))
        summary = microbundle.tables(result)["summary"].set_index("metric")["mean"]
        amplitude[method] = summary["amplitude_um"]
    assert amplitude["default"] == pytest.approx(amplitude["paper"], rel=0.1)
