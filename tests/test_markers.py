"""Where markers are placed, and what is said where they cannot be."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbundle.axis import measure_axis
from microbundle.config import Config
from microbundle.data import Masks, Movie
from microbundle.errors import NoTexture
from microbundle.markers import place_markers, tile_counts

SHAPE = (120, 200)


def masks() -> Masks:
    tissue = np.zeros(SHAPE, bool)
    tissue[20:100, 15:185] = True
    return Masks(tissue, measure_axis(tissue), "supplied")


def textured(seed: int = 0, grain_px: float = 1.5) -> np.ndarray:
    grain = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=SHAPE), (0, 0), grain_px)
    return 20000 + 4000 * grain / grain.std()


def movie(picture: np.ndarray, count: int = 3) -> Movie:
    return Movie.from_array(np.repeat(np.clip(picture, 0, 65535).astype(np.uint16)[None], count, axis=0))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 60), side=st.sampled_from([5, 7, 20]), whole=st.booleans())
def test_tile_counts_are_those_of_a_slow_loop(seed, count, side, whole):
    rng = np.random.default_rng(seed)
    tissue = rng.random((50, 70)) < 0.6
    points = rng.uniform(-5, 75, (count, 2))
    if whole:  # points on the edges belong to no tile
        points = points.round()
    r0, c0 = rng.integers(0, 20, 2)
    r1, c1 = r0 + rng.integers(0, 50 - r0), c0 + rng.integers(0, 70 - c0)
    pixels, points_in = tile_counts(tissue, points, (int(r0), int(r1), int(c0), int(c1)), side)
    rows, cols = (r1 - r0) // side, (c1 - c0) // side
    if rows and cols:
        assert pixels.shape == points_in.shape == (rows, cols)
    for i in range(pixels.shape[0]):
        for j in range(pixels.shape[1]):
            a, b = r0 + i * side, c0 + j * side
            assert pixels[i, j] == tissue[a:a + side, b:b + side].sum()
            inner = [a < r < a + side and b < c < b + side for r, c in points]
            assert points_in[i, j] == sum(inner)


def test_markers_cover_the_tissue_evenly_and_nothing_else():
    found = place_markers(movie(textured()), masks(), 0, Config())
    assert found.coverage_px == pytest.approx(40, rel=0.35)
    at = found.position_px.round().astype(int)
    assert masks().tissue[at[:, 0], at[:, 1]].all()
    _, counts = tile_counts(masks().tissue, found.position_px, (20, 100, 15, 175))
    assert counts.min() >= 4
    assert counts.std() < 0.5 * counts.mean()
    away = np.hypot(*(found.position_px[:, None] - found.position_px).transpose(2, 0, 1))
    assert away[~np.eye(len(found), dtype=bool)].min() >= found.spacing_px - 1e-6
    assert found.findings == ()


def test_coverage_is_as_asked_for():
    configs = [Config.from_dict({"method": "fast", "markers": {"coverage_px": c}}) for c in (30, 60, 120)]
    counts = [len(place_markers(movie(textured()), masks(), 0, config)) for config in configs]
    assert counts[0] > 1.4 * counts[1] > 1.4 * counts[2]
    config = Config.from_dict({"markers": {"max_count": 50}})
    assert len(place_markers(movie(textured()), masks(), 0, config)) == 50


def test_one_glaring_corner_does_not_take_the_markers_from_the_rest():
    plain = len(place_markers(movie(textured()), masks(), 0, Config()))
    picture = textured()
    picture[60:63, 100:103] = 65000
    assert len(place_markers(movie(picture), masks(), 0, Config())) > 0.8 * plain


def test_flat_tissue_has_no_texture():
    with pytest.raises(NoTexture, match="focus"):
        place_markers(movie(np.full(SHAPE, 20000.0)), masks(), 0, Config())


def test_tissue_with_few_corners_has_no_texture():
    picture = np.full(SHAPE, 20000.0)
    picture[40:46, 50:56] = picture[80:86, 140:146] = 30000
    with pytest.raises(NoTexture, match="at least 12"):
        place_markers(movie(picture), masks(), 0, Config())


def test_partly_flat_tissue_gets_a_finding():
    picture = textured()
    picture[:, 80:] = 20000
    found = place_markers(movie(picture), masks(), 0, Config())
    assert [f.key for f in found.findings] == ["texture_sparse"]
    assert found.findings[0].value == pytest.approx(0.6, abs=0.15)


def test_markers_lie_on_the_frame_that_is_asked_for():
    frames = np.stack([np.roll(textured(), 3 * t, axis=1) for t in range(3)]).astype(np.uint16)
    found = [place_markers(Movie.from_array(frames), masks(), t, Config(method="fast")) for t in (0, 2)]
    assert [m.reference_frame for m in found] == [0, 2]
    shifted = found[0].position_px + np.array([0, 6])
    near = np.hypot(*(shifted[:, None] - found[1].position_px).transpose(2, 0, 1)).min(axis=1)
    inner = (shifted[:, 1] > 30) & (shifted[:, 1] < 170)
    assert np.median(near[inner]) < 0.5


def test_published_method_gives_the_same_markers_whatever_the_brightness():
    one = place_markers(movie(textured()), masks(), 0, Config(method="paper"))
    other = place_markers(movie(textured() * 1.5 + 4000), masks(), 0, Config(method="paper"))
    assert len(one) == pytest.approx(len(other), rel=0.03)
    assert one.spacing_px in (3, 4, 5)


def test_a_field_is_sampled_evenly_over_the_whole_tissue():
    found = place_markers(movie(textured()), masks(), 0, Config())
    assert len(found) >= 500
    inside = masks().tissue[tuple(np.rint(found.position_px).astype(int).T)]
    assert inside.all()
    steps = np.unique(np.diff(np.unique(found.position_px[:, 1])).round(3))
    assert len(steps) == 1
