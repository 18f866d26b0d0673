"""Plates: long thin pillars that stand across the tissue at its ends, seen edge on.

Oblique light makes one side of a plate dark and the other bright, and its middle may be as bright as the tissue. What
stays is its edges: along each the brightness steps the same way everywhere. All boxes of plausible size, place and
tilt are tried. The coherence of an edge is the mean step across it over the mean strength of all steps there, so that
texture, whose steps cancel, counts against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .data import Bools, Floats
from .level import LENGTH_PX, Level
from .pillar_candidate import PLACE, Candidate
from .ramp import ramp
from .view import blurred

COARSER = 2
"""Boxes are tried in a picture this much smaller than the level one."""
SIDE_PX = LENGTH_PX / COARSER
SHARP = 0.04
"""Brightness that varies over more than this share of the tissue's length is shading, not an edge."""
FLOOR = 0.5
"""Steps below this share of the tissue's typical ones count as none."""
TILTS_DEG = np.arange(-12.0, 13.0, 4.0)
ASIDE = 0.13
"""Distance of a plate's middle from the axis is at most this share of the tissue's length."""
LENGTH = (0.15, 0.75)
"""Of a plate, as a share of the tissue's length."""
LENGTH_TO_WIDTH = (0.95, 1.25)
"""Of a plate, in widths of the tissue's middle: a plate holds the whole width."""
THICKNESS = (0.03, 0.055, 0.15, 0.19)
"""Of a plate, as a share of the tissue's length."""
SLENDER = (2.0, 2.6)
"""Length of a plate in thicknesses."""
LONG_EDGE = (0.45, 0.7)
"""Coherence of the weaker long edge."""
SHORT_EDGE = (0.1, 0.5)
"""Coherence of the weaker short edge, which is often round."""
CROSSED = (0.35, 0.2)
"""Steps across the tissue inside a plate, as a share of those at its weaker long edge."""
CORNER = 0.5
"""Radius of a plate's corners, in thicknesses."""


@dataclass(frozen=True)
class _Box:
    """A box in the turned small picture: first and last row and column."""

    t1: float
    t2: float
    s1: float
    s2: float
    tilt_deg: float
    plausibility: float
    evidence: float
    """By which the best box is chosen: plausibility times the length and the coherence of its edges."""


@dataclass(frozen=True)
class _Steps:
    """Sums of the brightness steps of a turned picture, from its border to each pixel."""

    along: Floats
    """(h + 1, w): steps along the tissue, summed down the rows."""
    along_all: Floats
    """The same of the strength of all steps."""
    across: Floats
    """(h, w + 1): steps across the tissue, summed along the columns."""
    across_all: Floats
    along_px: Floats
    """(h, w): absolute steps along the tissue, never zero."""
    across_px: Floats
    """(h, w): absolute steps across the tissue."""


def plates(level: Level) -> list[Candidate]:
    """Find the most plausible plate at each end of a level tissue, the better one first."""
    small = _coarse(blurred(level.image, COARSER))
    sharp = small - blurred(small, SHARP * SIDE_PX)
    seen = _coarse(level.seen.astype(np.float32)) > 0.99
    middle = (level.middle + 0.5) / COARSER - 0.5
    core = level.tissue & level.seen
    core[:, np.abs(np.arange(core.shape[1]) - level.middle[1]) > PLACE[0] * LENGTH_PX] = False
    if not core.any():
        return []
    width = float(np.median(core.sum(axis=0)[core.any(axis=0)])) / COARSER
    core = _coarse(core.astype(np.float32)) > 0
    strength = np.hypot(cv2.Sobel(sharp, cv2.CV_32F, 1, 0), cv2.Sobel(sharp, cv2.CV_32F, 0, 1))
    floor = FLOOR * float(np.median(strength[core])) + 1e-6 * float(np.ptp(sharp)) + 1e-30
    best: dict[int, _Box] = {}
    for tilt in TILTS_DEG:
        plain, steps = (_steps(picture, seen, middle, float(tilt), floor) for picture in (small, sharp))
        for end in (-1, 1):
            box = _best_box(plain, steps, middle, width, end, float(tilt))
            if box is not None and (end not in best or box.evidence > best[end].evidence):
                best[end] = box
    return sorted((_candidate(level, box, middle) for box in best.values()), key=lambda c: -c.plausibility)


def _coarse(picture: Floats) -> Floats:
    """Average a picture over squares of COARSER px; what is left over at its end is cut off."""
    rows, cols = (n // COARSER for n in picture.shape)
    whole = picture[:rows * COARSER, :cols * COARSER]
    return np.asarray(cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA))


def _turn(middle: Floats, tilt_deg: float) -> Floats:
    """Turn about the tissue's middle, as the (2, 3) matrix that cv2 takes."""
    return np.asarray(cv2.getRotationMatrix2D((float(middle[1]), float(middle[0])), tilt_deg, 1.0))


def _steps(small: Floats, seen: Bools, middle: Floats, tilt_deg: float, floor: float) -> _Steps:
    turn, size = _turn(middle, tilt_deg), small.shape[::-1]
    turned = cv2.warpAffine(small, turn, size, borderMode=cv2.BORDER_REPLICATE)
    known = cv2.warpAffine(seen.astype(np.float32), turn, size) > 0.99
    known = cv2.erode(known.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    along, across = (np.where(known, cv2.Sobel(turned, cv2.CV_32F, *d), 0.0) for d in ((1, 0), (0, 1)))
    strength = np.hypot(along, across) + floor
    down, right = ((1, 0), (0, 0)), ((0, 0), (1, 0))
    return _Steps(np.pad(along.cumsum(0), down), np.pad(strength.cumsum(0), down), np.pad(across.cumsum(1), right),
                  np.pad(strength.cumsum(1), right), np.abs(along) + floor, np.abs(across))


def _best_box(plain: _Steps, steps: _Steps, middle: Floats, width: float, end: int, tilt_deg: float) -> _Box | None:
    """The most plausible box at one end of a turned picture."""
    rows, cols = steps.along.shape[0] - 1, steps.along.shape[1]
    row = np.arange(2, rows - 2, 3)
    t1, t2 = (x.ravel() for x in np.meshgrid(row, row, indexing="ij"))
    length = t2 - t1
    fits = ((length > LENGTH[0] * SIDE_PX) & (length < LENGTH[1] * SIDE_PX) & (length > LENGTH_TO_WIDTH[0] * width)
            & (np.abs(0.5 * (t1 + t2) - middle[0]) < ASIDE * SIDE_PX))
    t1, t2, length = t1[fits], t2[fits], length[fits]
    reach = np.sort(middle[1] + end * np.arange(PLACE[0] * SIDE_PX, PLACE[-1] * SIDE_PX))
    s = np.round(reach[(reach > 1) & (reach < cols - 2)]).astype(int)
    one, other = ((p.along[t2][:, s] - p.along[t1][:, s]) / (p.along_all[t2][:, s] - p.along_all[t1][:, s])
                  for p in (plain, steps))
    # Shading has no sharp steps; beside a strong edge the filter makes steps that the picture does not have.
    long_edge = np.where(one * other > 0, np.minimum(np.abs(one), np.abs(other)), 0.0)
    best = None
    for thickness in range(max(int(THICKNESS[0] * SIDE_PX), 5), int(THICKNESS[-1] * SIDE_PX) + 1):
        slim = length >= SLENDER[0] * thickness
        if thickness >= len(s) or not slim.any():
            continue
        s1, s2 = s[:-thickness], s[thickness:]
        long = np.minimum(long_edge[slim, :-thickness], long_edge[slim, thickness:])
        ends = np.abs(steps.across[:, s2] - steps.across[:, s1]) / (steps.across_all[:, s2] - steps.across_all[:, s1])
        short = np.minimum(ends[t1[slim]], ends[t2[slim]])
        # A longer box of the same coherence has more evidence.
        evidence = (long - LONG_EDGE[0]).clip(0) * length[slim, None] * np.sqrt(short)
        i, j = np.unravel_index(int(np.argmax(evidence)), evidence.shape)
        if evidence[i, j] <= (best.evidence if best else 0.0):
            continue
        first, last, box_length = int(t1[slim][i]), int(t2[slim][i]), float(length[slim][i])
        edge = steps.along_px[first:last]
        crossed = (float(steps.across_px[first + thickness // 2:last - thickness // 2, s1[j] + 2:s2[j] - 1].mean())
                   / float(min(edge[:, s1[j]].mean(), edge[:, s2[j]].mean())))
        score = (ramp(float(long[i, j]), LONG_EDGE) * ramp(float(short[i, j]), SHORT_EDGE)
                 * ramp(thickness / SIDE_PX, THICKNESS) * ramp(box_length / thickness, SLENDER)
                 * ramp(box_length / width, LENGTH_TO_WIDTH) * ramp(crossed, CROSSED))
        parted = float(long_edge[slim][i, j + 2:j + thickness - 1].max())  # a plate has no edge in its middle
        weight = score * float(evidence[i, j]) * (1.0 - parted)
        if weight > 0 and (best is None or weight > best.evidence):
            best = _Box(first, last, float(s1[j]), float(s2[j]), tilt_deg, score, weight)
    return best


def _candidate(level: Level, box: _Box, middle: Floats) -> Candidate:
    """The box with rounded ends, back in the level picture."""
    row, col = np.mgrid[:level.image.shape[0], :level.image.shape[1]]
    turn = _turn(middle, box.tilt_deg)
    x, y = (np.stack([(col + 0.5) / COARSER - 0.5, (row + 0.5) / COARSER - 0.5, np.ones(col.shape)], axis=-1)
            @ turn.T).transpose(2, 0, 1)
    half = np.array([box.t2 - box.t1, box.s2 - box.s1]) / 2
    away = np.stack([y - 0.5 * (box.t1 + box.t2), x - 0.5 * (box.s1 + box.s2)])
    radius = CORNER * 2 * half[1]
    out = np.abs(away) - (half - radius)[:, None, None]
    inside = radius - np.hypot(*out.clip(0)) - np.minimum(out.max(axis=0), 0)
    center = (np.argwhere(inside > 0).mean(axis=0) - level.middle) / LENGTH_PX
    return Candidate(inside, center, float(np.sqrt(np.count_nonzero(inside > 0))) / LENGTH_PX, "plate",
                     box.plausibility)
