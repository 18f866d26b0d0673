"""Names and definitions of other tools' numbers for a beat, as their papers and programs state them.

`compat` computes them; docs/compat.md is written from here. In a column's name `{size}` stands for the unit of the
signal (um, px, uN), `{time}` for that of time (as the tool writes it, or frames where times are unknown), `{per}` for
its singular, `{rate}` for that of a frequency, and `{level}` for each of the levels in percent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ToolName = Literal["musclemotion", "beatprofiler", "pulse3d", "pillartrack"]


@dataclass(frozen=True)
class Column:
    """One number of another tool."""

    name: str
    definition: str
    """As that tool has it."""
    ours: str
    """Key of the nearest metric of the dictionary, or the empty string."""
    difference: str
    """In what theirs and ours differ."""
    levels: tuple[int, ...] = ()


@dataclass(frozen=True)
class Tool:
    """Another tool, and the numbers that it gives for a beat."""

    title: str
    source: str
    """Paper, and the version of the program that the definitions were read from."""
    signal: str
    """What that tool measures, and what stands for it here."""
    units: tuple[str, str, str]
    """How it writes time, one unit of it, and a frequency."""
    columns: tuple[Column, ...]
    left_out: str


TENS = tuple(range(10, 100, 10))
FROM_LOWEST = ("theirs counts from the lowest frame before the peak, in whole frames; ours from the line through both "
               "rests, between frames")
TO_PROMINENCE = ("theirs is a share of the prominence, above the higher of the two valleys; ours of the height above "
                 "the line through both rests")
TO_VALLEYS = "theirs counts each side from its own valley; ours from the line through both rests"


TOOLS: dict[str, Tool] = {
    "musclemotion": Tool(
        "MUSCLEMOTION", "Sala et al., Circ. Res. 122 (2018) e5, doi 10.1161/CIRCRESAHA.117.312067; macro 1.1 beta, "
        "with its default settings", "There the mean absolute difference of the grey values from a reference frame, in "
        "arbitrary units; here the mean absolute displacement, whose times are comparable, but not its sizes.",
        ("ms", "ms", "Hz"), (
            Column("Contraction duration [10% above baseline] ({time})", "From the rise to the fall through 10 % of "
                   "the contraction amplitude. A level is passed at the first of three frames in a row below it, from "
                   "the peak outwards.", "cd90", FROM_LOWEST),
            Column("Time-to-peak ({time})", "From the rise through 10 % to the peak frame.", "time_to_peak",
                   FROM_LOWEST),
            Column("Relaxation Time ({time})", "From the peak frame to the fall through 10 %.", "relax90", FROM_LOWEST),
            Column("{level}-to-{level} transient ({time})", "From the rise to the fall through 100 less this "
                   "percentage of the contraction amplitude: 90-to-90 is the width at 10 % of the height.",
                   "cd90, cd50, cd10", FROM_LOWEST, (90, 50, 10)),
            Column("Peak-to-peak time ({time})", "From the peak before to this peak, in whole frames.", "beat_period",
                   "ours is from this peak to the next, between frames"),
            Column("Baseline value ({size})", "Lowest value of the signal from half way between the peak before and "
                   "this one to this one.", "", "ours has the level of the rests subtracted from the signal"),
            Column("Peak amplitude ({size})", "Value of the signal at the peak frame.", "amplitude",
                   "ours is above the baseline"),
            Column("Contraction amplitude ({size})", "Peak amplitude less baseline value.", "amplitude", FROM_LOWEST),
        ), "Speed of contraction: it comes from differences of grey values between frames, not from the signal above."),
    "beatprofiler": Tool(
        "BeatProfiler", "Kim et al., IEEE Open J. Eng. Med. Biol. (2024), \"BeatProfiler: Multimodal in vitro analysis "
        "of cardiac function\"; beatprofiler.py of February 2024", "With two pillars and a known pixel size: how much "
        "nearer they are than without load, as in its pillar analysis (the distance at rest cancels). Else the mean "
        "absolute displacement stands for its brightfield trace (the mean change of grey values, in arbitrary units). "
        "Only whole beats have numbers.", ("s", "s", "Hz"), (
            Column("beat index", "Frame of the peak.", "peak_frame", "ours is the peak of the contraction signal"),
            Column("tau [{time}]", "From the peak to where the fall passes 1/e (37 %) of the prominence.", "relax50, "
                   "relax90", "another level; " + TO_PROMINENCE),
            Column("fwhm [{time}]", "Width at half of the prominence, between frames.", "cd50", TO_PROMINENCE),
            Column("contract50 [{time}]", "From the rise through half of the prominence to the peak frame.", "",
                   "our half_rise_time is that moment, on the clock of the movie"),
            Column("relax50 [{time}]", "From the peak frame to the fall through half of the prominence.", "relax50",
                   TO_PROMINENCE),
            Column("fw90m [{time}]", "Width at 90 % of the prominence below the peak.", "cd90", TO_PROMINENCE),
            Column("contract90 [{time}]", "From the rise through 10 % of the prominence to the peak frame.",
                   "time_to_peak", TO_PROMINENCE),
            Column("relax90 [{time}]", "From the peak frame to the fall through 10 % of the prominence.", "relax90",
                   TO_PROMINENCE),
            Column("raw amplitude [{size}]", "Prominence of the peak: height above the higher of the lowest values on "
                   "both sides, as far as the next higher peak. Of the brightfield trace.", "amplitude",
                   TO_PROMINENCE),
            Column("deflection [um]", "The same, of the distance between the pillars: that of both together.",
                   "deflection", "ours is of each pillar, along its own motion"),
            Column("contraction speed [{size}/{per}]", "Largest slope (central differences) between the valleys before "
                   "and after the peak.", "contraction_velocity", "ours is taken over one frame instead of two, "
                   "before the peak only"),
            Column("relaxation speed [{size}/{per}]", "Most negative slope between these valleys, without its sign.",
                   "relaxation_velocity", "ours is the same, after the peak only, and negative"),
            Column("active length [um]", "Distance between the pillars at the peak frame.", "", "no such number"),
            Column("passive length [um]", "active length plus deflection.", "", "no such number"),
            Column("active force [uN]", "Coefficient of force times how much nearer the pillars are at the peak than "
                   "at the largest distance of the movie. The coefficient is half of a pillar's stiffness here, as "
                   "both pillars share the way.", "twitch_force",
                   "ours counts from the relaxed state of the same beat"),
            Column("active stress [mN/mm2]", "active force over a circle whose diameter is the tissue's width.", "",
                   "our stress_ellipse takes the depth for the other axis; mN/mm2 are kPa"),
            Column("total force [uN]", "Coefficient times how much nearer the pillars are at the peak than without "
                   "load (`pillars.unloaded_px`).", "", "ours is force_amplitude + resting_force, of each pillar"),
            Column("passive tension [uN]", "Coefficient times how much nearer they are at passive length than without "
                   "load.", "resting_force", "ours is of each pillar, along its own motion"),
            Column("work per contraction cycle [nJ]", "Half of the coefficient times the difference of the squares of "
                   "these two ways.", "work", "ours is of each pillar"),
        ), "auc and amplitude [dF/F0]: they need the fluorescence baseline. In its summary of a movie `RMSSD` is the "
        "root mean square of the periods themselves, not of their successive differences (period_rmssd)."),
    "pulse3d": Tool(
        "Pulse3D (Curi Bio)", "Program pulse3D, src/pulse3D/metrics.py and constants.py, as public in 2022 and 2023; "
        "no paper states the definitions", "There the force of a tissue; here that of each pillar along its own motion "
        "where stiffness and pixel size are known, else the mean absolute displacement, of which the tool would write "
        "`Twitch Amplitude`. Only whole beats have numbers; a valley is the lowest frame between two peaks.",
        ("seconds", "second", "Hz"), (
            Column("Twitch Period ({time})", "From this peak to the next, in whole frames.", "beat_period",
                   "ours is between frames"),
            Column("Twitch Frequency ({rate})", "1 / Twitch Period.", "beat_rate", "ours is between frames"),
            Column("{amplitude} ({size})", "Mean of the heights of the peak above the valley before and that after.",
                   "force_amplitude, amplitude", "ours is the height above the line through both rests"),
            Column("Fraction of Maximum {amplitude}", "That over the largest of all beats. (The tool writes the unit "
                   "of the amplitude behind it.)", "", "no such number"),
            Column("Area Under Curve ({size} * {per})", "Area between the signal and the straight line that joins its "
                   "two points 90 % below the peak.", "force_area, area", "ours is above the line through both rests, "
                   "over the whole beat. The tool takes one trapezium from the wrong side, which is not repeated"),
            Column("Twitch Contraction Velocity ({size}/{per})", "Mean slope of the rise from 90 to 10 % below the "
                   "peak.", "force_mean_contraction_velocity, mean_contraction_velocity", TO_VALLEYS),
            Column("Twitch Relaxation Velocity ({size}/{per})", "Mean slope of the fall from 10 to 90 % below the "
                   "peak, without its sign.", "", "our relaxation_velocity is the steepest slope"),
            Column("Twitch Interval Irregularity ({time})", "Difference of the periods before and after this peak, "
                   "without its sign.", "period_rmssd",
                   "ours is the root mean square over the movie, of periods between frames"),
            Column("Twitch Width {level} ({time})", "From the rise to the fall through the point this percentage below "
                   "the peak, between frames.", "force_cd10 to force_cd90, cd10 to cd90", TO_VALLEYS, TENS),
            Column("Time From Contraction {level} to Peak ({time})", "From where the rise has reached this percentage "
                   "to the peak frame.", "force_time_to_peak, time_to_peak (10)", TO_VALLEYS, (10, 50, 90)),
            Column("Time From Peak to Relaxation {level} ({time})", "From the peak frame to where the fall has gone "
                   "this percentage of the way down.", "force_relax50, force_relax90", TO_VALLEYS, (10, 50, 90)),
        ), "Times from and to the baseline: the versions differ (the valley's frame, or 10 and 90 %). Filters and the "
        "tool's own detection of peaks are not repeated: beats are those of this program."),
    "pillartrack": Tool(
        "MicroBundlePillarTrack", "Kobeissi et al., microPubl. Biol. (2024), doi 10.17912/micropub.biology.001231; "
        "pillar_analysis.py", "Length of a pillar's mean displacement: there from the first frame, after cutting the "
        "movie to begin in a valley; here from the relaxed reference frame, with drift, without splitting into beats. "
        "One row for each pillar; no rows without pillars. On a real movie, tracked as published (`--method paper`), "
        "times and force are those of the published tracks to 0.5 %.", ("s", "s", "Hz"), (
            Column("beat_peaks", "Frame of the peak.", "peak_frame", "ours is the tissue's"),
            Column("t50 ({time})", "Width at half of the prominence, between frames.", "force_cd50", TO_PROMINENCE),
            Column("t80 ({time})", "Width at 80 % of the prominence below the peak.", "force_cd80", TO_PROMINENCE),
            Column("mean absolute displacement ({size})", "Value of the signal at the peak frame.", "deflection",
                   "ours is along the pillar's own motion, from the relaxed state of the same beat"),
            Column("contraction velocity ({size}/{per})", "Largest value around the beat of the differences from frame "
                   "to frame, averaged over three.", "force_contraction_velocity", "ours is of the force, over "
                   "`metrics.velocity_s`"),
            Column("relaxation velocity ({size}/{per})", "Most negative value of the same.",
                   "force_relaxation_velocity", "the same as above"),
            Column("pillar_force_abs (uN)", "Stiffness times the mean absolute displacement at the peak frame.",
                   "force_absolute", "ours is from the relaxed state of the same beat"),
            Column("tissue_stress (MPa)", "Largest value over the beat of the pillars' mean force over width x depth.",
                   "stress_rectangle", "ours is in kPa, of the mean twitch force"),
        ), "pillar_force_row and pillar_force_col: the tool's files hold each other's force. Its width of the tissue "
        "is that of a thresholded picture between the pillars; here it is `tissue_width`."),
}


def names(column: Column, **parts: str) -> list[str]:
    """Write a column's name, once for each of its levels, with units and other parts put in."""
    return [column.name.format(level=level, **parts) for level in column.levels or ("",)]
