"""One look for all pictures: colours, sizes, and the small parts that every figure shares.

Colours are those of M. Okabe and K. Ito and the maps viridis and RdBu, which people with any colour vision can tell
apart. Sizes are for print: a figure is one column of a journal wide, 85 mm, or two, 175 mm, and its text has 7 points.
matplotlib is imported when a picture is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .data import Floats
from .fonts import figure_fonts

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

INK, FAINT, PALE = "#222222", "#8c8c8c", "#ececec"
BLUE, SKY, GREEN, YELLOW, ORANGE, RED, PINK = ("#0072B2", "#56B4E9", "#009E73", "#F0E442", "#E69F00", "#D55E00",
                                               "#CC79A7")
TISSUE, PEAK, REST = ORANGE, RED, BLUE
PILLAR = (SKY, PINK, YELLOW, GREEN)
GROUPS = (SKY, ORANGE, GREEN, YELLOW, PINK, BLUE, RED, FAINT)
"""Colours of groups, where there are no more than these."""
LEVEL = {"pass": GREEN, "review": ORANGE, "fail": RED, "info": FAINT}
"""Colours of verdicts and findings."""
SEQUENTIAL, DIVERGING = "viridis", "RdBu_r"
OVERLAY, MOVIE_OVERLAY = 0.85, 0.65
"""How far a colour map covers the picture below it: in movies less, so that the tissue is seen to move."""

ONE_COLUMN_MM, TWO_COLUMNS_MM = 85.0, 175.0
MM_PER_INCH = 25.4
POINTS, SMALL_POINTS = 7.0, 6.0
DPI = 300

_SETTINGS: dict[str, Any] = {
    "font.size": POINTS, "axes.titlesize": POINTS, "axes.labelsize": POINTS,
    "legend.fontsize": SMALL_POINTS, "mathtext.fontset": "dejavusans", "axes.linewidth": 0.6, "lines.linewidth": 0.9,
    "axes.edgecolor": INK, "axes.labelcolor": INK, "text.color": INK, "xtick.color": INK, "ytick.color": INK,
    "legend.frameon": False, "pdf.fonttype": 42, "svg.fonttype": "none", "savefig.dpi": DPI, "figure.dpi": 100,
    "axes.unicode_minus": True, "axes.formatter.useoffset": False,
}


def settings() -> AbstractContextManager[None]:
    """matplotlib's settings while a figure is made, and while it is written."""
    from matplotlib import rc_context

    return rc_context(_SETTINGS | {"font.family": figure_fonts()})  # type: ignore[arg-type]


def blank(width_mm: float, height_mm: float) -> Figure:
    """Make an empty figure of a size in millimetres."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_mm / MM_PER_INCH, height_mm / MM_PER_INCH), facecolor="white")


def place(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Put axes on a figure, in millimetres from its upper left corner."""
    w, h = figure.get_size_inches() * MM_PER_INCH
    return figure.add_axes((left / w, 1 - (top + height) / h, width / w, height / h))


def plain(axes: Axes) -> Axes:
    """Take the upper and right line off the axes, and make the ticks small."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=SMALL_POINTS, width=0.6, length=2.2, pad=1.8, colors=INK)
    axes.xaxis.labelpad = axes.yaxis.labelpad = 2.0
    return axes


def bare(axes: Axes) -> Axes:
    """Take the ticks and lines off the axes of an image."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    return axes


def colour_bar(figure: Figure, axes: Axes, shown: ScalarMappable, label: str, values: Floats) -> None:
    """Draw a colour bar into axes of its own, pointed where values lie beyond its end."""
    from matplotlib.cm import ScalarMappable

    low, high = shown.get_clim()
    known = values[np.isfinite(values)]
    under, over = (bool((known < low - 1e-9 * (high - low)).any()), bool((known > high + 1e-9 * (high - low)).any()))
    bar = figure.colorbar(ScalarMappable(shown.norm, shown.cmap), cax=axes,
                          extend=(("neither", "max"), ("min", "both"))[under][over])
    bar.set_label(label, fontsize=POINTS, labelpad=3)
    bar.ax.tick_params(labelsize=SMALL_POINTS, width=0.6, length=2.0, pad=1.5)
    bar.outline.set_linewidth(0.4)
    bar.locator = nice_ticks(4)
    bar.update_ticks()


def scale_bar(axes: Axes, width: float, factor: float, unit: str) -> None:
    """Draw a scale bar below an image that is `width` px wide, `factor` units each."""
    size = round_size(0.25 * width * factor)
    share = size / (width * factor)
    axes.plot([0, share], [-0.0, -0.0], transform=_below(axes, 1.8), color=INK, lw=1.8, clip_on=False,
              solid_capstyle="butt")
    axes.text(share, 0, f" {size:g} {unit}", transform=_below(axes, 1.8), fontsize=SMALL_POINTS, va="center",
              clip_on=False)


def _below(axes: Axes, millimetres: float) -> Any:
    from matplotlib.transforms import ScaledTranslation

    figure = axes.get_figure(root=True)
    assert figure is not None
    return axes.transAxes + ScaledTranslation(0, -millimetres / MM_PER_INCH, figure.dpi_scale_trans)


def round_size(size: float) -> float:
    """Largest of 1, 2, 5, 10, 20, 50, ... that is not above a size."""
    ten = 10.0 ** np.floor(np.log10(size))
    return float(max(step * ten for step in (1, 2, 5) if step * ten <= size * (1 + 1e-9)))


def nice_ticks(count: int) -> Any:
    """Place at most so many ticks at round numbers."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(count, steps=[1, 2, 2.5, 5, 10])


def colour_map(name: str) -> Colormap:
    """Colour map of that name."""
    import matplotlib

    return matplotlib.colormaps[name]


def limits_of(values: Floats | Sequence[float], *, symmetric: bool) -> tuple[float, float]:
    """Limits that hold all known values and are easy to read: (-a, a), or (0, a)."""
    values = np.asarray(values, float)
    known = values[np.isfinite(values)]
    top = float(np.abs(known).max()) if known.size else 0.0
    if top <= 0:
        top = 1.0
    ten = 10.0 ** np.floor(np.log10(top))
    top = float(min(step * ten for step in (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10) if step * ten >= top * (1 - 1e-9)))
    return (-top if symmetric else 0.0, top)
