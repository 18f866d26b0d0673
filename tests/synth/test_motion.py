"""The motions give the gradient of their own displacement, and rest where they promise to."""

import numpy as np
import pytest

from microbundle.synth.motion import Composed, Inclusion, Motion, Rhythm, RigidMotion, TissueMotion, UniformStretch


def tissue(**changes):
    rhythm = changes.pop("rhythm", None) or Rhythm(60, amplitude_variation=0.1, period_variation=0.1, seed=3)
    settings = {"center_px": (100.0, 130.0), "half_length_px": 95.0, "half_width_px": 30.0, "peak_px": 4.0,
                "angle_deg": 12.0, "inclusion": Inclusion((95.0, 160.0), 15.0)}
    return TissueMotion(rhythm, **(settings | changes))


def motions():
    stretch = np.eye(2) + 0.05 * np.random.default_rng(1).standard_normal((60, 2, 2))
    stage = RigidMotion.drift(60, (0.02, -0.03), 1e-3, (50.0, 60.0))
    return {
        "rigid": stage,
        "stretch": UniformStretch(stretch, (90.0, 120.0)),
        "tissue": tissue(),
        "tissue_cosine": tissue(rhythm=Rhythm(60, shape="cosine", active=0.47), inclusion=None),
        "composed": Composed((tissue(), stage)),
    }


@pytest.mark.parametrize("name", motions())
def test_gradient_is_that_of_the_displacement(name):
    motion = motions()[name]
    assert isinstance(motion, Motion)
    points = np.random.default_rng(0).uniform((40, 20), (160, 240), (200, 2))
    for frame in (0, 11, 14, 20, 41):
        F = motion.gradient(points, frame)
        for j, h in enumerate(np.eye(2) * 1e-4):
            ahead, behind = motion.displacement_px(points + h, frame), motion.displacement_px(points - h, frame)
            column = (ahead - behind) / 2e-4 + np.eye(2)[j]
            np.testing.assert_allclose(F[:, :, j], column, atol=2e-8)


def test_indices_are_row_then_col():
    """A turn moves a point right of the centre downwards, or upwards if rows and cols were swapped."""
    turn = RigidMotion(np.zeros((1, 2)), np.array([np.deg2rad(-90.0)]), (10.0, 10.0))
    np.testing.assert_allclose(turn.displacement_px(np.array([[10.0, 15.0]]), 0), [[5.0, -5.0]], atol=1e-12)
    shear = UniformStretch(np.array([[[1.0, 0.5], [0.0, 1.0]]]))
    np.testing.assert_allclose(shear.displacement_px(np.array([[0.0, 4.0]]), 0), [[2.0, 0.0]])


def test_tissue_rests_exactly_between_beats():
    rhythm = Rhythm(80, 24.0, first_beat=0.3)
    motion = tissue(rhythm=rhythm, delay_frames=2.0)
    points = np.random.default_rng(0).uniform(0, 250, (300, 2))
    # Points are activated up to 2 frames late and the inclusion 0.5 later still; past the pillars even more or less.
    late = [t for t in range(5, 78) if rhythm.resting[t - 5:t + 3].all()]
    assert len(late) >= 8
    for t in late:
        assert not motion.displacement_px(points, t).any()
        np.testing.assert_array_equal(motion.gradient(points, t), np.broadcast_to(np.eye(2), (300, 2, 2)))
    assert len(rhythm.peak_frames) == 3


@pytest.mark.parametrize("peak_px", [0.1, 2.0, 8.0])
def test_pillars_move_inward_by_the_peak(peak_px):
    rhythm = Rhythm(240, 24.0, seed=2)
    motion = tissue(rhythm=rhythm, peak_px=peak_px, angle_deg=0.0, delay_frames=0.0, inclusion=None, asymmetry=0.0)
    ends = np.array([[100.0, 130.0 - 95.0], [100.0, 130.0 + 95.0]])
    u = np.array([motion.displacement_px(ends, t) for t in range(240)])
    np.testing.assert_allclose(u[:, :, 0], 0, atol=1e-12)
    assert u[:, 0, 1].max() == pytest.approx(peak_px, rel=0.02)
    assert u[:, 1, 1].min() == pytest.approx(-peak_px, rel=0.02)


def test_inclusion_extends_while_the_rest_shortens():
    rhythm = Rhythm(40, 24.0)
    motion = tissue(rhythm=rhythm, angle_deg=0.0, delay_frames=0.0, inclusion=Inclusion((100.0, 150.0), 15.0, 0.5, 0.0))
    peak = round(rhythm.peak_frames[0])
    F = motion.gradient(np.array([[100.0, 150.0], [100.0, 90.0]]), peak)
    assert F[0, 1, 1] > 1.015
    assert F[1, 1, 1] < 0.975


def test_movement_is_not_a_shape_times_a_time_course():
    motion = tissue(rhythm=Rhythm(72, amplitude_variation=0.1, period_variation=0.05))
    points = np.random.default_rng(0).uniform((70, 40), (130, 220), (300, 2))
    u = np.array([motion.displacement_px(points, t).ravel() for t in range(72)])
    s = np.linalg.svd(u, compute_uv=False)
    assert s[1] / s[0] > 0.05
    assert s[3] / s[0] > 1e-3


def test_beats_differ_and_can_start_contracted():
    rhythm = Rhythm(120, 24.0, first_beat=-0.2, amplitude_variation=0.1, period_variation=0.1, seed=5)
    activation = rhythm.activation(np.arange(120.0))[0]
    assert activation[0] > 0.7
    assert activation[0] > activation[2]
    assert np.ptp(np.diff(rhythm.onset_frames)) > 1
    assert np.ptp(rhythm.amplitudes) > 0.05
    same = Rhythm(120, 24.0, first_beat=-0.2, amplitude_variation=0.1, period_variation=0.1, seed=5)
    np.testing.assert_array_equal(activation, same.activation(np.arange(120.0))[0])


def test_frames_outside_the_movie_are_refused():
    with pytest.raises(IndexError, match="frame 60"):
        tissue().displacement_px(np.zeros((1, 2)), 60)
    with pytest.raises(ValueError, match="same number of frames"):
        Composed((RigidMotion.drift(3, (0, 0)), RigidMotion.drift(4, (0, 0))))
    with pytest.raises(ValueError, match="shift_px"):
        RigidMotion(np.zeros((3, 3)))
