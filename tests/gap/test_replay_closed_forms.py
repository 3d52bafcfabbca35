"""Replay against what can be worked out by hand."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from leactl.gap.replay import replay
from leactl.gap.replay.cutting import CutJob
from leactl.gap.signals.record import LONG_GAP, Record
from tests.gap.synthetic import (
    BENCH,
    CONSTANT,
    DAMPING,
    FRICTION,
    INDUCTANCE,
    INERTIA,
    INTERVAL_S,
    RESISTANCE,
    STIFFNESS,
    THERMAL,
    clocked,
    model,
    record,
)
from tests.loops import current_step

UNFILTERED = {"bus_voltage": 29.6, "shaft_stiffness": 6000.0}


def test_a_free_rotor_decays_to_standstill_and_stays():
    job = replay(record("free", reference=0.0, start_speed=2.0), model(bench=UNFILTERED))
    turning = job.fast["velocity", "test"][5:]
    time = INTERVAL_S * np.arange(1, len(turning) + 1)
    level = FRICTION / DAMPING
    expected = np.maximum((2.0 + level) * np.exp(-DAMPING / INERTIA * time) - level, 0.0)
    assert turning == pytest.approx(expected, abs=0.06)  # bristles give back a little where it stops
    assert np.max(np.abs(turning[100:])) < 1e-9


def test_friction_that_builds_up_after_a_swift_reversal_takes_less_of_the_motion():
    """Over the angle in which it builds up exponentially from one level to the other, friction is missing twice."""
    displacement = 0.02
    run = record("free", reference=6.0, start_speed=-20.0, seconds=0.1)
    energies = []
    for effects in ((), (("presliding", {"displacement": displacement}),)):
        job = replay(run, model(*effects, viscous_damping=0.0))
        reversal = int(np.argmax(job.velocity > 0.0))
        turned = job.angle[reversal:] - job.angle[reversal]
        speed = float(np.interp(1.0, turned, job.velocity[reversal:]))  # rad after the reversal
        energies.append(0.5 * INERTIA * speed**2)
    assert energies[1] - energies[0] == pytest.approx(2.0 * FRICTION * displacement, rel=0.15)


def test_a_current_settles_at_the_speed_that_friction_allows():
    reference = 2.0
    job = replay(record("free", reference=reference, start_speed=30.0), model())
    assert job.fast["velocity", "test"][-1] == pytest.approx((CONSTANT * reference - FRICTION) / DAMPING, rel=1e-3)


def test_a_current_below_friction_does_not_move_a_free_rotor():
    job = replay(record("free", reference=0.5 * FRICTION / CONSTANT), model())
    speed = job.fast["velocity", "test"][5:]
    assert np.sum(speed) * INTERVAL_S < 1e-3
    assert np.max(np.abs(speed[100:])) < 1e-6


def test_current_follows_a_step_as_a_first_order_loop():
    reference = np.where(np.arange(1000) >= 500, 5.0, 0.0)
    job = replay(record("locked", reference=reference), model())
    constant = 1.0 / (2 * np.pi * 450.0)
    first = 5.0 * (1 - constant / INTERVAL_S * (1 - np.exp(-INTERVAL_S / constant)))
    assert job.fast["q_axis_current", "test"][500] == pytest.approx(first, rel=1e-6)
    assert job.fast["q_axis_current", "test"][520] == pytest.approx(5.0)


def test_current_follows_a_step_of_a_setpoint_that_leads():
    reference = np.where(np.arange(1000) >= 500, 5.0, 0.0)
    led = {"current_loop_bandwidth": 264.0, "setpoint_lead": 0.0892, "setpoint_lead_time": 0.0598}
    job = replay(record("locked", reference=reference), model(bench=BENCH | led))
    instants = current_step(INTERVAL_S * np.arange(1, 101), 264.0, 0.0892, 0.0598)
    fine = current_step(np.linspace(0.0, 0.1, 100_001), 264.0, 0.0892, 0.0598)
    means = fine[:-1].reshape(100, 1000).mean(axis=1)  # the record's current is a mean over its interval
    assert job.fast["q_axis_current", "test"][500:600] == pytest.approx(5.0 * means, rel=1e-3)
    assert instants.max() == pytest.approx(1.083, abs=5e-4)


def test_a_locked_rotor_rings_around_its_torque_and_sticks_within_friction_of_it():
    reference = np.where(np.arange(2000) >= 500, 10.0, 0.0)
    job = replay(record("locked", reference=reference, seconds=2.0), model())
    torque = job.fast["torque", "test"]
    assert np.nanmax(torque) > 1.1 * CONSTANT * 10.0
    assert abs(torque[-1] - CONSTANT * 10.0) <= FRICTION
    assert np.ptp(torque[1500:]) < 1e-9


def test_a_slow_rise_and_fall_of_a_locked_current_leaves_friction_on_both_sides():
    reference = 10.0 * np.interp(np.arange(8000), [0, 3500, 4500, 7999], [0, 1, 1, 0])
    job = replay(record("locked", reference=reference, seconds=8.0), model())
    torque = job.fast["torque", "test"]
    assert torque[2000] == pytest.approx(CONSTANT * reference[2000] - FRICTION, abs=0.02)
    assert torque[6000] == pytest.approx(CONSTANT * reference[6000] + FRICTION, abs=0.02)


def test_two_coupled_rotors_share_the_torque_of_one():
    reference = 4.0
    job = replay(record("coupled", reference=reference, seconds=2.0, start_speed=20.0), model())
    speed = job.fast["velocity", "test"][-1]
    assert speed == pytest.approx((CONSTANT * reference - 2 * FRICTION) / (2 * DAMPING), rel=0.02)
    assert job.fast["torque", "test"][-1] == pytest.approx(0.5 * CONSTANT * reference, rel=0.02)


def test_a_locked_shaft_is_twisted_by_its_torque_over_its_stiffness():
    ramp = 20.0 * np.minimum(np.arange(4000) / 3000, 1.0)
    job = replay(record("locked", reference=ramp, seconds=4.0), model())
    assert np.ptp(job.torque) > 9.0
    assert np.ptp(job.angle) == pytest.approx(np.ptp(job.torque) / STIFFNESS, rel=1e-3)


def test_a_shaft_between_two_rotors_is_twisted_by_its_torque_over_its_stiffness():
    ramp = 20.0 * np.minimum(np.arange(2000) / 900, 1.0)
    job = replay(record("coupled", reference=ramp, seconds=2.0), model())
    first, last = 200, 3500  # steps, before it begins again
    twist = np.sum((job.velocity - job.load_velocity)[first:last]) * job.step
    torque = job.torque[last] - job.torque[first]
    assert torque > 4.0
    assert twist == pytest.approx(torque / STIFFNESS, rel=1e-3)


def test_a_winding_that_warms_from_the_first_sample_starts_where_it_was():
    def temperatures(warm):
        run = record("locked", reference=20.0, seconds=10.0, warm=warm)
        return replay(run, model()).slow

    first = temperatures((25.0, 25.0))
    measured = tuple(first[f"{node}_temperature", "test"] for node in ("winding", "housing"))
    assert measured[0][15] - measured[0][0] > 3.0
    again = temperatures(measured)
    for node, values in zip(("winding", "housing"), measured, strict=True):
        assert again[f"{node}_temperature", "test"] == pytest.approx(values, abs=0.02)


def test_voltage_is_resistance_inductance_and_back_emf():
    reference = 0.02 * np.arange(1000)
    job = replay(record("locked", reference=reference), model(resistance_coefficient=0.0))
    flowing = job.fast["q_axis_current", "test"][900]
    expected = RESISTANCE * flowing + INDUCTANCE * 20.0
    assert job.fast["q_axis_voltage", "test"][900] == pytest.approx(expected, abs=2e-3)
    spun = replay(record("free", reference=0.0, start_speed=20.0), model(bench=UNFILTERED))
    assert spun.fast["q_axis_voltage", "test"][10] == pytest.approx(
        CONSTANT * spun.fast["velocity", "test"][10], abs=CONSTANT * 0.15
    )


def servo(reference, angle, enabled=None, **changes):
    """A pendulum of 0.5 kg at 0.2 m on a servo, without friction."""
    count = len(reference)
    channels = {("angle", "test"): angle, ("angle_reference", "test"): reference}
    if enabled is not None:
        channels["drive_enabled", "test"] = enabled
    run = Record(Path("servo.h5"), "free", "free", clocked(count, 5e-3, channels), None, {})
    load, drive = {"type": "pendulum", "mass": 0.5, "length": 0.2}, {"type": "position_servo", "gain": 2.0}
    plain = {"viscous_damping": 0.0, "coulomb_friction": 0.0, "resistance_coefficient": 0.0}
    drive["voltage_limit"] = 10.0
    return replay(run, model(**{"load": load, "drive": drive} | plain | changes))


def test_a_servo_holds_a_pendulum_where_its_torque_equals_the_weight():
    job = servo(np.full(4000, 1.0), 0.8)
    angle = job.fast["angle", "test"][-1]
    assert CONSTANT * 2.0 * (1.0 - angle) / RESISTANCE == pytest.approx(0.5 * 9.80665 * 0.2 * np.sin(angle), rel=1e-3)


def test_a_servo_s_axis_answers_a_step_as_a_damped_spring():
    stands, inertia = 10, 0.24
    job = servo(np.where(np.arange(400) < stands, 0.0, 1.0), 0.0, load={"type": "none"}, rotor_inertia=inertia)
    half, stiff = 0.5 * CONSTANT**2 / RESISTANCE / inertia, 2.0 * CONSTANT / RESISTANCE / inertia
    rate, time = np.sqrt(stiff - half**2), 5e-3 * np.arange(400 - stands)
    swing = np.cos(rate * time) + half / rate * np.sin(rate * time)
    wrong = job.fast["angle", "test"][stands:] - (1.0 - np.exp(-half * time) * swing)
    assert np.max(np.abs(wrong)) < 1e-4


def test_a_servo_beyond_its_voltage_runs_at_the_speed_of_its_back_emf():
    job = servo(np.full(600, 1000.0), 0.0, load={"type": "none"})
    assert np.diff(job.fast["angle", "test"])[-1] / 5e-3 == pytest.approx(10.0 / CONSTANT, rel=1e-3)


@pytest.mark.parametrize("mass", [0.5, pytest.param(0.001, marks=pytest.mark.long)])
def test_a_pendulum_let_go_swings_with_its_own_period(mass):
    """A servo that is off brakes nothing, however light its axis."""
    load = {"type": "pendulum", "mass": mass, "length": 0.2}
    job = servo(np.zeros(2000), 0.05, enabled=np.zeros(2000), rotor_inertia=1e-9, load=load)
    angle = job.fast["angle", "test"][2:]
    crossings = np.flatnonzero((angle[1:] > 0) & (angle[:-1] <= 0))
    period = 5e-3 * np.mean(np.diff(crossings))
    assert period == pytest.approx(2 * np.pi * np.sqrt(0.2 / 9.80665), rel=5e-3)
    assert np.max(angle[-200:]) == pytest.approx(0.05, rel=0.02)


def test_a_logged_force_drives_an_axis_that_has_no_torque_constant():
    channels = {("angle", "test"): 0.0, ("torque_reference", "test"): 2.0}
    run = Record(Path("axis.h5"), "free", "free", clocked(3000, 1e-3, channels), None, {})
    axis = {"rotor_inertia": 4.0, "viscous_damping": 0.0, "coulomb_friction": 0.0, "torque_constant": None}
    job = replay(run, model(back_emf_constant=None, **axis))
    speed = job.fast["velocity", "test"]
    assert speed[900] - speed[400] == pytest.approx(2.0 / 4.0 * 0.5, rel=1e-3)


def test_heat_from_two_leads_ends_at_the_network_s_rise():
    slow = {("line_current", "test"): 5.0, ("line_voltage", "test"): 0.0}
    run = record("heated", seconds=20000.0, camera_s=2.0, slow=slow)
    job = replay(run, model(resistance_coefficient=0.0))
    heat = 2 * RESISTANCE * 25.0
    through = THERMAL["winding_housing_resistance"] + THERMAL["housing_ambient_resistance"]
    together = 1 / (1 / THERMAL["winding_ambient_resistance"] + 1 / through)
    assert job.slow["winding_temperature", "test"][-1] == pytest.approx(25.0 + heat * together, abs=0.01)
    assert job.slow["line_voltage", "test"][-1] == pytest.approx(2 * RESISTANCE * 5.0)


def test_a_warm_housing_cools_with_its_time_constant():
    alone = THERMAL | {"winding_ambient_resistance": 1e6, "winding_capacitance": 1e-3}
    slow = {("line_current", "test"): 0.0, ("line_voltage", "test"): 0.0}
    constant = THERMAL["housing_capacitance"] * THERMAL["housing_ambient_resistance"]
    expected = 25.0 + 40.0 * np.exp(-np.arange(2000.0) / constant)
    run = record("heated", seconds=2000.0, camera_s=1.0, warm=(expected, expected), slow=slow)
    job = replay(run, model(thermal=alone))
    assert job.slow["housing_temperature", "test"] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("body", [30.0, 62.0, 75.0])
def test_a_body_behind_a_warm_housing_starts_at_a_temperature_that_the_run_tells(body):
    """Three coupled nodes without heat, the third of which is cooler or hotter than the housing and not measured."""
    capacity, resistance, seconds = 400.0, 0.6, 120.0
    wa, wh = 1 / THERMAL["winding_ambient_resistance"], 1 / THERMAL["winding_housing_resistance"]
    ha, hb = 1 / THERMAL["housing_ambient_resistance"], 1 / resistance
    flows = np.array([[-wa - wh, wh, 0.0], [wh, -wh - ha - hb, hb], [0.0, hb, -hb]])
    flows /= np.array([THERMAL["winding_capacitance"], THERMAL["housing_capacitance"], capacity])[:, None]
    start = np.array([70.0, 62.0, body]) - 25.0
    rises = np.array([expm(flows * time) @ start for time in np.arange(0.0, seconds, 0.5)])
    winding, housing = 25.0 + rises[:, 0], 25.0 + rises[:, 1]
    run = record("locked", reference=0.0, seconds=seconds, camera_s=0.5, warm=(winding, housing))
    lost = slice(100, 160)  # as an import fills it, along a line that no body follows
    for key, valid in run.slow.valid.items():
        if key[0] != "ambient_temperature":
            valid[lost] = False
            run.slow.values[key][lost] = 20.0
    job = replay(run, model(("third_thermal_node", {"capacitance": capacity, "resistance": resistance})))
    assert job.slow["winding_temperature", "test"] == pytest.approx(winding, abs=0.05)
    assert job.slow["housing_temperature", "test"] == pytest.approx(housing, abs=0.05)


@pytest.mark.parametrize("moving", [False, True])
def test_the_measured_current_tells_how_a_servo_moves_its_reference(moving):
    """A ramp of the servo's target with steps; the reference is held for a millisecond, or moves within it."""
    fine, target = 4, np.where(np.arange(4000) % 1000 < 500, 0.0, 10.0)
    gain, decay = 2.0, 0.97  # A s/rad, and what is left of the servo's error after a sub-step
    error, references, recorded = 0.0, [], []
    for index in range(1, len(target)):
        error += target[index] - target[index - 1]
        for _ in range(fine):
            references.append(gain * error)
            error *= decay
        recorded.append(gain * error / decay if moving else references[-fine])
    followed = np.array(references) if moving else np.repeat(recorded, fine)
    constant = 1 / (2 * np.pi * 450.0)
    step = INTERVAL_S / fine
    flowing = lfilter([1 - np.exp(-step / constant)], [1, -np.exp(-step / constant)], followed)
    current = np.concatenate([[0.0], flowing.reshape(-1, fine).mean(axis=1)])
    reference = np.concatenate([[0.0], recorded])
    speed = target - reference / gain
    fast = {("velocity_reference", "test"): target, ("velocity", "test"): speed, ("q_axis_current", "test"): current}
    job = replay(record("free", reference=reference, seconds=4.0, fast=fast), model())
    left = job.fast["q_axis_current", "test"][10:] - current[10:]
    assert np.sqrt(np.mean(left**2)) < 0.12


@pytest.mark.parametrize(("bus", "driven"), [(29.6, 8.0), (14.8, 5.0)])
def test_where_the_bus_leaves_no_voltage_the_measured_current_drives_the_replay(bus, driven):
    """12 V are below the ceiling of 29.6 V over sqrt(2), and above that of half the bus."""
    there = {("bus_voltage", "bench"): bus, ("q_axis_voltage", "test"): 12.0, ("q_axis_current", "test"): 5.0}
    job = replay(record("locked", reference=8.0, fast=there), model())
    assert job.fast["q_axis_current", "test"][500] == pytest.approx(driven)


@pytest.mark.parametrize(("gap", "driven"), [(500, 5.0), (7, 8.0)])
def test_where_a_run_has_no_reference_its_measured_current_drives_the_replay(gap, driven):
    """A velocity mode, then a current of 8 A; a few samples that are missing are bridged."""
    run = record("free", reference=8.0, fast={("q_axis_current", "test"): 5.0})
    key, clock = ("q_axis_current_reference", "test"), run.fast
    clock.valid[key][100 : 100 + gap] = False
    good = clock.valid[key]
    clock.between[key] = clock.time[good], clock.values[key][good]
    job = replay(run, model())
    speed = (CONSTANT * driven - FRICTION) / DAMPING
    before = job.fast["velocity", "test"][99 + gap]
    told = np.isnan(job.fast["q_axis_current", "test"][100 : 100 + gap])
    if gap > LONG_GAP:
        assert before == pytest.approx(speed, rel=0.05)
        assert told.all()
    else:
        assert not told.any()
    assert np.isfinite(job.fast["q_axis_current", "test"][150 + gap :]).all()
    assert job.fast["q_axis_current", "test"][-1] == pytest.approx(8.0)


@pytest.mark.parametrize("length", [1, 2, 3, 7, 545, 546, 2000])
def test_stretches_of_any_length_begin_within_the_run_and_reach_its_end(length):
    """Runs that are stepped side by side share the longest stretch of all, whatever each was cut into at first."""
    samples, parts = 546, 80
    job = SimpleNamespace(clock=SimpleNamespace(time=np.arange(samples)), parts=parts)
    cut = CutJob(job, 0, 1, samples, np.zeros((samples - 1) * parts + 1), None, None)
    cut.set_length(length)
    assert cut.length * (cut.count - 1) <= samples - 1 < cut.length * cut.count + 1
    assert cut.cut(cut.drive, np.arange(cut.count)).shape == (length * parts, cut.count)
