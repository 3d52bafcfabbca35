"""Energy of a cycle against closed forms of sinusoids, and its balance over any cycle."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.model.cycle import POINTS_PER_CYCLE, Cycle
from leactl.model.energy import DriveSupply, best_ratio, remarks, stride
from leactl.model.motor import load_sheet
from leactl.model.winding import FRAMES

LEA, U8, MAXON = (load_sheet(name)[0] for name in ("lea", "u8-kv100", "ec-4pole-30"))
PART = 2.0 * np.pi * np.arange(POINTS_PER_CYCLE) / POINTS_PER_CYCLE


def swing(amplitude=0.4, torque=50.0, phase=0.7, period=1.1, mean=0.0):
    rate = 2.0 * np.pi / period
    return Cycle(
        "swing",
        period,
        amplitude * np.sin(PART),
        amplitude * rate * np.cos(PART),
        -amplitude * rate**2 * np.sin(PART),
        torque * np.cos(PART + phase) + mean,
        harmonics=1,
        relative_residual=0.0,
    )


def frictionless(motor):
    return motor.model_copy(update={"viscous_damping": 0.0, "coulomb_friction": 0.0, "resistance_coefficient": 0.0})


def test_a_sinusoid_has_its_closed_form():
    cycle, ratio = swing(), 12.0
    result = stride(frictionless(LEA), cycle, ratio)
    # torque of the motor: T/N cos(x + p) - J N a w^2 sin x, of squared amplitude |T/N e^jp + j J N a w^2|^2
    inertia = LEA.rotor_inertia * ratio * 0.4 * (2.0 * math.pi / 1.1) ** 2
    size = abs(50.0 / ratio * np.exp(0.7j) + 1j * inertia)
    assert result.joule == pytest.approx(1.1 * LEA.phase_resistance * (size / LEA.torque_constant) ** 2 / 2.0)
    assert result.joint_work == pytest.approx(0.5 * 50.0 * math.cos(0.7) * 0.4 * 2.0 * math.pi)
    assert result.electrical == pytest.approx(result.joint_work + result.joule)
    assert result.peak_line_current == pytest.approx(size / LEA.torque_constant / FRAMES["wye"].current, rel=1e-4)


def test_viscous_and_coulomb_friction_have_theirs():
    result = stride(LEA, swing(), 12.0)
    speed = 12.0 * 0.4 * 2.0 * math.pi / 1.1
    assert result.viscous == pytest.approx(1.1 * LEA.viscous_damping * speed**2 / 2.0)
    assert result.coulomb == pytest.approx(LEA.coulomb_friction * 4.0 * 12.0 * 0.4, rel=1e-3)


def test_the_winding_ends_where_heat_in_is_heat_out():
    result = stride(LEA, swing(torque=120.0), 12.0)
    rise = result.winding_temperature - 25.0
    outwards = 1.0 / (1.0 / 5.6 + 1.0 / 2.0)
    assert rise == pytest.approx(result.joule / 1.1 * outwards)
    cold = stride(LEA, swing(torque=120.0), 12.0, supply=DriveSupply(winding_temperature=25.0))
    assert result.joule / cold.joule == pytest.approx(1.0 + 0.004 * rise)


def test_the_best_ratio_balances_load_and_inertia():
    cycle = swing(phase=0.0, torque=20.0)  # load and inertia in quadrature: their squares add up
    bend = np.sqrt(np.mean(cycle.acceleration**2))
    closed = math.sqrt(math.sqrt(np.mean(cycle.torque**2)) / (LEA.rotor_inertia * bend) * 1.0)
    result = best_ratio(frictionless(LEA), cycle, supply=DriveSupply(bus_voltage=500.0))
    assert result.ratio == pytest.approx(closed, rel=1e-3)


def test_a_bus_that_is_too_low_moves_the_best_ratio_down_to_its_ceiling():
    cycle = swing(phase=0.0, torque=20.0)
    free, bound = best_ratio(LEA, cycle, supply=DriveSupply(500.0)), best_ratio(LEA, cycle, supply=DriveSupply(12.0))
    assert bound.ratio < free.ratio
    assert bound.feasible
    assert bound.electrical > free.electrical
    assert 0.99 < bound.peak_voltage / bound.voltage_ceiling <= 1.0


def test_points_beyond_a_ceiling_are_counted_and_the_first_is_told():
    by_voltage = stride(LEA, swing(), 40.0, supply=DriveSupply(29.6))
    assert by_voltage.over_voltage > 0
    assert by_voltage.first_beyond_percent == 0.0  # the swing begins at its fastest
    assert not by_voltage.feasible
    by_current = stride(LEA, swing(phase=-math.pi / 2.0), 5.0, supply=DriveSupply(500.0, line_current=10.0))
    assert by_current.over_voltage == 0
    needed = stride(LEA, swing(phase=-math.pi / 2.0), 5.0, supply=DriveSupply(500.0)).peak_line_current
    assert needed > 10.0
    assert 0.0 < by_current.first_beyond_percent < 25.0
    assert 0 < by_current.over_current < POINTS_PER_CYCLE


def test_a_winding_that_runs_away_is_too_hot():
    result = stride(LEA, swing(torque=3000.0), 5.0, supply=DriveSupply(1000.0))
    assert result.too_hot
    assert math.isinf(result.winding_temperature)
    assert not result.feasible


def test_where_nothing_is_feasible_the_least_bad_is_given():
    result = best_ratio(U8, swing(torque=150.0), supply=DriveSupply(5.0, line_current=5.0))
    assert not result.feasible
    assert result.over_voltage + result.over_current > 0


def test_a_held_joint_is_held_by_friction_as_far_as_that_goes():
    held = Cycle(
        "held",
        1.0,
        np.zeros(POINTS_PER_CYCLE),
        np.zeros(POINTS_PER_CYCLE),
        np.zeros(POINTS_PER_CYCLE),
        np.full(POINTS_PER_CYCLE, 10.0),
        1,
        0.0,
    )
    result = stride(LEA, held, 10.0)
    left = 10.0 / 10.0 - LEA.coulomb_friction
    rise = result.winding_temperature - 25.0
    heat = LEA.phase_resistance * (1.0 + 0.004 * rise) * (left / LEA.torque_constant) ** 2
    assert result.joule == pytest.approx(heat)
    assert result.coulomb == 0.0


def test_a_lossy_transmission_costs_the_motor_going_out_and_the_joint_coming_back():
    cycle = swing(phase=0.0)  # drives throughout
    result = stride(frictionless(LEA), cycle, 12.0, efficiency=0.8)
    assert result.transmission == pytest.approx(result.joint_work * (1.0 / 0.8 - 1.0))
    back = swing(phase=math.pi)  # brakes throughout
    result = stride(frictionless(LEA), back, 12.0, efficiency=0.8)
    assert result.transmission == pytest.approx(-result.joint_work * (1.0 - 0.8))


@settings(max_examples=40)
@given(
    motor=st.sampled_from([LEA, U8, MAXON]),
    amplitude=st.floats(0.05, 1.5),
    torque=st.floats(0.1, 60.0),
    phase=st.floats(0.0, 6.3),
    mean=st.floats(-30.0, 30.0),
    ratio=st.floats(1.0, 300.0),
    efficiency=st.floats(0.3, 1.0),
)
def test_nothing_is_lost_and_nothing_is_gained(motor, amplitude, torque, phase, mean, ratio, efficiency):
    result = stride(
        motor, swing(amplitude, torque, phase, mean=mean), ratio, efficiency, DriveSupply(winding_temperature=60.0)
    )
    spent = result.joint_work + result.joule + result.viscous + (result.coulomb or 0.0) + result.transmission
    assert result.electrical == pytest.approx(spent, rel=1e-9, abs=1e-9 * result.joule)
    assert result.electrical_without_return >= result.electrical - 1e-9 * abs(result.electrical)
    assert result.transmission >= -1e-12


def test_what_a_motor_lacks_is_said_or_refused():
    maxon = stride(MAXON, swing(), 100.0)
    assert maxon.coulomb is None
    assert len(remarks(MAXON, maxon)) == 3
    assert remarks(LEA, stride(LEA, swing(), 10.0)) == []
    with pytest.raises(InputError, match=r"'lea' has no rotor_inertia, viscous_damping: its energy cannot"):
        stride(LEA.model_copy(update={"rotor_inertia": None, "viscous_damping": None}), swing(), 10.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"ratio": 0.0}, "ratio 0: from 0.05"),
        ({"ratio": math.nan}, "ratio nan"),
        ({"efficiency": 0.0}, "efficiency 0: more than 0"),
        ({"efficiency": 1.1}, "efficiency 1.1"),
        ({"supply": DriveSupply(0.0)}, "bus voltage 0 V"),
        ({"supply": DriveSupply(29.6, -1.0)}, "line current -1 A"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        stride(LEA, swing(), **({"ratio": 10.0} | arguments))
