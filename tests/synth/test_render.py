"""The truth of a synthetic movie is proved here: what the frames show is where the motion says it is."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from microbundle.errors import ConfigError
from microbundle.synth.motion import Inclusion, Rhythm, RigidMotion, TissueMotion, UniformStretch
from microbundle.synth.noise import NoiseModel
from microbundle.synth.render import (
    Rendered,
    Tapered,
    beating_tissue,
    invert,
    material_points,
    patchwork,
    render_movie,
    with_noise,
)
from microbundle.synth.texture import Gratings, band_limited

SHAPE = (128, 160)
PEAK = 12


def pixels(shape=SHAPE):
    return np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2).astype(float)


def tissue(peak_px=3.0, scale=1.0):
    """The same motion in a picture of `scale` times as many pixels."""
    passive = Inclusion((66.0 * scale, 95.0 * scale), 12.0 * scale)
    return TissueMotion(Rhythm(40, amplitude_variation=0.1), (63.0 * scale, 80.0 * scale), 60.0 * scale, 22.0 * scale,
                        peak_px * scale, angle_deg=15.0, inclusion=passive)


class Shrunk:
    """A texture in a picture of `scale` times as many pixels."""

    def __init__(self, texture, scale):
        self.texture, self.scale = texture, scale

    def sample(self, points_px):
        return self.texture.sample(points_px / self.scale)


def misplaced_px(frame, texture, motion, t, scale=1):
    """How far the picture lies from where the truth says, as least-squares shifts (blocks, 2) of 16 x 16 px blocks.

    Works forwards, with no inverse of the motion: material points X are looked up at X + u in the frame, between its
    pixels, and compared with the texture at X itself.
    """
    X = pixels()[np.all((pixels() >= 16) & (pixels() < (112, 144)), axis=1)]
    u = motion.displacement_px(X * scale, t)
    seen = ndimage.map_coordinates(frame, (X * scale + u).T, order=5)
    gradient = np.stack([(texture.sample(X + d) - texture.sample(X - d)) / 2e-3 for d in np.eye(2) * 1e-3], axis=1)
    off = seen - texture.sample(X)
    block = (X // 16) @ [100, 1]
    return np.array([np.linalg.lstsq(gradient[block == b], off[block == b])[0] for b in np.unique(block)])


@pytest.mark.parametrize("peak_px", [0.2, 3.0, 8.0])
def test_frames_show_the_truth(peak_px):
    """Rendered with four times the pixels, so that looking between them costs no accuracy."""
    texture, motion = Gratings.random(40, highest=0.25, seed=1), tissue(peak_px, scale=4.0)
    frame = Rendered(Shrunk(texture, 4), motion, (512, 640)).perfect(PEAK)
    assert np.abs(misplaced_px(frame, texture, motion, PEAK, scale=4)).max() < 2e-4


@pytest.mark.skipif("MICROBUNDLE_DATA" not in os.environ, reason="MICROBUNDLE_DATA does not name the folder of movies")
def test_a_real_picture_shows_the_truth_too():
    import tifffile

    frame = min(Path(os.environ["MICROBUNDLE_DATA"]).glob("type1_bright/movie/*.TIF"))
    texture = band_limited(tifffile.imread(frame)[200:328, 170:330] / 65535.0)
    drawn = Rendered(texture, tissue(3.0), SHAPE).perfect(PEAK)
    assert np.abs(misplaced_px(drawn, texture, tissue(3.0), PEAK)).max() < 0.01


def test_a_wrong_truth_is_noticed():
    texture, motion = Gratings.random(40, highest=0.25, seed=1), tissue(3.0)
    frame = Rendered(texture, motion, SHAPE).perfect(PEAK)
    assert np.abs(misplaced_px(frame, texture, motion, PEAK)).max() < 0.01

    class Wrong:
        def __init__(self, change):
            self.change = change

        def displacement_px(self, points_px, frame):
            return self.change(motion, points_px, frame)

    half_a_pixel = Wrong(lambda m, p, t: m.displacement_px(p, t) + 0.5)
    assert np.median(np.abs(misplaced_px(frame, texture, half_a_pixel, PEAK))) > 0.3
    swapped = Wrong(lambda m, p, t: m.displacement_px(p, t)[:, ::-1])
    assert np.abs(misplaced_px(frame, texture, swapped, PEAK)).max() > 0.5
    backwards = Wrong(lambda m, p, t: -m.displacement_px(p, t))
    assert np.abs(misplaced_px(frame, texture, backwards, PEAK)).max() > 0.5
    # The displacement of the material point that is at the pixel now, instead of the one that was there at rest.
    inverse = Wrong(lambda m, p, t: p - invert(m, p, t))
    assert np.abs(misplaced_px(frame, texture, inverse, PEAK)).max() > 0.05


def test_frames_agree_with_those_of_twice_the_pixels():
    texture = Gratings.random(40, highest=0.35, seed=2)
    once = Rendered(texture, tissue(4.0), SHAPE).perfect(PEAK)
    twice = Rendered(Shrunk(texture, 2), tissue(4.0, scale=2.0), (256, 320)).perfect(PEAK)
    gradient = np.std(np.gradient(once))
    assert np.abs(twice[::2, ::2] - once).max() < 1e-3 * gradient


def test_a_stretch_and_a_turn_are_drawn_as_their_formula():
    texture = Gratings.random(seed=3)
    F = np.array([[1.06, 0.03], [-0.02, 0.92]])
    frame = Rendered(texture, UniformStretch(F[None], (60.0, 70.0)), SHAPE).perfect(0)
    back = (pixels() - (60, 70)) @ np.linalg.inv(F).T + (60, 70)
    np.testing.assert_allclose(frame.ravel(), texture.sample(back), atol=1e-5)
    # One pixel down and two to the right: the picture moves with the shift, not against it.
    moved = Rendered(texture, RigidMotion(np.array([[1.0, 2.0]])), SHAPE).perfect(0)
    rest = texture.sample(pixels()).reshape(SHAPE)
    np.testing.assert_allclose(moved[1:, 2:], rest[:-1, :-2], atol=1e-9)


@pytest.mark.parametrize("peak_px", [0.5, 8.0])
def test_coarse_grid_is_as_good_as_every_pixel(peak_px):
    mask = np.zeros(SHAPE, bool)
    mask[35:90, 20:140] = True
    motion = Tapered(tissue(peak_px), mask, 40.0)
    fast, slow = (material_points(motion, SHAPE, PEAK, tolerance_px=tol) for tol in (5e-5, 0.0))
    assert np.abs(fast - slow).max() < 1e-4
    back = slow.reshape(-1, 2) + motion.displacement_px(slow.reshape(-1, 2), PEAK) - pixels()
    assert np.abs(back).max() < 1e-8


def test_ground_rests_and_tissue_moves_exactly():
    mask = np.zeros(SHAPE, bool)
    mask[40:86, 30:130] = True
    mask[55:70, 40:55] = False
    inner, band = tissue(3.0), 24.0
    motion = Tapered(inner, mask, band)
    # Up to the outline of the outermost pixels, and in the hole, where a pillar stands.
    points = np.random.default_rng(0).uniform((39.5, 29.5), (85.5, 129.5), (3000, 2))
    np.testing.assert_array_equal(motion.displacement_px(points, PEAK), inner.displacement_px(points, PEAK))
    np.testing.assert_array_equal(motion.gradient(points, PEAK), inner.gradient(points, PEAK))
    far = np.array([[2.0, 80.0], [120.0, 20.0], [63.0, 158.0]])
    assert not motion.displacement_px(far, PEAK).any()
    # The gradient holds in the band as well.
    points = np.random.default_rng(1).uniform((5, 5), (120, 150), (500, 2))
    F = motion.gradient(points, PEAK)
    for j, h in enumerate(np.eye(2) * 1e-3):
        slope = (motion.displacement_px(points + h, PEAK) - motion.displacement_px(points - h, PEAK)) / 2e-3
        np.testing.assert_allclose(F[:, :, j], slope + np.eye(2)[j], atol=1e-5)

    still = render_movie(Gratings.random(), inner, mask)
    moves = render_movie(Gratings.random(), inner, mask, ground="moves")
    np.testing.assert_array_equal(still.movie.frames[0][:8], still.movie.frames[PEAK][:8])
    assert (moves.movie.frames[0][:8] != moves.movie.frames[PEAK][:8]).mean() > 0.9
    np.testing.assert_allclose(still.movie.frames[PEAK][50:80, 50:110].astype(float),
                               moves.movie.frames[PEAK][50:80, 50:110], atol=3)


def test_motion_that_folds_is_refused():
    mask = np.zeros(SHAPE, bool)
    mask[40:86, 20:140] = True
    with pytest.raises(ConfigError, match="folds the picture"):
        Rendered(Gratings.random(), Tapered(tissue(30.0), mask, 10.0), SHAPE).perfect(PEAK)


def test_truth_counts_from_the_relaxed_state_or_from_a_frame():
    made = beating_tissue((128, 128), frames=30, peak_px=2.0, noise=NoiseModel(), drift_px_per_frame=(0.01, -0.02),
                          rhythm=Rhythm(30, first_beat=-0.1))
    truth = made.truth
    points = truth.points_px(6.0)
    assert truth.mask[tuple(points.astype(int).T)].all()
    u0, u = (truth.displacement_px(points, t) for t in (0, 9))
    assert np.hypot(*u0.T).max() > 0.3
    np.testing.assert_allclose(truth.from_reference_px(points + u0, 9), u - u0, atol=1e-8)
    np.testing.assert_allclose(truth.mad_px(points, [9]), np.hypot(*u.T).mean())
    assert truth.mad_px(points).shape == (30,)
    assert truth.F(points, 9).shape == (len(points), 2, 2)
    assert truth.rhythm is not None


def test_frames_do_not_depend_on_the_order_of_access():
    first, second = (beating_tissue((96, 96), frames=12, noise=NoiseModel(perlin_ratio=0.05, read_noise=0.01, bits=12))
                     for _ in range(2))
    forward = [first.movie.frames[t] for t in range(12)]
    for t in (11, 3, 7, 3, 0):
        np.testing.assert_array_equal(second.movie.frames[t], forward[t])
    np.testing.assert_array_equal(second.array(), forward)
    np.testing.assert_array_equal(second.movie.frames[-1], forward[-1])
    with pytest.raises(IndexError, match="frame 12"):
        second.movie.frames[12]


def test_the_demo_movie():
    made = beating_tissue(peak_px=2.0, seed=1)
    movie = made.movie
    assert (movie.count, movie.shape, movie.um_per_px) == (60, (256, 256), 4.0)
    assert movie.frames_per_s == pytest.approx(30.0)
    frame = movie.frames[0]
    assert frame.dtype == np.uint16
    assert frame.shape == (256, 256)
    assert frame.max() > 50_000
    mad = made.truth.mad_px(made.truth.points_px(8.0))
    assert mad.min() == 0
    assert 0.8 < mad.max() < 2.0
    clean = with_noise(made, NoiseModel())
    assert np.abs(clean.movie.frames[0].astype(float) - frame).std() > 50
    assert clean.truth is made.truth


def test_patchwork_is_nearly_the_exact_picture():
    texture, motion = Gratings.random(30, highest=0.08, seed=5), tissue(3.0)
    rest = texture.sample(pixels()).reshape(SHAPE)
    exact = Rendered(texture, motion, SHAPE).perfect(PEAK)
    paper = patchwork(rest, motion, PEAK)
    inner = (slice(12, -12), slice(12, -12))
    assert np.abs(paper - exact)[inner].mean() < 0.15 * np.abs(rest - exact)[inner].mean()
    made = Rendered(texture, motion, SHAPE, how="paper")
    np.testing.assert_array_equal(made[PEAK], NoiseModel().quantise(paper))
