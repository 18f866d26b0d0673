"""The dictionary of metrics: every key has one definition, and one unit for each calibration.

It names the columns of all tables. Nothing is written that is not in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["length", "area", "time", "rate", "rate_per_min", "number", "angle"]
UNITS: dict[Kind, tuple[str, str]] = {
    "length": ("px", "um"), "area": ("px2", "um2"), "time": ("frames", "s"), "rate": ("per_frame", "hz"),
    "rate_per_min": ("", "bpm"), "number": ("", ""), "angle": ("deg", "deg"),
}
"""Unit without calibration and unit with it, for each kind of quantity."""


@dataclass(frozen=True)
class Metric:
    """One entry of the dictionary."""

    key: str
    kind: Kind
    level: Literal["movie", "beat", "subdomain", "frame"]
    definition: str

    @property
    def has_error(self) -> bool:
        """Whether its standard error is written beside it, in the column `key_se_unit`, or `se` in the summary."""
        return (self.level != "movie" or self.key == "drift") and self.key not in NO_ERROR


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
           "relaxed frames; displacement is taken from the beat's own relaxed state, and what noise adds to a mean of "
           "lengths is subtracted where the method knows it."),
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
    Metric("mean_absolute_displacement_corrected", "length", "frame", "mean_absolute_displacement less what noise adds "
           "to a mean of lengths, where the method knows its noise."),
    Metric("time", "time", "frame", "Time of the frame."),
)

NO_ERROR = ("extending_fraction", "synchrony_sd_null", "synchrony_correlation_null", "markers", "E_1_angle", "time")
"""Counts, angles (an error has no meaning across 180 degrees) and values that chance alone gives."""

IDENTITY = ("beat", "frame", "subdomain", "complete", "relaxed", "start_frame", "peak_frame", "stop_frame", "reason")
"""Columns that name a row rather than measure something."""


def column(metric: Metric, calibrated: bool, *, error: bool = False) -> str:
    """Make the column name of a metric, or of its standard error: its key, with the unit where it has one."""
    unit = UNITS[metric.kind][int(calibrated)]
    return "_".join([metric.key, *["se"] * error, *[unit] * bool(unit)])
