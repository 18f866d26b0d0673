"""The shift of the background, on movies whose stage moves by a known amount."""

from dataclasses import replace

import numpy as np
import pytest

from microbundle.data import Masks, Movie, TissueAxis
from microbundle.pipeline import analyze
from microbundle.stage_motion import StageMotion, measure_stage, stage_finding
from microbundle.synth.cases import STILL, Case, camera
from microbundle.synth.scenes import Analytic

FRAMES = 30


def textured(shift_px, noise=0.004, seed=0) -> tuple[Movie, Masks]:
    """A textured ground that moves as a whole by shifts (T, 2), below a tissue that does not move."""
    from scipy.ndimage import fourier_gaussian, fourier_shift

    rng = np.random.default_rng(seed)
    ground = fourier_gaussian(np.fft.fft2(rng.normal(size=(160, 240))), 1.6)
    frames = np.stack([np.fft.ifft2(fourier_shift(ground, s)).real for s in shift_px])
    frames = 0.5 + 0.1 * frames / frames.std() + noise * rng.normal(size=frames.shape)
    tissue = np.zeros((160, 240), bool)
    tissue[65:95, 60:180] = True
    frames[:, tissue] = frames[0, tissue]
    axis = TissueAxis(np.array([80.0, 120.0]), np.array([0.0, 1.0]), 120.0, 30.0, 30.0, 0.0)
    return Movie.from_array(frames.astype(np.float32)), Masks(tissue, axis, "supplied")


def test_shift_of_the_ground_is_measured_to_its_error():
    t = np.arange(FRAMES)
    true = np.stack([0.05 * t, 0.4 * np.sin(t / 3)], axis=1)
    stage = measure_stage(*textured(true), reference_frame=4)
    assert stage is not None
    off = stage.shift_px - (true - true[4])
    assert np.sqrt((off**2).mean()) < 0.01
    assert stage.error_px < 0.02


def test_one_moving_thing_on_the_ground_does_not_count():
    movie, masks = textured(np.zeros((FRAMES, 2)))
    frames = np.array(movie.frames)
    rolled = np.stack([np.roll(f, 2 * (t % 2), axis=1) for t, f in enumerate(frames)])
    frames[:, :32, :32] = rolled[:, :32, :32]
    stage = measure_stage(replace(movie, frames=frames), masks, 0)
    assert stage is not None
    assert np.abs(stage.shift_px).max() < 0.03


def test_empty_or_missing_ground_gives_nothing():
    movie, masks = textured(np.zeros((FRAMES, 2)))
    flat = np.random.default_rng(1).normal(0.5, 0.01, (FRAMES, 160, 240)).astype(np.float32)
    assert measure_stage(replace(movie, frames=flat), masks, 0) is None
    assert measure_stage(replace(movie, frames=np.full((FRAMES, 160, 240), 7.0)), masks, 0) is None
    everywhere = replace(masks, tissue=np.ones((160, 240), bool))
    assert measure_stage(movie, everywhere, 0) is None


@pytest.mark.parametrize("drift_px", [(0.02, -0.01), (0.0, 0.0)])
def test_drift_is_a_finding_and_stillness_none(drift_px):
    scene = Analytic(0.8, 5, shape=(256, 320), frames=48, side_px=60.0, drift_px=drift_px)
    found = analyze(Case("stage", STILL, scene, camera(5)).make().drawn().movie)
    assert found.stage_px is not None
    steady = np.arange(48)[:, None] * np.array(drift_px)
    off = found.stage_px - steady
    assert np.sqrt(((off - off.mean(axis=0)) ** 2).mean()) < 0.02
    told = [f for f in found.findings if f.key == "stage_motion"]
    assert [f.level for f in told] == (["info"] if any(drift_px) else [])


def test_shaking_with_the_beat_is_for_review(tissue_analysis):
    beats = tissue_analysis.beats
    shift = 0.3 * beats.signal_px / np.ptp(beats.signal_px)
    stage = StageMotion(np.stack([shift, np.zeros(len(shift))], axis=1), 0.005, 20)
    assert [(f.key, f.level) for f in stage_finding(stage, beats)] == [("stage_motion", "review")]
    assert stage_finding(None, beats) == ()
