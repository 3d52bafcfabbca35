"""What an analysis is told of its instruments: in the intervals of what they multiply, and refused where it is none."""

import math

import pytest

from leactl.analysis.experiments import analyze_runs
from leactl.errors import InputError

from .back_driven import driven as back_driven
from .envelopes import driven
from .pulses import pulsed
from .warmed import warmed

CASES = {
    "back-drive": (lambda bench: back_driven(bench, noise=0.0), "torque_gain_std", "viscous_damping", "cogging_order"),
    "torque-pulses": (pulsed, "torque_gain_std", "torque_constant", "loss_at_peak"),
    "torque-speed-envelope": (driven, "torque_gain_std", "highest_power", "corner_speed"),
    "winding-rise": (lambda bench: warmed(bench, step=0.0), "voltage_gain_std", "hot_resistance", "winding_rise"),
}


@pytest.mark.parametrize("experiment", CASES)
def test_a_gain_is_in_what_it_multiplies_and_in_nothing_else(bench, experiment):
    make, option, scaled, free = CASES[experiment]
    path = make(bench)
    told, silent = analyze_runs([path], **{option: 0.02}), analyze_runs([path])
    before = silent.find(scaled)
    assert told.find(scaled).std == pytest.approx(math.hypot(0.02 * before.value, before.std), rel=0.02)
    assert repr(told.find(free)) == repr(silent.find(free))  # NaN is no equal of NaN
    assert any("0.02 is in their uncertainty" in note for note in told.notes)


def test_a_current_off_by_its_gain_is_elsewhere_on_the_bend(bench):
    told, silent = (analyze_runs([path], current_gain_std=std) for path in [pulsed(bench)] for std in (0.02, 0.0))
    lost, before = told.find("loss_at_peak"), silent.find("loss_at_peak")
    assert lost.value == before.value
    assert lost.std > math.hypot(before.std, 0.02 * before.value)  # more than in proportion: what is lost grows faster


@pytest.mark.parametrize("experiment", CASES)
def test_a_gain_that_makes_no_sense_is_refused(bench, experiment):
    make, option, *_ = CASES[experiment]
    with pytest.raises(InputError, match=f"{option} -0.1: a relative standard uncertainty of zero or more"):
        analyze_runs([make(bench)], **{option: -0.1})
