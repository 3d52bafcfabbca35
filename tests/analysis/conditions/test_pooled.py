"""One value of several actuators and the difference of two, against drawn values whose truth is known."""

import math

import numpy as np
import pytest

from leactl.analysis.anova.pooled import difference, over_actuators
from leactl.analysis.estimate import Estimate
from leactl.errors import NotIdentifiable

NAN = math.nan


def estimate(value, std):
    return Estimate("x", value, std, value - 1.96 * std, value + 1.96 * std, "1")


def test_scatter_between_actuators_alone_is_students_interval():
    from scipy.stats import t

    values = np.array([0.48, 0.50, 0.49, 0.52])
    result = over_actuators([estimate(value, 0.0) for value in values])
    low, high = t.interval(0.95, 3, values.mean(), values.std(ddof=1) / 2.0)
    assert (result.value, result.low, result.high) == pytest.approx((values.mean(), low, high))


@pytest.mark.parametrize(("between", "own", "shared"), [(1.0, 0.1, 0.1), (0.2, 1.0, 0.0), (0.3, 0.2, 1.0)])
@pytest.mark.parametrize("actuators", [2, 4])
def test_the_interval_holds_the_mean_of_the_make(between, own, shared, actuators):
    rng = np.random.default_rng(3)
    held, seeds = 0, 1000
    for _ in range(seeds):
        values = rng.normal(0.0, between, actuators) + rng.normal(0.0, own, actuators) + rng.normal(0.0, shared)
        result = over_actuators([estimate(value, math.hypot(own, shared)) for value in values])
        held += result.low <= 0.0 <= result.high
    assert held / seeds > 0.94  # never less than told; more where errors of their own count twice


def test_what_is_not_known_takes_no_part():
    assert over_actuators([estimate(NAN, NAN), estimate(0.5, 0.1)]) == estimate(0.5, 0.1)
    bare = over_actuators([Estimate("r", value, NAN, NAN, NAN, "1") for value in (0.98, 0.99)])
    assert bare.value == pytest.approx(0.985)
    assert math.isnan(bare.std)
    with pytest.raises(NotIdentifiable, match="x: not known of any actuator"):
        over_actuators([estimate(NAN, NAN)])


def test_a_difference_is_the_second_less_the_first():
    result = difference(estimate(2.0, 0.3), estimate(2.6, 0.4))
    assert (result.value, result.std) == pytest.approx((0.6, 0.5))
    assert (result.low, result.high) == pytest.approx((0.6 - 0.98, 0.6 + 0.98))
    lopsided = difference(Estimate("x", 1.0, 0.1, 0.9, 1.4, "1"), Estimate("x", 3.0, 0.1, 2.7, 3.3, "1"))
    assert (lopsided.low, lopsided.high) == pytest.approx((2.0 - 0.5, 2.0 + math.hypot(0.3, 0.1)))
