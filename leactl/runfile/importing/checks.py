"""Check an imported recording for wrong units, columns or clocks: implausible values, gaps, and factors of a unit.

Two channels that should measure the same are compared: a velocity with the change of its angle, and a measured channel
with its setpoint. Since a gear, a limit or a bad sensor can cause any factor too, a factor is a note and not a fault.
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
FEWEST_COMMON_ROWS = 50  # rows of two channels at common times, for an estimate of their gain
CALIBRATION_ERROR = 0.05  # relative difference of two sensors, or of a loop and its setpoint, if the units are right
GAIN_ERROR_STDS = 4.0  # standard errors of the gain, added to `CALIBRATION_ERROR` as tolerance of a unit's factor
LARGEST_GAIN_ERROR = 0.1  # relative standard error above which a gain is not used
LEAST_EXPLAINED_SHARE = 0.9  # of one channel's squares, by the other; less means a lag or a limit instead of a factor
SMALLEST_REPORTED_FACTOR = 2.0  # friction, ripple and limits cause smaller factors
LARGEST_UNREPORTED_FACTOR = 20.0  # a larger factor, or its inverse, is reported even if it is not that of a unit
LEAST_VARIATION = 0.1  # as a share of a setpoint's root mean square; if it varies less, its gain is that of the levels
TRAVEL_BLOCKS = 40  # parts of a record in which travel by angle and by velocity are compared: noise averages out
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
GAP_INTERVALS = 10.0  # of the usual length, beyond which an interval is a gap
SHORTEST_GAP_S = 0.1  # shorter gaps may come from the scheduling of the logging program
MOST_GAP_SHARE = 0.1  # of the intervals; more long intervals than this are the log's normal sampling
SHORTEST_INTERVAL_S, LONGEST_INTERVAL_S = 1e-7, 3600.0  # between samples


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
    """Yield a note for each channel that differs by a factor from the channel that it should equal."""
    columns = {key: column for key, column in mapped_columns(streams, mapping)}
    for (quantity, role, location), column in columns.items():
        angle = columns.get(("angle", role, location)) if quantity == "velocity" else None
        if angle and column.target == f"{angle.target}/s":
            yield from notes_on_gain(column, angle, f"the change of {angle.path}", gain_by_travel(column, angle))
        setpoint = columns.get((SETPOINTS.get(quantity, ""), role, location))
        if setpoint and column.target == setpoint.target:
            yield from notes_on_gain(column, setpoint, setpoint.path, gain_by_setpoint(column, setpoint, quantity))


def mapped_columns(streams: dict[str, Stream], mapping: Mapping) -> Iterator[tuple[tuple[str, str, str], MappedColumn]]:
    """Yield the key (quantity, role, location) and the finite samples of each channel."""
    for name, stream in streams.items():
        for spec, values in zip(stream.specs, stream.values, strict=True):
            is_finite = np.isfinite(values)
            units = mapping.streams[name].channels[spec.name].units or spec.unit
            column = MappedColumn(f"{name}/{spec.name}", stream.time[is_finite], values[is_finite], units, spec.unit)
            yield (spec.quantity, spec.role, spec.location), column


def notes_on_gain(
    column: MappedColumn, reference: MappedColumn, reference_text: str, gain: Gain | None
) -> Iterator[str]:
    """Yield a note if a precise gain is that of a mistaken unit, is beyond a factor of 20, or is negative.

    Parameters
    ----------
    reference : channel that should equal `column`.
    reference_text : `reference`, or what is computed from it, in words.
    """
    if gain is None or gain.explained < LEAST_EXPLAINED_SHARE or gain.std > LARGEST_GAIN_ERROR * abs(gain.value):
        return
    magnitude = abs(gain.value)
    distances = [
        (abs(math.log(magnitude / factor)), unit_text)
        for factor, unit_text in [(1.0, ""), *unit_factors(column, reference)]
    ]
    tolerance = math.log1p(CALIBRATION_ERROR) + GAIN_ERROR_STDS * gain.std / magnitude
    candidates = [unit_text for distance, unit_text in sorted(distances) if distance <= tolerance]
    finding = f"{column.path} reads {gain.value:.4g} times {reference_text}"
    if candidates and all(candidates):
        yield f"{finding}: {', or '.join(candidates)}? a gear of that ratio would look alike"
    elif not 1.0 / LARGEST_UNREPORTED_FACTOR < magnitude < LARGEST_UNREPORTED_FACTOR:
        yield f"{finding}: are scale and units of both right? a gear of that ratio would look alike"
    elif gain.value < 0.0:
        yield f"{finding}: is the sign of both right?"


def unit_factors(column: MappedColumn, reference: MappedColumn) -> list[tuple[float, str]]:
    """Return the gains that a mistaken unit of either column would give, each with the unit in words."""
    factors = [
        *factors_of_mistaken_unit(column),
        *((1.0 / factor, unit_text) for factor, unit_text in factors_of_mistaken_unit(reference)),
    ]
    if (column.units, reference.units) == ("rad/s", "rad"):
        factor = CONVERSIONS["rad"]["deg"][0] / CONVERSIONS["rad/s"]["rpm"][0]
        factors.append((factor, f"{column.path} in rpm and {reference.path} in deg, both taken for SI units"))
    return [
        (factor, unit_text) for factor, unit_text in factors if max(factor, 1.0 / factor) >= SMALLEST_REPORTED_FACTOR
    ]


def factors_of_mistaken_unit(column: MappedColumn) -> list[tuple[float, str]]:
    """Return the factors by which a channel is wrong if its column has another unit, each with that unit in words."""
    table = CONVERSIONS[column.target]
    mapped_factor = table[column.units][0]
    factors = {mapped_factor / factor: unit for unit, (factor, _) in reversed(table.items()) if factor != mapped_factor}
    return [(factor, f"{column.path} in {unit} taken for {column.units}") for factor, unit in factors.items()]


def gain_by_travel(velocity: MappedColumn, angle: MappedColumn) -> Gain | None:
    """Return the ratio of a velocity's integral to the change of its angle, over blocks; None for too few samples."""
    if min(len(velocity.time), len(angle.time)) < FEWEST_COMMON_ROWS:
        return None
    steps = np.diff(velocity.time) * 0.5 * (velocity.values[1:] + velocity.values[:-1])
    travel = np.concatenate([[0.0], np.cumsum(steps)])
    is_common = (angle.time >= velocity.time[0]) & (angle.time <= velocity.time[-1])
    travel_steps = np.diff(np.interp(angle.time[is_common], velocity.time, travel))
    if len(travel_steps) < FEWEST_COMMON_ROWS:
        return None
    angle_steps = unwrapped_steps(angle.values[is_common], travel_steps, angle.target)
    block_starts = np.linspace(0, len(angle_steps), TRAVEL_BLOCKS, endpoint=False).astype(int)
    return gain_through_zero(np.add.reduceat(travel_steps, block_starts), np.add.reduceat(angle_steps, block_starts))


def unwrapped_steps(angle: Array, travel_steps: Array, units: str) -> Array:
    """Return the changes of an angle from row to row, with whole turns added to be nearest to the velocity's integral.

    `travel_steps` are the changes of the velocity's integral. An angle that is sampled too slowly to be unwrapped then
    agrees with any velocity, and gives no information.
    """
    steps = np.asarray(np.diff(angle), np.float64)
    angle_range = float(np.ptp(angle))
    if units != "rad" or angle_range == 0.0:
        return steps
    if np.abs(steps).max() > 0.5 * angle_range:
        return add_turns(steps, travel_steps, turn_of(steps, angle_range))
    # a shaft that turns by about whole turns from row to row seems to stand still or to turn slowly
    steps_plus_turns = add_turns(steps, travel_steps, TURN)
    has_turns = (steps_plus_turns != steps) & (CALIBRATION_ERROR * np.abs(travel_steps) < 0.125 * TURN)
    agrees = np.abs(steps_plus_turns - travel_steps)[has_turns] <= CALIBRATION_ERROR * np.abs(travel_steps)[has_turns]
    return steps_plus_turns if angle_range <= TURN and (not has_turns.any() or agrees.mean() > 0.5) else steps


def turn_of(steps: Array, angle_range: float) -> float:
    """Return the size of the jumps of a wrapped angle: the difference of the steps at a jump and before it."""
    jumps = np.flatnonzero((np.abs(steps[1:]) > 0.5 * angle_range) & (steps[1:] * steps[:-1] < 0.0)) + 1
    turn = float(np.median(np.abs(steps[jumps] - steps[jumps - 1]))) if len(jumps) else angle_range
    return TURN if abs(turn / TURN - 1.0) < CALIBRATION_ERROR else turn


def add_turns(steps: Array, travel_steps: Array, turn: float) -> Array:
    """Add to each step the number of turns that brings it nearest to the step of the velocity's integral."""
    return np.asarray(steps + turn * np.round((travel_steps - steps) / turn), np.float64)


def gain_by_setpoint(column: MappedColumn, setpoint: MappedColumn, quantity: str) -> Gain | None:
    """Return the ratio of a measured channel to its setpoint; None if there are too few common samples.

    None for an angle with a constant setpoint too, since the zero of an angle is arbitrary.
    """
    is_common = (column.time >= setpoint.time[0]) & (column.time <= setpoint.time[-1])
    if is_common.sum() < FEWEST_COMMON_ROWS:
        return None
    measured, expected = column.values[is_common], np.interp(column.time[is_common], setpoint.time, setpoint.values)
    if np.std(expected) > LEAST_VARIATION * math.sqrt(float(np.mean(expected**2))):
        return gain_through_zero(measured - measured.mean(), expected - expected.mean())
    return gain_through_zero(measured, expected) if quantity != "angle" else None


def gain_through_zero(measured: Array, expected: Array) -> Gain | None:
    """Fit a line through zero, with a standard error that includes the autocorrelation of the residual.

    None if either channel is zero throughout.
    """
    expected_squares, measured_squares = float(expected @ expected), float(measured @ measured)
    if expected_squares == 0.0 or measured_squares == 0.0:
        return None
    gain = float(measured @ expected) / expected_squares
    residual = measured - gain * expected
    std = math.sqrt(autocorrelated_variance(residual * expected)) / expected_squares
    return Gain(gain, std, 1.0 - float(residual @ residual) / measured_squares)


def implausible_values(name: str, stream: Stream) -> Iterator[str]:
    """Yield a line for each fault of a stream: too few rows, an implausible interval, or values not in `PLAUSIBLE`."""
    if len(stream.time) < 2:
        yield f"stream {name}: {len(stream.time)} row; at least 2 were expected"
        return
    interval = float(np.median(np.diff(stream.time)))
    if not SHORTEST_INTERVAL_S <= interval <= LONGEST_INTERVAL_S:
        yield f"stream {name}: {interval:.3g} s between samples; are time.units right?"
    for spec, values in zip(stream.specs, stream.values, strict=True):
        low, high = PLAUSIBLE.get(spec.unit, (-np.inf, np.inf))
        rows = np.flatnonzero((values < low) | (values > high))
        if len(rows):
            first_value = values[rows[0]]
            finding = f"{first_value:.6g} {spec.unit} at {stream.time[rows[0]]:.6g} s is outside {low:g} .. {high:g}"
            yield f"stream {name}, channel {spec.name}: {finding}; are units and scale right?"


def notes_on_gaps(streams: dict[str, Stream]) -> Iterator[str]:
    """Yield a note for each stream or channel with gaps that are far longer than its usual sampling interval."""
    for name, stream in streams.items():
        usual_interval = float(np.median(np.diff(stream.time)))
        if gap := longest_gap(stream.time, usual_interval):
            yield f"stream {name}: {gap}; samples come every {usual_interval:.4g} s otherwise"
        for spec, values in zip(stream.specs, stream.values, strict=True):
            finite_stamps = stream.time[np.isfinite(values)]
            if not 1 < len(finite_stamps) < len(stream.time):
                continue
            channel_gap = longest_gap(finite_stamps, float(np.median(np.diff(finite_stamps))))
            if channel_gap and channel_gap != gap:
                yield f"stream {name}, channel {spec.name}: {channel_gap}"


def longest_gap(time: Array, usual_interval: float) -> str:
    """Describe the longest of the gaps that are far longer than the usual interval [s]; empty if there is none."""
    intervals = np.diff(time)
    gaps = np.flatnonzero(intervals > max(GAP_INTERVALS * usual_interval, SHORTEST_GAP_S))
    if not 0 < len(gaps) <= MOST_GAP_SHARE * len(intervals):
        return ""
    longest = int(gaps[np.argmax(intervals[gaps])])
    shorter_gaps = f" and {len(gaps) - 1} shorter" if len(gaps) > 1 else ""
    return f"{intervals[longest]:.4g} s without a sample from {time[longest]:.6g} s{shorter_gaps}"
