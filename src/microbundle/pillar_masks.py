"""Which pixels are pillars: the masks that came with the movie, or what stands at both ends of the tissue.

Without supplied masks, the mean frame is laid level along the tissue (`level`), round caps (`pillar_caps`) and plates
(`pillar_plates`) are looked for near its ends, and the pair is taken whose two pillars are plausible each and alike:
as large, as far from the tissue's middle, as far aside. If only one is plausible, the other is its mirror image. If
none is, the search refuses.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from .config import PillarParams
from .data import Bools, Finding, Floats, Masks, Movie, Pillars, PillarSource
from .errors import MaskUnusable, NoPillars, NoTissue
from .level import Level, lay_level
from .pillar_candidate import Candidate
from .pillar_caps import caps
from .pillar_plates import plates
from .ramp import ramp
from .view import ADVICE, views

ACCEPT = 0.4
"""Smallest plausibility of a pair that is believed."""
ACCEPT_ALONE = 0.75
"""Smallest plausibility of a pillar that is believed without a partner like it."""
SURE = 0.65
"""Below this plausibility a pair is for review, and above it no plates are looked for when caps are found."""
COMPARED = 12
"""Candidates of each end that are compared with those of the other."""
AS_GOOD = 0.9
"""Of the pairs whose plausibility is this share of the best one's, the largest is taken: it shows most of the caps."""
SIZE_APART = (0.6, 0.3)
"""Difference of two pillars' size, as the logarithm of the ratio of the square roots of their areas."""
DISTANCE_APART = (0.4, 0.12)
"""Difference of their distances from the tissue's middle, as a share of the tissue's length."""
ASIDE_APART = (0.2, 0.1)
"""Difference of their distances from the axis, as a share of the tissue's length."""
OVERLAP_REFUSED = 0.5
"""Supplied masks that share this part of the smaller one are the same pillar twice."""
IN_PICTURE = 0.6
"""A mirror image of which less than this share lies in the picture is not used."""
HELP = ("Supply the pillars' masks with the movie, as masks/pillar_mask_1.txt and masks/pillar_mask_2.txt, or set "
        "pillars.masks to none to measure without pillars.")


def find_pillars(movie: Movie, masks: Masks, params: PillarParams) -> Pillars:
    """Find the pillars that a tissue is attached to, P masks (R, C) in their order along the tissue's axis.

    `auto` takes the pillar masks that came with the movie as they are, or else looks for pillars on the mean of at
    most 24 frames; `none` gives no pillars. Raises MaskUnusable for a supplied mask that does not fit the frames,
    marks nothing, or marks the same pillar as another, and NoPillars where none came and none can be told.
    """
    if params.masks == "none":
        return Pillars((), (), np.zeros((0, 2)), (), ())
    supplied = {name: mask for name, mask in movie.supplied_masks.items() if re.fullmatch(r"pillar_\d+", name)}
    if supplied:
        return _supplied(movie, masks, supplied)
    if params.masks == "supplied":
        raise NoPillars(f"{movie.name}: expected a pillar mask with the movie, for pillars.masks is 'supplied'; found "
                        f"none. Supply masks/pillar_mask_1.txt beside the frames, or set pillars.masks to auto.")
    return _found(movie, masks)


def _supplied(movie: Movie, masks: Masks, supplied: dict[str, Bools]) -> Pillars:
    names = sorted(supplied, key=lambda name: int(name.removeprefix("pillar_")))
    pillars = []
    for name in names:
        mask = np.array(supplied[name], bool)
        if mask.shape != movie.shape:
            raise MaskUnusable(f"{movie.name}: {name}: expected a mask of {movie.shape[0]} x {movie.shape[1]} px like "
                               f"the frames, found {' x '.join(map(str, mask.shape))}. Draw it on a frame of this "
                               "movie.")
        if not mask.any():
            raise MaskUnusable(f"{movie.name}: {name}: expected some pixels of a pillar, found an empty mask. Mark the "
                               "pillar by 1 (or 255), or remove the mask.")
        pillars.append(mask)
    findings = [Finding("pillars_supplied", "info", f"The pillars are the masks that came with the movie: "
                        f"{', '.join(name.removeprefix('pillar_') for name in names)}.")]
    for i, one in enumerate(pillars):
        for j in range(i):
            findings += _overlap_finding(movie, (names[j], names[i]), pillars[j], one)
    return _in_order(masks, pillars, [name.removeprefix("pillar_") for name in names], ["supplied"] * len(names),
                     [None] * len(names), findings)


def _overlap_finding(movie: Movie, names: tuple[str, str], one: Bools, other: Bools) -> list[Finding]:
    both = np.count_nonzero(one & other)
    share = both / min(np.count_nonzero(one), np.count_nonzero(other))
    if share > OVERLAP_REFUSED:
        raise MaskUnusable(f"{movie.name}: {names[0]} and {names[1]}: expected masks of different pillars, found that "
                           f"{share:.0%} of the smaller one lies in the other. Remove one of them, or draw it again.")
    if both == 0:
        return []
    return [Finding("pillars_overlap", "review", f"The masks {names[0]} and {names[1]} share {both} px ({share:.0%} of "
                    "the smaller one), which count for both pillars. Draw them apart.", share, 0.0)]


def _found(movie: Movie, masks: Masks) -> Pillars:
    """Look for the pillars in the movie's mean frame."""
    if movie.count == 0:
        raise NoPillars(f"{movie.name}: expected at least one frame to look for pillars on, found none.")
    try:
        level = lay_level(views(movie)[0], masks)
    except NoTissue as error:
        raise NoPillars(f"{str(error).removesuffix(ADVICE)}No pillar can be found on it. {HELP}") from None
    candidates = caps(level)
    pair, plausibility = best_pair(candidates)
    if plausibility < SURE:
        candidates = sorted([*candidates, *plates(level)], key=lambda c: -c.plausibility)
        pair, plausibility = best_pair(candidates)
    if plausibility >= ACCEPT:
        return _in_order(masks, [_drawn(level, one, movie) for one in pair], None, ["found", "found"],
                         [plausibility, plausibility], _doubt(plausibility))
    if candidates and candidates[0].plausibility >= ACCEPT_ALONE:
        return _with_mirror_image(movie, masks, level, candidates[0])
    best = candidates[0].plausibility if candidates else 0.0
    raise NoPillars(f"{movie.name}: expected a round cap or a plate near each end of the tissue, found nothing like "
                    f"that (the most plausible pair scores {plausibility:.2f} of 1, needed {ACCEPT}; the most "
                    f"plausible single one {best:.2f}, needed {ACCEPT_ALONE}). {HELP}")


def best_pair(candidates: Sequence[Candidate]) -> tuple[tuple[Candidate, ...], float]:
    """Choose the two candidates, one of each end, that are most plausible together, with their plausibility 0 to 1.

    Candidates are given the most plausible first. Gives no pair and 0 where one end has none.
    """
    first, second = ([c for c in candidates if c.end == end][:COMPARED] for end in (-1, 1))
    scored = [((a, b), float(np.sqrt(a.plausibility * b.plausibility)) * _alike(a, b)) for a in first for b in second]
    best = max((score for _, score in scored), default=0.0)
    if best == 0:
        return (), 0.0
    return max((one for one in scored if one[1] >= AS_GOOD * best), key=lambda one: one[0][0].size + one[0][1].size)


def _alike(one: Candidate, other: Candidate) -> float:
    """How much two candidates look like a pair that stands symmetrically about the tissue's middle, from 0 to 1."""
    if one.kind != other.kind:
        return 0.0
    return (ramp(abs(float(np.log(one.size / other.size))), SIZE_APART)
            * ramp(abs(abs(float(one.center[1])) - abs(float(other.center[1]))), DISTANCE_APART)
            * ramp(abs(float(one.center[0] - other.center[0])), ASIDE_APART))


def _with_mirror_image(movie: Movie, masks: Masks, level: Level, one: Candidate) -> Pillars:
    """A pillar, and its mirror image across the tissue's axis at the other end."""
    found = _drawn(level, one, movie)
    image = _drawn(level, one, movie, mirrored=True)
    where = "start" if one.end < 0 else "end"
    expected = np.count_nonzero(found)
    told = (f"Only the pillar at the {where} of the tissue's axis was found (plausibility {one.plausibility:.2f} of "
            "1). ")
    if np.count_nonzero(image) < IN_PICTURE * expected:
        finding = Finding("pillar_missing", "review", told + "The other would lie outside the picture. "
                          "Its force is not measured; supply its mask if the picture shows it.", 1.0, 2.0)
        return _in_order(masks, [found], None, ["found"], [one.plausibility], [finding])
    finding = Finding("pillar_mirrored", "review", told + "The other mask is its mirror image about the tissue's "
                      "middle, and may not lie on the pillar. Look at it, or supply both masks.",
                      one.plausibility, ACCEPT_ALONE)
    return _in_order(masks, [found, image], None, ["found", "mirrored"], [one.plausibility, None], [finding])


def _drawn(level: Level, one: Candidate, movie: Movie, mirrored: bool = False) -> Bools:
    """The mask (R, C) of a candidate, or of its mirror image: the level picture has the tissue's middle in its own."""
    inside = one.inside[:, ::-1] if mirrored else one.inside
    return np.asarray(level.carried(inside, movie.shape, outside=float(one.inside.min())) > 0)


def _doubt(plausibility: float) -> list[Finding]:
    if plausibility >= SURE:
        return []
    return [Finding("pillars_doubtful", "review", f"The pillars were found with a plausibility of {plausibility:.2f} "
                    f"of 1 (limit {SURE}). Look at their masks, and supply better ones if they do not lie on the "
                    "pillars.", plausibility, SURE)]


def _in_order(masks: Masks, pillars: Sequence[Bools], names: Sequence[str] | None, source: Sequence[PillarSource],
              score: Sequence[float | None], findings: Sequence[Finding]) -> Pillars:
    """Put pillars in their order along the tissue's axis; without names they are numbered in that order."""
    center: Floats = np.array([np.argwhere(mask).mean(axis=0) for mask in pillars])
    order = np.argsort((center - masks.axis.center_px) @ masks.axis.direction, kind="stable")
    names = [str(1 + i) for i in range(len(pillars))] if names is None else [names[i] for i in order]
    return Pillars(tuple(pillars[i] for i in order), tuple(names), center[order], tuple(source[i] for i in order),
                   tuple(score[i] for i in order), tuple(findings))
