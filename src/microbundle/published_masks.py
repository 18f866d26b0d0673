"""The paper's three ways to part tissue from ground, step by step as in the published tool.

Otsu's threshold on a frame (`otsu`), on the smoothed gradient of a frame (`sobel`), and on the darkest or brightest
value that each pixel takes over the movie (`minimum`, `maximum`). They answer for any picture that is not blank.
Source: paper, "Tissue segmentation".
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from .axis import largest_region
from .data import Bools, Floats, Image, Movie
from .published import without_border
from .threshold import otsu

CLOSING_PX = {"otsu": 3, "sobel": 10, "minimum": 25, "maximum": 25}
SOBEL_SIGMA_PX = 5.0
ROUNDING_PX = 1e-3
"""Distances are square roots of whole numbers, as float32."""


def paper_mask(image: Image, method: str, shift: float = 0.0) -> Bools:
    """Part tissue from ground on a frame or projection (R, C) as the paper does; empty where the picture is blank."""
    if image.min() == image.max():
        return np.zeros(image.shape, bool)
    if method == "sobel":
        field = np.hypot(ndimage.sobel(image.astype(float), 0), ndimage.sobel(image.astype(float), 1))
        field = ndimage.gaussian_filter(field, SOBEL_SIGMA_PX)
        tissue = field > otsu(field, shift)
    else:
        field = image if method == "otsu" else ndimage.median_filter(image, size=2)
        tissue = without_border(field <= otsu(field, shift))
    return _close_with_disk(largest_region(tissue), CLOSING_PX[method])


def projections(movie: Movie, method: str) -> tuple[Image, Image, Image]:
    """Darkest (or brightest) value of each pixel over all frames, over the first third and over the last third."""
    extreme = np.minimum if method == "minimum" else np.maximum
    third = -(-movie.count // 3)
    whole = first = np.asarray(movie.frames[0])
    last = np.asarray(movie.frames[movie.count - third])
    for index in range(movie.count):
        frame = np.asarray(movie.frames[index])
        whole = extreme(whole, frame)
        first = extreme(first, frame) if index < third else first
        last = extreme(last, frame) if index >= movie.count - third else last
    return whole, first, last


def _close_with_disk(mask: Bools, radius_px: int) -> Bools:
    """Binary closing by the disk of all pixels within `radius_px`; the picture's border does not erode."""
    if not mask.any():
        return mask
    grown = _distance(~mask) <= radius_px + ROUNDING_PX
    return grown if grown.all() else _distance(grown) > radius_px + ROUNDING_PX


def _distance(mask: Bools) -> Floats:
    """Exact distance of each pixel of a mask from the nearest pixel outside it."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
