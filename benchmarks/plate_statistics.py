"""How often the intervals of `microbundle compare` hold the truth: the tables of docs/statistics.md.

    python benchmarks/plate_statistics.py [--trials 2000] [--curves 400]

Wells are drawn with a standard deviation of 1, on plates with one of their own, and effects of a treatment that vary
from plate to plate; each well's number is the mean of 10 beats. Three groups (control and two treatments) have 6 wells
each on every plate, or whole plates. The true difference is 0, so a p below 0.05 is a false positive in the share of
trials that an interval misses. Beside the method stand:

- beats: every beat counts as a sample (Welch's t test);
- wells: every well counts as a sample, whatever its plate (Welch's t test);
- REML: the mixed linear model with random plates and group x plate, by restricted likelihood, Satterthwaite's degrees
  of freedom, and variances that are not negative; for these balanced designs it is known in closed form, by pooling the
  mean squares that are out of order (W. A. Thompson, Ann. Math. Stat. 33, 1962).

Width is the half width of the interval, its median over trials, in standard deviations of wells.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator

import numpy as np
from scipy import optimize, special

from microbundle.statistics.curve import Points, fit_curve
from microbundle.statistics.estimates import Places, difference, ratio

GROUPS, WELLS, BEATS, BEAT_SD, MEAN = 3, 6, 10, 0.5, 10.0
SPREADS, EFFECT_SPREADS = (0.0, 0.5, 1.0, 2.0), (0.0, 0.5)
EC50, HILL, DOSES = 0.3, 1.2, np.array([0, 0.01, 0.03, 0.1, 0.3, 1, 3, 10.0])

CURVES = ((1, 3, 0.1, 0, 0, 0, 0.7), (1, 6, 0.1, 0, 0, 0, 0.7), (1, 3, 0.2, 0, 0, 0, 0.7), (3, 3, 0.1, 0, 0, 0, 0.7),
          (3, 3, 0.1, 0.2, 0, 0, 0.7), (3, 3, 0.1, 0.2, 0.05, 0, 0.7), (3, 3, 0.1, 0.2, 0.1, 0, 0.7),
          (3, 3, 0.1, 0.2, 0, 0.1, 0.7), (3, 3, 0.1, 0.2, 0, 0.2, 0.7), (1, 3, 0.1, 0, 0, 0, 0),
          (3, 3, 0.1, 0.2, 0, 0, 0))
"""Plates, wells a dose, SD of wells, plates, plate x dose and of plates' log10 EC50, and how far the response goes."""


def layout(plates: int, *, within: bool) -> tuple[np.ndarray, np.ndarray]:
    """Group and plate of each well: all groups on each plate, or so many plates for each group."""
    if within:
        return np.tile(np.repeat(np.arange(GROUPS), WELLS), plates), np.repeat(np.arange(plates), GROUPS * WELLS)
    plate = np.repeat(np.arange(plates * GROUPS), WELLS)
    return plate % GROUPS, plate


def drawn(rng, group, plate, plate_sd: float, effect_sd: float, well_sd=1.0) -> np.ndarray:
    """Numbers of wells."""
    count = plate.max() + 1
    effects = rng.normal(0, effect_sd, (GROUPS, count)) if effect_sd else np.zeros((GROUPS, count))
    return (MEAN + rng.normal(0, 1, count)[plate] * plate_sd + effects[group, plate]
            + rng.normal(0, 1, len(group)) * well_sd)


def welch(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Difference and half width of its interval."""
    va, vb = a.var(ddof=1) / len(a), b.var(ddof=1) / len(b)
    df = (va + vb)**2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return a.mean() - b.mean(), special.stdtrit(df, 0.975) * np.sqrt(va + vb)


def reml(value: np.ndarray, plates: int, *, within: bool) -> tuple[float, float]:
    """The balanced mixed model: mean squares of wells, cells and plates, pooled until they are in order."""
    cells = value.reshape(-1, WELLS)
    ms = [(cells.var(axis=1, ddof=1).mean(), cells.size - len(cells))]
    at = 0
    if within:
        means = cells.mean(axis=1).reshape(plates, GROUPS)
        rest = means - means.mean(axis=0) - means.mean(axis=1, keepdims=True) + means.mean()
        if plates > 1:
            ms.append((WELLS * (rest**2).sum() / ((GROUPS - 1) * (plates - 1)), (GROUPS - 1) * (plates - 1)))
            ms.append((WELLS * GROUPS * means.mean(axis=1).var(ddof=1), plates - 1))
            at = 1
    else:
        means = cells.mean(axis=1).reshape(plates, GROUPS)
        if plates == 1:
            return np.nan, np.nan
        ms.append((WELLS * means.var(axis=0, ddof=1).mean(), GROUPS * (plates - 1)))
        at = 1
    pools = [([i], square, df) for i, (square, df) in enumerate(ms)]
    while any(pools[i][1] > pools[i + 1][1] for i in range(len(pools) - 1)):
        i = next(i for i in range(len(pools) - 1) if pools[i][1] > pools[i + 1][1])
        (a, x, m), (b, y, n) = pools[i:i + 2]
        pools[i:i + 2] = [(a + b, (x * m + y * n) / (m + n), m + n)]
    _, square, df = next(pool for pool in pools if at in pool[0])
    return (means[:, 1].mean() - means[:, 0].mean(),
            special.stdtrit(df, 0.975) * np.sqrt(2 * square / (WELLS * plates)))


def ours(value, places: Places) -> tuple[float, float]:
    """Difference and half width, by the package."""
    found = difference(value, places, 1, 0)
    return found.value, (found.high - found.low) / 2


def covered(plates: int, plate_sd: float, effect_sd: float, trials: int, *, within: bool) -> str:
    """A row of the table: shares of intervals that hold 0, and widths."""
    rng = np.random.default_rng(plates)
    group, plate = layout(plates, within=within)
    places = Places(group, plate, np.zeros_like(plate))
    found = []
    for _ in range(trials):
        value = drawn(rng, group, plate, plate_sd, effect_sd)
        beats = value[:, None] + rng.normal(0, BEAT_SD, (len(value), BEATS))
        value = beats.mean(axis=1)
        found.append([welch(beats[group == 1].ravel(), beats[group == 0].ravel()),
                      welch(value[group == 1], value[group == 0]), reml(value, plates, within=within),
                      ours(value, places)])
    answers = np.array(found)
    share = 100 * (np.abs(answers[..., 0]) <= answers[..., 1]).mean(axis=0)
    width = np.median(answers[..., 1], axis=0)
    ends = (f"{share[2]:.1f} | {share[3]:.1f} | {width[2]:.2f} | {width[3]:.2f}" if np.isfinite(width).all() else
            "not estimable | not estimable | |")
    effect = f"{effect_sd:g}" if within else "-"
    return f"| {plates} | {plate_sd:g} | {effect} | {share[0]:.1f} | {share[1]:.1f} | {ends} |"


def harder(trials: int) -> Iterator[str]:
    """Designs that are not balanced, groups that differ in spread, days, and ratios: the package alone."""
    def share(name: str, make, analyze, truth: float) -> str:
        rng = np.random.default_rng(7)
        held, known = 0, 0
        for _ in range(trials):
            found = analyze(*make(rng))
            known += not found.reason
            held += found.low <= truth <= found.high
        return f"| {name} | {100 * held / max(known, 1):.1f} | {100 * known / trials:.0f} |"

    def uneven(rng, plates=4, well_sd=1.0, effect_sd=0.5):
        group, plate = layout(plates, within=True)
        keep = rng.random(len(group)) < rng.uniform(0.3, 1, (GROUPS, plates))[group, plate]
        keep &= ~((group == 2) & (plate == 0))
        value = drawn(rng, group, plate, 1.0, effect_sd, np.array([1, well_sd, 1])[group])
        return value[keep], Places(group[keep], plate[keep], np.zeros(int(keep.sum()), int))

    def days(rng, per_day=1):
        group, plate = layout(4 * per_day, within=False)
        day = plate // GROUPS // per_day
        return drawn(rng, group, plate, 0.5, 0) + rng.normal(0, 1, 4)[day], Places(group, plate, day)

    def whole_days(rng):
        plate = np.repeat(np.arange(24), WELLS)
        day = plate // 2
        return drawn(rng, day % GROUPS, plate, 0.5, 0) + rng.normal(0, 1, 12)[day], Places(day % GROUPS, plate, day)

    def multiplied(rng):
        group, plate = layout(4, within=True)
        effects = np.exp(rng.normal(0, 0.05, (GROUPS, 4)) + rng.normal(0, 0.3, 4))
        return (np.array([1, 1.5, 0.5])[group] * effects[group, plate] * np.exp(rng.normal(0, 0.2, len(group))),
                Places(group, plate, np.zeros_like(plate)))

    def compare(value, places):
        return difference(value, places, 1, 0)

    yield share("4 plates, 30 to 100 % of the wells of each cell, a group missing on one", uneven, compare, 0)
    yield share("the same, treated wells vary twice as much", lambda rng: uneven(rng, well_sd=2.0), compare, 0)
    yield share("1 plate, treated wells vary twice as much",
                lambda rng: uneven(rng, plates=1, well_sd=2.0, effect_sd=0.0), compare, 0)
    yield share("groups are plates, one each on each of 4 days (SD 1)", days, compare, 0)
    yield share("groups are plates, two each on each of 4 days (SD 1)", lambda rng: days(rng, 2), compare, 0)
    yield share("groups are days, 4 each, 2 plates a day", whole_days, compare, 0)
    yield share("ratio 1.5, 4 plates, all spreads multiply", multiplied, lambda v, p: ratio(v, p, 1, 0), 1.5)


def wald(dose, value) -> tuple[float, float]:
    """The usual fit of a curve to all wells: log10 EC50 and its standard error."""
    def curve(x, bottom, top, log_ec50, hill):
        with np.errstate(divide="ignore", over="ignore"):
            return bottom + (top - bottom) / (1 + (10**log_ec50 / x)**hill)

    try:
        found, spread = optimize.curve_fit(curve, np.maximum(dose, 1e-9), value, maxfev=4000, p0=(
            value[dose == 0].mean(), value[dose == dose.max()].mean(), np.log10(EC50), 1.0))
        return found[2], float(np.sqrt(spread[2, 2]))
    except (RuntimeError, optimize.OptimizeWarning):
        return np.nan, np.nan


def curves(plates: int, wells: int, sd: float, plate_sd: float, cell_sd: float, ec50_sd: float, span: float,
           trials: int) -> str:
    """A row: share of intervals of the EC50 that hold it, of those that can be told, and the usual fit beside."""
    rng = np.random.default_rng(plates)
    dose, plate = np.tile(np.repeat(DOSES, wells), plates), np.repeat(np.arange(plates), wells * len(DOSES))
    cell = np.unique(np.stack([plate, dose]), axis=1, return_inverse=True)[1].ravel()
    held = told = wald_held = wald_told = 0
    for _ in range(trials):
        ec50 = EC50 * 10**rng.normal(0, ec50_sd, plates)[plate] if ec50_sd else EC50
        with np.errstate(divide="ignore"):
            share = 1 / (1 + (ec50 / dose)**HILL)
        value = (1 - span * share + rng.normal(0, plate_sd, plates)[plate]
                 + rng.normal(0, cell_sd, cell.max() + 1)[cell] + rng.normal(0, sd, len(dose)))
        if plates > 1:
            mean = np.bincount(cell, value) / wells
            at = np.unique(np.stack([plate, dose]), axis=1)
            points = Points(at[1], mean, at[0].astype(int), np.ones(len(mean)))
        else:
            points = Points(dose, value, plate, np.ones(len(value)))
        found = fit_curve(points)
        told += not found.reason
        held += found.ec50[1] <= EC50 <= found.ec50[2]
        log_ec50, se = wald(dose, value)
        wald_told += bool(np.isfinite(se))
        wald_held += abs(log_ec50 - np.log10(EC50)) <= special.stdtrit(len(dose) - 4, 0.975) * se
    hold = f"{100 * held / told:.1f}" if span and told else "-"
    usual = f"{100 * wald_held / wald_told:.1f}" if span else "-"
    return (f"| {plates} | {wells} | {span:g} | {sd:g} | {plate_sd:g} | {cell_sd:g} | {ec50_sd:g} | {hold} | "
            f"{100 * told / trials:.0f} | {usual} | {100 * wald_told / trials:.0f} |")


def main() -> None:
    """Print the tables."""
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--trials", type=int, default=2000)
    arguments.add_argument("--curves", type=int, default=400)
    wanted = arguments.parse_args()
    warnings.simplefilter("error", optimize.OptimizeWarning)
    for within in (True, False):
        print("\nGroups within plates" if within else "\nGroups are whole plates")
        print(f"| plates{'' if within else ' of each group'} | SD of plates | SD of effects | beats, % | wells, % | "
              "REML, % | microbundle, % | width, REML | width, microbundle |")
        print("|" + "---|" * 9)
        for plates in (1, 2, 4, 8):
            for effect_sd in EFFECT_SPREADS if within else (0.0,):
                for plate_sd in SPREADS if plates > 1 or not within else SPREADS[2:3]:  # one plate shifts all alike
                    print(covered(plates, plate_sd, effect_sd, wanted.trials, within=within), flush=True)
    print("\n| design | intervals that hold the truth, % | can be told, % |\n|---|---|---|")
    for row in harder(wanted.trials):
        print(row, flush=True)
    print("\n| plates | wells a dose | span | SD of wells | SD of plates | SD of plate x dose | SD of log10 EC50 | "
          "microbundle, % | can be told, % | usual fit, % | converged, % |")
    print("|" + "---|" * 11)
    for design in CURVES:
        print(curves(*design, wanted.curves), flush=True)


if __name__ == "__main__":
    main()
