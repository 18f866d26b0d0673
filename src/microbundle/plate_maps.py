"""Plates as pictures for a paper: one map for each plate and metric, in the plate's geometry, and one of its groups.

All plates of a run share one colour scale for each metric. A well without a value shows why: blank, it has no movie;
crossed out, the movie could not be measured; hatched, its verdict is fail. A corner marks those to be reviewed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import tempfile
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import OutputError
from .plates import Plate, Well, groups_of, limits_of
from .report.page import number
from .report.terms import Term, term_of
from .style import (
    FAINT,
    GROUPS,
    INK,
    PALE,
    POINTS,
    SEQUENTIAL,
    SMALL_POINTS,
    TWO_COLUMNS_MM,
    bare,
    blank,
    colour_bar,
    colour_map,
    place,
    settings,
)
from .wells import row_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FOLDER, LIST = "plate_maps", ".drawn.json"
FORMATS = ("png", "pdf")
LARGEST_CELL_MM, LEAST_FOR_NUMBERS_MM, LEAST_FOR_KIND_MM = 11.0, 5.5, 9.5
LEFT_MM, TOP_MM, RIGHT_MM, BELOW_MM = 6.0, 10.0, 18.0, 8.0
LEGEND_MM, LEGEND_LINE_MM, LETTER_MM = 28.0, 4.2, 1.02
POINTS_A_MM = 2.83
BLANK = "Blank: no movie."


def draw_metric(plate: Plate, metric: str, limits: tuple[float, float], title: str | None = None) -> Figure:
    """Draw one metric of a plate as a matplotlib figure, two columns of a journal wide at most.

    `limits` are the ends of the colour scale, in the metric's unit (see `plates.limits_of`).
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    term = term_of(metric)
    with settings():
        figure, axes, cell = _frame(plate, RIGHT_MM, title or _title(plate, term))
        colours = ScalarMappable(Normalize(*limits), colour_map(SEQUENTIAL))
        for well in plate.wells:
            value = well.reading(metric)[0]
            share, known = (value - limits[0]) / (limits[1] - limits[0]), math.isfinite(value)
            _cell(axes, well, cell, colours.cmap(share) if known else None, number(value, 3) if known else "")
        height = min(plate.rows * cell, 60.0)
        bar = place(figure, LEFT_MM + plate.columns * cell + 3, TOP_MM, 3, height)
        colour_bar(figure, bar, colours, _labelled(term), np.array([well.reading(metric)[0] for well in plate.wells]))
        _legend(axes, plate, cell)
    return figure


def draw_groups(plate: Plate, groups: Sequence[str], title: str | None = None) -> Figure:
    """Draw which group each well of a plate belongs to; `groups` are all groups, whose order gives the colours."""
    with settings():
        figure, axes, cell = _frame(plate, LEGEND_MM, title or f"{plate.name}: groups".lstrip(": "))
        colours = _group_colours(groups)
        for well in plate.wells:
            if well.group:
                _filled(axes, well, cell, colours[well.group], _short(well.group, 8))
        here = [group for group in groups if any(well.group == group for well in plate.wells)]
        most = max(1, int(plate.rows * cell / LEGEND_LINE_MM))
        shown = here if len(here) <= most else here[:most - 1]
        for k, group in enumerate(shown):
            y = (k + 0.5) * LEGEND_LINE_MM / cell
            axes.add_patch(_square(plate.columns + 3 / cell, y - 1.4 / cell, 2.8 / cell, colours[group]))
            axes.text(plate.columns + 7 / cell, y, _short(group, 20), va="center", fontsize=SMALL_POINTS)
        if len(shown) < len(here):
            axes.text(plate.columns + 3 / cell, (most - 0.5) * LEGEND_LINE_MM / cell,
                      f"and {len(here) - len(shown)} more", va="center", fontsize=SMALL_POINTS)
        if len(plate.wells) < plate.rows * plate.columns:
            _say(axes, plate, cell, [BLANK])
    return figure


def write_maps(plates: Sequence[Plate], metrics: Sequence[str], out: Path) -> Path | None:
    """Write the maps of plates into the folder `plate_maps`, as PNG and PDF, and return it; None where there are none.

    A map that is there already with the same content is left alone, one of an earlier run that is no more is removed.
    Each file appears whole. Raises OutputError where the folder cannot be written.
    """
    folder = out / FOLDER
    try:
        before = _drawn(folder)
        now: dict[str, str] = {}
        for name, content, draw in _wanted(plates, metrics):
            now[name] = hashlib.sha256(content.encode()).hexdigest()
            files = [folder / f"{name}.{suffix}" for suffix in FORMATS]
            if before.get(name) == now[name] and all(file.is_file() for file in files):
                continue
            folder.mkdir(exist_ok=True)
            figure = draw()
            for file in files:
                _save(figure, file)
        if not now and not before:
            return None
        for name in before.keys() - now.keys():
            for suffix in FORMATS:
                (folder / f"{name}.{suffix}").unlink(missing_ok=True)
        if now != before:
            (folder / LIST).write_text(json.dumps(now, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{folder}: the plate maps cannot be written: {error.strerror or error}") from None
    return folder if now else None


def _wanted(plates: Sequence[Plate], metrics: Sequence[str]) -> Iterator[tuple[str, str, Any]]:
    """Every map that is wanted: its name, all that is seen on it, and how to draw it."""
    groups = groups_of(plates)
    scales = {metric: limits for metric in metrics if (limits := limits_of(plates, metric)) is not None}
    names = [re.sub(r"[^A-Za-z0-9._-]+", "_", plate.name).strip("._") or "plate" for plate in plates]
    for k, plate in enumerate(plates):
        name = names[k] if names.count(names[k]) == 1 else f"{names[k]}_{k + 1}"
        told = [plate.name, plate.rows, plate.columns,
                [(well.name, well.state, well.kind, well.group) for well in plate.wells]]
        for metric, limits in scales.items():
            values = [number(well.reading(metric)[0], 5) for well in plate.wells]
            yield (f"{name}_{metric}", repr((told, metric, limits, values)),
                   lambda plate=plate, metric=metric, limits=limits: draw_metric(plate, metric, limits))
        if groups:
            yield f"{name}_groups", repr((told, groups)), lambda plate=plate: draw_groups(plate, groups)


def _drawn(folder: Path) -> dict[str, str]:
    """What an earlier run has drawn, by name; a hash of what is seen on each map."""
    with suppress(OSError, ValueError, AttributeError):
        read = json.loads((folder / LIST).read_text(encoding="utf-8"))
        return {str(name): str(content) for name, content in read.items()}
    return {}


def _save(figure: Figure, file: Path) -> None:
    handle, partial = tempfile.mkstemp(prefix=f".{file.name}.partial-", dir=file.parent)
    os.close(handle)
    try:
        suffix = file.suffix.removeprefix(".")
        with settings():
            figure.savefig(partial, format=suffix, metadata={"CreationDate": None} if suffix == "pdf" else None)
        Path(partial).chmod(0o644)
        os.replace(partial, file)
    finally:
        Path(partial).unlink(missing_ok=True)


def _frame(plate: Plate, right_mm: float, title: str) -> tuple[Figure, Axes, float]:
    """Make a figure with the plate's empty wells; also give the side of a cell in millimetres."""
    from matplotlib.collections import LineCollection

    cell = min((TWO_COLUMNS_MM - LEFT_MM - right_mm) / plate.columns, LARGEST_CELL_MM)
    width, height = plate.columns * cell, plate.rows * cell
    figure = blank(LEFT_MM + max(width, 40.0) + right_mm, TOP_MM + height + BELOW_MM)
    axes = bare(place(figure, LEFT_MM, TOP_MM, width, height))
    axes.set_xlim(0, plate.columns)
    axes.set_ylim(plate.rows, 0)
    lines = [[(0, r), (plate.columns, r)] for r in range(plate.rows + 1)]
    lines += [[(c, 0), (c, plate.rows)] for c in range(plate.columns + 1)]
    axes.add_collection(LineCollection(lines, colors=PALE, linewidths=0.5, clip_on=False, zorder=0))
    size = min(SMALL_POINTS, 2.4 * cell)
    for r in range(plate.rows):
        axes.text(-1 / cell, r + 0.5, row_name(r), ha="right", va="center", fontsize=size)
    for c in range(plate.columns):
        axes.text(c + 0.5, -1 / cell, str(c + 1), ha="center", va="bottom", fontsize=size)
    axes.text(0, -5 / cell, title, va="bottom", fontsize=POINTS, weight="bold")
    return figure, axes, cell


def _cell(axes: Axes, well: Well, cell: float, colour: Any, text: str) -> None:
    """Draw one well: its colour and number, or why it has none."""
    row, column = well.place
    gap = _gap(cell)
    if colour is not None:
        _filled(axes, well, cell, colour, text)
    if well.state == "review":
        corner = max(0.16, min(1.6 / cell, 0.3))
        axes.fill([column + 1 - gap - corner, column + 1 - gap, column + 1 - gap], [row + gap, row + gap,
                  row + gap + corner], color="white", ec=INK, lw=0.4, zorder=3)
    elif well.state == "fail":
        patch = _square(column + gap, row + gap, 1 - 2 * gap, "none" if colour is not None else PALE)
        patch.set(hatch="/" * max(2, min(5, int(cell))), edgecolor=FAINT, linewidth=0, zorder=3)
        axes.add_patch(patch)
    elif well.state == "failed":
        a, b = 2 * gap, 1 - 2 * gap
        for ends in ((a, b), (b, a)):
            axes.plot([column + a, column + b], [row + ends[0], row + ends[1]], color=FAINT, lw=0.6, zorder=3,
                      solid_capstyle="round")
        if cell >= LEAST_FOR_KIND_MM and colour is None:
            words = re.sub(r"(?<=[a-z])(?=[A-Z])", "\n", well.kind)
            axes.text(column + 0.5, row + 0.5, words, ha="center", va="center", fontsize=4.2, color=INK, zorder=4,
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6})


def _filled(axes: Axes, well: Well, cell: float, colour: Any, text: str) -> None:
    """Fill one well with a colour, and write into it where there is room."""
    row, column = well.place
    axes.add_patch(_square(column + _gap(cell), row + _gap(cell), 1 - 2 * _gap(cell), colour))
    if cell >= LEAST_FOR_NUMBERS_MM:
        size = min(SMALL_POINTS, POINTS_A_MM * 0.9 * cell / (0.62 * max(len(text), 4)))
        axes.text(column + 0.5, row + 0.52, text, ha="center", va="center", fontsize=size,
                  color="white" if _dark(colour) else INK)


def _gap(cell: float) -> float:
    """Gap around a well's colour, as a share of its side."""
    return min(0.25 / cell, 0.06)


def _legend(axes: Axes, plate: Plate, cell: float) -> None:
    """Say below the map what its marks mean, those of them that are there."""
    states = {well.state for well in plate.wells}
    said = []
    if "review" in states:
        said.append("Corner: to be reviewed.")
    if "fail" in states:
        said.append("Hatched: verdict fail.")
    if "failed" in states:
        said.append("Crossed: no result (" + ", ".join(f"{n} {kind}" for kind, n in plate.failures.items()) + ").")
    if len(plate.wells) < plate.rows * plate.columns:
        said.append(BLANK)
    _say(axes, plate, cell, said)


def _say(axes: Axes, plate: Plate, cell: float, said: Sequence[str]) -> None:
    letters = int((plate.columns * cell + RIGHT_MM) / LETTER_MM)
    axes.text(0, plate.rows + 1.5 / cell, "\n".join(textwrap.wrap(" ".join(said), letters)), va="top",
              fontsize=SMALL_POINTS - 0.5, color=INK)


def _square(x: float, y: float, side: float, colour: Any) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x, y), side, side, facecolor=colour, edgecolor="none", zorder=1, clip_on=False)


def _group_colours(groups: Sequence[str]) -> dict[str, Any]:
    if len(groups) <= len(GROUPS):
        return dict(zip(groups, GROUPS, strict=False))
    shades = colour_map("turbo")
    return {group: shades((k + 0.5) / len(groups)) for k, group in enumerate(groups)}


def _dark(colour: Any) -> bool:
    """Tell whether white is read better on a colour than black is, by relative luminance."""
    from matplotlib.colors import to_rgb

    linear = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour))
    return sum(weight * c for weight, c in zip((0.2126, 0.7152, 0.0722), linear, strict=True)) < 0.2


def _title(plate: Plate, term: Term) -> str:
    return f"{plate.name}: {term.name}" if plate.name else term.name


def _labelled(term: Term) -> str:
    return f"{term.name} ({term.unit})" if term.unit else term.name


def _short(text: str, letters: int) -> str:
    return text if len(text) <= letters else text[:letters - 1] + "…"
