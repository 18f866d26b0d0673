"""Faults made on purpose are found, a good movie is not accused, and odd movies are no trouble."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import microbundle
from microbundle import read_movie
from microbundle.analysis import Analysis
from microbundle.appearance import MOST_FRAMES, frames_to_look_at, look
from microbundle.config import Config, MaskParams
from microbundle.data import Beats, Finding, Movie, Tracks
from microbundle.mask import find_masks
from microbundle.pipeline import analyze
from microbundle.quality import check_movie, repeats
from microbundle.quality_result import check_result, opposite_quarters, upstroke_frames
from microbundle.synth import faults
from microbundle.synth.cases import CLEAN_LARGE, Case, camera
from microbundle.synth.scenes import Analytic


@pytest.fixture(scope="module")
def good():
    """A movie without faults, and its masks."""
    scene = Analytic(0.8, 7, shape=(128, 224), frames=50, side_px=40.0)
    movie = Case("good", CLEAN_LARGE, scene, camera(7)).make().drawn().movie
    return movie, find_masks(movie, MaskParams())


def levels(findings: tuple[Finding, ...]) -> dict[str, str]:
    return {f.key: f.level for f in findings}


def bright_end(movie: Movie, masks, share: float) -> float:
    return float(np.quantile(movie.frames[0][masks.tissue], 1 - share))


FAULTS = {
    "blurred": lambda m, _: faults.blurred(m, 3.0),
    "focus_drift": lambda m, _: faults.losing_focus(m, 1.0),
    "low_contrast": lambda m, _: faults.faded(m, 0.01, 8.0),
    "few_grey_levels": lambda m, _: faults.posterised(m, 400.0),
    "saturated": lambda m, k: faults.clipped(m, 0, bright_end(m, k, 0.1)),
    "flicker": lambda m, _: faults.flickering(m, 0.03),
    "flash": lambda m, _: faults.flashing(m, [20], 0.2),
    "brightness_drift": lambda m, _: faults.dimming(m, 0.2),
    "repeated_frames": lambda m, _: faults.repeating(m, [20, 33]),
    "dropped_frames": lambda m, _: faults.without_frames(m, [20, 21]),
    "calibration_unknown": lambda m, _: replace(m, um_per_px=None),
}
TAKEN_OUT = {"flicker", "flash", "brightness_drift"}


@pytest.mark.parametrize("key", FAULTS)
def test_fault_of_the_frames_is_found_and_no_other(good, key):
    movie, masks = good
    found = check_movie(FAULTS[key](movie, masks), masks)
    assert [f.key for f in found] == [key]
    assert found[0].level == ("info" if key in TAKEN_OUT | {"calibration_unknown"} else "review")
    assert found[0].value is not None
    assert found[0].limit is not None
    low_is_bad = key in ("blurred", "low_contrast", "few_grey_levels")
    assert (found[0].value < found[0].limit) == low_is_bad


@pytest.mark.parametrize("method", ["accurate", "fast", "paper"])
def test_good_movie_is_not_accused(good, method):
    assert check_movie(*good, method) == ()


@pytest.mark.parametrize("key", sorted(TAKEN_OUT))
def test_paper_does_not_cope_with_changing_light(good, key):
    movie, masks = good
    assert levels(check_movie(FAULTS[key](movie, masks), masks, "paper")) == {key: "review"}


def test_numbers_of_findings(good):
    movie, masks = good

    def only(fault):
        (finding,) = check_movie(fault, masks)
        return finding
    assert only(faults.repeating(movie, [20, 33, 34])).value == 3
    assert only(faults.without_frames(movie, [20, 21, 30])).value == 3
    assert only(faults.flashing(movie, [5, 20], -0.2)).value == 2
    assert only(faults.dimming(movie, 0.3)).value == pytest.approx(0.35, abs=0.04)  # of the median
    assert only(faults.clipped(movie, bright_end(movie, masks, 0.98), 4095)).value == pytest.approx(0.02, abs=0.01)
    assert only(faults.flickering(movie, 0.05, 3)).value == pytest.approx(0.05, rel=0.4)


def test_blur_is_told_from_low_contrast_and_dim_light(good):
    movie, masks = good
    sharp, grey, soft = (look(m, masks.tissue).texture.sharpness for m in (
        movie, faults.faded(movie, 0.05, 5.0), faults.blurred(movie, 1.5)))
    assert grey == pytest.approx(sharp, rel=0.1)
    assert soft < 0.3 * sharp


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int16, np.float32, np.float64])
def test_number_type_of_the_frames_does_not_matter(good, dtype):
    movie, masks = good
    array = np.stack([movie.frames[t] for t in range(30)]).astype(float)
    array = array / 16 if dtype == np.uint8 else array / 4095 - 0.5 if np.issubdtype(dtype, np.floating) else array
    assert check_movie(Movie.from_array(array.astype(dtype), fps=30, um_per_px=4), masks) == ()


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_few_frames(good, count):
    movie, masks = good
    assert check_movie(faults.without_frames(movie, range(count, movie.count)), masks) == ()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("value", [0, 7])
def test_constant_frames_have_no_grey_levels_and_repeat_nothing(good, dtype, value):
    masks = good[1]
    movie = Movie.from_array(np.full((12, *masks.tissue.shape), value, dtype), fps=30, um_per_px=4)
    found = check_movie(movie, masks)
    assert {f.key for f in found} == {"few_grey_levels", "saturated"}


def test_blank_frames_and_other_pictures(good):
    movie, masks = good
    array = np.stack([movie.frames[t] for t in range(movie.count)])
    array[[0, 20, 21, 22]] = 3000
    array[30] = array[30, ::-1, ::-1]
    found = levels(check_movie(Movie.from_array(array, fps=30, um_per_px=4), masks))
    assert "blurred" not in found
    assert "repeated_frames" in found


def test_tissue_at_the_border_or_all_over_or_tiny(good):
    movie, masks = good
    for part in (np.s_[:, :], np.s_[:60, :], np.s_[-50:, -90:], np.s_[40:52, 80:92]):
        tissue = np.zeros(movie.shape, bool)
        tissue[part] = True
        assert "repeated_frames" in levels(check_movie(faults.repeating(movie, [20]), replace(masks, tissue=tissue)))
        check_movie(movie, replace(masks, tissue=tissue))


def test_drawn_movie_without_noise_may_rest():
    scene = Analytic(0.8, 8, shape=(128, 224), frames=40, side_px=40.0)
    movie = Case("drawn", CLEAN_LARGE, scene).make().drawn().movie
    assert check_movie(movie, find_masks(movie, MaskParams())) == ()


def test_repeats_need_steady_noise():
    steady = np.array([np.nan, 5.0, 5.2, 0.0, 4.9, 5.1, 0.1, 5.0])
    assert np.flatnonzero(repeats(steady)).tolist() == [3, 6]
    assert not repeats(np.abs(np.sin(np.arange(40) / 4))).any()
    assert not repeats(np.zeros(20)).any()
    assert not repeats(np.array([np.nan, 1.0, 0.0])).any()


@pytest.mark.parametrize("count", [1, 5, MOST_FRAMES, MOST_FRAMES + 1, 3000, 100_000])
def test_long_movies_are_looked_at_in_runs(count):
    frames = frames_to_look_at(count)
    assert len(frames) == min(len(frames), count, MOST_FRAMES)
    assert len(frames) >= min(count, MOST_FRAMES - 5)
    assert (frames[0], frames[-1]) == (0, count - 1)
    assert (np.diff(frames) > 0).all()


# --- results --------------------------------------------------------------------------------------------------------


def judged(analysis: Analysis, method="accurate", **changes) -> dict[str, str]:
    parts = {"tracks": analysis.tracks, "beats": analysis.beats, "strain": analysis.strain} | changes
    still = Movie.from_array(np.stack([analysis.image] * analysis.frame_count))
    return levels(check_result(still, analysis.masks, parts["tracks"], parts["beats"], parts["strain"], method))


def test_good_result_has_no_finding(tissue_analysis):
    assert judged(tissue_analysis) == {}
    assert tissue_analysis.verdict == "pass"


def test_sub_pixel_motion_depends_on_the_method(tissue_analysis):
    beats = replace(tissue_analysis.beats, signal_px=0.3 * tissue_analysis.beats.signal_px)
    assert judged(tissue_analysis, beats=beats) == {"sub_pixel_motion": "info"}
    assert judged(tissue_analysis, "fast", beats=beats) == {"sub_pixel_motion": "review"}


def test_residual_at_the_peaks_beyond_that_at_rest(tissue_analysis):
    tracks = tissue_analysis.tracks
    residual = np.full_like(tracks.residual, 0.6)
    assert judged(tissue_analysis, tracks=replace(tracks, residual=residual)) == {}
    residual[tissue_analysis.beats.peak] = 0.9
    assert judged(tissue_analysis, tracks=replace(tracks, residual=residual)) == {"large_residual": "review"}


def test_focus_that_follows_the_beat(tissue_analysis, tissue_movie):
    parts = tissue_analysis.masks, tissue_analysis.tracks, tissue_analysis.beats, None
    assert check_result(tissue_movie, *parts) == ()
    leaves = faults.blurred_in_step(tissue_movie, tissue_analysis.beats.signal_px)
    assert levels(check_result(leaves, *parts)) == {"focus_with_beat": "review"}


def test_lost_peaks(tissue_analysis):
    tracks, beats = tissue_analysis.tracks, tissue_analysis.beats

    def without(*frames):
        ok, signal = tracks.ok.copy(), beats.signal_px.copy()
        ok[list(frames)], signal[list(frames)] = False, np.nan
        return judged(tissue_analysis, tracks=replace(tracks, ok=ok), beats=replace(beats, signal_px=signal))
    assert without(0, 24) == {}
    assert without(beats.peak[0] + 1) == {"peaks_lost": "review"}
    assert without(*beats.peak) == {"peaks_lost": "fail"}
    assert without(*beats.peak, *(beats.peak - 3)) == {"peaks_lost": "fail"}


def test_forward_backward(tissue_analysis):
    tracks = tissue_analysis.tracks
    for miss, keys in ((0.02, {}), (0.3, {"forward_backward": "review"})):
        misses = np.full(tracks.position_px.shape[1], miss)
        assert judged(tissue_analysis, tracks=replace(tracks, forward_backward_px=misses)) == keys


def made_of(signal: np.ndarray, peaks, period: int, markers: int = 4) -> Beats:
    peaks = np.array(peaks)
    return Beats(signal, 0.0, peaks - period // 2, peaks, peaks + period // 2, np.ones(len(peaks), bool),
                 np.arange(len(signal)) < 2, np.zeros((markers, 2)), np.zeros((len(peaks), markers, 2)), "default")


def test_slow_frames_and_irregular_beats(tissue_analysis):
    t = np.arange(120)

    def timing(period, peaks=None):
        peaks = np.arange(period, 120 - period, period) if peaks is None else np.array(peaks)
        away = np.abs(t[:, None] - peaks).min(axis=1)
        beats = made_of(3 * np.clip(1 - away / (period / 3), 0, None), peaks, period)
        tracks = replace(tissue_analysis.tracks, residual=None)
        return judged(tissue_analysis, tracks=tracks, beats=beats, strain=None)
    assert timing(24) == {}
    assert timing(6) == {"slow_frames": "review"}
    assert timing(20, [20, 42, 60, 92]) == {"irregular_beats": "info"}


def test_upstroke_is_counted_in_parts_of_frames():
    assert upstroke_frames(np.array([0.0, 0, 0, 1, 2, 3, 4, 5])) == pytest.approx(4.5)
    assert upstroke_frames(np.array([3.0, 5.0])) == pytest.approx(0.9)
    assert upstroke_frames(np.array([5.0])) == 0.0
    assert upstroke_frames(np.array([2.0, 2.0])) == 0.0


def test_subdomains_without_strain(tissue_analysis):
    strain = tissue_analysis.strain
    names = len(strain.label)
    one = replace(strain, reason=("too few markers", *[""] * (names - 1)))
    assert judged(tissue_analysis, strain=one) == {"subdomains_without_strain": "info"}
    every = replace(strain, reason=("too few markers",) * names)
    assert judged(tissue_analysis, strain=every) == {"subdomains_without_strain": "review"}


def test_opposite_quarters():
    rng = np.random.default_rng(0)
    points = rng.uniform([10, 20], [50, 60], (60, 2))
    corners = np.array([[10.0, 20], [10, 60], [50, 60], [50, 20]])
    x, y = points[:, 1] - 40, points[:, 0] - 30

    def along(u, noise=0.0):
        return opposite_quarters(points, np.stack([0 * u, u + noise * rng.standard_normal(len(u))], axis=1), corners)
    assert along(0.02 * np.abs(x))  # one half shortens, the other lengthens
    assert along(0.02 * np.sign(y) * x)  # the same across
    assert not along(-0.03 * x)  # the displacement changes its sign, the strain does not
    assert not along(-0.03 * x + 0.005 * np.abs(x))
    assert not along(0.0 * x, noise=0.3)
    assert not opposite_quarters(points[:3], points[:3], corners)


def test_paper_says_that_a_movie_starts_contracted(tissue_analysis):
    tracks = tissue_analysis.tracks
    kept = Tracks(tracks.position_px, tracks.ok, "paper", 0, 5)
    assert "contracted_start" not in judged(tissue_analysis, "paper", tracks=kept)
    late = Tracks(tracks.position_px[10:], tracks.ok[10:], "paper", 0, 5)  # a peak
    assert judged(tissue_analysis, "paper", tracks=late)["contracted_start"] == "review"
    assert "contracted_start" not in judged(tissue_analysis, tracks=late)  # the beats say so themselves


def test_findings_reach_the_verdict(good):
    movie, masks = good
    found = analyze(faults.repeating(movie, [20]), Config(method="fast"), masks=masks)
    assert "repeated_frames" in levels(found.findings)
    assert found.verdict == "review"


def test_real_movies(data_folder):
    for name in ("type1_bright", "type1_dark"):
        movie = read_movie(data_folder / name, fps=30, um_per_px=4)
        assert check_movie(movie, find_masks(movie, MaskParams())) == ()


def test_guide_lists_every_finding():
    guide = (Path(__file__).parents[1] / "docs" / "guide.md").read_text(encoding="utf-8")
    source = "".join(file.read_text(encoding="utf-8") for file in Path(microbundle.__file__).parent.glob("*.py"))
    keys = set(re.findall(r"Finding\(\s*\"([a-z_]+)\"", source))
    assert len(keys) > 40
    assert [key for key in sorted(keys) if f"`{key}`" not in guide] == []
