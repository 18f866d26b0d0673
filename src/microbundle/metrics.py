"""Numbers in physical units: the one place where pixels become micrometres, and frames seconds.

Every number is a function of a result; where the method knows its errors, the same function of its alternatives gives
the standard error (see `uncertainty`). `tables` writes nothing that is not in the dictionary of metrics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .analysis import Analysis
from .contraction import mean_absolute
from .data import Floats, Strain
from .dictionary import IDENTITY, METRICS, Kind, column
from .draws import COUNT as DRAWS
from .uncertainty import added_by_noise, standard_errors

if TYPE_CHECKING:
    import pandas as pd

SHUFFLES = 200
SEED = 20240
"""Of the shuffles that give the null values of synchrony, so that a result can be repeated."""


def tables(analysis: Analysis) -> dict[str, pd.DataFrame]:
    """Compute all metrics of a result, as tables with the unit in each column's name.

    `summary` has a row for each metric of the movie (n, mean, standard error, sd, cv, median, 95 % interval of the mean
    over whole beats); `beats` a row for each beat, `subdomains` for each sub-domain and beat, `frames` for each frame,
    `strain` for each sub-domain and frame. Lengths are given in px, and in um too where the pixel size is known; times
    in frames, or in seconds where the frame times are known. Standard errors (`_se`) are those of the measurement, for
    results of the method `accurate`.
    """
    import pandas as pd

    errors = standard_errors(analysis, _numbers)
    added = added_by_noise(analysis, lambda a: np.stack([beat_signal(a), a.beats.signal_px]))
    signal = beat_signal(analysis) - added[0]
    beats = pd.DataFrame(list(_beat_rows(analysis, signal, errors)))
    return {
        "summary": _summary(analysis, beats, errors),
        "beats": beats,
        "subdomains": pd.DataFrame(list(_subdomain_rows(analysis, errors))),
        "frames": _frames(analysis, errors, added[1]),
        "strain": _strain_frames(analysis, errors),
    }


def _numbers(analysis: Analysis) -> dict[str, Floats]:
    """All numbers that have a standard error, as arrays."""
    signal = beat_signal(analysis)
    beats = beat_values(analysis, signal, nulls=False)
    each = np.array([list(values.values()) for values in beats], float).reshape(len(beats), len(_beat_names(analysis)))
    out = {"signal": signal, "mean_absolute": analysis.beats.signal_px, "drift": np.array(_drift_px(analysis)),
           "beats": each, "movie": _mean_of_known(each[analysis.beats.complete])}
    if analysis.strain is not None:
        out |= {"F": analysis.strain.F, "E": analysis.strain.E, **subdomain_values(analysis)}
    return out


def _written(analysis: Analysis, values: Mapping[str, Any], errors: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Give values in px and frames, and their standard errors, the columns and units that the calibration allows."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        for metric in (m for m in METRICS if m.key == key):
            for calibrated, factor in _units(analysis, metric.kind):
                out[column(metric, calibrated)] = value * factor
                if errors is not None and key in errors and metric.has_error:
                    out[column(metric, calibrated, error=True)] = errors[key] * factor
    return out


def _units(analysis: Analysis, kind: Kind) -> list[tuple[bool, float]]:
    """Units in which a kind of quantity is written: whether with calibration, and the factor to it."""
    um, step = analysis.um_per_px, _seconds_per_frame(analysis)
    match kind:
        case "length" | "area":
            power = 2 if kind == "area" else 1
            return [(False, 1.0)] + ([] if um is None else [(True, um**power)])
        case "time":
            return [(False, 1.0)] if step is None else [(True, step)]
        case "rate":
            return [(False, 1.0)] if step is None else [(True, 1 / step)]
        case "rate_per_min":
            return [] if step is None else [(True, 60 / step)]
        case _:
            return [(False, 1.0)]


def _seconds_per_frame(analysis: Analysis) -> float | None:
    return None if analysis.time_s is None else float(np.median(np.diff(analysis.time_s)))


def _clock(analysis: Analysis) -> Floats:
    """Time of each frame (T,) in units of the median frame, so that gaps between frames count."""
    step = _seconds_per_frame(analysis)
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


def parabola_peak(signal: Floats, frame: int) -> float:
    """Place a peak between frames, by the parabola through it and its two neighbours."""
    if not 0 < frame < len(signal) - 1:
        return float(frame)
    left, top, right = signal[frame - 1:frame + 2]
    bend = left - 2 * top + right
    return float(frame + (0.5 * (left - right) / bend if bend < 0 else 0.0))


def beat_values(analysis: Analysis, signal: Floats, *, nulls: bool = True) -> list[dict[str, float]]:
    """Compute the metrics of each beat in px and frames from the signal (T,) of `beat_signal`; without `nulls` those
    that chance alone would give are left out."""
    beats, clock = analysis.beats, _clock(analysis)
    tops = _tops(analysis, signal)
    peaks = np.interp([parabola_peak(signal, t) for t in tops], np.arange(len(clock)), clock)
    # A beat that the movie cuts off on its way has its largest value at the cut, which is not its peak.
    seen = np.array([0 < t < len(signal) - 1 for t in tops])
    periods = [peaks[b + 1] - peaks[b] if b + 1 < len(tops) and seen[b] and seen[b + 1] else np.nan
               for b in range(len(tops))]
    out = []
    for b, (start, stop, top) in enumerate(zip(beats.start, beats.stop, tops, strict=True)):
        resting = np.zeros(len(signal), bool)
        resting[start:stop] = beats.relaxed[start:stop] & np.isfinite(signal[start:stop])
        level = float(signal[resting].mean()) if resting.any() else 0.0
        values = {
            "amplitude": signal[top] - level if seen[b] else np.nan, "peak_time": peaks[b] if seen[b] else np.nan,
            "beat_period": periods[b], "beat_rate": 1 / periods[b], "beat_drift": float(np.hypot(*beats.drift_px[b])),
        }
        if analysis.strain is not None:
            values |= beat_strain(analysis.strain, int(start), int(stop), clock, periods[b], bool(beats.complete[b]),
                                  nulls=nulls)
        out.append(values)
    return out


def _tops(analysis: Analysis, signal: Floats) -> list[int]:
    """Frame of the largest signal of each beat."""
    followed = np.where(np.isfinite(signal), signal, -np.inf)
    return [int(a + np.argmax(followed[a:b])) for a, b in zip(analysis.beats.start, analysis.beats.stop, strict=True)]


def _beat_rows(analysis: Analysis, signal: Floats, errors: Mapping[str, Floats]) -> Iterator[dict[str, object]]:
    beats, names = analysis.beats, _beat_names(analysis)
    for b, (values, top) in enumerate(zip(beat_values(analysis, signal), _tops(analysis, signal), strict=True)):
        error = dict(zip(names, errors["beats"][b], strict=True)) if errors else None
        yield {"beat": b, "complete": bool(beats.complete[b]), "start_frame": int(beats.start[b]), "peak_frame": top,
               "stop_frame": int(beats.stop[b]), **_written(analysis, values, error)}


def _beat_names(analysis: Analysis) -> list[str]:
    """Keys of the metrics of a beat that have errors, in their order."""
    names = ["amplitude", "peak_time", "beat_period", "beat_rate", "beat_drift"]
    return names + [name for name in BEAT_STRAIN if analysis.strain is not None and not name.endswith("_null")]


BEAT_STRAIN = ("e_cc_peak", "e_cc_min", "e_cc_max", "e_cc_heterogeneity", "extending_fraction", "synchrony_sd",
               "synchrony_sd_of_period", "synchrony_sd_null", "synchrony_correlation", "synchrony_correlation_null")


def beat_strain(strain: Strain, start: int, stop: int, clock: Floats, period: float, complete: bool, *,
                nulls: bool = True) -> dict[str, float]:
    """Compute the tissue's strain metrics of one beat from E_cc of all sub-domains; times in frames."""
    names = tuple(name for name in BEAT_STRAIN if nulls or not name.endswith("_null"))
    E_cc = strain.E[start:stop, :, 1, 1]
    seen = np.isfinite(E_cc).any(axis=1)  # a frame in which all markers are lost costs no sub-domain
    E_cc, times = E_cc[seen], clock[start:stop][seen]
    E_cc = E_cc[:, np.isfinite(E_cc).all(axis=0)]
    if E_cc.size == 0 or not complete:
        return dict.fromkeys(names, np.nan)
    mean = E_cc.mean(axis=1)
    top = int(np.argmin(mean))
    values = [float(mean[top]), float(E_cc.min()), float(E_cc.max()), float(E_cc[top].std()),
              float((E_cc[top] > 0).mean())]
    return dict(zip(names, values + synchrony(np.abs(E_cc), times, period, nulls=nulls), strict=True))


def synchrony(traces: Floats, clock: Floats, period: float, *, nulls: bool = True) -> list[float]:
    """Compare the timing of traces (F, S): SD of their peak times, the same over the period, its value for shuffled
    traces, mean correlation with their mean, and its value for shuffled traces. NaN for fewer than two traces.
    Without `nulls` the values for shuffled traces are left out."""
    frames, count = traces.shape
    if count < 2 or frames < 3:
        return [np.nan] * (5 if nulls else 3)
    rng = np.random.default_rng(SEED)
    sd, correlation = _peak_time_sd(traces, clock), _correlation(traces)
    if not nulls:
        return [sd, sd / period, correlation]
    rolls = rng.integers(0, frames, (SHUFFLES, count))
    index = (np.arange(frames)[:, None] - rolls[:, None, :]) % frames
    shuffled = traces[index, np.arange(count)]
    return [sd, sd / period, float(np.mean([_peak_time_sd(s, clock) for s in shuffled])),
            correlation, float(np.mean([_correlation(s) for s in shuffled]))]


def _peak_time_sd(traces: Floats, clock: Floats) -> float:
    return float(clock[np.argmax(traces, axis=0)].std(ddof=1))


def _correlation(traces: Floats) -> float:
    centred = traces - traces.mean(axis=0)
    mean = centred.mean(axis=1)
    size = np.sqrt((centred**2).sum(axis=0) * (mean**2).sum())
    return float(np.mean(np.divide(centred.T @ mean, size, out=np.zeros(len(size)), where=size > 0)))


def subdomain_values(analysis: Analysis) -> dict[str, Floats]:
    """Compute the metrics of each sub-domain in each beat (B, S), times in frames."""
    strain, beats, clock = analysis.strain, analysis.beats, _clock(analysis)
    if strain is None:
        return {}
    peak = beats.peak
    F, E, J = strain.F[peak], strain.E[peak], strain.J[peak]
    principal, angle = (a[peak] for a in strain.principal)
    extreme, when = np.full((2, len(beats), len(strain.label)), np.nan)
    E_cc = strain.E[..., 1, 1]
    for b, (start, stop) in enumerate(zip(beats.start, beats.stop, strict=True)):
        size = np.abs(E_cc[start:stop])
        at = start + np.argmax(np.where(np.isfinite(size), size, -1.0), axis=0)
        seen = np.isfinite(size).any(axis=0)
        extreme[b], when[b] = np.where(seen, E_cc[at, np.arange(len(at))], np.nan), np.where(seen, clock[at], np.nan)
    parts = {"rr": (0, 0), "rc": (0, 1), "cr": (1, 0), "cc": (1, 1)}
    return {
        "E_cc_extreme": extreme, "E_cc_extreme_time": when,
        **{f"F_{name}": F[..., i, j] for name, (i, j) in parts.items()},
        **{f"E_{name}": E[..., i, j] for name, (i, j) in parts.items() if name != "cr"},
        "E_1": principal[..., 0], "E_2": principal[..., 1], "E_1_angle": angle, "areal_strain": J - 1,
        "shear_max": 0.5 * (principal[..., 1] - principal[..., 0]),
    }


def _subdomain_rows(analysis: Analysis, errors: Mapping[str, Floats]) -> Iterator[dict[str, object]]:
    strain, beats = analysis.strain, analysis.beats
    if strain is None:
        return
    values = subdomain_values(analysis)
    for b in range(len(beats)):
        for s, label in enumerate(strain.label):
            here = {"markers": int(strain.count[s])} | {key: value[b, s] for key, value in values.items()}
            error = {key: errors[key][b, s] for key in values} if errors else None
            yield {"beat": b, "subdomain": label, "complete": bool(beats.complete[b]), "reason": strain.reason[s],
                   **_written(analysis, here, error)}


def _frames(analysis: Analysis, errors: Mapping[str, Floats], added: Floats) -> pd.DataFrame:
    import pandas as pd

    beats = analysis.beats
    values, error = {"mean_absolute_displacement": beats.signal_px}, None
    if errors:
        values["mean_absolute_displacement_corrected"] = beats.signal_px - added
        error = dict.fromkeys(values, errors["mean_absolute"])
    step, clock = _seconds_per_frame(analysis), _clock(analysis)
    return pd.DataFrame({
        "frame": np.arange(analysis.frame_count), **({} if step is None else {"time_s": clock * step}),
        "beat": beats.beat_of_frame, "relaxed": beats.relaxed, **_written(analysis, values, error),
    })


def _strain_frames(analysis: Analysis, errors: Mapping[str, Floats]) -> pd.DataFrame:
    import pandas as pd

    strain = analysis.strain
    if strain is None:
        return pd.DataFrame()
    count, tiles = strain.F.shape[:2]
    columns = {"frame": np.repeat(np.arange(count), tiles), "subdomain": np.tile(np.array(strain.label), count)}
    for letter, tensor in (("F", strain.F), ("E", strain.E)):
        for name, i, j in (("rr", 0, 0), ("rc", 0, 1), ("cr", 1, 0), ("cc", 1, 1)):
            if letter == "E" and name == "cr":
                continue
            error = {f"{letter}_{name}": errors[letter][..., i, j].ravel()} if errors else None
            columns |= _written(analysis, {f"{letter}_{name}": tensor[..., i, j].ravel()}, error)
    return pd.DataFrame(columns)


def _drift_px(analysis: Analysis) -> float:
    drift = analysis.beats.drift_px
    return float(np.hypot(*(drift[-1] - drift[0]))) if len(drift) else np.nan


def _summary(analysis: Analysis, beats: pd.DataFrame, errors: Mapping[str, Floats]) -> pd.DataFrame:
    """One row for each metric of the movie; those of beats over the whole beats."""
    import pandas as pd

    axis = analysis.masks.axis
    single = {
        "tissue_length": axis.length_px, "tissue_width": axis.width_center_px, "tissue_width_min": axis.width_min_px,
        "tissue_width_min_at": axis.width_min_at_px, "tissue_area": float(analysis.masks.tissue.sum()),
        "tissue_angle": axis.angle_deg, "lost_fraction": analysis.tracks.lost_fraction, "drift": _drift_px(analysis),
    }
    error: dict[str, Any] = {}
    if errors:
        error = _written(analysis, dict(zip(_beat_names(analysis), errors["movie"], strict=True)))
        error |= _written(analysis, {"drift": errors["drift"]})
    rows = [{"metric": name, "n": 1, "mean": value, "se": error.get(name, np.nan), "interval": ""}
            for name, value in _written(analysis, single).items()]
    whole = beats[beats["complete"]] if len(beats) else beats
    known = {column(m, c) for m in METRICS for c in (False, True)}
    rows += [_over_beats(str(name), np.asarray(whole[name], float), float(error.get(name, np.nan)))
             for name in whole.columns if name in known and name not in IDENTITY]
    return pd.DataFrame(rows, columns=["metric", "n", "mean", "se", "sd", "cv", "median", "low_95", "high_95",
                                       "interval"])


def _over_beats(name: str, values: Floats, error: float) -> dict[str, object]:
    """n, mean, its standard error by measurement, and over beats SD, CV, median and the 95 % interval of the mean; for
    fewer than two beats the interval is that of the measurement."""
    from scipy.special import stdtrit

    values = values[np.isfinite(values)]
    n = len(values)
    mean = float(values.mean()) if n else np.nan
    row: dict[str, object] = {"metric": name, "n": n, "mean": mean, "se": error, "interval": ""}
    if n == 1 and np.isfinite(error):
        half = float(stdtrit(DRAWS, 0.975)) * error
        row |= {"low_95": mean - half, "high_95": mean + half, "interval": "measurement"}
    if n >= 2:
        sd = float(values.std(ddof=1))
        half = float(stdtrit(n - 1, 0.975)) * sd / np.sqrt(n)
        row |= {"sd": sd, "cv": sd / abs(mean) if mean else np.nan, "median": float(np.median(values)),
                "low_95": mean - half, "high_95": mean + half, "interval": "beat-to-beat spread"}
    return row


def _mean_of_known(values: Floats) -> Floats:
    """Mean over rows (B, n) of what is known: (n,), NaN where nothing is."""
    seen = np.isfinite(values)
    total = np.where(seen, values, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, seen.sum(axis=0), out=np.full(total.shape, np.nan), where=seen.any(axis=0)))
