"""Textures are what they say between pixels, and the painted bundle resembles a real one."""

import os
from pathlib import Path

import numpy as np
import pytest

from microbundle.synth.texture import Gratings, band_limited, procedural_tissue


def pixels(shape):
    return np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 2).astype(float)


def radial_power(patch):
    """Mean power in rings of 0.05 cycles per pixel up to 0.45."""
    window = np.outer(*(np.hanning(n) for n in patch.shape))
    power = np.abs(np.fft.fft2((patch - patch.mean()) * window)) ** 2 / (window**2).sum()
    f = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n) for n in patch.shape), indexing="ij"))
    return np.array([power[(f >= lo) & (f < lo + 0.05)].mean() for lo in np.arange(0.05, 0.45, 0.05)])


def test_a_known_picture_is_known_between_its_pixels():
    shape = (128, 160)
    known = Gratings.random(60, highest=0.29, seed=4)
    texture = band_limited(known.sample(pixels(shape)).reshape(shape), cut_off=0.4)
    points = np.random.default_rng(0).uniform((24, 24), (104, 136), (4000, 2))
    error = texture.sample(points) - known.sample(points)
    # One pixel of misplacement changes the brightness by its gradient; 1e-3 of that is the promise.
    step = 1e-4
    gradient = np.std([(known.sample(points + d) - known.sample(points - d)) / (2 * step) for d in np.eye(2) * step])
    assert np.sqrt(np.mean(error**2)) < 3e-4 * gradient
    swapped = texture.sample(points[:, ::-1].clip(24, 104)) - known.sample(points)
    assert np.sqrt(np.mean(swapped**2)) > gradient


def test_frequencies_that_alias_are_removed():
    shape = (96, 96)
    texture = band_limited(np.random.default_rng(1).standard_normal(shape), cut_off=0.3)
    half_a_pixel = texture.sample(pixels(shape) + 0.5).reshape(shape)
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(96), np.fft.fftfreq(96), indexing="ij"))
    window = np.outer(np.hanning(96), np.hanning(96)) ** 2
    power = np.abs(np.fft.fft2(half_a_pixel * window)) ** 2
    assert power[f > 0.36].mean() < 1e-6 * power[f < 0.2].mean()


def test_fill_and_border():
    image = np.full((40, 50), 0.2)
    image[:, :20] = 0.0
    keep = image > 0
    texture = band_limited(image, fill=keep)
    np.testing.assert_allclose(texture.sample(np.array([[20.0, 5.0], [-30.0, 25.0], [70.0, 49.0]])), 0.2, atol=1e-6)
    with pytest.raises(ValueError, match="cut_off"):
        band_limited(image, cut_off=0.7)
    with pytest.raises(ValueError, match="finite"):
        band_limited(np.full((8, 8), np.nan))


@pytest.mark.parametrize("shape", [(256, 256), (300, 420)])
def test_painted_bundle_is_dark_on_bright_ground_with_bright_caps(shape):
    picture = procedural_tissue(shape, seed=2, angle_deg=8.0)
    image = picture.image
    assert image.shape == shape
    assert 0 <= image.min() < image.max() <= 1
    tissue, caps = image[picture.tissue], image[picture.pillars[0] | picture.pillars[1]]
    ground = image[~picture.body & (np.abs(np.arange(shape[0]) - shape[0] / 2) < 0.3 * min(shape))[:, None]]
    assert np.median(tissue) < 0.5 < np.median(caps) < np.median(ground)
    assert not (picture.tissue & picture.pillars[0]).any()
    first, second = (np.argwhere(p).mean(axis=0) for p in picture.pillars)
    assert np.hypot(*(second - first)) == pytest.approx(2 * picture.half_length_px, rel=0.03)
    assert np.degrees(np.arctan2(*(second - first))) == pytest.approx(8.0, abs=2.5)
    np.testing.assert_array_equal(image, procedural_tissue(shape, seed=2, angle_deg=8.0).image)
    assert np.abs(image - procedural_tissue(shape, seed=3, angle_deg=8.0).image).max() > 0.1


@pytest.mark.skipif("MICROBUNDLE_DATA" not in os.environ, reason="MICROBUNDLE_DATA does not name the folder of movies")
def test_painted_bundle_has_the_power_spectrum_of_a_real_one():
    import tifffile

    frame = min(Path(os.environ["MICROBUNDLE_DATA"]).glob("type1_bright/movie/*.TIF"))
    real = tifffile.imread(frame)[215:300, 150:360] / 65535.0
    painted = [procedural_tissue((512, 512), seed).image[215:300, 150:360] for seed in range(3)]
    ratio = np.mean([radial_power(p) for p in painted], axis=0) / radial_power(real)
    assert (ratio > 0.5).all()
    assert (ratio < 2.0).all()
    assert np.mean([p.std() for p in painted]) == pytest.approx(real.std(), rel=0.3)
