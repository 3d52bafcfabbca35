"""Each effect that a bench can show does in the stepped plant what its definition says, whatever form it has there."""

import math
from dataclasses import replace

import numpy as np
import pytest

from leactl.emulation.plant.effects import known_effects, make_effect
from leactl.emulation.plant.parameters import ActuatorParameters, BenchParameters
from leactl.emulation.plant.stepped.heating import heat
from leactl.emulation.plant.stepped.lanes import Lane
from leactl.emulation.plant.stepped.plant import TICK, SteppedPlant
from leactl.emulation.plant.stepped.sensors import Sensors, Spread
from leactl.emulation.plant.stepped.simulation import DriveSignals
from leactl.vocabulary.effect import effect_definition, effects_on

LEA = ActuatorParameters()
FLYWHEEL = replace(LEA, rotor_inertia=1e4, coulomb_friction=0.0, viscous_damping=0.0)  # holds any speed
SILENT = Spread(*[0.0] * 8)
KT, F, B = 0.49, 0.208, 0.0238


def test_all_definitions_have_a_form_with_their_parameters():
    known = known_effects()
    assert set(effects_on("bench")) <= set(known)
    for name in effects_on("bench"):
        definition = effect_definition(name)
        own = {parameter: entry for parameter, entry in definition.parameters.items() if entry.default is None}
        lowest = {parameter: entry.low for parameter, entry in own.items()}
        highest = {parameter: entry.high for parameter, entry in own.items()}
        for parameters in (lowest, highest):  # both ends of the vocabulary's ranges are within what the form takes
            effect = make_effect(name, parameters)
            assert {key: value for key, value in vars(effect).items() if key != "role"} == parameters
    assert set(CHECKS) == set(effects_on("bench"))


class Record:
    """What one lane had over the ticks after the first 30 ms."""

    def __init__(self, setup, effects=(), current=0.0, speed=0.0, seconds=0.6, settle=0.03, load=FLYWHEEL, **lane):
        test = lane.pop("test", LEA)
        self.plant = SteppedPlant([Lane(setup, test, load, effects=tuple(effects), **lane)])
        self.plant.velocity[:] = speed
        names = ("angle", "encoder", "velocity", "torque", "current", "voltage", "bus", "load_current", "true")
        self.rows = {name: [] for name in names}
        for k in range(round(seconds / TICK)):
            self.plant.advance(np.array([[current(k * TICK) if callable(current) else current], [0.0]]))
            if k * TICK >= settle:
                self._take()
        for name, values in self.rows.items():
            setattr(self, name, np.array(values))

    def _take(self):
        plant, rows = self.plant, self.rows
        rows["angle"].append(plant.angle[0, 0])
        rows["encoder"].append(plant.angle_read[0])
        rows["velocity"].append(plant.velocity_read[0, 0])
        rows["torque"].append(plant.torque_read[0])
        rows["current"].append(plant.current_mean_sensed[0, 0])
        rows["true"].append(plant.current_mean[0, 0])
        rows["voltage"].append(plant.voltage_mean[0, 0])
        rows["bus"].append(plant.bus_voltage[0])
        rows["load_current"].append(plant.current[1, 0])


def turning(name, parameters, **how):
    """With the effect and without, coupled to a flywheel."""
    return (
        Record("coupled", [make_effect(name, parameters)], **how),
        Record("coupled", **how),
    )


def harmonic(angle, values, order):
    """Complex amplitude of a sine over the angle: abs is its amplitude, angle its phase."""
    basis = np.c_[np.sin(order * angle), np.cos(order * angle), np.ones(len(angle))]
    sine, cosine, _ = np.linalg.lstsq(basis, values, rcond=None)[0]
    return complex(sine, cosine)


def cogging():
    for current in (0.0, 5.0):
        on, off = turning("cogging", {"amplitude": 0.1, "order": 12, "phase": 0.7}, speed=10.0, current=current)
        result = harmonic(on.angle, on.torque - off.torque, 12)
        assert abs(result) == pytest.approx(0.1, rel=0.1)
        assert np.angle(result) == pytest.approx(0.7, abs=0.15)


def torque_ripple():
    amplitudes = {}
    for current in (0.0, 4.0, 8.0):
        on, off = turning("torque_ripple", {"amplitude": 0.05, "order": 12, "phase": 0.0}, speed=10.0, current=current)
        amplitudes[current] = abs(harmonic(on.angle, on.torque - off.torque, 12))
    assert amplitudes[0.0] < 1e-6
    assert amplitudes[4.0] == pytest.approx(0.05 * KT * 4.0, rel=0.1)
    assert amplitudes[8.0] == pytest.approx(2 * amplitudes[4.0], rel=0.02)


def unbalance():
    on, off = turning("unbalance", {"amplitude": 0.2, "phase": -1.0}, speed=12.0)
    result = harmonic(on.angle, on.torque - off.torque, 1)
    assert abs(result) == pytest.approx(0.2, rel=0.05)
    assert np.angle(result) == pytest.approx(-1.0, abs=0.1)


def gravity_load():
    on, off = turning("gravity_load", {"amplitude": 0.2, "phase": 0.4}, speed=12.0)
    result = harmonic(on.angle, on.torque - off.torque, 1)
    assert abs(result) == pytest.approx(0.2, rel=0.05)
    assert np.angle(result) == pytest.approx(0.4 - 0.5 * np.pi, abs=0.1)  # it pulls by -cos(angle + phase)


def position_spring():
    on, off = turning("position_spring", {"stiffness": 0.05, "rest_angle": 2.0}, speed=12.0)
    pull, near = on.torque - off.torque, np.abs(on.angle - 2.0) < 1.0
    assert np.polyfit(on.angle[near], pull[near], 1)[0] == pytest.approx(-0.05, rel=0.1)
    assert np.interp(2.0, on.angle, pull) == pytest.approx(0.0, abs=0.002)
    assert -0.05 * 5.0 < np.interp(7.0, on.angle, pull) < -0.05 * 4.0  # less than in proportion


def torque_sensor_crosstalk():
    off = Record("coupled", speed=12.0)
    signals = as_signals(off)
    effect = make_effect("torque_sensor_crosstalk", {"amplitude": 0.2, "phase": 0.5})
    read = Sensors(Lane("coupled", effects=(effect,)), SILENT, 0).loop(signals)["torque"]
    result = harmonic(off.angle, read - off.torque, 1)
    assert abs(result) == pytest.approx(0.2, rel=0.02)
    assert np.angle(result) == pytest.approx(0.5, abs=0.02)


def position_dependent_friction():
    for speed in (12.0, -12.0):
        on, off = turning(
            "position_dependent_friction", {"amplitude": 0.3, "order": 3, "phase": 0.0}, speed=speed, seconds=0.8
        )
        result = harmonic(on.angle, on.torque - off.torque, 3)
        assert abs(result) == pytest.approx(0.3 * F, rel=0.1)
        cosine = result.imag  # of the reading: friction takes torque in forward motion
        assert cosine * speed < 0.0


def stribeck():
    extra = {}
    for speed in (0.02, 1.0, 25.0):
        parameters = {"breakaway_ratio": 0.5, "stribeck_velocity": 1.0}
        on, off = turning("stribeck", parameters, speed=speed, seconds=0.2)
        extra[speed] = (off.torque - on.torque).mean() / F
    assert extra[0.02] == pytest.approx(0.5, rel=0.02)
    assert 0.1 < extra[1.0] < 0.35
    assert abs(extra[25.0]) < 0.01


def asymmetric_friction():
    levels = {}
    for speed in (8.0, -8.0):
        on, _ = turning("asymmetric_friction", {"asymmetry": 0.2}, speed=speed, seconds=0.2)
        levels[speed] = abs(on.torque.mean()) - B * 8.0
    assert (levels[8.0] - levels[-8.0]) / (levels[8.0] + levels[-8.0]) == pytest.approx(0.2, rel=0.02)


def load_dependent_friction():
    extra = {}
    for current in (0.5, 10.0, 20.0):
        on, off = turning("load_dependent_friction", {"coefficient": 0.1}, speed=5.0, current=current, seconds=0.3)
        extra[current] = (off.torque - on.torque).mean()
    assert extra[20.0] - extra[10.0] == pytest.approx(0.1 * 4.9, rel=0.15)
    assert extra[0.5] < 0.03


def quadratic_drag():
    for speed in (10.0, 30.0, -30.0):
        on, off = turning("quadratic_drag", {"coefficient": 5e-4}, speed=speed, seconds=0.2)
        assert (off.torque - on.torque).mean() == pytest.approx(5e-4 * speed * abs(speed), rel=0.01)


def friction_temperature():
    levels = {}
    for housing in (25.0, 55.0):
        on, _ = turning(
            "friction_temperature", {"coefficient": -0.006}, speed=10.0, housing=housing, winding=housing, seconds=0.2
        )
        levels[housing] = -on.torque.mean()
    assert levels[55.0] / levels[25.0] == pytest.approx(1 - 0.006 * 30, rel=0.03)


def friction_run_in():
    on, off = turning("friction_run_in", {"excess": 0.4, "time_constant": 0.3}, speed=10.0, seconds=1.8)
    extra = on.torque / off.torque - 1.0
    assert extra[0] == pytest.approx(0.4, rel=0.25)
    assert extra[270] == pytest.approx(0.4 / math.e, rel=0.1)
    assert extra[-1] < 0.03


def presliding():
    parameters = {"displacement": 0.01}
    half = Record(
        "free", [make_effect("presliding", parameters)], current=lambda t: min(t / 0.5, 1.0) * 0.25, seconds=0.7
    )
    assert 0.001 < half.angle[-1] < 0.01  # gives, and holds
    on, off = turning("presliding", parameters, speed=0.2, seconds=0.3, settle=0.0)
    friction, plain = -on.torque, -off.torque
    travel = on.angle
    early = (friction / plain)[(travel > 0.004) & (travel < 0.006)].mean()
    late = (friction / plain)[travel > 0.02].mean()
    assert 0.5 < early < 0.95
    assert late == pytest.approx(1.0, abs=0.02)


def backlash():
    def swing(t):
        return 5.0 if t < 0.4 else -5.0

    play = Record("locked", [make_effect("backlash", {"width": 0.01})], current=swing, seconds=0.8, settle=0.0)
    firm = Record("locked", current=swing, seconds=0.8, settle=0.0)
    travel = [record.angle[395] - record.angle[-1] for record in (play, firm)]
    assert travel[0] - travel[1] == pytest.approx(0.01, rel=0.1)


def shaft_compliance():
    soft = Record("locked", [make_effect("shaft_compliance", {"stiffness": 800.0})], current=10.0, seconds=0.5)
    assert soft.torque[-1] / soft.angle[-1] == pytest.approx(800.0, rel=1e-3)


def resistance_temperature():
    constant = replace(LEA, resistance_coefficient=0.0)
    effect = make_effect("resistance_temperature", {"coefficient": 0.004})
    (run,) = heat([Lane("heated", constant, effects=(effect,))], [np.full(600, 9.0)])
    resistance = run.voltage / (2 * 9.0)
    rise = run.winding[-1] - 25.0
    assert rise > 20.0
    assert resistance[-1] / resistance[0] - 1.0 == pytest.approx(0.004 * rise, rel=0.01)


def magnet_temperature():
    slopes = {}
    for housing in (25.0, 65.0):
        readings = [
            turning(
                "magnet_temperature",
                {"coefficient": 0.002},
                speed=10.0,
                current=current,
                housing=housing,
                winding=housing,
                seconds=0.2,
            )[0]
            for current in (0.0, 10.0)
        ]
        slopes[housing] = (readings[1].torque - readings[0].torque).mean() / 10.0
        emf = readings[0].voltage.mean() / 10.0
        assert emf == pytest.approx(slopes[housing], rel=0.01)
    assert slopes[65.0] / slopes[25.0] == pytest.approx(1 - 0.002 * 40, rel=0.01)


def dead_time():
    effect = make_effect("dead_time", {"voltage": 0.4, "current": 0.3})
    for current, low, high in ((10.0, 0.39, 0.41), (-10.0, -0.41, -0.39), (0.3, 0.2, 0.36), (0.0, -0.01, 0.01)):
        on = Record("locked", [effect], current=current, seconds=0.1)
        off = Record("locked", current=current, seconds=0.1)
        assert low < (on.voltage - off.voltage)[-20:].mean() < high


def saturation():
    on, off = turning("saturation", {"loss": 0.1}, speed=5.0, current=25.0, seconds=0.2)
    assert (off.torque - on.torque).mean() == pytest.approx(0.1 * KT * 25.0, rel=0.01)
    on, off = turning("saturation", {"loss": 0.1}, speed=5.0, current=5.0, seconds=0.2)
    assert (off.torque - on.torque).mean() < 0.02 * KT * 5.0


def bus_sag():
    on, _ = turning("bus_sag", {"resistance": 0.3}, speed=20.0, current=15.0, seconds=0.2)
    drawn = (on.voltage * on.current / on.bus).mean()
    assert 29.6 - on.bus.mean() == pytest.approx(0.3 * drawn, rel=0.01)


def transport_delay():
    def step(t):
        return 5.0 if t > 0.05 else 0.0

    late = Record("locked", [make_effect("transport_delay", {"delay": 0.005})], current=step, seconds=0.1, settle=0.0)
    plain = Record("locked", current=step, seconds=0.1, settle=0.0)
    np.testing.assert_allclose(late.current[5:], plain.current[:-5], atol=1e-6)


def command_slew_limit():
    def step(t):
        return 10.0 if t > 0.05 else 0.0

    slow = Record(
        "locked", [make_effect("command_slew_limit", {"rate": 200.0})], current=step, seconds=0.15, settle=0.0
    )
    rates = np.diff(slow.current) / TICK
    assert rates.max() == pytest.approx(200.0, rel=0.02)
    assert slow.current[-1] == pytest.approx(10.0, rel=1e-3)


def torque_limit():
    limited = Record(
        "locked", [make_effect("torque_limit", {"current": 4.0})], current=lambda t: 40.0 * t - 10.0, seconds=0.5
    )
    plain = Record("locked", current=lambda t: 40.0 * t - 10.0, seconds=0.5)
    np.testing.assert_allclose(np.clip(plain.current, -4.0, 4.0), limited.current, atol=0.06)
    assert np.ptp(limited.current) == pytest.approx(8.0, rel=1e-3)


def power_foldback():
    on, off = turning("power_foldback", {"power": 60.0}, speed=20.0, current=15.0, seconds=0.1)
    assert on.current[-1] * KT * 20.0 == pytest.approx(60.0, rel=0.01)
    slow, _ = turning("power_foldback", {"power": 60.0}, speed=5.0, current=15.0, seconds=0.1)
    assert slow.current[-1] == pytest.approx(off.current[-1], rel=1e-6)


def voltage_limit():
    parameters = {"stall_current": 16.0, "no_load_speed": 40.0}
    on, _ = turning("voltage_limit", parameters, speed=20.0, current=15.0, seconds=0.1)
    assert on.current[-1] == pytest.approx(16.0 * (1.0 - 20.0 / 40.0), rel=0.01)
    braking, plain = turning("voltage_limit", parameters, speed=20.0, current=-15.0, seconds=0.1)
    assert braking.current[-1] == pytest.approx(plain.current[-1], rel=1e-6)


def torque_sensor_gain():
    on, off = turning("torque_sensor_gain", {"gain": 1.1}, speed=5.0, current=10.0, seconds=0.1)
    np.testing.assert_allclose(on.torque, 1.1 * off.torque)


def torque_sensor_offset():
    on, off = turning("torque_sensor_offset", {"offset": 0.3}, speed=5.0, seconds=0.1)
    np.testing.assert_allclose(on.torque, off.torque + 0.3)


def torque_sensor_drift():
    time = np.arange(0.0, 60.0, 0.1)[:, None]
    reading = make_effect("torque_sensor_drift", {"rate": 0.005}).torque_record(np.zeros_like(time), time, time)
    assert reading[-1, 0] == pytest.approx(0.005 * 60.0, rel=0.06)
    assert (reading[100] - reading[0]) / 10.0 == pytest.approx(0.005, rel=0.02)


def torque_sensor_lag():
    def climb(t):
        return 40.0 * t

    on, off = turning("torque_sensor_lag", {"time_constant": 0.01}, speed=3.0, current=climb, seconds=0.3)
    behind = (off.torque - on.torque)[-50:].mean() / (40.0 * KT)
    assert behind == pytest.approx(0.01, rel=0.03)


def torque_sensor_hysteresis():
    time = np.arange(0.0, 2.3, 1e-3)[:, None]
    torque = 10.0 * np.sin(2 * np.pi * time)
    effect = make_effect("torque_sensor_hysteresis", {"width": 0.03})
    reading = effect.torque_record(torque, time, time)
    second = slice(1000, 2250)
    rising = np.interp(0.0, torque[1750:2250, 0], reading[1750:2250, 0])
    falling = np.interp(0.0, -torque[1250:1750, 0], reading[1250:1750, 0])
    assert (falling - rising) / 2 == pytest.approx(0.03 * 10.0, rel=0.05)
    assert np.abs(reading[second] - torque[second]).max() <= 0.03 * 10.0 * 1.05


def time_skew():
    def climb(t):
        return 40.0 * t

    on, off = turning("time_skew", {"delay": 0.0124}, speed=3.0, current=climb, seconds=0.3)
    behind = (off.torque - on.torque)[-50:].mean() / (40.0 * KT)
    assert behind == pytest.approx(0.0124, rel=0.02)


def current_sensor_gain():
    on, _ = turning("current_sensor_gain", {"gain": 1.1}, speed=5.0, current=11.0, seconds=0.2)
    assert on.current[-1] == pytest.approx(11.0, rel=1e-6)
    assert on.true[-1] == pytest.approx(10.0, rel=1e-6)


def current_sensor_offset():
    on, off = turning("current_sensor_offset", {"offset": 0.2}, speed=5.0, current=3.0, seconds=0.2)
    assert on.current[-1] == pytest.approx(3.0, rel=1e-6)
    assert (on.torque - off.torque).mean() == pytest.approx(-0.2 * KT, rel=0.01)


def encoder_eccentricity():
    on, off = turning("encoder_eccentricity", {"amplitude": 0.01, "phase": 0.4}, speed=15.0)
    error = harmonic(on.angle, on.encoder - on.angle, 1)
    assert abs(error) == pytest.approx(0.01, rel=0.05)
    assert np.angle(error) == pytest.approx(0.4, abs=0.05)
    assert abs(harmonic(on.angle, on.velocity - off.velocity, 1)) == pytest.approx(0.01 * 15.0, rel=0.05)
    np.testing.assert_allclose(on.torque, off.torque)


def velocity_filter_lag():
    def push(t):
        return 2.0

    on = Record("free", [make_effect("velocity_filter_lag", {"time_constant": 0.02})], current=push, seconds=0.15)
    off = Record("free", current=push, seconds=0.15)
    slope = np.diff(off.velocity)[-20:].mean() / TICK
    # the acceleration fades with J/b = 0.1 s, so the lag is a little more than the time constant
    assert (off.velocity - on.velocity)[-20:].mean() / slope == pytest.approx(0.02, rel=0.3)


def nonlinear_convection():
    """Conductance over the nominal one from the last balance of two long heated runs."""
    effect, currents = make_effect("nonlinear_convection", {"coefficient": 0.005}), (2.0, 9.0)
    light = replace(LEA, thermal=replace(LEA.thermal, housing_capacitance=150.0))
    runs = heat([Lane("heated", light, effects=(effect,))] * 2, [np.full(3000, current) for current in currents])
    shares = []
    for run, current in zip(runs, currents, strict=True):
        heat_in = 2 * LEA.resistance(run.winding[-1]) * current**2 - (run.winding[-1] - 25.0) / 5.6
        shares.append((heat_in / (run.housing[-1] - 25.0) * 1.7, run.housing[-1] - 25.0))
    for share, rise in shares:
        assert 0.5 * 0.005 * rise < share - 1.0 < 1.1 * 0.005 * rise
    assert shares[1][0] > shares[0][0] + 0.05


def forced_convection():
    effect = make_effect("forced_convection", {"coefficient": 0.02})
    slow, fast = (effect.housing_conductance(30.0, speed) for speed in (-5.0, 20.0))
    assert slow == pytest.approx(1 + 0.02 * 5, rel=0.02)
    assert fast == pytest.approx(1 + 0.02 * 20, rel=0.1)
    turned = Record("coupled", [effect], speed=30.0, housing=80.0, winding=80.0)
    still = Record("coupled", [effect], speed=0.0, housing=80.0, winding=80.0)
    assert 80.0 - turned.plant.thermal.housing[0] > 80.0 - still.plant.thermal.housing[0]


def ambient_drift():
    light = replace(LEA, thermal=replace(LEA.thermal, winding_capacitance=2.0, housing_capacitance=10.0))
    effect = make_effect("ambient_drift", {"change": 6.0})
    (run,) = heat([Lane("heated", light, effects=(effect,))], [np.zeros(7200)])
    assert run.housing[0] == 25.0
    assert run.housing[-1] == pytest.approx(31.0, abs=0.1)


def rotational_heat():
    on, off = turning("rotational_heat", {"fraction": 1.0}, speed=30.0, seconds=0.5)
    warmer = on.plant.thermal.housing[0] - off.plant.thermal.housing[0]
    assert warmer == pytest.approx((B * 900 + F * 30) * 0.5 / 469.1, rel=0.05)


def third_thermal_node():
    effect = make_effect("third_thermal_node", {"capacitance": 500.0, "resistance": 1.0})
    runs = heat([Lane("heated", effects=(effect,)), Lane("heated")], [np.full(9000, 7.0)] * 2)
    slow, plain = (run.housing - 25.0 for run in runs)
    assert slow[900] < 0.9 * plain[900]
    assert slow[-1] == pytest.approx(plain[-1], rel=0.02)


def emissivity_bias():
    effect = make_effect("emissivity_bias", {"fraction": 0.85})
    with_bias, plain = heat([Lane("heated", effects=(effect,)), Lane("heated")], [np.full(900, 7.0)] * 2)
    np.testing.assert_allclose(with_bias.housing - 25.0, 0.85 * (plain.housing - 25.0), atol=1e-9)
    np.testing.assert_allclose(with_bias.voltage, plain.voltage)


def as_signals(record):
    thin = record.torque.astype(np.float32)
    return DriveSignals(thin, thin, thin, thin, record.angle, thin, thin, thin, thin, thin[:1], thin[:1])


CHECKS = {name: thing for name, thing in list(globals().items()) if name in effects_on("bench") and callable(thing)}


@pytest.mark.parametrize("name", effects_on("bench"))
def test_effect_does_what_its_definition_says(name):
    CHECKS[name]()


@pytest.mark.parametrize("name", effects_on("bench"))
def test_effect_of_no_size_leaves_the_plant_as_it_is(name):
    """At the neutral value of its parameters an effect changes nothing, so what it changes comes from its size."""
    effect = make_effect(name, NEUTRAL.get(name))
    bench = BenchParameters()
    records = [
        Record("coupled", effects, current=lambda t: 8.0 * math.sin(40 * t), speed=6.0, seconds=0.15, bench=bench)
        for effects in ([effect], [])
    ]
    for channel in ("angle", "encoder", "velocity", "torque", "current", "voltage", "bus"):
        with_it, without = (getattr(record, channel) for record in records)
        # a lag of no length still averages two sub-steps, which the ringing shaft shows
        atol = 0.02 if name == "torque_sensor_lag" else 1e-3
        np.testing.assert_allclose(with_it, without, rtol=1e-3, atol=atol, err_msg=channel)


@pytest.mark.parametrize(
    ("order", "true"), [(("offset", "gain"), 11.0 / 1.1 - 0.2), (("gain", "offset"), (11.0 - 0.2) / 1.1)]
)
def test_errors_of_a_current_sensor_act_one_after_the_other(order, true):
    effects = {
        "gain": make_effect("current_sensor_gain", {"gain": 1.1}),
        "offset": make_effect("current_sensor_offset", {"offset": 0.2}),
    }
    on = Record("coupled", [effects[name] for name in order], speed=5.0, current=11.0, seconds=0.2)
    assert on.current[-1] == pytest.approx(11.0, rel=1e-6)
    assert on.true[-1] == pytest.approx(true, rel=1e-6)


NEUTRAL = {
    "presliding": {"displacement": 1e-5},
    "torque_sensor_lag": {"time_constant": 1e-6},
    "velocity_filter_lag": {"time_constant": 1e-6},
    "resistance_temperature": {"coefficient": 0.0},
}
