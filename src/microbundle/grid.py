"""Interpolate displacement on a regular grid in the tissue's axes.

Source: paper, "Optional rotation and interpolation". Points outside the tissue get no value unless asked for.
"""

from __future__ import annotations

import numpy as np

from .config import Config
from .data import Beats, Grid, Masks, Tracks
from .field import inside_tissue, interpolate
from .geometry import to_image, to_tissue


def interpolate_grid(tracks: Tracks, beats: Beats, masks: Masks, config: Config) -> Grid:
    """Lay a grid along the tissue's axis over its whole extent, and interpolate the displacement from rest there."""
    params = config.grid
    axis = masks.axis
    low, high = _extent(masks)
    lines = [np.arange(a + 0.5 * ((b - a) % params.spacing_px), b + 1e-9, params.spacing_px)
             for a, b in zip(low, high, strict=True)]
    level = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    points = to_image(level, axis.center_px, axis.direction)
    tissue = None if params.extrapolate else masks.tissue
    if tracks.field is not None:
        moved = tracks.field.from_rest(points, beats.relaxed)
        if tissue is not None:
            moved[:, ~inside_tissue(points, tissue)] = np.nan
    else:
        moved = interpolate(beats.relaxed_px, tracks.position_px - beats.relaxed_px.astype(np.float32), points,
                            method=params.method, tissue=tissue)
    return Grid(points, (len(lines[0]), len(lines[1])), moved)


def _extent(masks: Masks) -> tuple[np.ndarray, np.ndarray]:
    level = to_tissue(np.argwhere(masks.tissue).astype(float), masks.axis.center_px, masks.axis.direction)
    return level.min(axis=0), level.max(axis=0)
