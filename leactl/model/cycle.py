"""One cycle of an activity from a CSV: angle and torque of a joint, whose columns name their units.

    cycle_percent, angle_deg, torque_Nm_per_kg        (with the stride time and the mass of the body)
    time_s, angle_rad, torque_Nm                      (with the stride time, or closed by its first row once more)

Torque acts onto the joint; positive torque turns it towards positive angles. Other columns are ignored. The angle
becomes a Fourier series, whose derivatives are exact: the second derivative of samples would be noise. Of a series
with harmonics up to K, rows everywhere less than 1 / 2K of the cycle apart leave nothing free (Groechenig, 1992);
between rows further apart it would swing as it likes.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.tables.columns import Columns, CsvForm

Array = npt.NDArray[np.float64]
POINTS = 720  # of a cycle, evenly spaced
HARMONICS = 10  # of the angle: 10 Hz at a stride a second
FEWEST_ROWS, MOST_ROWS = 12, 100_000
LARGEST = 1e6  # of any number of the file, in its own unit
MOST_BYTES = 1 << 25  # of the file: 300 for each of so many rows
FEWEST_HARMONICS = 4  # that a joint's angle is told with
CLOSED_WITHIN = 0.05  # of its range, that a quantity may end from where it began
CLOSED_UNTOLD = 0.01  # the same where the last row alone tells how long the cycle takes
NOTED = 0.02  # of its range, that the series may leave of the angle untold; a sensor's noise leaves under 0.01
SLIPPED = 0.5  # of that is left without its worst sample: it was a slip; of an angle that turns sharply 0.7 is left
STRIDE_S = (0.05, 60.0)
NAMES = {
    "phase": ("cycle_percent", "time_s"),
    "angle": ("angle_rad", "angle_deg"),
    "torque": ("torque_Nm", "torque_Nm_per_kg"),
}
MOST = {"angle_rad": 2.0 * math.pi, "angle_deg": 360.0, "torque_Nm": 2000.0, "torque_Nm_per_kg": 10.0}
"""Range of an angle and size of a torque beyond which a joint has none: the unit is another."""


@dataclass(frozen=True, eq=False)
class Cycle:
    """One cycle of a joint, `POINTS` samples evenly spaced over its period."""

    name: str
    period: float  # s
    angle: Array  # rad
    velocity: Array  # rad/s
    acceleration: Array  # rad/s^2
    torque: Array  # N*m, onto the joint
    harmonics: int  # of the angle that are kept
    left_out: float  # root mean square of what the series leaves of the angle, of its range
    notes: tuple[str, ...] = ()


def read_cycle(
    path: Path, stride_time: float | None = None, body_mass: float | None = None, harmonics: int = HARMONICS
) -> Cycle:
    """Read one cycle.

    Parameters
    ----------
    stride_time : how long it takes [s]; with `time_s` it may be left out where the last row is the first once more.
    body_mass : [kg], for torque per mass.
    harmonics : of the angle that are kept at the most.

    Raises
    ------
    InputError : no such file, columns without the units above, rows that are no numbers, values that no joint has, rows
        too far apart, or no whole cycle.
    """
    columns, lines, table = _table(path)
    phase, angle, torque = table.T
    for name, values, size in ((columns[1], angle, np.ptp(angle)), (columns[2], torque, np.abs(torque).max())):
        if size > MOST[name]:
            what = "ranges over" if name.startswith("angle") else "reaches"
            other = next(one for one in (*NAMES["angle"], *NAMES["torque"]) if one[0] == name[0] and one != name)
            raise InputError(
                f"{path}: {name} {what} {size:g}, at most {MOST[name]:g} was expected of a joint; is it {other} or"
                " another unit?"
            )
        if len(np.unique(values)) == 1 and name.startswith("torque") and values[0] == 0.0:
            raise InputError(f"{path}: {name} is 0 throughout")
    if columns[2] == "torque_Nm_per_kg":
        if body_mass is None or not 1.0 <= body_mass <= 500.0:
            mass = "none" if body_mass is None else f"{body_mass:g} kg"
            raise InputError(f"{path}: torque_Nm_per_kg needs --body-mass, from 1 to 500 kg; found {mass}")
        torque = torque * body_mass
    if columns[1] == "angle_deg":
        angle = np.radians(angle)
    part, period = _parts(path, columns[0], phase, stride_time)
    closing = part[-1] >= 1.0 - 1e-9
    for name, values in (("angle", angle), ("torque", torque)):
        _expect_closed(path, name, values, closing, stride_time is not None)
    if closing:
        part, angle, torque = part[:-1], angle[:-1], torque[:-1]
    kept = _harmonics(path, part, harmonics)
    notes = []
    if kept < harmonics:
        notes.append(f"{kept} harmonics of the angle are kept: its rows are too far apart for {harmonics}")
    even = np.arange(POINTS) / POINTS
    series, slope, bend, fitted = _series(part, angle, kept, even)
    left_out, missed = _left_out(part, angle, fitted, lines, kept)
    return Cycle(
        name=path.stem,
        period=period,
        angle=series,
        velocity=slope / period,
        acceleration=bend / period**2,
        torque=np.interp(even, part, torque, period=1.0),
        harmonics=kept,
        left_out=left_out,
        notes=(*notes, *missed),
    )


def _harmonics(path: Path, part: Array, most: int) -> int:
    """How many the widest gap between rows allows.

    Raises
    ------
    InputError : fewer than a joint's angle needs.
    """
    gaps = np.diff(part, append=part[0] + 1.0)
    widest = int(np.argmax(gaps))
    allowed = math.ceil(0.5 / float(gaps[widest]) - 1e-6) - 1
    if allowed < min(FEWEST_HARMONICS, most):
        raise InputError(
            f"{path}: nothing is told from {part[widest]:.1%} to {part[widest] + gaps[widest]:.1%} of the cycle; rows"
            f" less than {0.5 / FEWEST_HARMONICS:.1%} apart were expected"
        )
    return min(allowed, most)


def _series(part: Array, values: Array, harmonics: int, at: Array) -> tuple[Array, Array, Array, Array]:
    """A Fourier series by least squares: value and derivatives to the part of the cycle, and value at the samples."""
    orders = 2.0 * np.pi * np.arange(1, harmonics + 1)

    def waves(x: Array, order: int) -> Array:
        turned = np.outer(x, orders) + 0.5 * np.pi * order
        constant = np.full((len(x), 1), float(order == 0))
        return np.hstack([constant, orders**order * np.cos(turned), orders**order * np.sin(turned)])

    coefficients = np.linalg.lstsq(waves(part, 0), values, rcond=None)[0]
    first, second, third = (waves(at, order) @ coefficients for order in (0, 1, 2))
    return first, second, third, waves(part, 0) @ coefficients


def _left_out(part: Array, angle: Array, fitted: Array, lines: list[int], harmonics: int) -> tuple[float, list[str]]:
    """What the series leaves of the angle, root mean square of its range, and what a reader must know of that."""
    spread = float(np.ptp(angle))
    if spread == 0.0:
        return 0.0, []
    left = float(np.sqrt(np.mean((fitted - angle) ** 2))) / spread
    worst = int(np.argmax(np.abs(fitted - angle)))
    slip = ""
    # with fewer rows a series through all but one fits whichever is left away
    if abs(fitted[worst] - angle[worst]) > NOTED * spread and len(part) > 2 * (2 * harmonics + 1):
        others = np.delete(np.arange(len(part)), worst)
        there, _slope, _bend, again = _series(part[others], angle[others], harmonics, part[[worst]])
        if np.sqrt(np.mean((again - angle[others]) ** 2)) < SLIPPED * left * spread:
            apart = abs(float(there[0] - angle[worst])) / spread
            slip = f"; line {lines[worst]} alone is {apart:.0%} of it off what the others tell: is it a slip?"
    if left <= NOTED and not slip:
        return left, []
    return left, [f"{harmonics} harmonics leave out {100.0 * left:.1f} % of the angle's range (rms){slip}"]


def _parts(path: Path, name: str, phase: Array, stride_time: float | None) -> tuple[Array, float]:
    """Where in the cycle each row is, from 0, and the period [s]."""
    if stride_time is not None and not STRIDE_S[0] <= stride_time <= STRIDE_S[1]:
        raise InputError(f"stride time {stride_time:g} s: from {STRIDE_S[0]:g} to {STRIDE_S[1]:g} s was expected")
    if name == "cycle_percent":
        if stride_time is None:
            raise InputError(f"{path}: cycle_percent needs --stride-time, in s")
        whole, period = 100.0, stride_time
    else:
        whole = period = stride_time if stride_time is not None else float(phase[-1] - phase[0])
    part = (phase - phase[0]) / whole
    step = float(np.median(np.diff(part)))
    if abs(part[-1] - 1.0) < 1e-6 * len(part):
        part[-1] = 1.0
    elif not 0.0 < 1.0 - part[-1] <= 2.0 * step:
        unit = "%" if name == "cycle_percent" else "s"
        raise InputError(
            f"{path}: {name} goes from {phase[0]:g} to {phase[-1]:g} {unit}: one whole cycle of {whole:g} {unit} was"
            " expected"
        )
    return part, period


def _expect_closed(path: Path, name: str, values: Array, closing: bool, told: bool) -> None:
    """Refuse what does not come back to where it began; without a closing row it may be one step short of it."""
    steps = np.abs(np.diff(values))
    within = CLOSED_WITHIN if told else CLOSED_UNTOLD
    allowed = max(within * float(np.ptp(values)), 0.0 if closing else 2.0 * float(steps.max()))
    apart = abs(float(values[-1] - values[0]))
    if apart > allowed:
        unit = "rad" if name == "angle" else "N*m"
        raise InputError(
            f"{path}: {name} ends {apart:.3g} {unit} from where it began, at most {allowed:.3g} {unit} was expected of"
            f" a cycle that repeats{'' if told else '; --stride-time tells how long one takes'}"
        )


def _table(path: Path) -> tuple[list[str], list[int], Array]:
    """Names of the columns used, the number of each line, and the values, one row a line."""
    every = [name for known in NAMES.values() for name in known]
    form = CsvForm(comment="", missing=())
    table = Columns(path, form, every, every_row=False, most_bytes=MOST_BYTES, most_rows=MOST_ROWS + 1, most_faults=1)
    names: list[str] = []
    for what, known in NAMES.items():
        matches = [name for name in table.names if name in known]
        if len(matches) != 1:
            expected = " or ".join(known)
            present = ", ".join(table.names)[:200]
            raise InputError(f"{path}: line 1: one column {expected} was expected for {what}; found {present}")
        names += matches
    count = len(table.lines)
    if not FEWEST_ROWS <= count <= MOST_ROWS:
        rows = f"more than {MOST_ROWS}" if count > MOST_ROWS else f"{count}"
        raise InputError(f"{path}: {rows} rows below the header; from {FEWEST_ROWS} to {MOST_ROWS} were expected")
    return names, table.lines.tolist(), table.numbers(names, LARGEST)
