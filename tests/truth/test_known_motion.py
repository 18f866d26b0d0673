"""Rigid shifts, rotations and uniform stretches of a textured picture come back, by both methods.

Stated bounds, at the peaks. default: 0.03 px + 4 % of the motion, E within 0.006. paper: 0.06 px + 8 %, E within 0.01.
"""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import microbundle

from .conftest import CENTER, FRAMES, activation, shifted, stretched, turned

BOUNDS = {"default": (0.03, 0.04, 0.006), "paper": (0.06, 0.08, 0.01)}
few = settings(max_examples=5, deadline=None, derandomize=True,
               suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
PEAK = int(np.argmax(activation()[16:29])) + 16


def measured(movie, method):
    return microbundle.analyze(movie, microbundle.Config(method=method, strain={"tile_px": 20}))


def check_displacement(analysis, truth, method):
    absolute, relative, _ = BOUNDS[method]
    points = np.stack(np.meshgrid(np.arange(30, 82, 8), np.arange(24, 136, 8), indexing="ij"), -1).reshape(-1, 2)
    moved = analysis.displacement_at(points)[PEAK]
    exact = truth.displacement_px(points, PEAK)
    rest = truth.displacement_px(points, int(analysis.beats.start[0])) if method == "paper" else 0
    size = np.hypot(*exact.T).max()
    away = np.hypot(*(moved - (exact - rest)).T)
    assert np.median(away) <= absolute + relative * size
    assert away.max() <= 3 * absolute + 3 * relative * size


@pytest.mark.parametrize("method", ["default", "paper"])
@few
@given(row=st.floats(-5, 5), col=st.floats(-5, 5), seed=st.integers(0, 50))
def test_shift_is_recovered(render, method, row, col, seed):
    if np.hypot(row, col) < 0.2:  # the published prominence is 0.1 px
        col = 0.3
    movie, truth = render(shifted(row, col), seed)
    analysis = measured(movie, method)
    check_displacement(analysis, truth, method)
    assert np.nanmax(np.abs(analysis.strain.E[PEAK])) < 4 * BOUNDS[method][2]


@pytest.mark.parametrize("method", ["default", "paper"])
@few
@given(degrees=st.floats(0.5, 4), seed=st.integers(0, 50))
def test_rotation_is_recovered_and_is_no_strain(render, method, degrees, seed):
    movie, truth = render(turned(degrees), seed)
    analysis = measured(movie, method)
    check_displacement(analysis, truth, method)
    F = np.nanmean(analysis.strain.F[PEAK], axis=0)
    angle = np.degrees(np.arctan2(F[1, 0] - F[0, 1], F[0, 0] + F[1, 1]))
    exact = truth.F(np.array([CENTER]), PEAK)[0]
    expected = np.degrees(np.arctan2(exact[1, 0] - exact[0, 1], exact[0, 0] + exact[1, 1]))
    assert angle == pytest.approx(expected, abs=0.15)
    assert np.abs(np.nanmean(analysis.strain.E[PEAK], axis=0)).max() < BOUNDS[method][2]


@pytest.mark.parametrize("method", ["default", "paper"])
@few
@given(E_rr=st.floats(-0.02, 0.04), E_cc=st.floats(-0.06, -0.01), shear=st.floats(-0.03, 0.03),
       seed=st.integers(0, 50))
def test_uniform_stretch_is_recovered(render, method, E_rr, E_cc, shear, seed):
    movie, truth = render(stretched(E_rr, E_cc, shear), seed)
    analysis = measured(movie, method)
    F = truth.F(np.array([CENTER]), PEAK)[0]
    exact = 0.5 * (F.T @ F - np.eye(2))
    found = np.nanmean(analysis.strain.E[PEAK], axis=0)
    np.testing.assert_allclose(found, exact, atol=BOUNDS[method][2] + 0.06 * np.abs(exact).max())


def test_beats_of_a_known_rhythm_are_found(render):
    movie, _ = render(shifted(0.5, 2.0))
    analysis = measured(movie, "default")
    assert analysis.beats.complete.sum() == 3
    np.testing.assert_allclose(np.diff(analysis.beats.peak), 13, atol=1)
    assert analysis.frame_count == FRAMES
