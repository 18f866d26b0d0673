"""A user's own movie as texture: its noise is measured, and its tissue moved by the amounts that were asked for."""

from dataclasses import replace

import numpy as np
import pytest

from microbundle.config import Config
from microbundle.pipeline import analyze
from microbundle.synth.cases import camera, case_set
from microbundle.synth.microscope import framed, full_scale, measure_noise, texture_cases
from microbundle.synth.render import with_noise
from microbundle.synth.scores import compare, score

from .stand_in import StandIn


@pytest.fixture(scope="module")
def movie():
    """A small synthetic movie under a camera's noise, in the place of a user's."""
    noise = replace(camera(5, electrons=8_000, read=0.004), bits=16)
    return with_noise(case_set("smoke")[0].make(), noise).drawn().movie


@pytest.fixture(scope="module")
def cases(movie):
    return texture_cases(movie, Config(), amplitudes_px=(0.2, 1.0, 40.0), seeds=(0,))


def test_noise_is_measured(movie):
    analysis = analyze(movie, Config())
    noise = measure_noise(movie, analysis, full_scale(analysis.image))
    expected = np.sqrt(0.4 / 8_000 + 0.004**2)
    assert noise.tissue == pytest.approx(expected, rel=0.25)
    assert noise.ground == pytest.approx(np.sqrt(0.93 / 8_000 + 0.004**2), rel=0.15)
    assert noise.model.full_well_electrons == pytest.approx(8_000, rel=0.4)
    assert noise.model.read_noise == pytest.approx(0.004, abs=0.003)
    assert abs(noise.correlation) < 0.1


def test_the_tissue_moves_by_the_amplitude_and_too_large_ones_are_left_out(cases):
    chosen, noise = cases
    assert [c.group for c in chosen] == ["0.2 px", "1 px"]
    for case, amplitude in zip(chosen, (0.2, 1.0), strict=True):
        truth = case.make().truth
        assert truth.mad_px(truth.points_px(4.0)).max() == pytest.approx(amplitude, rel=0.15)
        assert case.noise.read_noise == noise.model.read_noise


def test_its_truth_is_scored_like_any_other(cases):
    case = cases[0][1]
    perfect = StandIn.perfect(case.make())
    assert abs(score(compare(perfect.synthetic, perfect, case.domain)).mad_error_pct) < 1e-3


def test_full_scale_and_frame():
    assert full_scale(np.zeros((2, 2), np.uint8)) == 255
    assert full_scale(np.full((2, 2), 3.0)) == pytest.approx(3.15)
    tissue = np.zeros((200, 300), bool)
    tissue[90:120, 100:200] = True
    picture = framed(np.ones((200, 300)), tissue, np.array([104.5, 149.5]), 0.0, 100.0, 30.0)
    assert picture.image.shape == (126, 196)
    assert picture.center_px == (62.5, 97.5)
