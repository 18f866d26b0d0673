"""Fit a dose-response: four parameters, and their 95 % intervals by profile likelihood.

    y = bottom + (top - bottom) / (1 + (ec50 / dose)^hill)          A. V. Hill, J. Physiol. 40 (1910) iv

The two plateaus and the offset of each plate are linear in y, so only the logarithms of ec50 and hill are searched: on
a grid, which zooms in on where the sum of squares S is small. An interval holds all values that some curve has whose S
is no more than (1 + t^2 / df) times the least (D. Bates and D. Watts, Nonlinear Regression Analysis, 1988, 6.1); for
the plateaus and the curve itself, which are linear, its ends at each point of the grid are known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..data import Bools, Floats, Ints

FEWEST_DOSES = 4
FLAT_P = 0.05
REACHED = 0.75
"""Share of the whole response at the highest dose (or missing from it at the lowest) that shows a plateau."""
HILLS = (0.2, 10.0)
BEYOND = 1.0
"""Decades around the tested doses in which the ec50 is searched."""
GRID, SMALL_GRID, ZOOMS = (61, 41), (17, 13), 8
FULL = 0.15
"""Share of the grid that lies inside the interval when it is fine enough."""
CURVE_POINTS = 120


@dataclass(frozen=True)
class Points:
    """What a curve is fitted to: M numbers at doses, of plates (or wells) that may be offset as a whole."""

    dose: Floats
    value: Floats
    block: Ints
    """(M,): whole numbers of what is offset as a whole."""
    weight: Floats
    """(M,): how many wells a number is the mean of, where wells are the sample; else 1."""
    inside: float = 0.0
    """Sum of squares of the wells within the numbers, and how many there are beyond one to each."""
    spare: int = 0

    @property
    def df(self) -> int:
        """Degrees of freedom of the residuals of a curve."""
        return len(self.value) + self.spare - len(np.unique(self.block)) - 3


@dataclass(frozen=True)
class Curve:
    """A fitted curve; or the reason why there is none."""

    points: Points
    reason: str = ""
    p: float = np.nan
    """Of the test against a constant (with the offsets)."""
    sd: float = np.nan
    """Of the residuals."""
    ec50: tuple[float, float, float] = (np.nan,) * 3
    """Value and interval; so are the others."""
    hill: tuple[float, float, float] = (np.nan,) * 3
    """Negative where the response falls; an end is NaN where the doses do not limit it."""
    bottom: tuple[float, float, float] = (np.nan,) * 3
    top: tuple[float, float, float] = (np.nan,) * 3
    offset: Floats | None = None
    """(M,): offset of each point's block from the mean over blocks."""
    shown_dose: Floats | None = None
    """(K,): doses at which the curve is drawn, and (K, 3) the curve and its band."""
    shown: Floats | None = None


def fit_curve(points: Points) -> Curve:
    """Fit a curve, or say why not: few doses, no response, or an ec50, an interval or a plateau beyond the doses."""
    from scipy.special import fdtrc, stdtrit

    doses = np.unique(points.dose)
    if len(doses) < FEWEST_DOSES:
        return Curve(points, f"{len(doses)} different doses; a curve needs {FEWEST_DOSES}")
    if points.df < 1:
        return Curve(points, "fewer numbers than a curve and the offsets need")
    tested = np.log10(doses[doses > 0])
    low, high = float(tested[0]), float(tested[-1])
    model = _Model(points)
    if not model.total > 1e-18 * float(points.value @ points.value):
        return Curve(points, "flat: all numbers are the same")
    ends = (low - BEYOND, high + BEYOND), (float(np.log(HILLS[0])), float(np.log(HILLS[1])))
    best, least = _least(model, ends)
    p = float(fdtrc(3, points.df, max(model.total - least, 0.0) / 3 / (least / points.df))) if least > 0 else 0.0
    if not p < FLAT_P:
        return Curve(points, "flat: no change with the dose stands out of the spread", p)
    sd = float(np.sqrt(least / points.df))
    if not low <= best[0] <= high:
        return Curve(points, "the EC50 lies outside the tested doses", p, sd)
    limit = least * (1 + float(stdtrit(points.df, 0.975))**2 / points.df)
    region = _region(model, ends, best, limit)
    if region.ec50[0] <= ends[0][0] or region.ec50[1] >= ends[0][1]:
        return Curve(points, "the interval of the EC50 reaches beyond ten times the tested doses", p, sd)
    at_best = np.array([best[0]]), np.array([best[1]])
    first, last = _share(np.array([tested[0] if doses[0] > 0 else -np.inf, high]), *at_best)[0, 0]
    if last < REACHED or first > 1 - REACHED:
        end = "highest" if last < REACHED else "lowest"
        return Curve(points, f"no plateau is reached at the {end} dose", p, sd)
    return _finished(points, model, best, limit, region, (low, high), p, sd)


@dataclass(frozen=True)
class _Region:
    """The part of the grid of log10 ec50 and log hill (E, H) where curves are inside the interval."""

    e: Floats
    h: Floats
    squares: Floats
    inside: Bools
    ec50: tuple[float, float]
    hill: tuple[float, float]


class _Model:
    """Sums of squares of curves whose ec50 and hill are given, the rest being fitted."""

    def __init__(self, points: Points) -> None:
        blocks = np.unique(points.block, return_inverse=True)[1]
        self.member = np.asarray(blocks[:, None] == np.arange(blocks.max() + 1), float)
        self.weight, self.size = points.weight, points.weight @ self.member
        with np.errstate(divide="ignore"):
            self.log_dose = np.log10(points.dose)
        self.value, self.inside = points.value, points.inside
        self.rest = self.value - self.mean(self.value) @ self.member.T
        self.total = float(self.weight @ self.rest**2) + self.inside

    def mean(self, of: Floats) -> Floats:
        """Means over each block, (..., M) to (..., B)."""
        return np.asarray((of * self.weight) @ self.member / self.size)

    def parts(self, e: Floats, h: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """For a grid (E,) x (H,): sums of squares, spans, mean share of the response, and the span's weight."""
        share = _share(self.log_dose, e, h)
        means = self.mean(share)
        share = share - means @ self.member.T
        across = share**2 @ self.weight
        with_value = share @ (self.weight * self.rest)
        span = np.divide(with_value, across, out=np.zeros_like(across), where=across > 1e-12)
        return self.total - span * with_value, span, means.mean(axis=-1), np.maximum(across, 1e-12)

    def level(self) -> float:
        """Mean over the blocks of their means."""
        return float(self.mean(self.value).mean())

    def spread_of_level(self) -> float:
        """Variance of that, for numbers of variance 1."""
        return float((1 / self.size).sum() / len(self.size)**2)


def _share(log_dose: Floats, e: Floats, h: Floats) -> Floats:
    """Share of the whole response (E, H, M) at doses (M,)."""
    from scipy.special import expit

    steep = np.exp(h)[None, :, None] * np.log(10)
    return np.asarray(expit(steep * (log_dose[None, None, :] - e[:, None, None])))


def _least(model: _Model, ends: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], float]:
    """Find the ec50 and hill of the least sum of squares."""
    box = list(ends)
    for zoom in range(ZOOMS):
        count = SMALL_GRID if zoom else GRID
        e, h = (np.linspace(*side, n) for side, n in zip(box, count, strict=True))
        squares = model.parts(e, h)[0]
        i, j = np.unravel_index(int(np.argmin(squares)), squares.shape)
        best = float(e[i]), float(h[j])
        steps = [2 * (side[1] - side[0]) / (n - 1) for side, n in zip(box, count, strict=True)]
        box = [(max(at - step, end[0]), min(at + step, end[1]))
               for at, step, end in zip(best, steps, ends, strict=True)]
    return best, float(squares[i, j])


def _region(model: _Model, ends: tuple[tuple[float, float], ...], best: tuple[float, float], limit: float) -> _Region:
    """Find the curves inside the interval, on a grid that is fine enough, and the ends for ec50 and hill."""
    box = list(ends)
    for _ in range(ZOOMS):
        grid = [np.linspace(*side, count) for side, count in zip(box, GRID, strict=True)]
        grid = [np.unique(np.append(axis, at)) for axis, at in zip(grid, best, strict=True)]
        squares = model.parts(*grid)[0]
        inside = squares <= limit
        inside[np.searchsorted(grid[0], best[0]), np.searchsorted(grid[1], best[1])] = True
        if inside.mean() >= FULL:
            break
        narrow = []
        for axis, end, along in zip(grid, ends, (1, 0), strict=True):
            there = np.flatnonzero(inside.any(axis=along))
            narrow.append((max(float(axis[max(there[0] - 1, 0)]), end[0]),
                           min(float(axis[min(there[-1] + 1, len(axis) - 1)]), end[1])))
        if narrow == box:
            break
        box = narrow
    ec50, hill = (_crossings(axis, squares.min(axis=along), limit) for axis, along in zip(grid, (1, 0), strict=True))
    return _Region(grid[0], grid[1], squares, inside, ec50, hill)


def _crossings(axis: Floats, profile: Floats, limit: float) -> tuple[float, float]:
    """Outermost places where a profile crosses its limit; the end of the axis where it does not."""
    inside = np.flatnonzero(profile <= limit)
    if len(inside) == 0:
        inside = np.array([int(np.argmin(profile))])

    def crossing(within: int, without: int) -> float:
        if not 0 <= without < len(axis) or not profile[without] > profile[within]:
            return float(axis[within])
        share = (limit - profile[within]) / (profile[without] - profile[within])
        return float(axis[within] + max(share, 0.0) * (axis[without] - axis[within]))

    return crossing(int(inside[0]), int(inside[0]) - 1), crossing(int(inside[-1]), int(inside[-1]) + 1)


def _finished(points: Points, model: _Model, best: tuple[float, float], limit: float, region: _Region,
              tested: tuple[float, float], p: float, sd: float) -> Curve:
    """Put the parameters and the drawn curve together."""
    at_best = np.array([best[0]]), np.array([best[1]])
    _, span, mean_share, _ = (float(part[0, 0]) for part in model.parts(*at_best))
    squares, spans, mean_shares, across = (part[region.inside] for part in model.parts(region.e, region.h))
    room = np.maximum(limit - squares, 0.0)

    def linear(share: Floats, share_at_best: float) -> tuple[float, float, float]:
        """The height of the curves where they have a share of the response, and its interval."""
        value = model.level() + spans * (share - mean_shares)
        reach = np.sqrt(room * (model.spread_of_level() + (share - mean_shares)**2 / across))
        here = model.level() + span * (share_at_best - mean_share)
        return here, min(float((value - reach).min()), here), max(float((value + reach).max()), here)

    start, end = linear(np.zeros_like(spans), 0.0), linear(np.ones_like(spans), 1.0)
    hills = tuple(float(np.exp(x)) if log_low < x < log_high else np.nan for x in (best[1], *region.hill)
                  for log_low, log_high in [(np.log(HILLS[0]) + 1e-9, np.log(HILLS[1]) - 1e-9)])
    hill = (hills[0], hills[1], hills[2]) if span > 0 else (-hills[0], -hills[2], -hills[1])
    shown_log = np.linspace(tested[0] - 0.3, tested[1] + 0.3, CURVE_POINTS)
    shares = _share(shown_log, region.e, region.h)[region.inside]
    shown = [linear(shares[:, k], float(_share(shown_log[k:k + 1], *at_best)[0, 0, 0])) for k in range(CURVE_POINTS)]
    fitted = model.level() + span * (_share(model.log_dose, *at_best)[0, 0] - mean_share)
    offset = model.mean(points.value - fitted) @ model.member.T
    return Curve(points, "", p, sd, tuple_of_tens(best[0], *region.ec50), hill, *((start, end) if span > 0 else
                 (end, start)), offset=offset, shown_dose=10.0**shown_log, shown=np.array(shown))


def tuple_of_tens(value: float, low: float, high: float) -> tuple[float, float, float]:
    """Turn logarithms into numbers."""
    return 10.0**value, 10.0**low, 10.0**high
