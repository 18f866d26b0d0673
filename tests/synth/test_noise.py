"""Each disturbance has the size it was given, and every frame its own repeatable pattern."""

import numpy as np
import pytest

from microbundle.synth.noise import NoiseModel, perlin

GREY = np.full((128, 160), 0.4)


def test_the_default_disturbs_nothing():
    image = np.random.default_rng(0).random((20, 30))
    np.testing.assert_array_equal(NoiseModel().disturb(image, 3, 10), image)


def test_frames_are_the_same_in_any_order_and_differ_from_each_other():
    noise = NoiseModel(perlin_ratio=0.1, full_well_electrons=5000, read_noise=0.01, flicker_gain=0.02,
                       flicker_offset=0.01, hot_pixels=0.01, seed=7)
    forward = [noise.disturb(GREY, t, 5) for t in range(5)]
    backward = [noise.disturb(GREY, t, 5) for t in reversed(range(5))][::-1]
    np.testing.assert_array_equal(forward, backward)
    assert np.abs(forward[0] - forward[1]).max() > 0.01
    other = NoiseModel(perlin_ratio=0.1, seed=8).disturb(GREY, 0, 5)
    assert np.abs(NoiseModel(perlin_ratio=0.1, seed=7).disturb(GREY, 0, 5) - other).max() > 0.01


def test_one_disturbance_leaves_the_pattern_of_another():
    only = NoiseModel(read_noise=0.01, seed=1).disturb(GREY, 2, 5) - GREY
    with_hot = NoiseModel(read_noise=0.01, hot_pixels=0.01, seed=1).disturb(GREY, 2, 5)
    cold = with_hot < 1
    np.testing.assert_allclose((with_hot - GREY)[cold], only[cold], atol=1e-12)


def test_read_noise_is_white_and_shot_noise_grows_with_brightness():
    read = NoiseModel(read_noise=0.02).disturb(GREY, 0, 1) - GREY
    assert read.std() == pytest.approx(0.02, rel=0.03)
    assert np.corrcoef(read[:, 1:].ravel(), read[:, :-1].ravel())[0, 1] == pytest.approx(0, abs=0.03)
    for grey in (0.1, 0.8):
        shot = NoiseModel(full_well_electrons=2000.0).disturb(np.full((200, 200), grey), 0, 1)
        assert shot.mean() == pytest.approx(grey, rel=0.01)
        assert shot.var() == pytest.approx(grey / 2000.0, rel=0.05)


def test_perlin_noise_has_its_range_cells_and_place():
    noise = perlin((180, 120), 20, (3, 1))
    assert noise.min() == 0
    assert noise.max() == 1
    np.testing.assert_array_equal(noise, perlin((180, 120), 20, (3, 1)))
    assert np.abs(noise - perlin((180, 120), 20, (3, 2))).mean() > 0.05
    # A cell is 9 px by 9 px. Gradient noise is 0 at every lattice point, so all those pixels have one brightness.
    assert np.ptp(noise[::9, ::9]) < 1e-12
    for octaves in (18, 40):
        image = perlin((256, 256), octaves, 5)
        power = np.abs(np.fft.fft2(image - image.mean())) ** 2
        f = np.hypot(*np.meshgrid(np.fft.fftfreq(256, 1 / 256), np.fft.fftfreq(256, 1 / 256), indexing="ij"))
        assert (power * f).sum() / power.sum() == pytest.approx(0.65 * octaves, rel=0.25)
        assert power[f > 2.5 * octaves].sum() < 0.01 * power.sum()


def test_perlin_ratio_is_of_the_largest_brightness():
    image = np.linspace(0.1, 0.5, 128 * 160).reshape(128, 160)
    added = NoiseModel(perlin_ratio=0.12, perlin_octaves=24.5).disturb(image, 0, 1) - image
    assert added.min() == pytest.approx(0, abs=1e-12)
    assert added.max() == pytest.approx(0.06)


def test_flicker_drift_defocus_and_hot_pixels():
    noise = NoiseModel(flicker_gain=0.05, seed=2)
    gains = np.array([noise.disturb(GREY, t, 400).mean() / 0.4 for t in range(400)])
    assert gains.std() == pytest.approx(0.05, rel=0.1)
    drift = NoiseModel(lamp_drift=-0.1, shading_drift=0.2)
    np.testing.assert_allclose(drift.disturb(GREY, 0, 11), GREY)
    last = drift.disturb(GREY, 10, 11)
    assert last.mean() == pytest.approx(0.36)
    assert last[:, -1].mean() - last[:, 0].mean() == pytest.approx(0.2 * 0.36)
    image = np.random.default_rng(0).random((64, 64))
    sharp, blurred = (NoiseModel(defocus_swing_px=2.0, defocus_period_frames=20).disturb(image, t, 20) for t in (0, 10))
    np.testing.assert_array_equal(sharp, image)
    assert blurred.std() < 0.25 * sharp.std()
    hot = NoiseModel(hot_pixels=0.01)
    first, second = (hot.disturb(GREY, t, 2) == 1.0 for t in (0, 1))
    np.testing.assert_array_equal(first, second)
    assert first.mean() == pytest.approx(0.01, rel=0.4)


@pytest.mark.parametrize(("bits", "kind", "top"), [(8, np.uint8, 255), (12, np.uint16, 4095), (16, np.uint16, 65535)])
def test_quantisation_rounds_and_clips(bits, kind, top):
    counts = NoiseModel(bits=bits).quantise(np.array([[-0.1, 0.0, 0.4 / top, 0.6 / top, 0.5, 1.0, 1.3]]))
    assert counts.dtype == kind
    assert counts.tolist() == [[0, 0, 0, 1, round(0.5 * top), top, top]]


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="read_noise"):
        NoiseModel(read_noise=-1.0)
    with pytest.raises(ValueError, match="bits"):
        NoiseModel(bits=10)
    with pytest.raises(ValueError, match="full_well"):
        NoiseModel(full_well_electrons=0.0)
    with pytest.raises(ValueError, match="octaves"):
        perlin((8, 8), 0, 1)
