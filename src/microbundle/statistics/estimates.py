"""Differences between groups of wells, and their 95 % intervals, by the spread of the level that repeats them.

Wells of one plate share much: the batch of cells, the medium, the day. What repeats an experiment is the plate. So each
plate's mean of a group (a cell) is one number, and the numbers are compared as the design allows:

1. Groups that share plates are compared within plates: least squares of the cells on groups and plates. The residual
   spread, pooled over all groups, is how much the difference varies from plate to plate, chance of wells included.
2. Groups that are whole plates are compared by their plates' means, within days where they share days.
3. Groups that share no day are compared by their days' means.
4. Where there is but one plate, its wells are compared (B. L. Welch, Biometrika 34, 1947); that holds for this plate.

For balanced designs these are the exact tests of the mixed linear model with random plates, days and group x plate
(the analysis of summary measures, J. N. S. Matthews et al., BMJ 300, 1990). Its intervals cover what they promise from
two plates on, where a fit of the model by restricted likelihood falls short (`benchmarks/plate_statistics.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import Bools, Floats, Ints

LEVEL = 0.95
FEWEST = 2
"""Wells of a group, or numbers that are compared, from which a spread is known."""
ROUNDING = 1e-12
"""Spread, as a share of the numbers' size, below which it is but rounding."""


@dataclass(frozen=True)
class Places:
    """Where N wells lie, as whole numbers: what they are compared by, and what they share."""

    group: Ints
    plate: Ints
    """(N,): numbers of plates; a plate lies in one day."""
    day: Ints
    plate_word: str = "plate"
    """What the table calls a plate: the day, where the run knows days and no plates."""

    def __getitem__(self, chosen: Bools) -> Places:
        return Places(self.group[chosen], self.plate[chosen], self.day[chosen], self.plate_word)


@dataclass(frozen=True)
class Estimate:
    """A number with its interval and test against zero; or, where it cannot be told, the reason."""

    value: float = np.nan
    low: float = np.nan
    high: float = np.nan
    p: float = np.nan
    df: float = np.nan
    unit: str = ""
    """What was compared: wells, plates or days."""
    reason: str = ""
    """Why it cannot be estimated; empty where it can."""


def difference(value: Floats, places: Places, group: int, control: int) -> Estimate:
    """Compare a group with the control: mean difference, and its interval by the level that repeats it.

    `value` (N,) are the wells' numbers, all finite, of all groups: the spread is pooled over those that the design
    connects. The reason of the estimate says why there is none.
    """
    for which in (group, control):
        count = int((places.group == which).sum())
        if count < FEWEST:
            return Estimate(reason=f"{_wells(count)} in the {'control' if which == control else 'group'}; a spread "
                                   f"needs {FEWEST}")
    plates, plate_places = _means(value, places, places.plate)
    connected = _connected(plate_places.group, plate_places.plate, control)
    if group in plate_places.group[connected]:
        found = _additive(plates[connected], plate_places[connected], plate_places.plate[connected], group, control,
                          places.plate_word)
        return found or _one_plate(value, places, group, control)
    connected = _connected(plate_places.group, plate_places.day, control)
    if group in plate_places.group[connected]:
        chosen = connected & _independent(plate_places.group, plate_places.plate, group, control)
        return _apart(plates[chosen], plate_places[chosen], plate_places.day[chosen], group, control, places.plate_word)
    days, day_places = _means(plates, plate_places, plate_places.day)
    chosen = _independent(day_places.group, day_places.day, group, control)
    return _apart(days[chosen], day_places[chosen], np.zeros(int(chosen.sum()), int), group, control, "day")


def ratio(value: Floats, places: Places, group: int, control: int) -> Estimate:
    """Compare a group with the control by the logarithms of the wells' numbers: the ratio of their geometric means.

    All numbers of both must have one sign; groups that have another are left out of the pooled spread.
    """
    signs = {int(g): np.unique(np.sign(value[places.group == g])) for g in np.unique(places.group)}
    sign = signs.get(control, np.zeros(1))[0]
    alike = [g for g, found in signs.items() if len(found) == 1 and found[0] == sign != 0]
    if group in signs and control in signs and not {group, control} <= set(alike):
        return Estimate(reason="no ratio: numbers of both signs, or 0")
    chosen = np.isin(places.group, alike)
    return exponential(difference(np.log(np.abs(value[chosen])), places[chosen], group, control))


def exponential(logarithm: Estimate) -> Estimate:
    """Turn the estimate of a difference of logarithms into that of a ratio."""
    value, low, high = (float(np.exp(x)) for x in (logarithm.value, logarithm.low, logarithm.high))
    return replace(logarithm, value=value, low=low, high=high)


def mean_of(value: Floats, places: Places) -> Estimate:
    """Mean over plates, and its interval by their spread; over the wells of a single plate by theirs.

    For numbers that are differences within wells already, such as after less before.
    """
    if len(value) < FEWEST:
        return Estimate(reason=f"{_wells(len(value))}; a spread needs {FEWEST}")
    plates = np.unique(places.plate)
    if len(plates) == 1:
        return _estimate(float(value.mean()), float(value.std(ddof=1)) / len(value)**0.5, len(value) - 1, "well",
                         float(np.abs(value).max()))
    means = np.array([value[places.plate == plate].mean() for plate in plates])
    return _estimate(float(means.mean()), float(means.std(ddof=1)) / len(means)**0.5, len(means) - 1,
                     places.plate_word, float(np.abs(value).max()))


def holm(p: Floats) -> Floats:
    """Adjust p values (K,) for their number (S. Holm, Scand. J. Stat. 6, 1979); NaN are not counted."""
    out = np.full(len(p), np.nan)
    known = np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(p[known], kind="stable")]
    steps = p[order] * np.arange(len(order), 0, -1)
    out[order] = np.minimum(np.maximum.accumulate(steps), 1) if len(order) else steps
    return out


def _means(value: Floats, places: Places, above: Ints) -> tuple[Floats, Places]:
    """Mean of each group in each plate, or in each day, in the order of group and place."""
    pairs = np.stack([places.group, above], axis=1)
    _, first, at = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    means = np.bincount(at.ravel(), value) / np.bincount(at.ravel())
    return means, Places(places.group[first], places.plate[first], places.day[first], places.plate_word)


def _connected(group: Ints, block: Ints, control: int) -> Bools:
    """Which cells hang together with the control's, by groups that share blocks."""
    reached = group == control
    while True:
        wider = np.isin(group, group[reached]) | np.isin(block, block[reached])
        if (wider == reached).all():
            return np.asarray(reached)
        reached = wider


def _independent(groups: Ints, unit: Ints, group: int, control: int) -> Bools:
    """Which cells may pool their spread: all, or those of the two groups alone where some groups share a unit."""
    if len(np.unique(unit)) == len(unit):
        return np.ones(len(unit), bool)
    return np.isin(groups, (group, control))


def _apart(cells: Floats, places: Places, block: Ints, group: int, control: int, unit: str) -> Estimate:
    """Compare groups that share no plate, or no day, by the means of theirs; each needs several."""
    for which in (group, control):
        if int((places.group == which).sum()) < FEWEST:
            named = "control" if which == control else "group"
            return Estimate(reason=f"the {named} is a single {unit} that does not hold the other, so that their "
                                   f"difference and that of the {unit}s cannot be told apart")
    return _additive(cells, places, block, group, control, unit) or Estimate(
        reason=f"too few {unit}s to know how much they differ by themselves")


def _additive(cells: Floats, places: Places, block: Ints, group: int, control: int, unit: str) -> Estimate | None:
    """Least squares of cells on groups and blocks; None where nothing is left to know the spread from."""
    design = np.concatenate([_indicators(places.group), _indicators(block)], axis=1)
    inverse, df = np.linalg.pinv(design), len(cells) - int(np.linalg.matrix_rank(design))
    if df < 1:
        return None
    groups = np.unique(places.group)
    contrast = np.zeros(design.shape[1])
    contrast[:len(groups)] = (groups == group) * 1.0 - (groups == control)
    weights = contrast @ inverse
    rest = cells - design @ (inverse @ cells)
    return _estimate(float(weights @ cells), float(np.sqrt(rest @ rest / df * (weights @ weights))), df,
                     unit, float(np.abs(cells).max()))


def _one_plate(value: Floats, places: Places, group: int, control: int) -> Estimate:
    """Compare the wells of the one plate that holds both groups."""
    word = places.plate_word
    shared = np.intersect1d(places.plate[places.group == group], places.plate[places.group == control])
    if len(shared) == 0:
        return Estimate(reason=f"the group shares no {word} with the control, and other groups connect them on too few")
    here = places.plate == shared[0]
    treated, untreated = (value[here & (places.group == which)] for which in (group, control))
    if min(len(treated), len(untreated)) < FEWEST:
        return Estimate(reason=f"one {word} holds both groups, and one of them has a single well there")
    parts = np.array([part.var(ddof=1) / len(part) for part in (treated, untreated)])
    free = np.array([len(treated) - 1, len(untreated) - 1])
    df = float(parts.sum()**2 / (parts**2 / free).sum()) if parts.sum() > 0 else float(free.sum())
    return _estimate(float(treated.mean() - untreated.mean()), float(np.sqrt(parts.sum())), df, "well",
                     float(np.abs(value[here]).max()))


def _estimate(value: float, se: float, df: float, unit: str, size: float) -> Estimate:
    from scipy.special import stdtr, stdtrit

    if not se > ROUNDING * size:
        return Estimate(reason=f"the {unit}s do not differ at all, so that their spread is not known")
    reach = float(stdtrit(df, 0.5 + LEVEL / 2)) * se
    return Estimate(value, value - reach, value + reach, float(2 * stdtr(df, -abs(value) / se)), df, unit)


def _indicators(index: Ints) -> NDArray[Any]:
    return np.asarray(index[:, None] == np.unique(index)[None, :], float)


def _wells(count: int) -> str:
    return "no well" if count == 0 else "a single well" if count == 1 else f"{count} wells"
