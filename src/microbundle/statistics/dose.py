"""Dose-responses of each compound and metric: what a curve is fitted to, and the table `dose_response`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data import Floats, Ints
from .curve import Curve, Points, fit_curve
from .wells import Run, Well, counts, merged, numbers

if TYPE_CHECKING:
    import pandas as pd

PARAMETERS = ("bottom", "top", "ec50", "hill")
COLUMNS = ("metric", "group", "compound", "dose_column", "dose_unit", "n_wells", "n_plates", "n_days", "n_doses",
           *(f"{name}{end}" for name in PARAMETERS for end in ("", "_low_95", "_high_95")), "residual_sd", "p_flat",
           "df", "unit", "reason")


@dataclass(frozen=True)
class Response:
    """The curve of one group, compound and metric, and what it was fitted to."""

    metric: str
    group: str
    """Empty where groups share a curve."""
    compound: str
    wells: tuple[Well, ...]
    curve: Curve
    unit: str
    """What the curve's points are: wells, or plates."""
    blocks: Mapping[tuple[str, ...], int]
    """Numbers of what is offset as a whole: plates, by day and plate, or wells, by day, plate and well."""

    @property
    def name(self) -> str:
        """What the curve is of: group and compound, as far as there are such."""
        return curve_name(self.group, self.compound)

    def block_of(self, well: Well) -> int:
        """Number of the block of a well: its own, or its plate's."""
        own = well.day, well.plate, well.well
        return self.blocks.get(own, self.blocks.get(own[:2], -1))


def curve_name(group: str, compound: str) -> str:
    """Name of a curve: group and compound, as far as there are such."""
    return " ".join(name for name in (group, compound) if name)


def dose_wells(run: Run) -> Mapping[tuple[str, str], list[Well]]:
    """Wells of each curve, by group and compound; where there is a before and after, those after.

    Groups have curves of their own where one of them holds several doses; else, as where groups are doses, their name
    is empty. Wells of dose 0 whose group or compound is empty, or has no other dose, count for all.
    """
    phase = run.columns.phases[-1]
    dosed = merged([well for well in run.wells if well.dose >= 0 and well.phase == phase],
                   lambda well: (well.day, well.plate, well.well, well.group, well.compound, well.dose))
    given = [well for well in dosed if well.dose > 0]
    of_group: dict[str, set[float]] = {}
    for well in given:
        of_group.setdefault(well.group, set()).add(well.dose)
    apart = any(len(doses) > 1 for doses in of_group.values())
    names = dict.fromkeys((well.group if apart else "", well.compound) for well in given) or {("", ""): None}
    groups, compounds = ({name[i] for name in names} for i in (0, 1))

    def belongs(well: Well, group: str, compound: str) -> bool:
        return (not apart or well.group == group or _shared(well, well.group, groups)) and (
            well.compound == compound or _shared(well, well.compound, compounds))

    return {name: [well for well in dosed if belongs(well, *name)] for name in names}


def _shared(well: Well, name: str, given: set[str]) -> bool:
    """Tell whether a well of dose 0 counts for all, by the name of its group or compound."""
    return well.dose == 0 and (not name or name not in given)


def fit_responses(run: Run) -> tuple[Response, ...]:
    """Fit the curve of each group, compound and metric."""
    of = dose_wells(run)
    return tuple(_fit(metric, *name, wells) for metric in run.metrics for name, wells in of.items())


def response_table(run: Run, responses: tuple[Response, ...]) -> pd.DataFrame:
    """Put the curves' parameters into a table; a curve that cannot be told has its reason there, and no numbers."""
    import pandas as pd

    return pd.DataFrame(list(_rows(run, responses)), columns=list(COLUMNS))


def _rows(run: Run, responses: tuple[Response, ...]) -> Iterator[dict[str, Any]]:
    for response in responses:
        curve = response.curve
        ends = {f"{name}{end}": value for name in PARAMETERS
                for end, value in zip(("", "_low_95", "_high_95"), getattr(curve, name), strict=True)}
        yield {"metric": response.metric, "group": response.group, "compound": response.compound,
               "dose_column": run.columns.dose, "dose_unit": run.columns.dose_unit, **counts(response.wells),
               "n_doses": len({well.dose for well in response.wells}), **ends, "residual_sd": curve.sd,
               "p_flat": curve.p, "df": max(curve.points.df, 0), "unit": response.unit, "reason": curve.reason}


def _fit(metric: str, group: str, compound: str, wells: list[Well]) -> Response:
    """Fit the wells of one plate; the means of several plates at each dose; or, where most wells have
    several doses, the wells with an offset of their own."""
    known, value = numbers(wells, metric)
    doses = Counter((well.day, well.plate, well.well) for well in known)
    repeated = sum(many > 1 for many in doses.values()) > 0.5 * len(doses)
    names = [(well.day, well.plate, well.well)[:3 if repeated else 2] for well in known]
    blocks: dict[tuple[str, ...], int] = {name: i for i, name in enumerate(dict.fromkeys(names))}
    block = np.array([blocks[name] for name in names], int)
    by_plate = len(blocks) > 1 and not repeated
    points = _points(np.array([well.dose for well in known], float), value, block, by_plate)
    return Response(metric, group, compound, tuple(known), fit_curve(points), "plate" if by_plate else "well", blocks)


def _points(dose: Floats, value: Floats, block: Ints, by_plate: bool) -> Points:
    """Means at each dose of each block. They count alike where plates are the sample, and by their wells elsewhere."""
    if len(value) == 0:
        return Points(dose, value, block, dose)
    pairs, at = np.unique(np.stack([block, dose], axis=1), axis=0, return_inverse=True)
    at = at.ravel()
    many = np.bincount(at).astype(float)
    mean = np.bincount(at, value) / many
    block, dose = pairs[:, 0].astype(int), pairs[:, 1]
    if by_plate:
        return Points(dose, mean, block, np.ones(len(mean)))
    inside = value - mean[at]
    return Points(dose, mean, block, many, float(inside @ inside), len(value) - len(mean))
