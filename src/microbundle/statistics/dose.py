"""Dose-responses of each compound and metric: what a curve is fitted to, and the table `dose_response`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data import Floats, Ints
from .curve import Curve, Points, fit_curve
from .wells import CONTROLS, Run, Well, counts, merged, numbers

if TYPE_CHECKING:
    import pandas as pd

PARAMETERS = ("bottom", "top", "ec50", "hill")
COLUMNS = ("metric", "compound", "dose_column", "dose_unit", "n_wells", "n_plates", "n_days", "n_doses",
           *(f"{name}{end}" for name in PARAMETERS for end in ("", "_low_95", "_high_95")), "residual_sd", "p_flat",
           "df", "unit", "reason")


@dataclass(frozen=True)
class Response:
    """The curve of one compound and metric, and what it was fitted to."""

    metric: str
    compound: str
    wells: tuple[Well, ...]
    curve: Curve
    unit: str
    """What the curve's points are: wells, or plates."""
    blocks: Mapping[tuple[str, ...], int]
    """Numbers of what is offset as a whole: plates, by day and plate, or wells, by day, plate and well."""

    def block_of(self, well: Well) -> int:
        """Number of the block of a well: its own, or its plate's."""
        own = well.day, well.plate, well.well
        return self.blocks.get(own, self.blocks.get(own[:2], -1))


def dose_wells(run: Run) -> Mapping[str, list[Well]]:
    """Wells with a dose, by compound; where there is a before and after, those after.

    Wells of dose 0 without a compound, or with that of a control such as vehicle, count for every compound. Whatever
    group they are in, they are compared by dose alone.
    """
    phase = run.columns.phases[-1]
    dosed = merged([well for well in run.wells if well.dose >= 0 and well.phase == phase],
                   lambda well: (well.day, well.plate, well.well, well.compound, well.dose))
    names = dict.fromkeys(well.compound for well in dosed if not _shared(well)) or {"": None}
    return {name: [well for well in dosed if _shared(well) or well.compound == name] for name in names}


def _shared(well: Well) -> bool:
    return well.dose == 0 and (not well.compound or well.compound.casefold() in CONTROLS)


def fit_responses(run: Run) -> tuple[Response, ...]:
    """Fit the curve of each compound and metric."""
    of = dose_wells(run)
    return tuple(_fit(metric, compound, wells) for metric in run.metrics for compound, wells in of.items())


def response_table(run: Run, responses: tuple[Response, ...]) -> pd.DataFrame:
    """Put the curves' parameters into a table; a curve that cannot be told has its reason there, and no numbers."""
    import pandas as pd

    return pd.DataFrame(list(_rows(run, responses)), columns=list(COLUMNS))


def _rows(run: Run, responses: tuple[Response, ...]) -> Iterator[dict[str, Any]]:
    for response in responses:
        curve = response.curve
        ends = {f"{name}{end}": value for name in PARAMETERS
                for end, value in zip(("", "_low_95", "_high_95"), getattr(curve, name), strict=True)}
        yield {"metric": response.metric, "compound": response.compound, "dose_column": run.columns.dose,
               "dose_unit": run.columns.dose_unit, **counts(response.wells),
               "n_doses": len({well.dose for well in response.wells}), **ends, "residual_sd": curve.sd,
               "p_flat": curve.p, "df": max(curve.points.df, 0), "unit": response.unit, "reason": curve.reason}


def _fit(metric: str, compound: str, wells: list[Well]) -> Response:
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
    return Response(metric, compound, tuple(known), fit_curve(points), "plate" if by_plate else "well", blocks)


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
