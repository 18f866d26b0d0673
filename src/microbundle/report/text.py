"""The words of a report: how the movie was measured, ready for a paper, and where every number comes from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from ..analysis import Analysis
from ..config import Config, flat
from ..decisions import MarkBeat
from ..draws import COUNT as DRAWS
from ..force import stiffness
from .page import number

PAPER = ("Kobeissi H, Jilberto J, Karakan MÇ, Gao X, DePalma SJ, Das SL, Quach L, Urquia J, Baker BM, Chen CS, "
         "Nordsletten D, Lejeune E. MicroBundleCompute: Automated segmentation, tracking, and analysis of subdomain "
         "deformation in cardiac microbundles. PLOS ONE 19(3): e0298863 (2024). doi:10.1371/journal.pone.0298863")
SOURCES = {"file": "as its file says", "user": "as given by the user"}
NOT_OF_METHOD = ("method", "fps", "um_per_px")
"""Settings that the paragraph mentions in its own words."""


def summary_sentence(analysis: Analysis) -> str:
    """Say in one sentence what was looked at."""
    whole, out = int(analysis.beats.complete.sum()), int(analysis.beats.left_out.sum())
    beats = len(analysis.beats) - out
    rate = analysis_rate(analysis)
    duration = "" if analysis.time_s is None else f" ({number(float(analysis.time_s[-1] - analysis.time_s[0]), 3)} s)"
    cut = f", and {_count(beats - whole, 'beat')} that the movie cuts off" if beats > whole else ""
    by_person = f", {_count(out, 'beat')} that a person left out" if out else ""
    return (f"{_count(whole, 'whole beat')}{cut}{by_person}, in {_count(analysis.frame_count, 'frame')}{duration} of "
            f"{analysis.image.shape[0]} × {analysis.image.shape[1]} px{rate}; method {analysis.config.method}.")


def analysis_rate(analysis: Analysis) -> str:
    """Name the frame rate and the pixel size, where they are known."""
    parts = []
    if analysis.time_s is not None and len(analysis.time_s) > 1:
        parts.append(f"{1 / np.median(np.diff(analysis.time_s)):.4g} frames/s")
    if analysis.um_per_px is not None:
        parts.append(f"{analysis.um_per_px:.4g} µm/px")
    return f" at {', '.join(parts)}" if parts else ", without known frame rate and pixel size"


def methods_paragraph(analysis: Analysis) -> str:
    """Write the paragraph of a paper that says how this movie was measured; it cites `references` by number."""
    parts = [*_about_movie(analysis), _about_tissue(analysis), *_about_motion(analysis), *_about_beats(analysis),
             *_about_strain(analysis), *_about_pillars(analysis), _about_errors(analysis)]
    changed = [f"{name} = {value}" for name, value in changed_settings(analysis.config).items()
               if name not in NOT_OF_METHOD]
    parts.append(f"Settings other than the defaults: {', '.join(changed)}." if changed
                 else "All other settings were the defaults.")
    return " ".join(parts)


def references(analysis: Analysis) -> list[str]:
    """The works that the paragraph cites, in its order."""
    version = analysis.versions.get("microbundle", "unknown")
    return [f"The microbundle developers. microbundle: displacement, strain and beat metrics from movies of cardiac "
            f"microbundles. Version {version}.", PAPER]


def _about_movie(a: Analysis) -> Iterator[str]:
    yield (f"Displacement, strain and beats were measured with microbundle {a.versions.get('microbundle', '')} [1], "
           "which builds on MicroBundleCompute [2]")
    yield f"(method “{a.config.method}”)."
    time = "an unknown frame rate (times are in frames)" if a.time_s is None else \
        f"{1 / np.median(np.diff(a.time_s)):.4g} frames/s ({SOURCES.get(a.time_source, 'source unknown')})"
    size = "an unknown pixel size (lengths are in pixels)" if a.um_per_px is None else \
        f"{a.um_per_px:.4g} µm/px ({SOURCES.get(a.um_per_px_source, 'source unknown')})"
    yield f"The movie had {a.frame_count} frames of {a.image.shape[0]} × {a.image.shape[1]} px at {time} and {size}."


def _about_tissue(a: Analysis) -> str:
    if a.masks.method == "supplied":
        return "The tissue's mask was supplied."
    sure = "" if a.masks.stability is None else \
        f", overlapping by at least {100 * a.masks.stability:.0f} % with the masks of slightly different settings"
    return f"The tissue was segmented automatically (“{a.masks.method}”{sure})."


def _about_motion(a: Analysis) -> Iterator[str]:
    frame = a.tracks.reference_frame
    if a.tracks.field is not None:
        yield (f"Every frame was registered against the relaxed tissue (frame {frame}): the displacement is a cubic "
               f"B-spline on knots {a.tracks.field.spacing_px:.4g} px apart, found by least squares of grey values "
               "with a bending energy, and reduced to the patterns that stand out of the noise.")
    elif a.config.method == "paper":
        yield "Displacement was tracked as published (Shi-Tomasi corners, pyramidal Lucas-Kanade) [2]."
    else:
        yield (f"{len(a.markers)} points of the tissue were followed from frame {frame} by pyramidal Lucas-Kanade in "
               f"windows of {a.tracks.window_px} px.")


def _about_beats(a: Analysis) -> Iterator[str]:
    whole, out = int(a.beats.complete.sum()), int(a.beats.left_out.sum())
    count = len(a.beats) - out
    if len(a.beats) == 0:
        yield "No beat was found above the movie's detection limit."
        return
    cut = f" ({count - whole} more cut off by the movie's ends)" if count > whole else ""
    yield (f"{_count(whole, 'whole beat')}{cut} {'was' if whole == 1 else 'were'} found in the mean absolute "
           "displacement; each was measured from its own relaxed state. Values are means over whole beats.")
    if out:
        yield f"{_count(out, 'beat')} {'was' if out == 1 else 'were'} left out by hand."
    marked = sum(isinstance(one, MarkBeat) for one in a.decisions.listed)
    if marked:
        yield f"{_count(marked, 'beat')} {'was' if marked == 1 else 'were'} marked by hand."


def _about_strain(a: Analysis) -> Iterator[str]:
    if a.strain is None:
        return
    rows, cols = a.strain.grid
    height, width = a.strain.side_px
    yield (f"Green-Lagrange strain was computed in {rows} × {cols} sub-domains of {height:.4g} × "
           f"{width:.4g} px in the tissue's axes (c along, r across the tissue).")


def _about_pillars(a: Analysis) -> Iterator[str]:
    if a.pillars is None:
        return
    count = len(a.pillars.pillars)
    found = {"supplied": "supplied masks", "found": "masks found automatically", "mirrored": "a mirrored mask"}
    how = " and ".join(dict.fromkeys(found[source] for source in a.pillars.pillars.source))
    k = stiffness(a.config.pillars)
    force = ("no stiffness was given, so that deflections and no forces are reported" if k is None else
             "without a pixel size no forces are reported" if a.um_per_px is None else
             f"force is the deflection from rest times a stiffness of {k:.4g} µN/µm")
    yield f"{count} pillar{'s' if count > 1 else ''} ({how}) {'were' if count > 1 else 'was'} followed; {force}."


def _about_errors(a: Analysis) -> str:
    if a.tracks.field is None or a.tracks.field.draws is None:
        return "This method gives no standard errors of the measurement; intervals are of the spread of the beats."
    return (f"Standard errors of the measurement come from {DRAWS} random draws of the registration's error; 95 % "
            "intervals of means are by Student's t over the beats, together with the measurement's error.")


def changed_settings(config: Config) -> dict[str, Any]:
    """Find the settings that differ from the defaults: dotted name -> value."""
    now, usual = (dict(flat(one.model_dump())) for one in (config, Config()))
    return {name: value for name, value in now.items() if value != usual[name]}


def all_settings(config: Config) -> dict[str, Any]:
    """All settings: dotted name -> value."""
    return dict(flat(config.model_dump()))


def provenance(analysis: Analysis) -> Mapping[str, str]:
    """Where the numbers come from: movie, hash, calibration, masks, versions."""
    a = analysis
    names = [PurePath(file).name for file in a.files]
    many = "" if len(names) < 2 else f" … {names[-1]} ({len(names)} files)"
    unknown = "not known"
    out = {
        "Movie": a.name,
        "Files": f"{names[0]}{many}" if names else "none; the movie was made in memory",
        "SHA-256 of the files": a.input_hash or "none",
        "Frame times": unknown if a.time_s is None else f"{analysis_rate(a)[4:].split(',')[0]}, "
                       f"{SOURCES.get(a.time_source, 'source unknown')}",
        "Pixel size": unknown if a.um_per_px is None else f"{a.um_per_px:.4g} µm/px, "
                      f"{SOURCES.get(a.um_per_px_source, 'source unknown')}",
        "Tissue mask": a.masks.method if a.masks.stability is None else
                       f"{a.masks.method}, stability {a.masks.stability:.2f}",
        "Pillars": "none" if a.pillars is None else ", ".join(map(": ".join, zip(
            a.pillars.pillars.names, a.pillars.pillars.source, strict=True))),
        "Relaxed frame": str(a.tracks.reference_frame),
        "Markers": f"{len(a.markers)}, {100 * a.tracks.lost_fraction:.2g} % of their positions lost",
        "Smallest beat that could be told": unknown if not np.isfinite(a.beats.detection_limit_px) else
                                            f"{number(a.beats.detection_limit_px, 2)} px of mean displacement",
    }
    return out | {f"Version of {name}": version for name, version in a.versions.items()}


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"
