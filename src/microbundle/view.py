"""What the search for tissue looks at: a movie's mean frame at moderate size, and pictures that are high on tissue.

Tissue can be darker than its ground, also under uneven light, rougher, or brighter: `KINDS` has a picture for each.
All lengths are shares of the side of the square with the picture's area, so that the size of the frames does not
matter. Disks of any radius cost one distance transform.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from .data import Bools, Floats, Movie
from .errors import NoTissue

FRAMES_READ = 24
"""Frames that the default reads, evenly spaced."""
FINE_PX, COARSE_PX = 512, 192
"""Longest side of the picture in which the outline is drawn, and of the one in which regions are compared."""
SMALLEST_PX = 24
"""Below this side, a tissue is a few pixels wide and no outline can be drawn."""
PADDING_LIMIT = 0.7
"""A picture turned by 45 degrees and kept whole is half padding; with more black than this, too little is left to
see."""
BRIGHTNESS_BLUR = 0.003
"""Smoothing before a threshold, as a share of the picture's side: 1.5 px of 512, about the grain of the noise."""
DETAIL_BLURS = (0.002, 0.006)
"""Fine detail is what lies between these two smoothings: cells and fibres, not shading."""
TEXTURE_REACH = 0.016
"""Half a window of the median that says how strong the detail is: a few fibres wide."""
TEXTURE_BLUR = 0.004
"""Smoothing of that median, which has square corners."""
ADVICE = ("Supply a tissue mask with the movie, choose another mask method, or crop the movie to one tissue that is "
          "in focus and fully visible.")


@dataclass(frozen=True)
class View:
    """The mean of some frames in a picture of moderate size, and where it shows anything."""

    mean: Floats
    """(r, c) mean brightness as float32, the padding filled in."""
    seen: Bools
    """(r, c), False in the padding."""

    @property
    def side_px(self) -> float:
        """Side of the square with the picture's area: the unit of all lengths here."""
        return float(np.sqrt(self.mean.size))

    def shrunk(self, longest_px: int) -> View:
        """The same view with its longer side at most `longest_px`."""
        return View(shrink(self.mean, longest_px), shrink(self.seen.astype(np.float32), longest_px) > 0.99)


def views(movie: Movie) -> list[View]:
    """Views of the whole movie and, from three frames on, of its first and last third.

    Raises NoTissue where most of the picture is empty.
    """
    index = np.unique(np.linspace(0, movie.count - 1, min(FRAMES_READ, movie.count)).round().astype(int))
    sums: list[Any] = [0.0, 0.0, 0.0]
    counts = [0, 0, 0]
    first = np.asarray(movie.frames[0])
    empty, still = np.ones(movie.shape, bool), np.ones(movie.shape, bool)
    for i in index:
        frame = np.asarray(movie.frames[int(i)])
        empty &= frame == 0
        still &= frame == first
        third = min(int(3 * i / movie.count), 2)
        sums[third] = sums[third] + shrink(frame.astype(np.float32), FINE_PX)
        counts[third] += 1
    padding = _padding(empty)
    # The rim of the padding is half padding: interpolated when the picture was turned.
    pictured = ~dilate(padding, 2)
    # A camera's black is not always zero, but it is always the same, and nothing but a rim of the padding is darker.
    darkest = np.percentile(first[pictured], 1, method="lower") if pictured.any() else 0
    black = padding | (still & (first <= darkest))
    if black.mean() > PADDING_LIMIT and not (pictured.any() and black[pictured].all()):
        raise NoTissue(f"{movie.name}: expected a picture of a tissue, found {black.mean():.0%} of it at the one "
                       f"darkest value, as after a threshold or too short an exposure. {ADVICE}")
    seen = shrink(pictured.astype(np.float32), FINE_PX) > 0.99
    if min(seen.shape) < SMALLEST_PX or not seen.any():
        raise NoTissue(f"{movie.name}: expected frames of at least {SMALLEST_PX} x {SMALLEST_PX} px, found "
                       f"{movie.shape[0]} x {movie.shape[1]}. {ADVICE}")
    nearest = None if seen.all() else tuple(
        ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True))
    whole = _view(sum(sums) / sum(counts), seen, nearest)
    if min(counts) == 0:
        return [whole]
    return [whole, _view(sums[0] / counts[0], seen, nearest), _view(sums[2] / counts[2], seen, nearest)]


def _view(mean: Floats, seen: Bools, nearest: tuple[Any, ...] | None) -> View:
    """Make a view of a mean frame; `nearest` holds, for each pixel, the row and the column of the nearest seen one."""
    calm = cv2.medianBlur(np.nan_to_num(mean).astype(np.float32), 3)  # a hot pixel would set the scale of all below
    low, high = np.percentile(calm[seen], [0.1, 99.9])
    # A brightness below zero, as in a float movie with its mean taken off, has no ratio to the ground's.
    lifted: Floats = np.asarray(np.clip(calm, low, high) - min(low, 0.0), np.float32)
    if nearest is not None:
        lifted = np.asarray(lifted[nearest], np.float32)
    return View(lifted, seen)


def _padding(empty: Bools) -> Bools:
    """Pixels that are zero in every frame and connect to the border by pixels like them."""
    count, label = cv2.connectedComponents(empty.astype(np.uint8), connectivity=4)
    border = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    keep = np.zeros(count, bool)
    keep[border] = True
    keep[0] = False
    return np.asarray(keep[label])


def _darkness(view: View, blur: float) -> Floats:
    return -blurred(view.mean, view.side_px * BRIGHTNESS_BLUR * blur)


def _even_darkness(view: View, blur: float) -> Floats:
    """Darkness after division by the light of the ground, a paraboloid fitted to the brighter pixels."""
    smooth = blurred(view.mean, view.side_px * BRIGHTNESS_BLUR * blur)
    thin = (slice(None, None, 4),) * 2
    row, col = np.mgrid[-1:1:smooth.shape[0] * 1j, -1:1:smooth.shape[1] * 1j]
    terms = np.stack([np.ones_like(row), row, col, row * row, row * col, col * col], axis=-1)
    value, term, used = smooth[thin].ravel(), terms[thin].reshape(-1, 6), view.seen[thin].ravel().copy()
    ground = np.full(value.shape, np.median(value[used]))
    for _ in range(5):
        bright = used & (value >= 0.9 * ground)
        if np.count_nonzero(bright) < 0.1 * len(value):
            break
        ground = term @ np.linalg.lstsq(term[bright], value[bright], rcond=None)[0]
    coefficient = np.linalg.lstsq(term, ground, rcond=None)[0]
    faintest = max(0.2 * float(np.median(ground)), 0.05 * float(np.ptp(smooth)), 1e-30)  # corners may be all dark
    light = np.maximum(terms @ coefficient, faintest)
    return np.asarray(-smooth / light, np.float32)


def _texture(view: View, blur: float) -> Floats:
    """Logarithm of the local strength of fine detail; a median, for a mean would carry an edge's strength outwards."""
    strength = np.log(detail_strength(view))
    low, high = np.percentile(strength, [1, 99])
    bytes_ = (np.clip((strength - low) / max(high - low, 1e-9), 0, 1) * 255).astype(np.uint8)  # cv2's wide median
    window = 2 * max(round(TEXTURE_REACH * view.side_px * blur), 1) + 1
    return blurred(cv2.medianBlur(bytes_, window).astype(np.float32), view.side_px * TEXTURE_BLUR * blur)


def detail_strength(view: View) -> Floats:
    """Measure how strong the fine detail is at each pixel (r, c), never zero."""
    detail = np.abs(_detail(view))
    return detail + 0.1 * max(float(detail[view.seen].mean()), 1e-30)


def _detail(view: View) -> Floats:
    """Brightness between two scales; none at the rim of the padding, where the fill would make some."""
    fine, rough = (blurred(view.mean, view.side_px * blur) for blur in DETAIL_BLURS)
    return np.where(erode(view.seen, 2 * DETAIL_BLURS[1] * view.side_px), fine - rough, 0.0)


def _brightness(view: View, blur: float) -> Floats:
    return -_darkness(view, blur)


@dataclass(frozen=True)
class Kind:
    """One way in which tissue can differ from its ground."""

    field: Callable[[View, float], Floats]
    """Picture that is high on tissue, from a view and a factor on the smoothing."""
    prior: float
    """Factor on the plausibility."""
    edge_level: float
    """Level of the outline, from 0 on the ground to 1 in the tissue."""


# The rim of a dark tissue is thin and so less dark: the level halfway would lie too far inside. Texture is measured
# over a window, which carries it outwards: there the level halfway would lie too far outside. A bright strip is more
# often the ground between a tissue and a wall than a tissue.
KINDS = {"dark": Kind(_darkness, 1.0, 0.4), "dark_evened": Kind(_even_darkness, 1.0, 0.4),
         "texture": Kind(_texture, 1.0, 0.7), "bright": Kind(_brightness, 0.75, 0.4)}


def dilate(mask: Bools, radius: float) -> Bools:
    """Add all pixels within `radius` of a mask: a disk of any size at the cost of one distance transform."""
    if radius <= 0 or not mask.any():
        return mask
    return distance(~mask) <= radius


def erode(mask: Bools, radius: float) -> Bools:
    """Take all pixels within `radius` of the ground off a mask; beyond the picture's border there is no ground."""
    if radius <= 0 or mask.all():
        return mask
    return distance(mask) > radius


def opened(mask: Bools, radius: float) -> Bools:
    """Take off a mask what a disk of `radius` does not fit into."""
    return dilate(erode(mask, radius), radius)


def distance(mask: Bools) -> Floats:
    """Distance of each pixel of a mask from the nearest pixel outside it, to 2 %."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5))


def blurred(image: Floats, sigma: float) -> Floats:
    """Smooth a picture by a Gaussian of at least 0.4 px."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(sigma, 0.4)))


def shrink(image: Floats, longest_px: int) -> Floats:
    """Average a picture down until its longer side is at most `longest_px`."""
    scale = longest_px / max(image.shape)
    if scale >= 1:
        return image
    rows, cols = (max(round(n * scale), 1) for n in image.shape)
    return np.asarray(cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA))


def enlarge(mask: Bools, shape: tuple[int, ...]) -> Bools:
    """The same mask in a larger picture, its outline interpolated."""
    if mask.shape == tuple(shape):
        return mask
    return np.asarray(cv2.resize(mask.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR) >= 0.5)
