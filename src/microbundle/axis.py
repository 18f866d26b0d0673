"""Where the tissue lies: its long axis, length and widths, measured on a mask.

Two measurements of the same thing. `measure_axis` is ours: the largest region with its holes filled gives the axis by
its second moments, and the mask, laid level along that axis, gives length and widths; holes, stray pieces and the
angle of the picture do not matter. `paper_axis` is the published tool's box (MicroBundleCompute, "tissue width" and
"rotation"): the smallest rectangle around the first contour of the mask. It is kept to reproduce that tool's numbers
and keeps its weaknesses: a stray piece above the tissue, or a notch in an end, turns the box.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from .data import Bools, Floats, TissueAxis

EIGHT = np.ones((3, 3), bool)
"""Pixels that share a side or a corner are neighbours."""

MIDDLE_SHARE = 0.5
"""Share of the length in which the smallest width is looked for; the ends taper or hold the pillars."""
WIDTH_MEDIAN_PX = 5
"""Columns across which the median width is taken, so that one notch in the outline is not the width."""

PAPER_BORDER_PX = 10
PAPER_SIGMA_PX = 1.0
PAPER_LEVEL = 0.75
PAPER_LEAST_KEPT = 0.85
"""A picture that shows less of the tissue after it was turned gets a margin: its width would be that of a rest."""


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


def paper_axis(tissue: Bools) -> tuple[Floats, Floats, float]:
    """Measure centre (row, col), unit direction (row, col) and width in pixels as the published tool does.

    The border of 10 px is taken off a copy; the caller's mask (R, C) stays as it is. The width is the distance from
    the first to the last tissue pixel in the column of the box's centre, without the pixel that a count would add;
    holes are ignored. Raises ValueError where the mask has no contour inside that border. Source: the published
    tool's box, width and rotation.
    """
    mask = _without_border(np.asarray(tissue, bool).astype(np.float64), PAPER_BORDER_PX)
    center, direction = _paper_box(mask)
    angle_deg = float(np.degrees(np.arctan2(direction[0], direction[1])))
    level = _paper_turn(mask, center, angle_deg, margin=0)
    if level.sum() < PAPER_LEAST_KEPT * mask.sum():
        level = _paper_turn(mask, center, angle_deg, margin=max(mask.shape))
    level_center, _ = _paper_box(_without_border(level, PAPER_BORDER_PX))
    row = np.nonzero(level[:, int(level_center[1])])[0]
    if row.size == 0:
        raise ValueError("tissue: the column of the published tool's box centre holds no tissue")
    return center, direction, float(row[-1] - row[0])


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


def _without_border(image: Floats, width_px: int) -> Floats:
    out = np.zeros_like(image)
    inner = (slice(width_px, -width_px),) * 2
    out[inner] = image[inner]
    return out


def _paper_turn(mask: Floats, center: Floats, angle_deg: float, margin: int) -> Floats:
    """Turn a mask level in a picture of its own size, or with a margin around it.

    The centre of the turn has row and column exchanged: of the centres tried, only this gives the published 116 px.
    """
    turn = cv2.getRotationMatrix2D((float(center[0]) + margin, float(center[1]) + margin), angle_deg, 1.0)
    roomy = np.pad(mask, margin)
    return np.asarray(cv2.warpAffine(roomy, turn, roomy.shape[::-1], flags=cv2.INTER_LINEAR), float)


def _paper_box(mask: Floats) -> tuple[Floats, Floats]:
    """Centre (2,) and unit vector (2,) of the smallest rectangle around the first contour of a mask."""
    smooth = ndimage.gaussian_filter(mask, PAPER_SIGMA_PX, mode="nearest")
    point = _first_contour(smooth, PAPER_LEVEL).astype(np.int32)
    corner = cv2.boxPoints(cv2.minAreaRect(point)).astype(np.int32).astype(float)
    side = corner[1:3] - corner[0:2]
    length = np.hypot(side[:, 0], side[:, 1])
    longer = int(np.argmax(length))
    if length[longer] == 0:
        raise ValueError("tissue: too small for the published tool's box")
    return 0.5 * (corner[0] + corner[2]), side[longer] / length[longer]


def _first_contour(image: Floats, level: float) -> Floats:
    """Points (n, 2) where the contour that reaches highest in the picture crosses the lines between pixel centres.

    A contour parts one region above the level (sides connect) from one region below it (corners connect too), so its
    points are the crossings between these two regions, without following the line from point to point.
    """
    above = image > level
    high = cv2.connectedComponents(above.astype(np.uint8), connectivity=4)[1]
    low = cv2.connectedComponents((~above).astype(np.uint8), connectivity=8)[1]
    crossings, pairs = [], []
    for axis in (0, 1):
        here = tuple(slice(None, -1) if a == axis else slice(None) for a in (0, 1))
        there = tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))
        at = np.nonzero(above[here] != above[there])
        crossing = np.stack(at, axis=1).astype(float)
        crossing[:, axis] += (level - image[here][at]) / (image[there][at] - image[here][at])
        crossings.append(crossing)
        pairs.append(np.stack([np.maximum(high[here][at], high[there][at]),
                               np.maximum(low[here][at], low[there][at])], axis=1))
    point, pair = np.concatenate(crossings), np.concatenate(pairs)
    if len(point) == 0:
        raise ValueError("tissue: the published tool finds no contour in a mask without tissue inside a 10 px border")
    first = np.lexsort((point[:, 1], point[:, 0]))[0]
    return np.asarray(point[(pair == pair[first]).all(axis=1)])
