"""The emulated bench with its phases resolved: the rig's temperatures, their voltage, and the bench file's keys."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leactl.bench import benchfile
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.plant.effects import make_effect
from leactl.emulation.plant.exact.rig import Rig
from leactl.emulation.plant.exact.rig_phases import PHASES_OF_PART, HottestPhase
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters, PhaseParameters, ThermalParameters
from leactl.emulation.plant.phase_lanes import PhaseLane, PhaseLanes
from leactl.emulation.plant.phases import lead_squares
from leactl.emulation.plant.stepped.rig import SteppedRig
from leactl.errors import InputError
from leactl.model.thermal_network import ACTIVE_SHARE
from leactl.safety.thermal.turning import LEAD_LOOSE_SHARE
from tests.emulation.five_nodes import AT_REST, TWO_LEADS, settled

LEA = ActuatorParameters()
QUICK = replace(LEA, thermal=ThermalParameters(winding_capacitance=5.0, housing_capacitance=20.0))  # settles in 500 s
RESOLVED = BenchParameters(phase_resolved=True, friction_heat=True)


def run(rig: Rig, duration: float, step: float) -> None:
    start = rig.time
    for k in range(1, round(duration / step) + 1):
        rig.advance(start + k * step)


def test_a_held_current_at_rest_heats_one_phase_to_the_closed_form():
    rig = Rig("locked", QUICK, bench=BenchParameters(phase_resolved=True))
    actuator = rig.actuators["test"]
    actuator.command("current", 10.0)
    run(rig, 600.0, 1.0)
    expected = settled(LEA, 100.0 * AT_REST)
    assert rig.hottest_phase("test").present == pytest.approx(expected[0], abs=0.1)
    assert actuator.winding_temperature == pytest.approx(expected[:3].mean(), abs=0.1)
    assert actuator.housing_temperature == pytest.approx(expected[3], abs=0.1)
    # the voltage has the mean of the three resistances
    assert actuator.voltage == pytest.approx(10.0 * LEA.resistance(expected[:3].mean()), rel=1e-3)
    assert rig.hottest_phase("load") == HottestPhase(25.0, 25.0)


@pytest.mark.parametrize("offset", [0.0, 1.0, math.pi / 2.0])
def test_rotor_angle_and_offset_choose_the_phase(offset):
    own = replace(LEA, resistance_coefficient=0.0, phases=PhaseParameters(commutation_offset=offset))
    rig = Rig("coupled", own, bench=BenchParameters(phase_resolved=True))
    rig.actuators["load"].command("angle", 0.5)
    run(rig, 2.0, 0.01)
    rig.actuators["test"].command("current", 20.0)
    beyond = np.zeros(3)
    # what a phase has beyond the mean decays to the other nodes with the winding's own 6.5 s
    decay = (1.0 / 5.6 + 1.0 / 0.3) / 22.9
    for _ in range(3000):  # the load's servo gives way by three electrical turns and comes back
        before = rig.actuators["test"].angle
        rig.advance(rig.time + 0.001)
        theta = own.pole_pairs * 0.5 * (before + rig.actuators["test"].angle) + offset
        shares = 2.0 / 3.0 * np.cos(theta - np.arange(3) * 2.0 * math.pi / 3.0) ** 2
        beyond += 0.001 * ((shares - 1.0 / 3.0) * 0.264 * 400.0 * 3.0 / 22.9 - decay * beyond)
    result = rig.hottest_phase("test").present - rig.actuators["test"].winding_temperature
    assert result == pytest.approx(beyond.max(), rel=0.005)


def test_highest_is_kept_while_the_phase_cools():
    rig = Rig("locked", bench=RESOLVED)
    rig.actuators["test"].command("current", 30.0)
    run(rig, 5.0, 0.01)
    peak = rig.hottest_phase("test")
    assert peak.present == peak.highest
    rig.actuators["test"].command("off")
    run(rig, 20.0, 0.01)
    cooled = rig.hottest_phase("test")
    assert cooled.highest == peak.highest
    assert cooled.present < peak.present - 50.0


def test_direct_current_through_two_leads_settles_at_the_closed_form():
    rig = Rig("heated", QUICK, bench=RESOLVED)
    rig.heater_current = 9.0
    run(rig, 1000.0, 50.0)
    expected = settled(LEA, 81.0 * TWO_LEADS)
    assert rig.hottest_phase("test").present == pytest.approx(expected[0], abs=1e-4)
    assert rig.actuators["test"].housing_temperature == pytest.approx(expected[3], abs=1e-4)
    assert rig.line_voltage == pytest.approx(9.0 * 2.0 * LEA.resistance(expected[0]), rel=1e-6)
    assert rig.part_of_winding("test", "active") == pytest.approx(expected[0], abs=1e-4)
    assert rig.part_of_winding("test", "inactive") == pytest.approx(expected[2], abs=1e-4)


def test_parts_of_the_winding_are_those_of_analysis_and_guard():
    rig = Rig("heated", bench=RESOLVED)
    rig.heater_current = 9.0
    run(rig, 20.0, 1.0)
    active, inactive = (rig.part_of_winding("test", part) for part in ("active", "inactive"))
    assert active - inactive > 15.0
    winding = ACTIVE_SHARE * active + (1.0 - ACTIVE_SHARE) * inactive
    assert winding == pytest.approx(rig.actuators["test"].winding_temperature, abs=1e-9)
    squares = lead_squares(np.array(81.0))
    assert squares.max() / squares.sum() == pytest.approx((1.0 + LEAD_LOOSE_SHARE) / 3.0)


@pytest.mark.parametrize("plant", [Rig, SteppedRig])
def test_a_winding_whose_phases_are_not_resolved_has_no_parts(plant):
    rig = plant("heated")
    rig.heater_current = 9.0
    run(rig, 20.0, 1.0)
    actuator = rig.actuators["test"]
    assert actuator.winding_temperature > 35.0
    assert {rig.part_of_winding("test", part) for part in PHASES_OF_PART} == {actuator.winding_temperature}


def test_rig_and_lanes_are_one_plant():
    rig = Rig("coupled", bench=RESOLVED)
    test, load = rig.actuators["test"], rig.actuators["load"]
    current, velocity, hottest = [], [], []
    for asked, turned in ((24.0, 0.0), (15.0, 3.0), (-20.0, -25.0), (0.0, 10.0)):
        load.command("velocity", turned)
        test.command("current", asked)
        for _ in range(2000):
            before = test.angle
            rig.advance(rig.time + 0.001)
            current.append(test.current_true)
            velocity.append((test.angle - before) / 0.001)
            hottest.append(rig.hottest_phase("test").present)
    lanes = PhaseLanes([PhaseLane()], 0.001)
    expected = lanes.run(np.array(current)[:, None], np.array(velocity)[:, None])[:, 0]
    np.testing.assert_allclose(hottest, expected, atol=0.05)
    assert test.housing_temperature == pytest.approx(lanes.network.housing[0], abs=0.01)


@pytest.mark.parametrize("step", [0.001, 0.033])
def test_result_does_not_depend_on_the_step_of_the_host(step):
    results = []
    for own in (step, 0.0033):
        rig = Rig("coupled", bench=RESOLVED)
        rig.actuators["load"].command("velocity", 2.0)
        rig.actuators["test"].command("current", 25.0)
        run(rig, 3.3, own)
        results.append(rig.hottest_phase("test"))
    assert results[0] == pytest.approx(results[1], abs=0.05)


def test_friction_warms_the_housing_of_a_turning_rotor():
    rig = Rig("free", QUICK, bench=RESOLVED)
    rig.actuators["test"].command("velocity", 30.0)
    run(rig, 500.0, 1.0)
    friction = (LEA.viscous_damping * 30.0 + LEA.coulomb_friction) * 30.0
    current = (LEA.viscous_damping * 30.0 + LEA.coulomb_friction) / LEA.torque_constant
    expected = settled(LEA, np.full(3, current**2 / 3.0), friction)
    assert rig.actuators["test"].housing_temperature == pytest.approx(expected[3], abs=0.02)


# ---------------------------------------------------------------- the bench file


RESOLVED_PHASES = "    phase_resolved: true\n"


def bench_file(tmp_path: Path, bench: str, extra: str = "") -> EmulatedBench:
    shipped = (benchfile.SHIPPED / "emulated.yaml").read_text()
    path = tmp_path / "bench.yaml"
    path.write_text(shipped.replace("  bench:\n", f"{extra}  bench:\n{bench}", 1))
    file, devices, _ = benchfile.load(str(path))
    return EmulatedBench(file, devices, "locked", "design")


def test_a_bench_file_resolves_the_phases(tmp_path):
    phases = "phases: {commutation_offset: 0.0, fixture_capacitance: 200}"
    bench = bench_file(tmp_path, f"{RESOLVED_PHASES}    friction_heat: true\n", f"  test: {{{phases}}}\n")
    bench.machine("test").command("current", 20.0)
    bench.clock.sleep_until(3.0)
    hottest = bench.rig.hottest_phase("test")
    assert hottest.present > bench.rig.actuators["test"].winding_temperature + 10.0


@pytest.mark.parametrize(
    ("bench", "extra", "said"),
    [
        ("    phase_resolved: 1\n", "", "phase_resolved: found 1, expected true or false"),
        ("    friction_heat: warm\n", "", "friction_heat: found 'warm', expected true or false"),
        (RESOLVED_PHASES, "  test: {phases: {offset: 1}}\n", "phases.offset: unknown parameter"),
        (
            RESOLVED_PHASES,
            "  test: {phases: {fixture_capacitance: -1}}\n",
            "phases.fixture_capacitance: -1 is outside",
        ),
        (
            "",
            "  load: {phases: {commutation_offset: 1}}\n",
            "phases: these act only where the bench has phase_resolved",
        ),
        (
            RESOLVED_PHASES,
            "  effects: [{name: nonlinear_convection}]\n",
            "phase_resolved: the stepped plant of these effects has no phases",
        ),
    ],
)
def test_settings_that_make_no_plant_are_refused(tmp_path, bench, extra, said):
    with pytest.raises(InputError) as caught:
        bench_file(tmp_path, bench, extra)
    assert said in str(caught.value)


def test_without_resolved_phases_none_is_hottest():
    with pytest.raises(InputError, match="phase_resolved: true"):
        Rig("free").hottest_phase("test")
    with pytest.raises(InputError, match="phase_resolved: true"):
        SteppedRig("free", test=ActuatorParameters(phases=PhaseParameters(1.0)))


def test_a_drive_that_reads_its_current_low_heats_with_the_current_that_flows():
    gain = make_effect("current_sensor_gain", {"gain": math.sqrt(2.0 / 3.0)})
    misread = Rig("locked", bench=RESOLVED, effects=[gain])
    plain = Rig("locked", bench=RESOLVED)
    misread.actuators["test"].command("current", 10.0)
    plain.actuators["test"].command("current", 10.0 * math.sqrt(1.5))
    for rig in (misread, plain):
        run(rig, 5.0, 0.01)
    assert misread.hottest_phase("test").present == pytest.approx(plain.hottest_phase("test").present, abs=0.05)
