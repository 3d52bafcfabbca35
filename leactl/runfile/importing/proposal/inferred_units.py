"""Infer the unit of a column from its values: jumps of a wrapped angle, the integral of a velocity, ranges.

The ratio of a velocity to the rate of its angle depends only on their units if both belong to one shaft. A gear between
them multiplies it, and gears of 6, 9.1 or 60 imitate other pairs of units. Therefore only a ratio of 1 decides a unit
from a known one; any other ratio merely puts the matching pair first among the choices for a person.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.runfile.importing.checks import Gain, MappedColumn, gain_by_setpoint, gain_by_travel
from leactl.units import CONVERSIONS, SECONDS, converter

Array = npt.NDArray[np.float64]
ANGLES: Final = ("rad", "deg", "turn", "m", "mm")  # units of angles in logs; `rev` is another name of turn
VELOCITIES: Final = ("rad/s", "deg/s", "rpm", "turn/s", "m/s", "mm/s")
MOST_DEGREES: Final = 400.0  # largest angle of a limb in whole degrees
WIDE_RAD: Final = 6.0 * math.pi  # larger than the angle of any limb
UNITS_LIKE_A_GEAR: Final = ("deg/s", "rpm", "turn/s")  # their ratios are 6 and 60, which are also ratios of gears
TURNS: Final = {2.0 * math.pi: "rad", 360.0: "deg", 1.0: "turn"}  # unit by the size of a wrap
UNIT_GAIN_TOLERANCE: Final = 0.004  # relative, of a gain to 1, if the unit of one channel is known
PAIR_GAIN_TOLERANCE: Final = 0.003  # relative, of a gain to the ratio of two different units, which are then likeliest
GEAR_TOLERANCE: Final = 0.003  # relative, of a gain to a whole number, which may be the ratio of a gear
LARGEST_GAIN_ERROR: Final = 0.001  # relative standard error of a gain that decides
LEAST_EXPLAINED_SHARE: Final = 0.95  # share of a velocity that the angle's change has to explain
SETPOINT_TOLERANCE: Final = 0.05  # relative, of a reading to its setpoint
FEWEST_JUMPS: Final = 2  # of an angle, by which it counts as wrapped
NEIGHBOURS: Final = 3  # steps on either side of a jump, by which the travel there is measured
TURN_TOLERANCE: Final = 0.05  # relative, of a jump with the travel around it to a turn
LEAST_WRAP_SHARE: Final = 0.8  # of the jumps of a wrapped angle
AMPERES: Final = (0.05, 5.0)  # largest current of a log in A; no actuator moves with such a current in mA
VOLTS: Final = (0.5, 60.0)  # largest voltage of a log in V; windings have more mV, and rigs of more V are asked for
SHORTEST_ROW_INTERVAL_S, LONGEST_ROW_INTERVAL_S = 2e-5, 10.0  # between rows of a log, in the median
EPOCHS: Final = {"s": 1e9, "ms": 1e12, "us": 1e15, "ns": 1e18}  # stamps in 2001; twice as large ones are in 2033
VOLTS_OF_A_BUS: Final = (3.0, 1000.0)
INDOORS_DEGC: Final = (5.0, 45.0)  # range of a log's coldest reading; the same numbers in degF are -15 to 7 degC


class AngleWrap(NamedTuple):
    """Wrap of an angle: the size of its jumps, and the unit in which that is a turn."""

    units: str
    period: float  # a turn, in the unit of the column
    jumps: int  # number of jumps
    jump: float  # median size of a jump, in the unit of the column


def find_wrap(values: Array) -> AngleWrap | None:
    """Find the unit of a wrapped angle; None if it does not wrap, or its jumps are not a turn in any unit.

    A jump of a wrap goes against the travel around it, and together they are a turn; a step of a setpoint from one
    level to another is none.
    """
    finite_values = values[np.isfinite(values)]
    if len(finite_values) < FEWEST_JUMPS + 1:
        return None
    value_range = float(np.ptp(finite_values))
    steps = np.diff(finite_values)
    for period, units in TURNS.items():
        jumps = np.flatnonzero(np.abs(steps) > 0.8 * period)
        if 0.9 * period <= value_range <= 1.001 * period and FEWEST_JUMPS <= len(jumps) < 0.2 * len(steps):
            travel = travel_around(steps, jumps, 0.5 * period)
            turns = np.abs(steps[jumps]) + np.abs(travel)
            are_wraps = (steps[jumps] * travel < 0.0) & (np.abs(turns / period - 1.0) < TURN_TOLERANCE)
            if are_wraps.sum() >= max(FEWEST_JUMPS, LEAST_WRAP_SHARE * len(jumps)):
                return AngleWrap(units, period, int(are_wraps.sum()), float(np.median(np.abs(steps[jumps]))))
    return None


def travel_around(steps: Array, jumps: npt.NDArray[np.intp], largest: float) -> Array:
    """Return the mean of up to `NEIGHBOURS` steps on either side of each jump; only steps below `largest` count."""
    small_steps = np.pad(np.where(np.abs(steps) < largest, steps, np.nan), NEIGHBOURS, constant_values=np.nan)
    shifts = [shift for shift in range(2 * NEIGHBOURS + 1) if shift != NEIGHBOURS]
    around = np.stack([small_steps[jumps + shift] for shift in shifts])
    known = np.isfinite(around)
    return np.asarray(np.where(known, around, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1), np.float64)


class ColumnSeries(NamedTuple):
    """A column with its stamps [s], in the units of the file."""

    time: Array
    values: Array

    def known(self) -> "ColumnSeries":
        """Return the rows with finite values."""
        rows = np.isfinite(self.values)
        return ColumnSeries(self.time[rows], self.values[rows])


def gain_of(angle: ColumnSeries, velocity: ColumnSeries) -> Gain | None:
    """Return the ratio of a velocity to the rate of change of its angle, in the file's units, or None if imprecise."""
    wrap, known_angle, known_velocity = find_wrap(angle.values), angle.known(), velocity.known()
    if min(len(known_angle.time), len(known_velocity.time)) < 2:
        return None
    unwrapped = np.unwrap(known_angle.values, period=wrap.period) if wrap else known_angle.values
    gain = gain_by_travel(
        MappedColumn("", *known_velocity, "", ""), MappedColumn("", known_angle.time, unwrapped, "", "")
    )
    if gain is None or gain.explained < LEAST_EXPLAINED_SHARE or gain.std > LARGEST_GAIN_ERROR * abs(gain.value):
        return None
    return gain


def unit_pairs_with_gain(gain: float, tolerance: float) -> list[tuple[str, str]]:
    """Return the pairs (angle unit, velocity unit) whose ratio equals a gain, within a relative tolerance."""
    pairs = []
    for angle in ANGLES:
        for velocity in VELOCITIES:
            angle_conversion, velocity_conversion = converter(angle, "angle"), converter(velocity, "velocity")
            assert angle_conversion is not None and velocity_conversion is not None
            if f"{angle_conversion.target}/s" == velocity_conversion.target:
                factor = angle_conversion.factor / velocity_conversion.factor
                if abs(math.log(abs(gain) / factor)) <= tolerance:
                    pairs.append((angle, velocity))
    return pairs


def is_gear(gain: float) -> bool:
    """Return whether a ratio or its inverse is near a whole number, as that of a gear."""
    ratio = max(abs(gain), 1.0 / abs(gain))
    return abs(ratio / round(ratio) - 1.0) <= GEAR_TOLERANCE


def equals_setpoint(measured: ColumnSeries, setpoint: ColumnSeries, quantity: str) -> bool:
    """Return whether a reading equals its setpoint within `SETPOINT_TOLERANCE`, as in a common unit."""
    reading, setpoint_values = measured.known(), setpoint.known()
    if min(len(reading.time), len(setpoint_values.time)) < 2:
        return False
    gain = gain_by_setpoint(MappedColumn("", *reading, "", ""), MappedColumn("", *setpoint_values, "", ""), quantity)
    return gain is not None and gain.explained >= LEAST_EXPLAINED_SHARE and abs(gain.value - 1.0) <= SETPOINT_TOLERANCE


def units_of_time(stamps: Array, candidates: Sequence[str] = tuple(EPOCHS)) -> tuple[list[str], str]:
    """Return the candidates that may be the unit of stamps, and the reason."""
    median_stamp = float(np.median(stamps))
    interval = float(np.median(np.diff(stamps))) if len(stamps) > 1 else math.nan
    shortest, longest = SHORTEST_ROW_INTERVAL_S, LONGEST_ROW_INTERVAL_S
    for units, epoch in EPOCHS.items():
        # stamps in us since a start may be as large as dates in s
        is_likely = math.isnan(interval) or shortest <= interval * SECONDS[units] <= longest
        if epoch <= median_stamp <= 2.2 * epoch and is_likely:
            return [units], f"about {median_stamp:.4g} is a date of these years in {units}"
    likely_units = [units for units in candidates if shortest <= interval * SECONDS[units] <= longest]
    return likely_units, f"{interval:.4g} from row to row"


def is_wide_for_rad(values: Array) -> bool:
    """Return whether the range of an angle suggests degrees; no proof, since a spindle may turn as far in rad."""
    largest = float(np.nanmax(np.abs(values)))
    return WIDE_RAD < largest <= 360.0


def are_counts(columns: Sequence[Array]) -> bool:
    """Return whether an angle consists of encoder counts: whole numbers beyond `MOST_DEGREES`."""
    finite_values = np.concatenate([values[np.isfinite(values)] for values in columns])
    return bool((finite_values == np.round(finite_values)).all()) and float(np.abs(finite_values).max()) > MOST_DEGREES


def units_by_range(quantity: str, values: Array) -> tuple[str, str]:
    """Return the only unit that fits the range of a column, and the reason; empty if several units fit."""
    finite_values = values[np.isfinite(values)]
    if not len(finite_values):
        return "", ""
    low, high, middle = float(finite_values.min()), float(finite_values.max()), float(np.median(finite_values))
    range_text = f"its range {low:.4g} .. {high:.4g}"
    if quantity == "drive_enabled" and set(np.unique(finite_values).tolist()) <= {0.0, 1.0}:
        return "1", f"{range_text}, 0 and 1 alone"
    # whole numbers may be scaled, such as tenths of a volt
    are_whole = bool((finite_values == np.round(finite_values)).all())
    if quantity == "bus_voltage" and not are_whole:
        lowest, highest = VOLTS_OF_A_BUS
        if lowest <= middle <= highest:
            return "V", f"{range_text}; no bus has so few millivolts"
        if lowest * 1e3 <= middle <= highest * 1e3:
            return "mV", f"{range_text}; no bus has so many volts"
    largest = max(-low, high)
    if "current" in quantity and not are_whole and AMPERES[0] <= largest <= AMPERES[1]:
        return "A", f"{range_text}; no actuator moves on as few mA"
    if "voltage" in quantity and not are_whole and VOLTS[0] <= largest <= VOLTS[1]:
        return "V", f"{range_text}; no winding shows as few mV"
    if quantity.endswith("temperature"):
        factor, zero = CONVERSIONS["degC"]["degF"]
        if INDOORS_DEGC[0] <= low <= INDOORS_DEGC[1]:
            return "degC", f"{range_text}; in degF it would begin at {factor * (low - zero):.3g} degC"
        if low > 250.0 and high < 600.0:
            return "K", f"{range_text}; no log begins so hot in degC or degF"
    if quantity.startswith("angle") and (wrap := find_wrap(values)):
        return wrap.units, f"{wrap.jumps} jumps by {wrap.jump:.4g}, with the travel there a turn in {wrap.units}"
    return "", ""
