"""Signs that a mapping has taken units, columns or clocks for others: values of no machine, gaps, factors of a unit.

Two channels that should measure the same are compared: a velocity with the change of its angle, a measured channel with
its setpoint. A gear, a limit or a bad sensor can make any factor as well, so that a factor is a note and no fault.
"""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.quantities import UNITS
from leactl.runfile.align.alignment import autocorrelated_variance
from leactl.runfile.importing.mapping import Mapping
from leactl.runfile.importing.streams import Stream
from leactl.units import CONVERSIONS, TURN

Array = npt.NDArray[np.float64]
FEWEST = 50  # rows that both channels have
CALIBRATION = 0.05  # relative, between two sensors or a loop and its setpoint: a few percent, where units are right
ERRORS = 4.0  # standard errors of the gain that a unit's factor may be off on top of that
LARGEST_GAIN_ERROR = 0.1  # relative standard error above which a gain tells nothing
EXPLAINED = 0.9  # share of one channel that the other has to explain: what lags or is limited is no factor
SMALLEST_TOLD_FACTOR = 2.0  # a factor less than this is what friction, ripple and limits make
LARGEST_UNTOLD_FACTOR = 20.0  # that is told although no unit makes it
VARIES = 0.1  # of a setpoint's root mean square: one that stays where it is shows a gain by its level alone
BLOCKS = 40  # of a record, over which angles and velocities are compared as travel: counts and noise average out
SETPOINTS: Final = {name.removesuffix("_reference"): name for name in UNITS if name.endswith("_reference")}
# the widest range that electric machines are met in, from watchmaking to traction
PLAUSIBLE: Final[dict[str, tuple[float, float]]] = {
    "A": (-5e4, 5e4),
    "V": (-1e5, 1e5),
    "rad": (-1e10, 1e10),
    "m": (-1e6, 1e6),
    "rad/s": (-1e5, 1e5),
    "m/s": (-500.0, 500.0),
    "N*m": (-1e7, 1e7),
    "N": (-1e7, 1e7),
    "degC": (-100.0, 600.0),
    "1": (-0.001, 1.001),
}
GAP = 10.0  # usual intervals
SHORTEST_GAP_S = 0.1  # which no scheduler of a log makes by itself
MOST_GAPS = 0.1  # share of the intervals: more of them are how the log was made
SHORTEST_S, LONGEST_S = 1e-7, 3600.0  # between samples


class MappedColumn(NamedTuple):
    """A channel with its stamps, without the rows that it lacks."""

    place: str  # stream/channel
    time: Array
    values: Array
    units: str  # that the mapping says its column is in
    target: str  # that it is kept in


class Gain(NamedTuple):
    """A channel over another one that should be equal."""

    value: float
    std: float
    explained: float  # share of the channel's squares


def notes_on_units(streams: dict[str, Stream], mapping: Mapping) -> Iterator[str]:
    """A note for each channel that is a factor of what it should equal."""
    columns = {key: column for key, column in mapped_columns(streams, mapping)}
    for (quantity, role, location), column in columns.items():
        angle = columns.get(("angle", role, location)) if quantity == "velocity" else None
        if angle and column.target == f"{angle.target}/s":
            yield from notes_on_gain(column, angle, f"the change of {angle.place}", gain_by_travel(column, angle))
        setpoint = columns.get((SETPOINTS.get(quantity, ""), role, location))
        if setpoint and column.target == setpoint.target:
            yield from notes_on_gain(column, setpoint, setpoint.place, gain_by_setpoint(column, setpoint, quantity))


def mapped_columns(streams: dict[str, Stream], mapping: Mapping) -> Iterator[tuple[tuple[str, str, str], MappedColumn]]:
    """Every channel by its quantity, role and location."""
    for name, stream in streams.items():
        for spec, values in zip(stream.specs, stream.values, strict=True):
            known = np.isfinite(values)
            units = mapping.streams[name].channels[spec.name].units or spec.unit
            column = MappedColumn(f"{name}/{spec.name}", stream.time[known], values[known], units, spec.unit)
            yield (spec.quantity, spec.role, spec.location), column


def notes_on_gain(column: MappedColumn, other: MappedColumn, what: str, gain: Gain | None) -> Iterator[str]:
    """What a gain tells, where it is sure and not that of two channels in their units."""
    if gain is None or gain.explained < EXPLAINED or gain.std > LARGEST_GAIN_ERROR * abs(gain.value):
        return
    size = abs(gain.value)
    distances = [(abs(math.log(size / factor)), named) for factor, named in [(1.0, ""), *unit_factors(column, other)]]
    within = math.log1p(CALIBRATION) + ERRORS * gain.std / size
    candidates = [named for distance, named in sorted(distances) if distance <= within]
    finding = f"{column.place} reads {gain.value:.4g} times {what}"
    if candidates and all(candidates):
        yield f"{finding}: {', or '.join(candidates)}? a gear of that ratio would look alike"
    elif not 1.0 / LARGEST_UNTOLD_FACTOR < size < LARGEST_UNTOLD_FACTOR:
        yield f"{finding}: are scale and units of both right? a gear of that ratio would look alike"
    elif gain.value < 0.0:
        yield f"{finding}: is the sign of both right?"


def unit_factors(column: MappedColumn, other: MappedColumn) -> list[tuple[float, str]]:
    """What a gain is where a column is in another unit than its mapping says, and in which."""
    factors = [
        *factors_of_mistaken_unit(column),
        *((1.0 / factor, named) for factor, named in factors_of_mistaken_unit(other)),
    ]
    if (column.units, other.units) == ("rad/s", "rad"):
        factor = CONVERSIONS["rad"]["deg"][0] / CONVERSIONS["rad/s"]["rpm"][0]
        factors.append((factor, f"{column.place} in rpm and {other.place} in deg, both taken for SI units"))
    return [(factor, named) for factor, named in factors if max(factor, 1.0 / factor) >= SMALLEST_TOLD_FACTOR]


def factors_of_mistaken_unit(column: MappedColumn) -> list[tuple[float, str]]:
    """What a channel is multiplied by where its column is in another unit, and in which."""
    table = CONVERSIONS[column.target]
    given = table[column.units][0]
    others = {given / factor: unit for unit, (factor, _) in reversed(table.items()) if factor != given}
    return [(factor, f"{column.place} in {unit} taken for {column.units}") for factor, unit in others.items()]


def gain_by_travel(velocity: MappedColumn, angle: MappedColumn) -> Gain | None:
    """Travel by a velocity over travel by its angle, part by part of the record; None where there is too little."""
    if min(len(velocity.time), len(angle.time)) < FEWEST:
        return None
    steps = np.diff(velocity.time) * 0.5 * (velocity.values[1:] + velocity.values[:-1])
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    both = (angle.time >= velocity.time[0]) & (angle.time <= velocity.time[-1])
    by_velocity = np.diff(np.interp(angle.time[both], velocity.time, travelled))
    if len(by_velocity) < FEWEST:
        return None
    by_angle = unwrapped_steps(angle.values[both], by_velocity, angle.target)
    parts = np.linspace(0, len(by_angle), BLOCKS, endpoint=False).astype(int)
    return gain_through_zero(np.add.reduceat(by_velocity, parts), np.add.reduceat(by_angle, parts))


def unwrapped_steps(angle: Array, by_velocity: Array, units: str) -> Array:
    """How far an angle goes from row to row; one that wraps, as near to what the velocity says as whole turns let it.

    An angle that was sampled too slowly to be unwrapped so agrees with any velocity, and tells nothing.
    """
    steps = np.asarray(np.diff(angle), np.float64)
    reach = float(np.ptp(angle))
    if units != "rad" or reach == 0.0:
        return steps
    if np.abs(steps).max() > 0.5 * reach:
        return add_turns(steps, by_velocity, turn_of(steps, reach))
    # what turns by about whole turns from row to row seems to stand, or to turn slowly
    turned = add_turns(steps, by_velocity, TURN)
    changed = (turned != steps) & (CALIBRATION * np.abs(by_velocity) < 0.125 * TURN)
    close = np.abs(turned - by_velocity)[changed] <= CALIBRATION * np.abs(by_velocity)[changed]
    return turned if reach <= TURN and (not changed.any() or close.mean() > 0.5) else steps


def turn_of(steps: Array, reach: float) -> float:
    """What a wrapped angle jumps by: the steps before and at a jump differ by it."""
    jumps = np.flatnonzero((np.abs(steps[1:]) > 0.5 * reach) & (steps[1:] * steps[:-1] < 0.0)) + 1
    turn = float(np.median(np.abs(steps[jumps] - steps[jumps - 1]))) if len(jumps) else reach
    return TURN if abs(turn / TURN - 1.0) < CALIBRATION else turn


def add_turns(steps: Array, by_velocity: Array, turn: float) -> Array:
    """Steps of a wrapped angle with as many turns added as bring each nearest to what the velocity says."""
    return np.asarray(steps + turn * np.round((by_velocity - steps) / turn), np.float64)


def gain_by_setpoint(column: MappedColumn, setpoint: MappedColumn, quantity: str) -> Gain | None:
    """A measured channel over its setpoint; None where there is too little, or a zero that is anyone's."""
    both = (column.time >= setpoint.time[0]) & (column.time <= setpoint.time[-1])
    if both.sum() < FEWEST:
        return None
    measured, wanted = column.values[both], np.interp(column.time[both], setpoint.time, setpoint.values)
    if np.std(wanted) > VARIES * math.sqrt(float(np.mean(wanted**2))):
        return gain_through_zero(measured - measured.mean(), wanted - wanted.mean())
    return gain_through_zero(measured, wanted) if quantity != "angle" else None


def gain_through_zero(measured: Array, expected: Array) -> Gain | None:
    """The line through zero of one channel over another; its error takes the residual's autocorrelation in."""
    power, squares = float(expected @ expected), float(measured @ measured)
    if power == 0.0 or squares == 0.0:
        return None
    gain = float(measured @ expected) / power
    residual = measured - gain * expected
    std = math.sqrt(autocorrelated_variance(residual * expected)) / power
    return Gain(gain, std, 1.0 - float(residual @ residual) / squares)


def implausible_values(name: str, stream: Stream) -> Iterator[str]:
    """What is wrong with a stream's numbers, one line each."""
    if len(stream.time) < 2:
        yield f"stream {name}: {len(stream.time)} row; at least 2 were expected"
        return
    interval = float(np.median(np.diff(stream.time)))
    if not SHORTEST_S <= interval <= LONGEST_S:
        yield f"stream {name}: {interval:.3g} s between samples; are time.units right?"
    for spec, values in zip(stream.specs, stream.values, strict=True):
        low, high = PLAUSIBLE.get(spec.unit, (-np.inf, np.inf))
        wrong = np.flatnonzero((values < low) | (values > high))
        if len(wrong):
            worst = values[wrong[0]]
            finding = f"{worst:.6g} {spec.unit} at {stream.time[wrong[0]]:.6g} s is outside {low:g} .. {high:g}"
            yield f"stream {name}, channel {spec.name}: {finding}; are units and scale right?"


def notes_on_gaps(streams: dict[str, Stream]) -> Iterator[str]:
    """A note for each stream whose stamps leave far more than its usual interval out."""
    for name, stream in streams.items():
        intervals = np.diff(stream.time)
        usual = float(np.median(intervals))
        gaps = np.flatnonzero(intervals > max(GAP * usual, SHORTEST_GAP_S))
        if 0 < len(gaps) <= MOST_GAPS * len(intervals):
            longest = int(gaps[np.argmax(intervals[gaps])])
            where = f"{intervals[longest]:.4g} s without a sample from {stream.time[longest]:.6g} s"
            others = f" and {len(gaps) - 1} shorter" if len(gaps) > 1 else ""
            yield f"stream {name}: {where}{others}; samples come every {usual:.4g} s otherwise"
