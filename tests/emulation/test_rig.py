import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from leactl.emulation.plant.effects import known_effects, make_effect
from leactl.emulation.plant.exact.rig import Rig
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.emulation.plant.stepped.rig import SteppedRig
from leactl.errors import InputError
from tests.loops import current_step, position_step

LEA = ActuatorParameters()
KT, B, F = LEA.torque_constant, LEA.viscous_damping, LEA.coulomb_friction


def run(rig: Rig, duration: float, step: float = 0.02) -> None:
    start = rig.time
    for k in range(1, round(duration / step) + 1):
        rig.advance(start + k * step)


def free(current: float, duration: float = 4.0) -> Rig:
    rig = Rig("free")
    rig.actuators["test"].command("current", current)
    run(rig, duration)
    return rig


@pytest.mark.parametrize("current", [0.6, 0.74, 1.6, -0.6, -2.0])
def test_free_velocity_settles_where_friction_takes_the_torque(current):
    expected = math.copysign((KT * abs(current) - F) / B, current)
    actuator = free(current).actuators["test"]
    if abs(expected) > 42.0:
        raise AssertionError("beyond the voltage ceiling: choose a lower current")
    assert actuator.velocity_true == pytest.approx(expected, rel=1e-6)
    assert actuator.velocity == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("current", [0.42, -0.42, 0.1])
def test_sticks_below_coulomb_friction(current):
    actuator = free(current).actuators["test"]
    assert actuator.velocity_true == 0.0
    assert actuator.angle == 0.0


def test_reversal_is_symmetric():
    records = []
    for sign in (1.0, -1.0):
        rig = Rig("free")
        actuator = rig.actuators["test"]
        record = []
        for current in (2.0, -3.0, 0.2, 0.0, 4.0):
            actuator.command("current", sign * current)
            for _ in range(60):
                rig.advance(rig.time + 0.005)
                record.append(sign * actuator.angle)
        records.append(record)
    assert records[0] == pytest.approx(records[1], abs=1e-12)


def test_locked_current_step_is_first_order_of_the_stated_bandwidth():
    rig = Rig("locked")
    actuator = rig.actuators["test"]
    actuator.command("current", 7.5)
    for k in range(1, 40):
        rig.advance(k * 1e-4)
        expected = 7.5 * (1.0 - math.exp(-2.0 * math.pi * 450.0 * k * 1e-4))
        assert actuator.current == pytest.approx(expected, rel=1e-8)


LED = BenchParameters(current_loop_bandwidth=264.0, setpoint_lead=0.0892, setpoint_lead_time=0.0598)


@pytest.mark.parametrize(("kind", "tolerance"), [(Rig, 1e-8), (SteppedRig, 3e-4)])
def test_a_setpoint_that_leads_overshoots_as_its_closed_form(kind, tolerance):
    rig = kind("locked", bench=LED)
    actuator = rig.actuators["test"]
    actuator.command("current", 7.5)
    for k in range(1, 200):
        rig.advance(k * 1e-3)
        assert actuator.current == pytest.approx(7.5 * current_step(k * 1e-3, 264.0, 0.0892, 0.0598), rel=tolerance)


@pytest.mark.parametrize("kind", [Rig, SteppedRig])
def test_a_setpoint_that_leads_stays_below_the_drive_s_peak_current(kind):
    rig = kind("locked", bench=replace(LED, peak_current=10.0))
    actuator = rig.actuators["test"]
    actuator.command("current", 9.9)
    for k in range(1, 100):
        rig.advance(k * 1e-3)
        assert actuator.current <= 10.0 + 1e-9
    assert actuator.current > 9.9


@pytest.mark.parametrize("kind", [Rig, SteppedRig])
def test_a_lead_begins_from_the_current_that_flows(kind):
    """Taken over from a servo that holds its speed, the same current is no step."""
    rig = kind("free", bench=LED)
    actuator = rig.actuators["test"]
    actuator.command("velocity", 10.0)
    run(rig, 0.3)
    flowing = actuator.current
    actuator.command("current", flowing)
    for _ in range(50):
        rig.advance(rig.time + 1e-3)
        assert actuator.current == pytest.approx(flowing, rel=1e-3)


def test_a_position_step_agrees_with_an_integrator_of_the_servo_s_equations():
    bench = BenchParameters(position_gain=47.0, velocity_gain=123.0, speed_limit=25.15, current_loop_bandwidth=264.0)
    rig = Rig("free", bench=bench)
    rig.actuators["test"].command("angle", math.pi / 2)
    time, angle = position_step(math.pi / 2, LEA, bench, duration=0.4)
    results = []
    for at in time[1::20]:
        rig.advance(float(at))
        results.append(rig.actuators["test"].angle)
    np.testing.assert_allclose(results, angle[1::20], atol=2e-6 * math.pi)


def test_the_lock_is_beyond_the_torque_sensor():
    rig = Rig("locked")
    test, load = rig.actuators["test"], rig.actuators["load"]
    for k in range(1, 901):
        test.command("current", 10.0 * min(k / 600.0, 1.0))
        rig.advance(k * 1e-3)
    assert 4.9 - 0.208 - 1e-6 <= rig.shaft_torque <= 4.9
    assert test.angle == pytest.approx(rig.shaft_torque / rig.bench.shaft_stiffness, rel=1e-6)
    assert (test.velocity_true, load.velocity_true, load.angle) == (0.0, 0.0, 0.0)


def levels(order: list[float]) -> dict[float, float]:
    rig = Rig("coupled")
    rig.actuators["load"].command("angle", 0.0)
    torque = {}
    for level in order:
        rig.actuators["test"].command("current", level)
        run(rig, 5.5)
        torque[level] = rig.shaft_torque
    return torque


def test_levels_from_both_sides_have_their_mean_at_the_torque_constant():
    currents = [4.9 * k for k in range(1, 6)]
    rising = levels(currents)
    falling = levels([29.4, *reversed(currents)])
    for current in currents:
        assert (rising[current] + falling[current]) / 2.0 == pytest.approx(KT * current, rel=5e-4)
        assert 0.0 <= abs(rising[current] - falling[current]) / 2.0 <= F * (1.0 + 1e-9)


def busy_record(step: float) -> np.ndarray:
    """Both actuators, commands changed every 0.66 s, which is a multiple of 1, 20 and 33 ms."""
    rig = Rig("coupled")
    test, load = rig.actuators["test"], rig.actuators["load"]
    record = []
    for current, velocity in ((5.0, 10.0), (5.0, -10.0), (0.0, -12.0), (20.0, 30.0)):
        test.command("current", current)
        load.command("velocity", velocity)
        run(rig, 0.66, step)
        record.append([test.velocity_true, load.angle, load.current, rig.shaft_torque, test.winding_temperature])
    return np.array(record)


@pytest.mark.parametrize("step", [0.001, 0.033])
def test_result_does_not_depend_on_the_step_of_the_host(step):
    # the resistance is held over a step: at the voltage ceiling 33 ms of heating is 2e-4 of the current
    np.testing.assert_allclose(busy_record(step), busy_record(0.02 if step > 0.02 else 0.0033), rtol=3e-4, atol=1e-5)


def test_voltage_never_passes_the_ceiling():
    rig = Rig("free")
    actuator = rig.actuators["test"]
    ceiling = 29.6 / math.sqrt(2.0)
    for target in (500.0, -500.0):
        actuator.command("velocity", target)
        for _ in range(400):
            rig.advance(rig.time + 0.001)
            assert abs(actuator.voltage) <= ceiling * (1.0 + 1e-12)
            assert abs(actuator.current) <= 45.0 + 1e-6
    steady = actuator.resistance * actuator.current + LEA.back_emf_constant * actuator.velocity_true
    assert steady == pytest.approx(-ceiling, rel=1e-4)


def as_delta(parameters):
    """The delta with the leads of a wye: 3/2 of what two leads show in place of 1/2, sqrt(3) times the constants."""
    root = math.sqrt(3.0)
    return replace(
        parameters,
        winding="delta",
        phase_resistance=3.0 * parameters.phase_resistance,
        phase_inductance=3.0 * parameters.phase_inductance,
        torque_constant=root * parameters.torque_constant,
        back_emf_constant=root * parameters.back_emf_constant,
    )


@pytest.mark.parametrize("make", [Rig, SteppedRig])
def test_a_delta_runs_as_fast_as_the_wye_with_its_leads(make):
    bench = BenchParameters(peak_current=45.0 * math.sqrt(3.0))
    rigs = {
        name: make("free", parameters, bench=bench) for name, parameters in (("wye", LEA), ("delta", as_delta(LEA)))
    }
    for name, rig in rigs.items():
        rig.actuators["test"].command("current", 20.0 / (math.sqrt(3.0) if name == "delta" else 1.0))
        run(rig, 2.0, 0.01)
    wye, delta = (rig.actuators["test"] for rig in rigs.values())
    assert wye.voltage == pytest.approx(29.6 / math.sqrt(2.0), rel=1e-3)  # both are at their ceilings
    assert delta.voltage == pytest.approx(math.sqrt(3.0) * wye.voltage, rel=1e-6)
    assert delta.velocity_true == pytest.approx(wye.velocity_true, rel=1e-6)
    assert delta.current == pytest.approx(wye.current / math.sqrt(3.0), rel=1e-4)


def test_heated_rig_settles_at_the_closed_form():
    rig = Rig("heated")
    rig.heater_current = 5.0
    run(rig, 20000.0, 10.0)
    actuator = rig.actuators["test"]
    winding, housing = actuator.thermal.steady_rise(1.0)
    # heat = 2 R0 (1 + alpha rise) I^2 and rise = winding x heat, solved for the heat
    cold = 2.0 * LEA.phase_resistance * 25.0
    heat = cold / (1.0 - LEA.resistance_coefficient * winding * cold)
    assert actuator.winding_temperature == pytest.approx(25.0 + winding * heat, rel=1e-6)
    assert actuator.housing_temperature == pytest.approx(25.0 + housing * heat, rel=1e-6)
    assert rig.line_voltage * rig.line_current == pytest.approx(heat, rel=1e-6)


def test_same_calls_give_the_same_result():
    assert np.array_equal(busy_record(0.02), busy_record(0.02))


def test_every_fault_of_a_mapping_is_named():
    with pytest.raises(InputError) as caught:
        ActuatorParameters.from_mapping(
            {"torque_konstant": 1.0, "rotor_inertia": float("nan"), "thermal": {"winding_capacitance": -1.0}}
        )
    assert [fault.split(":")[0] for fault in caught.value.faults] == [
        "torque_konstant",
        "rotor_inertia",
        "thermal.winding_capacitance",
    ]


def test_unknown_effect_names_the_known_ones():
    with pytest.raises(InputError, match="cogging, command_slew_limit"):
        make_effect("coging")
    assert {"cogging", "torque_sensor_gain", "torque_sensor_offset"} <= set(known_effects())


def test_drive_regulates_the_current_its_sensor_shows():
    rig = Rig("locked", bench=BenchParameters(), effects=[make_effect("current_sensor_gain", {"gain": 1.25})])
    rig.actuators["test"].command("current", 5.0)
    run(rig, 0.1)
    assert rig.actuators["test"].current == pytest.approx(5.0)
    assert rig.actuators["test"].current_true == pytest.approx(4.0)


def test_cogging_modulates_the_velocity():
    rig = Rig("free", effects=[make_effect("cogging", {"amplitude": 0.05, "order": 12})])
    actuator = rig.actuators["test"]
    actuator.command("current", 0.8)
    run(rig, 2.0)
    seen = []
    for _ in range(500):
        rig.advance(rig.time + 0.001)
        seen.append(actuator.velocity_true)
    assert max(seen) - min(seen) > 0.1


def test_transient_agrees_with_an_integrator_of_the_equations():
    """Coupled, both rotors turning: current step against a velocity loop, by the equations of the design alone."""
    rig = Rig("coupled")
    rig.actuators["load"].command("velocity", 10.0)
    rig.actuators["test"].command("current", 2.0)
    run(rig, 1.0)
    rig.actuators["test"].command("current", 3.0)
    bench = rig.bench
    damping = 2 * bench.shaft_damping_ratio * math.sqrt(bench.shaft_stiffness * LEA.rotor_inertia / 2)
    gain = LEA.rotor_inertia / KT
    rate = 2 * math.pi * bench.current_loop_bandwidth

    def slope(_time, x):
        i1, w1, i2, w2, integral, twist = x
        shaft = bench.shaft_stiffness * twist + damping * (w1 - w2)
        wanted = gain * bench.velocity_gain * (10.0 - w2) + integral
        return [
            rate * (3.0 - i1),
            (KT * i1 - B * w1 - F - shaft) / LEA.rotor_inertia,
            rate * (wanted - i2),
            (KT * i2 - B * w2 - F + shaft) / LEA.rotor_inertia,
            gain * bench.velocity_integral * (10.0 - w2),
            w1 - w2,
        ]

    start = [rig.state(index) for index in (0, 1, 5, 6, 8, 10)]
    times = np.arange(1, 101) * 1e-3
    expected = solve_ivp(slope, (0, 0.1), start, t_eval=times, rtol=1e-9, atol=1e-12, method="LSODA").y
    for k, after in enumerate(times):
        rig.advance(1.0 + after)
        results = [rig.state(index) for index in (0, 1, 5, 6, 8, 10)]
        np.testing.assert_allclose(results, expected[:, k], rtol=2e-5, atol=2e-7)
