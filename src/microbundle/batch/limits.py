"""Which colours and axes the pictures of a result would have by themselves, and those that all results share.

The limits of each result are kept beside it, so that those of a whole run are found without opening a result. The
shared ones hold the values of almost all movies, but not of a rare one that would flatten all the others: left out are
results with the verdict "fail", those whose values reach more than five times as far as the middle one's, and the
largest twentieth. Values of these that lie beyond take the last colour, and curves leave the axes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..analysis import Analysis
from ..folder import write_within

FILE = "limits.json"
FURTHEST = 5.0
"""A movie that reaches so many times as far as the middle one is left out."""
SHARE = 0.95
"""Share of the movies whose values the limits hold."""
SECTIONS = ("figures", "movies")

Limits = Mapping[str, tuple[float, float]]


def own_limits(analysis: Analysis) -> dict[str, Any]:
    """Find the limits of a result's figures and movies, and the units that they are in."""
    from .. import figures, movies
    from ..shown import Shown

    shown = Shown(analysis)
    return {"units": [shown.length_unit, shown.time_unit], "figures": figures.own_limits(analysis),
            "movies": movies.own_limits(analysis)}


def write_limits(analysis: Analysis, folder: Path) -> None:
    """Write the limits of a result into its folder, while that is being written. Raises OSError."""
    (folder / FILE).write_text(json.dumps(own_limits(analysis), indent=1) + "\n", encoding="utf-8")


def add_limits(analysis: Analysis, folder: Path) -> None:
    """Add the limits of a result to its folder. Raises OutputError."""
    write_within(folder, FILE, lambda file: file.write_text(json.dumps(own_limits(analysis), indent=1) + "\n",
                                                            encoding="utf-8"))


def read_limits(folder: Path) -> dict[str, Any] | None:
    """Read the limits of a result; None where there are none, or the file is damaged."""
    try:
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        return {"units": [str(unit) for unit in found["units"]],
                **{section: {str(name): (float(low), float(high)) for name, (low, high) in found[section].items()}
                   for section in SECTIONS}}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None


def shared_limits(each: Mapping[str, Mapping[str, Any]], verdicts: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Find the limits that the results of one unit share, from the limits of each (movie -> limits).

    Returns movie -> limits, the same for all movies of the same units. Where all movies of a unit have the verdict
    "fail", they count after all.
    """
    groups: dict[str, list[str]] = {}
    for movie, own in each.items():
        groups.setdefault(json.dumps(own["units"]), []).append(movie)
    out: dict[str, dict[str, Any]] = {}
    for group in groups.values():
        counted = [movie for movie in group if verdicts[movie] != "fail"] or group
        shared: dict[str, Any] = {"units": each[group[0]]["units"]}
        for section in SECTIONS:
            names = dict.fromkeys(name for movie in group for name in each[movie][section])
            shared[section] = {
                name: robust([each[movie][section][name] for movie in counted if name in each[movie][section]]
                             or [each[movie][section][name] for movie in group if name in each[movie][section]])
                for name in names}
        out |= dict.fromkeys(group, shared)
    return out


def robust(limits: list[tuple[float, float]]) -> tuple[float, float]:
    """Join limits of at least one movie, without the rare ones that reach far beyond the others."""
    reach = sorted(limits, key=lambda one: max(abs(one[0]), abs(one[1])))
    furthest = FURTHEST * max(map(abs, reach[(len(reach) - 1) // 2]))
    most = math.ceil(SHARE * (len(reach) - 1)) + 1
    kept = [one for one in reach[:most] if max(map(abs, one)) <= furthest] or reach[:1]
    return min(low for low, _ in kept), max(high for _, high in kept)


def check_drawn(folder: Path, section: str, limits: Limits) -> bool:
    """Tell whether the pictures in a result's folder of that name were drawn with these limits."""
    try:
        return bool(json.loads((folder / section / FILE).read_text(encoding="utf-8")) == as_drawn(limits))
    except (OSError, ValueError):
        return False


def as_drawn(limits: Limits) -> dict[str, list[float]]:
    """Limits as they are written beside the pictures that were drawn with them."""
    return {name: [low, high] for name, (low, high) in limits.items()}
