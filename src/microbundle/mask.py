"""Which pixels are tissue: a movie becomes a mask, the tissue's axis, and a measure of how far to trust them.

The default takes the mask that came with the movie, or the most plausible region of the movie's mean frame
(`segment`); if none is plausible enough, it refuses. The paper's methods (`published_masks`) answer for any picture
that is not blank.

Stability is the smallest overlap with the masks that a shifted threshold, a stronger smoothing, and the first and the
last third of the movie give.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .axis import measure_axis
from .config import MaskParams
from .data import Bools, Finding, Masks, Movie
from .errors import ConfigError, MaskUnusable, NoTissue
from .published_masks import paper_mask, projections
from .segment import Recipe, draw, most_plausible, without_caps
from .view import ADVICE, COARSE_PX, View, enlarge, views

THRESHOLD_SHIFT = 0.1
"""The stability check moves a threshold by this share of the distance between the means of its two classes."""
STRONGER_BLUR = 1.5
"""Factor on the smoothing, for the stability."""
ACCEPT = 0.35
"""Smallest plausibility that is believed."""
REFUSE_STABILITY = 0.4
"""A region whose variations share less than this with it is an accident of the threshold, not a thing."""


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


def _automatic(movie: Movie) -> tuple[str, Bools, float]:
    """Name, mask and stability of the most plausible region; raises NoTissue where none is plausible."""
    whole, *parts = views(movie)
    if np.ptp(whole.mean) == 0:
        raise NoTissue(f"{movie.name}: expected a tissue that differs from its ground, found frames of one single "
                       f"brightness. {ADVICE}")
    coarse = whole.shrunk(COARSE_PX)
    recipe, region, plausibility = most_plausible(coarse)
    if recipe is None or plausibility < ACCEPT:
        raise NoTissue(f"{movie.name}: expected one dark or textured strip of tissue near the middle of the picture, "
                       f"found no region like that (the most plausible one scores {plausibility:.2f} of 1, needed "
                       f"{ACCEPT}). {ADVICE}")
    tissue = draw(whole, recipe, enlarge(region, whole.mean.shape))
    stability = _stability([coarse, *(part.shrunk(COARSE_PX) for part in parts)], recipe, region)
    if stability < REFUSE_STABILITY:
        raise NoTissue(f"{movie.name}: expected a region that stays in place when the threshold moves a little, found "
                       f"only one that changes altogether (overlap {stability:.2f}). {ADVICE}")
    if recipe.kind.startswith("dark"):
        tissue = without_caps(whole, tissue)
    return recipe.kind, enlarge(tissue, movie.shape), stability


def _stability(views: list[View], recipe: Recipe, region: Bools) -> float:
    """Smallest overlap of a region's outline with varied ones; views of the whole movie first, then of its parts."""
    whole, *parts = views
    tissue = draw(whole, recipe, region)
    varied = [draw(whole, recipe, region, shift=shift) for shift in (-THRESHOLD_SHIFT, THRESHOLD_SHIFT)]
    varied.append(draw(whole, recipe, region, blur=STRONGER_BLUR))
    varied += [draw(part, recipe, region) for part in parts]
    return min(overlap(tissue, other) for other in varied)


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
        whole, *parts = projections(movie, method)
    tissue = paper_mask(whole, method)
    if not tissue.any():
        raise NoTissue(f"{movie.name}: expected the method {method!r} to part the tissue from the ground by its "
                       f"brightness, found nothing to part. {ADVICE}")
    varied = [paper_mask(whole, method, shift=shift) for shift in (-THRESHOLD_SHIFT, THRESHOLD_SHIFT)]
    varied.append(paper_mask(ndimage.gaussian_filter(whole.astype(float), 1.0), method))
    varied += [paper_mask(part, method) for part in parts]
    return method, tissue, min(overlap(tissue, other) for other in varied)
