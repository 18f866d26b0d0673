"""Follow single points by the grey values around them: for sparse regions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .data import Bools, Floats, Movie, Tracks
from .errors import ConfigError
from .patches import Noise, Patches
from .search import ODD, Search, odd, reference_picture, through, usable_pixels, usual

LEAST_VARIANCE = 1e-4
"""Of the residual in a usual frame, as a share of the patch's own."""


def follow_points(movie: Movie, points_px: ArrayLike, *, half_width_px: int = 10, mask: Bools | None = None,
                  reference_frame: int = 0, max_error_px: float = 0.5) -> Tracks:
    """Follow points (N, 2), each by the square of 2 half_width_px + 1 px around it, through all frames of a movie.

    Points are (row, col) in px in the reference frame. Only pixels inside `mask` (R, C) count, when it is given: let
    it hold what moves together, so that a square at a border does not see both sides. `position_px` (T, N, 2) is NaN
    and `ok` False wherever a point cannot be followed: fewer than 60 usable pixels, no texture, a search that does
    not end, a picture that does not match, or a standard error above `max_error_px`. `position_se_px` (T, N, 2) is the
    standard error of the way from the reference frame; it holds the noise of both frames, and grows where a frame's
    residual is far above that of the point's other frames. A pattern that repeats itself can be followed only while
    it moves by less than half of its period from frame to frame.

    Raises ConfigError for points, a half width or a reference frame that are not allowed, and MaskUnusable.
    """
    points = _checked_points(points_px)
    if not 3 <= half_width_px <= 100:
        raise ConfigError(f"half_width_px: expected 3 to 100 px; found {half_width_px}. 10 suits most textures")
    picture, usable = reference_picture(movie, reference_frame), usable_pixels(movie, mask)
    corner = np.rint(points).astype(int) - int(half_width_px)
    patches = Patches(picture, usable, corner, (2 * int(half_width_px) + 1,) * 2, points, "affine")
    count = movie.count, len(points)
    position, ok = np.full((*count, 2), np.nan), np.zeros(count, bool)
    variance, unlike = np.zeros(count), np.ones(count)
    noise = Noise(patches, movie.count)
    for t, _, _, found in through(movie, reference_frame, [Search(picture, patches, points[:, None])]):
        position[t] = points + found.warp[:, :, 2]
        ok[t], variance[t], unlike[t] = found.ok, found.variance, 1 - found.match
        noise.add(t, found)
    ok &= ~odd(unlike, ok)
    typical = usual(variance, ok)
    # What exceeds the usual residual is no noise but another picture, and does not average out over the pixels.
    excess = variance / (ODD * np.maximum(typical, LEAST_VARIANCE * patches.contrast))
    se = noise.standard_error(variance, (0, 1)) * patches.noisy_slopes(typical / 2)
    se *= np.sqrt(np.maximum(excess, 1))[:, :, None]
    ok &= se.max(axis=-1) <= max_error_px
    position[~ok], se[~ok] = np.nan, np.nan
    return Tracks(position, ok, "subsets", reference_frame, 2 * int(half_width_px) + 1, position_se_px=se)


def _checked_points(points_px: ArrayLike) -> Floats:
    points = np.asarray(points_px, float)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise ConfigError(f"points_px: expected (N, 2), a row and a col for each point; found shape {points.shape}")
    if not np.isfinite(points).all():
        raise ConfigError(f"points_px: expected numbers; found NaN or infinity in point "
                          f"{int(np.argmin(np.isfinite(points).all(axis=1)))}")
    return points
