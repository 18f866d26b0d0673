"""Follow the pillars: a movie becomes the motion of each pillar's head.

A head is a rigid body: it is registered as one, by translation and rotation, against the reference frame and then
against the mean of all frames (`bodies.follow_body`). The rim of the mask, where the head's own picture gives way to
its shadow and to tissue that move less, is left out. The head's four quarters are followed too: a real head tilts and
is partly covered, and how much its quarters disagree is the error of the whole that noise does not explain. The method
`paper` follows corners in the pillar's mask from frame to frame, as the published tool does, and takes the mean of
their positions. Forces are made of this in `force`.

Source: paper, "Pillar tracking"; the published tool's behaviour for `paper`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from .axis import measure_axis
from .bodies import Body, follow_bodies
from .bspline import Float32
from .config import Config, Reading
from .data import BodyMotion, Bools, Finding, Floats, Ints, Masks, Movie, PillarMotion, Pillars
from .errors import CannotMeasure, ConfigError, MaskUnusable, NoPillars
from .markers import place_markers
from .pillar_masks import find_pillars
from .prepare import Prepared
from .track import track_markers

RIM_SHARE = 0.06
"""Width of the rim that does not count, as a share of the diameter of a circle of the mask's size."""
FEWEST_INSIDE_PX = 200
"""A mask of which less would be left keeps its rim."""
MOST_FRAMES = 40
"""Frames in which the quarters are followed."""
LOST_SHARE = 0.2
"""A pillar that is missing in more than this share of the frames is for review."""


def measure_pillars(movie: Movie, masks: Masks, reference_frame: int,
                    config: Config) -> tuple[PillarMotion | None, tuple[Finding, ...]]:
    """Find the pillars of a movie and follow them, from the reference frame to all others.

    Where no pillar can be told, there is no motion but a finding that says why. What is found of pillars is for review
    where a stiffness shows that forces are wanted, else for information. Raises MaskUnusable for supplied masks that
    cannot be used, NoPillars where only supplied masks are allowed and none came, and ConfigError where `unloaded_px`
    does not name each pillar.
    """
    params = config.pillars
    wanted = params.stiffness_un_per_um is not None or params.modulus_mpa is not None
    try:
        pillars = find_pillars(movie, masks, params)
    except NoPillars as why:
        if params.masks == "supplied":
            raise
        return None, (Finding("no_pillars", "review" if wanted else "info", str(why)),)
    if len(pillars) == 0:
        return None, ()
    if params.unloaded_px is not None and len(params.unloaded_px) != len(pillars):
        raise ConfigError(f"pillars.unloaded_px: expected a position for each of the {len(pillars)} pillars "
                          f"({', '.join(pillars.names)}); found {len(params.unloaded_px)}")
    follow = _by_markers if config.method == "paper" else _as_bodies
    motion = follow(movie, pillars, 0 if config.method == "paper" else reference_frame, config)
    findings = (*pillars.findings, *motion.findings, *_missing(motion))
    if not wanted:
        findings = tuple(replace(finding, level="info") for finding in findings)
    return replace(motion, findings=findings), ()


def _as_bodies(movie: Movie, pillars: Pillars, reference_frame: int, _: Config) -> PillarMotion:
    motion = _nothing(movie, pillars, "body")
    findings, bodies = [], dict[int, Body]()
    picture = None
    insides = [without_rim(mask) for mask in pillars.masks]
    for p, inside in enumerate(insides):
        try:
            bodies[p] = Body(movie, inside, reference_frame, picture=picture)
        except CannotMeasure as why:
            findings.append(_not_followed(pillars.names[p], why))
        else:
            picture = bodies[p].picture
    moved = dict(zip(bodies, follow_bodies(movie, list(bodies.values())), strict=True))
    gains = _disagreement(movie, picture, {p: (insides[p], body) for p, body in moved.items()})
    for p, body in moved.items():
        motion.shift_px[:, p], motion.shift_se_px[:, p] = body.translation_px, body.translation_se_px
        motion.rotation_deg[:, p], motion.gain_se[p] = body.rotation_deg, gains[p]
    return replace(motion, findings=tuple(findings))


def without_rim(mask: Bools) -> Bools:
    """Leave the rim of a pillar's mask (R, C) out, where enough remains."""
    width = round(RIM_SHARE * 2 * float(np.sqrt(mask.sum() / np.pi)))
    inside = np.asarray(ndimage.binary_erosion(mask, iterations=width), bool) if width else mask
    return inside if inside.sum() >= FEWEST_INSIDE_PX else mask


def _disagreement(movie: Movie, picture: Float32 | None,
                  heads: Mapping[int, tuple[Bools, BodyMotion]]) -> dict[int, float]:
    """Standard error of each body's motion as a share of it, by how differently its mask's quarters follow it; NaN
    where the body does not move, or its quarters show too little."""
    out = dict.fromkeys(heads, np.nan)
    if not heads:
        return out
    first = next(iter(heads.values()))[1].reference_frame
    every = np.linspace(0, movie.count - 1, min(movie.count, MOST_FRAMES)).astype(int)
    frames = np.unique(np.append(every, first))
    reference = int(np.searchsorted(frames, first))
    some = replace(movie, frames=Prepared(movie.frames, frames, (0, movie.shape[0], 0, movie.shape[1]), Reading()),
                   time_s=None)
    found = {p: _Whole.of(body, frames) for p, (_, body) in heads.items()}
    quarters = []
    for p, (mask, body) in heads.items():
        for quarter in _quarters(mask, body.center_px) if found[p] is not None else ():
            with suppress(CannotMeasure, MaskUnusable):
                quarters.append((p, Body(some, quarter, reference, "translation", picture=picture)))
    gains = defaultdict[int, list[float]](list)
    for (p, _), part in zip(quarters, follow_bodies(some, [body for _, body in quarters]), strict=True):
        whole = found[p]
        assert whole is not None
        along = (part.translation_px - _turned(heads[p][1], part.center_px)[frames]) @ whole.direction
        both = whole.seen & np.isfinite(along)
        if both.sum() > 2 and np.ptp(whole.along[both]) > 0:
            gains[p].append(float(np.polyfit(whole.along[both], along[both], 1)[0]))
    return out | {p: float(np.std(each, ddof=1) / np.sqrt(len(each))) for p, each in gains.items() if len(each) > 1}


@dataclass(frozen=True)
class _Whole:
    """The main direction in which a body moves, and how far along it in some frames."""

    direction: Floats
    along: Floats
    seen: Bools

    @classmethod
    def of(cls, body: BodyMotion, frames: Ints) -> _Whole | None:
        """Find it in frames; None where the body is not seen, or does not move."""
        moved = body.translation_px[frames] - body.translation_px[body.reference_frame]
        seen = np.isfinite(moved).all(axis=1)
        if seen.sum() < 3 or not moved[seen].any():
            return None
        direction = np.linalg.svd(moved[seen] - moved[seen].mean(axis=0), full_matrices=False)[2][0]
        return cls(direction, moved @ direction, seen)


def _quarters(mask: Bools, center_px: Floats) -> Iterator[Bools]:
    """The four parts of a mask around its centre."""
    row, col = np.indices(mask.shape)
    below, right = row > center_px[0], col > center_px[1]
    yield from (mask & a & b for a in (below, ~below) for b in (right, ~right))


def _turned(body: BodyMotion, point_px: Floats) -> Floats:
    """Movement (T, 2) that the body's rotation about its centre gives to a point (2,) of it."""
    turn, arm = np.deg2rad(body.rotation_deg), point_px - body.center_px
    return np.stack([turn * arm[1], -turn * arm[0]], axis=1)


def _by_markers(movie: Movie, pillars: Pillars, reference_frame: int, config: Config) -> PillarMotion:
    motion = _nothing(movie, pillars, "markers")
    findings = []
    for p, mask in enumerate(pillars.masks):
        head = Masks(mask, measure_axis(mask), "supplied")
        try:
            markers = place_markers(movie, head, reference_frame, config)
            tracks = track_markers(movie, head, markers, config, lambda _: None)
        except CannotMeasure as why:
            findings.append(_not_followed(pillars.names[p], why))
            continue
        middle = tracks.position_px.mean(axis=1)
        motion.shift_px[:, p] = middle - middle[reference_frame]
    return replace(motion, findings=tuple(findings))


def _nothing(movie: Movie, pillars: Pillars, method: str) -> PillarMotion:
    """A motion of NaN, to be filled in."""
    shape = (movie.count, len(pillars), 2)
    return PillarMotion(pillars, np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape[:2], np.nan),
                        np.full(len(pillars), np.nan), method)


def _not_followed(name: str, why: CannotMeasure) -> Finding:
    return Finding("pillar_not_followed", "review", f"Pillar {name} could not be followed, so it has no force: {why}")


def _missing(motion: PillarMotion) -> list[Finding]:
    """Findings about pillars that are missing in part of the frames."""
    gone = np.isnan(motion.shift_px[..., 0]).mean(axis=0)
    return [Finding("pillar_lost", "review", f"Pillar {name} was not found in {share:.0%} of the frames (limit "
                    f"{LOST_SHARE:.0%}): is something in front of it, or its mask beside it?", float(share), LOST_SHARE)
            for name, share in zip(motion.pillars.names, gone, strict=True) if LOST_SHARE < share < 1]
