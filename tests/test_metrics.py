"""Tables: their columns against the dictionary, and their numbers against a motion that is known."""

from dataclasses import replace

import numpy as np
import pytest

from microbundle.analysis import Analysis
from microbundle.axis import measure_axis
from microbundle.beats import find_beats
from microbundle.config import Config
from microbundle.data import Grid, Markers, Masks, Movie, Tracks
from microbundle.dictionary import IDENTITY, METRICS, columns
from microbundle.metrics import tables
from microbundle.numbers import beat_signal, synchrony
from microbundle.strain import measure_strain

from .known_pillars import with_pillars

PERIOD, WIDTH, SHORTENING = 24.5, 12.0, 0.04
FIRST = 9.25
OF_A_MOVIE = [m for m in METRICS if m.level != "trace"]  # see test_trace
STATISTICS = {"metric", "n", "mean", "se", "sd", "cv", "median", "low_95", "high_95", "interval"}


def contraction(count: int, delay: float = 0.0) -> np.ndarray:
    """Bell-shaped beats (T,) whose peaks lie at 9.25, 33.75, 58.25, ... between frames."""
    t = np.arange(count, dtype=float) - delay
    away = (t - FIRST + 0.5 * PERIOD) % PERIOD - 0.5 * PERIOD
    return np.cos(np.pi * np.clip(away / WIDTH, -0.5, 0.5)) ** 2


def measured(count: int = 124, fps: float | None = 30.0, um_per_px: float | None = 4.0, **changes) -> Analysis:
    """A strip that shortens along its axis by 4 % at each peak, tracked without error."""
    tissue = np.zeros((120, 260), bool)
    tissue[20:100, 10:250] = True
    masks = Masks(tissue, measure_axis(tissue), "supplied")
    X = np.stack(np.meshgrid(np.arange(22.0, 100, 6), np.arange(12.0, 250, 6), indexing="ij"), -1).reshape(-1, 2)
    x = np.repeat(X[None], count, axis=0)
    x[..., 1] -= SHORTENING * contraction(count)[:, None] * (X[:, 1] - 129.5)
    tracks = Tracks(x, np.ones(x.shape[:2], bool), "default", 21, 17)
    movie = Movie.from_array(np.zeros((count, 120, 260), np.uint8), fps=fps, um_per_px=um_per_px)
    config = Config.from_dict({"strain": {"tile_px": 30}})
    beats = find_beats(tracks, masks, movie, config)
    analysis = Analysis(
        name="strip", image=movie.frames[21], time_s=movie.time_s, time_source=movie.time_source,
        um_per_px=movie.um_per_px, um_per_px_source=movie.um_per_px_source, config=config, masks=masks,
        markers=Markers(X, 21, 0.01, 6.0, 36.0), tracks=tracks, beats=beats,
        grid=Grid(X[:1], (1, 1), np.zeros((count, 1, 2))), strain=measure_strain(tracks, beats, masks, config),
        movie_findings=(), files=(), input_hash="", versions={})
    return replace(analysis, **changes)


@pytest.fixture(scope="module")
def strip() -> Analysis:
    return measured()


@pytest.fixture(scope="module")
def full_analysis(tissue_analysis) -> Analysis:
    """A result with pillars and every setting that adds a metric."""
    analysis = with_pillars(tissue_analysis, noise_px=0.01, unloaded=((64.0, 15.5), (64.0, 176.0)))
    metrics = {"levels_pct": tuple(range(10, 100, 10)), "pacing_hz": 1.25, "fibre_deg": 10.0}
    settings = {"metrics": metrics, "pillars": analysis.config.pillars.model_dump()}
    return replace(analysis, config=Config.from_dict(settings))


def written(analysis: Analysis) -> set[str]:
    found = tables(analysis)
    names = {name for key, table in found.items() if "summary" not in key for name in table.columns}
    return names | set(found["summary"]["metric"])


def known(um_per_px: float | None, s_per_frame: float | None) -> set[str]:
    """Columns that the dictionary has for a calibration."""
    names = {name for m in OF_A_MOVIE for name, _ in columns(m, um_per_px, s_per_frame)}
    return names | errors(um_per_px, s_per_frame) | set(IDENTITY)


def errors(um_per_px: float | None, s_per_frame: float | None) -> set[str]:
    return {name for m in OF_A_MOVIE if m.error and m.level != "movie"
            for name, _ in columns(m, um_per_px, s_per_frame, error=True)}


@pytest.mark.parametrize("calibration", [(30.0, 4.0), (None, None), (30.0, None), (None, 4.0)])
def test_every_column_is_in_the_dictionary(calibration):
    fps, um_per_px = calibration
    assert written(measured(fps=fps, um_per_px=um_per_px)) <= known(um_per_px, None if fps is None else 1 / fps)


def test_every_entry_of_the_dictionary_is_written(full_analysis):
    assert known(4.0, 1 / 30) - written(full_analysis) == set()
    calibrated = ("time_frames", "missed_beats", "extra_beats", "stress", "force_shortening_loop")
    bare = {name for name in known(None, None) if not name.startswith(calibrated)}
    assert bare - written(replace(full_analysis, time_s=None, um_per_px=None)) == set()


def test_a_result_that_does_not_know_its_errors_has_no_columns_for_them(strip):
    assert written(strip) & errors(4.0, 1 / 30) == set()
    assert "mean_absolute_displacement_corrected_um" not in written(strip)
    assert tables(strip)["summary"]["se"].isna().all()


def test_summary_has_the_promised_statistics(strip):
    assert set(tables(strip)["summary"].columns) == STATISTICS


def test_parts_are_summed_up_as_the_tissue_is(full_analysis):
    found = tables(full_analysis)
    for part, key in (("subdomain", "E_cc_amplitude"), ("pillar", "force_amplitude_un")):
        summary = found[f"{part}_summary"]
        assert set(summary.columns) == STATISTICS | {part}
        row = summary[(summary["metric"] == key) & (summary[part] == summary[part].iloc[0])].iloc[0]
        each = found[f"{part}s"].query(f"complete and {part} == '{row[part]}'")[key]
        assert row["n"] == len(each.dropna())
        assert row["mean"] == pytest.approx(each.mean())
        assert row["sd"] == pytest.approx(each.std())
        assert 0 < row["se"] < abs(row["mean"])


def test_entries_are_unique_and_say_what_they_are():
    assert len({name for m in METRICS for name, _ in columns(m, None, 1.0)}) == len(METRICS)
    assert all(m.definition.endswith(".") for m in METRICS)


def test_period_and_rate_of_a_known_rhythm(strip):
    beats = tables(strip)["beats"]
    assert beats["complete"].sum() == 5
    np.testing.assert_allclose(beats["beat_period_s"][:-1], PERIOD / 30, rtol=2e-3)
    np.testing.assert_allclose(beats["beat_rate_hz"][:-1], 30 / PERIOD, rtol=2e-3)
    np.testing.assert_allclose(beats["beat_rate_bpm"][:-1], 1800 / PERIOD, rtol=2e-3)
    np.testing.assert_allclose(beats["peak_time_s"], (FIRST + PERIOD * np.arange(5)) / 30, atol=0.05 / 30)
    assert np.isnan(beats["beat_period_s"].iloc[-1])


def test_amplitude_is_the_mean_absolute_displacement(strip):
    x = strip.tracks.position_px[21]
    mean_px = SHORTENING * np.abs(x[:, 1] - 129.5).mean()
    beats = tables(strip)["beats"]
    np.testing.assert_allclose(beats["amplitude_px"], mean_px, rtol=0.05)
    np.testing.assert_allclose(beats["amplitude_um"], 4 * beats["amplitude_px"])


def test_strain_of_a_known_shortening(strip):
    beats, parts = (tables(strip)[name] for name in ("beats", "subdomains"))
    E_cc = 0.5 * ((1 - SHORTENING) ** 2 - 1)
    np.testing.assert_allclose(beats["e_cc_peak"], E_cc, rtol=0.05)
    np.testing.assert_allclose(parts["E_1"], parts["E_cc"], atol=1e-9)
    np.testing.assert_allclose(np.abs(parts["E_1_angle_deg"]), 0, atol=1e-3)
    np.testing.assert_allclose(parts["areal_strain"], parts["F_cc"] - 1, atol=1e-9)
    np.testing.assert_allclose(parts["shear_max"], -0.5 * parts["E_cc"], atol=1e-9)
    np.testing.assert_allclose(beats["e_cc_heterogeneity"], 0, atol=1e-9)
    assert (beats["extending_fraction"] == 0).all()
    np.testing.assert_allclose(beats["synchrony_sd_s"], 0, atol=1e-12)
    np.testing.assert_allclose(beats["synchrony_correlation"], 1)
    assert (beats["synchrony_sd_null_s"] > 0.02).all()


def test_without_calibration_lengths_are_px_and_times_frames():
    names = written(measured(fps=None, um_per_px=None))
    assert not [name for name in names if name.endswith(("_um", "_um2", "_s", "_hz", "_bpm"))]
    beats = tables(measured(fps=None, um_per_px=None))["beats"]
    np.testing.assert_allclose(beats["beat_period_frames"][:-1], PERIOD, rtol=2e-3)
    np.testing.assert_allclose(beats["beat_rate_per_frame"][:-1], 1 / PERIOD, rtol=2e-3)
    assert "time_s" not in tables(measured(fps=None))["frames"].columns


def test_gap_between_frames_lengthens_the_period_it_lies_in(strip):
    time_s = strip.time_s + np.where(np.arange(124) >= 45, 0.2, 0.0)
    beats = tables(replace(strip, time_s=time_s))["beats"]
    np.testing.assert_allclose(beats["beat_period_s"][:3], PERIOD / 30 + np.array([0, 0.2, 0]), rtol=3e-3)


def test_one_beat_has_no_spread_and_no_period():
    analysis = measured(24)
    summary = tables(analysis)["summary"].set_index("metric")
    assert analysis.beats.complete.sum() == 1
    assert summary.loc["amplitude_px", "n"] == 1
    assert summary.loc["beat_period_s", "n"] == 0
    assert np.isnan(summary.loc["beat_period_s", "mean"])
    assert summary.loc["amplitude_px", ["sd", "cv", "low_95", "high_95"]].isna().all()
    assert summary.loc["amplitude_px", "interval"] == ""


def test_spread_is_that_of_the_whole_beats(strip):
    beats, summary = tables(strip)["beats"], tables(strip)["summary"].set_index("metric")
    row = summary.loc["amplitude_px"]
    assert row["n"] == 5
    assert row["mean"] == pytest.approx(beats["amplitude_px"].mean())
    assert row["sd"] == pytest.approx(beats["amplitude_px"].std())
    assert row["high_95"] - row["mean"] == pytest.approx(2.776 * row["sd"] / np.sqrt(5), rel=1e-3)
    assert row["interval"] == "beat-to-beat spread"


def test_partial_beat_gives_no_numbers_for_the_summary():
    analysis = measured(63)  # ends in the middle of a beat
    beats, summary = tables(analysis)["beats"], tables(analysis)["summary"].set_index("metric")
    assert not beats["complete"].iloc[-1]
    assert summary.loc["amplitude_px", "n"] == beats["complete"].sum() == 2
    assert np.isnan(beats["e_cc_peak"].iloc[-1])


def test_still_movie_has_tables_without_beats(strip):
    count = strip.frame_count
    still = replace(strip.tracks, position_px=np.repeat(strip.tracks.position_px[21:22], count, axis=0))
    movie = Movie.from_array(np.zeros((count, 120, 260), np.uint8), fps=30)
    beats = find_beats(still, strip.masks, movie, strip.config)
    analysis = replace(strip, tracks=still, beats=beats,
                       strain=measure_strain(still, beats, strip.masks, strip.config))
    found = tables(analysis)
    assert analysis.verdict == "fail"
    assert len(found["beats"]) == len(found["subdomains"]) == 0
    assert len(found["frames"]) == count
    np.testing.assert_allclose(found["frames"]["mean_absolute_displacement_px"], 0, atol=1e-9)
    assert "tissue_width_um" in set(found["summary"]["metric"])


def test_no_strain_leaves_displacement(strip):
    found = tables(replace(strip, strain=None))
    assert len(found["subdomains"]) == len(found["strain"]) == 0
    assert found["beats"]["amplitude_px"].notna().all()


def test_tissue_size_is_that_of_the_mask(strip):
    summary = tables(strip)["summary"].set_index("metric")["mean"]
    assert summary["tissue_width_px"] == 80
    assert summary["tissue_length_um"] == 960
    assert summary["tissue_area_um2"] == 80 * 240 * 16
    assert summary["tissue_angle_deg"] == pytest.approx(0, abs=1e-6)


def test_signal_is_taken_from_each_beats_own_rest(strip):
    drifting = strip.tracks.position_px + np.linspace(0, 5, strip.frame_count)[:, None, None] * np.array([1.0, 0.0])
    tracks = replace(strip.tracks, position_px=drifting)
    movie = Movie.from_array(np.zeros((strip.frame_count, 120, 260), np.uint8), fps=30)
    analysis = replace(strip, tracks=tracks, beats=find_beats(tracks, strip.masks, movie, strip.config))
    moved, plain = (tables(a)["beats"]["amplitude_px"].mean() for a in (analysis, strip))
    assert moved == pytest.approx(plain, rel=0.15)
    assert beat_signal(analysis).max() < 1.3 * beat_signal(strip).max()


def test_synchrony_tells_together_from_delayed():
    t = np.arange(25.0)
    together = np.stack([np.exp(-((t - 12) / 3) ** 2)] * 6, axis=1)
    delayed = np.stack([np.exp(-((t - 9 - d) / 3) ** 2) for d in range(6)], axis=1)
    sd, of_period, null, correlation, _ = synchrony(together, t, 25.0)
    assert (sd, of_period, correlation) == (0, 0, pytest.approx(1))
    late = synchrony(delayed, t, 25.0)
    assert late[0] == pytest.approx(np.std(np.arange(6), ddof=1))
    assert late[1] == pytest.approx(late[0] / 25)
    assert null > late[0]
    assert late[3] < correlation
    assert np.isnan(synchrony(together[:, :1], t, 25.0)).all()
