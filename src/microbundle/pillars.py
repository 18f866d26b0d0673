"""Follow the pillars: a movie becomes the motion of each pillar's head.

A head is a rigid body: it is registered as one, by translation and rotation, against the reference frame and then
against the mean of all frames (`subsets.follow_body`). The method `paper` follows corners in the pillar's mask from
frame to frame, as the published tool does, and takes the mean of their positions. Forces are made of this in `force`.

Source: paper, "Pillar tracking"; the published tool's behaviour for `paper`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .axis import measure_axis
from .config import Config
from .data import Finding, Floats, Masks, Movie, PillarMotion, Pillars
from .errors import CannotMeasure, NoPillars
from .markers import place_markers
from .pillar_masks import find_pillars
from .subsets import follow_body
from .track import track_markers

LOST_SHARE = 0.2
"""A pillar that is missing in more than this share of the frames is for review."""


def measure_pillars(movie: Movie, masks: Masks, reference_frame: int,
                    config: Config) -> tuple[PillarMotion | None, tuple[Finding, ...]]:
    """Find the pillars of a movie and follow them, from the reference frame to all others.

    Where no pillar can be told, there is no motion but a finding that says why. What is found of pillars is for review
    where a stiffness shows that forces are wanted, else for information. Raises MaskUnusable for supplied masks that cannot be used, and NoPillars
    where only supplied masks are allowed and none came.
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
    follow = _by_markers if config.method == "paper" else _as_bodies
    shift, error, turn, lost = follow(movie, pillars, 0 if config.method == "paper" else reference_frame, config)
    method = "markers" if config.method == "paper" else "body"
    findings = (*pillars.findings, *lost, *_missing(shift, pillars))
    if not wanted:
        findings = tuple(replace(finding, level="info") for finding in findings)
    return PillarMotion(pillars, shift, error, turn, method, findings), ()


def _as_bodies(movie: Movie, pillars: Pillars, reference_frame: int,
               _: Config) -> tuple[Floats, Floats, Floats, list[Finding]]:
    shift, error, turn, findings = _nothing(movie, pillars)
    for p, mask in enumerate(pillars.masks):
        try:
            body = follow_body(movie, mask, reference_frame=reference_frame)
        except CannotMeasure as why:
            findings.append(_not_followed(pillars.names[p], why))
            continue
        shift[:, p], error[:, p], turn[:, p] = body.translation_px, body.translation_se_px, body.rotation_deg
    return shift, error, turn, findings


def _by_markers(movie: Movie, pillars: Pillars, reference_frame: int,
                config: Config) -> tuple[Floats, Floats, Floats, list[Finding]]:
    shift, error, turn, findings = _nothing(movie, pillars)
    for p, mask in enumerate(pillars.masks):
        head = Masks(mask, measure_axis(mask), "supplied")
        try:
            markers = place_markers(movie, head, reference_frame, config)
            tracks = track_markers(movie, head, markers, config, lambda _: None)
        except CannotMeasure as why:
            findings.append(_not_followed(pillars.names[p], why))
            continue
        middle = tracks.position_px.mean(axis=1)
        shift[:, p] = middle - middle[reference_frame]
    return shift, error, turn, findings


def _nothing(movie: Movie, pillars: Pillars) -> tuple[Floats, Floats, Floats, list[Finding]]:
    shape = (movie.count, len(pillars), 2)
    return np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape[:2], np.nan), []


def _not_followed(name: str, why: CannotMeasure) -> Finding:
    return Finding("pillar_not_followed", "review", f"Pillar {name} could not be followed, so it has no force: {why}")


def _missing(shift: Floats, pillars: Pillars) -> list[Finding]:
    """Findings about pillars that are missing in part of the frames."""
    gone = np.isnan(shift[..., 0])
    return [Finding("pillar_lost", "review", f"Pillar {name} was not found in {share:.0%} of the frames (limit "
                    f"{LOST_SHARE:.0%}): is something in front of it, or its mask beside it?", float(share), LOST_SHARE)
            for name, share in zip(pillars.names, gone.mean(axis=0), strict=True) if LOST_SHARE < share < 1]
