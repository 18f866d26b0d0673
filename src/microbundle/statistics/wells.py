"""Read the tables of a run into wells, which are the sample: beats and movies of one well are not independent.

The number of a well is the mean over its movies, each the mean over its beats. Movies without a result, or with the
verdict fail, are left out and listed.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import groupby
from pathlib import Path

import numpy as np

from ..errors import ConfigError, ResultUnreadable
from ..formats.tiff_folder import natural_key
from .estimates import Places

MOVIES, PLATE = "movies.csv", "plate.csv"
CONTROLS = ("control", "ctrl", "vehicle", "dmso", "untreated", "wt", "baseline")
"""Names of groups that others are compared with, the likeliest first."""
PAIRS = (("before", "after"), ("baseline", "drug"))
"""Values of the column `phase` that make pairs by themselves."""
PHASE, COMPOUND, GROUP, DOSE = "phase", "compound", "group", "dose"
NEAR = 3


@dataclass(frozen=True)
class Chosen:
    """Columns of a run that a comparison uses; empty where there is none."""

    by: str = ""
    pair: str = ""
    before: str = ""
    after: str = ""
    compound: str = ""
    dose: str = ""

    @property
    def phases(self) -> tuple[str, ...]:
        """The two values of the column of pairs, or one empty name."""
        return (self.before, self.after) if self.pair else ("",)

    @property
    def dose_unit(self) -> str:
        """Unit of the dose, as the column's name has it: um of dose_um."""
        return self.dose[len(DOSE):].strip("_ ()[]")


@dataclass(frozen=True)
class Well:
    """One well, in one phase and at one dose: names of where it lies and what was done, and its number by metric."""

    day: str
    plate: str
    well: str
    group: str
    phase: str
    compound: str
    dose: float
    """NaN where there is none."""
    movies: int
    values: dict[str, float]
    """Metric -> mean over the movies in which it is known."""


@dataclass(frozen=True)
class Run:
    """The wells of a run, in natural order, and what was left out of it."""

    wells: tuple[Well, ...]
    metrics: tuple[str, ...]
    columns: Chosen
    left_out: tuple[tuple[str, str], ...]
    """Movie, or well, and the reason."""
    notes: tuple[str, ...]
    has_plates: bool
    has_days: bool

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups, in natural order; numbers by their size."""
        names = {well.group for well in self.wells if well.group}
        if all(_number(name) is not None for name in names):
            return tuple(sorted(names, key=lambda name: (float(name), name)))
        return tuple(sorted(names, key=natural_key))


def read_run(folder: Path | str, *, metrics: Sequence[str] | None = None, by: str | None = None,
             pair: str | None = None, before: str | None = None, after: str | None = None,
             only_pass: bool = False) -> Run:
    """Read the wells of a run of `microbundle batch`, and find the columns by which they can be compared.

    Raises ResultUnreadable where the folder is no such run, ConfigError for a column, value or metric that it has not,
    and where nothing in it can be compared.
    """
    folder = Path(folder).expanduser()
    header, movies = _table(folder / MOVIES)
    if not {"movie", "state", "verdict"} <= set(header):
        raise ResultUnreadable(f"{folder / MOVIES}: expected the columns movie, state, verdict; found another table")
    known = header[1:header.index("state")]
    columns = _choose(folder, known, movies, by, pair, before, after)
    shown = header[header.index("beats") + 1:-1] if "beats" in header else []
    wanted = tuple(dict.fromkeys(metrics)) if metrics else _without_twins(shown)
    kept, left_out = _kept(movies, columns, only_pass)
    values = _values(folder / PLATE, set(kept), wanted, by_user=metrics is not None)
    wells = _wells(kept, values, known, columns)
    notes = list(_notes(kept, known, columns))
    if not kept:
        raise ConfigError(f"{folder / MOVIES}: expected movies to compare; all {len(movies)} are left out, such as "
                          f"{left_out[0][0]}: {left_out[0][1]}" if left_out else
                          f"{folder / MOVIES}: expected movies to compare; there is none")
    return Run(wells, wanted, columns, tuple(left_out), tuple(notes), "plate" in known and columns.pair != "plate",
               "day" in known and columns.pair != "day")


def comparable(columns: Sequence[str]) -> bool:
    """Tell whether a run with such columns may be compared by them: groups, pairs or doses under their usual names."""
    return GROUP in columns or any(name.casefold() == PHASE or name.casefold().startswith(DOSE) for name in columns)


def merged(wells: Sequence[Well], same: Callable[[Well], tuple[object, ...]]) -> list[Well]:
    """Take the mean over wells that are `same`: one well at several doses, say; in the order of the first of each."""
    found = defaultdict[tuple[object, ...], list[Well]](list)
    for well in wells:
        found[same(well)].append(well)
    return [one[0] if len(one) == 1 else replace(one[0], movies=sum(w.movies for w in one), values=_mean(
        [w.values for w in one])) for one in found.values()]


def numbers(wells: Sequence[Well], metric: str) -> tuple[list[Well], np.ndarray[tuple[int], np.dtype[np.float64]]]:
    """Find the wells in which a metric is known, and its values."""
    known = [well for well in wells if metric in well.values]
    return known, np.array([well.values[metric] for well in known], float)


def places(wells: Sequence[Well], run: Run, groups: Sequence[str]) -> Places:
    """Number the places of wells; groups by their order."""
    days = {day: i for i, day in enumerate(dict.fromkeys(well.day for well in run.wells))}
    plates = {plate: i for i, plate in enumerate(dict.fromkeys((well.day, well.plate) for well in run.wells))}
    number = {group: i for i, group in enumerate(groups)}
    return Places(np.array([number[well.group] for well in wells], int),
                  np.array([plates[well.day, well.plate] for well in wells], int),
                  np.array([days[well.day] for well in wells], int),
                  "day" if run.has_days and not run.has_plates else "plate")


def counts(wells: Sequence[Well]) -> dict[str, int]:
    """Count wells, and the plates and days that they lie in."""
    return {"n_wells": len(wells), "n_plates": len({(well.day, well.plate) for well in wells}),
            "n_days": len({well.day for well in wells})}


def natural_control(groups: Sequence[str]) -> str:
    """Choose the group that the others are compared with, where nobody says: one called control or the like, else the
    first."""
    named = {group.casefold(): group for group in reversed(groups)}
    return next((named[name] for name in CONTROLS if name in named), groups[0])


def file_name(name: str) -> str:
    """Make a name safe in a file's name."""
    return "".join(letter if letter.isalnum() or letter in "-." else "_" for letter in name)


def _table(file: Path) -> tuple[list[str], list[dict[str, str]]]:
    rows = _rows(file)
    header = next(rows)
    return header, [dict(zip(header, row, strict=False)) for row in rows]


def _rows(file: Path) -> Iterator[list[str]]:
    """Header and rows of a table of a run."""
    try:
        with file.open(encoding="utf-8", newline="") as stream:
            rows = csv.reader(stream)
            yield next(rows, [])
            yield from rows
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ResultUnreadable(f"{file}: expected a table that `microbundle batch` writes into its folder; it cannot "
                               f"be read: {reason}") from None


def _choose(folder: Path, known: list[str], movies: list[dict[str, str]], by: str | None, pair: str | None,
            before: str | None, after: str | None) -> Chosen:
    """Find the columns: as asked, or by their usual names. Raises ConfigError."""
    for option, name in (("--by", by), ("--pair", pair)):
        if name is not None and name not in known:
            raise ConfigError(f"{option} {name}: {folder / MOVIES} has no such column; it has "
                              f"{', '.join(known) or 'none of a plan'}. Add it to the manifest, or to --pattern, and "
                              "run `microbundle batch` again")
    if by is not None and by == pair:
        raise ConfigError(f"--by {by} --pair {pair}: expected two columns; a column tells groups or pairs, not both")
    of = {name.casefold(): name for name in known}
    group = by or (GROUP if GROUP in known and pair != GROUP else "")
    dose = next((name for name in known if name.casefold().startswith(DOSE) and name != pair), "")
    phase, first, second = _pair(movies, pair, of.get(PHASE, ""), before, after)
    if phase and "well" not in known:
        raise ConfigError(f"{folder / MOVIES}: pairs by {phase} need the column well, which says what belongs "
                          "together; there is none. Add it to the manifest, or to --pattern")
    if not (group or phase or dose):
        raise ConfigError(f"{folder / MOVIES}: expected a column group, phase or dose to compare by; found "
                          f"{', '.join(known) or 'none of a plan'}. Add one to the manifest, or name one with --by or "
                          "--pair")
    return Chosen(group, phase, first, second, of.get(COMPOUND, "") if dose else "", dose)


def _pair(movies: list[dict[str, str]], pair: str | None, usual: str, before: str | None,
          after: str | None) -> tuple[str, str, str]:
    """The column of pairs and its two values; three empty names where there is none, and none was asked for."""
    asked = pair is not None or before is not None or after is not None
    column = pair or usual
    if not column:
        if asked:
            raise ConfigError(f"--before, --after: expected a column {PHASE}, or another named with --pair")
        return "", "", ""
    there = sorted({row[column] for row in movies if row.get(column)}, key=natural_key)
    named = {value.casefold(): value for value in there}
    usual_pair = next(((named[a], named[b]) for a, b in PAIRS if a in named and b in named), ("", ""))
    first, second = before or usual_pair[0], after or usual_pair[1]
    if not asked and not first:
        return "", "", ""
    for option, value in (("--before", first), ("--after", second)):
        if value not in there:
            said = f"{option} {value}: column {column} has no such value" if value else f"{option} is missing"
            raise ConfigError(f"{said}; column {column} has {', '.join(there) or 'none'}")
    if first == second:
        raise ConfigError(f"--before {first} --after {second}: expected two values of column {column}")
    return column, first, second


def _without_twins(shown: list[str]) -> tuple[str, ...]:
    """Metrics without those in px of which there is one in um: both would tell the same."""
    return tuple(name for name in shown if not ("_px" in name and name.replace("_px", "_um") in shown))


def _kept(movies: list[dict[str, str]], columns: Chosen,
          only_pass: bool) -> tuple[dict[str, dict[str, str]], list[tuple[str, str]]]:
    """Movies that count, by name, and those that do not, with the reason. Raises ConfigError for a wrong dose."""
    kept, left_out = {}, []
    for row in movies:
        if row["state"] != "done":
            reason = f"no result: {row.get('failure_kind') or row['state']}"
        elif row["verdict"] == "fail" or (only_pass and row["verdict"] != "pass"):
            reason = f"verdict {row['verdict']}"
        elif columns.pair and row[columns.pair] not in columns.phases:
            reason = f"column {columns.pair} is {row[columns.pair] or 'empty'}"
        else:
            reason = ""
        if reason:
            left_out.append((row["movie"], reason))
            continue
        if columns.dose and row[columns.dose]:
            _dose(row, columns.dose)
        kept[row["movie"]] = row
    return kept, left_out


def _number(text: str) -> float | None:
    """The finite number that a text is; None where it is none."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _dose(row: dict[str, str], column: str) -> float:
    if not row[column]:
        return math.nan
    dose = _number(row[column])
    if dose is None or dose < 0:
        raise ConfigError(f"{MOVIES}, movie {row['movie']}, column {column}: expected a dose, a number from 0 up; "
                          f"found {row[column]!r}. Correct the manifest, and run `microbundle batch` again")
    return dose


def _values(file: Path, movies: set[str], wanted: Sequence[str], *, by_user: bool) -> dict[str, dict[str, float]]:
    """Means of the wanted metrics of each movie. Raises ConfigError for a metric that the run has not."""
    rows = _rows(file)
    header = next(rows)
    if not {"movie", "metric", "mean"} <= set(header):
        raise ResultUnreadable(f"{file}: expected the columns movie, metric, mean; found another table")
    movie, metric, mean = (header.index(name) for name in ("movie", "metric", "mean"))
    out: dict[str, dict[str, float]] = {name: {} for name in movies}
    asked, there = set(wanted), set()
    for row in rows:
        there.add(row[metric])
        if row[metric] in asked and row[mean] and row[movie] in movies:
            out[row[movie]][row[metric]] = float(row[mean])
    unknown = [name for name in wanted if name not in there] if by_user else []
    if unknown:
        near = get_close_matches(unknown[0], sorted(there), n=NEAR, cutoff=0.4)
        raise ConfigError(f"--metric {unknown[0]}: the run has no such metric. Near: "
                          f"{', '.join(near) or f'none; the column metric of {PLATE} lists them'}")
    return out


def _wells(kept: dict[str, dict[str, str]], values: dict[str, dict[str, float]], known: list[str],
           columns: Chosen) -> tuple[Well, ...]:
    """Bring the movies of each well together, in natural order."""
    found = defaultdict[tuple[str, ...], list[str]](list)
    for movie, row in kept.items():
        day, plate, well = (row[name] if name in known and name != columns.pair else "" for name in
                            ("day", "plate", "well"))
        group, phase, compound = (row[name] if name else "" for name in (columns.by, columns.pair, columns.compound))
        dose = _dose(row, columns.dose) if columns.dose else math.nan
        found[day, plate, well or movie, group, phase, compound, f"{dose:.12g}"].append(movie)
    out = []
    for names in sorted(found, key=lambda names: (*map(natural_key, names[:-1]), _number(names[-1]) or 0.0)):
        day, plate, well, group, phase, compound, text = names
        out.append(Well(day, plate, well, group, phase, compound, float(text), len(found[names]),
                        _mean([values[movie] for movie in found[names]])))
    return tuple(out)


def _mean(each: Sequence[dict[str, float]]) -> dict[str, float]:
    found = defaultdict[str, list[float]](list)
    for values in each:
        for metric, value in values.items():
            found[metric].append(value)
    return {metric: math.fsum(known) / len(known) for metric, known in found.items()}


def _notes(kept: dict[str, dict[str, str]], known: list[str], columns: Chosen) -> Iterator[str]:
    """Say what a reader of the tables may not expect."""
    if "well" not in known:
        yield "no column well: each movie counts as a well of its own"
    if "plate" not in known and "day" not in known:
        yield "no column plate or day: all wells count as those of one plate, and the intervals hold for it alone"
    for column in (columns.by, *(name for name in ("plate", "day") if name in known)):
        empty = sum(not row[column] for row in kept.values()) if column else 0
        if empty:
            counted = "are not compared" if column == columns.by else f"count as one {column}"
            yield f"column {column} is empty for {empty} movies; they {counted}"
    if {"day", "plate", "well"} <= set(known) and columns.pair not in ("day", "plate", "well"):
        days = sorted((row["plate"], row["well"], row["day"]) for row in kept.values())
        for plate, same in groupby(days, key=lambda names: names[0]):
            of_well = [len({name[2] for name in one}) for _, one in groupby(same, key=lambda names: names[1])]
            if max(of_well) > 1:
                yield (f"plate {plate} has wells of the same name on several days, which count as different wells. "
                       "Where they are the same, filmed again, compare them with --pair day")
                break
