"""Cutting contraction signals whose beats are known."""

import numpy as np
import pytest

from microbundle.beats import Cut, cut_signal, find_beats
from microbundle.config import BeatParams, Config
from microbundle.contraction import contraction_signal, frame_noise, rest_weights
from microbundle.data import Masks, Movie, TissueAxis, Tracks

AMPLITUDE_PX = 2.0


def twitches(onsets, length, count, heights=None, rise=0.36) -> np.ndarray:
    """Contraction (T,) of twitches that start at the onsets and last `length` frames, fast up and slowly down."""
    t = np.arange(count, dtype=float)
    signal = np.zeros(count)
    for onset, height in zip(onsets, heights if heights is not None else np.ones(len(onsets)), strict=True):
        phase = (t - onset) / length
        up, down = np.clip(phase / rise, 0, 1), np.clip((1 - phase) / (1 - rise), 0, 1)
        signal += AMPLITUDE_PX * height * np.sin(np.pi / 2 * np.minimum(up, down)) ** 2
    return signal


def noisy(signal, sd, seed=0) -> np.ndarray:
    return signal + sd * np.random.default_rng(seed).normal(size=len(signal))


def cut(signal, **params) -> Cut:
    found, _ = cut_signal(signal, frame_noise(signal), BeatParams(**params))
    return found


def whole(found: Cut) -> np.ndarray:
    """Peaks of the whole beats."""
    return np.array(found.peak)[np.array(found.complete, bool)]


def check_order(found: Cut, count: int) -> None:
    for start, peak, stop in zip(found.start, found.peak, found.stop, strict=True):
        assert 0 <= start <= peak < stop <= count
    assert all(stop <= start for stop, start in zip(found.stop[:-1], found.start[1:], strict=True))
    assert len(found.rests) == len(found.complete) == len(found.peak)


@pytest.mark.parametrize("period", [8, 12, 24, 40, 60])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_regular_beats_are_found_at_any_frame_rate_and_noise(period, noise, seed):
    count = 6 * period
    onsets = 0.3 * period + period * np.arange(6)
    signal = noisy(twitches(onsets, 0.6 * period, count), noise, seed)
    found = cut(signal)
    check_order(found, count)
    expected = (onsets + 0.36 * 0.6 * period)[:5]
    assert len(whole(found)) in (5, 6)  # the movie ends within the rest after the sixth
    np.testing.assert_allclose(whole(found)[:5], expected, atol=1 + 0.08 * period)


@pytest.mark.parametrize("seed", range(5))
def test_irregular_rhythm_is_followed(seed):
    rng = np.random.default_rng(seed)
    onsets = 8 + np.cumsum(rng.uniform(16, 45, 8))
    count = int(onsets[-1]) + 30
    found = cut(noisy(twitches(onsets, 13, count), 0.03, seed))
    check_order(found, count)
    np.testing.assert_allclose(found.peak, onsets + 0.36 * 13, atol=2)
    assert all(found.complete)


def test_alternans_keeps_the_small_beats():
    onsets = 5 + 24 * np.arange(6)
    found = cut(noisy(twitches(onsets, 13, 150, heights=[1, 0.5, 1, 0.5, 1, 0.5]), 0.02))
    assert len(whole(found)) == 6


def test_paced_beats_with_long_rests_do_not_take_the_rests_along():
    onsets = 40 + 100 * np.arange(4)
    found = cut(noisy(twitches(onsets, 15, 460), 0.03))
    np.testing.assert_allclose(found.peak, onsets + 5.4, atol=1.5)
    assert all(found.complete)
    for start, onset in zip(found.start, onsets, strict=True):
        assert start <= onset + 2
    assert found.start[0] >= 0
    assert found.stop[-1] <= 460


@pytest.mark.parametrize("count", [40, 80])
def test_one_beat_is_enough(count):
    found = cut(noisy(twitches([12], 14, count), 0.02))
    assert found.complete == [True]
    assert found.peak[0] == pytest.approx(17, abs=1)
    assert found.start[0] <= 13
    assert found.stop[0] >= 24


def test_contracted_start_and_cut_end_are_marked():
    onsets = -5 + 24 * np.arange(5)  # starts at the peak, ends on the way up
    count = int(onsets[-1]) + 4
    found = cut(noisy(twitches(onsets, 13, count), 0.02))
    check_order(found, count)
    assert found.complete == [False, True, True, True, False][:len(found.complete)]
    assert len(whole(found)) == 3
    np.testing.assert_allclose(whole(found), onsets[1:4] + 4.7, atol=1.5)


@pytest.mark.parametrize("drift", [0.3, 1.0, 2.0])
def test_drift_of_the_rest_does_not_hide_beats(drift):
    """Drift over the whole movie, as a share of the beats' height."""
    onsets = 6 + 24 * np.arange(8)
    signal = twitches(onsets, 13, 198) + np.linspace(0, drift * AMPLITUDE_PX, 198)
    found = cut(noisy(signal, 0.03))
    np.testing.assert_allclose(found.peak, onsets + 4.7, atol=1.5)
    assert sum(found.complete) >= 7


def test_noise_alone_is_hardly_ever_a_beat():
    alarms = 0
    for seed in range(400):
        rng = np.random.default_rng(seed)
        signal = rng.normal(0, rng.choice([0.01, 0.1, 1.0]), rng.choice([50, 100, 300]))
        alarms += bool(cut(signal).peak)
    assert alarms / 400 < 0.02


def test_noise_of_tracked_points_is_hardly_ever_a_beat():
    alarms = 0
    x = np.stack(np.meshgrid(np.arange(0, 60, 6.0), np.arange(0, 120, 6.0), indexing="ij"), -1).reshape(-1, 2)
    for seed in range(300):
        rng = np.random.default_rng(seed)
        u = rng.normal(0, 0.05, (rng.choice([40, 80, 120]), len(x), 2))
        alarms += bool(cut(contraction_signal(u, x, np.array([0.0, 1.0]))).peak)
    assert alarms / 300 < 0.02


def test_too_short_flat_and_monotonous_signals_say_why():
    for signal, word in ((np.zeros(4), "4 frames"), (np.linspace(0, 3, 60), "no peak")):
        found, without = cut_signal(signal, frame_noise(signal), BeatParams())
        assert not found.peak
        assert word in without.why
        assert not without.still
    found, without = cut_signal(np.zeros(60), 0.0, BeatParams())
    assert not found.peak
    assert without.still


def test_settings_leave_out_small_and_close_peaks():
    signal = twitches([10, 40, 70], 13, 100, heights=[1, 0.4, 1])
    assert len(cut(signal).peak) == 3
    assert len(cut(signal, min_amplitude_px=1.0).peak) == 2
    found, _ = cut_signal(signal, 0.0, BeatParams(min_period_s=1.5), frames_per_s=30.0)
    assert len(found.peak) == 2


def test_frame_noise_is_that_of_the_quiet_frames():
    rng = np.random.default_rng(3)
    assert frame_noise(rng.normal(0, 0.2, 4000)) == pytest.approx(0.2, rel=0.1)
    beating = twitches(5 + 40 * np.arange(20), 14, 800) + rng.normal(0, 0.05, 800)
    assert frame_noise(beating) == pytest.approx(0.05, rel=0.3)
    assert np.isnan(frame_noise(np.zeros(3)))


def tracked(signal, drift_px=0.0, seed=0) -> tuple[Tracks, Masks, Movie]:
    """Points of a strip that shortens by the signal towards its middle, on a stage that drifts steadily."""
    x = np.stack(np.meshgrid(np.arange(20, 60, 8.0), np.arange(20, 140, 8.0), indexing="ij"), -1).reshape(-1, 2)
    u = np.zeros((len(signal), len(x), 2))
    u[..., 1] = -np.asarray(signal)[:, None] * (x[:, 1] - 76) / 60
    u += np.linspace(0, 1, len(signal))[:, None, None] * np.array([drift_px, 0])
    u += np.random.default_rng(seed).normal(0, 0.01, u.shape)
    tissue = np.zeros((80, 160), bool)
    tissue[15:65, 15:145] = True
    axis = TissueAxis(np.array([40.0, 80.0]), np.array([0.0, 1.0]), 130.0, 50.0, 50.0, 0.0)
    movie = Movie.from_array(np.zeros((len(signal), 80, 160), np.uint8), fps=30)
    return (Tracks(x + u, np.ones(u.shape[:2], bool), "default", 0, 17), Masks(tissue, axis, "supplied"), movie)


def test_each_beat_has_its_own_rest_and_drift_is_told():
    tracks, masks, movie = tracked(twitches(6 + 24 * np.arange(5), 13, 126), drift_px=3.0)
    beats = find_beats(tracks, masks, movie, Config())
    assert beats.complete.sum() == 5
    step = np.diff(beats.drift_px[:, 0])
    np.testing.assert_allclose(step[1:], 3.0 * 24 / 126, atol=0.03)  # the rest before the first beat is shorter
    assert "drift" in {f.key for f in beats.findings}
    assert np.isfinite(beats.beat_relaxed_px).all()


def test_rest_is_where_nothing_moves():
    signal = twitches(6 + 24 * np.arange(5), 13, 126)
    beats = find_beats(*tracked(signal), Config())
    assert signal[beats.relaxed].max() < 0.15 * AMPLITUDE_PX
    assert beats.relaxed.sum() > 30


def test_markers_that_are_often_lost_do_not_disturb():
    tracks, masks, movie = tracked(twitches(6 + 24 * np.arange(4), 13, 102))
    ok = tracks.ok.copy()
    ok[::2, :7] = ok[1::3, :7] = False
    ok[:, 8] = False
    position = np.where(ok[..., None], tracks.position_px, np.nan)
    beats = find_beats(Tracks(position, ok, "default", 0, 17), masks, movie, Config())
    assert beats.complete.sum() == 4
    assert np.isfinite(beats.signal_px).all()
    assert np.isnan(beats.relaxed_px[8]).all()


def test_still_tissue_has_no_beat_and_says_so():
    beats = find_beats(*tracked(np.zeros(60)), Config())
    assert len(beats) == 0
    assert [(f.key, f.level) for f in beats.findings] == [("no_measurable_motion", "fail")]
    assert beats.relaxed.all()


def test_published_method_on_too_few_peaks_says_what_it_needs():
    beats = find_beats(*tracked(twitches([6, 30], 13, 60)), Config(method="paper"))
    assert len(beats) == 0
    assert "three peaks" in beats.findings[0].message


def test_rest_is_taken_at_the_peak_however_long_the_rests_are():
    relaxed = np.zeros(60, bool)
    relaxed[[*range(20), 38, 39]] = True  # 20 frames of rest before the beat, two after it
    drift = 5 + 0.3 * np.arange(60)
    weights = rest_weights(relaxed, np.array([29]))
    np.testing.assert_allclose(weights @ drift, drift[29])
    assert weights[0, ~relaxed].sum() == 0
    one_side = rest_weights(np.arange(60) < 20, np.array([29, 50]))
    np.testing.assert_allclose(one_side, np.repeat((np.arange(60) < 20)[None] / 20, 2, axis=0))


def test_steady_drift_does_not_change_a_beats_height():
    signal = twitches(6 + 24 * np.arange(5), 13, 126)
    heights = []
    for drift_px in (0.0, 4.0):
        tracks, masks, movie = tracked(signal, drift_px=drift_px)
        beats = find_beats(tracks, masks, movie, Config())
        peak = tracks.position_px[beats.peak] - beats.beat_relaxed_px
        heights.append(np.hypot(peak[..., 0], peak[..., 1]).mean(axis=1)[1:-1])
    np.testing.assert_allclose(heights[1], heights[0], rtol=0.01)
