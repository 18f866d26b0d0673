"""Dose-response: known parameters come back, intervals agree with the likelihood, and what cannot be told is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize, stats

from microbundle.statistics.curve import Curve, Points, fit_curve

Array = NDArray[Any]
DOSES = np.array([0, 0.01, 0.03, 0.1, 0.3, 1, 3, 10.0])


def response(dose: Array, ec50: float = 0.2, hill: float = 1.3, bottom: float = 1.0, top: float = 5.0) -> Array:
    with np.errstate(divide="ignore"):
        return bottom + (top - bottom) / (1 + (ec50 / dose)**hill)


def points(sd: float, seed: int = 1, doses: Array = DOSES, wells: int = 3, **of: float) -> Points:
    dose = np.repeat(doses, wells)
    value = response(dose, **of) + np.random.default_rng(seed).normal(0, 1, len(dose)) * sd
    return Points(dose, value, np.zeros(len(dose), int), np.ones(len(dose)))


def test_the_parameters_come_back() -> None:
    found = fit_curve(points(1e-4))
    assert found.reason == ""
    assert [found.ec50[0], found.hill[0], found.bottom[0], found.top[0]] == pytest.approx([0.2, 1.3, 1, 5], rel=1e-3)
    for low, high in ((found.ec50[1:]), (found.hill[1:]), (found.bottom[1:]), (found.top[1:])):
        assert 0 < high - low < 1e-2


def test_numbers_without_noise_are_their_own_curve() -> None:
    found = fit_curve(points(0))
    assert found.reason == ""
    assert found.ec50 == pytest.approx((0.2, 0.2, 0.2), rel=1e-3)


def test_a_falling_response_has_a_negative_slope() -> None:
    found = fit_curve(points(0.01, bottom=5.0, top=1.0))
    assert (found.bottom[0], found.top[0]) == pytest.approx((1, 5), rel=0.02)
    assert found.hill[1] < found.hill[0] < found.hill[2] < 0


def test_the_fit_is_that_of_least_squares() -> None:
    given = points(0.4)
    (bottom, top, log_ec50, hill), _ = optimize.curve_fit(
        lambda x, b, t, e, h: response(x, 10**e, h, b, t), np.maximum(given.dose, 1e-12), given.value, (1, 5, -0.7, 1))
    found = fit_curve(given)
    assert [found.bottom[0], found.top[0], found.ec50[0], found.hill[0]] == pytest.approx(
        [bottom, top, 10**log_ec50, hill], rel=1e-3)


@pytest.mark.parametrize("name", ["ec50", "hill", "bottom", "top"])
def test_the_ends_of_an_interval_lie_where_the_likelihood_says(name: str) -> None:
    """With a parameter held at an end of its interval, the least sum of squares of all others is at the limit."""
    given = points(0.3)
    found = fit_curve(given)
    order = ("ec50", "hill", "bottom", "top")

    def squares(free: Array, held: float | None) -> float:
        values = list(free)
        if held is not None:
            values.insert(order.index(name), held)
        if values[0] <= 0 or values[1] <= 0:
            return 1e9
        return float(((given.value - response(given.dose, *values))**2).sum())

    start = [getattr(found, other)[0] for other in order]
    options = {"maxiter": 8000, "maxfev": 8000, "xatol": 1e-9, "fatol": 1e-11}
    least = optimize.minimize(squares, start, args=(None,), method="Nelder-Mead", options=options).fun
    limit = least * (1 + stats.t.ppf(0.975, given.df)**2 / given.df)
    free = [value for other, value in zip(order, start, strict=True) if other != name]
    for end in getattr(found, name)[1:]:
        at_end = optimize.minimize(squares, free, args=(end,), method="Nelder-Mead", options=options).fun
        assert at_end - least == pytest.approx(limit - least, rel=0.05)


def test_means_with_weights_are_the_same_as_their_wells() -> None:
    wells = points(0.3)
    means = wells.value.reshape(-1, 3).mean(axis=1)
    inside = float(((wells.value.reshape(-1, 3) - means[:, None])**2).sum())
    of_means = fit_curve(Points(DOSES, means, np.zeros(8, int), np.full(8, 3.0), inside, 16))
    assert of_means.points.df == wells.df == 20
    assert np.ravel([of_means.ec50, of_means.hill, of_means.bottom, of_means.top]) == pytest.approx(
        np.ravel([(f := fit_curve(wells)).ec50, f.hill, f.bottom, f.top]), rel=1e-6)


def test_offsets_of_plates_are_taken_out() -> None:
    dose, plate = np.tile(DOSES, 3), np.repeat(np.arange(3), len(DOSES))
    value = response(dose) + np.random.default_rng(0).normal(0, 0.1, len(dose))
    even = fit_curve(Points(dose, value, plate, np.ones(len(dose))))
    shifted = fit_curve(Points(dose, value + np.array([-7.0, 0, 7])[plate], plate, np.ones(len(dose))))
    assert shifted.ec50 == pytest.approx(even.ec50)
    assert shifted.bottom == pytest.approx(even.bottom)
    assert shifted.offset is not None
    assert shifted.offset[[0, 8, 16]] == pytest.approx([-7, 0, 7], abs=0.2)


def test_the_drawn_curve_and_band_are_those_of_the_parameters() -> None:
    found = fit_curve(points(0.3))
    assert found.shown is not None
    assert found.shown_dose is not None
    curve, low, high = found.shown.T
    exact = response(found.shown_dose, found.ec50[0], found.hill[0], found.bottom[0], found.top[0])
    np.testing.assert_allclose(curve, exact, rtol=1e-6)
    assert (low < curve).all()
    assert (curve < high).all()


CASES = {
    "3 different doses; a curve needs 4": points(0.1, doses=DOSES[-3:]),
    "fewer numbers than a curve and the offsets need": points(0.1, doses=DOSES[::2], wells=1),
    "flat: no change with the dose stands out of the spread": points(0.5, bottom=3, top=3),
    "flat: all numbers are the same": points(0, bottom=3, top=3),
    "the EC50 lies outside the tested doses": points(0.05, ec50=100),
    "the interval of the EC50 reaches beyond ten times the tested doses": points(0.8, ec50=2, hill=0.8),
    "no plateau is reached at the highest dose": points(0.02, ec50=7),
    "no plateau is reached at the lowest dose": points(0.02, doses=DOSES[1:], ec50=0.015),
}


@pytest.mark.parametrize("said", list(CASES))
def test_what_cannot_be_told_has_a_reason_and_no_number(said: str) -> None:
    found = fit_curve(CASES[said])
    assert found.reason == said
    assert np.isnan([found.ec50, found.hill, found.bottom, found.top]).all()


def test_a_step_between_two_doses_has_no_upper_limit_for_its_slope() -> None:
    found = fit_curve(points(0.1, doses=np.array([0, 0.001, 0.01, 1, 10.0]), ec50=0.1, hill=4.0))
    assert found.reason == ""
    assert np.isnan(found.hill[2])
    assert 0.01 < found.ec50[1] < found.ec50[2] < 1


def test_intervals_of_the_ec50_hold_it() -> None:
    found: list[Curve] = [fit_curve(points(0.4, seed=seed)) for seed in range(100)]
    told = [one for one in found if not one.reason]
    assert len(told) > 90
    assert 0.88 < np.mean([one.ec50[1] <= 0.2 <= one.ec50[2] for one in told]) < 1
