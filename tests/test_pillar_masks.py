"""Finding the pillars: painted tissues whose pillars are known, supplied masks, real frames, and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy import ndimage

from microbundle.config import MaskParams, PillarParams
from microbundle.data import Bools, Movie, Pillars
from microbundle.errors import CannotMeasure, MaskUnusable, NoPillars
from microbundle.mask import find_masks, overlap
from microbundle.pillar_masks import find_pillars
from microbundle.read import read_movie
from microbundle.synth.scenes import Sheet
from microbundle.synth.texture import TissuePicture, procedural_tissue

Image = NDArray[Any]
AUTO = PillarParams()
SIDE = 256


def as_movie(picture: Image, name: str = "painted", **more: Any) -> Movie:
    """One frame of 16 bits of a picture from 0 to 1."""
    return Movie.from_array(np.clip(picture * 60000, 0, 65535).astype(np.uint16)[None], name=name, **more)


def find(movie: Movie, params: PillarParams = AUTO) -> Pillars:
    return find_pillars(movie, find_masks(movie, MaskParams()), params)


def drawn_in_order(picture: TissuePicture, pillars: Pillars) -> list[Bools]:
    """The painted caps in the order of the found pillars."""
    center = np.array([np.argwhere(cap).mean(axis=0) for cap in picture.pillars])
    nearest = np.hypot(*(pillars.center_px[:, None] - center).T).argmin(axis=0)
    assert sorted(nearest) == [0, 1]
    return [picture.pillars[i] for i in nearest]


def hidden(picture: TissuePicture, which: int, seed: int = 0) -> Image:
    """The painted picture, with grainy tissue in place of one pillar and its shadow."""
    rng = np.random.default_rng(seed)
    cap = picture.pillars[which]
    middle, radius = np.argwhere(cap).mean(axis=0), np.sqrt(cap.sum() / np.pi)
    row, col = np.mgrid[:cap.shape[0], :cap.shape[1]]
    shadow = ndimage.gaussian_filter((np.hypot(row - middle[0], col - middle[1]) < 2.0 * radius) * 1.0, 2)
    grain = ndimage.gaussian_filter(rng.standard_normal(cap.shape), 1.5)
    return np.asarray(picture.image * (1 - shadow) + (0.4 + 0.06 * grain / grain.std()) * shadow)


# --- painted tissues ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("angle", "seed"), [(0, 1), (30, 2), (90, 3)])
def test_caps_are_found_at_any_angle(angle: float, seed: int) -> None:
    picture = procedural_tissue((SIDE, SIDE), seed, angle_deg=angle)
    pillars = find(as_movie(picture.image))
    assert pillars.names == ("1", "2")
    assert pillars.source == ("found", "found")
    assert min(score for score in pillars.score if score is not None) > 0.9
    assert pillars.findings == ()
    for mask, cap in zip(pillars.masks, drawn_in_order(picture, pillars), strict=True):
        assert overlap(mask, cap) > 0.93


def test_order_is_that_of_the_axis() -> None:
    movie = as_movie(procedural_tissue((SIDE, SIDE), 5, angle_deg=-60).image)
    masks = find_masks(movie, MaskParams())
    along = (find_pillars(movie, masks, AUTO).center_px - masks.axis.center_px) @ masks.axis.direction
    assert along[0] < 0 < along[1]


@pytest.mark.parametrize("change", [
    lambda x: ndimage.gaussian_filter(x, 3), lambda x: x * np.linspace(0.5, 1, SIDE),
    lambda x: 0.6 * x + np.random.default_rng(0).normal(0, 0.1, x.shape), lambda x: x[::2, ::2],
    lambda x: np.kron(x, np.ones((3, 3))),
], ids=["blurred", "uneven light", "noise", "small", "large"])
def test_quality_and_size_do_not_matter(change: Any) -> None:
    picture = procedural_tissue((SIDE, SIDE), 6, angle_deg=15)
    image = change(picture.image)
    pillars = find(as_movie(image))
    assert pillars.source == ("found", "found")
    there = np.array([[r.mean() for r in np.nonzero(cap)] for cap in picture.pillars]) * len(image) / SIDE
    assert np.abs(pillars.center_px - there).max() < 0.015 * len(image)


def test_dark_caps_are_found() -> None:
    picture = procedural_tissue((SIDE, SIDE), 7)
    pillars = find(as_movie(1 - picture.image))
    assert pillars.source == ("found", "found")
    for mask, cap in zip(pillars.masks, drawn_in_order(picture, pillars), strict=True):
        assert overlap(mask, cap) > 0.9


def test_plates_are_found() -> None:
    scene = Sheet(1).picture()
    pillars = find(as_movie(scene.image))
    assert pillars.source == ("found", "found")
    for mask, plate in zip(pillars.masks, scene.pillars, strict=True):
        assert np.count_nonzero(mask & plate) > 0.75 * np.count_nonzero(mask)
        assert overlap(mask, plate) > 0.55


@pytest.mark.parametrize("which", [0, 1])
def test_hidden_pillar_is_the_mirror_image_of_the_other(which: int) -> None:
    picture = procedural_tissue((SIDE, SIDE), 8)
    pillars = find(as_movie(hidden(picture, which)))
    assert pillars.source[which] == "mirrored"
    assert pillars.source[1 - which] == "found"
    assert pillars.score[which] is None
    assert [(f.key, f.level) for f in pillars.findings] == [("pillar_mirrored", "review")]
    assert overlap(pillars.masks[1 - which], picture.pillars[1 - which]) > 0.93
    assert overlap(pillars.masks[which], picture.pillars[which]) > 0.6


@pytest.mark.parametrize("seed", range(2))
def test_tissue_without_pillars_is_refused(seed: int) -> None:
    picture = procedural_tissue((SIDE, SIDE), seed, angle_deg=40 * seed)
    picture = replace(picture, image=hidden(picture, 0))
    with pytest.raises(NoPillars, match="round cap or a plate near each end"):
        find(as_movie(hidden(picture, 1, seed=1)))


def test_sharp_ends_are_no_plates() -> None:
    rng = np.random.default_rng(0)
    row, col = np.abs((np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE - 0.5)
    tissue = (col < 0.38) & (row < 0.1 * (1 + 7 * col**2))
    image = ndimage.gaussian_filter(np.where(tissue, 0.3 + 0.05 * rng.standard_normal(tissue.shape), 0.75), 1)
    with pytest.raises(NoPillars, match="pillar_mask_1"):
        find(as_movie(image))


def test_small_beating_tissue_has_no_pillars(tissue_movie: Movie) -> None:
    with pytest.raises(NoPillars):
        find(tissue_movie)


def test_empty_and_black_pictures_are_refused() -> None:
    tissue = np.zeros((SIDE, SIDE), bool)
    tissue[100:160, 20:236] = True
    for value in (0.0, 0.5):
        with pytest.raises(NoPillars):
            find(as_movie(np.full((SIDE, SIDE), value), tissue_mask=tissue))
    none = replace(as_movie(np.zeros((SIDE, SIDE)), tissue_mask=tissue), frames=np.zeros((0, SIDE, SIDE)))
    with pytest.raises(NoPillars, match="at least one frame"):
        find(none)


def test_few_frames_are_read() -> None:
    class Counted:
        def __init__(self, frame: Image) -> None:
            self.frame, self.read = frame, 0

        def __len__(self) -> int:
            return 5000

        def __getitem__(self, index: int) -> Image:
            self.read += 1
            return self.frame

    movie = as_movie(procedural_tissue((SIDE, SIDE), 9).image)
    frames = Counted(np.asarray(movie.frames[0]))
    find_pillars(replace(movie, frames=frames), find_masks(movie, MaskParams()), AUTO)
    assert frames.read <= 30


# --- supplied masks -------------------------------------------------------------------------------------------------


@pytest.fixture
def supplied() -> Movie:
    """A painted tissue with masks of both pillars, the first one at the end of the axis, with a gap in the numbers."""
    picture = procedural_tissue((SIDE, SIDE), 10)
    return replace(as_movie(picture.image),
                   supplied_masks={"pillar_1": picture.pillars[1], "pillar_3": picture.pillars[0]})


@pytest.mark.parametrize("masks", ["auto", "supplied"])
def test_supplied_masks_are_taken_as_they_are(supplied: Movie, masks: Any) -> None:
    pillars = find(supplied, PillarParams(masks=masks))
    assert pillars.names == ("3", "1")
    assert pillars.source == ("supplied", "supplied")
    assert pillars.score == (None, None)
    assert [f.key for f in pillars.findings] == ["pillars_supplied"]
    np.testing.assert_array_equal(pillars.masks[0], supplied.supplied_masks["pillar_3"])
    np.testing.assert_array_equal(pillars.masks[1], supplied.supplied_masks["pillar_1"])


def test_one_supplied_mask_is_enough(supplied: Movie) -> None:
    one = replace(supplied, supplied_masks={"pillar_3": supplied.supplied_masks["pillar_3"]})
    assert find(one).names == ("3",)


def test_none_gives_no_pillars(supplied: Movie) -> None:
    pillars = find(supplied, PillarParams(masks="none"))
    assert len(pillars) == 0
    assert pillars.center_px.shape == (0, 2)


def test_supplied_only_and_none_there(tissue_movie: Movie) -> None:
    with pytest.raises(NoPillars, match=r"pillars.masks is 'supplied'; found none"):
        find(tissue_movie, PillarParams(masks="supplied"))


def test_unusable_supplied_masks(supplied: Movie) -> None:
    masks = find_masks(supplied, MaskParams())
    one = supplied.supplied_masks["pillar_1"]
    with pytest.raises(MaskUnusable, match="pillar_2: expected some pixels"):
        find_pillars(replace(supplied, supplied_masks={"pillar_1": one, "pillar_2": one & False}), masks, AUTO)
    with pytest.raises(MaskUnusable, match="pillar_1 and pillar_2: expected masks of different pillars"):
        find_pillars(replace(supplied, supplied_masks={"pillar_1": one, "pillar_2": np.roll(one, 4)}), masks, AUTO)
    wrong = {"pillar_1": one, "pillar_2": one}
    movie = replace(supplied, supplied_masks=wrong)
    wrong["pillar_2"] = one[1:]  # after the movie's own check
    with pytest.raises(MaskUnusable, match="256 x 256 px like the frames, found 255 x 256"):
        find_pillars(movie, masks, AUTO)


def test_supplied_masks_that_touch_are_for_review(supplied: Movie) -> None:
    one = supplied.supplied_masks["pillar_1"]
    shifted = np.roll(one, -40, axis=1)
    assert (one & shifted).any()
    both = replace(supplied, supplied_masks={"pillar_1": one, "pillar_2": shifted})
    assert [(f.key, f.level) for f in find(both).findings][1:] == [("pillars_overlap", "review")]


# --- real movies ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["type1_bright", "type1_dark"])
def test_real_caps_overlap_with_drawn_ones(data_folder: Path, name: str) -> None:
    movie = read_movie(data_folder / name)
    bare = replace(movie, supplied_masks={k: v for k, v in movie.supplied_masks.items() if k == "tissue"})
    pillars = find(bare)
    assert pillars.source == ("found", "found")
    assert pillars.findings == ()
    for i, mask in enumerate(pillars.masks):
        assert overlap(mask, movie.supplied_masks[f"pillar_{i + 1}"]) > 0.8


def test_real_caps_in_the_dark(data_folder: Path) -> None:
    pillars = find(Movie.from_array(tifffile.imread(data_folder / "single_frames/type1.tif")[None]))
    assert pillars.source == ("found", "found")
    np.testing.assert_allclose(pillars.center_px, [[230, 88], [230, 450]], atol=15)


def test_real_plates(data_folder: Path) -> None:
    pillars = find(Movie.from_array(tifffile.imread(data_folder / "single_frames/type2.tif")[None]))
    assert pillars.source == ("found", "found")
    np.testing.assert_allclose(pillars.center_px, [[577, 200], [225, 528]], atol=20)


@pytest.mark.parametrize("name", ["type1_fail", "type2_fail"])
def test_real_frames_that_show_nothing(data_folder: Path, name: str) -> None:
    frames = tifffile.imread(data_folder / f"single_frames/{name}.tif")[None]
    with pytest.raises(CannotMeasure):
        find(Movie.from_array(frames))
    tissue = np.zeros(frames.shape[1:], bool)
    rows, cols = tissue.shape
    tissue[int(0.3 * rows):int(0.7 * rows), int(0.05 * cols):int(0.95 * cols)] = True
    with pytest.raises(NoPillars, match="Supply the pillars' masks"):
        find(Movie.from_array(frames, tissue_mask=tissue))
