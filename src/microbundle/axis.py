"""Where the tissue lies: its long axis, length and widths, measured on a mask.

The largest region with its holes filled gives the axis by its second moments, and the mask, laid level along that
axis, gives length and widths; holes, stray pieces and the angle of the picture do not matter. The published tool's
axis is in `published`.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from .data import Bools, Floats, TissueAxis

MIDDLE_SHARE = 0.5
"""Share of the length in which the smallest width is looked for; the ends taper or hold the pillars."""
WIDTH_MEDIAN_PX = 5
"""Columns across which the median width is taken, so that one notch in the outline is not the width."""


def measure_axis(tissue: Bools, axis_deg: float | None = None) -> TissueAxis:
    """Measure the tissue's long axis, length and widths on its mask (R, C), in pixels.

    The axis is the direction of the largest second moment of the largest region, or `axis_deg` (degrees clockwise
    from the image's columns) where it is given. Lengths count pixels, first and last included, along lines laid one
    pixel apart; holes inside the outline are ignored, and smaller regions too. The centre is halfway along, in the
    middle between the two sides. Raises ValueError for an empty mask.
    """
    body = _body(tissue)
    row, col = np.nonzero(body)
    point = np.stack([row, col], axis=1).astype(float)
    direction = _principal_direction(point) if axis_deg is None else _unit(np.deg2rad(axis_deg))
    across = np.array([direction[1], -direction[0]])  # a level tissue's "across" points down the rows
    s, t = point @ direction, point @ across

    level = _lay_level(body, direction, across, s, t)
    along = np.nonzero(level.any(axis=0))[0]
    first, last = int(along[0]), int(along[-1])
    width, middle = _widths(level[:, first:last + 1])
    center = len(width) // 2
    reach = int(len(width) * MIDDLE_SHARE / 2)
    lowest = center - reach + int(np.argmin(width[center - reach:center + reach + 1]))

    half_px = 0.5 * (last - first)
    s_center = np.floor(s.min()) + first + half_px
    t_center = np.floor(t.min()) + middle[center]
    return TissueAxis(
        center_px=s_center * direction + t_center * across, direction=direction,
        length_px=float(last - first + 1), width_center_px=float(width[center]),
        width_min_px=float(width[lowest]), width_min_at_px=float(lowest - half_px))


def bend(body: Bools) -> float:
    """Measure how far a region's middle line strays from a straight one: standard deviation in mean widths, over the
    middle half of its length; infinite where the region is broken there."""
    point = np.argwhere(body).astype(float)
    direction = _principal_direction(point)
    across = np.array([direction[1], -direction[0]])
    level = _lay_level(body, direction, across, point @ direction, point @ across)
    along = np.nonzero(level.any(axis=0))[0]
    width, middle = _widths(level[:, along[0]:along[-1] + 1])
    cut = int(len(width) * (1 - MIDDLE_SHARE) / 2)
    width, middle = width[cut:len(width) - cut], middle[cut:len(width) - cut]
    return float(middle.std() / width.mean()) if width.min() > 0 else np.inf


def largest_region(mask: Bools) -> Bools:
    """Keep the largest region of a mask (R, C), or nothing where it is empty; corners connect."""
    count, label, stats, _ = cv2.connectedComponentsWithStats(np.asarray(mask, np.uint8), connectivity=8)
    if count < 2:
        return np.zeros(mask.shape, bool)
    return np.asarray(label == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def fill_holes(mask: Bools, largest_px: float = np.inf) -> Bools:
    """Fill the holes of a mask (R, C) that are not larger than `largest_px` pixels."""
    count, label, stats, _ = cv2.connectedComponentsWithStats(np.asarray(~mask, np.uint8), connectivity=4)
    outside = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    hole = stats[:, cv2.CC_STAT_AREA] <= largest_px
    hole[outside] = False
    hole[0] = False  # label 0 is the mask itself
    return np.asarray(mask | hole[label]) if count > 1 else mask


def _body(tissue: Bools) -> Bools:
    """The largest region without its holes; a pillar's hole that the picture's edge cuts open counts as a hole."""
    region = largest_region(np.asarray(tissue, bool))
    if not region.any():
        raise ValueError("tissue: expected a mask with tissue, found an empty one")
    for edge in (region[0], region[-1], region[:, 0], region[:, -1]):
        at = np.nonzero(edge)[0]
        if at.size:
            edge[at[0]:at[-1] + 1] = True
    return fill_holes(region)


def _unit(angle_rad: float) -> Floats:
    """Unit vector (row, col) at an angle from the columns, with a column part that is not negative."""
    row, col = float(np.sin(angle_rad)), float(np.cos(angle_rad))
    if abs(col) < 1e-12:  # vertical up to rounding: points down
        return np.array([1.0, 0.0])
    return np.array([row, col]) if col > 0 else np.array([-row, -col])


def _principal_direction(point: Floats) -> Floats:
    """Direction (2,) of the largest variance of points (n, 2)."""
    rr, rc, cc = np.cov(point.T, ddof=0)[[0, 0, 1], [0, 1, 1]] if len(point) > 1 else (0.0, 0.0, 1.0)
    return _unit(0.5 * float(np.arctan2(2 * rc, cc - rr)))


def _lay_level(body: Bools, direction: Floats, across: Floats, s: Floats, t: Floats) -> Bools:
    """Sample a mask along its axis: rows of the result run across the tissue, columns along it, 1 px apart."""
    s_line = np.arange(np.floor(s.min()), np.ceil(s.max()) + 1)
    t_line = np.arange(np.floor(t.min()), np.ceil(t.max()) + 1)
    row = s_line[None, :] * direction[0] + t_line[:, None] * across[0]
    col = s_line[None, :] * direction[1] + t_line[:, None] * across[1]
    value = cv2.remap(body.astype(np.float32), col.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)  # a mask cut off by the picture's edge stays whole there
    return np.asarray(value >= 0.5)


def _widths(level: Bools) -> tuple[Floats, Floats]:
    """Width of a level mask in each column, and the place of its middle, both smoothed by a running median."""
    first = level.argmax(axis=0)
    last = level.shape[0] - 1 - level[::-1].argmax(axis=0)
    width = np.where(level.any(axis=0), last - first + 1, 0)
    return (np.asarray(ndimage.median_filter(width, WIDTH_MEDIAN_PX, mode="nearest"), float),
            np.asarray(ndimage.median_filter(0.5 * (first + last), WIDTH_MEDIAN_PX, mode="nearest"), float))
