"""A machine's own units: what its model file and its runs say of its torque, current, time, speed and heat."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from leactl.gap.signals.record import Array, Clocked, Record
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition, effect_names

TOP = 0.999  # quantile of a run's speeds that counts as its highest
TURNING = 0.1  # of the highest speed, from which on a run counts as turning


def scales(records: Sequence[Record], model: Model) -> dict[str, float]:
    """One unit of each kind for a machine and its runs; a kind that they do not tell is left out.

    Torque is the Coulomb friction and current what makes it; time is the finest interval between samples, speed the
    highest that was reached. A locked rotor swings and does not turn: without another run, speed is what a bus voltage
    allows without load. Machines that are similar in the sense of dimensional analysis have similar units.
    """
    units = {"1": 1.0, "rad": 1.0, "K": 1.0, "1/K": 1.0, "share of the limit": 1.0}
    clocks = [record.fast for record in records if record.fast is not None]
    if clocks:
        units["s"] = min(clock.interval for clock in clocks)
        lasting = max(float(clock.since_begin[-1]) for clock in clocks)
        if (speed := highest_speed(records, model)) > 0.0:
            units["rad/s"] = speed
            units["s/rad"] = 1.0 / speed
        if model.coulomb_friction:
            units["N*m/s"] = model.coulomb_friction / lasting
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
    """Highest speed of an angle in runs whose shaft turns, else that of a motor without load; zero of neither."""
    reached = max(
        (
            float(np.quantile(np.abs(np.diff(angle)), TOP)) / record.fast.interval
            for record in records
            if record.fast is not None and record.mechanical != "locked"
            if (angle := record.fast.get("angle")) is not None
        ),
        default=0.0,
    )
    if reached > 0.0 or not model.bench.bus_voltage or not model.back_emf_constant:
        return reached
    return model.bench.bus_voltage / model.back_emf_constant


def worth_knowing(records: Sequence[Record], model: Model) -> dict[str, float]:
    """The smallest size of each effect that is worth knowing on a machine; without those whose unit nothing tells.

    It is in the units of `EffectDefinition.worth_knowing`.
    """
    units = scales(records, model)
    least = {name: effect_definition(name).worth_knowing for name in effect_names()}
    return {name: worth.size * units[worth.units] for name, worth in least.items() if worth.units in units}


def form_scales(records: Sequence[Record], model: Model) -> dict[str, float]:
    """The scales in which forms of effects are told (`leactl.effects.contract.SCALES`), in SI units.

    What these runs and this model do not tell is left out; a loop or filter without a bandwidth is taken to be as slow
    as the finest interval between samples.
    """
    clocks = [record.fast for record in records if record.fast is not None]
    units = {"1": 1.0}
    if model.coulomb_friction:
        units["friction"] = model.coulomb_friction
    if model.thermal is not None:
        units["housing"] = model.thermal.housing_capacitance * model.thermal.housing_ambient_resistance
    if not clocks:
        return units
    if (travel := widest(records)) > 0.0:
        units["travel"] = travel
    bench = model.bench
    units["sampling rate"] = 1.0 / min(clock.interval for clock in clocks)
    units["loop"] = time_constant(bench.current_loop_bandwidth, min(clock.interval for clock in clocks))
    units["velocity filter"] = time_constant(bench.velocity_filter_bandwidth, units["loop"])
    units["torque filter"] = time_constant(bench.torque_filter_bandwidth, units["loop"])
    turning = [(float(clock.since_begin[-1]), speed) for clock in clocks for speed in absolute_speeds(clock)]
    if turning and (top := max(float(np.quantile(speed, TOP)) for _, speed in turning)) > 0.0:
        units["highest speed"] = top
        units["longest run"] = max(lasting for lasting, speed in turning if np.quantile(speed, TOP) > TURNING * top)
    currents = [highest(clock, name) for clock in clocks for name in ("q_axis_current", "q_axis_current_reference")]
    if (top := max(currents)) > 0.0:
        units["highest current"] = top
        units["highest rate"] = top / units["loop"]
    if model.torque_constant and (asked := max(currents_at_speed(clocks), default=0.0)) > 0.0:
        units["highest power"] = model.torque_constant * asked
    return units


def widest(records: Sequence[Record]) -> float:
    """Angle that the widest of some runs covers [rad]."""
    clocks = [record.fast for record in records if record.fast is not None]
    angles = [angle for clock in clocks if (angle := clock.get("angle")) is not None]
    return max((float(np.ptp(angle)) for angle in angles), default=0.0)


def visited(records: Sequence[Record]) -> tuple[float, float]:
    """Lowest and highest angle of some runs [rad]; everywhere where none has an angle."""
    clocks = [record.fast for record in records if record.fast is not None]
    angles = [angle for clock in clocks if (angle := clock.get("angle")) is not None]
    if not angles:
        return -math.inf, math.inf
    return min(float(np.min(angle)) for angle in angles), max(float(np.max(angle)) for angle in angles)


def time_constant(bandwidth: float | None, otherwise: float) -> float:
    """Of a first-order lag of a bandwidth [Hz]."""
    return otherwise if bandwidth is None else 1.0 / (2.0 * math.pi * bandwidth)


def absolute_speeds(clock: Clocked) -> Iterator[Array]:
    """Absolute speeds of a run that has them or an angle."""
    if (velocity := clock.get("velocity")) is not None:
        yield np.abs(velocity)
    elif (angle := clock.get("angle")) is not None:
        yield np.abs(np.diff(angle)) / clock.interval


def currents_at_speed(clocks: Sequence[Clocked]) -> Iterator[float]:
    """Largest products of a current that was asked for and the absolute speed [A*rad/s], but for outliers."""
    for clock in clocks:
        reference = clock.get("q_axis_current_reference")
        if reference is None:
            continue
        for speed in absolute_speeds(clock):
            yield float(np.quantile(np.abs(reference[-len(speed) :]) * speed, TOP))


def highest(clock: Clocked, quantity: str) -> float:
    """Largest absolute value of a channel but for its outliers; zero where it is not there."""
    values = clock.get(quantity)
    return 0.0 if values is None else float(np.quantile(np.abs(values), TOP))
