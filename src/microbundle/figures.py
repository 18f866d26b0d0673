"""Pictures of a result, ready for a paper: `draw` makes one, `save_all` writes all.

    figure = microbundle.figures.draw(analysis, "displacement")
    figure.savefig("displacement.pdf")

A figure is one or two columns of a journal wide, has physical units and a scale bar where the calibration is known, and
px and frames where not. `KINDS` lists what there is. A result that has no data for a kind, such as pillars, gives no
figure but a reason (`why_not`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from . import figures_maps as maps
from . import figures_quality as quality
from . import figures_traces as traces
from .analysis import Analysis
from .errors import CannotMeasure, ConfigError, OutputError
from .shown import Shown
from .style import ONE_COLUMN_MM, TWO_COLUMNS_MM, limits_of, settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Limits = tuple[float, float]
FORMATS = ("png", "pdf", "svg", "tif", "eps", "jpg")
_BEATS, _STRAIN, _PILLARS = "beats", "strain", "pillars"


@dataclass(frozen=True)
class Kind:
    """One kind of figure."""

    text: str
    """What it shows."""
    make: Callable[[Shown, float, Limits | None], Figure]
    needs: tuple[str, ...] = ()
    limited: Callable[[Shown], Limits] | None = None
    """Limits that hold all its values, for those that can share them."""
    columns: int = 1


def _displacement(kind: str) -> Kind:
    text = {"displacement": "length", "displacement_row": "row part", "displacement_col": "column part"}[kind]
    return Kind(f"Displacement at the peak: {text}",
                lambda s, w, l: maps.displacement(s, w, kind, l, arrows=kind == "displacement"), (_BEATS,),
                lambda s: maps.displacement_limits(s, kind))


def _strain_map(part: str) -> Kind:
    return Kind(f"Strain E_{part} of each sub-domain at the peak", lambda s, w, l: maps.strain_map(s, w, part, l),
                (_BEATS, _STRAIN), lambda s: limits_of(maps.strain_values(s, part), symmetric=True))


def _strain_series(part: str) -> Kind:
    return Kind(f"Strain E_{part} of each sub-domain over time", lambda s, w, l: traces.strain_series(s, w, part, l),
                (_BEATS, _STRAIN), lambda s: traces.series_limits(s, part), columns=2)


KINDS: Mapping[str, Kind] = {
    "tissue": Kind("Masks of tissue and pillars, and the tissue's axis", lambda s, w, _: maps.tissue(s, w)),
    "markers": Kind("Markers that were followed", lambda s, w, _: maps.markers(s, w)),
    **{kind: _displacement(kind) for kind in ("displacement", "displacement_row", "displacement_col")},
    "signal": Kind("Mean displacement with beats, peaks, relaxed levels and drift", traces.signal,
                   limited=lambda s: limits_of(s.signal, symmetric=False), columns=2),
    "beats": Kind("All beats laid over each other, and their mean", traces.beats, (_BEATS,),
                  lambda s: limits_of(traces.signal_from_rest(s), symmetric=False)),
    "subdomains": Kind("Which sub-domain is where", lambda s, w, _: maps.subdomains(s, w), (_STRAIN,)),
    **{f"strain_{part}": _strain_map(part) for part in ("cc", "cr", "rr")},
    **{f"strain_{part}_series": _strain_series(part) for part in ("cc", "cr", "rr")},
    "principal": Kind("Directions of the principal strains", lambda s, w, _: maps.principal(s, w), (_BEATS, _STRAIN)),
    "delay": Kind("Delay of each sub-domain", maps.delay, (_BEATS, _STRAIN, "delay"),
                  lambda s: limits_of(maps.delay_values(s), symmetric=True)),
    "pillar_displacement": Kind("Deflection of the pillars", traces.pillar_displacement, (_PILLARS,),
                                traces.pillar_limits),
    "force": Kind("Force of the pillars", traces.force, (_PILLARS, "force"), traces.force_limits),
    "force_length": Kind("Force over the tissue's length", traces.force_length, (_PILLARS, "force", _BEATS),
                         traces.force_limits),
    "quality": Kind("Verdict and findings", lambda s, w, _: quality.quality(s, w)),
}
"""Every kind of figure, by name."""


@dataclass(frozen=True)
class Saved:
    """What `save_all` wrote, and what it left out."""

    files: tuple[Path, ...]
    left_out: Mapping[str, str]
    """Kind -> why there is no such figure."""


def draw(analysis: Analysis, kind: str, *, limits: Limits | None = None, beat: int | None = None,
         width_mm: float | None = None) -> Figure:
    """Draw one kind of figure of a result.

    `limits` are the ends of the colour bar or of the vertical axis, in the unit shown; without them they follow the
    data (`shared_limits` makes common ones). `beat` shows one beat; without it maps are means over the whole beats.
    The default width is that of one column of a journal (85 mm), or two for series. The figure is matplotlib's, and
    belongs to no window. Raises ConfigError for an unknown kind, beat or limits, CannotMeasure for a kind that the
    result has no data for.
    """
    return _draw(Shown(analysis, beat), kind, limits, width_mm)


def why_not(analysis: Analysis, kind: str) -> str:
    """Tell why a result has no figure of a kind; the empty string where it has one. Raises ConfigError."""
    return _why_not(Shown(analysis), kind)


def shared_limits(analyses: Iterable[Analysis], kinds: Sequence[str] | None = None) -> dict[str, Limits]:
    """Find limits that hold the values of all results, so that their figures can be compared: kind -> (low, high).

    Kinds without limits, or without data in any of the results, are left out. Lengths must have one unit: raises
    ConfigError where the pixel size is known of some results only.
    """
    out: dict[str, Limits] = {}
    units = set()
    for analysis in analyses:
        shown = Shown(analysis)
        units.add((shown.length_unit, shown.time_unit))
        if len(units) > 1:
            raise ConfigError("shared limits: expected results of one unit; the pixel size or the frame rate is known "
                              "of some of them only. Give --um-per-px and --fps for all")
        for name, (low, high) in _own_limits(shown, kinds).items():
            before = out.get(name, (low, high))
            out[name] = min(low, before[0]), max(high, before[1])
    return out


def own_limits(analysis: Analysis, kinds: Sequence[str] | None = None) -> dict[str, Limits]:
    """Find the limits that the figures of one result have where none are given: kind -> (low, high).

    Kinds without limits or data are left out. Raises ConfigError for an unknown kind.
    """
    return _own_limits(Shown(analysis), kinds)


def _own_limits(shown: Shown, kinds: Sequence[str] | None) -> dict[str, Limits]:
    limited = ((name, KINDS[name].limited) for name in _checked(kinds) if not _why_not(shown, name))
    return {name: find(shown) for name, find in limited if find is not None}


def save_all(analysis: Analysis, folder: Path | str, *, formats: Sequence[str] = ("png", "pdf"),
             kinds: Sequence[str] | None = None, limits: Mapping[str, Limits] | None = None) -> Saved:
    """Write all figures, or those of some kinds, into a folder: `KIND.png`, `KIND.pdf`.

    Kinds that the result has no data for are left out, with the reason. Raises ConfigError for an unknown kind or
    format, OutputError where the folder cannot be written.
    """
    unknown = set(formats) - set(FORMATS)
    if unknown:
        raise ConfigError(f"formats: expected some of {', '.join(FORMATS)}; found {', '.join(sorted(unknown))}")
    folder, shown = Path(folder), Shown(analysis)
    files, left_out = [], {}
    for kind in _checked(kinds):
        why = _why_not(shown, kind)
        if why:
            left_out[kind] = why
            continue
        figure = _draw(shown, kind, (limits or {}).get(kind), None)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in formats:
                file = folder / f"{kind}.{name}"
                with settings():
                    figure.savefig(file, metadata={"CreationDate": None} if name == "pdf" else None)
                files.append(file)
        except OSError as error:
            raise OutputError(f"{folder}: the figures cannot be written: {error.strerror or error}") from None
    return Saved(tuple(files), left_out)


def _draw(shown: Shown, kind: str, limits: Limits | None, width_mm: float | None) -> Figure:
    why = _why_not(shown, kind)
    if why:
        raise CannotMeasure(f"figure {kind}: {why}")
    if limits is not None and not (np.isfinite(limits).all() and limits[0] < limits[1]):
        raise ConfigError(f"limits: expected two numbers, the lower first; found {limits}")
    with settings():
        return KINDS[kind].make(shown, width_mm or (ONE_COLUMN_MM, TWO_COLUMNS_MM)[KINDS[kind].columns - 1], limits)


def _why_not(shown: Shown, kind: str) -> str:
    needs, analysis = KINDS[_checked([kind])[0]].needs, shown.analysis
    if _BEATS in needs and len(analysis.beats) == 0:
        return "the movie has no beats"
    if _STRAIN in needs and (analysis.strain is None or not np.isfinite(analysis.strain.F).any()):
        return "no sub-domain has a strain"
    if _PILLARS in needs and (analysis.pillars is None or not np.isfinite(analysis.pillars.shift_px).any()):
        return "no pillars were followed"
    if "force" in needs and not np.isfinite(shown.un_per_length):
        return "the stiffness of the pillars or the pixel size is not known"
    if "delay" in needs and not np.isfinite(shown.delay).any():
        return "the delays lie below half a frame, which cannot be told"
    return ""


def _checked(kinds: Sequence[str] | None) -> Sequence[str]:
    unknown = [kind for kind in kinds or () if kind not in KINDS]
    if unknown:
        raise ConfigError(f"kinds: expected some of {', '.join(KINDS)}; found {', '.join(unknown)}")
    return tuple(KINDS) if kinds is None else kinds
