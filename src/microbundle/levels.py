"""All numbers of a result that belong to beats, level by level: of the tissue, its shortening, sub-domains, pillars."""

from __future__ import annotations

from .analysis import Analysis
from .data import Floats
from .dictionary import Level
from .force import forces, pillar_values, tissue_force_values
from .numbers import (
    beat_signal,
    beat_values,
    shapes_of,
    shortening,
    shortening_values,
    subdomain_signal,
    subdomain_values,
)


def level_values(analysis: Analysis, signal: Floats | None = None, *,
                 nulls: bool = True) -> dict[Level, dict[str, Floats]]:
    """Compute the numbers of each level: name -> (B,), (B, S) for sub-domains, (B, P) for pillars.

    `signal` (T,) takes the place of `beat_signal`. Without `nulls` what chance alone would give is left out.
    """
    found = forces(analysis)
    signals: dict[Level, Floats] = {
        "beat": (beat_signal(analysis) if signal is None else signal)[:, None],
        "shortening": shortening(analysis)[:, None], "subdomain": subdomain_signal(analysis)}
    if found is not None:
        signals["pillar"] = found.along_px
    shapes = shapes_of(analysis, signals)
    pillars = {} if found is None else pillar_values(analysis, found, shapes["pillar"])
    return {"beat": beat_values(analysis, shapes["beat"], nulls=nulls) | (
                {} if found is None else tissue_force_values(analysis, found, pillars)),
            "shortening": shortening_values(shapes["shortening"]),
            "subdomain": subdomain_values(analysis, shapes["subdomain"]), "pillar": pillars}
