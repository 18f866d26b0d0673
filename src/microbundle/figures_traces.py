"""Figures over time: displacement, beats, strain of each sub-domain, pillars and forces.

Each takes what is shown and gives a figure as wide as asked, in millimetres. Bands are standard errors, where the
method knows them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .contraction import rest_path
from .data import Floats
from .numbers import clock
from .shown import Shown
from .style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    PALE,
    PEAK,
    PILLAR,
    PINK,
    POINTS,
    REST,
    SMALL_POINTS,
    blank,
    nice_ticks,
    place,
    plain,
)
from .waveform import FINE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Limits = tuple[float, float]

LEFT_MM, RIGHT_MM, TOP_MM, BOTTOM_MM = 11.0, 2.0, 5.0, 8.0
"""Room around a plot for its numbers and names."""
GRID_STEPS = 200
"""Times at which the mean beat is taken."""
LEAST_SHARE = 0.5
"""Share of the beats that must reach a time for the mean to go there."""


def signal(shown: Shown, width_mm: float, limits: Limits | None) -> Figure:
    """Mean displacement with beats, peaks and relaxed levels, and below it the drift of the relaxed tissue."""
    beats, time, values = shown.analysis.beats, shown.time, shown.signal
    drifts = len(beats) > 1
    high = 30.0
    figure = blank(width_mm, TOP_MM + high + BOTTOM_MM + (14.0 if drifts else 0))
    top = plain(place(figure, LEFT_MM, TOP_MM, width_mm - LEFT_MM - RIGHT_MM, high))
    for b in range(len(beats)):
        here = shown.frames_of(b)
        last = min(here.stop, len(time) - 1)
        whole = bool(beats.complete[b])
        top.axvspan(time[here.start], time[last], facecolor=PALE if whole and b % 2 == 0 else "none", lw=0,
                    edgecolor="#c8c8c8", hatch=None if whole else "/////")
        resting = beats.relaxed[here]
        if resting.any():
            level = float(np.nanmean(values[here][resting]))
            top.plot([time[here.start], time[last]], [level, level], color=REST, lw=0.9, ls=(0, (3, 1.5)),
                     label="relaxed level" if b == 0 else None)
    _band(top, time, values, shown.errors.get("signal"), INK)
    top.plot(time, values, color=INK, lw=0.9)
    top.plot(time[beats.peak], values[beats.peak], "v", color=PEAK, ms=3.2, mec="white", mew=0.3, label="peak",
             clip_on=False)
    top.set_xlim(time[0], time[-1])
    known = values[np.isfinite(values)]
    top.set_ylim(*(limits or (min(0.0, float(known.min(initial=0.0))), 1.08 * float(known.max(initial=1e-9)))))
    top.set_ylabel(f"Mean displacement ({shown.length_unit})")
    top.yaxis.set_major_locator(nice_ticks(5))
    top.set_title(f"{int(beats.complete.sum())} whole beats of {len(beats)}", loc="left", pad=3)
    if len(beats):
        top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1, borderpad=0.1,
                   handlelength=1.6, columnspacing=1.0)
    last_axes = top
    if drifts:
        last_axes = plain(place(figure, LEFT_MM, TOP_MM + high + 3.5, width_mm - LEFT_MM - RIGHT_MM, 10.5))
        top.tick_params(labelbottom=False)
        drift = beats.drift_px * shown.px
        for part, (name, colour) in enumerate((("row", GREEN), ("col", PINK))):
            last_axes.plot(time[beats.peak], drift[:, part], "o-", ms=2, color=colour, label=name, clip_on=False)
        last_axes.set_xlim(time[0], time[-1])
        widest = max(1.3 * float(np.nanmax(np.abs(drift), initial=0.0)), 0.02 * top.get_ylim()[1])
        last_axes.set_ylim(-widest, widest)
        last_axes.yaxis.set_major_locator(nice_ticks(3))
        last_axes.set_ylabel(f"Drift ({shown.length_unit})")
        for axes in (top, last_axes):
            axes.yaxis.set_label_coords(-(LEFT_MM - 3.0) / (width_mm - LEFT_MM - RIGHT_MM), 0.5)
        last_axes.legend(loc="upper right", ncols=2, borderaxespad=0, borderpad=0.1, handlelength=1.2,
                         columnspacing=1.0)
        last_axes.set_xlabel(f"Time ({shown.time_unit})")
    return figure


def beats(shown: Shown, width_mm: float, limits: Limits | None) -> Figure:
    """All beats laid over each other at their half rise, with their mean."""
    figure, axes = _plot(width_mm, 38.0)
    each = [between_frames(time, values) for time, values in shown.overlaid(signal_from_rest(shown))]
    for k, (time, values) in enumerate(each):
        axes.plot(time, values, color=FAINT, lw=0.6, label="beats" if k == 0 else None)
    time, mean, spread = _mean_of(each)
    axes.plot(time, mean, color=BLUE, lw=1.5, label="mean")
    if len(each) > 1:
        axes.fill_between(time, mean - spread, mean + spread, color=BLUE, alpha=0.25, lw=0, label="SD")
    _finish(axes, f"Time from half rise ({shown.time_unit})", f"Mean displacement ({shown.length_unit})",
            "One beat" if len(each) == 1 else f"{len(each)} beats", limits)
    axes.legend(loc="upper right", borderaxespad=0.1)
    return figure


def signal_from_rest(shown: Shown) -> Floats:
    """Mean displacement (T,), above the straight lines from rest to rest, in the unit of length."""
    return np.asarray(shown.signal - rest_path(shown.signal, shown.analysis.beats.relaxed, clock(shown.analysis)))


def strain_series(shown: Shown, width_mm: float, part: str, limits: Limits | None) -> Figure:
    """One component of E over time in each sub-domain, beat over beat, laid out as the sub-domains lie."""
    strain = shown.analysis.strain
    assert strain is not None
    i, j = ("rc".index(letter) for letter in part)
    values = 100 * strain.E[..., i, j]
    errors = shown.errors.get("E")
    rows, cols = strain.grid
    gap = 1.2
    wide = (width_mm - LEFT_MM - RIGHT_MM - gap * (cols - 1)) / cols
    high = float(np.clip(0.75 * wide, 9.0, 22.0))
    figure = blank(width_mm, TOP_MM + rows * high + (rows - 1) * gap + BOTTOM_MM)
    each = shown.overlaid(values)
    bands = None if errors is None else shown.overlaid(100 * errors[..., i, j])
    low, top = limits or series_limits(shown, part)
    first, last = min(float(t[0]) for t, _ in each), max(float(t[-1]) for t, _ in each)
    colours = _shades(len(each))
    for s, name in enumerate(strain.label):
        r, c = divmod(s, cols)
        axes = plain(place(figure, LEFT_MM + c * (wide + gap), TOP_MM + r * (high + gap), wide, high))
        axes.axhline(0, color=FAINT, lw=0.4)
        for k, (time, beat) in enumerate(each):
            if bands is not None:
                _band(axes, time, beat[:, s], bands[k][1][:, s], colours[k])
            axes.plot(time, beat[:, s], color=colours[k], lw=0.8)
        axes.set_xlim(first, last)
        axes.set_ylim(low, top)
        axes.xaxis.set_major_locator(nice_ticks(3))
        axes.yaxis.set_major_locator(nice_ticks(4))
        axes.tick_params(labelbottom=r == rows - 1, labelleft=c == 0)
        below = -low > top  # on the side of zero where there is more room
        axes.text(0.96, 0.06 if below else 0.94, name, transform=axes.transAxes, ha="right",
                  va="bottom" if below else "top", fontsize=SMALL_POINTS, color=FAINT)
    width, height = figure.get_size_inches() * 25.4
    figure.text(0.5 * (1 + (LEFT_MM - RIGHT_MM) / width), 1.2 / height,
                f"Time from the tissue's half rise ({shown.time_unit})", ha="center", va="bottom", fontsize=POINTS)
    figure.text(0.8 / width, 0.5 * (1 + (BOTTOM_MM - TOP_MM) / height), f"Strain $E_{{{part}}}$ (%)", ha="left",
                va="center", rotation=90, fontsize=POINTS)
    band = ", band: standard error" if bands is not None else ""
    figure.text(LEFT_MM / width, 1 - 3.6 / height, f"{len(each)} beats from first (dark) to last (light){band}"
                if len(each) > 1 else f"One beat{band}", ha="left", va="bottom", fontsize=POINTS)
    return figure


def pillar_displacement(shown: Shown, width_mm: float, limits: Limits | None) -> Figure:
    """Deflection of each pillar along its own motion, over time."""
    return _pillar_plot(shown, width_mm, 1.0, f"Pillar deflection ({shown.length_unit})", limits)


def force(shown: Shown, width_mm: float, limits: Limits | None) -> Figure:
    """Force of each pillar over time."""
    return _pillar_plot(shown, width_mm, shown.un_per_length, "Force (µN)", limits)


def _pillar_plot(shown: Shown, width_mm: float, factor: float, name: str, limits: Limits | None) -> Figure:
    motion = shown.analysis.pillars
    assert motion is not None
    figure, axes = _plot(width_mm, 32.0)
    error = shown.errors.get("pillar_path")
    for p, pillar in enumerate(motion.pillars.names):
        colour = PILLAR[p % len(PILLAR)]
        path = shown.pillar_path[:, p] * factor
        _band(axes, shown.time, path, None if error is None else error[:, p] * factor, colour)
        axes.plot(shown.time, path, color=colour, label=f"pillar {pillar}")
    axes.set_xlim(shown.time[0], shown.time[-1])
    _finish(axes, f"Time ({shown.time_unit})", name, "" if error is None else "band: standard error", limits)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1, borderpad=0.1,
                handlelength=1.4, columnspacing=1.0)
    return figure


def force_length(shown: Shown, width_mm: float, limits: Limits | None) -> Figure:
    """Mean force of the pillars over the tissue's length, a loop for each beat; an arrow shows the way."""
    figure, axes = _plot(0.75 * width_mm, 42.0)
    mean = shown.pillar_path.mean(axis=1) * shown.un_per_length
    shades = _shades(len(shown.beats))
    for k, b in enumerate(shown.beats):
        here = slice(shown.frames_of(int(b)).start, min(shown.frames_of(int(b)).stop + 1, len(mean)))
        x, y = between_frames(shown.time[here], np.stack([shown.length[here], mean[here]], axis=1))[1].T
        axes.plot(x, y, "-", color=shades[k], lw=0.9, label=f"beat {b}")
        up = int(np.argmax(y >= 0.5 * np.nanmax(y)))
        if k == 0 and up > 0:
            axes.annotate("", (x[up], y[up]), (x[up - 1], y[up - 1]),
                          arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0.9, "mutation_scale": 9,
                                      "shrinkA": 0, "shrinkB": 0})
    _finish(axes, f"Length of the tissue ({shown.length_unit})", "Mean force (µN)", "", limits)
    axes.xaxis.set_major_locator(nice_ticks(5))
    if 1 < len(shown.beats) <= 6:
        axes.legend(loc="upper right", borderaxespad=0.1, handlelength=1.2)
    return figure


def between_frames(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Times and values (t, ...) with 16 points for each frame, by the cubic spline with which beats are measured."""
    from scipy.interpolate import make_interp_spline

    if len(time) < 4 or not np.isfinite(values).all():
        return time, values
    fine = np.linspace(time[0], time[-1], FINE * (len(time) - 1) + 1)
    return fine, np.asarray(make_interp_spline(time, values, k=3)(fine))


def _plot(width_mm: float, high_mm: float) -> tuple[Figure, Axes]:
    figure = blank(width_mm, TOP_MM + high_mm + BOTTOM_MM)
    return figure, plain(place(figure, LEFT_MM, TOP_MM, width_mm - LEFT_MM - RIGHT_MM, high_mm))


def _finish(axes: Axes, x: str, y: str, title: str, limits: Limits | None) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title, loc="left", pad=3)
    if limits is not None:
        axes.set_ylim(*limits)
    axes.yaxis.set_major_locator(nice_ticks(5))


def _band(axes: Axes, time: Floats, values: Floats, error: Floats | None, colour: object) -> None:
    if error is not None and np.isfinite(error).any():
        axes.fill_between(time, values - error, values + error, color=colour, alpha=0.3, lw=0)


def _shades(count: int) -> list[tuple[float, ...]]:
    """Colours of beats, from the first to the last."""
    from .style import colour_map

    return [tuple(colour_map("cividis")(x)) for x in np.linspace(0.0, 0.85, max(count, 2))[:count]]


def series_limits(shown: Shown, part: str) -> Limits:
    """Limits, in percent, that hold one component of E in all sub-domains and beats that are shown."""
    strain = shown.analysis.strain
    assert strain is not None
    i, j = ("rc".index(letter) for letter in part)
    return _wide_limits(np.concatenate([values.ravel() for _, values in shown.overlaid(100 * strain.E[..., i, j])]))


def pillar_limits(shown: Shown) -> Limits:
    """Limits that hold the deflection of all pillars."""
    return _wide_limits(shown.pillar_path)


def force_limits(shown: Shown) -> Limits:
    """Limits that hold the force of all pillars."""
    return _wide_limits(shown.pillar_path * shown.un_per_length)


def _wide_limits(values: Floats) -> Limits:
    """Limits that hold all known values and zero, with a little room."""
    every = values[np.isfinite(values)]
    low, high = min(float(every.min(initial=0.0)), 0.0), max(float(every.max(initial=0.0)), 0.0)
    room = 0.08 * max(high - low, 1e-6)
    return low - room, high + room


def _mean_of(each: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats, Floats]:
    """Times, mean and standard deviation over beats, where at least half of them are known."""
    first, last = min(float(t[0]) for t, _ in each), max(float(t[-1]) for t, _ in each)
    fine = np.linspace(first, last, GRID_STEPS)
    lines = np.stack([np.interp(fine, t, v, left=np.nan, right=np.nan) for t, v in each])
    enough = np.isfinite(lines).mean(axis=0) >= LEAST_SHARE
    fine, lines = fine[enough], lines[:, enough]
    mean, n = np.nanmean(lines, axis=0), np.isfinite(lines).sum(axis=0)
    spread = np.sqrt(np.nansum((lines - mean) ** 2, axis=0) / np.maximum(n - 1, 1))
    return fine, mean, np.where(n > 1, spread, np.nan)
