"""Equations of the voltages of winding, heated leads and bus, and of the current that follows its reference."""

import math

import numpy as np

from leactl.effects.contract import Signals
from leactl.gap.equations.contract import STAMP_TOLERANCE, Equation
from leactl.gap.signals.derived import moved_by_a_servo
from leactl.gap.signals.noise import noise_of, quantum_of
from leactl.gap.signals.record import Record
from leactl.gap.signals.setpoints import BEND_SHARE, bend, settling_rows, unknown_setpoints
from leactl.gap.signals.smoothing import slope, smooth
from leactl.gap.signals.stamps import BETWEEN_SAMPLES, TAPS, neighbour, stamp_columns
from leactl.gap.signals.voltage_ceiling import at_ceiling

# standard deviations of a current's noise; rows after a larger step of a servo's response are left out
MOST_SERVO_STEP_STDS = 5.0
START_TIME_CONSTANTS = 8.0  # time constants of a current loop after which setpoints before the run have no influence
PREVIOUS_SETPOINT_SHARE = 0.25  # share of an interval with the previous setpoint: 0 for one setpoint, 0.5 for very many
BUS_ZERO_PRIOR = 1.0 / 60.0  # prior error of a supply's voltage, as a share of the model's bus voltage
RECOVERY_WIDTH = 8.0  # samples, Gaussian margin around the voltage ceiling in which a current loop still recovers


def voltage(record: Record, s: Signals) -> Equation | None:
    """Return the equation of the q-axis voltage, u = R(T) i + L di/dt + K w.

    None where a channel or the resistance is missing.
    """
    model = s.model
    if s.voltage is None or s.current is None or model.phase_resistance is None or record.fast is None:
        return None
    speed = s.velocity if s.velocity is not None else np.zeros_like(s.current)
    if s.velocity is None and s.mechanical != "locked":
        return None
    emf_constant = model.back_emf_constant or model.torque_constant or 0.0
    winding_rise = s.winding_rise if s.winding_rise is not None else np.zeros_like(s.current)
    cold_resistance, resistance_rise = (
        model.phase_resistance,
        model.phase_resistance * model.resistance_coefficient * winding_rise,
    )
    resistive_voltage = (cold_resistance + resistance_rise) * s.current
    inductive_voltage = (model.phase_inductance or 0.0) * slope(s.current, s.interval)
    emf = emf_constant * speed
    calibration = {"phase_resistance": resistive_voltage, "torque_constant": emf}
    if model.phase_inductance:
        calibration["phase_inductance"] = inductive_voltage
    if model.resistance_coefficient:
        calibration["resistance_coefficient"] = resistance_rise * s.current
    keys = ("q_axis_voltage", "test"), ("q_axis_current", "test"), ("angle", "test")
    mask = record.fast.all_valid(*keys) & ~at_ceiling(record.fast, model)
    return Equation(
        "voltage",
        "q_axis_voltage",
        "test",
        "V",
        s.voltage - resistive_voltage - inductive_voltage - emf,
        s,
        mask,
        {
            "voltage": lambda c: c,
            "emf_factor": lambda c: emf * c,
            "current_reading": lambda c: -(cold_resistance + resistance_rise) * c,
            "angle_reading": lambda c: -emf_constant * slope(c, s.interval),
        },
        calibration,
        shared=stamp_columns("voltage", record.fast, keys, resistive_voltage + inductive_voltage + emf),
        width=2.0,
        step=6,
    )


def line_voltage(record: Record, s: Signals) -> Equation | None:
    """Return the equation of the heated winding's line voltage, U = 2 R(T) I; None without its channels.

    T is the temperature of the phases that carry the current where it is known, else that of the winding.
    """
    model, clock = s.model, record.slow
    if clock is None or s.line_current is None or s.winding is None or model.phase_resistance is None:
        return None
    measured = clock.get("line_voltage")
    if measured is None or s.winding_rise is None:
        return None
    cold_voltage = 2.0 * model.phase_resistance * s.line_current
    voltage_rise = cold_voltage * model.resistance_coefficient * s.extra.get("fed_rise", s.winding_rise)
    calibration = {"phase_resistance": cold_voltage + voltage_rise}
    if model.resistance_coefficient:
        calibration["resistance_coefficient"] = voltage_rise
    mask = clock.all_valid(("line_voltage", "test"), ("line_current", "test"), ("winding_temperature", "test"))
    mask &= np.abs(s.line_current) > 0.02 * np.max(np.abs(s.line_current))
    # the winding's temperature runs ahead of the smoothed camera where the current changes
    is_changing = np.abs(np.diff(s.line_current, prepend=s.line_current[0])) > 0.05 * np.max(np.abs(s.line_current))
    mask &= smooth(is_changing.astype(float), 8.0) < 1e-3
    return Equation(
        "line_voltage",
        "line_voltage",
        "test",
        "V",
        measured - cold_voltage - voltage_rise,
        s,
        mask,
        {"line_voltage": lambda c: c},
        calibration,
        rounding=quantum_of(clock.as_measured("line_voltage")) / math.sqrt(12.0),
        width=0.0,
        step=2,
    )


def current(record: Record, s: Signals) -> Equation | None:
    """Return the equation of the current: the response of the model's loop to its reference; None without either."""
    clock = record.fast
    if clock is None or s.following is None or clock.get("q_axis_current") is None:
        return None
    measured = clock.values["q_axis_current", "test"]
    mask = clock.all_valid(("q_axis_current", "test"), ("q_axis_current_reference", "test"))
    mask &= smooth(at_ceiling(clock, s.model).astype(float), RECOVERY_WIDTH) < 1e-3
    loop_time_constant = 1.0 / (2.0 * math.pi * (s.model.bench.current_loop_bandwidth or math.inf))
    mask &= s.time - s.time[0] > START_TIME_CONSTANTS * loop_time_constant + TAPS[-1] * s.interval
    rate = slope(s.following, s.interval)
    nuisance = {"current_stamp_s": (-rate, STAMP_TOLERANCE * s.interval)}
    if moved_by_a_servo(clock):
        is_swift = np.abs(np.diff(s.following, prepend=s.following[0])) > MOST_SERVO_STEP_STDS * noise_of(measured)
        mask &= ~settling_rows(is_swift, loop_time_constant, s.interval)
    channels = [(f"q_axis_current{suffix}", "test") for suffix in ("", "_reference")]
    # stamps of unknown meaning may be off by more than the nuisances below allow
    on_time = not any(channel in clock.unstamped for channel in channels)
    if moved_by_a_servo(clock) or (on_time and not clock.setpoints_held):
        # The reference may change at an unrecorded time within an interval. The first nuisance shifts the response; the
        # second takes it from the previous sample, which a swift later change does not affect.
        nuisance[BETWEEN_SAMPLES] = (-rate, 0.5 * s.interval)
        nuisance["reference_before"] = (neighbour(s.following, -1) - s.following, 0.5)
    shared = stamp_columns("current", clock, channels, s.following)
    following = s.following
    if clock.setpoints_between and not moved_by_a_servo(clock):
        previous_less_present = neighbour(s.following, -1) - s.following
        bends = bend(s.following)
        following = s.following + PREVIOUS_SETPOINT_SHARE * previous_less_present - BEND_SHARE * bends
        shared |= {
            "setpoint_before": (previous_less_present, PREVIOUS_SETPOINT_SHARE),
            "setpoint_bend": (bends, BEND_SHARE),
        }
        mask &= ~unknown_setpoints(clock, s.model)
    return Equation(
        "current",
        "q_axis_current",
        "test",
        "A",
        measured - following,
        s,
        mask,
        {"current_following": lambda c: c},
        {},
        nuisance,
        shared,
        width=0.0,
        step=2,
    )


def bus(record: Record, s: Signals) -> Equation | None:
    """Return the equation of the bus voltage, the model's at any load; None without channel or parameter."""
    if record.fast is None or s.bus_voltage is None or s.model.bench.bus_voltage is None:
        return None
    return Equation(
        "bus",
        "bus_voltage",
        "bench",
        "V",
        s.bus_voltage - s.model.bench.bus_voltage,
        s,
        record.fast.all_valid(("bus_voltage", "bench")),
        {"bus_voltage": lambda c: c},
        {},
        nuisance={"bus_zero": (np.ones_like(s.time), BUS_ZERO_PRIOR * s.model.bench.bus_voltage)},
        width=8.0,
        step=16,
    )
