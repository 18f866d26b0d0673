"""A second signal beside the movie: calcium, voltage, or any trace, cut into beats and compared with the contraction.

A trace comes from a text table (time and value), or from the frames of a second channel as the mean over the tissue's
mask. It is cut into beats like the contraction signal. Its relaxed level F0, the straight lines through its rests,
follows bleaching, and dF/F0 = (F - F0)/F0 is what the beats are measured on, by the definitions of `waveform`. The
standard errors come from 32 draws of white noise of the size that the trace itself shows between frames.

Delays compare each beat of the trace with the contraction that follows it: onset to onset, half rise to half rise, peak
to peak.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .analysis import Analysis
from .beats import cut_signal
from .config import BeatParams, MetricParams
from .contraction import frame_noise, rest_path
from .data import Beats, Bools, Finding, Floats, Movie
from .dictionary import BY_KEY, PREFIX, columns
from .errors import CannotMeasure, MovieUnreadable
from .numbers import beat_signal, duty, periods, shapes_of
from .waveform import beat_shapes

if TYPE_CHECKING:
    import pandas as pd

DRAWS, SEED = 32, 1729
FEWEST = 8
"""Values that a trace must have."""
MARKS = ("onset_time", "half_rise_time", "peak_time")
LATEST_SHARE = 0.5
"""A contraction follows a beat of the trace within this share of the period."""


@dataclass(frozen=True)
class Trace:
    """A signal over time, cut into beats."""

    name: str
    time_s: Floats
    """(T,)"""
    value: Floats
    """(T,): as it was recorded."""
    rest: Floats
    """(T,): relaxed level F0."""
    beats: Beats
    inverted: bool = False
    """Whether beats are dips of the recorded value."""
    findings: tuple[Finding, ...] = ()

    @property
    def relative(self) -> Floats:
        """(T,): dF/F0, positive in a beat; the change itself where the relaxed level is not positive."""
        change = (self.value - self.rest) * (-1 if self.inverted else 1)
        return np.asarray(change / self.rest if (self.rest > 0).all() else change)

    @property
    def clock(self) -> Floats:
        """Time of each value (T,) in units of the median step."""
        return np.asarray((self.time_s - self.time_s[0]) / float(np.median(np.diff(self.time_s))))


def read_trace(path: Path | str, *, fps: float | None = None) -> tuple[Floats, Floats]:
    """Read a trace: times in seconds (T,) and values (T,), from a text table.

    The table has a header, with a column `time_s` (or `time`) and one more; or one column of values, for which `fps`
    gives the rate. Columns are separated by commas, semicolons, tabs or blanks. Raises MovieUnreadable.
    """
    import pandas as pd

    path = Path(path).expanduser()
    try:
        table = pd.read_csv(path, sep=None, engine="python", comment="#")
    except Exception as error:  # whatever a damaged file makes the parser raise
        raise MovieUnreadable(f"{path}: expected a table with the columns time_s and value: {error}") from None
    names = {str(name).strip().lower(): name for name in table.columns}
    time = next((names[name] for name in ("time_s", "time", "t") if name in names), None)
    values = [name for name in table.columns if name != time]
    if not values or (time is None and fps is None):
        raise MovieUnreadable(f"{path}: expected a column time_s and one of values, or one column of values and --fps; "
                              f"found {', '.join(map(str, table.columns))}")
    def numbers(name: object) -> Floats:
        return np.asarray(pd.to_numeric(table[name], errors="coerce"), float)

    value = numbers(values[0])
    return (numbers(time) if time is not None else np.arange(len(value)) / float(fps or 1)), value


def mean_trace(movie: Movie, mask: Bools) -> tuple[Floats, Floats]:
    """Average each frame of a movie over a mask (R, C): times in seconds (T,) and values (T,).

    Raises CannotMeasure where the frames' times are not known, or the mask does not fit.
    """
    if movie.time_s is None:
        raise CannotMeasure(f"{movie.name}: expected known frame times for a second channel; give --fps")
    if mask.shape != movie.shape:
        raise CannotMeasure(f"{movie.name}: expected frames of {mask.shape} like the tissue's mask; found "
                            f"{movie.shape}")
    return movie.time_s, np.array([float(np.asarray(movie.frames[t])[mask].mean()) for t in range(movie.count)])


def cut_trace(name: str, time_s: Floats, value: Floats, params: BeatParams | None = None, *,
              inverted: bool = False) -> Trace:
    """Cut a trace, values (T,) at times (T,) in seconds, into beats; `inverted` for beats that are dips.

    Raises CannotMeasure for fewer than 8 values, or for times that do not grow.
    """
    known = np.isfinite(time_s) & np.isfinite(value)
    time_s, value = time_s[known], value[known]
    if len(value) < FEWEST:
        raise CannotMeasure(f"{name}: expected a trace of at least {FEWEST} numbers; found {len(value)}")
    if (np.diff(time_s) <= 0).any():
        at = int(np.argmax(np.diff(time_s) <= 0)) + 1
        raise CannotMeasure(f"{name}: expected times that grow; found {time_s[at]:g} s after {time_s[at - 1]:g} s, in "
                            f"row {at + 1}")
    # Scaled, because the limits of `cut_signal` are those of a displacement in px.
    scale = float(np.ptp(value)) or 1.0
    signal = (-1 if inverted else 1) * (value - np.median(value)) * 100 / scale
    noise = frame_noise(signal)
    cut, without = cut_signal(signal, noise, params or BeatParams(), 1 / float(np.median(np.diff(time_s))))
    relaxed = np.zeros(len(value), bool)
    for first, stop in (rest for rests in cut.rests for rest in rests):
        relaxed[first:stop] = True
    count = len(cut.peak)
    findings = () if count else (Finding("no_beats", "review", f"{name}: no beat was found in the trace"
                                         f"{': ' + without.why if without.why else ''}"),)
    beats = Beats(signal, noise, np.array(cut.start, int), np.array(cut.peak, int), np.array(cut.stop, int),
                  np.array(cut.complete, bool), relaxed if count else ~relaxed, np.zeros((0, 2)),
                  np.zeros((count, 0, 2)), "trace", findings=findings)
    return Trace(name, time_s, value, rest_path(value, beats.relaxed, time_s), beats, inverted, findings)


def trace_values(trace: Trace, params: MetricParams | None = None) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """Compute the metrics of each beat of a trace, and their standard errors: name -> (B,), times in steps."""
    params, step = params or MetricParams(), float(np.median(np.diff(trace.time_s)))
    signal = trace.relative
    noise = frame_noise(signal) * np.random.default_rng(SEED).standard_normal((len(signal), DRAWS))
    found = beat_shapes(np.concatenate([signal[:, None], signal[:, None] + noise], axis=1), trace.clock, trace.beats,
                        levels=params.levels_pct, velocity_window=params.velocity_s / step)
    found = {PREFIX["trace"] + name: values for name, values in found.items()}
    period = np.stack([periods(column) for column in found["trace_peak_time"].T], axis=1)
    found |= {"trace_period": period}
    found |= duty(found, "trace")
    return ({name: values[:, 0] for name, values in found.items()},
            {name: _spread(values[:, 1:]) for name, values in found.items()})


def _spread(values: Floats) -> Floats:
    """Standard deviation (B,) over draws (B, D); NaN where half of them have no value."""
    seen = np.isfinite(values)
    n = np.where(seen.sum(axis=1) * 2 > values.shape[1], seen.sum(axis=1), np.nan)
    mean = np.where(seen, values, 0.0).sum(axis=1) / n
    return np.asarray(np.sqrt((np.where(seen, values - mean[:, None], 0.0) ** 2).sum(axis=1) / (n - 1)))


def trace_delays(trace: Trace, analysis: Analysis) -> dict[str, Floats]:
    """Compare each beat of a trace (B,) with the contraction that follows it: delays in seconds, NaN where none does.

    Both count their times from the same start. Raises CannotMeasure where the movie's frame times are not known.
    """
    if analysis.time_s is None:
        raise CannotMeasure(f"{analysis.name}: expected known frame times to compare with a trace; give --fps")
    own, _ = trace_values(trace)
    follows = shapes_of(analysis, {"beat": beat_signal(analysis)[:, None]})["beat"]
    step = float(np.median(np.diff(trace.time_s)))
    frame = float(np.median(np.diff(analysis.time_s)))
    reach = LATEST_SHARE * float(np.nanmedian(own["trace_period"])) * step if len(trace.beats) > 1 else np.inf
    out = {}
    for mark in MARKS:
        early = trace.time_s[0] + own[f"trace_{mark}"] * step
        late = analysis.time_s[0] + follows[mark][:, 0] * frame
        away = late[None, :] - early[:, None] if len(late) else np.full((len(early), 1), np.nan)
        near = np.where(np.isfinite(away), np.abs(away), np.inf)
        best = np.argmin(near, axis=1) if len(early) else np.zeros(0, int)
        chosen = away[np.arange(len(early)), best]
        out[f"contraction_delay_{mark.removesuffix('_time')}"] = np.where(np.abs(chosen) <= reach, chosen, np.nan)
    return out


def trace_table(trace: Trace, analysis: Analysis | None = None) -> pd.DataFrame:
    """Make the table of a trace's beats, with standard errors; with a result, also the contraction's delays."""
    import pandas as pd

    values, errors = trace_values(trace)
    step = float(np.median(np.diff(trace.time_s)))
    late = trace_delays(trace, analysis) if analysis is not None else {}
    rows: list[dict[str, Any]] = []
    for b in range(len(trace.beats)):
        row: dict[str, Any] = {"beat": b, "complete": bool(trace.beats.complete[b])}
        for key in values:
            for metric in BY_KEY[key]:
                for error, numbers in ((False, values), (True, errors)):
                    row |= {name: numbers[key][b] * factor
                            for name, factor in columns(metric, None, step, error=error)}
        row |= {f"{name}_s": value[b] for name, value in late.items()}
        rows.append(row)
    return pd.DataFrame(rows)
