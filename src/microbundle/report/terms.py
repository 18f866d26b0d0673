"""Names, units and definitions of metrics as people read them, all from the dictionary of metrics."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from ..analysis import Analysis
from ..dictionary import METRICS, Metric, columns
from ..numbers import seconds_per_frame
from .page import Html, escape, tag

UNITS = {"": "", "px": "px", "um": "µm", "px2": "px²", "um2": "µm²", "s": "s", "frames": "frames", "hz": "Hz",
         "bpm": "beats/min", "deg": "°", "un": "µN", "kpa": "kPa", "nj": "nJ", "nw": "nW", "un_s": "µN s",
         "un_frames": "µN frames", "px_frames": "px frames", "um_s": "µm s", "um_frames": "µm frames", "px_s": "px s",
         "per_frame": "1/frame", "per_s": "1/s"}
NAMED = {"beat_rate": "Beat rate", "beat_period": "Beat period", "amplitude": "Contraction amplitude",
         "shortening_amplitude": "Fractional shortening", "e_cc_peak": "Peak strain E_cc, mean of sub-domains",
         "e_cc_min": "Strongest contraction E_cc", "e_cc_max": "Strongest stretch E_cc",
         "cd50": "Contraction duration CD50", "relax50": "Relaxation time R50", "twitch_force": "Twitch force",
         "contraction_velocity": "Contraction velocity", "relaxation_velocity": "Relaxation velocity",
         "time_to_peak": "Time to peak", "synchrony_sd": "Spread of peak times", "tissue_width": "Tissue width",
         "tissue_length": "Tissue length", "stress_ellipse": "Contractile stress", "imbalance": "Imbalance of pillars"}
"""Names of the metrics that most readers look at; the others are called by their key."""


@dataclass(frozen=True)
class Term:
    """One column of the tables: what it is called, in which unit, and what it means."""

    column: str
    metric: Metric
    unit: str
    error_column: str | None

    @property
    def name(self) -> str:
        """What people call it."""
        plain = re.sub(r"\b([EF]) (rr|rc|cr|cc|1|2)\b", r"\1_\2", self.metric.key.replace("_", " "))
        plain = re.sub(r"\b(cd\d+|cv|sd|rmssd)\b", lambda found: found[1].upper(), plain).replace("e cc", "E_cc")
        return NAMED.get(self.metric.key, plain[0].upper() + plain[1:])

    @property
    def tip(self) -> str:
        """Its definition, its key, and what other tools call it."""
        elsewhere = f" Elsewhere: {self.metric.elsewhere}." if self.metric.elsewhere else ""
        return f"{self.metric.definition}{elsewhere} (column {self.column})"


def terms(analysis: Analysis) -> dict[str, Term]:
    """Find the term of every column that this calibration allows; of a length in px and um, both."""
    calibration = analysis.um_per_px, seconds_per_frame(analysis)
    out = {}
    for metric in METRICS:
        errors = [name for name, _ in columns(metric, *calibration, error=True)] if metric.error else []
        for i, (name, _) in enumerate(columns(metric, *calibration)):
            unit = name.removeprefix(metric.key).removeprefix("_")
            out[name] = Term(name, metric, pretty(unit), errors[i] if errors else None)
    return out


@cache
def _any_calibration() -> dict[str, Term]:
    out: dict[str, Term] = {}
    for um_per_px in (1.0, None):
        for step_s in (1.0, None):
            for metric in METRICS:
                for name, _ in columns(metric, um_per_px, step_s):
                    unit = name.removeprefix(metric.key).removeprefix("_")
                    out.setdefault(name, Term(name, metric, pretty(unit), None))
    return out


def term_of(column: str) -> Term:
    """Find the term of a column, whatever the calibration of its movie. Raises KeyError for what is no metric."""
    return _any_calibration()[column]


def pretty(unit: str) -> str:
    """Write a column's unit as people do: um_per_s becomes µm/s."""
    if unit in UNITS:
        return UNITS[unit]
    above, _, below = unit.partition("_per_")
    return f"{UNITS.get(above, above)}/{UNITS.get(below, below)}"


def best_unit(known: Mapping[str, Term], columns_there: list[str]) -> list[Term]:
    """Terms of the columns that are there, without those in px of which there is one in um."""
    found = [known[name] for name in columns_there if name in known]
    physical = {term.metric.key for term in found if term.unit in ("µm", "µm²")}
    return [term for term in found if not (term.unit in ("px", "px²") and term.metric.key in physical)]


def label(text: str) -> Html:
    """Write E_cc with its index below the line."""
    return Html(re.sub(r"\b([EF])_(rr|rc|cr|cc|1|2)\b", r"\1<sub>\2</sub>", str(escape(text))))


def explained(term: Term) -> Html:
    """Write a term's name with its definition, which shows on hover and focus."""
    return tag("span", label(term.name), class_="term", tabindex="0", data_tip=term.tip)
