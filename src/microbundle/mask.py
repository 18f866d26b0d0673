"""Which pixels are tissue: a movie becomes a mask, the tissue's axis, and a measure of how far to trust them.

Four methods are the paper's (MicroBundleCompute, tissue segmentation): Otsu's threshold on a frame, on the gradient of
a frame, and on the darkest or brightest value that each pixel takes. They answer for any picture that is not blank.

The automatic default proposes many regions: dark ones (with and without a correction of uneven light), textured ones
and bright ones, each also cut free of what it touches by openings. It asks of every region what one asks of a
microbundle: a strip of plausible size near the middle of the picture, compact, straight, not hanging on the picture's
border, and different from the ground beside it. The most plausible region wins; if none is plausible enough, it
refuses. The bright caps of pillars are then cut out.

Stability is the smallest overlap with the masks that a shifted threshold, a stronger smoothing, and the first and the
last third of the movie give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from .axis import bend, fill_holes, largest_region, measure_axis
from .config import MaskParams
from .data import Bools, Finding, Floats, Image, Masks, Movie
from .errors import ConfigError, MaskUnusable, NoTissue

THRESHOLD_SHIFT = 0.1
"""The stability check moves a threshold by this share of the distance between the means of its two classes."""
FLOAT_BINS = 256
THREE_CLASS_BINS = 64
"""Enough for a proposal; all pairs of bins are tried."""
LARGEST_EXACT_RANGE = 2**16
"""Whole numbers up to this range get one bin for each value."""

PAPER_BORDER_PX = 10
PAPER_CLOSING_PX = {"otsu": 3, "sobel": 10, "minimum": 25, "maximum": 25}
PAPER_SOBEL_SIGMA_PX = 5.0

FRAMES_READ = 24
"""Frames that the default reads, evenly spaced."""
FINE_PX, COARSE_PX = 512, 192
"""Longest side of the picture in which the outline is drawn, and of the one in which regions are compared."""
SMALLEST_PX = 24
"""Below this side, a tissue is a few pixels wide and no outline can be drawn."""
PADDING_LIMIT = 0.7
"""A picture turned by 45 degrees and kept whole is half padding; with more than this, too little is left to see."""
BRIGHTNESS_BLUR = 0.003
"""Smoothing before a threshold, as a share of the picture's side: 1.5 px of 512, about the grain of the noise."""
DETAIL_BLURS = (0.002, 0.006)
"""Fine detail is what lies between these two smoothings: cells and fibres, not shading."""
TEXTURE_REACH = 0.016
"""Half a window of the median that says how strong the detail is: a few fibres wide."""
TEXTURE_BLUR = 0.004
"""Smoothing of that median, which has square corners."""
OPENINGS = (0.0, 0.008, 0.016, 0.032)
"""Radii of the openings that cut a region free of its neighbours, as shares of the picture's side."""
STRONGER_BLUR = 1.5
"""Factor on the smoothing, for the stability."""
HAIR = 0.006
"""Thinner threads are taken off the outline, and narrower gaps closed; 3 px of 512."""
NEAR_BAND = (0.012, 0.05)
"""From here to there on either side of the outline lie the pixels that stand for tissue and for ground."""
SMALL_HOLE_SHARE = 0.01
"""Holes below this share of the tissue are filled; a pillar's cap takes 5 % or more."""
CAP_INSIDE = 0.02
"""A cap lies at least this share of the picture's side inside the outline."""
CAP_FROM_CENTER = 0.2
"""Distance of a cap from the centre, as a share of the length, is at least this."""
CAP_SHARE = (0.01, 0.25)
CAP_SOLIDITY = 0.7
CAP_CONTRAST = 2.0
"""Difference of a cap's brightness from the tissue's, in standard deviations of the tissue's."""
CAP_BRIGHTNESS = 0.2
"""Least brightness of a cap, from 0 in the tissue to 1 on the ground; a mere spot of the tissue is darker."""
CAP_RIM = 0.01
"""Width of the rim of a cap that is neither cap nor tissue."""
ACCEPT = 0.35
"""Smallest plausibility that is believed."""
REFUSE_STABILITY = 0.4
"""A region whose variations share less than this with it is an accident of the threshold, not a thing."""
ADVICE = ("Supply a tissue mask with the movie, choose another mask method, or crop the movie to one tissue that is "
          "in focus and fully visible.")


def find_masks(movie: Movie, params: MaskParams, *, axis_deg: float | None = None) -> Masks:
    """Find the tissue (R, C) in a movie, and measure its axis in pixels.

    `auto` takes the mask that came with the movie, or else looks for the tissue by itself. `axis_deg` gives the angle
    of the long axis, clockwise from the columns, in place of the measured one. Frames are read one at a time, so
    memory does not grow with their number. Raises MaskUnusable for a supplied mask that does not fit the frames or is
    empty, NoTissue where no region can be taken for tissue, and ConfigError for a frame that the movie does not have.
    """
    if params.method == "auto" and "tissue" in movie.supplied_masks:
        tissue = _supplied(movie)
        told = Finding("mask_supplied", "info", "The tissue is the mask that came with the movie.")
        return Masks(tissue, measure_axis(tissue, axis_deg), "supplied", None, (told, *_border_findings(tissue)))
    if movie.count == 0:
        raise NoTissue(f"{movie.name}: expected at least one frame to look for the tissue on, found none.")
    if params.method == "auto":
        method, tissue, stability = _automatic(movie)
    else:
        method, tissue, stability = _by_paper(movie, params)
    findings = (*_stability_findings(stability, params.min_stability), *_border_findings(tissue))
    return Masks(tissue, measure_axis(tissue, axis_deg), method, stability, findings)


def overlap(one: Bools, other: Bools) -> float:
    """Compare two masks (R, C): intersection over union, 0 where both are empty."""
    union = np.count_nonzero(one | other)
    return float(np.count_nonzero(one & other) / union) if union else 0.0


# --- findings and the supplied mask ---------------------------------------------------------------------------------


def _supplied(movie: Movie) -> Bools:
    tissue = np.array(movie.supplied_masks["tissue"], bool)
    if tissue.shape != movie.shape:
        raise MaskUnusable(f"{movie.name}: expected a tissue mask of {movie.shape} pixels like the frames, found "
                           f"{tissue.shape}. Draw the mask on a frame of this movie.")
    if not tissue.any():
        raise MaskUnusable(f"{movie.name}: the tissue mask marks no pixel. Expected tissue as 1 (or 255) on a ground "
                           "of 0. Leave the mask out to have the tissue found automatically.")
    return tissue


def _stability_findings(stability: float, limit: float) -> tuple[Finding, ...]:
    if stability >= limit:
        return ()
    return (Finding("mask_unstable", "review",
                    f"The tissue mask depends on details: slightly other settings, or another part of the movie, give "
                    f"a mask that overlaps only {stability:.0%} with it (limit {limit:.0%}). Look at the mask, and "
                    "supply one if it does not follow the tissue.", stability, limit),)


def _border_findings(tissue: Bools) -> tuple[Finding, ...]:
    touching = int(sum(np.count_nonzero(edge) for edge in (tissue[0], tissue[-1], tissue[1:-1, 0], tissue[1:-1, -1])))
    if touching == 0:
        return ()
    return (Finding("mask_touches_border", "info",
                    f"The tissue mask reaches the picture's border ({touching} px of it): tissue outside the picture "
                    "is not measured, and length is a lower bound.", float(touching), 0.0),)


# --- the paper's methods --------------------------------------------------------------------------------------------


def _by_paper(movie: Movie, params: MaskParams) -> tuple[str, Bools, float]:
    """Name, mask and stability of one of the paper's methods; raises NoTissue where its picture is blank."""
    method = params.method
    if method in ("otsu", "sobel"):
        if params.frame >= movie.count:
            raise ConfigError(f"{movie.name}: mask.frame is {params.frame}, but the movie has {movie.count} frames, "
                              "counted from 0.")
        # A part of the movie is stood for by the frame in its middle.
        whole, *parts = (np.asarray(movie.frames[index]) for index in
                         (params.frame, movie.count // 6, movie.count - 1 - movie.count // 6))
    else:
        whole, *parts = _projections(movie, method)
    tissue = _paper_mask(whole, method)
    if not tissue.any():
        raise NoTissue(f"{movie.name}: expected the method {method!r} to part the tissue from the ground by its "
                       f"brightness, found nothing to part. {ADVICE}")
    varied = [_paper_mask(whole, method, shift=shift) for shift in (-THRESHOLD_SHIFT, THRESHOLD_SHIFT)]
    varied.append(_paper_mask(ndimage.gaussian_filter(whole.astype(float), 1.0), method))
    varied += [_paper_mask(part, method) for part in parts]
    return method, tissue, min(overlap(tissue, other) for other in varied)


def _projections(movie: Movie, method: str) -> tuple[Image, Image, Image]:
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


def _paper_mask(image: Image, method: str, shift: float = 0.0) -> Bools:
    """Part tissue from ground on a frame or projection (R, C) as the paper does; empty where the picture is blank."""
    if image.min() == image.max():
        return np.zeros(image.shape, bool)
    if method == "sobel":
        field = np.hypot(ndimage.sobel(image.astype(float), 0), ndimage.sobel(image.astype(float), 1))
        field = ndimage.gaussian_filter(field, PAPER_SOBEL_SIGMA_PX)
        tissue = field > otsu(field, shift)
    else:
        field = image if method == "otsu" else ndimage.median_filter(image, size=2)
        tissue = field <= otsu(field, shift)
        border = np.ones(image.shape, bool)
        border[PAPER_BORDER_PX:-PAPER_BORDER_PX, PAPER_BORDER_PX:-PAPER_BORDER_PX] = False
        tissue &= ~border
    return _close_with_disk(largest_region(tissue), PAPER_CLOSING_PX[method])


def _close_with_disk(mask: Bools, radius_px: int) -> Bools:
    """Binary closing by the disk of all pixels within `radius_px`; the picture's border does not erode."""
    if not mask.any():
        return mask
    rounding = 1e-3  # the distances are square roots of whole numbers, as float32
    grown = _distance(~mask, cv2.DIST_MASK_PRECISE) <= radius_px + rounding
    return grown if grown.all() else _distance(grown, cv2.DIST_MASK_PRECISE) > radius_px + rounding


def otsu(values: Image, shift: float = 0.0) -> float:
    """Find the threshold that parts values, of any shape, into the two classes farthest apart (Otsu 1979).

    Whole numbers get one bin for each value, others 256 bins. `shift` moves the threshold by that share of the
    distance between the means of the classes. Raises ValueError where all values are equal.
    """
    center, count = _histogram(values)
    low, high = np.cumsum(count)[:-1], np.cumsum(count[::-1])[-2::-1]
    total = np.cumsum(count * center)
    mean_low = total[:-1] / low
    mean_high = (total[-1] - total[:-1]) / high
    best = int(np.argmax(low * high * (mean_high - mean_low) ** 2))
    return float(center[best] + shift * (mean_high[best] - mean_low[best]))


def _histogram(values: Image, bins: int = FLOAT_BINS) -> tuple[Floats, Floats]:
    """Centres and counts of the bins; the first and the last bin are never empty."""
    values = np.asarray(values).ravel()
    low, high = values.min(), values.max()
    if low == high:
        raise ValueError(f"values: expected at least two different ones, found only {low}")
    if values.dtype.kind in "iu" and int(high) - int(low) < LARGEST_EXACT_RANGE:
        count = np.bincount(values.astype(np.int64) - int(low))
        return np.arange(int(low), int(high) + 1, dtype=float), count.astype(float)
    counts, edges = np.histogram(values.astype(float), bins)
    return 0.5 * (edges[1:] + edges[:-1]), counts.astype(float)


# --- the automatic default ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _View:
    """The mean of some frames in a picture of moderate size, and where it shows anything."""

    mean: Floats
    """(r, c) mean brightness as float32, the padding filled in."""
    seen: Bools
    """(r, c), False in the padding."""

    @property
    def side_px(self) -> float:
        """Side of the square with the picture's area: the unit of all lengths here."""
        return float(np.sqrt(self.mean.size))

    def shrunk(self, longest_px: int) -> _View:
        """The same view with its longer side at most `longest_px`."""
        return _View(_shrink(self.mean, longest_px), _shrink(self.seen.astype(np.float32), longest_px) > 0.99)


@dataclass(frozen=True)
class _Recipe:
    """How a region was made: a field that is high on tissue, one of its thresholds, and an opening."""

    kind: str
    """A key of KINDS."""
    threshold: int
    """Which of the field's thresholds."""
    opening: float


def _automatic(movie: Movie) -> tuple[str, Bools, float]:
    """Name, mask and stability of the most plausible region; raises NoTissue where none is plausible."""
    whole, *parts = _views(movie)
    if np.ptp(whole.mean) == 0:
        raise NoTissue(f"{movie.name}: expected a tissue that differs from its ground, found frames of one single "
                       f"brightness. {ADVICE}")
    coarse = whole.shrunk(COARSE_PX)
    recipe, region, plausibility = _most_plausible(coarse)
    if recipe is None or plausibility < ACCEPT:
        raise NoTissue(f"{movie.name}: expected one dark or textured strip of tissue near the middle of the picture, "
                       f"found no region like that (the most plausible one scores {plausibility:.2f} of 1, needed "
                       f"{ACCEPT}). {ADVICE}")
    tissue = _draw(whole, recipe, _enlarge(region, whole.mean.shape))
    stability = _stability([coarse, *(part.shrunk(COARSE_PX) for part in parts)], recipe, region)
    if stability < REFUSE_STABILITY:
        raise NoTissue(f"{movie.name}: expected a region that stays in place when the threshold moves a little, found "
                       f"only one that changes altogether (overlap {stability:.2f}). {ADVICE}")
    if recipe.kind.startswith("dark"):
        tissue = _without_caps(whole, tissue)
    return recipe.kind, _enlarge(tissue, movie.shape), stability


def _stability(views: list[_View], recipe: _Recipe, region: Bools) -> float:
    """Smallest overlap of a region's outline with varied ones; views of the whole movie first, then of its parts."""
    whole, *parts = views
    tissue = _draw(whole, recipe, region)
    varied = [_draw(whole, recipe, region, shift=shift) for shift in (-THRESHOLD_SHIFT, THRESHOLD_SHIFT)]
    varied.append(_draw(whole, recipe, region, blur=STRONGER_BLUR))
    varied += [_draw(part, recipe, region) for part in parts]
    return min(overlap(tissue, other) for other in varied)


def _without_caps(view: _View, tissue: Bools) -> Bools:
    """Cut the bright cap of the pillar at each end out of a dark tissue (r, c), as whole convex pieces.

    A cap is the largest compact bright piece inside the outline at that end, clearly apart in brightness from the
    rest; a threshold for the whole picture often takes half of it for tissue.
    """
    side_px, body = view.side_px, fill_holes(tissue)
    smooth = _smooth(view.mean, BRIGHTNESS_BLUR * side_px)
    inner = _erode(body, CAP_INSIDE * side_px)
    if not inner.any() or np.ptp(smooth[inner]) == 0:
        return tissue
    bright = inner & (smooth > otsu(smooth[inner]))
    tissue_level, scatter = float(smooth[inner & ~bright].mean()), float(smooth[inner & ~bright].std())
    ground_level = float(np.median(smooth[view.seen & ~body]))
    brighter = max(CAP_CONTRAST * scatter, CAP_BRIGHTNESS * (ground_level - tissue_level))
    axis = measure_axis(body)
    count, label, stats, middle = cv2.connectedComponentsWithStats(
        _open(bright, CAP_RIM * side_px).astype(np.uint8), connectivity=8)
    along = (middle[:, ::-1] - axis.center_px) @ axis.direction / axis.length_px
    share = stats[:, cv2.CC_STAT_AREA] / np.count_nonzero(body)
    caps = np.zeros(body.shape, np.uint8)
    for end in (-1, 1):
        here = [i for i in range(1, count)
                if end * along[i] > CAP_FROM_CENTER and CAP_SHARE[0] < share[i] < CAP_SHARE[1]]
        if not here:
            continue
        cap = label == max(here, key=share.__getitem__)
        hull = cv2.convexHull(cv2.findContours(cap.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0][0])
        compact = np.count_nonzero(cap) / max(cv2.contourArea(hull), 1.0)
        if compact > CAP_SOLIDITY and float(smooth[cap].mean()) - tissue_level > brighter:
            cv2.fillConvexPoly(caps, hull, 1)
    return largest_region(tissue & ~_dilate(caps.astype(bool), CAP_RIM * side_px))


def _views(movie: Movie) -> list[_View]:
    """Views of the whole movie and, from three frames on, of its first and last third.

    Raises NoTissue where most of the picture is empty.
    """
    index = np.unique(np.linspace(0, movie.count - 1, min(FRAMES_READ, movie.count)).round().astype(int))
    sums: list[Any] = [0.0, 0.0, 0.0]
    counts = [0, 0, 0]
    empty = np.ones(movie.shape, bool)
    for i in index:
        frame = np.asarray(movie.frames[int(i)])
        empty &= frame == 0
        third = min(int(3 * i / movie.count), 2)
        sums[third] = sums[third] + _shrink(frame.astype(np.float32), FINE_PX)
        counts[third] += 1
    padding = _padding(empty)
    if padding.mean() > PADDING_LIMIT:
        raise NoTissue(f"{movie.name}: expected a picture of a tissue, found {padding.mean():.0%} of it black (exactly "
                       f"zero) from the border inwards, as after a threshold or too short an exposure. {ADVICE}")
    # The rim of the padding is half padding: interpolated when the picture was turned.
    seen = _shrink((~_dilate(padding, 2)).astype(np.float32), FINE_PX) > 0.99
    if min(seen.shape) < SMALLEST_PX or not seen.any():
        raise NoTissue(f"{movie.name}: expected frames of at least {SMALLEST_PX} x {SMALLEST_PX} px, found "
                       f"{movie.shape[0]} x {movie.shape[1]}. {ADVICE}")
    nearest = None if seen.all() else tuple(
        ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True))
    whole = _view(sum(sums) / sum(counts), seen, nearest)
    if min(counts) == 0:
        return [whole]
    return [whole, _view(sums[0] / counts[0], seen, nearest), _view(sums[2] / counts[2], seen, nearest)]


def _view(mean: Floats, seen: Bools, nearest: tuple[Any, ...] | None) -> _View:
    """Make a view of a mean frame; `nearest` holds, for each pixel, the row and the column of the nearest seen one."""
    calm = cv2.medianBlur(np.nan_to_num(mean).astype(np.float32), 3)  # a hot pixel would set the scale of all below
    low, high = np.percentile(calm[seen], [0.1, 99.9])
    # A brightness below zero, as in a float movie with its mean taken off, has no ratio to the ground's.
    lifted: Floats = np.asarray(np.clip(calm, low, high) - min(low, 0.0), np.float32)
    if nearest is not None:
        lifted = np.asarray(lifted[nearest], np.float32)
    return _View(lifted, seen)


def _padding(empty: Bools) -> Bools:
    """Pixels that are zero in every frame and connect to the border by pixels like them."""
    count, label = cv2.connectedComponents(empty.astype(np.uint8), connectivity=4)
    border = np.unique(np.concatenate([label[0], label[-1], label[:, 0], label[:, -1]]))
    keep = np.zeros(count, bool)
    keep[border] = True
    keep[0] = False
    return np.asarray(keep[label])


def _darkness(view: _View, blur: float) -> Floats:
    return -_smooth(view.mean, view.side_px * BRIGHTNESS_BLUR * blur)


def _even_darkness(view: _View, blur: float) -> Floats:
    """Darkness after division by the light of the ground, a paraboloid fitted to the brighter pixels."""
    smooth = _smooth(view.mean, view.side_px * BRIGHTNESS_BLUR * blur)
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


def _texture(view: _View, blur: float) -> Floats:
    """Logarithm of the local strength of fine detail; a median, for a mean would carry an edge's strength outwards."""
    strength = np.log(_detail_strength(view))
    low, high = np.percentile(strength, [1, 99])
    bytes_ = (np.clip((strength - low) / max(high - low, 1e-9), 0, 1) * 255).astype(np.uint8)  # cv2's wide median
    window = 2 * max(round(TEXTURE_REACH * view.side_px * blur), 1) + 1
    return _smooth(cv2.medianBlur(bytes_, window).astype(np.float32), view.side_px * TEXTURE_BLUR * blur)


def _detail_strength(view: _View) -> Floats:
    detail = np.abs(_detail(view))
    return detail + 0.1 * max(float(detail[view.seen].mean()), 1e-30)


def _detail(view: _View) -> Floats:
    """Brightness between two scales; none at the rim of the padding, where the fill would make some."""
    fine, rough = (_smooth(view.mean, view.side_px * blur) for blur in DETAIL_BLURS)
    return np.where(_erode(view.seen, 2 * DETAIL_BLURS[1] * view.side_px), fine - rough, 0.0)


def _brightness(view: _View, blur: float) -> Floats:
    return -_darkness(view, blur)


@dataclass(frozen=True)
class _Kind:
    """One way in which tissue can differ from its ground."""

    field: Callable[[_View, float], Floats]
    """Picture that is high on tissue, from a view and a factor on the smoothing."""
    prior: float
    """Factor on the plausibility."""
    edge_level: float
    """Level of the outline, from 0 on the ground to 1 in the tissue."""


# The rim of a dark tissue is thin and so less dark: the level halfway would lie too far inside. Texture is measured
# over a window, which carries it outwards: there the level halfway would lie too far outside. A bright strip is more
# often the ground between a tissue and a wall than a tissue.
KINDS = {"dark": _Kind(_darkness, 1.0, 0.4), "dark_evened": _Kind(_even_darkness, 1.0, 0.4),
         "texture": _Kind(_texture, 1.0, 0.7), "bright": _Kind(_brightness, 0.75, 0.4)}


def _thresholds(values: Floats) -> tuple[float, float, float]:
    """Otsu's threshold for two classes, and his two for three, of values (n,) that are not all equal."""
    center, count = _histogram(values, THREE_CLASS_BINS)
    n, total = np.append(0.0, np.cumsum(count)), np.append(0.0, np.cumsum(count * center))
    i, j = np.triu_indices(len(center), 1)
    i, j = i[i > 0], j[i > 0]
    mid = n[j] - n[i]
    between = (total[i] ** 2 / n[i] + (total[j] - total[i]) ** 2 / np.maximum(mid, 1)
               + (total[-1] - total[j]) ** 2 / (n[-1] - n[j]))
    best = int(np.argmax(between))
    return otsu(values), float(center[i[best] - 1]), float(center[j[best] - 1])


def _regions(view: _View) -> Iterator[tuple[_Recipe, Bools]]:
    """All regions that might be the tissue, with the way each was made."""
    smallest_px = SIZE_RAMP[0] * view.mean.size
    for name, kind in KINDS.items():
        field = kind.field(view, 1.0)
        if np.ptp(field[view.seen]) == 0:
            continue
        for number, cut in enumerate(_thresholds(field[view.seen])):
            above = (field > cut) & view.seen
            depth = _distance(above)
            for opening in OPENINGS:
                radius = opening * view.side_px
                opened = _dilate(depth > radius, radius)
                _, label, stats, _ = cv2.connectedComponentsWithStats(opened.astype(np.uint8), connectivity=8)
                for i in 1 + np.nonzero(stats[1:, cv2.CC_STAT_AREA] >= smallest_px)[0]:
                    yield _Recipe(name, number, opening), label == i


def _most_plausible(view: _View) -> tuple[_Recipe | None, Bools, float]:
    best: tuple[_Recipe | None, Bools, float] = (None, np.zeros(view.mean.shape, bool), 0.0)
    judge = _Judge(view)
    for recipe, region in _regions(view):
        prior = KINDS[recipe.kind].prior
        score = prior * judge.plausibility(region, to_beat=best[2] / prior)
        if score > best[2]:
            best = (recipe, region, score)
    return best


def _draw(view: _View, recipe: _Recipe, near: Bools, shift: float = 0.0, blur: float = 1.0) -> Bools:
    """Draw the region of a recipe that overlaps `near` most, and clean its outline; empty where there is none.

    The outline is moved to a level between those of the tissue and the ground beside it: a threshold for the whole
    picture also weighs walls and shadows that are far from the tissue.
    """
    side_px, field = view.side_px, KINDS[recipe.kind].field(view, blur)
    if np.ptp(field[view.seen]) == 0:
        return np.zeros(near.shape, bool)
    cut = _thresholds(field[view.seen])[recipe.threshold]
    region = _overlapping(_open((field > cut) & view.seen, max(recipe.opening, HAIR) * side_px), near)
    body = fill_holes(region)
    outward, inward = _distance(~body), _distance(body)
    ground_at = (outward > NEAR_BAND[0] * side_px) & (outward < NEAR_BAND[1] * side_px) & view.seen
    tissue_at = (inward > NEAR_BAND[0] * side_px) & (inward < NEAR_BAND[1] * side_px) & region
    if not ground_at.any() or not tissue_at.any():
        return np.zeros(near.shape, bool)
    ground, tissue = float(np.median(field[ground_at])), float(np.median(field[tissue_at]))
    edge = ground + (KINDS[recipe.kind].edge_level + shift) * (tissue - ground)
    above = (field > edge) & view.seen & (outward < NEAR_BAND[0] * side_px)
    radius = HAIR * side_px
    region = _overlapping(_open(above, radius), near)
    region = _erode(_dilate(region, radius), radius) & view.seen
    return fill_holes(region, SMALL_HOLE_SHARE * np.count_nonzero(region))


def _overlapping(mask: Bools, near: Bools) -> Bools:
    """The region of a mask that shares most pixels with another mask; empty where none does."""
    label = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]
    votes = np.bincount(label[near], minlength=2)
    votes[0] = 0
    return np.asarray((label == int(np.argmax(votes))) & (votes.max() > 0))


# Plausibility rises from 0 at the first number to 1 at the second; where four are given it falls again.
SIZE_RAMP = (0.02, 0.05, 0.45, 0.65)
"""Share of the picture."""
ELONGATION_RAMP = (1.3, 2.0, 8.0, 14.0)
"""Length to width by second moments."""
SOLIDITY_RAMP = (0.4, 0.62)
"""Share of the convex hull; a bundle has 0.8 to 0.95, with posts across its ends 0.6."""
BEND_RAMP = (0.45, 0.15)
"""Standard deviation of the middle line from a straight one, in mean widths, over the middle of the length."""
OFFSET_RAMP = (0.8, 0.3)
"""Distance of the middles of region and picture, in halves of the picture's shorter side."""
FILLED_RAMP = (0.4, 0.65)
"""Share of the outlined area that is not holes; the pillars' caps with their rings take up to 0.3."""
BORDER_RAMP = (0.55, 0.3)
"""Share of the outline that lies on the picture's border; both ends together are about 0.25."""
CONTRAST_RAMP = (0.4, 1.2)
"""Difference between bands inside and outside the outline, in standard deviations of single pixels."""


class _Judge:
    """Says how plausible a region is as the tissue of one view."""

    def __init__(self, view: _View) -> None:
        self.view = view
        self.features = (view.mean, np.log(_detail_strength(view)))
        self.middle = np.argwhere(view.seen).mean(axis=0)
        self.inside = _erode(view.seen, 2.0).copy()
        self.inside[[0, 1, -2, -1]] = False
        self.inside[:, [0, 1, -2, -1]] = False

    def plausibility(self, region: Bools, to_beat: float = 0.0) -> float:
        """Product of one factor from 0 to 1 for each thing that is expected of a tissue; 0 where it cannot be beaten.

        The factors that cost most to find come last, and are left out where the others stay below `to_beat`.
        """
        outlines = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        outline = max(outlines, key=len)
        area = cv2.moments(outline)
        if area["m00"] == 0:
            return 0.0
        score = _ramp(area["m00"] / np.count_nonzero(self.view.seen), SIZE_RAMP)
        covariance = np.array([[area["mu20"], area["mu11"]], [area["mu11"], area["mu02"]]]) / area["m00"]
        small, large = np.linalg.eigvalsh(covariance)
        score *= _ramp(float(np.sqrt(large / max(small, 1e-9))), ELONGATION_RAMP)
        score *= _ramp(area["m00"] / max(cv2.contourArea(cv2.convexHull(outline)), 1.0), SOLIDITY_RAMP)
        x, y = outline[:, 0].T
        score *= _ramp(1.0 - float(self.inside[y, x].mean()), BORDER_RAMP)
        middle = np.array([area["m01"], area["m10"]]) / area["m00"]
        score *= _ramp(float(np.hypot(*(middle - self.middle))) / (0.5 * min(region.shape)), OFFSET_RAMP)
        if score <= to_beat:
            return 0.0
        body = cv2.drawContours(np.zeros(region.shape, np.uint8), [outline], -1, 1, cv2.FILLED).astype(bool)
        score *= _ramp(np.count_nonzero(region) / np.count_nonzero(body), FILLED_RAMP)
        score *= _ramp(bend(body), BEND_RAMP)
        return score * self._contrast(region, body) if score > to_beat else 0.0

    def _contrast(self, region: Bools, body: Bools) -> float:
        """How sharply a band inside the outline differs from a band outside, in brightness or in fine detail."""
        side_px = self.view.side_px
        outward, inward = _distance(~body), _distance(body)
        ground_at = (outward > HAIR * side_px) & (outward < NEAR_BAND[1] * side_px) & self.view.seen
        tissue_at = region & (inward < NEAR_BAND[1] * side_px)
        if not ground_at.any() or not tissue_at.any():
            return 0.0
        apart = 0.0
        for feature in self.features:
            tissue, ground = feature[tissue_at], feature[ground_at]
            scatter = np.sqrt(0.5 * (tissue.var() + ground.var()))
            apart = max(apart, abs(float(tissue.mean() - ground.mean())) / max(float(scatter), 1e-9))
        return _ramp(apart, CONTRAST_RAMP) * apart / (1.0 + apart)


def _ramp(value: float, points: tuple[float, ...]) -> float:
    rise = float(np.clip((value - points[0]) / (points[1] - points[0]), 0, 1))
    return rise if len(points) == 2 else rise * float(np.clip((points[3] - value) / (points[3] - points[2]), 0, 1))


# --- pictures -------------------------------------------------------------------------------------------------------


def _dilate(mask: Bools, radius: float) -> Bools:
    """Add all pixels within `radius` of a mask: a disk of any size at the cost of one distance transform."""
    if radius <= 0 or not mask.any():
        return mask
    return _distance(~mask) <= radius


def _erode(mask: Bools, radius: float) -> Bools:
    """Take all pixels within `radius` of the ground off a mask; beyond the picture's border there is no ground."""
    if radius <= 0 or mask.all():
        return mask
    return _distance(mask) > radius


def _open(mask: Bools, radius: float) -> Bools:
    return _dilate(_erode(mask, radius), radius)


def _distance(mask: Bools, kind: int = cv2.DIST_MASK_5) -> Floats:
    """Distance of each pixel of a mask from the nearest pixel outside it, to 2 % or exactly (three times the cost)."""
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, kind))


def _smooth(image: Floats, sigma: float) -> Floats:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), max(sigma, 0.4)))


def _shrink(image: Floats, longest_px: int) -> Floats:
    scale = longest_px / max(image.shape)
    if scale >= 1:
        return image
    rows, cols = (max(round(n * scale), 1) for n in image.shape)
    return np.asarray(cv2.resize(image, (cols, rows), interpolation=cv2.INTER_AREA))


def _enlarge(mask: Bools, shape: tuple[int, ...]) -> Bools:
    """The same mask in a larger picture, its outline interpolated."""
    if mask.shape == tuple(shape):
        return mask
    return np.asarray(cv2.resize(mask.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR) >= 0.5)
