"""Where the published tool sees the tissue: its box, axis, level mask and width, for the method `paper`.

Everything here keeps the published program's rounding, so that markers, tiles and rotation agree with its results. It
also keeps its weaknesses: the box is drawn around the first contour of the mask, so a stray piece above the tissue,
or a notch in an end, turns it. New measurements use `axis` instead. Source: the published tool's behaviour, sections
"width" and "rotation".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from scipy import ndimage

from .data import Bools, Floats
from .errors import CannotMeasure

Mask = TypeVar("Mask", Bools, Floats)

BORDER_PX = 10
SIGMA_PX = 1.0
LEVEL = 0.75
LEVEL_DEG = 0.96 * 180
"""From this angle on, the published tool takes a tissue for level and does not turn it."""
LEAST_KEPT = 0.85
"""A picture that shows less of the tissue after it was turned gets a margin: its width would be that of a rest."""


@dataclass(frozen=True)
class PaperFrame:
    """Centre (2,) and direction (2,) by which the published tool turns points, and the masks it then looks at."""

    center: Floats
    direction: Floats
    mask: Bools
    """Mask (R, C) without the image's border."""
    level: Bools
    """The same mask, turned level."""

    @property
    def angle_deg(self) -> float:
        """Angle of the direction from the image's columns, clockwise."""
        return float(np.degrees(np.arctan2(self.direction[0], self.direction[1])))

    @property
    def turned(self) -> bool:
        """Whether the published tool turns images and strain (it always turns markers)."""
        return abs(self.angle_deg) < LEVEL_DEG

    @property
    def strain_direction(self) -> Floats:
        """Direction (2,) of the axes in which strain is measured."""
        return self.direction if self.turned else np.array([0.0, 1.0])


def paper_frame(tissue: Bools) -> PaperFrame:
    """Find the published tool's axis of a mask (R, C), which stays as it is.

    Raises CannotMeasure where the mask has no contour inside the image's border.
    """
    mask = without_border(tissue)
    box = paper_box(mask)
    side = box[1:3] - box[0:2]
    length = np.hypot(side[:, 0], side[:, 1])
    longer = int(np.argmax(length))
    if length[longer] == 0:
        raise CannotMeasure("method paper: expected a tissue mask of more than a point; the published tool's box "
                            "around it has no length")
    frame = PaperFrame(0.5 * (box[0] + box[2]), side[longer] / length[longer], mask, mask)
    if not frame.turned:
        return frame
    turn = cv2.getRotationMatrix2D((float(frame.center[1]), float(frame.center[0])), frame.angle_deg, 1.0)
    level = cv2.warpAffine(mask.astype(np.float32), turn, (mask.shape[1], mask.shape[0]))
    return PaperFrame(frame.center, frame.direction, mask, np.asarray(level > 0.5))


def paper_box(mask: Bools | Floats) -> Floats:
    """Find the integer corners (4, 2) of the smallest rectangle around the first contour of a mask (R, C), which may
    have been turned and then has values between 0 and 1.

    Raises CannotMeasure where there is no contour inside the 10 px border.
    """
    smooth: Floats = ndimage.gaussian_filter(without_border(np.asarray(mask, float)), SIGMA_PX, mode="nearest")
    points = _first_contour(smooth, LEVEL).astype(np.int32)
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(points)).astype(np.int32).astype(float))


def paper_width(frame: PaperFrame) -> float:
    """Measure the width in pixels: last minus first tissue pixel in the column of the level mask's box centre.

    The pixel that a count would add is left out, holes are ignored, and a pixel that the turn fills in part counts.
    Raises CannotMeasure where that column holds no tissue.
    """
    level = _level_for_width(frame, margin=0)
    if level.sum() < LEAST_KEPT * frame.mask.sum():
        level = _level_for_width(frame, margin=max(frame.mask.shape))
    box = paper_box(level)
    row = np.flatnonzero(level[:, int(0.5 * (box[0, 1] + box[2, 1]))])
    if row.size == 0:
        raise CannotMeasure("method paper: expected tissue in the column of the published tool's box centre; there is "
                            "none, so it has no width")
    return float(row[-1] - row[0])


def without_border(tissue: Mask) -> Mask:
    """Copy a mask (R, C) less the image's outermost 10 px, which the published tool loses on the way."""
    inside = np.zeros_like(tissue)
    core = slice(BORDER_PX, -BORDER_PX)
    inside[core, core] = tissue[core, core]
    return inside


def _level_for_width(frame: PaperFrame, margin: int) -> Floats:
    """Turn a mask level in a picture of its own size, or with a margin around it.

    The centre of the turn has row and column exchanged: of the centres tried, only this gives the published 116 px.
    """
    center = (float(frame.center[0]) + margin, float(frame.center[1]) + margin)
    turn = cv2.getRotationMatrix2D(center, frame.angle_deg, 1.0)
    roomy = np.pad(frame.mask.astype(float), margin)
    return np.asarray(cv2.warpAffine(roomy, turn, roomy.shape[::-1], flags=cv2.INTER_LINEAR), float)


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
        raise CannotMeasure("method paper: expected tissue farther than 10 px from the picture's border, where the "
                            "published tool looks for a contour; the mask has none")
    first = np.lexsort((point[:, 1], point[:, 0]))[0]
    return np.asarray(point[(pair == pair[first]).all(axis=1)])
