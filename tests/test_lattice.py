"""The compiled kernels against SciPy and dense algebra."""

import numpy as np
import pytest
from scipy import ndimage

from microbundle import bspline
from microbundle.bspline import Runs
from microbundle.lattice import Knots, Template, finer


@pytest.fixture(scope="module")
def picture():
    rng = np.random.default_rng(0)
    smooth = ndimage.gaussian_filter(rng.normal(size=(96, 128)), 1.5)
    return np.asarray(smooth / smooth.std(), np.float32)


@pytest.fixture(scope="module")
def mask():
    mask = np.zeros((96, 128), bool)
    mask[26:70, 26:100] = True
    mask[40:48, 50:62] = False
    return mask


def coefficients(picture):
    out = picture.copy()
    bspline.prefilter(out)
    return out


def test_prefilter_is_scipys_quintic_spline_filter(picture):
    exact = ndimage.spline_filter(picture.astype(float), order=5, mode="mirror")
    np.testing.assert_allclose(coefficients(picture), exact, atol=2e-4 * np.abs(exact).max())


def test_pull_back_samples_the_quintic_spline_at_displaced_pixels(picture, mask):
    knots = Knots(mask, 24, 12)
    p = np.random.default_rng(1).normal(0, 2, knots.shape).astype(np.float32)
    out = np.empty(knots.runs.count, np.float32)
    bspline.pull_back(coefficients(picture), *knots.runs.arrays, knots.table, 24, p, out)
    pixels = np.argwhere(mask)
    u = np.stack([knots.basis(pixels) @ p[i].ravel() for i in (0, 1)], axis=1)
    exact = ndimage.map_coordinates(picture.astype(float), (pixels + u).T, order=5, mode="mirror")
    np.testing.assert_allclose(out, exact, atol=2e-4)


def test_places_are_kept_inside_the_picture(picture):
    rows, cols = picture.shape
    whole = np.ones(picture.shape, bool)
    knots = Knots(whole, 0, 12)
    far = np.full(knots.shape, 50, np.float32)
    for p in (0 * far, far, -far):
        out = np.empty(knots.runs.count, np.float32)
        bspline.pull_back(coefficients(picture), *knots.runs.arrays, knots.table, 0, p, out)
        places = np.argwhere(whole) + p[:, 0, 0]
        places = np.clip(places, 2, [rows - 5, cols - 4])
        exact = ndimage.map_coordinates(picture.astype(float), places.T, order=5, mode="mirror")
        np.testing.assert_allclose(out, exact, atol=2e-4)


def test_slopes_are_the_splines_derivatives(picture, mask):
    runs = Runs.of(mask)
    gr, gc = np.empty(runs.count, np.float32), np.empty(runs.count, np.float32)
    bspline.slopes(coefficients(picture), *runs.arrays, gr, gc)
    pixels, h = np.argwhere(mask).T.astype(float), 1e-3
    for found, step in ((gr, [[h], [0]]), (gc, [[0], [h]])):
        up, down = (ndimage.map_coordinates(picture.astype(float), pixels + s * np.array(step), order=5, mode="mirror")
                    for s in (1, -1))
        np.testing.assert_allclose(found, (up - down) / (2 * h), atol=1e-3)


def test_normal_equations_agree_with_dense_least_squares(picture, mask):
    knots = Knots(mask, 24, 12)
    template = Template(knots, coefficients(picture))
    pixels = np.argwhere(mask)
    B = knots.basis(pixels).toarray()
    columns = np.zeros((len(pixels), knots.count))
    dense = np.stack([template.gr[:, None] * B, template.gc[:, None] * B], axis=1)
    columns = knots.flat(dense.reshape(len(pixels), *knots.shape))
    mean, y0, ys, x0, xs = template.scale
    plane = np.stack([np.ones(len(pixels)), (pixels[:, 0] - y0) * ys, (pixels[:, 1] - x0) * xs], axis=1)
    d = (template.f - mean)[:, None]
    J = np.concatenate([columns, -d * plane, -plane], axis=1)
    H = J.T @ J
    H[:knots.count, :knots.count] += template.penalty.toarray()
    residual = np.random.default_rng(2).normal(size=len(pixels))
    right = J.T @ residual
    exact = np.linalg.lstsq(H, right, rcond=1e-12)[0]
    bright = template.schur @ (right[knots.count:] - template.border.T @ right[:knots.count])
    step = template.solve(right[:knots.count, None])[:, 0] - template.border @ bright
    near = B.max(axis=0) > 1e-3  # knots that the mask hardly touches are not determined by it
    wide = np.tile(near.reshape(knots.shape[1:]), (2, 1, 1))
    np.testing.assert_allclose(knots.grid(step)[wide], knots.grid(exact[:knots.count])[wide], atol=2e-3)
    np.testing.assert_allclose(bright, exact[knots.count:], atol=1e-3)


def test_finer_knots_carry_the_same_displacement():
    mask = np.zeros((80, 120), bool)
    mask[12:60, 12:100] = True
    coarse, fine = Knots(mask, 6, 6), Knots(np.kron(mask, np.ones((2, 2), bool)), 12, 6)
    p = np.random.default_rng(3).normal(size=coarse.shape).astype(np.float32)
    points = np.random.default_rng(4).uniform([14, 14], [50, 90], (50, 2))
    once = coarse.basis(points) @ p.reshape(2, -1).T
    twice = fine.basis(2 * points) @ finer(p, fine.shape).reshape(2, -1).T
    np.testing.assert_allclose(twice, 2 * once, atol=1e-5)


def test_fit_recovers_a_known_displacement_and_brightness(picture, mask):
    knots = Knots(mask, 24, 12)
    place = np.indices(picture.shape).astype(float)
    u = np.stack([1.2 + 0.02 * (place[0] - 48), -0.8 + 0.03 * (place[1] - 64)])
    seen = ndimage.map_coordinates(picture.astype(float), place + u, order=5, mode="mirror")
    template = Template(knots, coefficients(np.asarray(seen, np.float32)))
    brighter = np.asarray(1.1 * picture + 0.2, np.float32)
    fit = template.fit([coefficients(brighter)], [np.zeros(knots.shape, np.float32)], [np.zeros(6)], 40)[0]
    points = np.argwhere(mask)[::50].astype(float)
    found = knots.basis(points) @ fit.p.reshape(2, -1).T
    exact = np.stack([u[i][tuple(points.astype(int).T)] for i in (0, 1)], axis=1)
    assert np.sqrt(((found - exact) ** 2).mean()) < 0.005
    assert fit.bright[0] == pytest.approx(0.1, abs=0.01)
    assert fit.rms < 0.01


def test_fit_ends_within_its_tolerance(picture, mask):
    knots = Knots(mask, 24, 12)
    template = Template(knots, coefficients(picture))
    noise = np.random.default_rng(6).normal(0, 0.05, picture.shape)
    moved = coefficients(np.asarray(ndimage.shift(picture, (0.6, -0.4), order=5, mode="mirror") + noise, np.float32))
    start = [np.zeros(knots.shape, np.float32)]
    tight = template.fit([moved], start, [np.zeros(6)], 60, 1e-6)[0]
    loose = template.fit([moved], start, [np.zeros(6)], 60, 3e-3)[0]
    points = np.argwhere(mask)[::20].astype(float)
    assert loose.iterations < tight.iterations
    assert np.abs(knots.basis(points) @ (loose.p - tight.p).reshape(2, -1).T).max() < 3e-3


def test_several_pictures_at_once_give_the_same_as_one_by_one(picture, mask):
    knots = Knots(mask, 24, 12)
    template = Template(knots, coefficients(picture))
    moved = [coefficients(np.asarray(ndimage.shift(picture, s, order=5, mode="mirror"), np.float32))
             for s in ((0.4, -0.2), (1.0, 0.7))]
    zero, dark = np.zeros(knots.shape, np.float32), np.zeros(6)
    together = template.fit(moved, [zero, zero], [dark, dark], 10)
    for one, both in zip([template.fit([m], [zero], [dark], 10)[0] for m in moved], together, strict=True):
        np.testing.assert_allclose(one.p, both.p, atol=1e-5)
