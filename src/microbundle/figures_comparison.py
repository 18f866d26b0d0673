"""Figures of a comparison: the wells of each group, pairs of wells, and dose-responses.

Every well is a point, and every plate has a colour and a marker. Below stand the differences with their 95 % intervals,
which are what the tables say; means of wells are short lines.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from .data import Floats
from .errors import ConfigError, OutputError
from .lookup import entries
from .report.terms import Term, pretty
from .statistics.groups import group_wells
from .statistics.paired import pairs
from .statistics.wells import file_name
from .style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    MM_PER_INCH,
    ONE_COLUMN_MM,
    ORANGE,
    PINK,
    POINTS,
    RED,
    SKY,
    SMALL_POINTS,
    TWO_COLUMNS_MM,
    YELLOW,
    blank,
    nice_ticks,
    place,
    plain,
    settings,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .statistics.compare import Comparison
    from .statistics.dose import Response
    from .statistics.wells import Well

LEFT_MM, RIGHT_MM, TOP_MM, BOTTOM_MM, GAP_MM = 17.0, 2.0, 4.5, 9.0, 3.0
LABEL_MM = 9.5
"""From the axes to the names of their vertical axis."""
WELLS_MM, DIFFERENCE_MM, CURVE_MM, LINE_MM = 34.0, 16.0, 40.0, 3.0
MOST_GROUP_MM, MOST_IN_COLUMN = 20.0, 6
COLOURS = (BLUE, ORANGE, GREEN, PINK, SKY, RED, YELLOW)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p")
MOST_NAMED = 10
"""Plates up to which a legend names them."""
LETTERS_ACROSS, LETTERS_WIDE = 9, 70
DOSE_UNITS = {"nm": "nM", "um": "µM", "mm": "mM", "pm": "pM", "m": "M"}
Place = tuple[str, str]


def save_all(comparison: Comparison, folder: Path | str, *, formats: Sequence[str] = ("png", "pdf")) -> list[Path]:
    """Write all figures of a comparison into a folder, `METRIC_groups.png` and the like; returns the files.

    Raises OutputError where the folder cannot be written.
    """
    folder, files, alike = Path(folder), list[Path](), Counter[str]()
    for name, make in _figures(comparison):
        alike[name] += 1
        name += f"_{alike[name]}" * (alike[name] > 1)
        with settings():
            figure = make()
            try:
                folder.mkdir(parents=True, exist_ok=True)
                for kind in formats:
                    files.append(folder / f"{name}.{kind}")
                    figure.savefig(files[-1], metadata={"CreationDate": None} if kind == "pdf" else None)
            except OSError as error:
                raise OutputError(f"{folder}: the figures cannot be written: {error.strerror or error}") from None
    return files


def _figures(comparison: Comparison) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """Names of the figures that a comparison has data for, and how each is made."""
    run = comparison.run
    for metric in run.metrics:
        for phase in run.columns.phases if comparison.control else ():
            if any(metric in well.values for well in group_wells(run, phase)):
                yield (file_name(f"{metric}_groups{f'_{phase}' if phase else ''}"),
                       partial(groups, comparison, metric, phase))
        if run.columns.pair and any(metric in a.values and metric in b.values for a, b in pairs(run)):
            yield f"{metric}_paired", partial(paired, comparison, metric)
    for response in comparison.responses:
        if response.wells:
            yield (file_name(f"{response.metric}_dose{f'_{response.name}' if response.name else ''}"),
                   partial(dose_response, comparison, response))


def groups(comparison: Comparison, metric: str, phase: str = "") -> Figure:
    """Wells of each group with their mean, and below each group's difference from the control."""
    run = comparison.run
    wells = [well for well in group_wells(run, phase) if metric in well.values]
    table = comparison.tables["comparison"]
    rows = table[(table["metric"] == metric) & (table["phase"] == phase)].set_index("group")
    names = (comparison.control, *(name for name in run.groups if name != comparison.control))
    figure, top, below = _two_panels(names, _plates(comparison), phase)
    for x, group in enumerate(names):
        mine = [well for well in wells if well.group == group]
        values = np.array([well.values[metric] for well in mine])
        for well, value, aside in zip(mine, values, spread(values), strict=True):
            _point(top, x + aside, value, _plates(comparison), well)
        if len(values) > 1:
            top.plot([x - 0.3, x + 0.3], [values.mean()] * 2, color=INK, lw=1.4, zorder=4)
        if group != comparison.control:
            _interval(below, x, rows.loc[group], "difference")
    _finish(top, below, metric, f"Difference\nfrom {_short(comparison.control)}")
    _name_plates(top, _plates(comparison))
    return figure


def paired(comparison: Comparison, metric: str) -> Figure:
    """Wells before and after, joined by lines, and below each group's mean change."""
    run, table = comparison.run, comparison.tables["paired"]
    rows = table[table["metric"] == metric].set_index("group")
    names = run.groups or ("",)
    known = [(a, b) for a, b in pairs(run) if metric in a.values and metric in b.values]
    first, second = run.columns.phases
    figure, top, below = _two_panels(names, _plates(comparison), f"{first} (left), {second} (right)")
    for x, group in enumerate(names):
        mine = [(a, b) for a, b in known if a.group == group]
        both = np.array([[well.values[metric] for well in pair] for pair in mine]).reshape(-1, 2)
        for (before, after), values in zip(mine, both, strict=True):
            top.plot([x - 0.22, x + 0.22], values, color=FAINT, lw=0.5, zorder=1)
            _point(top, x - 0.22, values[0], _plates(comparison), before)
            _point(top, x + 0.22, values[1], _plates(comparison), after)
        if len(both):
            top.plot([x - 0.22, x + 0.22], both.mean(axis=0), color=INK, lw=1.6, zorder=4)
        _interval(below, x, rows.loc[group], "change")
    _finish(top, below, metric, "Change")
    _name_plates(top, _plates(comparison))
    return figure


def dose_response(comparison: Comparison, response: Response) -> Figure:
    """Wells over dose without the plates' offsets, the curve with its 95 % band, and the EC50 with its interval."""
    curve, metric, plates = response.curve, response.metric, _plates(comparison)
    legend = LINE_MM if 1 < len(plates) <= MOST_NAMED else 0.0
    high = TOP_MM + LINE_MM + legend + CURVE_MM + BOTTOM_MM
    figure = blank(ONE_COLUMN_MM, high)
    axes = plain(place(figure, LEFT_MM, TOP_MM + LINE_MM + legend, ONE_COLUMN_MM - LEFT_MM - RIGHT_MM, CURVE_MM))
    doses = np.unique([well.dose for well in response.wells])
    positive = doses[doses > 0]
    axes.set_xscale("log")
    zero = positive.min() / 10**0.7 if len(positive) else 1.0
    offset = _offsets(response)
    for dose in doses:
        here = [well for well in response.wells if well.dose == dose]
        values = np.array([well.values[metric] - offset(well) for well in here])
        for well, value, aside in zip(here, values, spread(values), strict=True):
            _point(axes, (dose or zero) * 10**(0.3 * aside), value, plates, well)
    if curve.shown is not None and curve.shown_dose is not None:
        axes.fill_between(curve.shown_dose, curve.shown[:, 1], curve.shown[:, 2], color=FAINT, alpha=0.3, lw=0)
        axes.plot(curve.shown_dose, curve.shown[:, 0], color=INK, lw=1.1)
        middle = 0.5 * (curve.bottom[0] + curve.top[0])
        axes.plot(curve.ec50[1:], [middle] * 2, color=RED, lw=1.6, solid_capstyle="butt", zorder=5)
        axes.plot(curve.ec50[0], middle, "o", color=RED, ms=3.5, mec="white", mew=0.4, zorder=6)
    unit = comparison.run.columns.dose_unit
    unit = DOSE_UNITS.get(unit.casefold(), unit)
    axes.set_xlabel(f"Dose{f' of {response.compound}' if response.compound else ''}{f' ({unit})' if unit else ''}")
    _name_axis(axes, axis_label(metric), 5)
    if 0 in doses:
        _mark_zero(axes, zero, positive)
    if curve.reason:
        told = f"EC50 not estimable: {curve.reason}"
    else:
        told = "EC50 {:.3g} ({:.3g} to {:.3g})".format(*curve.ec50) + (f" {unit}" if unit else "")
    told = f"{response.group}: {told}" if response.group else told
    figure.text(LEFT_MM / ONE_COLUMN_MM, 1 - 1.0 / high, fill(told, LETTERS_WIDE), va="top",
                fontsize=SMALL_POINTS if curve.reason else POINTS)
    _name_plates(axes, plates)
    return figure


def axis_label(metric: str) -> str:
    """Name of a metric with its unit, as people write it; metrics that are not in the dictionary keep their column."""
    try:
        found = entries(metric)
    except ConfigError:
        return metric
    entry = min(found, key=lambda one: len(metric) - len(one.key))
    term = Term(metric, entry, pretty(metric.removeprefix(entry.key).removeprefix("_")), None)
    name = term.name.replace("E_cc", "$E_{cc}$")
    if "," in name:
        name = name.replace(", ", ",\n")
    return f"{name} ({term.unit})" if term.unit else name


def spread(values: Floats) -> Floats:
    """Move points that would lie over each other aside, the same way every time; within +/- 0.3."""
    out = np.zeros(len(values))
    if len(values) < 2 or not np.ptp(values) > 0:
        return np.linspace(-0.2, 0.2, len(values)) if len(values) > 1 else out
    near = 0.05 * float(np.ptp(values))
    order = np.argsort(values, kind="stable")
    steps = [0.0, 0.08, -0.08, 0.16, -0.16, 0.24, -0.24, 0.3, -0.3]
    for k, i in enumerate(order):
        taken = {float(out[j]) for j in order[max(k - len(steps), 0):k] if values[i] - values[j] < near}
        out[i] = next((step for step in steps if step not in taken), steps[k % len(steps)])
    return out


def _plates(comparison: Comparison) -> dict[Place, int]:
    return {name: i for i, name in enumerate(dict.fromkeys((w.day, w.plate) for w in comparison.run.wells))}


def _two_panels(names: Sequence[str], plates: dict[Place, int], title: str) -> tuple[Figure, Axes, Axes]:
    """Axes for the wells of groups of such names, and below them for differences."""
    count, long = len(names), max(len(name) for name in names) > LETTERS_ACROSS
    widest = ONE_COLUMN_MM if count <= MOST_IN_COLUMN else TWO_COLUMNS_MM
    wide = min(count * MOST_GROUP_MM, widest - LEFT_MM - RIGHT_MM)
    legend = LINE_MM * (1 + (len(plates) - 1) // 5) if 1 < len(plates) <= MOST_NAMED else 0.0
    above = (TOP_MM if title else 1.5) + legend
    high = above + WELLS_MM + GAP_MM + DIFFERENCE_MM + BOTTOM_MM + (3.0 if long else 0.0)
    width = max(LEFT_MM + wide + RIGHT_MM, 60.0)
    figure = blank(width, high)
    top = plain(place(figure, LEFT_MM, above, wide, WELLS_MM))
    below = plain(place(figure, LEFT_MM, above + WELLS_MM + GAP_MM, wide, DIFFERENCE_MM))
    below.axhline(0, color=FAINT, lw=0.6)
    for axes in (top, below):
        axes.set_xlim(-0.5, count - 0.5)
        axes.set_xticks(range(count))
    top.tick_params(labelbottom=False)
    below.set_xticklabels([_short(name) for name in names])
    if long:
        for text in below.get_xticklabels():
            text.set(rotation=25, ha="right", rotation_mode="anchor")
    figure.text(LEFT_MM / width, 1 - 1.0 / high, title, va="top")
    return figure, top, below


def _point(axes: Axes, x: float, y: float, plates: dict[Place, int], well: Well) -> None:
    i = plates[well.day, well.plate]
    axes.plot(x, y, MARKERS[i % len(MARKERS)], color=COLOURS[i % len(COLOURS)], ms=3.0, mec="white", mew=0.3, zorder=3,
              clip_on=False)


def _interval(axes: Axes, x: float, row: Any, name: str) -> None:
    """A difference with its interval, or the words that there is none."""
    value, low, high = (float(row[f"{name}{end}"]) for end in ("", "_low_95", "_high_95"))
    if not np.isfinite(value):
        axes.annotate("not\nestimable", (x, 0), ha="center", va="center", fontsize=SMALL_POINTS - 1, color=FAINT,
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5})
        return
    axes.plot([x, x], [low, high], color=INK, lw=1.1, solid_capstyle="butt")
    axes.plot(x, value, "o", color=INK, ms=3.2)


def _finish(top: Axes, below: Axes, metric: str, difference: str) -> None:
    _name_axis(top, axis_label(metric), 5)
    _name_axis(below, difference, 4)


def _name_axis(axes: Axes, name: str, ticks: int) -> None:
    """Name the vertical axis, at the same place whatever its numbers."""
    figure = axes.get_figure(root=True)
    assert figure is not None
    axes.set_ylabel(name, multialignment="center")
    axes.yaxis.set_major_locator(nice_ticks(ticks))
    axes.yaxis.set_label_coords(-LABEL_MM / (axes.get_position().width * figure.get_figwidth() * MM_PER_INCH), 0.5)


def _short(name: str) -> str:
    return name if len(name) <= 14 else f"{name[:13]}…"


def _name_plates(axes: Axes, plates: dict[Place, int]) -> None:
    """A legend of the plates above the axes."""
    from matplotlib.lines import Line2D

    if not 1 < len(plates) <= MOST_NAMED:
        return
    shown = [Line2D([], [], ls="none", marker=MARKERS[i % len(MARKERS)], color=COLOURS[i % len(COLOURS)], ms=3.0,
                    mec="white", mew=0.3, label=", ".join([plate] * bool(plate) + [f"day {day}"] * bool(day)))
             for (day, plate), i in plates.items()]
    axes.legend(handles=shown, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.1, borderpad=0.1,
                handletextpad=0.1, columnspacing=0.8)


def _offsets(response: Response) -> Callable[[Well], float]:
    """How far a well's plate (or the well) is offset as a whole; 0 where there is no curve."""
    points, offset = response.curve.points, response.curve.offset
    at = {} if offset is None else dict(zip(points.block.tolist(), offset.tolist(), strict=True))
    return lambda well: at.get(response.block_of(well), 0.0)


def _mark_zero(axes: Axes, zero: float, positive: Floats) -> None:
    """Put dose 0 on a logarithmic axis, left of a break."""
    from matplotlib.ticker import FixedFormatter, FixedLocator

    if len(positive) == 0:
        axes.set_xticks([zero], ["0"])
        return
    low, high = np.floor(np.log10(positive.min())), np.ceil(np.log10(positive.max()))
    tens = [10.0**k for k in np.arange(low, high + 1) if positive.min() / 1.5 <= 10.0**k <= positive.max() * 1.5]
    axes.xaxis.set_major_locator(FixedLocator([zero, *tens]))
    axes.xaxis.set_major_formatter(FixedFormatter(["0", *(f"{ten:g}" for ten in tens)]))
    axes.xaxis.set_minor_locator(FixedLocator([k * 10.0**n for n in np.arange(low, high + 1) for k in range(2, 10)
                                               if k * 10.0**n >= positive.min()]))
    axes.set_xlim(zero / 1.6, positive.max() * 2.2)
    at = float(np.sqrt(zero * positive.min()))
    axes.text(at, 0, "//", transform=axes.get_xaxis_transform(), ha="center", va="center", fontsize=POINTS, color=INK,
              bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.3}, clip_on=False)
