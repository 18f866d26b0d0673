"""A result's beats in the words of another tool: its columns, by its own definitions.

Beats are those of this program; from there on each number follows the tool's definition (see `compat_definitions`), of
the displacement or force measured here (see `compat_trace`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from difflib import get_close_matches
from typing import TYPE_CHECKING

import numpy as np

from .analysis import Analysis
from .compat_definitions import TENS, TOOLS, names
from .compat_trace import Named, Trace, between_pillars, each_force, each_pillar, length_unit, tissue
from .data import Floats
from .errors import ConfigError
from .numbers import seconds_per_frame

if TYPE_CHECKING:
    import pandas as pd

BELOW = 3
"""Frames in a row below a level that MUSCLEMOTION asks for."""
OF_PILLARS = ("pulse3d", "pillartrack")
"""Tools whose rows may be of a pillar."""


def compat_columns(analysis: Analysis, tool: str) -> pd.DataFrame:
    """Compute the numbers of another tool: a row for each beat, and for each pillar where the tool measures pillars.

    `tool` is musclemotion, beatprofiler, pulse3d or pillartrack. Names and definitions are those of that tool
    (docs/compat.md); the units in the names are those of this result: um or px, the tool's unit of time or frames. NaN
    where the tool has no number; columns that the result cannot have at all (forces without a stiffness) are left out.
    Raises ConfigError for an unknown tool.
    """
    import pandas as pd

    if tool not in TOOLS:
        near = get_close_matches(tool, TOOLS, n=1)
        raise ConfigError(f"compat: expected {', '.join(TOOLS)}; found {tool!r}"
                          + (f". Did you mean {near[0]!r}?" if near else ""))
    known = seconds_per_frame(analysis) is not None
    units = dict(zip(("time", "per", "rate"), TOOLS[tool].units if known else ("frames", "frame", "per frame"),
                     strict=True))
    units |= {"size": length_unit(analysis), "amplitude": "Twitch Amplitude"}
    identity = ["beat", *["pillar"] * (tool in OF_PILLARS), "complete", "signal"]
    rows: list[dict[str, object]] = []
    for trace in SIGNALS[tool](analysis):
        if trace.size == "uN":
            units |= {"size": "uN", "amplitude": "Active Twitch Force"}
        found = {name.format(**units): values for name, values in NUMBERS[tool](trace).items()}
        for b, complete in enumerate(analysis.beats.complete):
            rows.append({"beat": b, "pillar": trace.pillar, "complete": bool(complete), "signal": trace.name,
                         **{name: values[b] for name, values in found.items()}})
    every = [name for column in TOOLS[tool].columns for name in names(column, **units)]
    return pd.DataFrame(rows, columns=identity + [name for name in every if not rows or name in rows[0]])


def _musclemotion(trace: Trace) -> Named:
    y, peak, count = trace.values, trace.peak, len(trace.peak)
    base, edges = np.full(count, np.nan), np.full((2, 3, count), np.nan)
    apart = np.diff(peak)
    reach = np.append(apart, apart[-1:] if count > 1 else [len(y)] * count)
    for b in np.flatnonzero(trace.usable):
        first = 0 if b == 0 else peak[b] - round((peak[b] - peak[b - 1]) / 2)
        base[b] = y[first:peak[b]].min()
        for i, level in enumerate((10, 50, 90)):
            height = base[b] + 0.01 * level * (y[peak[b]] - base[b])
            edges[:, i, b] = [_three_below(y, int(peak[b]), height, way, int(reach[b])) for way in (-1, 1)]
    top, rise, fall = np.where(trace.peaked, trace.at(peak), np.nan), trace.at(edges[0]), trace.at(edges[1])
    height = trace.of_usable(y[peak])
    wide = {f"{100 - level}-to-{100 - level} transient ({{time}})": fall[i] - rise[i]
            for i, level in enumerate((10, 50, 90))}
    return {"Contraction duration [10% above baseline] ({time})": fall[0] - rise[0],
            "Time-to-peak ({time})": top - rise[0], "Relaxation Time ({time})": fall[0] - top, **wide,
            "Peak-to-peak time ({time})": np.append(np.nan, np.diff(top))[:count], "Baseline value ({size})": base,
            "Peak amplitude ({size})": height, "Contraction amplitude ({size})": height - base}


def _three_below(y: Floats, peak: int, level: float, way: int, reach: int) -> float:
    """First frame from the peak that is below a level together with the next two, within `reach` frames; else NaN."""
    side = y[peak::way][:reach + BELOW]
    low = side < level
    run = low[:-2] & low[1:-1] & low[2:]
    return peak + way * float(np.argmax(run)) if run.any() else np.nan


def _beatprofiler(trace: Trace) -> Named:
    usable, valley, top = trace.usable, trace.valley, trace.of_usable(trace.at(trace.peak))
    (rise50, fall50), (rise90, fall90), (_, fall) = (trace.passed(x) for x in (0.5, 0.9, 1 - np.exp(-1)))
    slope = np.gradient(trace.values, trace.time)
    speed = np.full((2, len(top)), np.nan)
    for b in np.flatnonzero(usable):
        around = slope[valley[b]:valley[b + 1]]
        speed[:, b] = around.max(), -around.min()
    own = {"raw amplitude [{size}]": trace.prominence()} if trace.more is None else trace.more
    return {"beat index": trace.of_usable(trace.peak), "tau [{time}]": fall - top, "fwhm [{time}]": fall50 - rise50,
            "contract50 [{time}]": top - rise50, "relax50 [{time}]": fall50 - top, "fw90m [{time}]": fall90 - rise90,
            "contract90 [{time}]": top - rise90, "relax90 [{time}]": fall90 - top,
            "contraction speed [{size}/{per}]": speed[0], "relaxation speed [{size}/{per}]": speed[1], **own}


def _pulse3d(trace: Trace) -> Named:
    usable, valley, y, peak = trace.usable, trace.valley, trace.values, trace.peak
    count = len(peak)
    left, right = ({x: np.full(count, np.nan) for x in TENS} for _ in range(2))
    height, area = np.full((2, count), np.nan), np.full(count, np.nan)
    for b in np.flatnonzero(usable):
        height[:, b] = y[peak[b]] - y[valley[[b, b + 1]]]
        for x in TENS:
            left[x][b] = _passed(y, int(peak[b]), y[peak[b]] - 0.01 * x * height[0, b], -1)
            right[x][b] = _passed(y, int(peak[b]), y[peak[b]] - 0.01 * x * height[1, b], 1)
        area[b] = _area_above_chord(trace, left[90][b], right[90][b])
    rise, fall = ({x: trace.at(side[x]) for x in TENS} for side in (left, right))
    top = np.where(trace.peaked, trace.at(peak), np.nan)
    period = np.append(np.diff(top), np.nan)[:count]
    amplitude = height.mean(axis=0)
    most = float(np.nanmax(amplitude)) if usable.any() else np.nan
    uneven = np.full(count, np.nan)
    uneven[1:-1] = np.abs(np.diff(np.diff(top))).round(9)  # frames are even but for rounding
    widths = {f"Twitch Width {x} ({{time}})": fall[x] - rise[x] for x in TENS}
    up = {f"Time From Contraction {x} to Peak ({{time}})": top - rise[100 - x] for x in (10, 50, 90)}
    down = {f"Time From Peak to Relaxation {x} ({{time}})": fall[x] - top for x in (10, 50, 90)}
    return {"Twitch Period ({time})": period, "Twitch Frequency ({rate})": 1 / period,
            "{amplitude} ({size})": amplitude, "Fraction of Maximum {amplitude}": amplitude / most,
            "Area Under Curve ({size} * {per})": area,
            "Twitch Contraction Velocity ({size}/{per})": 0.8 * height[0] / (rise[10] - rise[90]),
            "Twitch Relaxation Velocity ({size}/{per})": 0.8 * height[1] / (fall[90] - fall[10]),
            "Twitch Interval Irregularity ({time})": uneven, **widths, **up, **down}


def _passed(y: Floats, peak: int, level: float, way: int) -> float:
    """Place between frames at which the signal first reaches down to a level from the peak; NaN where it does not."""
    side = y[peak::way]
    low = side <= level
    if not low.any():
        return np.nan
    i = int(np.argmax(low))
    return float(peak + way * (i - (level - side[i]) / (side[i - 1] - side[i])))


def _area_above_chord(trace: Trace, left: float, right: float) -> float:
    """Area between the signal and the straight line that joins its points at two places between frames."""
    if not np.isfinite([left, right]).all():
        return np.nan
    place = np.concatenate([[left], np.arange(np.ceil(left), right), [right]])
    height = np.interp(place, np.arange(len(trace.values)), trace.values)
    time = trace.at(place)
    return float(np.trapezoid(height - np.interp(time, time[[0, -1]], height[[0, -1]]), time))


def _pillartrack(trace: Trace) -> Named:
    (rise50, fall50), (rise80, fall80) = trace.passed(0.5), trace.passed(0.8)
    valley, peak = trace.valley, trace.peak
    slope = np.convolve(np.diff(trace.values) / np.diff(trace.time), np.full(3, 1 / 3), mode="valid")
    speed = np.full((2, len(peak)), np.nan)
    for b in np.flatnonzero(trace.usable):
        first, top, last = (max(int(frame) - 1, 0) for frame in (valley[b], peak[b], valley[b + 1]))
        speed[:, b] = slope[first:top + 1].max(), slope[top:last + 1].min()
    return {"beat_peaks": trace.of_usable(peak), "t50 ({time})": fall50 - rise50, "t80 ({time})": fall80 - rise80,
            "mean absolute displacement ({size})": trace.of_usable(trace.values[peak]),
            "contraction velocity ({size}/{per})": speed[0], "relaxation velocity ({size}/{per})": speed[1],
            **(trace.more or {})}


SIGNALS: dict[str, Callable[[Analysis], Iterator[Trace]]] = {
    "musclemotion": lambda analysis: tissue(analysis, per_second=1e3), "beatprofiler": between_pillars,
    "pulse3d": each_force, "pillartrack": each_pillar}
NUMBERS: dict[str, Callable[[Trace], Named]] = {
    "musclemotion": _musclemotion, "beatprofiler": _beatprofiler, "pulse3d": _pulse3d, "pillartrack": _pillartrack}
