"""Where a microbundle and its pillars lie, seen from above: the geometry that the mechanics is solved on.

A bundle is a closed contour, a thickness and its pillars. It is drawn by hand, read from a tissue mask, or made from
four lengths. Lengths are micrometres, forces micronewtons and moduli megapascals, which fit together (1 MPa is
1 uN/um^2). Points are (row, col), rows down, as everywhere; pixel (i, j) has its centre at (i, j) times um_per_px.

Sources: the published tissue is 2.044 mm long and 0.4 mm thick, on pillars that are clamped 0.995 mm below its top
(S1 Appendix and its script); pillar stiffness by beam theory.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import ndimage

from ..data import Bools, Floats
from ..errors import ConfigError, MaskUnusable

MIN_SIDES = 12
"""Fewest sides of the polygon that stands for a round pillar."""


@dataclass(frozen=True)
class Pillar:
    """An elastic pillar of constant cross-section: clamped at its base, bonded to the tissue over its thickness."""

    center_um: tuple[float, float]
    """(row, col)"""
    size_um: tuple[float, float] = (400.0, 400.0)
    """Extent (rows, cols); for a round pillar both are its diameter."""
    shape: Literal["round", "rectangle"] = "round"
    shaft_um: float = 595.0
    """Free length between the base and the lower side of the tissue."""
    young_mpa: float = 1.6
    poisson: float = 0.47

    def __post_init__(self) -> None:
        if min(*self.size_um, self.shaft_um, self.young_mpa) <= 0 or not -1 < self.poisson < 0.5:
            raise ConfigError(f"pillar: sizes and modulus must be positive and Poisson's ratio below 0.5; found {self}")
        if self.shape == "round" and self.size_um[0] != self.size_um[1]:
            raise ConfigError(f"pillar: a round pillar has one diameter, found size_um={self.size_um}")

    @classmethod
    def from_mask(cls, mask: Bools, um_per_px: float) -> Pillar:
        """Make a round pillar with the centre and the area of a pillar mask (R, C)."""
        at = np.argwhere(mask) * um_per_px
        if not len(at):
            raise MaskUnusable("pillar mask: it marks no pixel.")
        diameter = float(np.sqrt(4 / np.pi * len(at)) * um_per_px)
        return cls((float(at[:, 0].mean()), float(at[:, 1].mean())), (diameter, diameter))

    @property
    def area_um2(self) -> float:
        """Area of the cross-section."""
        product = self.size_um[0] * self.size_um[1]
        return float(np.pi / 4 * product if self.shape == "round" else product)

    def second_moment_um4(self, axis: int) -> float:
        """Second moment of area for bending along `axis`, 0 for rows and 1 for columns."""
        along, across = self.size_um[axis], self.size_um[1 - axis]
        return float(np.pi * along**4 / 64 if self.shape == "round" else across * along**3 / 12)

    def stiffness_un_per_um(self, axis: int, thickness_um: float) -> float:
        """Give the slender-beam stiffness for a force at half the tissue's thickness and the deflection at the top.

        k = 6 E I / (a^2 (3 L - a)), with L the whole height and a the height of the force. A stubby pillar is softer
        than this, for it also shears; a bonded thick tissue holds its top upright and makes it stiffer.
        """
        L, a = self.shaft_um + thickness_um, self.shaft_um + thickness_um / 2
        return float(6 * self.young_mpa * self.second_moment_um4(axis) / (a**2 * (3 * L - a)))

    def with_stiffness(self, stiffness_un_per_um: float, thickness_um: float, axis: int = 1) -> Pillar:
        """Choose the modulus that gives this slender-beam stiffness along `axis`; the outline stays as it is.

        For a pillar whose wide cap shows in the picture, while a thin shaft below, which does not, makes it soft.
        """
        now = self.stiffness_un_per_um(axis, thickness_um)
        return replace(self, young_mpa=self.young_mpa * stiffness_un_per_um / now)

    def polygon_um(self, spacing_um: float) -> Floats:
        """Give the cross-section as a closed polygon (n, 2) with sides of about `spacing_um`.

        A polygon inscribed in a circle bends too easily, so its radius is scaled until its second moment,
        n/24 R^4 sin(2 pi/n) (2 + cos(2 pi/n)), is that of the circle, pi/4 r^4.
        """
        if self.shape == "rectangle":
            half = np.array(self.size_um) / 2
            corner = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) * half
            return np.asarray(np.asarray(self.center_um) + divide(corner, spacing_um))
        radius = self.size_um[0] / 2
        n = max(MIN_SIDES, 4 * round(2 * np.pi * radius / spacing_um / 4))
        step = 2 * np.pi / n
        R = radius * (6 * np.pi / (n * np.sin(step) * (2 + np.cos(step)))) ** 0.25
        angle = step * np.arange(n)
        return np.asarray(np.asarray(self.center_um) + R * np.stack([np.sin(angle), np.cos(angle)], axis=1))


@dataclass(frozen=True)
class Bundle:
    """A microbundle at rest, seen from above: closed contour, thickness and pillars."""

    outline_um: Floats
    """Closed contour (N, 2), any spacing; the last point is joined to the first."""
    pillars: tuple[Pillar, ...]
    thickness_um: float = 400.0

    def __post_init__(self) -> None:
        if self.outline_um.ndim != 2 or self.outline_um.shape[1] != 2 or len(self.outline_um) < 3:
            raise ValueError(f"outline_um: expected (N >= 3, 2), found {self.outline_um.shape}")
        if self.thickness_um <= 0:
            raise ConfigError(f"thickness_um: expected a positive length, found {self.thickness_um}")

    @classmethod
    def from_mask(cls, mask: Bools, um_per_px: float, *, pillars: tuple[Pillar, ...] | None = None,
                  thickness_um: float = 400.0) -> Bundle:
        """Read the contour from a tissue mask (R, C), and place two pillars where none are given.

        Holes are filled: a mask with the pillars cut out is as good as one without. Raises MaskUnusable where the
        mask marks nothing.
        """
        outline = trace_outline(mask) * um_per_px
        return cls(outline, default_pillars(mask, um_per_px) if pillars is None else pillars, thickness_um)


def bundle_mask(shape: tuple[int, int], um_per_px: float, *, length_um: float = 1900.0, end_um: float = 780.0,
                waist_um: float = 450.0, angle_deg: float = 0.0) -> Bools:
    """Draw the mask (R, C) of a waisted bundle in the middle of the picture, turned clockwise by `angle_deg`."""
    rows, cols = (np.arange(n) - (n - 1) / 2 for n in shape)
    r, c = np.meshgrid(rows * um_per_px, cols * um_per_px, indexing="ij")
    turn = np.deg2rad(angle_deg)
    along, across = c * np.cos(turn) + r * np.sin(turn), r * np.cos(turn) - c * np.sin(turn)
    s = 2 * along / length_um
    swell = np.where(np.abs(s) < 0.7, np.sin(np.pi / 2 * np.clip(s / 0.7, -1, 1)) ** 2, 1.0)
    cap = np.sqrt(np.clip(1 - (np.clip(np.abs(s) - 0.7, 0, None) / 0.3) ** 2, 0, 1))
    return np.asarray((np.abs(s) <= 1) & (np.abs(across) < (waist_um + (end_um - waist_um) * swell) / 2 * cap))


def trace_outline(mask: Bools, smooth_px: float = 3.0) -> Floats:
    """Follow the border of the largest region of a mask (R, C): closed contour (N, 2) in pixels, about 1 px a step.

    The border runs on the cracks between pixels and is then smoothed along its length, or every pixel's corner would
    become a corner of the tissue.
    """
    solid = _solid(mask)
    padded = np.pad(solid, 2)
    padded = _largest(ndimage.gaussian_filter(padded.astype(float), 1.0) > 0.5)
    after: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for axis, step in ((0, (0, 1)), (1, (1, 0))):
        jump = np.diff(padded.astype(np.int8), axis=axis)
        for i, j in np.argwhere(jump != 0):
            corner = (int(i) + 1, int(j)) if axis == 0 else (int(i), int(j) + 1)
            ahead = (corner[0] + step[0], corner[1] + step[1])
            enters = (jump[i, j] > 0) == (axis == 0)          # keeps the tissue on the same side all the way round
            after[corner if enters else ahead].append(ahead if enters else corner)
    longest: list[tuple[int, int]] = []
    while after:
        loop = [next(iter(after))]
        while loop[-1] in after:
            exits = after[loop[-1]]
            loop.append(exits.pop())
            if not exits:
                del after[loop[-2]]
        longest = max(longest, loop[:-1], key=len)
    contour = np.array(longest, float) - 2.5                  # padding, and corners lie half a pixel off the centres
    return np.asarray(ndimage.gaussian_filter1d(contour, smooth_px, axis=0, mode="wrap"))


def default_pillars(mask: Bools, um_per_px: float) -> tuple[Pillar, Pillar]:
    """Place a round pillar at each end of a mask (R, C): in its two holes, or half a width from the ends.

    The diameter is 400 um, or half the local width where that is smaller.
    """
    mask = np.asarray(mask, bool)
    solid = _solid(mask)
    point = np.argwhere(solid) * um_per_px
    middle = point.mean(axis=0)
    direction = np.linalg.svd(np.cov((point - middle).T))[0][:, 0]
    direction = direction * np.sign(direction[1] if abs(direction[1]) > 1e-6 else direction[0])
    along, across = (point - middle) @ direction, (point - middle) @ np.array([-direction[1], direction[0]])

    label, count = ndimage.label(solid & ~mask)
    big = [k for k in range(1, count + 1) if np.sum(label == k) > 0.01 * solid.sum()]
    pillars = []
    for side in (-1, 1):
        end = (side * along).max()
        outer = side * along > 0.6 * end
        width = 2 * np.quantile(np.abs(across[outer]), 0.98)
        center = middle + side * (end - 0.5 * width) * direction + np.median(across[outer]) * np.array(
            [-direction[1], direction[0]])
        pillars.append(Pillar((float(center[0]), float(center[1])), (min(400.0, width / 2),) * 2))
    if len(big) == 2:
        found = sorted((np.argwhere(label == k).mean(axis=0) * um_per_px for k in big), key=lambda p: p @ direction)
        pillars = [replace(p, center_um=(float(at[0]), float(at[1]))) for p, at in zip(pillars, found, strict=True)]
    return pillars[0], pillars[1]


def divide(corner: Floats, spacing_um: float) -> Floats:
    """Divide each side of a closed polygon (n, 2) into equal steps no longer than `spacing_um`; corners stay."""
    parts = []
    for a, b in zip(corner, np.roll(corner, -1, axis=0), strict=True):
        n = max(1, int(np.ceil(np.hypot(*(b - a)) / spacing_um)))
        parts.append(a + (b - a) * (np.arange(n) / n)[:, None])
    return np.concatenate(parts)


def resample(contour: Floats, spacing_um: float) -> Floats:
    """Place points at equal steps of about `spacing_um` along a closed contour (n, 2)."""
    closed = np.vstack([contour, contour[:1]])
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    n = max(8, round(s[-1] / spacing_um))
    at = s[-1] * np.arange(n) / n
    return np.stack([np.interp(at, s, closed[:, k]) for k in (0, 1)], axis=1)


def inside(point: Floats, polygon: Floats) -> Bools:
    """Tell which points (N, 2) lie inside a closed polygon (n, 2), by counting the sides that a ray crosses."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    r, c = point[:, :1], point[:, 1:]
    straddles = (a[:, 0] <= r) != (b[:, 0] <= r)
    rise = np.where(b[:, 0] == a[:, 0], 1.0, b[:, 0] - a[:, 0])
    crosses = straddles & (c < a[:, 1] + (b[:, 1] - a[:, 1]) * (r - a[:, 0]) / rise)
    return np.asarray(crosses.sum(axis=1) % 2 == 1)


def _solid(mask: Bools) -> Bools:
    """Fill the holes of the largest region, also those that the edge of the picture cuts open."""
    rim = np.pad(np.asarray(mask, bool), 1)
    for line, inner in ((rim[0], rim[1]), (rim[-1], rim[-2]), (rim[:, 0], rim[:, 1]), (rim[:, -1], rim[:, -2])):
        on = np.flatnonzero(inner)
        if len(on):
            line[on[0]: on[-1] + 1] = True
    return _largest(_largest(ndimage.binary_fill_holes(rim))[1:-1, 1:-1])


def _largest(region: Bools) -> Bools:
    label, count = ndimage.label(region)
    if count == 0:
        raise MaskUnusable("tissue mask: it marks no pixel, so there is no tissue to make a mesh of.")
    size = np.bincount(label.ravel())[1:]
    return np.asarray(label == 1 + int(size.argmax()))
