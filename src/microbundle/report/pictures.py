"""Pictures for the pages: the relaxed frame as 8 bits, and outlines of masks as paths.

A page holds each picture once, as a data URI: PNG where that is small, JPEG else. Points of paths are in px of the
movie's frames, x (col) first as SVG wants them; the centre of the first pixel is 0.5, 0.5 there.
"""

from __future__ import annotations

import base64

import cv2
import numpy as np

from ..analysis import Analysis
from ..data import Bools, Floats, Image, Masks

LONGEST = 1400
"""Longest side of the picture in a report, in its own pixels."""
LARGEST_PNG = 500_000
MARGIN = 0.05
"""Free space around the tissue in the maps, as a share of its size."""
WIDE = 360
"""Width of a thumbnail."""


def grey(image: Image) -> np.ndarray:
    """Scale a frame to 8 bits (R, C), between its percentiles 0.5 and 99.5."""
    low, high = np.percentile(image, [0.5, 99.5])
    scaled = (np.asarray(image, np.float32) - low) / max(high - low, 1e-12)
    return np.asarray(np.clip(np.rint(255 * scaled), 0, 255), np.uint8)


def data_uri(picture: np.ndarray, *, longest: int = LONGEST, largest_png: int = LARGEST_PNG) -> str:
    """Write an 8-bit picture (R, C) as a data URI, reduced where it is larger than `longest`."""
    side = max(picture.shape)
    if side > longest:
        size = tuple(max(1, round(n * longest / side)) for n in reversed(picture.shape))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    kind, data = "png", cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 6])[1]
    if len(data) > largest_png:
        kind, data = "jpeg", cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1]
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"


def view_box(analysis: Analysis) -> tuple[int, int, int, int]:
    """Give the part of the picture that holds the tissue, the pillars and a margin: x, y, width, height."""
    shown = np.array(analysis.masks.tissue)
    for mask in () if analysis.pillars is None else analysis.pillars.pillars.masks:
        shown |= mask
    rows, cols = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    if len(rows) == 0:
        return 0, 0, shown.shape[1], shown.shape[0]
    free = max(6, round(MARGIN * max(rows[-1] - rows[0], cols[-1] - cols[0])))
    top, left = max(0, int(rows[0]) - free), max(0, int(cols[0]) - free)
    bottom, right = min(shown.shape[0], int(rows[-1]) + free + 1), min(shown.shape[1], int(cols[-1]) + free + 1)
    return left, top, right - left, bottom - top


def outline(mask: Bools) -> str:
    """Trace the borders of a mask (R, C), holes included, as the path of an SVG."""
    found, _ = cv2.findContours(np.pad(mask.astype(np.uint8), 1), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parts = []
    for border in found:
        if len(border) < 8:
            continue
        points = cv2.approxPolyDP(border, 0.8, closed=True)[:, 0] - 0.5
        parts.append("M" + "L".join(f"{x:g} {y:g}" for x, y in points) + "Z")
    return "".join(parts)


def axis_line(masks: Masks) -> tuple[Floats, Floats]:
    """Ends of the tissue's axis, each (row, col) in px."""
    half = 0.5 * masks.axis.length_px * masks.axis.direction
    return masks.axis.center_px - half, masks.axis.center_px + half


def thumbnail(analysis: Analysis) -> str:
    """Make a small picture of the tissue, with its outline in white, as a data URI."""
    left, top, width, rows = view_box(analysis)
    part = np.s_[top:top + rows, left:left + width]
    size = (WIDE, max(1, round(WIDE * rows / width)))
    small = cv2.resize(grey(analysis.image)[part], size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(analysis.masks.tissue[part].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    borders, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(small, borders, -1, 255, 1, cv2.LINE_AA)
    return data_uri(small, largest_png=0)
