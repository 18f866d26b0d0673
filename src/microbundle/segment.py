"""Find the tissue on a view: propose regions, judge each as a microbundle, draw the best one's outline.

Proposed are dark regions (with and without a correction of uneven light), textured ones and bright ones, each also
cut free of what it touches by openings. A region is judged by what one asks of a microbundle: a strip of plausible
size near the middle of the picture, compact, straight, not hanging on the picture's border, and different from the
ground beside it. The bright caps of pillars are cut out of the drawn mask.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from .axis import bend, fill_holes, largest_region, measure_axis
from .data import Bools
from .ramp import ramp
from .threshold import otsu, otsu_cuts
from .view import BRIGHTNESS_BLUR, KINDS, View, blurred, detail_strength, dilate, distance, erode, opened

OPENINGS = (0.0, 0.008, 0.016, 0.032)
"""Radii of the openings that cut a region free of its neighbours, as shares of the picture's side."""
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


@dataclass(frozen=True)
class Recipe:
    """How a region was made: a field that is high on tissue, one of its thresholds, and an opening."""

    kind: str
    """A key of KINDS."""
    threshold: int
    """Which of the field's thresholds."""
    opening: float


def _regions(view: View) -> Iterator[tuple[Recipe, Bools]]:
    """All regions that might be the tissue, with the way each was made."""
    smallest_px = SIZE_RAMP[0] * view.mean.size
    for name, kind in KINDS.items():
        field = kind.field(view, 1.0)
        if np.ptp(field[view.seen]) == 0:
            continue
        for number, cut in enumerate(otsu_cuts(field[view.seen])):
            above = (field > cut) & view.seen
            depth = distance(above)
            for opening in OPENINGS:
                radius = opening * view.side_px
                cut_free = dilate(depth > radius, radius)
                _, label, stats, _ = cv2.connectedComponentsWithStats(cut_free.astype(np.uint8), connectivity=8)
                for i in 1 + np.nonzero(stats[1:, cv2.CC_STAT_AREA] >= smallest_px)[0]:
                    yield Recipe(name, number, opening), label == i


def most_plausible(view: View) -> tuple[Recipe | None, Bools, float]:
    """Find the most plausible region of a view, with the way it was made and its plausibility from 0 to 1."""
    best: tuple[Recipe | None, Bools, float] = (None, np.zeros(view.mean.shape, bool), 0.0)
    judge = _Judge(view)
    for recipe, region in _regions(view):
        prior = KINDS[recipe.kind].prior
        score = prior * judge.plausibility(region, to_beat=best[2] / prior)
        if score > best[2]:
            best = (recipe, region, score)
    return best


def draw(view: View, recipe: Recipe, near: Bools, shift: float = 0.0, blur: float = 1.0) -> Bools:
    """Draw the region of a recipe that overlaps `near` most, and clean its outline; empty where there is none.

    The outline is moved to a level between those of the tissue and the ground beside it: a threshold for the whole
    picture also weighs walls and shadows that are far from the tissue.
    """
    side_px, field = view.side_px, KINDS[recipe.kind].field(view, blur)
    if np.ptp(field[view.seen]) == 0:
        return np.zeros(near.shape, bool)
    cut = otsu_cuts(field[view.seen])[recipe.threshold]
    region = _overlapping(opened((field > cut) & view.seen, max(recipe.opening, HAIR) * side_px), near)
    body = fill_holes(region)
    outward, inward = distance(~body), distance(body)
    ground_at = (outward > NEAR_BAND[0] * side_px) & (outward < NEAR_BAND[1] * side_px) & view.seen
    tissue_at = (inward > NEAR_BAND[0] * side_px) & (inward < NEAR_BAND[1] * side_px) & region
    if not ground_at.any() or not tissue_at.any():
        return np.zeros(near.shape, bool)
    ground, tissue = float(np.median(field[ground_at])), float(np.median(field[tissue_at]))
    edge = ground + (KINDS[recipe.kind].edge_level + shift) * (tissue - ground)
    above = (field > edge) & view.seen & (outward < NEAR_BAND[0] * side_px)
    radius = HAIR * side_px
    region = _overlapping(opened(above, radius), near)
    region = erode(dilate(region, radius), radius) & view.seen
    return fill_holes(region, SMALL_HOLE_SHARE * np.count_nonzero(region))


def _overlapping(mask: Bools, near: Bools) -> Bools:
    """The region of a mask that shares most pixels with another mask; empty where none does."""
    label = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]
    votes = np.bincount(label[near], minlength=2)
    votes[0] = 0
    return np.asarray((label == int(np.argmax(votes))) & (votes.max() > 0))


def without_caps(view: View, tissue: Bools) -> Bools:
    """Cut the bright cap of the pillar at each end out of a dark tissue (r, c), as whole convex pieces.

    A cap is the largest compact bright piece inside the outline at that end, clearly apart in brightness from the
    rest; a threshold for the whole picture often takes half of it for tissue.
    """
    side_px, body = view.side_px, fill_holes(tissue)
    smooth = blurred(view.mean, BRIGHTNESS_BLUR * side_px)
    inner = erode(body, CAP_INSIDE * side_px)
    if not inner.any() or np.ptp(smooth[inner]) == 0:
        return tissue
    bright = inner & (smooth > otsu(smooth[inner]))
    tissue_level, scatter = float(smooth[inner & ~bright].mean()), float(smooth[inner & ~bright].std())
    ground_level = float(np.median(smooth[view.seen & ~body]))
    brighter = max(CAP_CONTRAST * scatter, CAP_BRIGHTNESS * (ground_level - tissue_level))
    axis = measure_axis(body)
    count, label, stats, middle = cv2.connectedComponentsWithStats(
        opened(bright, CAP_RIM * side_px).astype(np.uint8), connectivity=8)
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
    return largest_region(tissue & ~dilate(caps.astype(bool), CAP_RIM * side_px))


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

    def __init__(self, view: View) -> None:
        self.view = view
        self.features = (view.mean, np.log(detail_strength(view)))
        self.middle = np.argwhere(view.seen).mean(axis=0)
        self.inside = erode(view.seen, 2.0).copy()
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
        score = ramp(area["m00"] / np.count_nonzero(self.view.seen), SIZE_RAMP)
        covariance = np.array([[area["mu20"], area["mu11"]], [area["mu11"], area["mu02"]]]) / area["m00"]
        small, large = np.linalg.eigvalsh(covariance)
        score *= ramp(float(np.sqrt(large / max(small, 1e-9))), ELONGATION_RAMP)
        score *= ramp(area["m00"] / max(cv2.contourArea(cv2.convexHull(outline)), 1.0), SOLIDITY_RAMP)
        x, y = outline[:, 0].T
        score *= ramp(1.0 - float(self.inside[y, x].mean()), BORDER_RAMP)
        middle = np.array([area["m01"], area["m10"]]) / area["m00"]
        score *= ramp(float(np.hypot(*(middle - self.middle))) / (0.5 * min(region.shape)), OFFSET_RAMP)
        if score <= to_beat:
            return 0.0
        body = cv2.drawContours(np.zeros(region.shape, np.uint8), [outline], -1, 1, cv2.FILLED).astype(bool)
        score *= ramp(np.count_nonzero(region) / np.count_nonzero(body), FILLED_RAMP)
        score *= ramp(bend(body), BEND_RAMP)
        return score * self._contrast(region, body) if score > to_beat else 0.0

    def _contrast(self, region: Bools, body: Bools) -> float:
        """How sharply a band inside the outline differs from a band outside, in brightness or in fine detail."""
        side_px = self.view.side_px
        outward, inward = distance(~body), distance(body)
        ground_at = (outward > HAIR * side_px) & (outward < NEAR_BAND[1] * side_px) & self.view.seen
        tissue_at = region & (inward < NEAR_BAND[1] * side_px)
        if not ground_at.any() or not tissue_at.any():
            return 0.0
        apart = 0.0
        for feature in self.features:
            tissue, ground = feature[tissue_at], feature[ground_at]
            scatter = np.sqrt(0.5 * (tissue.var() + ground.var()))
            apart = max(apart, abs(float(tissue.mean() - ground.mean())) / max(float(scatter), 1e-9))
        return ramp(apart, CONTRAST_RAMP) * apart / (1.0 + apart)
