"""Numbers in physical units: the one place where pixels become micrometres, and frames seconds.

`METRICS` is the dictionary: every key has one definition and one unit for each calibration. `tables` writes nothing
that is not in it. Definitions follow the usual names of the field; a level x % is the height above rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from .analysis import Analysis
from .contraction import mean_absolute
from .data import Beats, Floats, Strain

if TYPE_CHECKING:
    import pandas as pd

Kind = Literal["length", "area", "time", "rate", "rate_per_min", "number", "angle"]
UNITS: dict[Kind, tuple[str, str]] = {
    "length": ("px", "um"), "area": ("px2", "um2"), "time": ("frames", "s"), "rate": ("per_frame", "hz"),
    "rate_per_min": ("", "bpm"), "number": ("", ""), "angle": ("deg", "deg"),
}
"""Unit without calibration and unit with it, for each kind of quantity."""

SHUFFLES = 200
SEED = 20240
"""Of the shuffles that give the null values of synchrony, so that a result can be repeated."""


@dataclass(frozen=True)
class Metric:
    """One entry of the dictionary."""

    key: str
    kind: Kind
    level: Literal["movie", "beat", "subdomain", "frame"]
    definition: str


METRICS: tuple[Metric, ...] = (
    Metric("tissue_length", "length", "movie", "Extent of the tissue mask along the tissue's axis."),
    Metric("tissue_width", "length", "movie", "Extent of the mask across the axis, at its centre."),
    Metric("tissue_width_min", "length", "movie", "Smallest extent across the axis in the middle part (necking)."),
    Metric("tissue_width_min_at", "length", "movie", "Place of the smallest width, from the centre along the axis."),
    Metric("tissue_area", "area", "movie", "Area of the tissue mask."),
    Metric("tissue_angle", "angle", "movie", "Angle of the tissue's axis from the image's columns, clockwise."),
    Metric("drift", "length", "movie", "Movement of the relaxed tissue from the first whole or cut beat to the last."),
    Metric("lost_fraction", "number", "movie", "Share of marker positions that could not be followed."),
    Metric("beat_period", "time", "beat", "Time from this beat's peak to the next beat's peak, peaks placed between "
           "frames by a parabola."),
    Metric("beat_rate", "rate", "beat", "1 / beat_period."),
    Metric("beat_rate", "rate_per_min", "beat", "60 / beat_period in seconds."),
    Metric("amplitude", "length", "beat", "Mean absolute displacement at the peak less its mean over the beat's "
           "relaxed frames; displacement is taken from the beat's own relaxed state."),
    Metric("peak_time", "time", "beat", "Time of the largest mean absolute displacement, between frames by a "
           "parabola."),
    Metric("beat_drift", "length", "beat", "Movement of this beat's relaxed state from the movie's."),
    Metric("e_cc_peak", "number", "beat", "Most negative value over the beat of the mean E_cc of all sub-domains."),
    Metric("e_cc_min", "number", "beat", "Most negative E_cc of any sub-domain and frame of the beat."),
    Metric("e_cc_max", "number", "beat", "Most positive E_cc of any sub-domain and frame of the beat."),
    Metric("e_cc_heterogeneity", "number", "beat", "Standard deviation of E_cc over sub-domains at the frame of "
           "e_cc_peak."),
    Metric("extending_fraction", "number", "beat", "Share of sub-domains with positive E_cc at the frame of "
           "e_cc_peak."),
    Metric("synchrony_sd", "time", "beat", "Standard deviation over sub-domains of the time of their largest |E_cc|."),
    Metric("synchrony_sd_of_period", "number", "beat", "synchrony_sd / beat_period."),
    Metric("synchrony_sd_null", "time", "beat", "Value of synchrony_sd when the sub-domains' traces are shifted in "
           "time at random (mean of 200)."),
    Metric("synchrony_correlation", "number", "beat", "Mean correlation of each sub-domain's |E_cc| trace with the "
           "mean of all."),
    Metric("synchrony_correlation_null", "number", "beat", "Value of synchrony_correlation for traces shifted in time "
           "at random (mean of 200)."),
    Metric("markers", "number", "subdomain", "Markers in the sub-domain."),
    Metric("E_cc_extreme", "number", "subdomain", "E_cc of largest size within the beat, with its sign."),
    Metric("E_cc_extreme_time", "time", "subdomain", "Time of E_cc_extreme."),
    *(Metric(f"{tensor}_{part}", "number", "subdomain", f"{name} component {part} at the beat's peak frame.")
      for tensor, name in (("F", "Deformation gradient"), ("E", "Green-Lagrange strain"))
      for part in (("rr", "rc", "cr", "cc") if tensor == "F" else ("rr", "rc", "cc"))),
    Metric("E_1", "number", "subdomain", "Smaller principal Green-Lagrange strain at the beat's peak frame."),
    Metric("E_2", "number", "subdomain", "Larger principal Green-Lagrange strain at the beat's peak frame."),
    Metric("E_1_angle", "angle", "subdomain", "Direction of E_1 from the col axis, positive towards +row."),
    Metric("areal_strain", "number", "subdomain", "det F - 1 at the beat's peak frame."),
    Metric("shear_max", "number", "subdomain", "Largest shear (E_2 - E_1) / 2 at the beat's peak frame."),
    Metric("mean_absolute_displacement", "length", "frame", "Mean over markers of the distance from the movie's "
           "relaxed state."),
    Metric("time", "time", "frame", "Time of the frame."),
)

IDENTITY = ("beat", "frame", "subdomain", "complete", "relaxed", "start_frame", "peak_frame", "stop_frame", "reason")
"""Columns that name a row rather than measure something."""


def column(metric: Metric, calibrated: bool) -> str:
    """Make the column name of a metric: its key, with the unit where it has one."""
    unit = UNITS[metric.kind][int(calibrated)]
    return f"{metric.key}_{unit}" if unit else metric.key


def tables(analysis: Analysis) -> dict[str, pd.DataFrame]:
    """Compute all metrics of a result, as tables with the unit in each column's name.

    `summary` has a row for each metric of the movie (n, mean, sd, cv, median, 95 % interval of the mean over whole
    beats); `beats` a row for each beat, `subdomains` for each sub-domain and beat, `frames` for each frame, `strain`
    for each sub-domain and frame. Lengths are given in px, and in um too where the pixel size is known; times in
    frames, or in seconds where the frame times are known.
    """
    import pandas as pd

    beats = pd.DataFrame(list(_beat_rows(analysis)))
    return {
        "summary": _summary(analysis, beats),
        "beats": beats,
        "subdomains": pd.DataFrame(list(_subdomain_rows(analysis))),
        "frames": _frames(analysis),
        "strain": _strain_frames(analysis),
    }


def _written(analysis: Analysis, values: dict[str, float]) -> dict[str, float]:
    """Give values in px and frames the columns and units that the calibration allows."""
    out: dict[str, float] = {}
    step = _seconds_per_frame(analysis)
    for key, value in values.items():
        for metric in (m for m in METRICS if m.key == key):
            match metric.kind:
                case "length" | "area":
                    out[column(metric, False)] = value
                    if analysis.um_per_px is not None:
                        out[column(metric, True)] = value * analysis.um_per_px ** (2 if metric.kind == "area" else 1)
                case "time":
                    out[column(metric, step is not None)] = value if step is None else value * step
                case "rate":
                    out[column(metric, step is not None)] = value if step is None else value / step
                case "rate_per_min":
                    if step is not None:
                        out[column(metric, True)] = 60 * value / step
                case _:
                    out[column(metric, False)] = value
    return out


def _seconds_per_frame(analysis: Analysis) -> float | None:
    return None if analysis.time_s is None else float(np.median(np.diff(analysis.time_s)))


def _clock(analysis: Analysis) -> Floats:
    """Time of each frame (T,) in units of the median frame, so that gaps between frames count."""
    step = _seconds_per_frame(analysis)
    if analysis.time_s is None or step is None:
        return np.arange(analysis.frame_count, dtype=float)
    return np.asarray((analysis.time_s - analysis.time_s[0]) / step)


def beat_signal(analysis: Analysis) -> Floats:
    """Mean absolute displacement (T,) in px of each frame from the relaxed state of the beat nearest to it; NaN in a
    frame in which no marker was followed."""
    beats, tracks = analysis.beats, analysis.tracks
    if len(beats) == 0:
        return beats.signal_px
    out = np.empty(analysis.frame_count)
    kept = tracks.kept
    for b in range(len(beats)):
        frames = beats.nearest_beat == b
        moved = tracks.position_px[frames][:, kept] - beats.beat_relaxed_px[b, kept].astype(np.float32)
        out[frames] = mean_absolute(moved)
    return out


def parabola_peak(signal: Floats, frame: int) -> float:
    """Place a peak between frames, by the parabola through it and its two neighbours."""
    if not 0 < frame < len(signal) - 1:
        return float(frame)
    left, top, right = signal[frame - 1:frame + 2]
    bend = left - 2 * top + right
    return float(frame + (0.5 * (left - right) / bend if bend < 0 else 0.0))


def _beat_rows(analysis: Analysis) -> Iterator[dict[str, object]]:
    beats, clock = analysis.beats, _clock(analysis)
    signal = beat_signal(analysis)
    followed = np.where(np.isfinite(signal), signal, -np.inf)
    tops = [int(a + np.argmax(followed[a:b])) for a, b in zip(beats.start, beats.stop, strict=True)]
    peaks = np.interp([parabola_peak(signal, t) for t in tops], np.arange(len(clock)), clock)
    # A beat that the movie cuts off on its way has its largest value at the cut, which is not its peak.
    seen = np.array([0 < t < len(signal) - 1 for t in tops])
    periods = [peaks[b + 1] - peaks[b] if b + 1 < len(tops) and seen[b] and seen[b + 1] else np.nan
               for b in range(len(tops))]
    for b, (start, stop, top) in enumerate(zip(beats.start, beats.stop, tops, strict=True)):
        resting = np.zeros(len(signal), bool)
        resting[start:stop] = beats.relaxed[start:stop] & np.isfinite(signal[start:stop])
        level = float(signal[resting].mean()) if resting.any() else 0.0
        complete = bool(beats.complete[b])
        values = {
            "amplitude": signal[top] - level if seen[b] else np.nan, "peak_time": peaks[b] if seen[b] else np.nan,
            "beat_period": periods[b], "beat_rate": 1 / periods[b], "beat_drift": float(np.hypot(*beats.drift_px[b])),
        }
        if analysis.strain is not None:
            values |= beat_strain(analysis.strain, int(start), int(stop), clock, periods[b], complete)
        yield {"beat": b, "complete": complete, "start_frame": int(start), "peak_frame": top, "stop_frame": int(stop),
               **_written(analysis, values)}


def beat_strain(strain: Strain, start: int, stop: int, clock: Floats, period: float,
                complete: bool) -> dict[str, float]:
    """Compute the tissue's strain metrics of one beat from E_cc of all sub-domains; times in frames."""
    names = ("e_cc_peak", "e_cc_min", "e_cc_max", "e_cc_heterogeneity", "extending_fraction", "synchrony_sd",
             "synchrony_sd_of_period", "synchrony_sd_null", "synchrony_correlation", "synchrony_correlation_null")
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
    return dict(zip(names, values + synchrony(np.abs(E_cc), times, period), strict=True))


def synchrony(traces: Floats, clock: Floats, period: float) -> list[float]:
    """Compare the timing of traces (F, S): SD of their peak times, the same over the period, its value for shuffled
    traces, mean correlation with their mean, and its value for shuffled traces. NaN for fewer than two traces."""
    frames, count = traces.shape
    if count < 2 or frames < 3:
        return [np.nan] * 5
    rng = np.random.default_rng(SEED)
    sd, correlation = _peak_time_sd(traces, clock), _correlation(traces)
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


def _subdomain_rows(analysis: Analysis) -> Iterator[dict[str, object]]:
    strain, beats, clock = analysis.strain, analysis.beats, _clock(analysis)
    if strain is None:
        return
    E, J, (principal, angle) = strain.E, strain.J, strain.principal
    for b, (start, peak, stop) in enumerate(zip(beats.start, beats.peak, beats.stop, strict=True)):
        for s, label in enumerate(strain.label):
            trace = E[start:stop, s, 1, 1]
            seen = np.isfinite(trace).any()
            at = int(np.nanargmax(np.abs(trace))) if seen else 0
            F, E_s, (E_1, E_2) = strain.F[peak, s], E[peak, s], principal[peak, s]
            values = {
                "markers": int(strain.count[s]), "E_cc_extreme": trace[at] if seen else np.nan,
                "E_cc_extreme_time": clock[start + at] if seen else np.nan,
                "F_rr": F[0, 0], "F_rc": F[0, 1], "F_cr": F[1, 0], "F_cc": F[1, 1],
                "E_rr": E_s[0, 0], "E_rc": E_s[0, 1], "E_cc": E_s[1, 1], "E_1": E_1, "E_2": E_2,
                "E_1_angle": angle[peak, s], "areal_strain": J[peak, s] - 1, "shear_max": 0.5 * (E_2 - E_1),
            }
            yield {"beat": b, "subdomain": label, "complete": bool(beats.complete[b]), "reason": strain.reason[s],
                   **_written(analysis, values)}


def _frames(analysis: Analysis) -> pd.DataFrame:
    import pandas as pd

    beats: Beats = analysis.beats
    length = _written(analysis, {"mean_absolute_displacement": 1.0})
    step = _seconds_per_frame(analysis)
    clock = _clock(analysis)
    return pd.DataFrame({
        "frame": np.arange(analysis.frame_count),
        **({} if step is None else {"time_s": clock * step}),
        "beat": beats.beat_of_frame, "relaxed": beats.relaxed,
        **{name: beats.signal_px * scale for name, scale in length.items()},
    })


def _strain_frames(analysis: Analysis) -> pd.DataFrame:
    import pandas as pd

    strain = analysis.strain
    if strain is None:
        return pd.DataFrame()
    count, tiles = strain.F.shape[:2]
    E = strain.E
    parts = {"rr": (0, 0), "rc": (0, 1), "cr": (1, 0), "cc": (1, 1)}
    return pd.DataFrame({
        "frame": np.repeat(np.arange(count), tiles), "subdomain": np.tile(np.array(strain.label), count),
        **{f"F_{name}": strain.F[..., i, j].ravel() for name, (i, j) in parts.items()},
        **{f"E_{name}": E[..., i, j].ravel() for name, (i, j) in parts.items() if name != "cr"},
    })


def _summary(analysis: Analysis, beats: pd.DataFrame) -> pd.DataFrame:
    """One row for each metric of the movie; those of beats over the whole beats."""
    import pandas as pd

    axis, drift = analysis.masks.axis, analysis.beats.drift_px
    single = _written(analysis, {
        "tissue_length": axis.length_px, "tissue_width": axis.width_center_px, "tissue_width_min": axis.width_min_px,
        "tissue_width_min_at": axis.width_min_at_px, "tissue_area": float(analysis.masks.tissue.sum()),
        "tissue_angle": axis.angle_deg, "lost_fraction": analysis.tracks.lost_fraction,
        "drift": float(np.hypot(*(drift[-1] - drift[0]))) if len(drift) else np.nan,
    })
    rows = [{"metric": name, "n": 1, "mean": value, "interval": ""} for name, value in single.items()]
    whole = beats[beats["complete"]] if len(beats) else beats
    rows += [_spread(str(name), np.asarray(whole[name], float)) for name in whole.columns if name not in IDENTITY]
    return pd.DataFrame(rows, columns=["metric", "n", "mean", "sd", "cv", "median", "low_95", "high_95", "interval"])


def _spread(name: str, values: Floats) -> dict[str, object]:
    """n, mean, SD, CV, median and 95 % interval of the mean over beats; no spread for fewer than two."""
    from scipy.special import stdtrit

    values = values[np.isfinite(values)]
    n = len(values)
    row: dict[str, object] = {"metric": name, "n": n, "mean": float(values.mean()) if n else np.nan, "interval": ""}
    if n >= 2:
        mean, sd = float(values.mean()), float(values.std(ddof=1))
        half = float(stdtrit(n - 1, 0.975)) * sd / np.sqrt(n)
        row |= {"sd": sd, "cv": sd / abs(mean) if mean else np.nan, "median": float(np.median(values)),
                "low_95": mean - half, "high_95": mean + half, "interval": "beat-to-beat spread"}
    return row
