"""Read one cycle of a joint's angle and torque from a CSV file whose column names contain the units.

    cycle_percent, angle_deg, torque_Nm_per_kg        (needs the stride time and the mass of the body)
    time_s, angle_rad, torque_Nm                      (needs the stride time, or a last row that repeats the first)

Torque acts onto the joint; positive torque turns it towards positive angles. Other columns are ignored. The angle
is fitted by a Fourier series, whose derivatives are exact, because the second derivative of samples would be noise.
A series with harmonics up to K is determined by its rows if no gap between rows exceeds 1 / 2K of the cycle
(Groechenig, 1992); in wider gaps the fit would oscillate freely.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.tables.columns import Columns, CsvForm

Array = npt.NDArray[np.float64]
POINTS_PER_CYCLE = 720  # evenly spaced samples of a cycle
DEFAULT_HARMONICS = 10  # default number for the angle: up to 10 Hz at one stride per second
FEWEST_ROWS, MOST_ROWS = 12, 100_000  # rows of numbers in the file
LARGEST_NUMBER = 1e6  # magnitude of any number in the file, in the unit of its column
MOST_FILE_BYTES = 1 << 25  # size of the file: about 300 bytes for each of `MOST_ROWS`
FEWEST_HARMONICS = 4  # fewer do not describe the angle of a joint
CLOSING_TOLERANCE = 0.05  # largest difference between first and last value, as a share of the quantity's range
CLOSING_TOLERANCE_WITHOUT_STRIDE_TIME = 0.01  # the same if the period is known from the last row alone
NOTED_RESIDUAL = 0.02  # residual of the series that is noted, as a share of the angle's range; noise leaves under 0.01
SLIP_RATIO = 0.5  # one sample is an outlier if the residual falls below this share without it; sharp turns leave 0.7
STRIDE_TIME_RANGE = (0.05, 60.0)  # s
CLOSING_SHARE = 0.1  # of a row's step, by which the closing row may miss the end of the cycle: rounding of the file
COLUMN_NAMES = {
    "phase": ("cycle_percent", "time_s"),
    "angle": ("angle_rad", "angle_deg"),
    "torque": ("torque_Nm", "torque_Nm_per_kg"),
}
JOINT_LIMITS = {"angle_rad": 2.0 * math.pi, "angle_deg": 360.0, "torque_Nm": 2000.0, "torque_Nm_per_kg": 10.0}
"""Largest range of an angle and largest magnitude of a torque of a joint; larger values have another unit."""


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle of a joint, `POINTS_PER_CYCLE` samples evenly spaced over its period."""

    name: str
    period: float  # s
    angle: Array  # rad
    velocity: Array  # rad/s
    acceleration: Array  # rad/s^2
    torque: Array  # N*m, onto the joint
    harmonics: int  # number of harmonics of the angle
    relative_residual: float  # root mean square of angle minus series, as a share of the angle's range
    notes: tuple[str, ...] = ()


def read_cycle(
    path: Path, stride_time: float | None = None, body_mass: float | None = None, harmonics: int = DEFAULT_HARMONICS
) -> Cycle:
    """Read one cycle and fit the angle by a Fourier series.

    Parameters
    ----------
    stride_time : period of the cycle [s]; optional with `time_s` if the last row repeats the first.
    body_mass : mass of the body [kg], required for torque per mass.
    harmonics : largest number of harmonics of the angle; fewer are used where rows are too far apart.

    Raises
    ------
    InputError : no such file, columns without the units above, rows that are not numbers, values that no joint has,
        rows too far apart, or less or more than one whole cycle.
    """
    columns, lines, table = _table(path)
    phase, angle, torque = table.T
    for name, values, size in ((columns[1], angle, np.ptp(angle)), (columns[2], torque, np.abs(torque).max())):
        if size > JOINT_LIMITS[name]:
            verb = "ranges over" if name.startswith("angle") else "reaches"
            names = *COLUMN_NAMES["angle"], *COLUMN_NAMES["torque"]
            other_unit = next(column for column in names if column[0] == name[0] and column != name)
            raise InputError(
                f"{path}: {name} {verb} {size:g}, at most {JOINT_LIMITS[name]:g} was expected of a joint; is it"
                f" {other_unit} or another unit?"
            )
        if len(np.unique(values)) == 1 and name.startswith("torque") and values[0] == 0.0:
            raise InputError(f"{path}: {name} is 0 throughout")
    if columns[2] == "torque_Nm_per_kg":
        if body_mass is None or not 1.0 <= body_mass <= 500.0:
            mass_text = "none" if body_mass is None else f"{body_mass:g} kg"
            raise InputError(f"{path}: torque_Nm_per_kg needs --body-mass, from 1 to 500 kg; found {mass_text}")
        torque = torque * body_mass
    if columns[1] == "angle_deg":
        angle = np.radians(angle)
    position, period = _cycle_positions(path, columns[0], phase, stride_time)
    has_closing_row = position[-1] >= 1.0 - 1e-9
    for name, values in (("angle", angle), ("torque", torque)):
        _expect_closed(path, name, values, has_closing_row, stride_time is not None)
    if has_closing_row:
        position, angle, torque = position[:-1], angle[:-1], torque[:-1]
    harmonic_count = _allowed_harmonics(path, position, harmonics)
    notes = []
    if harmonic_count < harmonics:
        notes.append(f"{harmonic_count} harmonics of the angle are kept: its rows are too far apart for {harmonics}")
    grid_positions = np.arange(POINTS_PER_CYCLE) / POINTS_PER_CYCLE
    series, slope, curvature, fitted_angle = _series(position, angle, harmonic_count, grid_positions)
    relative_residual, residual_notes = _residual_and_notes(position, angle, fitted_angle, lines, harmonic_count)
    return Cycle(
        name=path.stem,
        period=period,
        angle=series,
        velocity=slope / period,
        acceleration=curvature / period**2,
        torque=np.interp(grid_positions, position, torque, period=1.0),
        harmonics=harmonic_count,
        relative_residual=relative_residual,
        notes=(*notes, *residual_notes),
    )


def _allowed_harmonics(path: Path, position: Array, requested: int) -> int:
    """Return the number of harmonics that the widest gap between rows allows, at most `requested`.

    Raises
    ------
    InputError : the gap allows fewer than `FEWEST_HARMONICS`, or than `requested` if that is smaller.
    """
    gaps = np.diff(position, append=position[0] + 1.0)
    widest_row = int(np.argmax(gaps))
    allowed = math.ceil(0.5 / float(gaps[widest_row]) - 1e-6) - 1
    if allowed < min(FEWEST_HARMONICS, requested):
        raise InputError(
            f"{path}: nothing is told from {position[widest_row]:.1%} to"
            f" {position[widest_row] + gaps[widest_row]:.1%} of the cycle; rows less than"
            f" {0.5 / min(FEWEST_HARMONICS, requested):.1%} apart were expected"
        )
    return min(allowed, requested)


def _series(position: Array, values: Array, harmonics: int, grid_positions: Array) -> tuple[Array, Array, Array, Array]:
    """Fit a Fourier series by least squares to values at positions in the cycle, 0 to 1.

    Returns
    -------
    Value, first and second derivative by the position at `grid_positions`, and value at `position`.
    """
    orders = 2.0 * np.pi * np.arange(1, harmonics + 1)

    def waves(positions: Array, order: int) -> Array:
        """Return the terms of the series at positions, or their derivatives of an order, shape (n, terms)."""
        phases = np.outer(positions, orders) + 0.5 * np.pi * order
        constant = np.full((len(positions), 1), float(order == 0))
        return np.hstack([constant, orders**order * np.cos(phases), orders**order * np.sin(phases)])

    coefficients = np.linalg.lstsq(waves(position, 0), values, rcond=None)[0]
    value, slope, curvature = (waves(grid_positions, order) @ coefficients for order in (0, 1, 2))
    return value, slope, curvature, waves(position, 0) @ coefficients


def _residual_and_notes(
    position: Array, angle: Array, fit: Array, lines: list[int], harmonics: int
) -> tuple[float, list[str]]:
    """Return the root mean square residual of the series as a share of the angle's range, and notes if it is large.

    `lines` has the line of the file for each row; a note names the line of a single outlier.
    """
    angle_range = float(np.ptp(angle))
    if angle_range == 0.0:
        return 0.0, []
    residual = float(np.sqrt(np.mean((fit - angle) ** 2))) / angle_range
    outlier = int(np.argmax(np.abs(fit - angle)))
    slip_text = ""
    # with fewer rows, the series fits the remaining rows whichever row is left out
    if abs(fit[outlier] - angle[outlier]) > NOTED_RESIDUAL * angle_range and len(position) > 2 * (2 * harmonics + 1):
        other_rows = np.delete(np.arange(len(position)), outlier)
        value_at_outlier, _slope, _curvature, refit = _series(
            position[other_rows], angle[other_rows], harmonics, position[[outlier]]
        )
        if np.sqrt(np.mean((refit - angle[other_rows]) ** 2)) < SLIP_RATIO * residual * angle_range:
            distance = abs(float(value_at_outlier[0] - angle[outlier])) / angle_range
            slip_text = f"; line {lines[outlier]} alone is {distance:.0%} of it off what the others tell: is it a slip?"
    if residual <= NOTED_RESIDUAL and not slip_text:
        return residual, []
    return residual, [f"{harmonics} harmonics leave out {100.0 * residual:.1f} % of the angle's range (rms){slip_text}"]


def _cycle_positions(path: Path, name: str, phase: Array, stride_time: float | None) -> tuple[Array, float]:
    """Return the position of each row in the cycle, 0 for the first row and 1 for a closing row, and the period [s].

    Raises
    ------
    InputError : a stride time outside `STRIDE_TIME_RANGE`, none where it is needed, or less or more than one cycle.
    """
    shortest, longest = STRIDE_TIME_RANGE
    if stride_time is not None and not shortest <= stride_time <= longest:
        raise InputError(f"stride time {stride_time:g} s: from {shortest:g} to {longest:g} s was expected")
    if name == "cycle_percent":
        if stride_time is None:
            raise InputError(f"{path}: cycle_percent needs --stride-time, in s")
        full_cycle, period = 100.0, stride_time
    else:
        full_cycle = period = stride_time if stride_time is not None else float(phase[-1] - phase[0])
    if not shortest <= period <= longest:
        raise InputError(f"{path}: a cycle of {period:g} s; from {shortest:g} to {longest:g} s was expected")
    position = (phase - phase[0]) / full_cycle
    step = float(np.median(np.diff(position)))
    if abs(position[-1] - 1.0) < CLOSING_SHARE * step:
        position[-1] = 1.0
    elif not 0.0 < 1.0 - position[-1] <= 2.0 * step:
        unit = "%" if name == "cycle_percent" else "s"
        raise InputError(
            f"{path}: {name} goes from {phase[0]:g} to {phase[-1]:g} {unit}: one whole cycle of {full_cycle:g} {unit}"
            " was expected"
        )
    return position, period


def _expect_closed(path: Path, name: str, values: Array, has_closing_row: bool, stride_time_given: bool) -> None:
    """Raise InputError if a quantity does not end at the value at which it began.

    Without a closing row, the last row may differ from the first by twice the largest step between rows.

    Raises
    ------
    InputError : the difference is larger than allowed.
    """
    row_steps = np.abs(np.diff(values))
    fraction = CLOSING_TOLERANCE if stride_time_given else CLOSING_TOLERANCE_WITHOUT_STRIDE_TIME
    allowed = max(fraction * float(np.ptp(values)), 0.0 if has_closing_row else 2.0 * float(row_steps.max()))
    distance = abs(float(values[-1] - values[0]))
    if distance > allowed:
        unit = "rad" if name == "angle" else "N*m"
        raise InputError(
            f"{path}: {name} ends {distance:.3g} {unit} from where it began, at most {allowed:.3g} {unit} was expected"
            f" of a cycle that repeats{'' if stride_time_given else '; --stride-time tells how long one takes'}"
        )


def _table(path: Path) -> tuple[list[str], list[int], Array]:
    """Return the names of the three columns, the line number of each row, and the values, shape (rows, 3).

    Raises
    ------
    InputError : no such file, a column that is absent or present in two units, cells that are not numbers, or fewer
        rows than `FEWEST_ROWS` or more than `MOST_ROWS`.
    """
    known_names = [name for quantity_names in COLUMN_NAMES.values() for name in quantity_names]
    form = CsvForm(comment="", missing=())
    table = Columns(
        path, form, known_names, every_row=False, most_bytes=MOST_FILE_BYTES, most_rows=MOST_ROWS + 1, most_faults=1
    )
    names: list[str] = []
    for quantity, quantity_names in COLUMN_NAMES.items():
        matches = [name for name in table.names if name in quantity_names]
        if len(matches) != 1:
            expected = " or ".join(quantity_names)
            present = ", ".join(table.names)[:200]
            raise InputError(f"{path}: line 1: one column {expected} was expected for {quantity}; found {present}")
        names += matches
    count = len(table.lines)
    if not FEWEST_ROWS <= count <= MOST_ROWS:
        rows = f"more than {MOST_ROWS}" if count > MOST_ROWS else f"{count}"
        raise InputError(f"{path}: {rows} rows below the header; from {FEWEST_ROWS} to {MOST_ROWS} were expected")
    return names, table.lines.tolist(), table.numbers(names, LARGEST_NUMBER)
