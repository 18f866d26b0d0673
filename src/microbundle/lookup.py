"""Look entries of the dictionary of metrics up, and put them into words, for people and for scripts."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Any

from .dictionary import BY_KEY, METRICS, Level, Metric, columns
from .errors import ConfigError

LEVELS: dict[Level, tuple[str, str]] = {
    "movie": ("Per movie", "summary.csv"),
    "beat": ("Per beat, by the mean absolute displacement", "beats.csv, and over the whole beats summary.csv"),
    "shortening": ("Per beat, by the tissue's length", "shortening.csv, and over the whole beats summary.csv"),
    "subdomain": ("Per sub-domain and beat", "subdomains.csv"),
    "pillar": ("Per pillar and beat", "pillars.csv"),
    "trace": ("Per beat of a second signal", "the table of `microbundle trace`"),
    "frame": ("Per frame", "frames.csv"),
    "pillar_frame": ("Per pillar and frame", "pillar_frames.csv"),
}
"""Each level's title, and where its numbers are written."""
IN_STRAIN = ("F_rr", "F_rc", "F_cr", "F_cc", "E_rr", "E_rc", "E_cc")
UNCALIBRATED, CALIBRATED = (None, None), (1.0, 1.0)
NEAR = 4


def entries(key: str) -> tuple[Metric, ...]:
    """Find the entries of a key, or of a column's name such as `amplitude_um`; raises ConfigError that names keys like
    it."""
    if key in BY_KEY:
        return BY_KEY[key]
    found = tuple(metric for metric in METRICS if key in _columns(metric))
    if found:
        return found
    near = get_close_matches(key, BY_KEY, n=NEAR, cutoff=0.5)
    near += [name for name in BY_KEY if key and key in name and name not in near][:NEAR]
    hint = f"Near: {', '.join(near[:NEAR])}" if near else "`microbundle metrics` lists them all"
    raise ConfigError(f"metrics: expected a key or column of the dictionary; found {key!r}. {hint}")


def units(metric: Metric, calibration: tuple[float | None, float | None]) -> list[str]:
    """Units in which a metric is written, given um/px and s/frame where they are known; `1` for a pure number."""
    return [name.removeprefix(metric.key).removeprefix("_") or "1" for name, _ in columns(metric, *calibration)]


def all_units(metric: Metric) -> str:
    """Units without calibration and with it, each once."""
    return ", ".join(dict.fromkeys(unit for known in (UNCALIBRATED, CALIBRATED) for unit in units(metric, known)))


def place(metric: Metric) -> str:
    """Tell in which tables a metric is written."""
    also = ", and in each frame strain.csv" if metric.level == "subdomain" and metric.key in IN_STRAIN else ""
    return LEVELS[metric.level][1] + also


def as_dict(metric: Metric) -> dict[str, Any]:
    """Put an entry into plain values, for JSON."""
    return {"key": metric.key, "level": metric.level, "written_in": place(metric), "definition": metric.definition,
            "units_uncalibrated": units(metric, UNCALIBRATED), "units_calibrated": units(metric, CALIBRATED),
            "standard_error": metric.error, "elsewhere": metric.elsewhere, "source": metric.source}


def entry_lines(metric: Metric) -> Iterator[str]:
    """Describe one entry in lines of text."""
    yield metric.key
    yield f"  definition      {metric.definition}"
    yield f"  unit            {_or(units(metric, CALIBRATED))}; {_or(units(metric, UNCALIBRATED))} without calibration"
    yield f"  level           {LEVELS[metric.level][0].lower()}"
    yield f"  written in      {place(metric)}"
    yield f"  standard error  {', '.join(_error_columns(metric)) if metric.error else 'no'}"
    yield f"  elsewhere       {metric.elsewhere or '-'}"
    yield f"  source          {metric.source or '-'}"


def list_lines() -> Iterator[str]:
    """List every key with its units and definition, level by level."""
    wide = max(len(metric.key) for metric in METRICS)
    for level, (title, table) in LEVELS.items():
        yield f"{title} ({table})"
        for metric in METRICS:
            if metric.level == level:
                yield f"  {metric.key:<{wide}}  {all_units(metric):<22}  {metric.definition}"
        yield ""


def _columns(metric: Metric) -> set[str]:
    """Names of all columns that a metric may be written in, with those of its standard error."""
    known = (UNCALIBRATED, CALIBRATED, (1.0, None), (None, 1.0))
    return {name for um, s in known for error in (False, True)[:1 + metric.error]
            for name, _ in columns(metric, um, s, error=error)}


def _error_columns(metric: Metric) -> list[str]:
    """Columns of the standard error; in the summary it has one name for all."""
    own = [] if metric.level == "movie" else [name for name, _ in columns(metric, *CALIBRATED, error=True)]
    return own + ["se in summary.csv"] * ("summary" in place(metric))


def _or(names: list[str]) -> str:
    return " and ".join(names) or "not written"
