"""The figure that says how far a result can be trusted: its verdict, a few numbers, and all findings."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import numpy as np

from .shown import Shown
from .style import FAINT, LEVEL, POINTS, SMALL_POINTS, bare, blank, place

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EDGE_MM, HEAD_MM, LINE_MM, GAP_MM, LABEL_MM = 2.0, 13.0, 2.9, 1.2, 9.0
LETTER_MM = 1.1
"""Usual width of a small letter."""
ORDER = {"fail": 0, "review": 1, "info": 2}


def quality(shown: Shown, width_mm: float) -> Figure:
    """Verdict, name and size of the movie, and its findings, the worst first."""
    from matplotlib.patches import FancyBboxPatch

    analysis = shown.analysis
    letters = int((width_mm - 2 * EDGE_MM - LABEL_MM) / LETTER_MM)
    found = [(f.level, textwrap.wrap(f.message, letters))
             for f in sorted(analysis.findings, key=lambda f: ORDER[f.level])]
    height = EDGE_MM + HEAD_MM + sum(len(lines) * LINE_MM + GAP_MM for _, lines in found) + EDGE_MM
    if not found:
        height += LINE_MM
    figure = blank(width_mm, height)
    axes = bare(place(figure, 0, 0, width_mm, height))
    axes.set_xlim(0, width_mm)
    axes.set_ylim(height, 0)
    axes.add_patch(FancyBboxPatch((EDGE_MM + 1, EDGE_MM + 1), 15, 4.4, boxstyle="round,pad=0.6,rounding_size=1",
                                  facecolor=LEVEL[analysis.verdict], edgecolor="none"))
    axes.text(EDGE_MM + 8.5, EDGE_MM + 3.3, analysis.verdict, color="white", weight="bold", ha="center", va="center",
              fontsize=POINTS + 1)
    name = textwrap.shorten(analysis.name, int((width_mm - 24) / LETTER_MM / 1.2), placeholder=" ...")
    axes.text(EDGE_MM + 19.5, EDGE_MM + 0.3, name, va="top", fontsize=POINTS, weight="bold")
    axes.text(EDGE_MM + 19.5, EDGE_MM + 3.8, _size(shown), va="top", fontsize=SMALL_POINTS, color=FAINT)
    y = EDGE_MM + HEAD_MM - 3
    if not found:
        axes.text(EDGE_MM, y, "nothing to report", va="top", fontsize=SMALL_POINTS, color=FAINT)
    for level, lines in found:
        axes.text(EDGE_MM, y, level, va="top", color=LEVEL[level], weight="bold", fontsize=SMALL_POINTS)
        for line in lines:
            axes.text(EDGE_MM + LABEL_MM, y, line, va="top", fontsize=SMALL_POINTS)
            y += LINE_MM
        y += GAP_MM
    return figure


def _size(shown: Shown) -> str:
    analysis = shown.analysis
    beats = int(analysis.beats.complete.sum())
    parts = [f"{analysis.frame_count} frames", f"{beats} whole beat{'' if beats == 1 else 's'}"]
    peaks = shown.signal[analysis.beats.peak]
    if np.isfinite(peaks).any():
        parts.append(f"{float(np.nanmean(peaks)):.2f} {shown.length_unit} at the peak")
    return ", ".join(parts)


