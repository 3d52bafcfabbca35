"""The judge of the intervals itself: what it counts and what it refuses."""

import pytest

from leactl.analysis.estimate import Estimate

from .judgement import judge


def estimates(values, half=0.5):
    return [Estimate("viscous_damping", value, half / 2, value - half, value + half, "N*m*s/rad") for value in values]


def test_shares_and_errors_are_counted():
    result = judge("viscous_damping", "design", 10.0, estimates([10.0, 10.4, 9.8, 10.6]))
    assert result.covered == 0.75
    assert result.worst_error == pytest.approx(0.06)
    assert result.mean_error == pytest.approx(0.03)
    assert result.bias == pytest.approx(0.02)
    assert result.printed == pytest.approx(0.025)


@pytest.mark.parametrize(
    ("outside", "fault"), [(1, "in 99.0% of seeds, not 92% to 98%"), (9, "in 91.0% of seeds"), (5, None)]
)
def test_too_many_and_too_few_are_faults(outside, fault):
    values = [10.0] * (100 - outside) + [10.2] * outside
    result = judge("viscous_damping", "design", 10.0, estimates(values, half=0.1)).faults
    assert result == [] if fault is None else fault in result[0]


def test_a_seed_far_off_is_a_fault_and_results_without_a_limit_have_none():
    values = [10.0] * 95 + [10.31] * 5
    assert "off by 3.10%, 3.0% are allowed" in judge("viscous_damping", "design", 10.0, estimates(values)).faults[-1]
    assert judge("sticking_torque", "design", 10.0, estimates(values)).faults == []


def test_each_seed_may_have_a_truth_of_its_own_and_a_truth_of_zero_gives_absolute_errors():
    result = judge("viscous_damping", "design", [10.0, 20.0, 30.0], estimates([10.1, 20.2, 31.5]))
    assert result.covered == pytest.approx(2 / 3)
    assert result.worst_error == pytest.approx(0.05)
    zero = judge("steady_state_error", "design", 0.0, estimates([0.1, -0.2]))
    assert (zero.covered, zero.worst_error) == (1.0, pytest.approx(0.2))
