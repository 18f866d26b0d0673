"""Forces, work and loops against pillars whose motion is known, and against the published tool's on a real movie."""

from dataclasses import replace

import numpy as np
import pytest

from microbundle import Config, Movie, analyze, read_movie
from microbundle.config import PillarParams
from microbundle.contraction import rest_path
from microbundle.errors import ConfigError
from microbundle.force import forces, loop_areas, stiffness
from microbundle.metrics import tables
from microbundle.store import load, save

from .known_pillars import DEPTH, PEAK_PX, UM, K, with_pillars


@pytest.mark.parametrize("drift_px", [0.0, 0.03])
def test_forces_of_a_known_motion(tissue_analysis, drift_px):
    found = tables(with_pillars(tissue_analysis, drift_px=drift_px))
    first, second = (found["pillars"][found["pillars"]["pillar"] == name] for name in "12")
    for table, peak in ((first, PEAK_PX[0]), (second, PEAK_PX[1])):
        whole = table[table["complete"]]
        np.testing.assert_allclose(whole["deflection_um"], UM * peak, rtol=0.01)
        np.testing.assert_allclose(whole["force_amplitude_un"], K * UM * peak, rtol=0.01)
        np.testing.assert_allclose(whole["force_axis_un"], K * UM * peak, rtol=0.02)
        np.testing.assert_allclose(whole["work_nj"], 1e-3 * 0.5 * K * (UM * peak) ** 2, rtol=0.02)
        np.testing.assert_allclose(whole["force_cd50_s"], 6 / 30, rtol=0.02)
        np.testing.assert_allclose(whole["force_row_un"], 0, atol=0.05)
    beats = found["beats"][found["beats"]["complete"]]
    mean = K * UM * np.mean(PEAK_PX)
    np.testing.assert_allclose(beats["twitch_force_un"], mean, rtol=0.01)
    np.testing.assert_allclose(beats["imbalance"], 0.2, atol=0.005)
    width_um = tissue_analysis.masks.axis.width_center_px * UM
    np.testing.assert_allclose(beats["stress_rectangle_kpa"], 1e3 * mean / (width_um * DEPTH), rtol=0.01)
    np.testing.assert_allclose(beats["stress_ellipse_kpa"], 4 / np.pi * beats["stress_rectangle_kpa"])


def test_resting_force_is_from_the_unloaded_position(tissue_analysis):
    unloaded = ((64.0, 15.5), (64.0, 176.0))  # the left pillar is bent inward by half a pixel, the right one not
    analysis = with_pillars(tissue_analysis, unloaded=unloaded)
    first, second = (tables(analysis)["pillars"].query(f"pillar == '{name}' and complete") for name in "12")
    np.testing.assert_allclose(first["resting_force_un"], 0.5 * K * UM, rtol=1e-3)
    np.testing.assert_allclose(second["resting_force_un"], 0, atol=1e-6)
    np.testing.assert_allclose(first["work_nj"], 1e-3 * 0.5 * K * ((2.0 * UM) ** 2 - (0.5 * UM) ** 2), rtol=0.02)
    assert "resting_force_un" not in tables(with_pillars(tissue_analysis))["pillars"]


def test_standard_errors_grow_with_the_noise_of_the_pillars(tissue_analysis):
    quiet, noisy = (tables(with_pillars(tissue_analysis, noise_px=s))["pillars"]["force_amplitude_se_un"].mean()
                    for s in (0.01, 0.04))
    assert 2 < noisy / quiet < 8
    assert noisy == pytest.approx(0.04 * K * UM, rel=0.5)


def test_budget_lists_every_source(tissue_analysis):
    budget = tables(with_pillars(tissue_analysis, noise_px=0.01))["budget"].set_index(["quantity", "source"])["se_pct"]
    force = budget.loc["twitch_force"]
    assert force["stiffness"] == 5.0
    assert np.isnan(force["pixel size"])
    parts = force.drop("total of what is known").dropna()
    assert len(parts) == 3
    assert force["total of what is known"] == pytest.approx(np.sqrt((parts**2).sum()))
    assert "depth" in budget.loc["stress_ellipse"]


def test_without_stiffness_or_pixel_size_there_is_deflection_but_no_force(tissue_analysis):
    analysis = replace(with_pillars(tissue_analysis), config=Config())
    found = tables(analysis)
    assert found["pillars"]["force_amplitude_un"].isna().all()
    assert found["pillars"]["deflection_um"].notna().all()
    assert len(found["budget"]) == 0
    assert tables(replace(with_pillars(tissue_analysis), um_per_px=None))["pillars"]["force_amplitude_un"].isna().all()


def test_stiffness_from_geometry_is_that_of_a_cantilever():
    beam = {"modulus_mpa": 1.61, "width_um": 163.0, "thickness_um": 33.2, "length_um": 199.3, "force_height_um": 163.0}
    inertia = 163.0 * 33.2**3 / 12
    assert stiffness(PillarParams(**beam)) == pytest.approx(6 * 1.61 * inertia / (163.0**2 * (3 * 199.3 - 163.0)))
    tip = {**beam, "force_height_um": None}
    assert stiffness(PillarParams(**tip)) == pytest.approx(3 * 1.61 * inertia / 199.3**3)
    circle = PillarParams(profile="circle", modulus_mpa=1.0, diameter_um=400.0, length_um=1000.0)
    assert stiffness(circle) == pytest.approx(3 * np.pi * 400.0**4 / 64 / 1000.0**3)
    assert stiffness(PillarParams(modulus_mpa=1.0, length_um=10.0)) is None
    assert stiffness(PillarParams(stiffness_un_per_um=3.0, **beam)) == 3.0


def test_loop_is_the_integral_of_force_over_length(tissue_analysis):
    """In phase there is no loop; with a delay d the ellipse-like loop has a known area."""
    t = np.arange(tissue_analysis.frame_count)

    def course(lag):
        since = (t - 4 - lag) % 24
        return np.where((since < 12) & (t >= 4 + lag), np.sin(np.pi * since / 12) ** 2, 0.0)

    whole = tissue_analysis.beats.complete
    np.testing.assert_allclose(loop_areas(tissue_analysis, course(0), course(0))[whole], 0, atol=1e-6)
    fine = np.linspace(0, 24, 20_001)
    x, y = (np.where((s := fine - lag) % 24 < 12, np.sin(np.pi * (s % 24) / 12) ** 2, 0.0) for lag in (0, 2))
    exact = float(np.trapezoid(y, x))
    found = loop_areas(tissue_analysis, course(0), course(2))[whole]
    np.testing.assert_allclose(found[:-1], exact, rtol=0.03)
    np.testing.assert_allclose(loop_areas(tissue_analysis, course(2), course(0))[whole][:-1], -exact, rtol=0.03)


def test_rest_path_follows_the_rests():
    relaxed = np.zeros(30, bool)
    relaxed[[0, 1, 2, 12, 13, 27, 28, 29]] = True
    values = 0.1 * np.arange(30)[:, None] + np.where(relaxed, 0, 5)[:, None]
    np.testing.assert_allclose(rest_path(values, relaxed, np.arange(30.0))[1:28, 0], 0.1 * np.arange(1, 28), atol=0.06)
    assert not rest_path(values, np.zeros(30, bool), np.arange(30.0)).any()


def test_pillars_survive_saving(tissue_analysis, tmp_path):
    analysis = with_pillars(tissue_analysis, noise_px=0.01)
    again = load(save(analysis, tmp_path / "result"))
    np.testing.assert_allclose(again.pillars.shift_px, analysis.pillars.shift_px)
    assert again.pillars.pillars.names == ("1", "2")
    assert (tmp_path / "result" / "pillars.csv").is_file()
    one, other = tables(analysis)["pillars"], tables(again)["pillars"]
    np.testing.assert_allclose(other.select_dtypes("number"), one.select_dtypes("number"), rtol=1e-4, atol=1e-6)


@pytest.fixture(scope="module")
def bright(data_folder):
    """The real movie with the paper's stiffness and the masks of its authors, by both methods."""
    movie = read_movie(data_folder / "type1_bright", fps=30, um_per_px=UM)
    settings = {"pillars": {"stiffness_un_per_um": K, "masks": "supplied"}}
    return {method: analyze(movie, Config.from_dict({**settings, "method": method}))
            for method in ("accurate", "paper")}


def test_published_forces(bright, golden_folder):
    golden = np.load(golden_folder / "mbc_pillar.npz")
    found = forces(bright["paper"])
    for p in (0, 1):
        published = golden[f"pillar{p + 1}_force_abs"]
        ours = np.hypot(*found.deflection_px[:, p].T) * found.un_per_px
        assert ours.max() == pytest.approx(published.max(), rel=0.01)
        np.testing.assert_allclose(ours, published, atol=0.03 * published.max())


def test_accurate_forces_are_near_the_published_ones(bright):
    """The published mean over the mask takes in its rim, which moves less: it lies below, by hardly more than the
    error."""
    accurate, paper = (tables(bright[m])["pillars"].query("complete").groupby("pillar")["force_amplitude_un"].mean()
                       for m in ("accurate", "paper"))
    np.testing.assert_allclose(accurate, paper, rtol=0.12)
    error = tables(bright["accurate"])["pillars"].groupby("pillar")["force_amplitude_se_un"].mean()
    assert (error < 0.05 * accurate).all()
    assert (np.abs(accurate - paper) < 3 * error).all()


def test_unloaded_positions_must_name_each_pillar(tissue_array):
    """Three positions for two pillars are an error, not a resting force that is missing."""
    movie = Movie.from_array(tissue_array, fps=30, um_per_px=UM)
    head = np.zeros((2, *movie.shape), bool)
    head[0, 54:75, 40:61], head[1, 54:75, 130:151] = True, True
    supplied = replace(movie, supplied_masks={"pillar_1": head[0], "pillar_2": head[1]})
    positions = {"pillars": {"unloaded_px": [[1.0, 2.0]] * 3}}
    with pytest.raises(ConfigError, match="each of the 2 pillars"):
        analyze(supplied, Config.from_dict(positions))
