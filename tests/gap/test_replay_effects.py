"""Each effect changes in a replay what its definition says, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from leactl.effects import library
from leactl.gap.replay import replay, replay_all
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.job import Job
from leactl.vocabulary.effect import effect_definition
from tests.gap.synthetic import INTERVAL_S, model, record

CURRENT = ("q_axis_current", "test")
VOLTAGE = ("q_axis_voltage", "test")
VELOCITY = ("velocity", "test")
LOAD_VELOCITY = ("velocity", "load")
TORQUE = ("torque", "test")
BUS = ("bus_voltage", "bench")
WINDING = ("winding_temperature", "test")
HOUSING = ("housing_temperature", "test")
LINE = ("line_voltage", "test")
TURNING = {VELOCITY, LOAD_VELOCITY, VOLTAGE, TORQUE}
SHAKEN = {TORQUE, VELOCITY, VOLTAGE}  # a locked rotor swings on its shaft where its torque changes
WARM = {WINDING, HOUSING}

# effect, its parameters, the run that shows it, the channels that it moves there
CASES = [
    ("ambient_drift", {"change": 6.0}, "heated", WARM | {LINE}),
    ("asymmetric_friction", {"asymmetry": 0.2}, "free", {VELOCITY, VOLTAGE}),
    ("backlash", {"width": 0.01}, "locked", SHAKEN),
    ("bus_sag", {"resistance": 0.2}, "locked", {BUS}),
    ("cogging", {"amplitude": 0.05, "order": 24.0, "phase": 0.3}, "free", {VELOCITY, VOLTAGE}),
    ("command_slew_limit", {"rate": 300.0}, "locked", SHAKEN | {CURRENT} | WARM),
    ("current_sensor_gain", {"gain": 1.1}, "locked", SHAKEN | WARM),
    ("current_sensor_offset", {"offset": 0.3}, "locked", SHAKEN | {WINDING}),
    ("dead_time", {"voltage": 0.3, "current": 0.2}, "locked", {VOLTAGE}),
    ("emissivity_bias", {"fraction": 0.9}, "heated", WARM),
    ("encoder_eccentricity", {"amplitude": 0.01, "phase": 0.5}, "free", {VELOCITY, VOLTAGE}),
    ("forced_convection", {"coefficient": 0.05}, "coupled", {HOUSING, WINDING}),
    ("friction_run_in", {"excess": 0.4, "time_constant": 3.0}, "free", {VELOCITY, VOLTAGE}),
    ("friction_temperature", {"coefficient": -0.01}, "free", {VELOCITY, VOLTAGE}),
    ("gear_backlash", {"share": 0.5, "play": 0.02}, "free", {VELOCITY, VOLTAGE}),
    ("gravity_load", {"amplitude": 0.1, "phase": 0.2}, "free", {VELOCITY, VOLTAGE}),
    ("joint_elasticity", {"share": 0.4, "frequency": 20.0}, "free", {VELOCITY, VOLTAGE}),
    ("load_dependent_friction", {"coefficient": 0.1}, "coupled", TURNING),
    ("magnet_temperature", {"coefficient": 0.002}, "locked", SHAKEN),
    ("nonlinear_convection", {"coefficient": 0.01}, "heated", WARM | {LINE}),
    ("position_dependent_friction", {"amplitude": 0.4, "order": 3.0, "phase": 0.1}, "free", {VELOCITY, VOLTAGE}),
    ("position_spring", {"stiffness": 0.05, "rest_angle": 1.0, "reach": 3.0}, "free", {VELOCITY, VOLTAGE}),
    ("power_foldback", {"power": 12.0}, "coupled", TURNING | {CURRENT} | WARM),
    ("presliding", {"displacement": 0.01}, "free", {VELOCITY, VOLTAGE}),
    ("quadratic_drag", {"coefficient": 5e-4}, "free", {VELOCITY, VOLTAGE}),
    ("resistance_temperature", {"coefficient": 0.003}, "locked", {VOLTAGE, WINDING, HOUSING}),
    ("rotational_heat", {"fraction": 1.0}, "coupled", {HOUSING, WINDING}),
    ("saturation", {"loss": 0.2}, "locked", SHAKEN),
    ("shaft_compliance", {"stiffness": 300.0}, "locked", SHAKEN),
    ("stribeck", {"breakaway_ratio": 0.4, "stribeck_velocity": 1.0}, "free", {VELOCITY, VOLTAGE}),
    ("third_thermal_node", {"capacitance": 800.0, "resistance": 2.0}, "heated", WARM | {LINE}),
    ("time_skew", {"delay": 0.005}, "locked", {TORQUE}),
    ("torque_limit", {"current": 10.0}, "locked", SHAKEN | {CURRENT} | WARM),
    ("torque_ripple", {"amplitude": 0.1, "order": 12.0, "phase": 0.0}, "coupled", TURNING),
    ("torque_sensor_crosstalk", {"amplitude": 0.1, "phase": 0.4}, "coupled", {TORQUE}),
    ("torque_sensor_drift", {"rate": 0.02}, "locked", {TORQUE}),
    ("torque_sensor_gain", {"gain": 1.15}, "locked", {TORQUE}),
    ("torque_sensor_hysteresis", {"width": 0.05}, "locked", {TORQUE}),
    ("torque_sensor_lag", {"time_constant": 0.01}, "locked", {TORQUE}),
    ("torque_sensor_offset", {"offset": 0.2}, "locked", {TORQUE}),
    ("transmission_error", {"amplitude": 0.001, "order": 12.0, "phase": 0.5}, "free", {VELOCITY, VOLTAGE}),
    ("transport_delay", {"delay": 0.004}, "locked", SHAKEN | {CURRENT}),
    ("unbalance", {"amplitude": 0.1, "phase": 0.2}, "free", {VELOCITY, VOLTAGE}),
    ("velocity_filter_lag", {"time_constant": 0.02}, "free", {VELOCITY}),
    ("voltage_limit", {"stall_current": 12.0, "no_load_speed": 50.0}, "coupled", TURNING | {CURRENT} | WARM),
]
OFFSET = ("current_sensor_offset", {"offset": 0.3})
# a channel moves where it changes by more than this, or by more than this share of its swing
SMALLEST = {WINDING: 0.02, HOUSING: 0.002, LINE: 1e-3, TORQUE: 5e-3, VELOCITY: 2e-2, VOLTAGE: 5e-3}


def run_of(mechanical):
    if mechanical == "heated":
        slow = {
            ("line_current", "test"): np.where(np.arange(4000) < 2500, 8.0, 0.0),
            ("line_voltage", "test"): 0.0,
        }
        return record("heated", seconds=8000.0, camera_s=2.0, slow=slow)
    time = INTERVAL_S * np.arange(4000)
    if mechanical == "locked":
        reference = 15.0 * np.sign(np.sin(2 * np.pi * 0.6 * time)) * (time > 0.2)
    else:
        reference = 1.5 * np.sin(2 * np.pi * 1.5 * time) + (6.0 if mechanical == "coupled" else 0.0)
    speed = {"free": 3.0, "coupled": 25.0}.get(mechanical, 0.0)
    more = {LOAD_VELOCITY: 0.0, ("q_axis_current", "load"): -3.0} if mechanical == "coupled" else {}
    more[VELOCITY] = speed
    return record(mechanical, reference=reference, seconds=4.0, start_speed=speed, warm=(70.0, 60.0), fast=more)


def channels(job):
    return job.fast | job.slow


def replayed(mechanical, *effects):
    return channels(replay(run_of(mechanical), model(*effects)))


@pytest.mark.parametrize(("effect", "parameters", "mechanical", "moved"), CASES, ids=[case[0] for case in CASES])
def test_an_effect_moves_what_it_says_and_nothing_else(effect, parameters, mechanical, moved):
    coefficient = 0.0 if effect == "resistance_temperature" else 0.004
    run = run_of(mechanical)
    plain = channels(replay(run, model(resistance_coefficient=coefficient)))
    changed = channels(replay(run, model((effect, parameters), resistance_coefficient=coefficient)))
    assert plain.keys() == changed.keys()
    results = set()
    for key, values in plain.items():
        if np.nanmax(np.abs(changed[key] - values)) > SMALLEST.get(key, 1e-6):
            results.add(key)
    assert results == moved


def test_every_effect_of_the_library_has_a_case():
    servos = {name for name in library() if effect_definition(name).shown_on == ("servo",)}  # see test_servo_limits
    assert [case[0] for case in CASES] == [name for name in library() if name not in servos]


def test_teeth_begin_on_the_flank_that_presses_where_no_motion_was_measured():
    run = run_of("free")
    for key in (VELOCITY, ("angle", "test")):
        del run.fast.values[key]
    job = replay(run, model(("gear_backlash", {"share": 0.5, "play": 0.02})))
    assert np.all(np.isfinite(job.velocity))


@pytest.mark.parametrize(
    "effect",
    [
        ("encoder_eccentricity", {"amplitude": 0.02, "phase": 0.5}),
        ("transmission_error", {"amplitude": 0.002, "order": 12.0, "phase": 0.5}),
    ],
)
def test_a_speed_made_of_the_angle_has_the_encoder_s_error(effect):
    run = run_of("free")
    del run.fast.values[VELOCITY]
    plain, changed = replay(run, model()), replay(run, model(effect))
    amplitude, order, phase = (({"order": 1.0} | effect[1])[name] for name in ("amplitude", "order", "phase"))
    rotor_angle = changed.angle[:: changed.parts][: len(changed.clock.time)]
    until_restart = slice(300, 1000)  # from where the other speed at its start is forgotten
    rate_of_error = np.gradient(amplitude * np.sin(order * rotor_angle + phase), INTERVAL_S)[until_restart]
    added_speed = (changed.fast[VELOCITY] - plain.fast[VELOCITY])[until_restart]
    assert added_speed == pytest.approx(rate_of_error, abs=0.1 * np.ptp(rate_of_error))


def test_faults_of_one_sensor_follow_each_other():
    plain = replayed("locked")[TORQUE]
    both = replayed("locked", ("torque_sensor_gain", {"gain": 1.1}), ("torque_sensor_offset", {"offset": 0.3}))[TORQUE]
    assert both[2:] == pytest.approx(1.1 * plain[2:] + 0.3, abs=1e-9)


def test_a_torque_sensor_drifts_from_the_run_s_start_in_a_stretch_of_it():
    whole = run_of("locked")
    stretch = replace(whole, fast=replace(whole.fast, begin=whole.fast.time[0] - 100.0))  # s
    drifting = model(("torque_sensor_drift", {"rate": 0.02}))
    late = replay(stretch, drifting).fast[TORQUE] - replay(whole, drifting).fast[TORQUE]
    assert late[5:] == pytest.approx(2.0, abs=1e-6)  # N*m


def test_a_torque_sensor_feels_the_housing_s_temperature():
    felt = []
    plant = plant_of(model())
    plant.torque_reading.append(lambda run, reading: felt.append(run.housing) or reading)
    job = Job(run_of("locked"), plant)
    replay_all([job])
    assert felt[0] == pytest.approx(60.0, abs=5.0)  # degC, at which the run begins
    assert len(felt[0]) == (len(job.clock.time) - 1) * job.parts + 1


def test_a_pair_on_two_channels_is_the_sum_of_its_members():
    bus, offset = ("bus_sag", {"resistance": 0.2}), ("torque_sensor_offset", {"offset": 0.3})
    both = replayed("locked", bus, offset)
    assert np.array_equal(both[BUS], replayed("locked", bus)[BUS], equal_nan=True)
    assert np.array_equal(both[TORQUE], replayed("locked", offset)[TORQUE], equal_nan=True)


def test_three_effects_on_one_rotor_all_act():
    effects = [
        ("stribeck", {"breakaway_ratio": 0.4, "stribeck_velocity": 1.0}),
        ("cogging", {"amplitude": 0.05, "order": 24.0, "phase": 0.3}),
        ("presliding", {"displacement": 0.005}),
    ]
    together = replayed("free", *effects)[VELOCITY]
    assert np.all(np.isfinite(together[5:]))
    for left_out in effects:
        fewer = replayed("free", *(effect for effect in effects if effect is not left_out))[VELOCITY]
        assert np.nanmax(np.abs(together - fewer)) > 0.05


def test_a_regulated_current_sensor_moves_the_current_and_hides_it():
    plain, wrong = replay(run_of("locked"), model()), replay(run_of("locked"), model(OFFSET))
    assert wrong.fast[CURRENT][1:] == pytest.approx(plain.fast[CURRENT][1:])
    assert np.mean(wrong.current - plain.current) == pytest.approx(-0.3)
