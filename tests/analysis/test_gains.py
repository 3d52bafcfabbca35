"""What an analysis is told of its instruments: in the intervals of what they multiply, and refused where it is none."""

import math

import pytest

from leactl.analysis.analyze import analyze_runs
from leactl.errors import InputError

from .back_driven import driven as back_driven
from .envelopes import driven
from .free_rotors import turned
from .pulses import pulsed
from .run_outs import coasting
from .warmed import warmed

CASES = {
    "torque-constant": (
        lambda bench, **how: bench.torque(scatter=0.01, **how),
        "torque_gain_std",
        "torque_constant",
        "r_squared",
    ),
    "friction": (
        lambda bench, **how: bench.friction(scatter=0.002, **how),
        "current_gain_std",
        "viscous_damping",
        "r_squared",
    ),
    "no-load-loss": (turned, "current_gain_std", "no_load_loss", "full_speed"),
    "coast-down": (coasting, "current_gain_std", "rotor_inertia", "damping_over_inertia"),
    "back-drive": (
        lambda bench, **how: back_driven(bench, noise=0.0, **how),
        "torque_gain_std",
        "viscous_damping",
        "cogging_order",
    ),
    "torque-pulses": (pulsed, "torque_gain_std", "torque_constant", "loss_at_peak"),
    "torque-speed-envelope": (driven, "torque_gain_std", "highest_power", "corner_speed"),
    "winding-rise": (lambda bench: warmed(bench, step=0.0), "voltage_gain_std", "hot_resistance", "winding_rise"),
}

TORQUE, CURRENT = {"torque_gain_std": 0.0}, {"current_gain_std": 0.0}
NONE = {  # what makes a channel's own calibration count for nothing
    "torque-constant": TORQUE | CURRENT,
    "friction": CURRENT,
    "no-load-loss": CURRENT,
    "coast-down": CURRENT,
    "back-drive": TORQUE,
    "torque-pulses": TORQUE | CURRENT,
    "torque-speed-envelope": TORQUE,
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


def test_a_torque_constant_that_both_gains_scale(bench):
    path = bench.torque(scatter=0.01)
    told, silent = analyze_runs([path], torque_gain_std=0.03, current_gain_std=0.04), analyze_runs([path])
    half = analyze_runs([path], torque_gain_std=0.03)
    factor = "an error in the calibration of {} is a factor on the torque constants{}"
    assert factor.format("torque or current", "; its 0.05 is in their uncertainty") in told.notes
    assert factor.format("torque", "; its 0.03 is in their uncertainty") in half.notes
    assert factor.format("current", ", on top of their uncertainty") in half.notes
    for name in ("torque_constant", "torque_constant_rising", "torque_constant_falling"):
        before = silent.find(name)
        assert told.find(name).std == pytest.approx(math.hypot(0.05 * before.value, before.std), rel=0.01)
    stuck = silent.find("sticking_torque")
    assert told.find("sticking_torque").std == pytest.approx(math.hypot(0.03 * stuck.value, stuck.std), rel=0.01)


def test_a_current_off_by_its_gain_is_elsewhere_on_the_bend(bench):
    told, silent = (analyze_runs([path], current_gain_std=std) for path in [pulsed(bench)] for std in (0.02, 0.0))
    lost, before = told.find("loss_at_peak"), silent.find("loss_at_peak")
    assert lost.value == before.value
    assert lost.std > math.hypot(before.std, 0.02 * before.value)  # more than in proportion: what is lost grows faster


@pytest.mark.parametrize("experiment", [name for name in CASES if name != "winding-rise"])
def test_what_a_channel_says_of_its_calibration_counts_where_nothing_is_told(bench, experiment):
    make, _, scaled, _ = CASES[experiment]
    path = make(bench, scale_std=0.02)
    item, free = analyze_runs([path]).find(scaled), analyze_runs([path], **NONE[experiment]).find(scaled)
    both = 0.02 * math.sqrt(len(NONE[experiment]))
    assert item.std == pytest.approx(math.hypot(both * free.value, free.std), rel=0.02)


@pytest.mark.parametrize("experiment", CASES)
def test_a_gain_that_makes_no_sense_is_refused(bench, experiment):
    make, option, *_ = CASES[experiment]
    with pytest.raises(InputError, match=f"{option} -0.1: a relative standard uncertainty of zero or more"):
        analyze_runs([make(bench)], **{option: -0.1})
