"""A machine's own units of torque, current, time, speed and heat, from its model file and its runs."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from leactl.gap.signals.record import Array, Clocked, Record
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition, effect_names

TOP_QUANTILE = 0.999  # quantile of a run's speeds that counts as its highest
TURNING_SHARE = 0.1  # share of the highest speed from which a run counts as turning


def scales(records: Sequence[Record], model: Model) -> dict[str, float]:
    """Return one unit of each kind for a machine and its runs, without kinds that they do not determine.

    The unit of torque is the Coulomb friction, that of current makes this torque; time has the finest interval between
    samples, speed the highest speed reached. A locked rotor does not turn: without another run, the unit of speed is
    the no-load speed at the bus voltage. Machines that are similar by dimensional analysis have similar units.
    """
    units = {"1": 1.0, "rad": 1.0, "K": 1.0, "1/K": 1.0, "share of the limit": 1.0}
    clocks = [record.fast for record in records if record.fast is not None]
    if clocks:
        units["s"] = min(clock.interval for clock in clocks)
        longest_duration = max(float(clock.since_begin[-1]) for clock in clocks)
        if (speed := highest_speed(records, model)) > 0.0:
            units["rad/s"] = speed
            units["s/rad"] = 1.0 / speed
        if model.coulomb_friction:
            units["N*m/s"] = model.coulomb_friction / longest_duration
    if model.coulomb_friction:
        units["N*m"] = units["N*m/rad"] = model.coulomb_friction
        if "rad/s" in units:
            units["N*m*s^2/rad^2"] = units["N*m"] / units["rad/s"] ** 2
        if model.torque_constant:
            units["A"] = units["N*m"] / model.torque_constant
    if model.phase_resistance:
        units["ohm"] = model.phase_resistance
        if "A" in units:
            units["V"] = units["ohm"] * units["A"]
    if model.thermal is not None:
        units["J/K"] = model.thermal.housing_capacitance
    return units


def highest_speed(records: Sequence[Record], model: Model) -> float:
    """Return the highest speed of an angle in runs with a turning shaft, else the no-load speed; zero without both."""
    highest_reached = max(
        (
            float(np.quantile(np.abs(np.diff(angle)), TOP_QUANTILE)) / record.fast.interval
            for record in records
            if record.fast is not None and record.mechanical != "locked"
            if (angle := record.fast.get("angle")) is not None
        ),
        default=0.0,
    )
    if highest_reached > 0.0 or not model.bench.bus_voltage or not model.back_emf_constant:
        return highest_reached
    return model.bench.bus_voltage / model.back_emf_constant


def worth_knowing(records: Sequence[Record], model: Model) -> dict[str, float]:
    """Return the smallest relevant size of each effect on a machine, without effects whose unit is not determined.

    Sizes are in the units that `EffectDefinition.smallest_worth_knowing` names, not in multiples of the machine's.
    """
    units = scales(records, model)
    smallest_sizes = {name: effect_definition(name).smallest_worth_knowing for name in effect_names()}
    return {
        name: smallest.size * units[smallest.units]
        for name, smallest in smallest_sizes.items()
        if smallest.units in units
    }


def form_scales(records: Sequence[Record], model: Model) -> dict[str, float]:
    """Return the scales of forms of effects (`leactl.effects.contract.SCALES`) in SI units.

    Scales that these runs and this model do not determine are left out. A loop without a bandwidth has the finest
    interval between samples as its time constant, a filter without one that of the loop.
    """
    clocks = [record.fast for record in records if record.fast is not None]
    units = {"1": 1.0}
    if model.coulomb_friction:
        units["friction"] = model.coulomb_friction
    if model.thermal is not None:
        units["housing"] = model.thermal.housing_capacitance * model.thermal.housing_ambient_resistance
    if not clocks:
        return units
    if (travel := widest_angle_range(records)) > 0.0:
        units["travel"] = travel
    bench = model.bench
    units["sampling rate"] = 1.0 / min(clock.interval for clock in clocks)
    units["loop"] = time_constant(bench.current_loop_bandwidth, min(clock.interval for clock in clocks))
    units["velocity filter"] = time_constant(bench.velocity_filter_bandwidth, units["loop"])
    units["torque filter"] = time_constant(bench.torque_filter_bandwidth, units["loop"])
    durations_and_speeds = [
        (float(clock.since_begin[-1]), speed) for clock in clocks for speed in absolute_speeds(clock)
    ]
    if (
        durations_and_speeds
        and (top_speed := max(float(np.quantile(speed, TOP_QUANTILE)) for _, speed in durations_and_speeds)) > 0.0
    ):
        units["highest speed"] = top_speed
        units["longest run"] = max(
            duration
            for duration, speed in durations_and_speeds
            if np.quantile(speed, TOP_QUANTILE) > TURNING_SHARE * top_speed
        )
    currents = [
        highest_value(clock, name) for clock in clocks for name in ("q_axis_current", "q_axis_current_reference")
    ]
    if (highest_current := max(currents)) > 0.0:
        units["highest current"] = highest_current
        units["highest rate"] = highest_current / units["loop"]
    if model.torque_constant and (highest_product := max(currents_at_speed(clocks), default=0.0)) > 0.0:
        units["highest power"] = model.torque_constant * highest_product
    return units


def widest_angle_range(records: Sequence[Record]) -> float:
    """Return the largest angle range of some runs [rad], zero without an angle."""
    clocks = [record.fast for record in records if record.fast is not None]
    angles = [angle for clock in clocks if (angle := clock.get("angle")) is not None]
    return max((float(np.ptp(angle)) for angle in angles), default=0.0)


def angle_bounds(records: Sequence[Record]) -> tuple[float, float]:
    """Return the lowest and highest angle of some runs [rad]; infinite where none has an angle."""
    clocks = [record.fast for record in records if record.fast is not None]
    angles = [angle for clock in clocks if (angle := clock.get("angle")) is not None]
    if not angles:
        return -math.inf, math.inf
    return min(float(np.min(angle)) for angle in angles), max(float(np.max(angle)) for angle in angles)


def time_constant(bandwidth: float | None, otherwise: float) -> float:
    """Return the time constant [s] of a first-order lag with a bandwidth [Hz], or `otherwise` without one."""
    return otherwise if bandwidth is None else 1.0 / (2.0 * math.pi * bandwidth)


def absolute_speeds(clock: Clocked) -> Iterator[Array]:
    """Yield the absolute speeds of a run from its velocity, else from its angle."""
    if (velocity := clock.get("velocity")) is not None:
        yield np.abs(velocity)
    elif (angle := clock.get("angle")) is not None:
        yield np.abs(np.diff(angle)) / clock.interval


def currents_at_speed(clocks: Sequence[Clocked]) -> Iterator[float]:
    """Yield the largest products of reference current and absolute speed [A*rad/s], without outliers."""
    for clock in clocks:
        reference = clock.get("q_axis_current_reference")
        if reference is None:
            continue
        for speed in absolute_speeds(clock):
            yield float(np.quantile(np.abs(reference[-len(speed) :]) * speed, TOP_QUANTILE))


def highest_value(clock: Clocked, quantity: str) -> float:
    """Return the largest absolute value of a channel without outliers; zero where it is missing."""
    values = clock.get(quantity)
    return 0.0 if values is None else float(np.quantile(np.abs(values), TOP_QUANTILE))
