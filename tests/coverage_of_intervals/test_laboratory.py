"""The command that judges the laboratory's intervals: what it prints and refuses, with few seeds."""

import pytest

from leactl.analysis.estimate import Estimate

from .judgement import judge
from .laboratory import answered, faults_of, main
from .laboratory_cases import CASES


@pytest.mark.parametrize("experiment", CASES)
def test_every_result_with_an_interval_has_a_truth_near_it(experiment):
    answer = answered((experiment, next(iter(CASES[experiment])), 1))
    assert len(answer) > 1
    for item, true, bound in answer:
        half = 0.5 * (item.high - item.low)
        assert bound or item.low - 2 * half <= true <= item.high + 2 * half, item.name


def test_a_result_whose_truth_is_not_known_is_no_silence(monkeypatch):
    whole = CASES["torque-pulses"]["noise"]

    def forgetful(bench):
        made = whole(bench)
        del made.true["sticking_torque"]
        return made

    monkeypatch.setitem(CASES["torque-pulses"], "noise", forgetful)
    with pytest.raises(KeyError, match="sticking_torque"):
        answered(("torque-pulses", "noise", 1))


def test_the_table_has_every_case_and_one_seed_is_too_few_for_a_share_between(capsys):
    assert main(["--seeds", "1", "--processes", "1", "--only", "torque-pulses"]) == 1
    lines = capsys.readouterr().out.splitlines()
    for case in CASES["torque-pulses"]:
        assert any(line.startswith("loss_at_peak") and case in line for line in lines)
    assert any(line.startswith("straight_up_to") and line.endswith("bound") for line in lines)
    assert any(
        line.startswith("torque-pulses: loss_at_peak, ") and "of seeds, not 92% to 98%" in line for line in lines
    )


@pytest.mark.parametrize(("outside", "fault"), [(0, None), (8, None), (9, "the bound holds in 91.0% of seeds")])
def test_a_bound_may_hold_always_and_must_hold_often(outside, fault):
    highs = [2.0] * (100 - outside) + [0.5] * outside
    bounds = [Estimate("eddy_damping", float("nan"), float("nan"), 0.0, high, "N*m*s/rad") for high in highs]
    faults = faults_of(judge("eddy_damping", "noise", 1.0, bounds), True)
    assert faults == [] if fault is None else fault in faults[0]
