"""How often intervals hold the truth: the test of standard errors.

An interval of 95 % should hold the truth in 95 of 100 cases. Counted are, in one movie: both components of the
displacement at all points of the domain and frames of the beats, E_cc of all sub-domains of the analysis and frames of
the beats, the amplitude of each beat and the period between beats.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from ..analysis import Analysis
from ..data import Floats
from ..draws import COUNT
from ..levels import level_values
from ..metrics import tables
from ..uncertainty import displacement_error_at, standard_errors
from .render import SyntheticMovie
from .scores import Comparison, analysis_rest, true_displacement, true_rest

LEVELS = (0.5, 0.68, 0.8, 0.9, 0.95, 0.99)
QUANTITIES = ("displacement", "E_cc", "amplitude", "period")


def coverage(synthetic: SyntheticMovie, analysis: Analysis, c: Comparison) -> dict[str, list[float]]:
    """Compute, for each quantity, the share of intervals that hold the truth, for each of `LEVELS`.

    A quantity without any interval is left out; so is all of a method that does not know its errors.
    """
    if not len(c.pairs) or analysis.tracks.field is None or analysis.tracks.field.draws is None:
        return {}
    frames = np.concatenate(c.windows)
    domain = displacement_error_at(analysis, c.domain.points_px.reshape(-1, 2))
    ratios = {"displacement": c.beat_error_px[frames] / domain[frames]}
    if analysis.strain is not None:
        error = standard_errors(analysis, lambda a: {"E_cc": _strain(a)})["E_cc"]
        ratios["E_cc"] = (c.own_ecc[1] - c.own_ecc[0])[frames] / error[frames]
    ratios |= _of_beats(synthetic, analysis, c)
    limits = stdtrit(COUNT, 0.5 + 0.5 * np.array(LEVELS))
    out = {}
    for name, ratio in ratios.items():
        size = np.abs(ratio[np.isfinite(ratio)])
        if len(size):
            out[name] = [float((size < limit).mean()) for limit in limits]
    return out


def _strain(analysis: Analysis) -> Floats:
    return np.zeros(0) if analysis.strain is None else analysis.strain.E[..., 1, 1]


def _of_beats(synthetic: SyntheticMovie, analysis: Analysis, c: Comparison) -> dict[str, Floats]:
    """Errors of amplitude and period over their standard errors, for the matched beats."""
    true = _perfect(synthetic, analysis, c)
    values = level_values(true, nulls=False)["beat"]
    found = tables(replace(analysis, um_per_px=None, time_s=None))["beats"]
    out = {}
    for name, key, unit in (("amplitude", "amplitude", "px"), ("period", "beat_period", "frames")):
        error = [(found[f"{key}_{unit}"][a] - values[key][a]) / found[f"{key}_se_{unit}"][a] for _, a in c.pairs]
        out[name] = np.array(error, float)
    return out


def _perfect(synthetic: SyntheticMovie, analysis: Analysis, c: Comparison) -> Analysis:
    """The analysis with its markers where they truly are, and with the beats' true rests."""
    seen, beats = analysis.beats.relaxed_px, analysis.beats
    X = np.nan_to_num(seen) - analysis_rest(synthetic.truth, analysis, np.nan_to_num(seen))
    position = X + true_displacement(synthetic.truth, X)
    rest = beats.beat_relaxed_px.copy()
    for b, a in c.pairs:
        rest[a] = true_rest(position, c.beats, analysis, b, a)
    return replace(analysis, tracks=replace(analysis.tracks, position_px=position),
                   beats=replace(beats, beat_relaxed_px=rest))
