"""Differences and their intervals, against exact tests on balanced designs, and what cannot be told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from microbundle.statistics.estimates import Estimate, Places, difference, exponential, holm, mean_of, ratio

Array = NDArray[Any]


def on_plates(groups: int, plates: int, wells: int) -> Places:
    """All groups on each plate."""
    return Places(np.tile(np.repeat(np.arange(groups), wells), plates), np.repeat(np.arange(plates), groups * wells),
                  np.zeros(groups * plates * wells, int))


def whole_plates(groups: int, plates: int, wells: int, days: int = 1) -> Places:
    """So many plates for each group, and each day."""
    plate = np.repeat(np.arange(groups * plates), wells)
    return Places(plate % groups, plate, plate // groups % days)


def numbers(places: Places, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return 10 + rng.normal(0, 2, 99)[places.plate] + rng.normal(size=len(places.plate)) + places.group


def cells(value: Array, places: Places) -> Array:
    """Means (plates, groups) of a design with all groups on each plate."""
    return np.array([[value[(places.plate == p) & (places.group == g)].mean() for g in np.unique(places.group)]
                     for p in np.unique(places.plate)])


def test_two_groups_within_plates_are_the_paired_t_test_of_the_plates_means() -> None:
    places = on_plates(2, 4, 5)
    value = numbers(places)
    means = cells(value, places)
    exact = stats.ttest_rel(means[:, 1], means[:, 0])
    found = difference(value, places, 1, 0)
    interval = exact.confidence_interval()
    assert (found.p, found.df, found.low, found.high) == pytest.approx((exact.pvalue, 3, interval.low, interval.high))
    assert found.value == pytest.approx((means[:, 1] - means[:, 0]).mean())
    assert (found.unit, found.reason) == ("plate", "")


def test_several_groups_within_plates_pool_the_spread_of_the_two_way_analysis() -> None:
    places = on_plates(3, 4, 5)
    value = numbers(places)
    means = cells(value, places)
    rest = means - means.mean(axis=0) - means.mean(axis=1, keepdims=True) + means.mean()
    se = np.sqrt(2 * (rest**2).sum() / 6 / 4)
    found = difference(value, places, 2, 0)
    assert found.df == 6
    assert found.high - found.low == pytest.approx(2 * stats.t.ppf(0.975, 6) * se)


def test_wells_of_one_plate_are_welchs_test() -> None:
    places = on_plates(2, 1, 6)
    value = numbers(places) * np.where(places.group == 1, 3, 1)
    exact = stats.ttest_ind(value[places.group == 1], value[places.group == 0], equal_var=False)
    found = difference(value, places, 1, 0)
    assert (found.p, found.df, found.low) == pytest.approx((exact.pvalue, exact.df, exact.confidence_interval().low))
    assert found.unit == "well"


def test_groups_that_are_whole_plates_are_compared_by_their_plates() -> None:
    places = whole_plates(2, 3, 5)
    value = numbers(places)
    means = np.array([value[places.plate == p].mean() for p in range(6)])
    exact = stats.ttest_ind(means[1::2], means[::2])
    found = difference(value, places, 1, 0)
    assert (found.p, found.df, found.unit) == (pytest.approx(exact.pvalue), 4, "plate")


def test_three_groups_of_whole_plates_give_the_analysis_of_variance_of_their_plates() -> None:
    places = whole_plates(3, 4, 5)
    value = numbers(places)
    means = np.array([value[places.plate == p].mean() for p in range(12)])
    found = [difference(value, places, g, 0) for g in (1, 2)]
    within = np.mean([means[g::3].var(ddof=1) for g in range(3)])
    assert found[0].high - found[0].value == pytest.approx(stats.t.ppf(0.975, 9) * np.sqrt(within / 2))
    by_f = stats.f_oneway(means[::3], means[1::3]).pvalue
    assert difference(value[places.group < 2], places[places.group < 2], 1, 0).p == pytest.approx(by_f)


def test_plates_of_several_days_are_compared_within_days() -> None:
    places = whole_plates(2, 4, 5, days=4)
    value = numbers(places) + 50.0 * places.day
    means = np.array([value[places.plate == p].mean() for p in range(8)])
    exact = stats.ttest_rel(means[1::2], means[::2])
    assert difference(value, places, 1, 0).p == pytest.approx(exact.pvalue)


def test_groups_on_different_days_are_compared_by_days() -> None:
    plate = np.repeat(np.arange(8), 4)
    places = Places(plate // 2 % 2, plate, plate // 2)
    value = numbers(places)
    means = np.array([value[places.day == d].mean() for d in range(4)])
    found = difference(value, places, 1, 0)
    assert (found.unit, found.df) == ("day", 2)
    assert found.p == pytest.approx(stats.ttest_ind(means[1::2], means[::2]).pvalue)


def test_plates_with_one_group_alone_say_nothing_of_the_difference() -> None:
    places = on_plates(2, 4, 5)
    keep = ~((places.plate == 3) & (places.group == 0))
    value = numbers(places)
    three = difference(value[places.plate < 3], places[places.plate < 3], 1, 0)
    all_four = difference(value[keep], places[keep], 1, 0)
    assert (all_four.value, all_four.low) == pytest.approx((three.value, three.low))


@pytest.mark.parametrize(("chosen", "said"), [
    (lambda p: (p.group == 0) | ((p.plate == 1) & (np.arange(len(p.plate)) == 5)), "a single well in the group"),
    (lambda p: p.group == 1, "no well in the control"),
    (lambda p: p.plate < 2, "the group is a single plate"),
])
def test_what_cannot_be_told_has_a_reason_and_no_number(chosen: Any, said: str) -> None:
    places = whole_plates(2, 3, 5)
    keep = chosen(places)
    found = difference(numbers(places)[keep], places[keep], 1, 0)
    assert said in found.reason
    assert np.isnan([found.value, found.low, found.high, found.p, found.df]).all()


def test_a_group_beside_one_plate_of_the_controls_is_compared_there() -> None:
    places = Places(np.repeat([0, 1, 0], 4), np.repeat([0, 0, 1], 4), np.zeros(12, int))
    value = numbers(places)
    exact = stats.ttest_ind(value[4:8], value[:4], equal_var=False)
    assert difference(value, places, 1, 0).p == pytest.approx(exact.pvalue)


def test_numbers_without_spread_have_no_interval() -> None:
    places = on_plates(2, 3, 4)
    found = difference(1.0 * places.group, places, 1, 0)
    assert "do not differ at all" in found.reason


def test_a_ratio_is_that_of_the_logarithms() -> None:
    places = on_plates(2, 4, 5)
    value = numbers(places)
    logs = difference(np.log(value), places, 1, 0)
    assert ratio(value, places, 1, 0) == ratio(-value, places, 1, 0) == exponential(logs)
    assert ratio(value, places, 1, 0).low == pytest.approx(np.exp(logs.low))
    assert ratio(value - 10, places, 1, 0).reason == "no ratio: numbers of both signs, or 0"


def test_a_group_of_another_sign_does_not_take_the_ratio_from_the_others() -> None:
    places = on_plates(3, 4, 5)
    value = np.where(places.group == 2, -1, 1) * numbers(places)
    two = places.group < 2
    assert ratio(value, places, 1, 0) == ratio(value[two], places[two], 1, 0)
    assert ratio(value, places, 2, 0).reason


def test_changes_on_several_plates_are_the_t_test_of_the_plates_means() -> None:
    places = on_plates(1, 4, 5)
    value = numbers(places) - 10
    exact = stats.ttest_1samp(cells(value, places)[:, 0], 0)
    assert mean_of(value, places).p == pytest.approx(exact.pvalue)
    one = places.plate == 0
    assert mean_of(value[one], places[one]).p == pytest.approx(stats.ttest_1samp(value[one], 0).pvalue)
    assert mean_of(value[:1], places[np.arange(20) < 1]).reason == "a single well; a spread needs 2"


def test_holms_adjustment() -> None:
    np.testing.assert_allclose(holm(np.array([0.04, 0.01, np.nan, 0.03])), [0.06, 0.03, np.nan, 0.06])
    np.testing.assert_allclose(holm(np.array([0.6, 0.7])), [1, 1])
    assert holm(np.array([np.nan])).tolist() == pytest.approx([np.nan], nan_ok=True)


def test_intervals_hold_the_truth_where_effects_differ_from_plate_to_plate() -> None:
    """Two plates, effects that vary as much as wells: wells as samples would hold it in some 70 %."""
    rng, places, held = np.random.default_rng(2), on_plates(2, 2, 6), 0
    for _ in range(400):
        effects = rng.normal(size=(2, 2))
        value = effects[places.group, places.plate] + rng.normal(size=len(places.plate))
        found = difference(value, places, 1, 0)
        held += found.low <= 0 <= found.high
    assert 0.92 < held / 400 < 0.98


def test_an_estimate_that_cannot_be_told_is_empty() -> None:
    assert np.isnan(exponential(Estimate(reason="why")).value)
