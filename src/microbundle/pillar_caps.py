"""Caps: round pillar heads near the ends of the tissue, brighter (or darker) than all that surrounds them.

Pieces of plausible size and place are cut out of the level picture at many brightnesses. The outline of each is moved
to halfway between its own brightness and that of its ring, and the piece is judged by its place, size, shape, and by
how clearly it stands out from every part of its ring.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from .data import Bools, Floats
from .level import LENGTH_PX, Level
from .pillar_candidate import PLACE, Candidate
from .ramp import ramp
from .view import blurred, distance

BLUR_PX = 1.2
"""Smoothing of the level picture before brightness is compared."""
AROUND = 0.03
"""The range of brightness is that of the tissue and of the ground this near to it, as a share of its length."""
SHADING = 0.04
"""Brightness that varies over more than this share of the tissue's length is shading, not texture."""
OUTLINE_PX = 4
"""The tissue's outline is blurred over this far."""
LEVELS = 18
"""Brightnesses at which pieces are cut out."""
SAME_PX, SAME_AREA = 4, 0.2
"""Pieces that differ by less than this in their place and in the logarithm of their area are taken for the same."""
DIAMETER = (0.05, 0.09, 0.30, 0.42)
"""Diameter of a cap of the same area, as a share of the tissue's length."""
DIAMETER_TO_WIDTH = (1.15, 0.95)
"""The same as a share of the tissue's largest width: the tissue holds the pillar."""
CAP_ASIDE = (0.38, 0.22)
"""Distance of a cap from the axis, as a share of the tissue's largest width."""
CAP_SOLIDITY = (0.78, 0.92)
"""Share of its convex hull."""
CAP_ROUNDNESS = (0.35, 0.6)
"""Smaller to larger axis of the ellipse with its second moments."""
CAP_CUT_OFF = (0.3, 0.1)
"""Share of the outline that lies at the picture's edge."""
CAP_CONTRAST = (2.5, 6.0)
"""Difference between a cap and its ring, in standard deviations of the tissue; in the weaker parts of the ring."""
CAP_RANGE = (0.04, 0.12)
"""The same difference as a share of the picture's range of brightness."""
CAP_EVEN = (1.0, 2.5)
"""Difference between a cap and its ring, in standard deviations of the cap itself."""
DARK_CAP = 0.7
"""Factor on the plausibility of a cap that is darker than its ring: a shadow is, too."""
RING = 0.3
"""Width of a cap's ring, in radii."""
SECTORS = 12
WEAK_SECTORS = 0.2
"""Share of a ring that may be as bright as the cap: where the tissue grows over it, or is cut by the picture."""


def caps(level: Level) -> list[Candidate]:
    """Find all pieces that could be a round cap, the most plausible first."""
    smooth = blurred(level.image, BLUR_PX)
    around = level.seen & (distance(~level.body) < AROUND * LENGTH_PX)
    low, high = np.percentile(smooth[around], [1, 99])
    inner = level.tissue & level.seen
    inner[:, np.abs(np.arange(inner.shape[1]) - level.middle[1]) > PLACE[0] * LENGTH_PX] = False
    if high <= low or not inner.any():
        return []
    scatter = max(_texture(smooth, inner), 0.005 * float(high - low))
    found = []
    for sign in (1, -1):
        tried: set[tuple[int, ...]] = set()
        for cut in np.linspace(low, high, LEVELS + 2)[1:-1]:
            for piece in _pieces(level, sign * (smooth - cut) > 0, tried):
                one = _cap(level, smooth, piece, sign, scatter, float(high - low))
                if one is not None:
                    found.append(one)
    return sorted(found, key=lambda c: -c.plausibility)


def _texture(smooth: Floats, tissue: Bools) -> float:
    """Standard deviation of the brightness of the tissue itself, without shading and without its outline."""
    inner = distance(tissue) > OUTLINE_PX
    inner = inner if inner.any() else tissue
    share = inner.astype(np.float32)
    shading = blurred(smooth * share, SHADING * LENGTH_PX) / np.maximum(blurred(share, SHADING * LENGTH_PX), 1e-6)
    return 1.48 * float(np.median(np.abs(smooth - shading)[inner]))


@dataclass(frozen=True)
class _Piece:
    """A piece of the picture in a window around it that also shows its ring."""

    window: tuple[slice, slice]
    mask: Bools


def _pieces(level: Level, above: Bools, tried: set[tuple[int, ...]]) -> Iterator[_Piece]:
    """The pieces of a mask, holes filled, that have the size and the place of a cap, but of none in `tried`.

    Pieces of neighbouring brightness are often nearly the same, and their outlines end up at the same place.
    """
    _, label, stats, middle = cv2.connectedComponentsWithStats((above & level.seen).astype(np.uint8), connectivity=4)
    smallest, largest = (np.pi / 4 * (d * LENGTH_PX) ** 2 for d in (DIAMETER[0], DIAMETER[-1]))
    place = (middle[:, ::-1] - level.middle) / LENGTH_PX
    area, box = stats[:, cv2.CC_STAT_AREA], stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
    fits = ((area > 0.6 * smallest) & (area < largest) & (box.max(axis=1) < 1.4 * DIAMETER[-1] * LENGTH_PX)
            & (np.abs(place[:, 1]) > PLACE[0]) & (np.abs(place[:, 1]) < PLACE[-1])
            & (np.abs(place[:, 0]) * LENGTH_PX < CAP_ASIDE[0] * level.width))
    fits[0] = False
    for i in np.nonzero(fits)[0]:
        like = (*(middle[i] / SAME_PX).round().astype(int).tolist(), round(np.log(area[i]) / SAME_AREA))
        if like in tried:
            continue
        tried.add(like)
        x, y, wide, high = stats[i, :4]
        pad = int(RING * max(wide, high)) + 4
        window = (slice(max(y - pad, 0), y + high + pad), slice(max(x - pad, 0), x + wide + pad))
        yield _Piece(window, _filled(label[window] == i))


def _filled(mask: Bools) -> Bools:
    """The largest region of a mask without its holes."""
    outlines = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
    if not outlines:
        return mask
    return cv2.drawContours(np.zeros(mask.shape, np.uint8), [max(outlines, key=cv2.contourArea)], -1, 1, -1) > 0


def _cap(level: Level, smooth: Floats, piece: _Piece, sign: int, scatter: float, span: float) -> Candidate | None:
    """Judge a piece as a cap, after its outline was moved to halfway between its brightness and its ring's."""
    here, seen, mask = smooth[piece.window], level.seen[piece.window], piece.mask
    above = np.zeros(mask.shape)
    for _ in range(2):
        radius = np.sqrt(np.count_nonzero(mask) / np.pi)
        outward = distance(~mask)
        ring = (outward > 1.5) & (outward < 1.5 + RING * radius) & seen
        if not ring.any() or radius < 3:
            return None
        halfway = 0.5 * (float(np.median(here[mask])) + float(np.median(here[ring])))
        above = np.where((outward < 0.15 * radius) & seen, sign * (here - halfway), -span)
        mask = _filled(above > 0)
    score = _cap_shape(level, mask, piece.window)
    if score > 0:
        score *= _stands_out(here, seen, mask, sign, scatter, span)
    if score == 0:
        return None
    inside = np.full(smooth.shape, -span, np.float32)
    inside[piece.window] = np.where(mask, np.maximum(above, 1e-3 * span), np.minimum(above, -1e-3 * span))
    area = np.count_nonzero(mask)
    return Candidate(inside, _center(level, mask, piece.window), np.sqrt(area) / LENGTH_PX,
                     "bright cap" if sign > 0 else "dark cap", score)


def _cap_shape(level: Level, mask: Bools, window: tuple[slice, slice]) -> float:
    """How much a piece has the place, the size and the shape of a cap, from 0 to 1."""
    area = np.count_nonzero(mask)
    if area < np.pi / 4 * (DIAMETER[0] * LENGTH_PX) ** 2:
        return 0.0
    outline = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0][0]
    small, large = np.linalg.eigvalsh(np.cov(np.argwhere(mask).T))
    hull = cv2.convexHull(outline)
    hull_area = cv2.contourArea(hull) + 0.5 * cv2.arcLength(hull, True) + 1  # of pixels, not of their middles
    diameter, center = 2 * np.sqrt(area / np.pi), _center(level, mask, window)
    inner = cv2.erode(level.seen[window].astype(np.uint8), np.ones((3, 3)), borderValue=0)
    x, y = outline[:, 0].T
    return float(
        ramp(abs(center[1]), PLACE) * ramp(diameter / LENGTH_PX, DIAMETER)
        * ramp(diameter / level.width, DIAMETER_TO_WIDTH)
        * ramp(abs(center[0]) * LENGTH_PX / level.width, CAP_ASIDE)
        * ramp(area / hull_area, CAP_SOLIDITY) * ramp(np.sqrt(small / max(large, 1e-9)), CAP_ROUNDNESS)
        * ramp(1.0 - inner[y, x].mean(), CAP_CUT_OFF))


def _center(level: Level, mask: Bools, window: tuple[slice, slice]) -> Floats:
    corner = np.array([window[0].start, window[1].start])
    return np.asarray((np.argwhere(mask).mean(axis=0) + corner - level.middle) / LENGTH_PX)


def _stands_out(here: Floats, seen: Bools, cap: Bools, sign: int, scatter: float, span: float) -> float:
    """How clearly a cap differs in brightness from every part of its ring, from 0 to 1."""
    outward = distance(~cap)
    ring = np.argwhere((outward > 1.5) & (outward < 1.5 + RING * np.sqrt(np.count_nonzero(cap) / np.pi)) & seen)
    if len(ring) < SECTORS:
        return 0.0
    around = ring - np.argwhere(cap).mean(axis=0)
    sector = ((np.arctan2(*around.T) / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    count = np.bincount(sector, minlength=SECTORS)
    total = np.bincount(sector, here[ring[:, 0], ring[:, 1]], minlength=SECTORS)
    brightness = total[count > 0] / count[count > 0]
    own = here[cap]
    apart = sign * (float(np.median(own)) - brightness)
    weak = float(np.quantile(apart, WEAK_SECTORS))
    score = ramp(weak / scatter, CAP_CONTRAST) * ramp(weak / span, CAP_RANGE)
    score *= ramp(float(np.median(apart)) / max(float(own.std()), 1e-9), CAP_EVEN)
    return score * (1.0 if sign > 0 else DARK_CAP)
