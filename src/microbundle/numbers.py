"""Every number of a result, in px and frames, as arrays over beats, sub-domains and pillars.

Each function takes a result and gives named arrays, so that the same function of the result's alternatives gives their
standard errors (see `uncertainty`). Names are those of the dictionary of metrics; `metrics` puts units to them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .analysis import Analysis
from .contraction import mean_absolute
from .data import Beats, Floats, Ints, Strain, known
from .dictionary import PREFIX, Level
from .geometry import to_tissue
from .propagation import delays, front
from .waveform import beat_shapes, vertex

SHUFFLES = 200
SEED = 20240
"""Of the shuffles that give the values by chance alone, so that a result can be repeated."""
END_SHARE = 0.1
"""Share of the markers on each side that is an end of the tissue."""


def seconds_per_frame(analysis: Analysis) -> float | None:
    """Median time between frames, or None where the times are unknown."""
    return None if analysis.time_s is None else float(np.median(np.diff(analysis.time_s)))


def clock(analysis: Analysis) -> Floats:
    """Time of each frame (T,) in units of the median frame, so that gaps between frames count."""
    step = seconds_per_frame(analysis)
    if analysis.time_s is None or step is None:
        return np.arange(analysis.frame_count, dtype=float)
    return np.asarray((analysis.time_s - analysis.time_s[0]) / step)


def beat_signal(analysis: Analysis) -> Floats:
    """Mean absolute displacement (T,) in px of each frame from the relaxed state of the beat nearest to it, which moves
    on with the drift from beat to beat; NaN in a frame in which no marker was followed."""
    beats, tracks = analysis.beats, analysis.tracks
    if len(beats) == 0:
        return beats.signal_px
    out = np.empty(analysis.frame_count)
    kept, t = tracks.kept, np.arange(analysis.frame_count)
    rest = beats.beat_relaxed_px[:, kept]
    whole = np.flatnonzero(beats.complete)  # a beat that is cut off has its rest at another time
    drift = np.gradient(rest[whole], beats.peak[whole], axis=0) if len(whole) > 1 else np.zeros((1, *rest.shape[1:]))
    for b in range(len(beats)):
        frames = beats.nearest_beat == b
        near = int(np.argmin(np.abs(whole - b))) if len(whole) > 1 else 0
        at_rest = rest[b] + (t[frames] - beats.peak[b])[:, None, None] * drift[near]
        out[frames] = mean_absolute(tracks.position_px[frames][:, kept] - at_rest.astype(np.float32))
    return out


def end_distance(analysis: Analysis) -> tuple[Floats, float]:
    """Distance (T,) in px between the two ends of the tracked tissue along its axis, and that distance at rest.

    An end is the mean place of the outermost tenth of the markers; NaN in a frame in which an end was not followed.
    """
    rest, direction = analysis.beats.relaxed_px, analysis.masks.axis.direction
    usable = np.flatnonzero(analysis.tracks.kept & known(rest))
    if len(usable) < 2:
        return np.full(analysis.frame_count, np.nan), np.nan
    order = usable[np.argsort(rest[usable] @ direction)]
    size = max(1, int(END_SHARE * len(order)))
    first, last = order[:size], order[-size:]
    moved = (analysis.tracks.position_px - rest) @ direction

    def end(members: Ints) -> Floats:
        seen = np.isfinite(moved[:, members])
        total = np.where(seen, moved[:, members], 0).sum(axis=1, dtype=float)
        return np.asarray(np.divide(total, seen.sum(axis=1), out=np.full(len(moved), np.nan), where=seen.any(axis=1)))

    at_rest = float((rest[last] @ direction).mean() - (rest[first] @ direction).mean())
    return at_rest + end(last) - end(first), at_rest


def shortening(analysis: Analysis) -> Floats:
    """Fractional shortening (T,): decrease of the distance between the tissue's ends over that at rest."""
    distance, at_rest = end_distance(analysis)
    return np.asarray(1 - distance / at_rest)


Shape = dict[str, Floats]
"""What `waveform.beat_shapes` measures of the signals of a level, under the names of the dictionary: (B, n)."""


def shapes_of(analysis: Analysis, signals: Mapping[Level, Floats]) -> dict[Level, Shape]:
    """Measure the beats of the signals (T, n) of some levels; all at once, which takes little more time than one."""
    params, step = analysis.config.metrics, seconds_per_frame(analysis)
    window = 1.0 if step is None else params.velocity_s / step
    found = beat_shapes(np.concatenate(list(signals.values()), axis=1), clock(analysis), analysis.beats,
                        levels=params.levels_pct, velocity_window=window)
    ends = np.cumsum([signal.shape[1] for signal in signals.values()])
    parts = {level: slice(end - signal.shape[1], end)
             for end, (level, signal) in zip(ends, signals.items(), strict=True)}
    return {level: {PREFIX.get(level, "") + name: values[:, part] for name, values in found.items()}
            for level, part in parts.items()}


def beat_values(analysis: Analysis, measured: Shape, *, nulls: bool = True) -> dict[str, Floats]:
    """Compute the metrics of each beat from the shape of `beat_signal`: name -> (B,). Without `nulls` those that chance
    alone would give are left out."""
    shape = {name: values[:, 0] for name, values in measured.items()}
    period = periods(shape["peak_time"])
    drift = analysis.beats.drift_px
    out = {"beat_period": period, "beat_rate": 1 / period, **shape, "duty": shape["cd50"] / period
           if "cd50" in shape else np.full(len(period), np.nan), "beat_drift": np.hypot(drift[:, 0], drift[:, 1])}
    return out | strain_values(analysis, period, nulls=nulls)


def periods(peak_time: Floats) -> Floats:
    """Time from each peak (B,) to the next; NaN for the last and where one is unknown."""
    return np.append(np.diff(peak_time), np.nan) if len(peak_time) else np.zeros(0)


def shortening_values(measured: Shape) -> dict[str, Floats]:
    """Compute the metrics of each beat from the shape of `shortening`: name -> (B,)."""
    out = {name: values[:, 0] for name, values in measured.items()}
    return out | duty(out, "shortening")


def duty(shape: dict[str, Floats], level: Level) -> dict[str, Floats]:
    """The share of the period that a beat lasts at half its height, by the signal's own period; periods run along the
    first axis."""
    prefix = PREFIX[level]
    peak = shape[f"{prefix}peak_time"]
    if f"{prefix}cd50" not in shape or len(peak) == 0:
        return {}
    period = np.concatenate([np.diff(peak, axis=0), np.full((1, *peak.shape[1:]), np.nan)])
    return {f"{prefix}duty": shape[f"{prefix}cd50"] / period}


BEAT_STRAIN = ("e_cc_peak", "e_cc_min", "e_cc_max", "e_cc_heterogeneity", "extending_fraction", "synchrony_sd",
               "synchrony_sd_of_period", "synchrony_sd_null", "synchrony_correlation", "synchrony_correlation_null")


def strain_values(analysis: Analysis, period: Floats, *, nulls: bool = True) -> dict[str, Floats]:
    """Compute the tissue's strain metrics of each beat from E_cc of all sub-domains: name -> (B,)."""
    strain, beats = analysis.strain, analysis.beats
    if strain is None:
        return {}
    names = tuple(name for name in BEAT_STRAIN if nulls or not name.endswith("_null"))
    out = np.full((len(names), len(beats)), np.nan)
    for b, (start, stop) in enumerate(zip(beats.start, beats.stop, strict=True)):
        if beats.complete[b]:
            out[:, b] = _beat_strain(strain, int(start), int(stop), clock(analysis), period[b], nulls=nulls)
    return dict(zip(names, out, strict=True))


def _beat_strain(strain: Strain, start: int, stop: int, times: Floats, period: float, *, nulls: bool) -> list[float]:
    E_cc = strain.E[start:stop, :, 1, 1]
    seen = np.isfinite(E_cc).any(axis=1)  # a frame in which all markers are lost costs no sub-domain
    E_cc, times = E_cc[seen], times[start:stop][seen]
    E_cc = E_cc[:, np.isfinite(E_cc).all(axis=0)]
    if E_cc.size == 0:
        return [np.nan] * (len(BEAT_STRAIN) - (0 if nulls else 2))
    mean = E_cc.mean(axis=1)
    top = int(np.argmin(mean))
    return [float(mean[top]), float(E_cc.min()), float(E_cc.max()), float(E_cc[top].std()),
            float((E_cc[top] > 0).mean()), *synchrony(np.abs(E_cc), times, period, nulls=nulls)]


def synchrony(traces: Floats, times: Floats, period: float, *, nulls: bool = True) -> list[float]:
    """Compare the timing of traces (F, S): SD of their peak times, the same over the period, its value for shuffled
    traces, mean correlation with their mean, and its value for shuffled traces. NaN for fewer than two traces.
    Without `nulls` the values for shuffled traces are left out."""
    frames, count = traces.shape
    if count < 2 or frames < 3:
        return [np.nan] * (5 if nulls else 3)
    sd, correlation = float(_peak_time_sd(traces, times)), float(_correlation(traces))
    if not nulls:
        return [sd, sd / period, correlation]
    rolls = np.random.default_rng(SEED).integers(0, frames, (SHUFFLES, 1, count))
    shuffled = traces[(np.arange(frames)[:, None] - rolls) % frames, np.arange(count)]
    return [sd, sd / period, float(_peak_time_sd(shuffled, times).mean()), correlation,
            float(_correlation(shuffled).mean())]


def _peak_time_sd(traces: Floats, times: Floats) -> Floats:
    """Standard deviation of peak times over traces (..., F, S), peaks placed between frames by a parabola."""
    top = np.argmax(traces, axis=-2)
    middle = np.clip(top, 1, traces.shape[-2] - 2)
    left, here, right = (np.take_along_axis(traces, (middle + side)[..., None, :], axis=-2)[..., 0, :]
                         for side in (-1, 0, 1))
    place = np.where(middle == top, middle + np.clip(vertex(left, here, right), -1, 1), top)
    return np.asarray(np.interp(place, np.arange(len(times)), times).std(axis=-1, ddof=1))


def _correlation(traces: Floats) -> Floats:
    """Mean correlation of traces (..., F, S) with the mean of all."""
    centred = traces - traces.mean(axis=-2, keepdims=True)
    mean = centred.mean(axis=-1, keepdims=True)
    size = np.sqrt((centred**2).sum(axis=-2) * (mean**2).sum(axis=-2))
    return np.asarray(np.divide((centred * mean).sum(axis=-2), size, out=np.zeros(size.shape),
                                where=size > 0).mean(axis=-1))


def subdomain_signal(analysis: Analysis) -> Floats:
    """E_cc (T, S) of each sub-domain, positive where it is as in most beats: one contracts, another is stretched."""
    if analysis.strain is None:
        return np.zeros((analysis.frame_count, 0))
    return np.asarray(_sign(_extreme(analysis.strain, analysis.beats)) * analysis.strain.E[..., 1, 1])


def _extreme(strain: Strain, beats: Beats) -> Floats:
    """E_cc (B, S) of each sub-domain where it is largest, of either sign, in each beat."""
    E_cc = strain.E[..., 1, 1]
    extreme = np.full((len(beats), len(strain.label)), np.nan)
    for b, (start, stop) in enumerate(zip(beats.start, beats.stop, strict=True)):
        size = np.abs(E_cc[start:stop])
        at = start + np.argmax(np.where(np.isfinite(size), size, -1.0), axis=0)
        extreme[b] = np.where(np.isfinite(size).any(axis=0), E_cc[at, np.arange(len(at))], np.nan)
    return extreme


def _sign(extreme: Floats) -> Floats:
    return np.where(np.nan_to_num(extreme).sum(axis=0) > 0, 1.0, -1.0)


def subdomain_values(analysis: Analysis, measured: Shape) -> dict[str, Floats]:
    """Compute the metrics of each sub-domain in each beat from the shape of `subdomain_signal`: name -> (B, S)."""
    strain, peak = analysis.strain, analysis.beats.peak
    if strain is None:
        return {}
    F, E, J = strain.F[peak], strain.E[peak], strain.J[peak]
    principal, angle = (a[peak] for a in strain.principal)
    extreme = _extreme(strain, analysis.beats)
    sign = _sign(extreme)
    shape = measured | duty(measured, "subdomain")
    for name in ("amplitude", "contraction_velocity", "relaxation_velocity", "mean_contraction_velocity", "area"):
        shape[f"E_cc_{name}"] = shape[f"E_cc_{name}"] * sign
    parts = {"rr": (0, 0), "rc": (0, 1), "cr": (1, 0), "cc": (1, 1)}
    out = {
        "E_cc_extreme": extreme, **shape, "delay": delays(shape["E_cc_half_rise_time"], extreme),
        **{f"F_{name}": F[..., i, j] for name, (i, j) in parts.items()},
        **{f"E_{name}": E[..., i, j] for name, (i, j) in parts.items() if name != "cr"},
        "E_1": principal[..., 0], "E_2": principal[..., 1], "E_1_angle": angle, "areal_strain": J - 1,
        "shear_max": 0.5 * (principal[..., 1] - principal[..., 0]),
    }
    if analysis.config.metrics.fibre_deg is not None:
        fibre = np.deg2rad(analysis.config.metrics.fibre_deg)
        n = np.array([np.sin(fibre), np.cos(fibre)])
        out["E_fibre"] = np.einsum("i,bsij,j->bs", n, E, n)
    return out


def front_values(analysis: Analysis, delay: Floats) -> dict[str, Floats]:
    """Compute how the contraction travels over the sub-domains from their delays (B, S), of the whole beats."""
    if analysis.strain is None:
        return {}
    step = seconds_per_frame(analysis)
    axis = analysis.masks.axis
    center = to_tissue(analysis.strain.corner_px.mean(axis=1), axis.center_px, axis.direction)
    return front(delay[analysis.beats.complete], center, None if step is None else 1 / step)


def rhythm_values(analysis: Analysis, beats: dict[str, Floats], *, nulls: bool = True) -> dict[str, Floats]:
    """Compute how regular the whole beats are: name -> scalar. Missed and extra beats need the pacing rate and known
    frame times."""
    whole = analysis.beats.complete
    period, amplitude = beats["beat_period"], beats["amplitude"]
    both = whole & np.append(whole[1:], False) if len(whole) else whole
    period = period[both & np.isfinite(period)]
    amplitude = amplitude[whole & np.isfinite(amplitude)]
    sd = float(period.std(ddof=1)) if len(period) > 1 else np.nan
    out = {"period_sd": sd, "period_cv": sd / float(period.mean()) if len(period) > 1 else np.nan,
           "period_rmssd": float(np.sqrt(np.mean(np.diff(period) ** 2))) if len(period) > 1 else np.nan,
           "alternans": alternans(amplitude)}
    if nulls:
        rng = np.random.default_rng(SEED)
        out["alternans_null"] = (float(np.mean([alternans(rng.permutation(amplitude)) for _ in range(SHUFFLES)]))
                                 if len(amplitude) > 3 else np.nan)
    rate, step = analysis.config.metrics.pacing_hz, seconds_per_frame(analysis)
    if rate is not None and step is not None:
        pulses = period * step * rate
        answered = np.rint(pulses)
        out["missed_beats"] = float(np.maximum(answered - 1, 0).sum()) if len(pulses) else np.nan
        out["extra_beats"] = float((answered < 1).sum()) if len(pulses) else np.nan
    return {name: np.array(value) for name, value in out.items()}


def alternans(amplitude: Floats) -> float:
    """Mean of each amplitude less that of its two neighbours, with alternating sign, over the mean; NaN for fewer than
    four beats."""
    if len(amplitude) < 4:
        return np.nan
    against = amplitude[1:-1] - 0.5 * (amplitude[:-2] + amplitude[2:])
    return float(abs(np.mean(against * (-1.0) ** np.arange(len(against)))) / np.mean(amplitude))


def drift_px(analysis: Analysis) -> float:
    """Movement of the relaxed tissue from the first beat to the last."""
    drift = analysis.beats.drift_px
    return float(np.hypot(*(drift[-1] - drift[0]))) if len(drift) else np.nan


def baseline_drift(analysis: Analysis) -> float:
    """Speed of the relaxed tissue's movement in px a frame; NaN for fewer than two beats."""
    times = clock(analysis)[analysis.beats.peak]
    return drift_px(analysis) / float(times[-1] - times[0]) if len(times) > 1 else np.nan

