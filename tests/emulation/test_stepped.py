"""The stepped plant without effects: against the rig, which is exact, and against what physics demands."""

import math
from dataclasses import replace

import numpy as np
import pytest

from leactl.emulation.plant.effects import make_effect
from leactl.emulation.plant.exact.rig import Rig
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.emulation.plant.stepped.heating import heat
from leactl.emulation.plant.stepped.lanes import Lane
from leactl.emulation.plant.stepped.plant import TICK, SteppedPlant
from leactl.emulation.plant.stepped.rig import SteppedRig
from leactl.emulation.plant.stepped.simulation import DriveReferences, simulate
from leactl.errors import InputError

LEA = ActuatorParameters()
CURRENTS = [(1.0, 300), (-3.0, 200), (0.3, 400), (8.0, 60), (0.0, 300)]  # A, ms


def walk_rig(setup: str) -> np.ndarray:
    rig = Rig(setup)
    test = rig.actuators["test"]
    rig.actuators["load"].command("current", 0.0)
    record, tick = [], 0
    for current, ticks in CURRENTS:
        test.command("current", current)
        for _ in range(ticks):
            tick += 1
            rig.advance(tick * TICK)
            record.append([test.velocity_true, test.angle, test.current_true, rig.shaft_torque])
    return np.array(record)


def walk_stepped(setup: str) -> np.ndarray:
    plant = SteppedPlant([Lane(setup)])
    record = []
    for current, ticks in CURRENTS:
        for _ in range(ticks):
            plant.advance(np.array([[current], [0.0]]))
            record.append([plant.velocity[0, 0], plant.angle[0, 0], plant.current[0, 0], plant.torque_read[0]])
    return np.array(record)


@pytest.mark.parametrize("setup", ["free", "coupled"])
def test_agrees_with_the_exact_rig(setup):
    rig, stepped = walk_rig(setup), walk_stepped(setup)
    scale = np.abs(rig).max(axis=0) + 1e-9
    difference = np.sqrt(((stepped - rig) ** 2).mean(axis=0)) / scale
    # velocity, angle, current, torque: the shaft rings at 360 Hz, where 0.1 ms steps are 0.2 % off in frequency
    assert (difference < [2e-3, 2e-3, 1e-3, 2e-2]).all(), difference


def test_rotor_sticks_below_coulomb_friction_and_nowhere_else():
    plant = SteppedPlant([Lane("free"), Lane("free")])
    for _ in range(200):
        plant.advance(np.array([[0.42, 0.44], [0.0, 0.0]]))  # 0.208 N*m is 0.424 A
    assert plant.velocity[0, 0] == 0.0
    assert plant.angle[0, 0] == 0.0
    assert plant.velocity[0, 1] > 0.05


@pytest.mark.parametrize("current", [0.6, 1.6, -2.0])
def test_free_velocity_settles_where_friction_takes_the_torque(current):
    plant = SteppedPlant([Lane("free")])
    for _ in range(1500):
        plant.advance(np.array([[current], [0.0]]))
    expected = math.copysign((0.49 * abs(current) - 0.208) / 0.0238, current)
    assert plant.velocity[0, 0] == pytest.approx(expected, rel=1e-4)


def test_locked_torque_is_the_current_s_less_what_sticks_and_the_angle_is_the_twist():
    plant = SteppedPlant([Lane("locked")])
    for k in range(900):
        plant.advance(np.array([[10.0 * min(k / 600.0, 1.0)], [0.0]]))
    torque = plant.torque_read[0]
    assert 4.9 - 0.208 - 1e-6 <= torque <= 4.9
    assert plant.angle[0, 0] == pytest.approx(torque / 6000.0, rel=1e-6)
    assert plant.velocity[0, 0] == 0.0


def test_energy_stays_without_friction_and_damping():
    smooth = replace(LEA, viscous_damping=0.0, coulomb_friction=0.0)
    plant = SteppedPlant([Lane("coupled", test=smooth, load=smooth, bench=BenchParameters(shaft_damping_ratio=0.0))])
    plant.velocity[0] = 3.0
    energies = []
    for _ in range(2000):
        plant.advance(np.zeros((2, 1)))
        energies.append(plant.kinetic_and_strain_energy[0])
    start = 0.5 * 0.0024 * 9.0
    # a leap-frog's energy swings by (angle a step)^2 / 4 = 1.2 % around a mean that stays
    assert np.mean(energies[:500]) == pytest.approx(start, rel=0.01)
    assert np.mean(energies[-500:]) == pytest.approx(np.mean(energies[:500]), rel=1e-3)


def test_power_is_balanced_at_steady_speed():
    """Electrical power = Joule heat + friction; load free of current, so its friction goes through the shaft."""
    plant = SteppedPlant([Lane("coupled")])
    for _ in range(2500):
        plant.advance(np.array([[2.0], [0.0]]))
    speed, current = plant.velocity[0, 0], plant.current[0, 0]
    electrical = plant.voltage_mean[0, 0] * current
    joule = LEA.resistance(float(plant.thermal.winding[0])) * current**2
    friction = 2.0 * (0.0238 * speed**2 + 0.208 * speed)
    assert electrical == pytest.approx(joule + friction, rel=1e-3)


def test_voltage_stays_under_its_ceiling_and_current_yields():
    plant = SteppedPlant([Lane("free")])
    voltages = []
    for _ in range(400):
        plant.advance(np.array([[20.0], [0.0]]))
        voltages.append(plant.voltage_mean[0, 0])
    assert max(voltages) <= 29.6 / math.sqrt(2.0) * 1.001
    assert plant.current[0, 0] < 3.0


def test_heated_run_agrees_with_the_rig_s_exact_thermal_network():
    current = np.concatenate([np.full(900, 9.0), np.zeros(600)])
    rig = Rig("heated")
    expected = []
    for value in current:
        expected.append([rig.actuators["test"].winding_temperature, rig.actuators["test"].housing_temperature])
        rig.heater_current = float(value)
        for _ in range(5):
            rig.advance(rig.time + 0.2)
    (run,) = heat([Lane("heated")], [current])
    np.testing.assert_allclose(np.stack([run.winding, run.housing], axis=1), expected, atol=0.01)
    assert run.voltage[0] == pytest.approx(2 * 0.264 * 9.0)


def test_lanes_do_not_feel_each_other_and_come_back_in_order():
    programs = [DriveReferences(np.full(50, current)) for current in (1.0, 2.0, 3.0)]
    together = simulate([Lane("free")] * 3, programs)
    alone = [simulate([Lane("free")], [program])[0] for program in programs]
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_array_equal(one.angle, other.angle)
        np.testing.assert_array_equal(one.voltage, other.voltage)


def test_servo_holds_its_velocity_and_opposes_the_test_drive():
    still = DriveReferences(np.zeros(1500), np.full(1500, 10.0), "test")
    load = DriveReferences(np.full(1500, 5.0), np.full(1500, -8.0), "load", 150.0, 1500.0, feedforward=0.9)
    free, coupled = simulate([Lane("free"), Lane("coupled")], [still, load])
    assert free.velocity[-200:].mean() == pytest.approx(10.0, abs=0.02)
    assert coupled.load_velocity[-200:].mean() == pytest.approx(-8.0, abs=0.05)
    assert coupled.load_current[-1] < -4.0


def test_the_rig_refuses_an_effect_it_has_no_form_for():
    with pytest.raises(InputError, match="stribeck: only the stepped plant"):
        Rig("free", effects=[make_effect("stribeck", {"breakaway_ratio": 0.2})])


def test_one_lane_stands_in_for_the_rig():
    rig, stepped = Rig("coupled"), SteppedRig("coupled")
    readings = []
    for bench in (rig, stepped):
        bench.actuators["load"].command("velocity", 8.0)
        bench.actuators["test"].command("current", 5.0)
        bench.advance(0.8)
        test = bench.actuators["test"]
        reading = [test.velocity, test.current, test.voltage, bench.shaft_torque, bench.actuators["load"].current]
        test.command("off")
        bench.actuators["load"].command("angle", bench.actuators["load"].angle + 0.3)
        start = bench.actuators["load"].angle
        bench.advance(1.4)
        readings.append([*reading, bench.actuators["load"].angle - start, test.current_true])
    np.testing.assert_allclose(readings[1], readings[0], rtol=2e-3, atol=2e-3)


def test_one_lane_heats_as_the_rig_does():
    rigs = [Rig("heated"), SteppedRig("heated")]
    for rig in rigs:
        rig.heater_current = 9.0
        for _ in range(1500):
            rig.advance(rig.time + 0.2)
    exact, stepped = rigs
    assert stepped.line_voltage == pytest.approx(exact.line_voltage, rel=1e-4)
    assert stepped.actuators["test"].housing_temperature == pytest.approx(
        exact.actuators["test"].housing_temperature, abs=0.01
    )


def test_a_live_bench_refuses_a_form_that_looks_ahead():
    with pytest.raises(InputError, match="torque_sensor_hysteresis: its form needs a whole record"):
        SteppedRig("free", effects=[make_effect("torque_sensor_hysteresis", {"width": 0.02})])
