"""What a second sensor allows a current to be: derived by hand, and the short way for whole windows beside the long."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.safety.interlocks import TorqueDisagreement, VoltageDisagreement
from leactl.safety.thermal.box import Range
from leactl.safety.witnesses import TORQUE_CONSTANT_LOSS, ByTorque, ByVoltage, TorqueModel
from tests.safety.guards import LEA, SETTINGS, guard_of

PERIOD = 0.01
MODEL = TorqueModel.of(LEA)
RESISTANCE = Range(0.2, 0.3)
BACK_EMF = 0.5
TORQUE = TorqueDisagreement.model_validate({"tolerance_Nm": 0.2, "share_percent": 5.0})
VOLTAGE = VoltageDisagreement.model_validate({"tolerance_V": 0.1, "share_percent": 4.0})
WITNESSES = {
    "torque of the actuator under test": ByTorque(TORQUE, MODEL, 1.0),
    "torque of the other": ByTorque(TORQUE, MODEL, -1.0),
    "voltage": ByVoltage("test q_axis_voltage", VOLTAGE, BACK_EMF, lambda: RESISTANCE),
}
READINGS = st.lists(st.tuples(st.floats(-12.0, 12.0), st.floats(-30.0, 30.0)), min_size=1, max_size=8)


def ends(values):
    return float(values.min()), float(values.max())


@pytest.mark.parametrize("name", WITNESSES)
@given(readings=READINGS, before=st.floats(-30.0, 30.0))
def test_the_ends_of_a_window_promise_no_more_than_its_samples_hold(name, readings, before):
    witness, (second, velocity) = WITNESSES[name], np.array(readings).T
    result = witness.currents(second, velocity, before, PERIOD)
    lowest, highest = witness.extremes(ends(second), ends(velocity))
    assert result.low.max() <= lowest + 1e-9
    assert result.high.min() >= highest - 1e-9
    assert (result.low <= result.likely + 1e-9).all() and (result.likely <= result.high + 1e-9).all()


@pytest.mark.parametrize("name", WITNESSES)
@given(second=st.floats(-12.0, 12.0), velocity=st.sampled_from([-20.0, -3.0, 0.0, 3.0, 20.0]))
def test_of_one_steady_sample_the_ends_promise_all_there_is(name, second, velocity):
    witness = WITNESSES[name]
    result = witness.currents(np.array([second]), np.array([velocity]), velocity, PERIOD)
    lowest, highest = witness.extremes((second, second), (velocity, velocity))
    assert lowest >= result.low[0] - 1e-9
    if name == "voltage":  # the share of the voltage is left out of the ends
        wider = (VOLTAGE.share_percent / 100.0) * (abs(second) + abs(BACK_EMF * velocity))
        assert lowest == pytest.approx(max(0.0, abs(second - BACK_EMF * velocity) - VOLTAGE.tolerance_V) / 0.3)
        assert highest == pytest.approx(result.high[0] - wider / 0.2)
    elif velocity == 0.0:
        assert lowest == pytest.approx(result.low[0])
        assert highest == pytest.approx(result.high[0])
    else:  # friction that turns with the motion is in doubt at both ends at once
        doubt = MODEL.coulomb_friction.high - MODEL.coulomb_friction.low
        doubt += (MODEL.viscous_damping.high - MODEL.viscous_damping.low) * abs(velocity)
        assert lowest <= result.low[0] + doubt / MODEL.torque_constant
        assert highest >= result.high[0] - 1.05 * doubt / ((1.0 - TORQUE_CONSTANT_LOSS) * MODEL.torque_constant)
    if velocity == 0.0:
        assert np.sign(witness.direction(second, velocity)) == result.direction[0]


def test_a_voltage_tells_of_what_back_emf_leaves_over_the_resistance():
    """3 V at 4 rad/s: 1 V is left, 0.2 V and 0.1 V of it in doubt, over 0.2 to 0.3 ohm."""
    result = WITNESSES["voltage"].currents(np.array([3.0]), np.array([4.0]), 4.0, PERIOD)
    assert WITNESSES["voltage"].label == "test q_axis_voltage"
    assert result.direction[0] == 1.0
    assert result.low[0] == pytest.approx(0.7 / 0.3)
    assert result.likely[0] == pytest.approx(1.0 / math.sqrt(0.06))
    assert result.high[0] == pytest.approx(1.3 / 0.2)


def test_a_torque_tells_of_what_friction_inertia_and_hot_magnets_leave_over_the_torque_constant():
    """A rotor that speeds up by 1 rad/s in a cycle, its friction against the motion and its inertia in doubt."""
    velocity, torque = 10.0, 6.0
    result = WITNESSES["torque of the actuator under test"].currents(
        np.array([torque]), np.array([velocity]), velocity - 1.0, PERIOD
    )
    least = MODEL.coulomb_friction.low + MODEL.viscous_damping.low * velocity
    most = MODEL.coulomb_friction.high + MODEL.viscous_damping.high * velocity
    given = torque + 0.5 * (least + most)
    doubt = 0.5 * (most - least) + MODEL.rotor_inertia * 1.0 / PERIOD + 0.2
    assert result.low[0] == pytest.approx((0.95 * given - doubt) / MODEL.torque_constant)
    assert result.likely[0] == pytest.approx(given / MODEL.torque_constant)
    assert result.high[0] == pytest.approx(
        (1.05 * given + doubt) / ((1.0 - TORQUE_CONSTANT_LOSS) * MODEL.torque_constant)
    )


def test_the_resistance_of_a_phase_lies_between_the_coldest_it_may_be_and_where_its_bound_stands():
    guard = guard_of(start=90.0)
    box, found = guard.boxes["test"], guard.resistances("test")
    rise, coldest = box.resistance_coefficient, SETTINGS.ambient - box.ambient_rise - box.reference_temperature
    assert box.ambient_rise > 0.0 > coldest * rise.high
    assert found.low == pytest.approx(box.phase_resistance.low * (1.0 + rise.high * coldest))
    warmest = guard.hottest["test"] - box.reference_temperature
    assert guard.hottest["test"] == 90.0
    assert found.high == pytest.approx(box.phase_resistance.high * (1.0 + rise.high * warmest))
