"""The published tool's box, axis and width: on drawn masks, and on its own mask with its own numbers."""

import numpy as np
import pytest

from microbundle.axis import measure_axis
from microbundle.errors import CannotMeasure
from microbundle.published import paper_frame, paper_width, without_border


def rectangle(rows: slice, cols: slice, shape=(120, 200)) -> np.ndarray:
    mask = np.zeros(shape, bool)
    mask[rows, cols] = True
    return mask


def test_box_of_a_rectangle():
    frame = paper_frame(rectangle(slice(40, 81), slice(30, 171)))
    np.testing.assert_allclose(frame.center, (60, 100), atol=1)
    np.testing.assert_allclose(np.abs(frame.direction), (0, 1), atol=0.01)
    assert paper_width(frame) == pytest.approx(40, abs=2)


def test_box_takes_the_highest_contour():
    mask = rectangle(slice(60, 120), slice(30, 170), (160, 200))
    mask[15:45, 90:100] = True  # a stray upright piece above the tissue
    assert abs(paper_frame(mask).direction[0]) == pytest.approx(1)
    assert measure_axis(mask).angle_deg == pytest.approx(0)


def test_mask_without_tissue_inside_the_border_has_no_box():
    with pytest.raises(CannotMeasure, match="10 px from the picture's border"):
        paper_frame(rectangle(slice(0, 10), slice(0, 200)))


def test_masks_are_left_alone():
    mask = np.ones((60, 90), bool)
    paper_width(paper_frame(mask))
    assert without_border(mask).sum() == 40 * 70
    assert mask.all()


def test_center_direction_and_width_are_those_published(golden_folder):
    frame = paper_frame(np.load(golden_folder / "mbc_masks.npz")["provided"] > 0)
    expected = np.load(golden_folder / "mbc_rotated.npz")["rot_info"]
    np.testing.assert_allclose(frame.center, expected[0], atol=0.5)
    np.testing.assert_allclose(frame.direction, expected[1], atol=1e-6)
    assert paper_width(frame) == float(np.load(golden_folder / "mbc_tracks.npz")["tissue_info"]) == 116
