"""Numbers in physical units: the one place where pixels become micrometres, and frames seconds.

Every number is a function of a result (see `numbers`); where the method knows its errors, the same function of its
alternatives gives the standard error (see `uncertainty`). `tables` writes nothing that is not in the dictionary.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .analysis import Analysis
from .data import Bools, Floats
from .dictionary import BY_KEY, Level, columns
from .draws import COUNT as DRAWS
from .force import budget, pillar_series
from .levels import level_values
from .numbers import (
    baseline_drift,
    beat_signal,
    clock,
    drift_px,
    front_values,
    rhythm_values,
    seconds_per_frame,
    shortening,
)
from .propagation import speed
from .uncertainty import added_by_noise, standard_errors

if TYPE_CHECKING:
    import pandas as pd

OVER_BEATS: tuple[Level, ...] = ("beat", "shortening")
"""Levels whose numbers are summed up over the whole beats of the tissue."""
PARTS: tuple[Level, ...] = ("subdomain", "pillar")
"""Levels whose numbers are summed up over the whole beats for each part."""


def tables(analysis: Analysis) -> dict[str, pd.DataFrame]:
    """Compute all metrics of a result, as tables with the unit in each column's name.

    `summary` has a row for each metric of the movie (n, mean, standard error, sd, cv, median, 95 % interval of the mean
    over whole beats), `subdomain_summary` and `pillar_summary` the same for each sub-domain and pillar; `beats` a row
    for each beat, by the mean absolute displacement, and `shortening` by the tissue's length; `subdomains` a row for
    each sub-domain and beat, `frames` for each frame, `strain` for each sub-domain and frame. `pillars` has a row for
    each pillar and beat, `pillar_frames` for each pillar and frame, and `budget` the sources of the forces' errors; all
    three are empty without pillars. Lengths are given in px, and in um too where the pixel size is known; times in
    frames, or in seconds where the frame times are known. Standard errors (`_se`) are those of the measurement, for
    results of the method `accurate`.
    """
    import pandas as pd

    errors = standard_errors(analysis, _with_errors)
    signals = np.stack([beat_signal(analysis), analysis.beats.signal_px])
    added = added_by_noise(analysis, lambda a: np.stack([beat_signal(a), a.beats.signal_px]))
    values = level_values(analysis, signals[0] - added[0])
    return {
        "summary": _summary(analysis, values, errors),
        "subdomain_summary": _summary_of_parts(analysis, "subdomain", values["subdomain"], errors),
        "pillar_summary": _summary_of_parts(analysis, "pillar", values["pillar"], errors),
        "beats": pd.DataFrame(list(_beat_rows(analysis, values["beat"], errors, "beat"))),
        "shortening": pd.DataFrame(list(_beat_rows(analysis, values["shortening"], errors, "shortening"))),
        "subdomains": pd.DataFrame(list(_subdomain_rows(analysis, values["subdomain"], errors))),
        "pillars": pd.DataFrame(list(_pillar_rows(analysis, values["pillar"], errors))),
        "frames": _frames(analysis, errors, added[1]),
        "strain": _strain_frames(analysis, errors),
        "pillar_frames": _pillar_frames(analysis, errors),
        "budget": pd.DataFrame(list(budget(analysis, values, _errors_of(errors, "mean")))),
    }


def _with_errors(analysis: Analysis) -> dict[str, Floats]:
    """All numbers that have a standard error, by level and name; means over the whole beats besides."""
    levels = level_values(analysis, nulls=False)
    out = {f"{level}.{name}": values for level, found in levels.items() for name, values in found.items()}
    whole = analysis.beats.complete
    out |= {f"mean.{name}": _mean_of_known(values[whole]) for level in OVER_BEATS
            for name, values in levels[level].items()}
    out |= {f"mean.{level}.{name}": _mean_of_known(values[whole]) for level in PARTS
            for name, values in levels[level].items()}
    movie = {"drift": np.array(drift_px(analysis)), "baseline_drift": np.array(baseline_drift(analysis)),
             **rhythm_values(analysis, levels["beat"], nulls=False), **_front(analysis, levels)}
    out |= {f"mean.{name}": value for name, value in movie.items()}
    frames = {"mean_absolute_displacement": analysis.beats.signal_px, "shortening": shortening(analysis)}
    out |= {f"frame.{name}": value for name, value in frames.items()}
    if analysis.strain is not None:
        out |= {"F": analysis.strain.F, "E": analysis.strain.E}
    return out | {f"pillar_frame.{name}": values for name, values in pillar_series(analysis).items()}


def _written(analysis: Analysis, values: Mapping[str, Any], errors: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Give values in px and frames, and their standard errors, the columns and units that the calibration allows."""
    out: dict[str, Any] = {}
    calibration = analysis.um_per_px, seconds_per_frame(analysis)
    for key, value in values.items():
        for metric in BY_KEY[key]:
            out |= {name: value * factor for name, factor in columns(metric, *calibration)}
            if errors and key in errors and metric.error:
                out |= {name: errors[key] * factor for name, factor in columns(metric, *calibration, error=True)}
    return out


def _at(values: Mapping[str, Floats], index: Any) -> dict[str, Any]:
    return {name: value[index] for name, value in values.items()}


def _errors_of(errors: Mapping[str, Floats], level: str) -> dict[str, Floats]:
    """Errors of one level, by name; empty for a method that does not know its errors."""
    start = f"{level}."
    return {name.removeprefix(start): value for name, value in errors.items() if name.startswith(start)}


def _beat_rows(analysis: Analysis, values: Mapping[str, Floats], errors: Mapping[str, Floats],
               level: Level) -> Iterator[dict[str, object]]:
    beats, error = analysis.beats, _errors_of(errors, level)
    for b in range(len(beats)):
        yield {"beat": b, "complete": bool(beats.complete[b]), "left_out": bool(beats.left_out[b]),
               "start_frame": int(beats.start[b]), "peak_frame": int(beats.peak[b]), "stop_frame": int(beats.stop[b]),
               **_written(analysis, _at(values, b), _at(error, b))}


def _subdomain_rows(analysis: Analysis, values: Mapping[str, Floats],
                    errors: Mapping[str, Floats]) -> Iterator[dict[str, object]]:
    strain, beats, error = analysis.strain, analysis.beats, _errors_of(errors, "subdomain")
    if strain is None:
        return
    for b in range(len(beats)):
        for s, label in enumerate(strain.label):
            here = {"markers": int(strain.count[s]), **_at(values, (b, s))}
            yield {"beat": b, "subdomain": label, "complete": bool(beats.complete[b]), "reason": strain.reason[s],
                   **_written(analysis, here, _at(error, (b, s)))}


def _pillar_rows(analysis: Analysis, values: Mapping[str, Floats],
                 errors: Mapping[str, Floats]) -> Iterator[dict[str, object]]:
    beats, motion, error = analysis.beats, analysis.pillars, _errors_of(errors, "pillar")
    if motion is None:
        return
    for b in range(len(beats)):
        for p, name in enumerate(motion.pillars.names):
            yield {"beat": b, "pillar": name, "complete": bool(beats.complete[b]),
                   **_written(analysis, _at(values, (b, p)), _at(error, (b, p)))}


def _pillar_frames(analysis: Analysis, errors: Mapping[str, Floats]) -> pd.DataFrame:
    import pandas as pd

    motion, error = analysis.pillars, _errors_of(errors, "pillar_frame")
    if motion is None:
        return pd.DataFrame()
    count, names = analysis.frame_count, np.array(motion.pillars.names)
    values = {name: series.ravel() for name, series in pillar_series(analysis).items()}
    return pd.DataFrame({"frame": np.repeat(np.arange(count), len(names)), "pillar": np.tile(names, count),
                         **_written(analysis, values, {name: series.ravel() for name, series in error.items()})})


def _frames(analysis: Analysis, errors: Mapping[str, Floats], added: Floats) -> pd.DataFrame:
    import pandas as pd

    beats, error = analysis.beats, _errors_of(errors, "frame")
    values = {"mean_absolute_displacement": beats.signal_px, "shortening": shortening(analysis)}
    if error:
        values["mean_absolute_displacement_corrected"] = beats.signal_px - added
        error["mean_absolute_displacement_corrected"] = error["mean_absolute_displacement"]
    step, times = seconds_per_frame(analysis), clock(analysis)
    return pd.DataFrame({
        "frame": np.arange(analysis.frame_count), **({} if step is None else {"time_s": times * step}),
        "beat": beats.beat_of_frame, "relaxed": beats.relaxed, **_written(analysis, values, error),
    })


def _strain_frames(analysis: Analysis, errors: Mapping[str, Floats]) -> pd.DataFrame:
    import pandas as pd

    strain = analysis.strain
    if strain is None:
        return pd.DataFrame()
    count, tiles = strain.F.shape[:2]
    found = {"frame": np.repeat(np.arange(count), tiles), "subdomain": np.tile(np.array(strain.label), count)}
    for letter, tensor in (("F", strain.F), ("E", strain.E)):
        for name, i, j in (("rr", 0, 0), ("rc", 0, 1), ("cr", 1, 0), ("cc", 1, 1)):
            if letter == "E" and name == "cr":
                continue
            error = {f"{letter}_{name}": errors[letter][..., i, j].ravel()} if errors else None
            found |= _written(analysis, {f"{letter}_{name}": tensor[..., i, j].ravel()}, error)
    return pd.DataFrame(found)


def _summary(analysis: Analysis, values: Mapping[Level, Mapping[str, Floats]],
             errors: Mapping[str, Floats]) -> pd.DataFrame:
    """One row for each metric of the movie; those of beats over the whole beats."""
    import pandas as pd

    axis, error, whole = analysis.masks.axis, _errors_of(errors, "mean"), analysis.beats.complete
    single = {
        "tissue_length": axis.length_px, "tissue_width": axis.width_center_px, "tissue_width_min": axis.width_min_px,
        "tissue_width_min_at": axis.width_min_at_px, "tissue_area": float(analysis.masks.tissue.sum()),
        "tissue_angle": axis.angle_deg, "lost_fraction": analysis.tracks.lost_fraction, "drift": drift_px(analysis),
        "baseline_drift": baseline_drift(analysis), **rhythm_values(analysis, dict(values["beat"])),
        **_told(_front(analysis, values), error),
    }
    rows = [_row(name, np.atleast_1d(value), se, single=True)
            for name, value, se in _with_column_errors(analysis, single, error)]
    over = {name: value[whole] for level in OVER_BEATS for name, value in values[level].items()}
    rows += [_row(name, value, se) for name, value, se in _with_column_errors(analysis, over, error)]
    return pd.DataFrame(rows, columns=STATISTICS)


STATISTICS = ["metric", "n", "mean", "se", "sd", "cv", "median", "low_95", "high_95", "interval"]


def _summary_of_parts(analysis: Analysis, level: Level, values: Mapping[str, Floats],
                      errors: Mapping[str, Floats]) -> pd.DataFrame:
    """One row for each metric of each sub-domain or pillar, over the whole beats."""
    import pandas as pd

    names: tuple[str, ...] = ()
    if level == "subdomain" and analysis.strain is not None:
        names = analysis.strain.label
    elif level == "pillar" and analysis.pillars is not None:
        names = analysis.pillars.pillars.names
    whole, error = analysis.beats.complete, _errors_of(errors, f"mean.{level}")
    rows = [{level: name, **_row(column, each, se)} for p, name in enumerate(names)
            for column, each, se in _with_column_errors(analysis, _at(values, (whole, p)), _at(error, p))]
    return pd.DataFrame(rows, columns=[level, *STATISTICS] if names else [])


def _front(analysis: Analysis, values: Mapping[Level, Mapping[str, Floats]]) -> dict[str, Floats]:
    return front_values(analysis, values["subdomain"]["delay"]) if "delay" in values["subdomain"] else {}


def _told(front: Mapping[str, Floats], error: dict[str, Floats]) -> dict[str, Any]:
    """The metrics of a front, whose slowness becomes a speed where it stands out of its error; `error` gets theirs."""
    if not front:
        return {}
    parts = ("slowness_across", "slowness_along")
    slowness, wrong = (np.array([float(found.get(part, np.nan)) for part in parts]) for found in (front, error))
    velocity, angle, velocity_se, angle_se = speed(slowness, wrong)
    error |= {"conduction_velocity": np.array(velocity_se), "conduction_angle": np.array(angle_se)}
    return {"delay_range": front["delay_range"], "conduction_velocity": velocity, "conduction_angle": angle}


def _with_column_errors(analysis: Analysis, values: Mapping[str, Any],
                        errors: Mapping[str, Floats]) -> Iterator[tuple[str, Floats, float]]:
    """Each column's name, values, and the standard error of their mean."""
    calibration = analysis.um_per_px, seconds_per_frame(analysis)
    for key, value in values.items():
        for metric in BY_KEY[key]:
            error = float(errors[key]) if metric.error and key in errors else np.nan
            for name, factor in columns(metric, *calibration):
                yield name, np.asarray(value) * factor, error * factor


def _row(name: str, values: Floats, error: float, *, single: bool = False) -> dict[str, object]:
    """n, mean, its standard error by measurement, and over beats SD, CV, median and the 95 % interval of the mean: by
    the beats' spread, and, where it is known, by the measurement's error too, of which a part is common to all beats.
    """
    from scipy.special import stdtrit

    values = values[np.isfinite(values)]
    n = len(values)
    mean = float(values.mean()) if n else np.nan
    row: dict[str, object] = {"metric": name, "n": n, "mean": mean, "se": error, "interval": ""}
    own = float(stdtrit(DRAWS, 0.975)) * error if np.isfinite(error) else 0.0
    if n == 1 and own and not single:
        row |= {"low_95": mean - own, "high_95": mean + own, "interval": "measurement"}
    if n >= 2:
        sd = float(values.std(ddof=1))
        half = float(np.hypot(float(stdtrit(n - 1, 0.975)) * sd / np.sqrt(n), own))
        row |= {"sd": sd, "cv": sd / abs(mean) if mean else np.nan, "median": float(np.median(values)),
                "low_95": mean - half, "high_95": mean + half,
                "interval": "beat-to-beat spread and measurement" if own else "beat-to-beat spread"}
    return row


def _mean_of_known(values: Floats) -> Floats:
    """Mean over rows (B, ...) of what is known: (...), NaN where nothing is."""
    seen: Bools = np.isfinite(values)
    total = np.where(seen, values, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, seen.sum(axis=0), out=np.full(np.shape(total), np.nan), where=seen.any(axis=0)))
