"""Peak currents against the exact solution of the three bodies, at every corner of the tolerances."""

import itertools

import numpy as np
import pytest

from leactl.model.continuous_current import STANDING_HEAT_SHARE, TURNING_HEAT_SHARE, ThermalActuator, current_for_rise
from leactl.model.motor import load_motor
from leactl.model.thermal_network import Conductances
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.guarded_currents import HIGHEST_CURRENT_A, PEAKS_S, nominal, peaks

AMBIENT = 25.0
RESISTANCES = ("winding_ambient_resistance", "winding_housing_resistance", "housing_ambient_resistance")
NETWORK = (*RESISTANCES, "winding_capacitance", "housing_capacitance")


def exact(box, ends, limit, duration, share):
    """The current that an actuator at a corner of a box carries, as its drive reads it."""
    values = [getattr(getattr(box, name), end) for name, end in zip(NETWORK, ends, strict=True)]
    network = Conductances(*(1.0 / value for value in values[:3]), *values[3:])
    actuator = ThermalActuator(
        network, box.phase_resistance.high, box.resistance_coefficient.high, box.reference_temperature
    )
    ambient = AMBIENT + box.ambient_rise
    return current_for_rise(actuator, limit - ambient, ambient, duration, share) / box.current_gain


def test_what_is_guaranteed_is_carried_by_the_weakest_actuator():
    motor = load_motor("lea")[0]
    box, limit = Box.of(motor), motor.limits.winding_temperature
    for item in peaks(motor, AMBIENT, PEAKS_S):
        corners = itertools.product(("low", "high"), repeat=len(NETWORK))
        weakest = min(exact(box, ends, limit, item.duration_s, STANDING_HEAT_SHARE) for ends in corners)
        assert 0.99 * weakest < item.current.guaranteed <= weakest
        assert item.torque.guaranteed == pytest.approx(motor.torque_constant * item.current.guaranteed)
        assert item.torque.favourable == pytest.approx(motor.torque_constant * item.current.favourable)


@pytest.mark.parametrize("name", ["lea", "u8-kv100"])
def test_nominal_peaks_are_those_of_the_exact_solution_or_a_little_less(name):
    motor = load_motor(name)[0]
    box, limit, durations = Box.exact(motor), motor.limits.winding_temperature, (0.5, 20.0, 300.0)
    result = nominal(motor, AMBIENT, durations)
    for share, told in ((TURNING_HEAT_SHARE, result.peaks), (STANDING_HEAT_SHARE, result.standing_peaks)):
        true = [exact(box, ("low",) * len(NETWORK), limit, duration, share) for duration in durations]
        ratios = np.array(told) / true
        assert ratios.max() <= 1.0
        assert ratios.min() > 0.99


def test_where_the_ambient_may_be_at_the_limit_already_nothing_is_guaranteed():
    motor = load_motor("lea")[0]
    limits = motor.limits.model_copy(update={"winding_temperature": AMBIENT + motor.tolerances.ambient_K - 0.5})
    for item in peaks(motor.model_copy(update={"limits": limits}), AMBIENT, (1.0, 60.0)):
        assert item.current.guaranteed == 0.0 < item.current.nominal


def test_a_limit_that_no_current_reaches_in_time_leaves_the_hardest_current_that_is_tried():
    motor = load_motor("lea")[0]
    heavy = motor.thermal.model_copy(update={"winding_capacitance": 1e9})
    [one] = peaks(motor.model_copy(update={"thermal": heavy}), AMBIENT, (1.0,))
    assert one.current.guaranteed == pytest.approx(HIGHEST_CURRENT_A)
