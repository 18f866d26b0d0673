"""The accurate method on movies with known motion: errors far below those of following single markers."""

import os
import subprocess
import sys

import numpy as np
import pytest

import microbundle
from microbundle.config import Config
from microbundle.data import Movie
from microbundle.synth.noise import NoiseModel
from microbundle.synth.render import beating_tissue

SMALL = Config.from_dict({"strain": {"tile_px": 16}})


def rendered(frames=50, peak_px=1.5, noise=None, shape=(160, 240), seed=1):
    made = beating_tissue(shape, frames, peak_px=peak_px, noise=noise or NoiseModel(), seed=seed)
    return made, made.array()


def analyzed(array, made, config=SMALL):
    return microbundle.analyze(Movie.from_array(array, fps=30, um_per_px=4, tissue_mask=made.truth.mask), config)


def error_px(analysis, made, frames=None):
    """Root mean square error over the tissue, 6 px away from its border."""
    from scipy.ndimage import distance_transform_edt

    points = made.truth.points_px(4)
    inner = distance_transform_edt(made.truth.mask)[tuple(points.astype(int).T)] > 6
    points = points[inner]
    chosen = range(analysis.frame_count) if frames is None else frames
    exact = np.stack([made.truth.displacement_px(points, t) for t in chosen])
    return float(np.sqrt(np.mean((analysis.displacement_at(points)[list(chosen)] - exact) ** 2)))


@pytest.fixture(scope="module")
def clean():
    return rendered()


@pytest.mark.parametrize("peak_px", [0.2, 1.5])
def test_clean_movie_is_measured_to_a_hundredth_of_its_motion(peak_px):
    made, array = rendered(peak_px=peak_px)
    analysis = analyzed(array, made)
    assert analysis.tracks.method == "accurate"
    assert error_px(analysis, made) < 0.01 * peak_px
    fast = analyzed(array, made, Config.from_dict({"method": "fast", "strain": {"tile_px": 16}}))
    assert error_px(analysis, made) < 0.4 * error_px(fast, made)


@pytest.mark.parametrize("noise", [
    NoiseModel(perlin_ratio=0.06, perlin_octaves=40, seed=3), NoiseModel(full_well_electrons=5000, seed=3),
], ids=["structured", "camera"])
def test_noise_is_pooled_over_frames(noise):
    made, array = rendered(peak_px=0.8, noise=noise)
    assert error_px(analyzed(array, made), made) < 0.03


def test_motion_of_eight_pixels_is_followed():
    made, array = rendered(frames=24, peak_px=8, shape=(384, 512))
    assert error_px(analyzed(array, made), made) < 0.1


def test_flicker_is_not_motion(clean):
    made, array = clean
    gain = 1 + 0.1 * np.random.default_rng(0).normal(size=(len(array), 1, 1))
    flickering = np.clip(array * gain, 0, 65535).astype(np.uint16)
    assert error_px(analyzed(flickering, made), made) < 0.03


def test_frame_that_shows_something_else_is_left_out(clean):
    made, array = clean
    broken = array.copy()
    broken[20] = 30000
    broken[33] = broken[33, ::-1, ::-1]
    analysis = analyzed(broken, made)
    assert not analysis.tracks.ok[[20, 33]].any()
    assert analysis.tracks.ok.mean() > 0.95
    assert "frames_lost" in [f.key for f in analysis.findings]
    rest = [t for t in range(len(array)) if t not in (20, 33)]
    assert error_px(analysis, made, rest) < 0.03


def test_result_does_not_depend_on_the_number_of_threads(clean):
    made, array = clean
    results = [analyzed(array[:20], made, Config.from_dict({"registration": {"threads": n}, "strain": {"tile_px": 16}}))
               for n in (1, 3)]
    np.testing.assert_allclose(results[0].tracks.position_px, results[1].tracks.position_px, atol=1e-3)


def test_still_noisy_movies_show_no_beat():
    made, array = rendered(frames=1)
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0, 900, (40, *array.shape[1:]))
        still = np.clip(array[:1] + noise, 0, 65535).astype(np.uint16)
        analysis = analyzed(still, made)
        assert len(analysis.beats) == 0
        assert analysis.verdict == "fail"


def test_field_is_stored_and_comes_back(clean, tmp_path):
    made, array = clean
    analysis = analyzed(array[:30], made)
    again = microbundle.load(microbundle.save(analysis, tmp_path / "out"))
    points = made.truth.points_px(9)
    np.testing.assert_array_equal(again.displacement_at(points), analysis.displacement_at(points))


def test_nothing_is_read_or_written_beyond_an_array(tmp_path):
    code = ("from microbundle import Config, analyze; from microbundle.synth.render import beating_tissue; "
            "made = beating_tissue((137, 211), 12, peak_px=1.5, seed=1); "
            "print(analyze(made.movie, Config.from_dict({'strain': {'tile_px': 16}})).tracks.method)")
    checked = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}  # a cache of its own
    done = subprocess.run([sys.executable, "-c", code], env=checked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "accurate"
