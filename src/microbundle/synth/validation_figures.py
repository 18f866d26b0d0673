"""Figures of a validation, like the paper's: errors against noise, errors against amplitude, curves beside the truth.

Source: paper, S1 Appendix, figures of errors by octave and magnitude ratio, and of E_cc by sub-domain.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import MicrobundleError, OutputError
from .cases import GROUPS, Case
from .coverage import LEVELS, QUANTITIES
from .scenes import Elements
from .validate import TRACES, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRUE, FOUND = "black", "tab:red"
TILES = ("A1", "A2", "B1", "B2")
SMALLEST_PCT = 1e-2


def write_figures(cases: Sequence[Case], rows: Sequence[Row], folder: Path) -> list[Path]:
    """Draw all figures that the rows allow, as PNG and PDF in `figures/`; returns the PNG files.

    Raises MicrobundleError where matplotlib is missing, and OutputError.
    """
    try:
        import matplotlib.figure as mpl
    except ImportError:
        raise MicrobundleError("figures need matplotlib; install it with: pip install 'microbundle[synth]'") from None
    out = []
    try:
        (folder / "figures").mkdir(exist_ok=True)
        for name, figure in _figures(mpl.Figure, cases, rows, folder):
            for suffix in ("png", "pdf"):
                figure.savefig(folder / "figures" / f"{name}.{suffix}", dpi=130)
            out.append(folder / "figures" / f"{name}.png")
    except OSError as error:
        raise OutputError(f"{folder}: the figures cannot be written: {error.strerror or error}") from None
    return out


def _figures(new: type[Figure], cases: Sequence[Case], rows: Sequence[Row], folder: Path) -> list[tuple[str, Figure]]:
    scored = [r for r in rows if r.measured and np.isfinite(r.scores["mad_error_pct"])]
    out = []
    if scored:
        out.append(("error_by_amplitude", error_by_amplitude(new, scored)))
    if any(r.held for r in rows):
        out.append(("calibration", calibration(new, [r for r in rows if r.held])))
    by_name = {c.name: c for c in cases}
    for passive in (False, True):
        noisy = [(by_name[r.case], r) for r in rows if r.case in by_name and by_name[r.case].octaves is not None
                 and isinstance(by_name[r.case].scene, Elements)
                 and getattr(by_name[r.case].scene, "passive", None) == passive]
        if noisy:
            kind = "heterogeneous" if passive else "homogeneous"
            out.append((f"error_by_noise_{kind}", error_by_noise(new, noisy, kind)))
    for group in GROUPS:
        mine = [r for r in scored if r.group == group]
        if mine:
            worst = max(mine, key=lambda r: abs(r.scores["mad_error_pct"]))
            file = folder / TRACES / f"{worst.case}.npz"
            if file.is_file():
                out.append((f"curves_{worst.case}", curves(new, worst, file)))
    return out


def error_by_amplitude(new: type[Figure], rows: Sequence[Row]) -> Figure:
    """Draw the peak MAD error and the E_cc error of every movie against its true peak displacement."""
    figure = new(figsize=(9, 3.8), layout="constrained")
    for axes, name, label in zip(figure.subplots(1, 2), ("mad_error_pct", "ecc_mae_pct"),
                                 ("error of the peak MAD (%)", "worst E_cc MAE / peak (%)"), strict=True):
        for group, color in zip(GROUPS, _colors(), strict=False):
            mine = [r for r in rows if r.group == group]
            if mine:
                axes.plot([r.scores["true_mad_px"] for r in mine],
                          [max(abs(r.scores[name]), SMALLEST_PCT) for r in mine], "o", color=color, label=group)
        axes.set(xscale="log", yscale="log", xlabel="true peak MAD (px)", ylabel=label)
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize=7)
    return figure


def calibration(new: type[Figure], rows: Sequence[Row]) -> Figure:
    """Draw how often intervals hold the truth against how often they should, by quantity: each movie and the mean."""
    figure = new(figsize=(9.6, 2.9), layout="constrained")
    wanted = 100 * np.array(LEVELS)
    panels = figure.subplots(1, len(QUANTITIES), sharex=True, sharey=True)
    for axes, quantity, color in zip(panels, QUANTITIES, _colors(), strict=False):
        held = 100 * np.array([r.held[quantity] for r in rows if quantity in r.held]).reshape(-1, len(LEVELS))
        axes.plot([40, 100], [40, 100], color="0.6", linewidth=1)
        axes.fill_between([94, 96], 90, 98, color="0.85", linewidth=0)
        axes.plot(wanted, held.T, color=color, alpha=0.2, linewidth=0.8)
        axes.plot(wanted, held.mean(axis=0), "o-", color=color, markersize=4)
        axes.set(title=quantity, xlabel="interval (%)", xlim=(45, 101), ylim=(0, 103))
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("holds the truth (%)")
    return figure


def error_by_noise(new: type[Figure], noisy: Sequence[tuple[Case, Row]], kind: str) -> Figure:
    """Draw errors against octaves, a line for each magnitude: middle and range over textures and fibre directions."""
    figure = new(figsize=(9, 3.8), layout="constrained")
    magnitudes = sorted({c.noise.perlin_ratio for c, _ in noisy})
    for axes, name, label in zip(figure.subplots(1, 2), ("mad_error_pct", "ecc_mae_pct"),
                                 ("error of the peak MAD (%)", "worst E_cc MAE / peak (%)"), strict=True):
        for ratio, color in zip(magnitudes, _colors(), strict=False):
            octaves = sorted({c.octaves for c, _ in noisy if c.noise.perlin_ratio == ratio and c.octaves is not None})
            spread = []
            for o in octaves:
                values = np.array([abs(r.scores[name]) for c, r in noisy
                                   if c.noise.perlin_ratio == ratio and c.octaves == o])
                values = values[np.isfinite(values)]
                spread.append((values.min(), np.median(values), values.max()) if len(values) else (np.nan,) * 3)
            low, middle, high = np.maximum(np.array(spread), SMALLEST_PCT).T
            axes.plot(octaves, middle, "o-", color=color, label=f"{ratio:.0%}")
            axes.fill_between(octaves, low, high, color=color, alpha=0.12, linewidth=0)
        axes.set(yscale="log", xlabel="octaves", ylabel=label)
        axes.grid(alpha=0.3)
    figure.axes[0].legend(title="magnitude", fontsize=7)
    missing = sum(not r.measured for _, r in noisy)
    figure.suptitle(f"{kind}, {len(noisy)} movies" + (f", {missing} not measured" if missing else ""), fontsize=10)
    return figure


def curves(new: type[Figure], row: Row, file: Path) -> Figure:
    """Draw a movie's mean absolute displacement and the E_cc of its four sub-domains beside the truth."""
    with np.load(file) as data:
        trace: dict[str, Any] = {name: data[name] for name in data.files}
    figure = new(figsize=(9, 5), layout="constrained")
    grid = figure.subplot_mosaic([["mad", "mad"], ["A1", "A2"], ["B1", "B2"]])
    _pair(grid["mad"], trace["mad_true_px"], trace["mad_found_px"], "MAD (px)")
    for s, name in enumerate(TILES):
        _pair(grid[name], trace["ecc_true"][:, s], trace["ecc_found"][:, s], f"E_cc {name}")
    for name in ("B1", "B2"):
        grid[name].set_xlabel("frame")
    grid["mad"].legend(fontsize=7)
    mad, ecc = row.scores["mad_error_pct"], row.scores["ecc_mae_pct"]
    figure.suptitle(f"{row.case}: peak MAD {mad:+.1f} %, E_cc {ecc:.1f} %", fontsize=10)
    return figure


def _pair(axes: Any, true: np.ndarray, found: np.ndarray, label: str) -> None:
    axes.plot(true, color=TRUE, label="truth")
    axes.plot(found, color=FOUND, linestyle="--", label="measured")
    axes.set_ylabel(label, fontsize=8)
    axes.grid(alpha=0.3)


def _colors() -> list[str]:
    return [f"tab:{c}" for c in ("blue", "orange", "green", "red", "purple", "brown", "pink", "gray")]
