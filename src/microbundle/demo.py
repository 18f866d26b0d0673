"""The demonstration: a rendered tissue with known motion, analyzed like any movie, beside the truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from .analysis import Analysis
from .config import Config
from .events import Tell, ignore
from .geometry import rotation
from .metrics import tables
from .pipeline import analyze
from .strain import fit_gradient
from .synth.render import SyntheticMovie, beating_tissue

SHAPE = (256, 256)
FRAMES = 75


@dataclass(frozen=True)
class Row:
    """One quantity, as it is and as it was measured."""

    metric: str
    truth: float
    measured: float

    @property
    def error(self) -> float:
        return self.measured / self.truth - 1


@dataclass(frozen=True)
class Demo:
    """What the demonstration found."""

    analysis: Analysis
    compared: tuple[Row, ...]
    rmse_px: float
    """Root mean square error of the displacement over tissue points and frames."""

    def rows(self) -> list[tuple[str, ...]]:
        """Rows of the table that is printed."""
        out = [(r.metric, f"{r.truth:.4g}", f"{r.measured:.4g}", f"{100 * r.error:+.1f} %") for r in self.compared]
        return [*out, ("displacement error (px, RMS)", "0", f"{self.rmse_px:.3f}", "")]

    def as_dict(self) -> dict[str, object]:
        """The same for programs."""
        return {"verdict": self.analysis.verdict, "rmse_px": self.rmse_px,
                "metrics": [asdict(r) | {"error": r.error} for r in self.compared]}


def run_demo(tell: Tell = ignore, seed: int = 0) -> Demo:
    """Render a small beating tissue, analyze it with default settings, and compare with its exact motion."""
    synthetic = beating_tissue(SHAPE, FRAMES, seed=seed)
    analysis = analyze(synthetic.drawn().movie, Config(), tell=tell)
    return compare(synthetic, analysis)


def compare(synthetic: SyntheticMovie, analysis: Analysis) -> Demo:
    """Set a result beside the truth of the movie it was made from."""
    truth = synthetic.truth
    points = truth.points_px()
    points = points[analysis.inside(points)]
    exact = np.stack([truth.displacement_px(points, t) for t in range(analysis.frame_count)])
    found = analysis.displacement_at(points)
    mad_exact, mad_found = (np.hypot(u[..., 0], u[..., 1]).mean(axis=1) for u in (exact, found))
    beats = tables(analysis)["beats"]
    peaks = [int(a + np.argmax(mad_exact[a:b])) for a, b in zip(analysis.beats.start, analysis.beats.stop, strict=True)]
    rows = [Row("mean displacement at the peaks (um)", float(mad_exact[peaks].mean()) * truth.um_per_px,
                float(mad_found[peaks].mean()) * truth.um_per_px)]
    if truth.rhythm is not None and len(beats) > 1:
        period = float(np.diff(truth.rhythm.peak_frames).mean()) / truth.fps
        rows.append(Row("beat period (s)", period, float(beats["beat_period_s"].mean())))
    rows += _strain_rows(synthetic, analysis, peaks)
    return Demo(analysis, tuple(rows), float(np.sqrt(np.nanmean((found - exact) ** 2))))


def _strain_rows(synthetic: SyntheticMovie, analysis: Analysis, peaks: list[int]) -> list[Row]:
    """Mean E_cc over the sub-domains at the peaks, the truth by the same fit to exact displacements."""
    strain = analysis.strain
    if strain is None or not peaks:
        return []
    turn = rotation(analysis.masks.axis.direction)
    share = np.linspace(0.02, 0.98, 14)
    exact = []
    for first, along, _, across in strain.corner_px:
        points = first + (along - first) * share[:, None, None] + (across - first) * share[None, :, None]
        points = points.reshape(-1, 2)
        moved = np.stack([points + synthetic.truth.displacement_px(points, t) for t in peaks])
        F, _ = fit_gradient(points @ turn.T, moved @ turn.T)
        exact.append(0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(2))[:, 1, 1])
    found = strain.E[peaks][..., 1, 1].T
    seen = np.isfinite(found)
    return [Row("mean E_cc at the peaks", float(np.array(exact)[seen].mean()), float(found[seen].mean()))]
