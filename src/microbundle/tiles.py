"""Place the sub-domains: a grid of square tiles in the middle of the tissue, in the tissue's axes.

The ends of the tissue, around the pillars, are left out, and a margin is kept free. `paper` keeps the published tool's
rounding to whole pixels. Source: paper, "Sub-domain strain".
"""

from __future__ import annotations

from dataclasses import dataclass
from string import ascii_uppercase

import numpy as np

from .axis import largest_region
from .config import Config, StrainParams
from .data import Bools, Floats, Masks
from .errors import CannotMeasure
from .geometry import to_image, to_tissue
from .published import paper_box, paper_frame


@dataclass(frozen=True)
class Tiling:
    """Where the sub-domains are, in the tissue's axes."""

    corner: Floats
    """Upper left corner (2,) of the grid."""
    grid: tuple[int, int]
    side: tuple[float, float]
    center: Floats
    """Point (2,) about which the tissue's axes are turned."""
    direction: Floats

    @property
    def boxes(self) -> Floats:
        """First row, end row, first column and end column of each tile (S, 4)."""
        row, col = np.divmod(np.arange(self.grid[0] * self.grid[1]), self.grid[1])
        r0, c0 = self.corner[0] + row * self.side[0], self.corner[1] + col * self.side[1]
        return np.stack([r0, r0 + self.side[0], c0, c0 + self.side[1]], axis=1)

    @property
    def corner_px(self) -> Floats:
        """Corners of each tile in the image (S, 4, 2), clockwise from the upper left in the tissue's axes."""
        r0, r1, c0, c1 = self.boxes.T
        corners = np.stack([np.stack([r0, c0], 1), np.stack([r0, c1], 1), np.stack([r1, c1], 1), np.stack([r1, c0], 1)],
                           1)
        return to_image(corners, self.center, self.direction)

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(f"{_letters(r)}{c + 1}" for r in range(self.grid[0]) for c in range(self.grid[1]))


def place_tiles(masks: Masks, config: Config) -> Tiling:
    """Place the grid of sub-domains in the middle of the tissue, as the settings ask.

    Raises CannotMeasure where none fits.
    """
    params = config.strain
    if config.method == "paper":
        return _paper_tiles(masks.tissue, params)
    center, direction = masks.axis.center_px, masks.axis.direction
    r0, r1, c0, c1 = divided_rectangle(masks, params)
    r0, r1 = _clipped(r0, r1, params.shrink_rows)
    c0, c1 = _clipped(c0, c1, params.shrink_columns)
    grid, side = _fit(r1 - r0, c1 - c0, params)
    corner = 0.5 * np.array([r0 + r1 - grid[0] * side, c0 + c1 - grid[1] * side])
    return Tiling(corner, grid, (side, side), center, direction)


def divided_rectangle(masks: Masks, params: StrainParams) -> tuple[float, float, float, float]:
    """Find the rectangle that is divided, margins included: first row, end row, first column, end column in the
    tissue's axes, as `strain.extents_px` gives it.

    Raises CannotMeasure where no tissue is left.
    """
    if params.extents_px is not None:
        return params.extents_px
    tissue = np.argwhere(largest_region(masks.tissue)).astype(float)
    row, col = to_tissue(tissue, masks.axis.center_px, masks.axis.direction).T
    c0, c1 = _clipped(float(col.min()), float(col.max()), params.clip_columns)
    part = row[(col >= c0) & (col <= c1)]
    if part.size == 0:
        raise CannotMeasure("strain: no tissue is left between the clipped ends; lower strain.clip_columns")
    r0, r1 = _clipped(float(part.min()), float(part.max()), params.clip_rows)
    return r0, r1, c0, c1


def _paper_tiles(tissue: Bools, params: StrainParams) -> Tiling:
    """The published tool's tiles, with its rounding to whole pixels."""
    frame = paper_frame(tissue)
    if params.extents_px is not None:
        r0, r1, c0, c1 = params.extents_px
    else:
        level = frame.level.copy()
        for axis, share in ((1, params.clip_columns), (0, params.clip_rows)):
            box = paper_box(level)
            cut = int(0.5 * share * (box[:, axis].max() - box[:, axis].min()))
            place = np.arange(level.shape[axis])
            outside = (place < box[:, axis].min() + cut) | (place >= box[:, axis].max() - cut)
            if cut > 0:
                level &= ~np.expand_dims(outside, 1 - axis)
        box = paper_box(level)
        (r0, c0), (r1, c1) = box.min(axis=0), box.max(axis=0)
    margin = int(0.5 * params.shrink_rows * (r1 - r0)), int(0.5 * params.shrink_columns * (c1 - c0))
    r0, r1, c0, c1 = r0 + margin[0], r1 - margin[0], c0 + margin[1], c1 - margin[1]
    grid, side = _fit(r1 - r0, c1 - c0, params)
    corner = np.floor(0.5 * np.array([r0 + r1 - grid[0] * side, c0 + c1 - grid[1] * side]))
    return Tiling(corner, grid, (side, side), frame.center, frame.strain_direction)


def _fit(height: float, width: float, params: StrainParams) -> tuple[tuple[int, int], float]:
    if params.tiles is not None:
        rows, cols = params.tiles
        side = float(np.floor(min(height / rows, width / cols)))
    else:
        side = params.tile_px
        rows, cols = int(height // side), int(width // side)
    if rows < 1 or cols < 1 or side < 1:
        raise CannotMeasure(f"strain: expected room for at least one sub-domain of {params.tile_px:g} px; the middle "
                            f"of the tissue has {height:.0f} x {width:.0f} px. Lower strain.tile_px, "
                            "strain.clip_columns or the margins, or give strain.tiles or strain.extents_px")
    return (rows, cols), side


def _clipped(first: float, last: float, share: float) -> tuple[float, float]:
    """Take a share off a range, half at each end."""
    cut = 0.5 * share * (last - first)
    return first + cut, last - cut


def _letters(row: int) -> str:
    """A to Z, then AA, AB, ..."""
    return (ascii_uppercase[row // 26 - 1] if row >= 26 else "") + ascii_uppercase[row % 26]
