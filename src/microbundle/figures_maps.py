"""Figures that lie over the picture of the tissue: masks, markers, displacement, sub-domains, strain, delays.

Each takes what is shown and gives a figure as wide as asked, in millimetres. The picture is the relaxed frame, cut to
the tissue and its pillars, as the camera saw it: rows down. Maps lie where the tissue rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .data import Bools, Floats
from .shown import Shown
from .style import (
    BLUE,
    DIVERGING,
    FAINT,
    INK,
    OVERLAY,
    PILLAR,
    POINTS,
    RED,
    SEQUENTIAL,
    SMALL_POINTS,
    TISSUE,
    bare,
    blank,
    colour_bar,
    colour_map,
    limits_of,
    place,
    round_size,
    scale_bar,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

Limits = tuple[float, float]

EDGE_MM, TITLE_MM, FOOT_MM, BAR_MM = 1.5, 5.0, 5.0, 15.0
"""Room at the sides, for the title, for the scale bar, and for the colour bar with its numbers."""
NARROW_MM = 55.0
"""A picture that is narrower has its remarks beside the scale bar, beyond its edge."""
TALLEST = 1.0
"""Largest height of a picture over the width it could have."""
ARROWS = 15
"""Arrows along the longer side of a picture."""
MOST_NUMBERS = 40
"""Sub-domains up to which their values are written into them."""
DISPLACEMENT = {"displacement": "Displacement", "displacement_row": "Row displacement",
                "displacement_col": "Column displacement"}


@dataclass(frozen=True)
class Sheet:
    """A figure with the picture on it, and the axes of its colour bar."""

    figure: Figure
    axes: Axes
    right: float
    """Where the remarks below the picture end, as a share of its width."""
    bar: Axes | None


def sheet(shown: Shown, width_mm: float, title: str, *, bar: bool) -> Sheet:
    """Lay out a picture with its title, scale bar and, where asked for, room for a colour bar."""
    r0, r1, c0, c1 = shown.box
    room = width_mm - 2 * EDGE_MM - (BAR_MM if bar else 0)
    wide = min(room, TALLEST * room * (c1 - c0) / (r1 - r0))
    high = wide * (r1 - r0) / (c1 - c0)
    figure = blank(width_mm, high + TITLE_MM + FOOT_MM)
    axes = bare(place(figure, EDGE_MM, TITLE_MM, wide, high))
    axes.imshow(shown.picture, cmap="gray", vmin=0, vmax=1, extent=(c0 - 0.5, c1 - 0.5, r1 - 0.5, r0 - 0.5))
    axes.set_xlim(c0 - 0.5, c1 - 0.5)
    axes.set_ylim(r1 - 0.5, r0 - 0.5)
    axes.set_title(title, loc="left", fontsize=POINTS, pad=3)
    scale_bar(axes, c1 - c0, shown.px, shown.length_unit)
    right = wide if wide > NARROW_MM else room
    return Sheet(figure, axes, right / wide, place(figure, EDGE_MM + wide + 1.5, TITLE_MM, 2.2, high) if bar else None)


def tissue(shown: Shown, width_mm: float) -> Figure:
    """Outline of the tissue's mask, its axis and width, and the pillars."""
    title = "Tissue and axis" if shown.analysis.pillars is None else "Tissue, axis and pillars"
    page = sheet(shown, width_mm, title, bar=False)
    axes, masks = page.axes, shown.analysis.masks
    outline(axes, masks.tissue, TISSUE)
    axis = masks.axis
    along = axis.direction[::-1] * axis.length_px / 2
    across = np.array([-axis.direction[0], axis.direction[1]]) * axis.width_center_px / 2
    for way, style in ((along, "-"), (across, (0, (2, 1)))):
        ends = np.stack([axis.center_px[::-1] - way, axis.center_px[::-1] + way])
        axes.plot(*ends.T, color="white", lw=1.0, ls=style)
    if shown.analysis.pillars is not None:
        pillars = shown.analysis.pillars.pillars
        for p, (name, mask, center) in enumerate(zip(pillars.names, pillars.masks, pillars.center_px, strict=True)):
            colour = PILLAR[p % len(PILLAR)]
            outline(axes, mask, colour)
            label(axes, center, name)
    foot(page, f"length {axis.length_px * shown.px:.0f}, width {axis.width_center_px * shown.px:.0f} "
               f"{shown.length_unit}")
    return page.figure


def markers(shown: Shown, width_mm: float) -> Figure:
    """The markers that were followed, and those that were lost."""
    analysis = shown.analysis
    kept = analysis.tracks.kept
    page = sheet(shown, width_mm, f"Markers, {int(kept.sum())} followed", bar=False)
    points = analysis.markers.position_px
    outline(page.axes, analysis.masks.tissue, TISSUE)
    for members, colour, shape in ((kept, "#ffffff", "o"), (~kept, RED, "x")):
        if members.any():
            page.axes.plot(points[members, 1], points[members, 0], shape, ms=1.4, mfc=BLUE, mec=colour, mew=0.25)
    foot(page, f"{int((~kept).sum())} lost" if (~kept).any() else "")
    return page.figure


def displacement(shown: Shown, width_mm: float, kind: str, limits: Limits | None, *, arrows: bool) -> Figure:
    """Displacement at the peak: its length, or its part along the rows or columns."""
    values = displacement_values(shown, kind)
    unit = shown.length_unit
    absolute = kind == "displacement"
    low, high = limits or displacement_limits(shown, kind)
    page = sheet(shown, width_mm, f"{DISPLACEMENT[kind]} at the peak, {shown.beats_text}", bar=True)
    r0, r1, c0, c1 = shown.box
    image = page.axes.imshow(values, cmap=SEQUENTIAL if absolute else DIVERGING, vmin=low, vmax=high, alpha=OVERLAY,
                             extent=(c0 - 0.5, c1 - 0.5, r1 - 0.5, r0 - 0.5), interpolation="bilinear")
    _clip(image, page.axes, shown.analysis.masks.tissue)
    if arrows:
        foot(page, f"arrows {_arrows(page.axes, shown)} times as long")
    assert page.bar is not None
    colour_bar(page.figure, page.bar, image, f"{DISPLACEMENT[kind]} ({unit})", values[shown.peak_displacement[1]])
    return page.figure


def displacement_values(shown: Shown, kind: str) -> Floats:
    """The map (A, B) of a kind of displacement figure, NaN away from the tissue."""
    moved, _ = shown.peak_displacement
    if kind == "displacement":
        return np.asarray(np.hypot(moved[..., 0], moved[..., 1]))
    return np.asarray(moved[..., 0 if kind == "displacement_row" else 1])


def displacement_limits(shown: Shown, kind: str) -> Limits:
    """Limits that hold a kind of displacement everywhere in the tissue."""
    values = displacement_values(shown, kind)[shown.peak_displacement[1]]
    return limits_of(values, symmetric=kind != "displacement")


def _arrows(axes: Axes, shown: Shown) -> str:
    """Draw arrows on the map, and tell how many times longer than the displacement they are."""
    moved, inside = shown.peak_displacement
    r0, r1, c0, c1 = shown.box
    step = max(max(moved.shape[:2]) // ARROWS, 1)
    rows, cols = (np.linspace(a, b - 1, n)[step // 2::step]
                  for a, b, n in ((r0, r1, moved.shape[0]), (c0, c1, moved.shape[1])))
    some, seen = moved[step // 2::step, step // 2::step] / shown.px, inside[step // 2::step, step // 2::step]
    longest = float(np.nanmax(np.hypot(some[..., 0], some[..., 1]), initial=0.0, where=seen))
    if longest <= 0:
        return "1"
    times = max(c1 - c0, r1 - r0) / ARROWS / longest
    times = float(np.floor(times)) if times < 10 else round_size(times)
    times = max(times, 1.0)
    where = np.nonzero(seen)
    axes.quiver(cols[where[1]], rows[where[0]], some[where][:, 1] * times, some[where][:, 0] * times, angles="xy",
                scale_units="xy", scale=1, color="white", edgecolor=INK, linewidth=0.25, width=0.0125, headwidth=3.6,
                headlength=4, headaxislength=3.6, minlength=0.5, units="inches")
    return f"{times:g}"


def subdomains(shown: Shown, width_mm: float) -> Figure:
    """Which sub-domain is where; those without strain are crossed out."""
    strain = shown.analysis.strain
    assert strain is not None
    page = sheet(shown, width_mm, f"Sub-domains, {strain.side_px[0] * shown.px:.0f} × "
                 f"{strain.side_px[1] * shown.px:.0f} {shown.length_unit}", bar=False)
    without = np.array([bool(why) for why in strain.reason])
    _tiles(page.axes, strain.corner_px, ["none"] * len(without), edge=TISSUE, width=0.9)
    for s in np.flatnonzero(without):
        for ends in (strain.corner_px[s, [0, 2]], strain.corner_px[s, [1, 3]]):
            page.axes.plot(ends[:, 1], ends[:, 0], color=RED, lw=0.6)
    for name, corners in zip(strain.label, strain.corner_px, strict=True):
        label(page.axes, corners.mean(axis=0), name)
    foot(page, f"{int(without.sum())} without strain" if without.any() else "")
    return page.figure


def strain_map(shown: Shown, width_mm: float, part: str, limits: Limits | None) -> Figure:
    """One component of E in each sub-domain at the peak: `cc`, `cr` or `rr`."""
    low, high = limits or limits_of(strain_values(shown, part), symmetric=True)
    return _tile_map(shown, width_mm, strain_values(shown, part), (low, high),
                     f"Strain at the peak, {shown.beats_text}", f"Strain $E_{{{part}}}$ (%)", "{:+.1f}")


def strain_values(shown: Shown, part: str) -> Floats:
    """One component of E (S,) in percent at the peak; E is symmetric, so `cr` is the `rc` of the tables."""
    i, j = ("rc".index(letter) for letter in part)
    return np.asarray(100 * shown.strain[:, i, j])


def delay(shown: Shown, width_mm: float, limits: Limits | None) -> Figure:
    """By how much each sub-domain contracts later than the middle one."""
    values, timed = delay_values(shown), shown.time_unit == "s"
    return _tile_map(shown, width_mm, values, limits or limits_of(values, symmetric=True),
                     f"Delay of the contraction, {shown.beats_text}", f"Delay ({'ms' if timed else 'frames'})",
                     "{:+.0f}" if timed else "{:+.1f}")


def delay_values(shown: Shown) -> Floats:
    """Delay (S,) of each sub-domain, in ms, or in frames where the frame rate is not known."""
    return shown.delay * (1e3 if shown.time_unit == "s" else 1.0)


def _tile_map(shown: Shown, width_mm: float, values: Floats, limits: Limits, title: str, name: str,
              number: str) -> Figure:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    strain = shown.analysis.strain
    assert strain is not None
    page = sheet(shown, width_mm, title, bar=True)
    shade = ScalarMappable(Normalize(*limits), colour_map(DIVERGING))
    known = np.isfinite(values)
    colours = [shade.to_rgba(value) if ok else "none" for value, ok in zip(values, known, strict=True)]
    _tiles(page.axes, strain.corner_px, colours, edge="white", width=0.5)
    if len(values) <= MOST_NUMBERS:
        for value, corners in zip(values[known], strain.corner_px[known], strict=True):
            dark = abs(2 * (value - limits[0]) / (limits[1] - limits[0]) - 1) > 0.6
            row, col = corners.mean(axis=0)
            text = number.format(value).replace("-", "−")
            if not any(digit in text for digit in "123456789"):  # neither +0.0 nor -0.0
                text = text[1:]
            page.axes.text(col, row, text, ha="center", va="center",
                           fontsize=_fitting(page, strain.side_px[1], len(number.format(value))),
                           color="white" if dark else INK)
    foot(page, "" if known.all() else f"empty: no value ({int((~known).sum())})")
    assert page.bar is not None
    colour_bar(page.figure, page.bar, shade, name, values)
    return page.figure


def _fitting(page: Sheet, side_px: float, letters: int) -> float:
    """Size of letters, in points, at which so many fit into a sub-domain, at most the usual one."""
    points_per_px = page.axes.get_position().width * page.figure.get_figwidth() * 72 / abs(
        np.subtract(*page.axes.get_xlim()))
    return float(min(SMALL_POINTS, 0.86 * side_px * points_per_px / (0.62 * letters)))


def principal(shown: Shown, width_mm: float) -> Figure:
    """Directions of the principal strains in each sub-domain at the peak; lengths are their sizes."""
    from matplotlib.lines import Line2D

    strain = shown.analysis.strain
    assert strain is not None
    value, angle = shown.principal
    largest = float(np.nanmax(np.abs(value), initial=0.0)) or 1.0
    page = sheet(shown, width_mm, f"Principal strains at the peak, {shown.beats_text}, longest {100 * largest:.1f} %",
                 bar=False)
    _tiles(page.axes, strain.corner_px, ["none"] * len(strain.label), edge="#ffffff90", width=0.4)
    centers = strain.corner_px.mean(axis=1)
    for k in range(2):
        turned = np.deg2rad(angle + 90 * k)
        way = np.stack([np.sin(turned), np.cos(turned)], axis=1)
        reach = 0.46 * min(strain.side_px) * (np.abs(value[:, k]) / largest)[:, None] * way
        for center, half, size in zip(centers, reach, value[:, k], strict=True):
            if np.isfinite(size):
                ends = np.stack([center - half, center + half])
                page.axes.plot(ends[:, 1], ends[:, 0], color="white", lw=2.2, solid_capstyle="butt")
                page.axes.plot(ends[:, 1], ends[:, 0], color=BLUE if size < 0 else RED, lw=1.4,
                               solid_capstyle="butt")
    page.axes.legend(handles=[Line2D([], [], color=BLUE, lw=1.4, label="shortening"),
                              Line2D([], [], color=RED, lw=1.4, label="lengthening")],
                     loc="upper right", bbox_to_anchor=(page.right, 0.0), ncols=2, borderaxespad=0.35, handlelength=1.2,
                     columnspacing=1.0, handletextpad=0.5, borderpad=0)
    return page.figure


def outline(axes: Axes, mask: Bools, colour: str) -> None:
    """Draw the edge of a mask (R, C)."""
    axes.contour(_smooth(mask), [0.5], colors=[colour], linewidths=0.9)


def _clip(image: AxesImage, axes: Axes, tissue: Bools) -> None:
    """Let an image show only within a mask (R, C), by an edge that is smooth at any size."""
    from matplotlib.patches import PathPatch

    filled = axes.contourf(_smooth(tissue), [0.5, 2.0], colors="none")
    image.set_clip_path(PathPatch(filled.get_paths()[0], transform=axes.transData))
    filled.remove()


def _smooth(mask: Bools) -> Floats:
    """A mask as numbers that rise from 0 to 1 at its edge, without the steps of its pixels."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(mask.astype(np.float32), 1.0))


def _tiles(axes: Axes, corners: Floats, colours: Sequence[Any], *, edge: str, width: float) -> None:
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(list(corners[..., ::-1]), facecolors=colours, edgecolors=edge,
                                       linewidths=width))


def label(axes: Axes, place_px: Floats, text: str) -> None:
    """Write a short name over the picture, readable on any ground."""
    from matplotlib.patheffects import withStroke

    axes.text(place_px[1], place_px[0], text, ha="center", va="center", fontsize=SMALL_POINTS, color="white",
              path_effects=[withStroke(linewidth=1.4, foreground=INK)])


def foot(page: Sheet, text: str) -> None:
    """Write a remark below the picture, at the right."""
    from matplotlib.transforms import ScaledTranslation

    shift = ScaledTranslation(0, -1.8 / 25.4, page.figure.dpi_scale_trans)
    page.axes.text(page.right, 0, text, transform=page.axes.transAxes + shift, ha="right", va="center",
                   fontsize=SMALL_POINTS, color=FAINT)
