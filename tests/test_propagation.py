"""Delays and fronts that are known come out; what a camera cannot tell does not."""

import numpy as np
import pytest

from microbundle.propagation import delays, front, speed

CENTER = np.stack(np.meshgrid([-30.0, 0.0, 30.0], [-80.0, -40.0, 0.0, 40.0, 80.0], indexing="ij"), -1).reshape(-1, 2)


def rises(slowness, beats=4, noise=0.0):
    """Half rise times (B, S) of a straight front of some slowness (frames a px), a beat every 100 frames."""
    late = CENTER @ np.array(slowness)
    times = 100.0 * np.arange(beats)[:, None] + 50 + late
    return times + noise * np.random.default_rng(2).standard_normal(times.shape)


SHORTENING = np.full((4, len(CENTER)), -0.1)


def test_a_straight_front_has_its_speed_and_direction():
    slowness = np.array([0.01, 0.03])
    delay = delays(rises(slowness, noise=0.1), SHORTENING)
    found = front(delay, CENTER, 200.0)
    assert float(found["delay_range"]) == pytest.approx(np.ptp(CENTER @ slowness), abs=0.3)
    got = np.array([found["slowness_across"], found["slowness_along"]])
    np.testing.assert_allclose(got, slowness, atol=2e-3)
    velocity, angle, velocity_se, angle_se = speed(got, np.array([1e-3, 1e-3]))
    assert velocity == pytest.approx(1 / np.hypot(*slowness), rel=0.05)
    assert angle == pytest.approx(np.degrees(np.arctan2(0.01, 0.03)), abs=4)
    assert 0 < velocity_se < 0.1 * velocity
    assert 0 < angle_se < 5


def test_delays_within_half_a_frame_are_none():
    assert np.isnan(delays(rises((0.0, 0.002)), SHORTENING)).all()
    assert float(front(delays(rises((0.0, 0.002)), SHORTENING), CENTER, 200.0)["delay_range"]) == 0
    assert np.isfinite(delays(rises((0.0, 0.01)), SHORTENING)).all()


def test_a_slow_camera_gives_delays_but_no_speed():
    found = front(delays(rises((0.0, 0.03)), SHORTENING), CENTER, 30.0)
    assert float(found["delay_range"]) > 4
    assert np.isnan(found["slowness_along"])


def test_a_speed_must_stand_out_of_its_error():
    assert np.isnan(speed(np.array([0.0, 0.01]), np.array([0.02, 0.02]))).all()
    assert np.isnan(speed(np.array([0.0, 0.01]), np.array([np.nan, np.nan]))).all()
    assert np.isnan(speed(np.zeros(2), np.array([0.01, 0.01]))).all()


def test_parts_that_hardly_shorten_have_no_delay():
    extreme = SHORTENING.copy()
    extreme[:, :3], extreme[:, 3] = -0.01, 0.05
    late = delays(rises((0.0, 0.03)), extreme)
    assert np.isnan(late[:, :4]).all()
    assert np.isfinite(late[:, 4:]).all()
    assert np.isnan(delays(rises((0.0, 0.03)), np.full(SHORTENING.shape, np.nan))).all()


def test_too_few_parts_or_parts_on_a_line_have_no_front():
    delay = delays(rises((0.0, 0.03)), SHORTENING)
    row = CENTER[:, 0] == 0
    assert np.isnan(front(delay[:, row], CENTER[row], 200.0)["slowness_along"])
    assert np.isnan(front(delay[:, :3], CENTER[:3], 200.0)["slowness_along"])
