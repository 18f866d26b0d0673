"""The dictionary of metrics: every key has one definition, and one unit for each calibration.

It names the columns of all tables, and feeds `microbundle metrics` and the docs. Nothing is written that is not in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

Level = Literal["movie", "beat", "shortening", "subdomain", "pillar", "trace", "frame", "pillar_frame"]
"""What a number belongs to; each level but `movie` has a table of its own."""


@dataclass(frozen=True)
class Kind:
    """A kind of quantity: powers of length and time, and the unit of what is neither."""

    length: int = 0
    time: int = 0
    unit: str = ""
    both: bool = False
    """Whether it is written in pixels even where micrometres are known."""
    timed: bool = False
    """Whether it is written only where the frames' times are known."""


LENGTH, AREA, TIME, NUMBER, ANGLE = Kind(1, both=True), Kind(2, both=True), Kind(time=1), Kind(), Kind(unit="deg")
RATE, PER_MINUTE, VELOCITY, LENGTH_TIME = Kind(time=-1), Kind(unit="bpm", timed=True), Kind(1, -1), Kind(1, 1)
FORCE, FORCE_RATE, FORCE_TIME = Kind(unit="un"), Kind(unit="un", time=-1), Kind(unit="un", time=1)
STRESS, WORK, POWER = Kind(unit="kpa"), Kind(unit="nj"), Kind(unit="nj", time=-1)


PAPER = "Kobeissi et al., PLoS ONE 19 (2024) e0298863 (MicroBundleCompute)"
PILLAR_TOOL = "Kobeissi et al., microPubl. Biol. (2024) 001231 (MicroBundlePillarTrack)"
MUSCLEMOTION = "Sala et al., Circ. Res. 122 (2018) e5 (MUSCLEMOTION), with another baseline"
BEATPROFILER = "Kim et al., IEEE Open J. Eng. Med. Biol. (2024) (BeatProfiler)"
PULSE3D = "Curi Bio, program pulse3D, with another baseline"
RHYTHM = "Task Force of ESC and NASPE, Circulation 93 (1996) 1043, of heart beats"
"""Where definitions come from; an entry without a source is defined here."""


@dataclass(frozen=True)
class Metric:
    """One entry of the dictionary."""

    key: str
    kind: Kind
    level: Level
    definition: str
    elsewhere: str = ""
    """What other tools call it."""
    source: str = ""
    error: bool = True
    """Whether its standard error is written beside it, where the method knows it: in the column `key_se_unit`, or `se`
    in the summary."""


def columns(metric: Metric, um_per_px: float | None, s_per_frame: float | None, *,
            error: bool = False) -> Iterator[tuple[str, float]]:
    """Give the columns in which a metric is written, or its standard error, and the factor from px and frames to each.

    A column's name is the key and the unit. Lengths and areas are written in px, and in um too where the pixel size is
    known; times in s where the frames' times are known, else in frames.
    """
    kind = metric.kind
    if kind.timed and s_per_frame is None:
        return
    factor = 1.0 if s_per_frame is None else s_per_frame**kind.time
    if kind is PER_MINUTE and s_per_frame is not None:
        factor = 60 / s_per_frame
    sizes: list[tuple[str, float]] = [("px", 1.0)] if um_per_px is None or kind.both else []
    if um_per_px is not None:
        sizes.append(("um", um_per_px**kind.length))
    for size, scale in sizes if kind.length else [("", 1.0)]:
        unit = _unit(kind, size, timed=s_per_frame is not None)
        yield "_".join([metric.key, *["se"] * error, *[unit] * bool(unit)]), factor * scale


def _unit(kind: Kind, size: str, *, timed: bool) -> str:
    """Unit of a kind of quantity, with `size` for px or um, in seconds or in frames."""
    above = kind.unit + size + (str(kind.length) if kind.length > 1 else "")
    if kind.unit == "nj" and kind.time == -1 and timed:
        return "nw"
    if kind.time == 1:
        return "_".join([above] * bool(above) + ["s" if timed else "frames"])
    if kind.time == -1:
        return "_".join([above, "per", "s" if timed else "frame"]) if above else ("hz" if timed else "per_frame")
    return above


ALSO = {10: ", 10-to-10 transient (MUSCLEMOTION)", 80: ", t80 (MicroBundlePillarTrack)",
        50: ", FWHM, 50-to-50 transient (MUSCLEMOTION), fwhm (BeatProfiler), t50 (MicroBundlePillarTrack)",
        90: ", Contraction duration [10% above baseline] (MUSCLEMOTION), fw90m (BeatProfiler)"}
"""Further names of contraction durations."""
SHAPE: tuple[Metric, ...] = (
    Metric("amplitude", LENGTH, "beat", "Largest height of the signal above its baseline, the line through the rests "
           "before and after the beat.", "Contraction amplitude (MUSCLEMOTION), raw amplitude (BeatProfiler), Twitch "
           "Amplitude (Pulse3D), each above another baseline", f"{PAPER}, there from the beat's first frame"),
    Metric("peak_time", TIME, "beat", "Time of the largest height, from the movie's first frame."),
    Metric("onset_time", TIME, "beat", "Time at which the steepest tangent of the rise meets the baseline."),
    Metric("half_rise_time", TIME, "beat", "Time at which the rise passes 50 % of the amplitude: the sharpest mark of "
           "a beat in time."),
    Metric("time_to_peak", TIME, "beat", "From 10 % of the rise to the peak.", "TTP, Time-to-peak (MUSCLEMOTION), "
           "contract90 (BeatProfiler), Time From Contraction 10 to Peak (Pulse3D)", MUSCLEMOTION),
    Metric("time_to_peak_from_onset", TIME, "beat", "From onset_time to the peak.", "TTP, contraction time"),
    Metric("time_to_peak_from_valley", TIME, "beat", "From the signal's lowest point before the peak to the peak.",
           "TTP"),
    *(Metric(f"cd{x}", TIME, "beat", f"Contraction duration: width of the beat at {100 - x} % of its height, that is "
             f"after {x} % of the relaxation.", f"CD{x}, Twitch Width {x} (Pulse3D){ALSO.get(x, '')}", MUSCLEMOTION)
      for x in range(10, 100, 10)),
    Metric("relax50", TIME, "beat", "From the peak to 50 % relaxation.", "R50, RT50, relax50 (BeatProfiler), "
           "Time From Peak to Relaxation 50 (Pulse3D)", BEATPROFILER),
    Metric("relax90", TIME, "beat", "From the peak to 90 % relaxation.", "R90, RT90, Relaxation Time "
           "(MUSCLEMOTION), relax90 (BeatProfiler), Time From Peak to Relaxation 90 (Pulse3D)", BEATPROFILER),
    Metric("t_up_20_80", TIME, "beat", "Time of the rise from 20 to 80 % of the amplitude."),
    Metric("t_down_80_20", TIME, "beat", "Time of the fall from 80 to 20 % of the amplitude."),
    Metric("diastolic_interval", TIME, "beat", "From the end of cd90 to the next beat's onset_time."),
    Metric("duty", NUMBER, "beat", "cd50 / beat_period."),
    Metric("contraction_velocity", VELOCITY, "beat", "Largest slope of the rise, over the window `metrics.velocity_s` "
           "(at least a frame).", "maximum contraction velocity, dF/dt max, contraction speed (BeatProfiler), "
           "contraction velocity (MicroBundlePillarTrack), over other windows"),
    Metric("relaxation_velocity", VELOCITY, "beat", "Most negative slope of the fall, over the same window.",
           "maximum relaxation velocity, -dF/dt max, relaxation speed (BeatProfiler), relaxation velocity "
           "(MicroBundlePillarTrack), over other windows"),
    Metric("mean_contraction_velocity", VELOCITY, "beat", "80 % of the amplitude over the time of the rise from 10 to "
           "90 %.", "contraction slope, Twitch Contraction Velocity (Pulse3D)", PULSE3D),
    Metric("area", LENGTH_TIME, "beat", "Integral of the height above the baseline over the beat.", "AUC, Area Under "
           "Curve (Pulse3D: above the chord at 10 % of the height)"),
)
"""Timing, size and speed of a beat, for any signal; as they stand, of the mean absolute displacement."""

SIGNALS = {"shortening": NUMBER, "subdomain": NUMBER, "pillar": FORCE, "trace": NUMBER}
"""Levels of the other signals that have these metrics too, and the kind of each signal."""
PREFIX: dict[Level, str] = {"shortening": "shortening_", "subdomain": "E_cc_", "pillar": "force_", "trace": "trace_"}
OF = {"shortening": "the tissue's shortening", "subdomain": "the sub-domain's E_cc (of the sign it has at its extreme)",
      "pillar": "the pillar's force along its own motion", "trace": "the trace"}


def _of_signal(level: Level) -> Iterator[Metric]:
    """The metrics of a beat's shape for another signal than the mean absolute displacement."""
    size = SIGNALS[level]
    for metric in SHAPE:
        kind = metric.kind if metric.kind in (TIME, NUMBER) else replace(size, time=metric.kind.time)
        yield replace(metric, key=PREFIX[level] + metric.key, kind=kind, level=level,
                      definition=f"Of {OF[level]}: {metric.definition[0].lower()}{metric.definition[1:]}")


METRICS: tuple[Metric, ...] = (
    Metric("tissue_length", LENGTH, "movie", "Extent of the tissue mask along the tissue's axis.", error=False),
    Metric("tissue_width", LENGTH, "movie", "Extent of the mask across the axis, at its centre.", source=PAPER,
           error=False),
    Metric("tissue_width_min", LENGTH, "movie", "Smallest extent across the axis in the middle part (necking).",
           error=False),
    Metric("tissue_width_min_at", LENGTH, "movie", "Place of the smallest width, from the centre along the axis.",
           error=False),
    Metric("tissue_area", AREA, "movie", "Area of the tissue mask.", error=False),
    Metric("tissue_angle", ANGLE, "movie", "Angle of the tissue's axis from the image's columns, clockwise.",
           error=False),
    Metric("drift", LENGTH, "movie", "Movement of the relaxed tissue from the first whole or cut beat to the last."),
    Metric("baseline_drift", VELOCITY, "movie", "Mean speed of the relaxed tissue's movement, from the first beat's "
           "rest to the last's."),
    Metric("lost_fraction", NUMBER, "movie", "Share of marker positions that could not be followed.", error=False),
    Metric("period_sd", TIME, "movie", "Standard deviation of beat_period.", "SDNN, SDRR (BeatProfiler)", RHYTHM),
    Metric("period_cv", NUMBER, "movie", "period_sd over the mean of beat_period.", "irregularity"),
    Metric("period_rmssd", TIME, "movie", "Root mean square of the differences of neighbouring beat periods.", "RMSSD; "
           "BeatProfiler's RMSSD is the root mean square of the periods themselves", RHYTHM),
    Metric("missed_beats", NUMBER, "movie", "Paced beats that were not answered: pulses of `metrics.pacing_hz`, from "
           "the first whole beat to the last, less the beats found, counted period by period.", error=False),
    Metric("extra_beats", NUMBER, "movie", "Beats beyond one to each pulse of `metrics.pacing_hz`.", error=False),
    Metric("alternans", NUMBER, "movie", "Mean of (even less odd amplitude) over the mean amplitude, each beat against "
           "the mean of its two neighbours, without sign.", "alternans ratio"),
    Metric("alternans_null", NUMBER, "movie", "Value of alternans when the order of the amplitudes is random (mean of "
           "200).", error=False),
    Metric("delay_range", TIME, "movie", "Difference between the latest and the earliest sub-domain's mean delay; "
           "0 below half a frame."),
    Metric("conduction_velocity", VELOCITY, "movie", "Speed of the straight front that fits the delays best; from 100 "
           "frames/s on, and where it stands out of its error.", "CV"),
    Metric("conduction_angle", ANGLE, "movie", "Direction in which the front travels, from the col axis of the tissue, "
           "positive towards +row."),
    Metric("beat_period", TIME, "beat", "Time from this beat's peak to the next beat's peak.", "RR interval "
           "(BeatProfiler), Twitch Period (Pulse3D), Peak-to-peak time (MUSCLEMOTION: from the peak before)", RHYTHM),
    Metric("beat_rate", RATE, "beat", "1 / beat_period.", "frequency, Twitch Frequency (Pulse3D)", PAPER),
    Metric("beat_rate", PER_MINUTE, "beat", "60 / beat_period in seconds.", "beats per minute, beat frequency "
           "(BeatProfiler, of the movie)"),
    *SHAPE,
    Metric("beat_drift", LENGTH, "beat", "Movement of this beat's relaxed state from the movie's."),
    Metric("e_cc_peak", NUMBER, "beat", "Most negative value over the beat of the mean E_cc of all sub-domains."),
    Metric("e_cc_min", NUMBER, "beat", "Most negative E_cc of any sub-domain and frame of the beat."),
    Metric("e_cc_max", NUMBER, "beat", "Most positive E_cc of any sub-domain and frame of the beat."),
    Metric("e_cc_heterogeneity", NUMBER, "beat", "Standard deviation of E_cc over sub-domains at the frame of "
           "e_cc_peak."),
    Metric("extending_fraction", NUMBER, "beat", "Share of sub-domains with positive E_cc at the frame of e_cc_peak.",
           error=False),
    Metric("synchrony_sd", TIME, "beat", "Standard deviation over sub-domains of the time of their largest |E_cc|."),
    Metric("synchrony_sd_of_period", NUMBER, "beat", "synchrony_sd / beat_period."),
    Metric("synchrony_sd_null", TIME, "beat", "Value of synchrony_sd when the sub-domains' traces are shifted in time "
           "at random (mean of 200).", error=False),
    Metric("synchrony_correlation", NUMBER, "beat", "Mean correlation of each sub-domain's |E_cc| trace with the mean "
           "of all."),
    Metric("synchrony_correlation_null", NUMBER, "beat", "Value of synchrony_correlation for traces shifted in time at "
           "random (mean of 200).", error=False),
    Metric("twitch_force", FORCE, "beat", "Mean over the pillars of force_amplitude.", "active force (BeatProfiler), "
           "Active Twitch Force (Pulse3D)"),
    Metric("imbalance", NUMBER, "beat", "(F1 - F2) / (F1 + F2) of the two pillars' force_amplitude."),
    Metric("stress_rectangle", STRESS, "beat", "twitch_force over the section width x depth: the tissue_width and "
           "`pillars.depth_um`.", "tissue_stress (MicroBundlePillarTrack, in MPa)", PILLAR_TOOL),
    Metric("stress_ellipse", STRESS, "beat", "twitch_force over the section pi/4 x width x depth.", "active stress "
           "(BeatProfiler, of a circle)"),
    Metric("force_shortening_loop", WORK, "beat", "Area of the loop of the mean force over the distance between the "
           "tissue's ends; positive where the force is larger while the tissue shortens.", "work loop"),
    Metric("force_strain_loop", FORCE, "beat", "Area of the loop of the mean force over the mean E_cc of all "
           "sub-domains, with the same sign."),
    *_of_signal("shortening"),
    Metric("markers", NUMBER, "subdomain", "Markers in the sub-domain.", error=False),
    Metric("E_cc_extreme", NUMBER, "subdomain", "E_cc of largest size within the beat, with its sign."),
    *_of_signal("subdomain"),
    Metric("delay", TIME, "subdomain", "E_cc_half_rise_time less its median over the "
           "sub-domains that shorten; empty where all delays lie within half a frame, which cannot be told."),
    *(Metric(f"{tensor}_{part}", NUMBER, "subdomain", f"{name} component {part} at the beat's peak frame.",
             source=PAPER)
      for tensor, name in (("F", "Deformation gradient"), ("E", "Green-Lagrange strain"))
      for part in (("rr", "rc", "cr", "cc") if tensor == "F" else ("rr", "rc", "cc"))),
    Metric("E_1", NUMBER, "subdomain", "Smaller principal Green-Lagrange strain at the beat's peak frame."),
    Metric("E_2", NUMBER, "subdomain", "Larger principal Green-Lagrange strain at the beat's peak frame."),
    Metric("E_1_angle", ANGLE, "subdomain", "Direction of E_1 from the col axis, positive towards +row.", error=False),
    Metric("E_fibre", NUMBER, "subdomain", "Strain along the fibres at the beat's peak frame: n'E n with n at "
           "`metrics.fibre_deg` from the col axis."),
    Metric("areal_strain", NUMBER, "subdomain", "det F - 1 at the beat's peak frame."),
    Metric("shear_max", NUMBER, "subdomain", "Largest shear (E_2 - E_1) / 2 at the beat's peak frame."),
    Metric("deflection", LENGTH, "pillar", "Twitch deflection along the pillar's own motion: peak less relaxed.",
           "mean absolute displacement (MicroBundlePillarTrack), deflection (BeatProfiler, of both together)"),
    Metric("deflection_row", LENGTH, "pillar", "Its part along the image's rows, at the beat's peak frame."),
    Metric("deflection_col", LENGTH, "pillar", "Its part along the image's columns, at the beat's peak frame."),
    Metric("deflection_axis", LENGTH, "pillar", "Its part along the axis from pillar to pillar, positive towards the "
           "other one, at the beat's peak frame."),
    *_of_signal("pillar"),
    Metric("force_absolute", FORCE, "pillar", "Length of the force's vector at the beat's peak frame.",
           "pillar_force_abs (published tools)", PAPER),
    Metric("force_row", FORCE, "pillar", "Force along the image's rows at the beat's peak frame.", "pillar_force_col "
           "(the published tools' files hold each other's)", PAPER),
    Metric("force_col", FORCE, "pillar", "Force along the image's columns at the beat's peak frame.",
           "pillar_force_row (the published tools' files hold each other's)", PAPER),
    Metric("force_axis", FORCE, "pillar", "Force along the axis from pillar to pillar at the beat's peak frame."),
    Metric("resting_force", FORCE, "pillar", "Force of the relaxed tissue, along the pillar's own motion, where the "
           "unloaded position is given.", "passive tension (BeatProfiler)", BEATPROFILER),
    Metric("work", WORK, "pillar", "Work done on the pillar from rest to peak: k/2 (x_peak^2 - x_rest^2), x from the "
           "unloaded position where it is given, else from rest.", "work per contraction cycle (BeatProfiler)",
           BEATPROFILER),
    Metric("power", POWER, "pillar", "work / force_time_to_peak_from_onset."),
    Metric("rotation", ANGLE, "pillar", "Rotation of the pillar's head in the picture at the beat's peak frame, "
           "clockwise: a check, for a pillar that bends hardly rotates."),
    Metric("pillar_drift", LENGTH, "pillar", "Movement of the pillar's relaxed position since the first beat."),
    Metric("pillar_deflection", LENGTH, "pillar_frame", "Distance of the pillar from its relaxed position, without "
           "drift.", error=False),
    Metric("pillar_deflection_row", LENGTH, "pillar_frame", "Its part along the image's rows."),
    Metric("pillar_deflection_col", LENGTH, "pillar_frame", "Its part along the image's columns."),
    Metric("pillar_deflection_axis", LENGTH, "pillar_frame", "Its part along the axis from pillar to pillar."),
    Metric("pillar_force", FORCE, "pillar_frame", "Force along the pillar's own motion, positive in contraction."),
    Metric("pillar_rotation", ANGLE, "pillar_frame", "Rotation of the pillar's head since the reference frame, "
           "clockwise.", error=False),
    *_of_signal("trace"),
    Metric("trace_period", TIME, "trace", "Time from this beat's peak to the next one's, of the trace."),
    *(Metric(f"contraction_delay_{mark}", TIME, "trace", f"From the trace's {mark} to that of the contraction nearest "
             "to it, within half a period.", error=False) for mark in ("onset", "half_rise", "peak")),
    Metric("mean_absolute_displacement", LENGTH, "frame", "Mean over markers of the distance from the movie's relaxed "
           "state.", "mean absolute displacement (MicroBundleCompute)", PAPER),
    Metric("mean_absolute_displacement_corrected", LENGTH, "frame", "mean_absolute_displacement less what noise adds "
           "to a mean of lengths, where the method knows its noise."),
    Metric("shortening", NUMBER, "frame", "Decrease of the distance between the two ends of the tracked tissue (mean "
           "place of the outermost tenth of the markers on each side), over that distance at rest.",
           "fractional shortening"),
    Metric("time", TIME, "frame", "Time of the frame.", error=False),
)

BY_KEY: dict[str, tuple[Metric, ...]] = {metric.key: tuple(m for m in METRICS if m.key == metric.key)
                                         for metric in METRICS}
"""Entries of each key; a rate has two, in Hz and in beats per minute."""

IDENTITY = ("beat", "frame", "subdomain", "pillar", "complete", "left_out", "relaxed", "start_frame", "peak_frame",
            "stop_frame", "reason")
"""Columns that name a row rather than measure something."""
