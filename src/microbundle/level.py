"""The tissue laid level: a small picture of it and its surroundings, its long axis along the columns.

The tissue is `LENGTH_PX` long in it, whatever its size and angle in the movie, so what looks for shapes at its ends
can say where and how large in shares of the tissue's length.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .axis import fill_holes, largest_region
from .data import Bools, Floats, Masks
from .view import View, blurred

LENGTH_PX = 256
"""Length of the tissue in the level picture."""
REACH_ALONG = 0.72
"""The picture reaches this far from the tissue's middle along it, as a share of the length."""
REACH_ACROSS = (0.32, 0.75)
"""And this far across it: the larger of a share of the length and of the tissue's largest width."""


@dataclass(frozen=True)
class Level:
    """A view turned, shifted and scaled so that the tissue lies along the columns."""

    image: Floats
    """(h, w) mean brightness."""
    seen: Bools
    """(h, w), False outside the movie's picture and in its padding."""
    tissue: Bools
    """(h, w)"""
    body: Bools
    """(h, w): the tissue with its holes filled."""
    middle: Floats
    """(2,): the tissue's middle (row, col) in this picture."""
    width: float
    """Largest width of the body here, in pixels of this picture."""
    to_movie: Floats
    """(2, 3): turns (row, col, 1) of this picture into (row, col) of the movie."""

    def in_movie(self, points: Floats) -> Floats:
        """Where points (N, 2) of this picture lie in the movie, in pixels (N, 2)."""
        return np.asarray(points @ self.to_movie[:, :2].T + self.to_movie[:, 2])

    def carried(self, field: Floats, shape: tuple[int, int], outside: float = 0.0) -> Floats:
        """Turn a field (h, w) of this picture back into one (R, C) of the movie's frames, by interpolation."""
        swapped = self.to_movie[::-1][:, [1, 0, 2]]  # cv2 has x first
        return np.asarray(cv2.warpAffine(np.asarray(field, np.float32), swapped, (shape[1], shape[0]),
                                         flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside))


def lay_level(view: View, masks: Masks) -> Level:
    """Lay a view of the movie level along the axis of its tissue, without the detail finer than a pixel of it."""
    shape, axis = masks.tissue.shape, masks.axis
    scale = axis.length_px / LENGTH_PX
    along = axis.direction
    across = np.array([along[1], -along[0]])  # a level tissue's "across" points down the rows
    body = fill_holes(largest_region(masks.tissue))
    reach_px = np.abs((np.argwhere(body)[::7] - axis.center_px) @ across).max()
    reach = max(REACH_ACROSS[0] * LENGTH_PX, REACH_ACROSS[1] * 2 * reach_px / scale)
    middle = np.ceil([reach, REACH_ALONG * LENGTH_PX])
    turn = np.stack([across, along], axis=1) * scale
    to_movie = np.column_stack([turn, axis.center_px - turn @ middle])

    rows, cols = (int(2 * m) + 1 for m in middle)
    row, col = np.mgrid[:rows, :cols].astype(np.float32)
    place = to_movie @ np.stack([row.ravel(), col.ravel(), np.ones(row.size, np.float32)])
    row, col = place.reshape(2, rows, cols).astype(np.float32)
    shrink = view.mean.shape[1] / shape[1]
    at = (shrink * (col + 0.5) - 0.5, shrink * (row + 0.5) - 0.5)
    image = cv2.remap(blurred(view.mean, 0.5 * scale * shrink), *at, cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)
    seen = cv2.remap(view.seen.astype(np.float32), *at, cv2.INTER_LINEAR) > 0.99
    tissue, filled = (cv2.remap(mask.astype(np.uint8), col, row, cv2.INTER_NEAREST) > 0 for mask in
                      (masks.tissue, body))
    return Level(np.asarray(image), np.asarray(seen), tissue, filled, np.asarray(middle),
                 float(filled.sum(axis=0).max()), to_movie)
