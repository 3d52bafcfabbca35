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
FEWEST = 50  # rows common to both channels
CALIBRATION = 0.05  # relative, between two sensors or a loop and its setpoint: a few percent, where units are right
ERRORS = 4.0  # standard errors of the gain, added to `CALIBRATION` as tolerance of a unit's factor
LARGEST_GAIN_ERROR = 0.1  # relative standard error above which a gain tells nothing
EXPLAINED = 0.9  # least share of one channel's squares that the other explains: a lag or a limit is no factor
SMALLEST_TOLD_FACTOR = 2.0  # a factor less than this is what friction, ripple and limits make
LARGEST_UNTOLD_FACTOR = 20.0  # that is told although no unit makes it
VARIES = 0.1  # of a setpoint's root mean square; a setpoint that varies less shows its gain only by its level
BLOCKS = 40  # parts of a record in which travel by angle and by velocity are compared, so that noise averages out
SETPOINTS: Final = {name.removesuffix("_reference"): name for name in UNITS if name.endswith("_reference")}
# the widest ranges of electric machines, from watchmaking to traction
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
MOST_GAPS = 0.1  # share of the intervals; more long intervals than this are the log's normal sampling
SHORTEST_S, LONGEST_S = 1e-7, 3600.0  # between samples


class MappedColumn(NamedTuple):
    """The finite samples of a channel, with the units of its column and of its quantity."""

    path: str  # stream/channel
    time: Array
    values: Array
    units: str  # of the source's column, by the mapping
    target: str  # units of the run file


class Gain(NamedTuple):
    """Ratio of a channel to another channel that should be equal, by least squares."""

    value: float
    std: float
    explained: float  # share of the channel's squares


def notes_on_units(streams: dict[str, Stream], mapping: Mapping) -> Iterator[str]:
    """A note for each channel that differs by a factor from the channel that it should equal."""
    columns = {key: column for key, column in mapped_columns(streams, mapping)}
    for (quantity, role, location), column in columns.items():
        angle = columns.get(("angle", role, location)) if quantity == "velocity" else None
        if angle and column.target == f"{angle.target}/s":
            yield from notes_on_gain(column, angle, f"the change of {angle.path}", gain_by_travel(column, angle))
        setpoint = columns.get((SETPOINTS.get(quantity, ""), role, location))
        if setpoint and column.target == setpoint.target:
            yield from notes_on_gain(column, setpoint, setpoint.path, gain_by_setpoint(column, setpoint, quantity))


def mapped_columns(streams: dict[str, Stream], mapping: Mapping) -> Iterator[tuple[tuple[str, str, str], MappedColumn]]:
    """Each channel with its key (quantity, role, location)."""
    for name, stream in streams.items():
        for spec, values in zip(stream.specs, stream.values, strict=True):
            known = np.isfinite(values)
            units = mapping.streams[name].channels[spec.name].units or spec.unit
            column = MappedColumn(f"{name}/{spec.name}", stream.time[known], values[known], units, spec.unit)
            yield (spec.quantity, spec.role, spec.location), column


def notes_on_gain(column: MappedColumn, other: MappedColumn, what: str, gain: Gain | None) -> Iterator[str]:
    """A note if a well-known gain is that of a mistaken unit, beyond a factor of 20, or negative."""
    if gain is None or gain.explained < EXPLAINED or gain.std > LARGEST_GAIN_ERROR * abs(gain.value):
        return
    size = abs(gain.value)
    distances = [(abs(math.log(size / factor)), named) for factor, named in [(1.0, ""), *unit_factors(column, other)]]
    within = math.log1p(CALIBRATION) + ERRORS * gain.std / size
    candidates = [named for distance, named in sorted(distances) if distance <= within]
    finding = f"{column.path} reads {gain.value:.4g} times {what}"
    if candidates and all(candidates):
        yield f"{finding}: {', or '.join(candidates)}? a gear of that ratio would look alike"
    elif not 1.0 / LARGEST_UNTOLD_FACTOR < size < LARGEST_UNTOLD_FACTOR:
        yield f"{finding}: are scale and units of both right? a gear of that ratio would look alike"
    elif gain.value < 0.0:
        yield f"{finding}: is the sign of both right?"


def unit_factors(column: MappedColumn, other: MappedColumn) -> list[tuple[float, str]]:
    """Gains that a mistaken unit of either column would give, each with the unit in words."""
    factors = [
        *factors_of_mistaken_unit(column),
        *((1.0 / factor, named) for factor, named in factors_of_mistaken_unit(other)),
    ]
    if (column.units, other.units) == ("rad/s", "rad"):
        factor = CONVERSIONS["rad"]["deg"][0] / CONVERSIONS["rad/s"]["rpm"][0]
        factors.append((factor, f"{column.path} in rpm and {other.path} in deg, both taken for SI units"))
    return [(factor, named) for factor, named in factors if max(factor, 1.0 / factor) >= SMALLEST_TOLD_FACTOR]


def factors_of_mistaken_unit(column: MappedColumn) -> list[tuple[float, str]]:
    """Factors by which a channel is wrong if its column has another unit of the quantity, with that unit in words."""
    table = CONVERSIONS[column.target]
    given = table[column.units][0]
    others = {given / factor: unit for unit, (factor, _) in reversed(table.items()) if factor != given}
    return [(factor, f"{column.path} in {unit} taken for {column.units}") for factor, unit in others.items()]


def gain_by_travel(velocity: MappedColumn, angle: MappedColumn) -> Gain | None:
    """Ratio of a velocity's integral to the change of its angle, over blocks; None if there are too few samples."""
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
    """Changes of an angle from row to row; whole turns are added so that they are nearest to the velocity's integral.

    An angle sampled too slowly to be unwrapped then agrees with any velocity, and gives no information.
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
    """Size of the jumps of a wrapped angle: the difference of the steps at a jump and before it."""
    jumps = np.flatnonzero((np.abs(steps[1:]) > 0.5 * reach) & (steps[1:] * steps[:-1] < 0.0)) + 1
    turn = float(np.median(np.abs(steps[jumps] - steps[jumps - 1]))) if len(jumps) else reach
    return TURN if abs(turn / TURN - 1.0) < CALIBRATION else turn


def add_turns(steps: Array, by_velocity: Array, turn: float) -> Array:
    """Add to each step the number of turns that brings it nearest to the step of the velocity's integral."""
    return np.asarray(steps + turn * np.round((by_velocity - steps) / turn), np.float64)


def gain_by_setpoint(column: MappedColumn, setpoint: MappedColumn, quantity: str) -> Gain | None:
    """Ratio of a measured channel to its setpoint; None if samples are too few or an angle's zero is arbitrary."""
    both = (column.time >= setpoint.time[0]) & (column.time <= setpoint.time[-1])
    if both.sum() < FEWEST:
        return None
    measured, wanted = column.values[both], np.interp(column.time[both], setpoint.time, setpoint.values)
    if np.std(wanted) > VARIES * math.sqrt(float(np.mean(wanted**2))):
        return gain_through_zero(measured - measured.mean(), wanted - wanted.mean())
    return gain_through_zero(measured, wanted) if quantity != "angle" else None


def gain_through_zero(measured: Array, expected: Array) -> Gain | None:
    """Fit a line through zero; the standard error includes the autocorrelation of the residual."""
    power, squares = float(expected @ expected), float(measured @ measured)
    if power == 0.0 or squares == 0.0:
        return None
    gain = float(measured @ expected) / power
    residual = measured - gain * expected
    std = math.sqrt(autocorrelated_variance(residual * expected)) / power
    return Gain(gain, std, 1.0 - float(residual @ residual) / squares)


def implausible_values(name: str, stream: Stream) -> Iterator[str]:
    """One line for each fault of a stream: too few rows, an implausible interval, or values outside `PLAUSIBLE`."""
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
    """A note for each stream with gaps far longer than its usual sampling interval, and for such gaps of a channel."""
    for name, stream in streams.items():
        usual = float(np.median(np.diff(stream.time)))
        if gap := longest_gap(stream.time, usual):
            yield f"stream {name}: {gap}; samples come every {usual:.4g} s otherwise"
        for spec, values in zip(stream.specs, stream.values, strict=True):
            known = stream.time[np.isfinite(values)]
            if not 1 < len(known) < len(stream.time):
                continue
            of_channel = longest_gap(known, float(np.median(np.diff(known))))
            if of_channel and of_channel != gap:
                yield f"stream {name}, channel {spec.name}: {of_channel}"


def longest_gap(time: Array, usual: float) -> str:
    """The longest of the gaps between stamps that are far beyond the usual interval; empty if there is none."""
    intervals = np.diff(time)
    gaps = np.flatnonzero(intervals > max(GAP * usual, SHORTEST_GAP_S))
    if not 0 < len(gaps) <= MOST_GAPS * len(intervals):
        return ""
    longest = int(gaps[np.argmax(intervals[gaps])])
    others = f" and {len(gaps) - 1} shorter" if len(gaps) > 1 else ""
    return f"{intervals[longest]:.4g} s without a sample from {time[longest]:.6g} s{others}"
