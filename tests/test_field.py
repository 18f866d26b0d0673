"""Interpolation between scattered markers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from microbundle.field import filled, inside_tissue, interpolate

quick = settings(max_examples=25, deadline=None, derandomize=True)


def markers(count: int = 200, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0, 0), (100, 160), (count, 2))


def tissue() -> np.ndarray:
    mask = np.zeros((100, 160), bool)
    mask[20:80, 10:150] = True
    return mask


@quick
@given(G=arrays(float, (2, 2), elements=st.floats(-0.2, 0.2)), shift=arrays(float, 2, elements=st.floats(-9, 9)),
       seed=st.integers(0, 20), method=st.sampled_from(["local", "thin_plate"]))
def test_uniform_strain_is_exact(G, shift, seed, method):
    X = markers(80, seed)
    points = markers(30, seed + 100)
    found = interpolate(X, (X @ G.T + shift)[None], points, method=method)
    np.testing.assert_allclose(found[0], points @ G.T + shift, atol=2e-4 * max(1, np.abs(G).max() * 100))


def test_thin_plate_goes_through_every_marker():
    X = markers(60)
    u = np.random.default_rng(1).normal(size=(3, 60, 2))
    np.testing.assert_allclose(interpolate(X, u, X, method="thin_plate"), u, atol=1e-4)


def test_local_averages_noise():
    X = markers(600)
    u = np.random.default_rng(1).normal(0, 0.1, (20, 600, 2))
    assert interpolate(X, u, [[50.0, 80.0], [40.0, 60.0]]).std() < 0.06


def test_smooth_field_is_close_by_both_methods():
    X = markers(400)

    def field(points):
        return np.stack([np.sin(points[:, 1] / 30), np.cos(points[:, 0] / 25)], axis=-1)

    points = np.random.default_rng(2).uniform((15, 15), (85, 145), (50, 2))
    for method, limit in (("local", 0.08), ("thin_plate", 0.02)):
        assert np.abs(interpolate(X, field(X)[None], points, method=method)[0] - field(points)).max() < limit


def test_points_outside_the_tissue_are_nan_unless_asked_for():
    X = markers(200)
    u = np.ones((2, 200, 2))
    points = np.array([[50.0, 80.0], [5.0, 5.0], [-3.0, 80.0], [50.0, 500.0], [np.nan, 3.0]])
    found = interpolate(X, u, points, tissue=tissue())
    np.testing.assert_allclose(found[:, 0], 1, atol=1e-5)
    assert np.isnan(found[:, 1:]).all()
    asked = interpolate(X, u, points)
    np.testing.assert_allclose(asked[:, :4], 1, atol=1e-4)
    assert np.isnan(asked[:, 4]).all()


def test_tissue_includes_its_small_gaps():
    mask = tissue()
    mask[50, 60:64] = False
    mask[30:50, 100:120] = False
    inside = inside_tissue(np.array([[50.0, 62.0], [40.0, 110.0], [20.0, 10.0], [19.0, 10.0]]), mask)
    np.testing.assert_array_equal(inside, [True, False, True, False])


def test_missing_markers_are_filled_from_their_neighbours():
    X = markers(300)
    u = np.stack([0.02 * X, 0.02 * X])
    u[1, ::5] = np.nan
    full = filled(X, u)
    assert np.isfinite(full).all()
    np.testing.assert_array_equal(full[0], u[0])
    assert np.abs(full[1] - 0.02 * X).max() < 0.6
    points = np.array([[50.0, 80.0], [30.0, 40.0]])
    np.testing.assert_allclose(interpolate(X, u, points)[1], 0.02 * points, atol=0.1)


def test_markers_that_are_mostly_missing_are_left_out():
    X = markers(100)
    u = np.zeros((4, 100, 2))
    u[:, :10] = 50.0
    u[1:, :10] = np.nan
    np.testing.assert_allclose(interpolate(X, u, X[20:40]), 0, atol=1e-6)


def test_frame_without_any_marker_has_no_field():
    X = markers(50)
    u = np.zeros((4, 50, 2))
    u[2] = np.nan
    found = interpolate(X, u, [[50.0, 80.0]])
    assert np.isnan(found[2]).all()
    assert np.isfinite(found[[0, 1, 3]]).all()


def test_collinear_markers_still_give_values_along_their_line():
    X = np.stack([np.full(20, 50.0), np.linspace(10, 150, 20)], axis=1)
    u = np.stack([np.zeros(20), 0.1 * X[:, 1]], axis=1)[None]
    np.testing.assert_allclose(interpolate(X, u, [[50.0, 83.0]])[0, 0], [0, 8.3], atol=0.01)


def test_wrong_points_and_too_few_markers_are_told():
    with pytest.raises(ValueError, match="row, col"):
        interpolate(markers(), np.zeros((1, 200, 2)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="at least 3"):
        interpolate(markers(2), np.zeros((1, 2, 2)), np.zeros((4, 2)))


def test_one_point_may_be_given_without_a_list():
    assert interpolate(markers(), np.zeros((3, 200, 2)), [50.0, 80.0]).shape == (3, 1, 2)
