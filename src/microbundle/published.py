"""Where the published tool sees the tissue: its box, axis and level mask, for the method `paper`.

Everything here keeps the published program's rounding, so that markers, tiles and rotation agree with its results.
New measurements use `axis` instead. Source: the published tool's behaviour, sections "width" and "rotation".
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from .axis import _first_contour
from .data import Bools, Floats

BORDER_PX = 10
SIGMA_PX = 1.0
LEVEL = 0.75
LEVEL_DEG = 0.96 * 180
"""From this angle on, the published tool takes a tissue for level and does not turn it."""


@dataclass(frozen=True)
class PaperFrame:
    """Centre (2,) and direction (2,) by which the published tool turns points, and the mask it then looks at."""

    center: Floats
    direction: Floats
    level: Bools
    """Mask (R, C) without the image's border, turned level."""

    @property
    def turned(self) -> bool:
        """Whether the published tool turns images and strain (it always turns markers)."""
        return abs(float(np.degrees(np.arctan2(self.direction[0], self.direction[1])))) < LEVEL_DEG

    @property
    def strain_direction(self) -> Floats:
        """Direction (2,) of the axes in which strain is measured."""
        return self.direction if self.turned else np.array([0.0, 1.0])


def paper_frame(tissue: Bools) -> PaperFrame:
    """Find the published tool's axis of a mask (R, C). Raises ValueError where its mask has no contour."""
    mask = without_border(tissue)
    box = paper_box(mask)
    side = box[1:3] - box[0:2]
    length = np.hypot(side[:, 0], side[:, 1])
    longer = int(np.argmax(length))
    if length[longer] == 0:
        raise ValueError("tissue: too small for the published tool's box")
    center, direction = 0.5 * (box[0] + box[2]), side[longer] / length[longer]
    angle_deg = float(np.degrees(np.arctan2(direction[0], direction[1])))
    if abs(angle_deg) >= LEVEL_DEG:
        return PaperFrame(center, direction, mask)
    turn = cv2.getRotationMatrix2D((float(center[1]), float(center[0])), angle_deg, 1.0)
    level = cv2.warpAffine(mask.astype(np.float32), turn, (mask.shape[1], mask.shape[0]))
    return PaperFrame(center, direction, np.asarray(level > 0.5))


def paper_box(mask: Bools) -> Floats:
    """Find the integer corners (4, 2) of the smallest rectangle around the first contour of a mask (R, C).

    Raises ValueError where there is no contour inside the 10 px border.
    """
    smooth = ndimage.gaussian_filter(without_border(mask).astype(float), SIGMA_PX, mode="nearest")
    points = _first_contour(smooth, LEVEL).astype(np.int32)
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(points)).astype(np.int32).astype(float))


def paper_width(frame: PaperFrame) -> float:
    """Measure the width in pixels: last minus first tissue pixel in the column of the level box's centre."""
    box = paper_box(frame.level)
    row = np.flatnonzero(frame.level[:, int(0.5 * (box[0, 1] + box[2, 1]))])
    return float(row[-1] - row[0]) if row.size else float("nan")


def without_border(tissue: Bools) -> Bools:
    """Copy a mask (R, C) less the image's outermost 10 px, which the published tool loses on the way."""
    inside = np.zeros(tissue.shape, bool)
    core = slice(BORDER_PX, -BORDER_PX)
    inside[core, core] = tissue[core, core]
    return inside
