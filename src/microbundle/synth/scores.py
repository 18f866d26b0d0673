"""How far a measurement is from the truth: the paper's four errors, and more.

    comparison = compare(synthetic, analysis, domain)
    scores = score(comparison)

Both sides are sampled on one dense grid: a material point X of the true relaxed state is looked up where the
analysis's relaxed image shows it. The analysis counts displacement from its own relaxed state of each beat, the truth
from the same frames, less those in which the tissue does not really rest: so a wrong relaxed state is an error like
any other, while the choice of frames on a drifting stage is none. E_cc comes, on both sides, from
one least-squares F over the grid of a sub-domain; it is also scored in the tool's own sub-domains, as they are in its
tables. Only true beats with rest on both sides are scored; "worst" is over beats, or over beats and sub-domains.

Source of the definitions: paper, S1 Appendix, "Validation against synthetic data".
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from ..analysis import Analysis
from ..contraction import rest_weights
from ..data import Floats, Ints, known
from ..geometry import rotation
from ..strain import fit_gradient
from ..waveform import vertex
from .render import SyntheticMovie, Truth
from .scenes import Domain
from .truth import TrueBeats, true_beats

MIN_COVERED = 0.5
"""A sub-domain of which less was measured has no strain."""
REST_SAMPLE = 24
"""Relaxed frames that are looked at to tell where a point lies in the relaxed image."""


@dataclass(frozen=True)
class Scores:
    """Errors of one movie; NaN is "could not be compared". Percentages are of the truth."""

    true_mad_px: float = np.nan
    """Largest mean absolute displacement in the domain over the whole beats: what the case is about."""
    true_ecc: float = np.nan
    """Largest |E_cc| of a sub-domain over the whole beats."""
    mad_error_pct: float = np.nan
    """Error of the peak of the mean absolute displacement, of the beat in which it is worst; + is too much."""
    mad_r2: float = np.nan
    """Coefficient of determination of the mean absolute displacement within a beat; the worst."""
    ecc_mae_pct: float = np.nan
    """Mean absolute error of E_cc over a beat as a share of the sub-domain's largest |E_cc| there; the worst."""
    ecc_r2: float = np.nan
    """Coefficient of determination of E_cc within a beat and sub-domain; the worst."""
    own_ecc_mae_pct: float = np.nan
    """The same as ecc_mae_pct in the sub-domains that the analysis chose."""
    own_ecc_r2: float = np.nan
    rmse_px: float = np.nan
    """Root mean square length of the displacement's error, over points and frames of the beats (of the movie where
    there are none)."""
    gain_pct: float = np.nan
    """Slope of measured against true displacement over all points and frames, less 100 %."""
    drift_error_px: float = np.nan
    """How far the error of the displacement moves from the first rest to the last, mean over points."""
    lost_pct: float = np.nan
    """Share of marker positions that were lost."""
    covered_pct: float = np.nan
    """Share of the domain's points at which there is a measurement."""
    period_error_pct: float = np.nan
    """Error of the mean time between matched neighbouring beats."""
    peak_error_frames: float = np.nan
    """Largest error of a beat's peak time."""
    true_beats: float = np.nan
    """Beats with rest on both sides."""
    missed_beats: float = np.nan
    extra_beats: float = np.nan
    """Whole beats in the analysis that are none."""

    def as_dict(self) -> dict[str, float]:
        """All scores by name."""
        return {f.name: float(getattr(self, f.name)) for f in fields(self)}


@dataclass(frozen=True)
class Comparison:
    """Measured beside true, in every frame; P points of the domain in 4 sub-domains, M matched beats."""

    domain: Domain
    beats: TrueBeats
    pairs: Ints
    """(M, 2): true beat and the analysis's beat for it."""
    windows: tuple[Ints, ...]
    """Frames of each matched beat, from true rest to true rest."""
    true_px: Floats
    """(T, P, 2): displacement from the true relaxed state of the movie."""
    found_px: Floats
    """(T, P, 2): displacement from the analysis's relaxed state of the movie."""
    mad: tuple[Floats, Floats]
    """True and measured (T,) from each beat's own rest; NaN outside matched beats."""
    ecc: tuple[Floats, Floats]
    """True and measured (T, 4)."""
    own_ecc: tuple[Floats, Floats]
    """True and measured (T, S) in the analysis's sub-domains."""
    beat_error_px: Floats
    """(T, P, 2): error of the displacement from each beat's rest; NaN outside matched beats."""
    peak_error_frames: Floats
    """(M,)"""
    period: tuple[float, float]
    """True and measured mean time between neighbouring matched beats, in frames; NaN for none."""
    extra: int
    lost: float


def compare(synthetic: SyntheticMovie, analysis: Analysis, domain: Domain) -> Comparison:
    """Sample truth and measurement at the same material points, and match their beats."""
    truth = synthetic.truth
    count = truth.motion.count
    if analysis.frame_count != count:
        raise ValueError(f"analysis: expected the {count} frames of the movie, found {analysis.frame_count}")
    X = domain.points_px.reshape(-1, 2)
    u = true_displacement(truth, X)
    beats = true_beats(truth)
    pairs, extra = match(beats, analysis)
    windows = tuple(np.arange(beats.start[b], beats.stop[b]) for b, _ in pairs)

    seen = X + analysis_rest(truth, analysis, X)
    found = np.asarray(analysis.displacement_at(seen), float)
    drift = found - np.asarray(analysis.displacement_at(seen, relative_to="beat"), float)
    owner = analysis.beats.nearest_beat

    shape = (count, len(domain.points_px))
    mad = np.full(count, np.nan), np.full(count, np.nan)
    ecc = np.full(shape, np.nan), np.full(shape, np.nan)
    error = np.full(u.shape, np.nan)
    turn = rotation(domain.direction)
    for (b, a), window in zip(pairs, windows, strict=True):
        rest = true_rest(u, beats, analysis, b, a)
        found_rest = drift[np.argmax(owner == a)]
        moved, measured = u[window] - rest, found[window] - found_rest
        error[window] = measured - moved
        both = known(measured)
        mad[0][window] = _mean_length(moved, both)
        mad[1][window] = _mean_length(measured, both)
        for s, tile in enumerate(np.split(np.arange(len(X)), shape[1])):
            ok = both[:, tile].all(axis=0)
            if ok.mean() < MIN_COVERED:
                continue
            tile = tile[ok]
            ecc[0][window, s] = _ecc(X[tile] + rest[tile], moved[:, tile], turn)
            ecc[1][window, s] = _ecc(seen[tile] + found_rest[tile], measured[:, tile], turn)

    true_peaks = _peaks(beats.deformation_px, beats.peak)
    found_peaks = _peaks(analysis.beats.signal_px, analysis.beats.peak)
    return Comparison(
        domain=domain, beats=beats, pairs=pairs, windows=windows, true_px=u - u[beats.resting].mean(axis=0),
        found_px=found, mad=mad, ecc=ecc, own_ecc=_own_ecc(truth, analysis, beats, pairs, windows),
        beat_error_px=error, peak_error_frames=found_peaks[pairs[:, 1]] - true_peaks[pairs[:, 0]],
        period=_periods(true_peaks, found_peaks, pairs), extra=extra, lost=analysis.tracks.lost_fraction)


def score(c: Comparison) -> Scores:
    """Reduce a comparison to numbers; a movie without matched beats has those that need none."""
    values: dict[str, Any] = {"true_beats": int(c.beats.complete.sum()), "extra_beats": c.extra,
                              "missed_beats": int(c.beats.complete.sum()) - len(c.pairs), "lost_pct": 100 * c.lost}
    for part in (_of_points, _of_beats, _of_strain):
        values |= part(c)
    return Scores(**values)


def _of_points(c: Comparison) -> dict[str, float]:
    ok = known(c.found_px)
    error = c.beat_error_px if len(c.pairs) else c.found_px - c.true_px
    values = {"covered_pct": 100 * float(ok.mean()),
              "rmse_px": float(np.sqrt(np.nanmean((error**2).sum(axis=-1)))) if known(error).any() else np.nan}
    if not ok.any() or c.beats.deformation_px.max() == 0:
        return values
    always = ok.all(axis=0)
    true, found = c.true_px[:, always], c.found_px[:, always]
    if not always.any():
        return values
    true, offset = true - true.mean(axis=0), found - found.mean(axis=0)
    values["gain_pct"] = 100 * float((true * offset).sum() / (true**2).sum() - 1)
    wrong = found - c.true_px[:, always]
    runs = np.split(np.flatnonzero(c.beats.resting), 1 + np.flatnonzero(np.diff(np.flatnonzero(c.beats.resting)) > 1))
    if len(runs) > 1:
        moved = wrong[runs[-1]].mean(axis=0) - wrong[runs[0]].mean(axis=0)
        values["drift_error_px"] = float(np.hypot(*moved.T).mean())
    return values


def _of_beats(c: Comparison) -> dict[str, float]:
    whole = [c.true_px[c.beats.start[b]:c.beats.stop[b]] - c.true_px[c.beats.rest_frames(int(b))].mean(axis=0)
             for b in np.flatnonzero(c.beats.complete)]
    values = {"true_mad_px": max((float(_mean_length(u).max()) for u in whole), default=0.0)}
    if not len(c.pairs):
        return values
    peak, r2 = [], []
    for window in c.windows:
        true, found = c.mad[0][window], c.mad[1][window]
        if len(window) > 2 and np.isfinite(found).all():
            peak.append(100 * (found.max() / true.max() - 1))
            r2.append(r_squared(true, found))
    if peak:
        values |= {"mad_error_pct": max(peak, key=abs), "mad_r2": min(r2)}
    true_period, found_period = c.period
    return values | {"peak_error_frames": float(np.abs(c.peak_error_frames).max()),
                     "period_error_pct": 100 * (found_period / true_period - 1)}


def _of_strain(c: Comparison) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, (true, found) in (("ecc", c.ecc), ("own_ecc", c.own_ecc)):
        share, r2 = [], []
        for window in c.windows:
            for t, f in zip(true[window].T, found[window].T, strict=True):
                both = np.isfinite(t) & np.isfinite(f)
                if both.sum() > 2:
                    share.append(100 * np.abs(f - t)[both].mean() / np.nanmax(np.abs(t)))
                    r2.append(r_squared(t[both], f[both]))
        if share:
            values |= {f"{name}_mae_pct": float(max(share)), f"{name}_r2": float(min(r2))}
    if np.isfinite(c.ecc[0]).any():
        values["true_ecc"] = float(np.nanmax(np.abs(c.ecc[0])))
    return values


def r_squared(true: Floats, found: Floats) -> float:
    """Coefficient of determination of a measured series about the true one; negative where it is worse than a mean."""
    spread = float(((true - true.mean()) ** 2).sum())
    return float(1 - ((found - true) ** 2).sum() / spread) if spread > 0 else np.nan


def match(beats: TrueBeats, analysis: Analysis) -> tuple[Ints, int]:
    """Pair each whole true beat with the analysis's beat that peaks in its window: (M, 2), and the number of the
    analysis's whole beats that are left over."""
    found = analysis.beats
    pairs, used = [], set()
    for b in range(len(beats)):
        inside = [int(a) for a in np.flatnonzero((found.peak >= beats.start[b]) & (found.peak < beats.stop[b]))]
        if not inside:
            continue
        best = min(inside, key=lambda a, b=b: abs(int(found.peak[a]) - int(beats.peak[b])))  # type: ignore[misc]
        used.add(best)
        if beats.complete[b]:
            pairs.append((b, best))
    extra = int(sum(bool(c) for a, c in enumerate(found.complete) if a not in used))
    return np.array(pairs, int).reshape(-1, 2), extra


def true_rest(u: Floats, beats: TrueBeats, analysis: Analysis, beat: int, found: int) -> Floats:
    """Relaxed state (N, 2) from which the truth u (T, N, 2) of a beat counts, made as the analysis makes that of its
    beat `found`, but only of frames in which the tissue rests indeed; where there are none, the true rests around the
    beat."""
    if analysis.beats.method == "paper":
        first = int(analysis.beats.start[found])
        frames = np.array([first]) if beats.resting[first] else beats.rest_frames(beat)
        return np.asarray(u[frames].mean(axis=0))
    resting = analysis.beats.relaxed & beats.resting
    weights = rest_weights(resting, analysis.beats.peak)[found]
    if not weights.any():
        return np.asarray(u[beats.rest_frames(beat)].mean(axis=0))
    return np.asarray(np.tensordot(weights, u, 1))


def _peaks(signal: Floats, frames: Ints) -> Floats:
    """Place peaks (B,) between frames."""
    inside = np.clip(frames, 1, len(signal) - 2)
    away = np.clip(vertex(signal[inside - 1], signal[inside], signal[inside + 1]), -1, 1)
    return np.where(inside == frames, frames + away, frames)


def _periods(true: Floats, found: Floats, pairs: Ints) -> tuple[float, float]:
    """Mean time between neighbouring beats that were both matched, in truth and measurement."""
    steps = [(true[b1] - true[b0], found[a1] - found[a0])
             for (b0, a0), (b1, a1) in pairwise(pairs) if b1 == b0 + 1 and a1 == a0 + 1]
    if not steps:
        return np.nan, np.nan
    t, f = np.mean(steps, axis=0)
    return float(t), float(f)


def true_displacement(truth: Truth, points: Floats) -> Floats:
    """Sample the true displacement (T, P, 2) in px of points (P, 2) of the picture without motion."""
    return np.stack([truth.displacement_px(points, t) for t in range(truth.motion.count)])


def analysis_rest(truth: Truth, analysis: Analysis, points: Floats) -> Floats:
    """True displacement (N, 2) of points in the analysis's relaxed image; `paper` takes frame 0 for relaxed."""
    frames = np.flatnonzero(analysis.beats.relaxed)
    if analysis.beats.method == "paper" or not len(frames):
        frames = np.array([analysis.tracks.reference_frame])
    sample = frames[np.unique(np.linspace(0, len(frames) - 1, REST_SAMPLE).astype(int))]
    return np.asarray(np.mean([truth.displacement_px(points, int(t)) for t in sample], axis=0))


def _ecc(rest: Floats, moved: Floats, turn: Floats) -> Floats:
    """E_cc (t,) along the axes of `turn`, from F fitted to points (n, 2) and their displacements (t, n, 2)."""
    F = fit_gradient(rest @ turn.T, (rest + moved) @ turn.T)[0]
    return np.asarray(0.5 * (np.einsum("tki,tkj->tij", F, F) - np.eye(2)))[:, 1, 1]


def _own_ecc(truth: Truth, analysis: Analysis, beats: TrueBeats, pairs: Ints,
             windows: tuple[Ints, ...]) -> tuple[Floats, Floats]:
    """True and measured E_cc (T, S) in the analysis's sub-domains; the truth over a dense grid of their tissue."""
    strain = analysis.strain
    if strain is None:
        return np.zeros((analysis.frame_count, 0)), np.zeros((analysis.frame_count, 0))
    true, found = np.full(strain.F.shape[:2], np.nan), np.full(strain.F.shape[:2], np.nan)
    angle = np.deg2rad(strain.angle_deg)
    turn = rotation(np.array([np.sin(angle), np.cos(angle)]))
    share = (np.arange(13) + 0.5) / 13
    for s, corner in enumerate(strain.corner_px):
        down, right = corner[3] - corner[0], corner[1] - corner[0]
        seen = (corner[0] + share[:, None, None] * down + share[None, :, None] * right).reshape(-1, 2)
        seen = seen[analysis.inside(seen)]
        if len(seen) < 3:
            continue
        X = seen
        for _ in range(2):  # the analysis's relaxed image shows X displaced by a little
            X = seen - analysis_rest(truth, analysis, X)
        u = true_displacement(truth, X)
        for (b, a), window in zip(pairs, windows, strict=True):
            rest = true_rest(u, beats, analysis, b, a)
            true[window, s] = _ecc(X + rest, u[window] - rest, turn)
            found[window, s] = strain.E[window, s, 1, 1]
    return true, found


def _mean_length(moved: Floats, ok: Any = None) -> Floats:
    """Mean length (t,) of displacements (t, n, 2), over the points that are known."""
    length = np.hypot(moved[..., 0], moved[..., 1])
    seen = np.isfinite(length) if ok is None else ok
    total = np.where(seen, length, 0.0).sum(axis=1)
    return np.asarray(np.divide(total, seen.sum(axis=1), out=np.full(len(total), np.nan), where=seen.any(axis=1)))
