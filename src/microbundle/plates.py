"""Results in the geometry of their plates: which well has which value, or why it has none.

A plate is that of the columns `plate` and `well`; where its movies are of several days, it is a plate for each day. A
well with several movies has the mean of those that can be trusted.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Literal

from .wells import Place, place_of, plate_size, well_name

State = Literal["pass", "review", "fail", "failed"]
"""A verdict, or that there is no result."""
TRUSTED = ("pass", "review")
Reading = tuple[float, float]
"""Mean over the beats and its standard error; NaN where not known."""


@dataclass(frozen=True)
class WellMovie:
    """One movie of a plate, and what became of it."""

    movie: str
    columns: Mapping[str, str]
    """Plate, well, group, day, ..."""
    state: State
    means: Mapping[str, Reading]
    """By the metric's column name."""
    kind: str = ""
    """Of the failure."""
    message: str = ""
    report: str = ""
    """Its report, as a path from the folder of the run; empty where there is none."""


@dataclass(frozen=True)
class Well:
    """One well that has a movie."""

    place: Place
    movies: tuple[WellMovie, ...]

    @property
    def name(self) -> str:
        """Such as B3."""
        return well_name(self.place)

    @property
    def group(self) -> str:
        """Its group; of movies of several, all."""
        return ", ".join(dict.fromkeys(movie.columns.get("group", "") for movie in self.movies))

    @property
    def state(self) -> State:
        """Pass where all its movies do; else review where any can be trusted, fail where any has a result."""
        states = {movie.state for movie in self.movies}
        if states == {"pass"}:
            return "pass"
        return "review" if states & set(TRUSTED) else "fail" if "fail" in states else "failed"

    @property
    def kind(self) -> str:
        """Kind of the first failure."""
        return next((movie.kind for movie in self.movies if movie.kind), "")

    def reading(self, metric: str) -> Reading:
        """Mean and standard error of a metric; of several movies the mean of their means, with no error."""
        found = [movie.means[metric] for movie in self.movies if movie.state in TRUSTED and metric in movie.means]
        found = [one for one in found if math.isfinite(one[0])]
        if len(found) == 1:
            return found[0]
        return (fmean(mean for mean, _ in found) if found else math.nan), math.nan


@dataclass(frozen=True)
class Plate:
    """One plate."""

    name: str
    rows: int
    columns: int
    wells: tuple[Well, ...]
    """In the order of their places; a place without a movie is not among them."""

    @property
    def failures(self) -> Counter[str]:
        """How many wells have no result, by the kind of failure."""
        return Counter(well.kind for well in self.wells if well.state == "failed")


def plates_of(movies: Iterable[WellMovie], wells: int | None = None) -> tuple[list[Plate], int]:
    """Put movies into their plates, in the order in which these come; also count those that name no well.

    `wells` is the size of the plates (6, 12, 24, 48, 96, 384, 1536); without it each is the smallest usual one that has
    all its wells. Raises ConfigError for a size that is not usual, or has not all the wells.
    """
    listed = list(movies)
    days: dict[str, dict[str, None]] = {}
    for movie in listed:
        days.setdefault(movie.columns.get("plate", ""), {})[movie.columns.get("day", "")] = None
    found: dict[str, dict[Place, list[WellMovie]]] = {}
    left_out = 0
    for movie in listed:
        place = place_of(movie.columns.get("well", ""))
        if place is None:
            left_out += 1
            continue
        plate, day = movie.columns.get("plate", ""), movie.columns.get("day", "")
        name = f"{plate} day {day}".strip() if len(days[plate]) > 1 and day else plate
        found.setdefault(name, {}).setdefault(place, []).append(movie)
    out = []
    for name, places in found.items():
        rows, columns = plate_size(places, wells)
        out.append(Plate(name, rows, columns, tuple(Well(place, tuple(places[place])) for place in sorted(places))))
    return out, left_out


def groups_of(plates: Sequence[Plate]) -> list[str]:
    """All groups of the plates, in the order of the movies' rows and columns; none where no movie has one."""
    return list(dict.fromkeys(well.group for plate in plates for well in plate.wells if well.group))


def limits_of(plates: Sequence[Plate], metric: str) -> tuple[float, float] | None:
    """Round limits around all values of a metric that can be trusted, on all plates; None where there are none."""
    values = [value for plate in plates for well in plate.wells if math.isfinite(value := well.reading(metric)[0])]
    if not values:
        return None
    low, high = min(values), max(values)
    if high - low < 1e-9 * max(abs(low), abs(high), 1e-300):
        low, high = low - 0.1 * (abs(low) or 1.0), high + 0.1 * (abs(high) or 1.0)
    step = 10.0 ** math.floor(math.log10((high - low) / 4))
    step *= next(n for n in (1, 2, 2.5, 5, 10) if n * step * 8 >= high - low)
    places = max(0, 2 - math.floor(math.log10(step)))
    return round(math.floor(low / step + 1e-9) * step, places), round(math.ceil(high / step - 1e-9) * step, places)
