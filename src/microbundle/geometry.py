"""Turn points between the image's axes and the tissue's.

The tissue's axes are the image's, turned about the tissue's centre until the tissue lies level: the column axis then
runs along the tissue, the row axis across it.
"""

from __future__ import annotations

import numpy as np

from .data import Floats


def rotation(direction: Floats) -> Floats:
    """Make the matrix (2, 2) on (row, col) vectors that turns `direction` onto the column axis."""
    row, col = np.asarray(direction, float) / np.hypot(*direction)
    return np.array([[col, -row], [row, col]])


def to_tissue(points_px: Floats, center_px: Floats, direction: Floats) -> Floats:
    """Turn image points (..., 2) about the centre into the tissue's axes."""
    return np.asarray((points_px - center_px) @ rotation(direction).T + center_px)


def to_image(points_px: Floats, center_px: Floats, direction: Floats) -> Floats:
    """Turn points (..., 2) in the tissue's axes back into the image's."""
    return np.asarray((points_px - center_px) @ rotation(direction) + center_px)


def rescale(points_px: Floats, origin_px: Floats, um_per_px: float) -> Floats:
    """Give points (..., 2) in micrometres from an origin (2,)."""
    return np.asarray((points_px - np.asarray(origin_px, float)) * um_per_px)
