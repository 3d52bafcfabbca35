"""Records and models made up for tests: inputs as they stand here, measured channels all zero unless given."""

from pathlib import Path

import numpy as np

from leactl.gap.signals.record import Clocked, Record
from leactl.model.nominal import Model

INTERVAL_S = 1e-3
RESISTANCE, INDUCTANCE, CONSTANT = 0.264, 0.000128, 0.49
INERTIA, DAMPING, FRICTION, STIFFNESS = 0.0024, 0.0238, 0.208, 6000.0
THERMAL = {
    "winding_ambient_resistance": 5.6,
    "winding_housing_resistance": 0.3,
    "housing_ambient_resistance": 1.7,
    "winding_capacitance": 22.9,
    "housing_capacitance": 469.1,
}
BENCH = {
    "bus_voltage": 29.6,
    "current_loop_bandwidth": 450.0,
    "velocity_filter_bandwidth": 250.0,
    "torque_filter_bandwidth": 265.0,
    "shaft_stiffness": STIFFNESS,
}


def model(*effects, **changes):
    """The LEA with effects, each a name and its parameters."""
    whole = {
        "name": "lea",
        "phase_resistance": RESISTANCE,
        "resistance_coefficient": 0.004,
        "phase_inductance": INDUCTANCE,
        "torque_constant": CONSTANT,
        "back_emf_constant": CONSTANT,
        "rotor_inertia": INERTIA,
        "viscous_damping": DAMPING,
        "coulomb_friction": FRICTION,
        "thermal": THERMAL,
        "bench": BENCH,
        "effects": [{"effect": name, "parameters": parameters} for name, parameters in effects],
    }
    return Model(**(whole | changes))


def clocked(count, interval, channels, means=()):
    time = interval * np.arange(count)
    values = {key: np.broadcast_to(np.asarray(v, float), count).copy() for key, v in channels.items()}
    return Clocked(time, interval, values, {key: np.ones(count, bool) for key in values}, set(means))


def record(mechanical, reference=None, seconds=1.0, camera_s=0.1, start_speed=0.0, warm=(25.0, 25.0), **more):
    """A run with every channel that the mechanical set-up has, under a current reference."""
    count = round(seconds / INTERVAL_S)
    test = {name: 0.0 for name in ("q_axis_current", "q_axis_voltage", "velocity")}
    channels = {(name, "test"): value for name, value in test.items()}
    channels["angle", "test"] = start_speed * INTERVAL_S * np.arange(count)
    channels["bus_voltage", "bench"] = 29.6
    if reference is not None:
        channels["q_axis_current_reference", "test"] = reference
    if mechanical in ("locked", "coupled"):
        channels["torque", "test"] = 0.0
    if mechanical == "coupled":
        channels["q_axis_current", "load"] = 0.0
        channels["velocity", "load"] = 0.0
    channels |= more.get("fast", {})
    fast = None
    if mechanical != "heated":
        fast = clocked(count, INTERVAL_S, channels, [("q_axis_current", "test"), ("q_axis_voltage", "test")])
    slow_channels = {
        ("winding_temperature", "test"): warm[0],
        ("housing_temperature", "test"): warm[1],
        ("ambient_temperature", "bench"): 25.0,
    } | more.get("slow", {})
    slow = clocked(max(round(seconds / camera_s), 4), camera_s, slow_channels)
    return Record(Path("made-up.h5"), mechanical, mechanical, fast, slow, {})
