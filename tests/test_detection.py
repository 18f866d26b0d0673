"""Motionless movies through the whole pipeline: no beat in noise, and the smallest beats are found."""

from dataclasses import replace

import numpy as np
import pytest

from microbundle import Config, analyze
from microbundle.analysis import Analysis
from microbundle.beats import goes_on
from microbundle.focus import shared_part, sharpness_correlation
from microbundle.modes import faintest_in
from microbundle.synth.cases import STILL, Case, camera, perlin
from microbundle.synth.noise import NoiseModel
from microbundle.synth.scenes import Analytic


def small(noise: NoiseModel, method: str, *, mad_px: float = 0.0, drift_px=(0.0, 0.0)) -> Analysis:
    scene = Analytic(mad_px, noise.seed, shape=(96, 160), frames=60, side_px=30.0, drift_px=drift_px)
    return analyze(Case("small", STILL, scene, noise).make().drawn().movie, Config.from_dict({"method": method}))


@pytest.mark.parametrize("method", ["accurate", "fast"])
def test_noise_is_no_beat(method):
    noises = [noise for seed in (1, 2) for noise in (
        camera(seed), camera(seed, electrons=2_000, read=0.01), perlin(0.06, 28, 448, seed),
        replace(camera(seed), flicker_gain=0.01, lamp_drift=0.03), perlin(0.02, 40, 448, seed))]
    for noise in noises:
        found = small(noise, method)
        assert len(found.beats) == 0
        finding = next(f for f in found.findings if f.key == "no_measurable_motion")
        assert finding.level == "fail"
        assert "detection limit" in finding.message
        assert 0.01 <= found.beats.detection_limit_px < 0.2


@pytest.mark.parametrize("method", ["accurate", "fast"])
def test_drift_is_no_beat_and_not_called_motionless(method):
    for seed in (3, 4):
        found = small(camera(seed, electrons=2_000, read=0.01), method, drift_px=(0.02, -0.01))
        assert len(found.beats) == 0
        assert "drifts" in next(f.message for f in found.findings if f.key == "no_whole_beat")


@pytest.mark.parametrize("method", ["accurate", "fast"])
def test_beats_of_four_times_the_limit_are_found(method):
    for noise in (camera(5), perlin(0.06, 28, 448, 6)):
        limit = small(noise, method).beats.detection_limit_px
        found = small(noise, method, mad_px=4 * limit / 2.4)  # the middle moves less than the whole
        assert found.beats.complete.sum() >= 2
        assert found.beats.detection_limit_px < 2 * limit


def test_breathing_focus_is_no_beat():
    for seed in (1000, 1002, 1015):
        found = small(replace(camera(seed), defocus_swing_px=0.4, defocus_period_frames=24.0), "accurate")
        assert len(found.beats) == 0
        assert "focus" in next(f.message for f in found.findings if f.key == "no_measurable_motion")


def test_limit_grows_with_noise_and_shrinks_with_frames():
    rng = np.random.default_rng(0)

    def limit(sd, frames):
        return faintest_in(sd * rng.standard_normal((frames, 200)))
    assert limit(2.0, 80) == pytest.approx(2 * limit(1.0, 80), rel=0.1)
    assert limit(1.0, 20) > 1.1 * limit(1.0, 80)
    assert limit(1.0, 2000) == pytest.approx(6.0, rel=0.05)  # standard deviations, when the pattern is known well


def test_single_frames_do_not_go_on():
    spikes = np.zeros(80)
    spikes[[7, 20, 51]] = 1.0
    assert not goes_on(spikes)
    assert goes_on(np.sin(np.arange(80) / 3))
    assert goes_on(np.tile([0.0, 1.0, 0.2, 0.1], 20))  # four frames to a beat


def test_shared_part_tells_tissue_from_grains():
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 100, (300, 2))
    assert shared_part((x - 50) * [0.01, -0.02], x) == pytest.approx(1.0)
    assert shared_part(rng.normal(size=x.shape), x) < 0.05


def test_sharpness_follows_blur():
    from scipy.ndimage import gaussian_filter

    picture = np.random.default_rng(2).uniform(100, 200, (60, 80))
    blur = 1 + 0.3 * np.sin(np.arange(30) / 3)
    frames = np.stack([gaussian_filter(picture, s) for s in blur])
    assert sharpness_correlation(frames, np.ones(picture.shape, bool), blur) < -0.95
