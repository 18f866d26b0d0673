"""The tissue's axis, length and widths on drawn masks, and on a real one."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from microbundle.axis import bend, fill_holes, largest_region, measure_axis

GOLDEN = os.environ.get("MICROBUNDLE_GOLDEN")
needs_golden = pytest.mark.skipif(GOLDEN is None, reason="MICROBUNDLE_GOLDEN does not name the golden arrays' folder")

Bools = NDArray[np.bool_]
LENGTH, WIDTH_MIDDLE, WIDTH_END = 260.0, 70.0, 130.0


def bundle(angle_deg: float = 0.0, shape: tuple[int, int] = (400, 420), *, holes: bool = False) -> Bools:
    """A strip that is narrow in the middle, turned clockwise about the picture's centre; holes where pillars are."""
    row, col = np.mgrid[:shape[0], :shape[1]] - np.array(shape).reshape(2, 1, 1) / 2 + 0.5
    angle = np.deg2rad(angle_deg)
    along = col * np.cos(angle) + row * np.sin(angle)
    across = -col * np.sin(angle) + row * np.cos(angle)
    width = WIDTH_MIDDLE + (WIDTH_END - WIDTH_MIDDLE) * (2 * along / LENGTH) ** 2
    mask = (np.abs(along) < LENGTH / 2) & (np.abs(across) < width / 2)
    if holes:
        for center in (-90, 90):
            mask &= np.hypot(along - center, across) > 25
    return np.asarray(mask)


def angle_between(one: float, other: float) -> float:
    return abs((one - other + 90) % 180 - 90)


@pytest.mark.parametrize("angle", [0, 7, 30, 45, 60, 89, 90, 91, 135, 173])
@pytest.mark.parametrize("holes", [False, True])
def test_axis_turns_with_the_mask(angle: float, holes: bool) -> None:
    axis = measure_axis(bundle(angle, holes=holes))
    assert angle_between(axis.angle_deg, angle) < 0.5
    assert axis.length_px == pytest.approx(LENGTH, abs=2)
    assert axis.width_center_px == pytest.approx(WIDTH_MIDDLE, abs=2)
    assert axis.width_min_px == pytest.approx(WIDTH_MIDDLE, abs=2)
    assert abs(axis.width_min_at_px) < 25
    np.testing.assert_allclose(axis.center_px, (199.5, 209.5), atol=1)
    assert axis.direction[1] >= 0
    assert np.linalg.norm(axis.direction) == pytest.approx(1)


def test_vertical_tissue_points_down() -> None:
    np.testing.assert_allclose(measure_axis(bundle(90)).direction, (1, 0), atol=0.01)
    np.testing.assert_array_equal(measure_axis(bundle(90), axis_deg=-90).direction, (1, 0))


def test_stray_pieces_and_holes_do_not_turn_the_axis() -> None:
    clean, dirty = bundle(20), bundle(20)
    dirty[10:30, 380:410] = True
    dirty[380:390, 5:60] = True
    dirty[190:210, 200:220] = False
    one, other = measure_axis(clean), measure_axis(dirty)
    assert other.angle_deg == pytest.approx(one.angle_deg, abs=0.01)
    assert (other.length_px, other.width_center_px) == (one.length_px, one.width_center_px)


def test_pillar_hole_that_the_border_cuts_open_is_a_hole() -> None:
    mask = bundle(shape=(300, 260))
    closed = measure_axis(mask)
    mask[130:180, :30] = False
    assert measure_axis(mask).angle_deg == pytest.approx(closed.angle_deg, abs=0.5)
    assert measure_axis(mask).length_px == closed.length_px


def test_width_counts_first_and_last_pixel() -> None:
    mask = np.zeros((50, 80), bool)
    mask[10:31, 5:65] = True
    axis = measure_axis(mask)
    assert (axis.length_px, axis.width_center_px, axis.width_min_px) == (60, 21, 21)
    np.testing.assert_allclose(axis.center_px, (20, 34.5))


def test_smallest_width_is_found_where_it_is() -> None:
    mask = np.zeros((100, 201), bool)
    mask[20:80] = True
    mask[20:30, 60:70] = False
    axis = measure_axis(mask)
    assert (axis.width_center_px, axis.width_min_px) == (60, 50)
    assert axis.width_min_at_px == pytest.approx(-36, abs=5)


def test_given_angle_wins() -> None:
    axis = measure_axis(bundle(0), axis_deg=190)
    assert axis.angle_deg == pytest.approx(10)


def test_empty_mask_is_refused() -> None:
    with pytest.raises(ValueError, match="empty"):
        measure_axis(np.zeros((30, 30), bool))


def test_single_pixel_has_an_axis() -> None:
    mask = np.zeros((30, 30), bool)
    mask[12, 14] = True
    assert measure_axis(mask).length_px == 1


def test_masks_are_left_alone() -> None:
    mask = np.ones((60, 90), bool)
    before = mask.copy()
    measure_axis(mask)
    np.testing.assert_array_equal(mask, before)


@needs_golden
def test_width_of_the_drawn_mask() -> None:
    axis = measure_axis(np.load(Path(str(GOLDEN)) / "mbc_masks.npz")["provided"] > 0)
    assert 105 <= axis.width_center_px <= 120
    assert abs(axis.angle_deg) < 1


def test_regions_holes_and_bend() -> None:
    mask = bundle(holes=True)
    full = fill_holes(mask)
    np.testing.assert_array_equal(full, bundle())
    np.testing.assert_array_equal(fill_holes(mask, largest_px=100), mask)
    stray = mask.copy()
    stray[:5, :5] = True
    np.testing.assert_array_equal(largest_region(stray), mask)
    row, col = np.mgrid[:200, :300]
    arc = np.abs(np.hypot(row - 250, col - 150) - 150) < 15
    assert bend(full) < 0.01 < 0.1 < bend(arc)
