"""Whether a drive's setpoints change between the rows of a log, as they do where a log is slower than what sets them.

A row that keeps its setpoint over its interval, as `sampling` promises, tells all that the drive follows: a linear
drive's current is then one weighted sum of the reference's rows around it. Where setpoints come into force somewhere
inside their intervals, that sum fails where the reference leaps. It also fails there where a drive limits the rate of
its current; but with the right limit, one for the whole log, the sum holds again. And no drive knows the setpoint of
the next row: where the sum gives that row a weight, it stands in for setpoints between the rows.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d
from scipy.optimize import minimize_scalar

from leactl.effects.shapes import ramp_shares, rate_limited
from leactl.gap.signals.derived import led, loop, moved_by_a_servo
from leactl.gap.signals.record import Record
from leactl.gap.signals.stamps import TAPS, neighbour
from leactl.gap.signals.voltage_ceiling import at_ceiling
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
CURRENT, REFERENCE = ("q_axis_current", "test"), ("q_axis_current_reference", "test")
LEAP, NEAR = 0.7, 3  # of the largest change so many rows near, by which a reference bends where it leaps
STEP = 0.05  # of a leap, that a reference may change in the rows beside it
TELLING = 20.0  # standard deviations of what is missed elsewhere, from which on a leap tells
MISSED, FEWEST = 5.0, 3  # of these deviations, and how many rows have to be missed by more
DOUBTED = 4.0  # standard deviations of the next row's weight below zero, from which rows are not said to hold
SHARE = 2e-3  # of the leaps' squares; rows that keep their setpoint miss 1e-5, every second or fourth one 0.01 to 0.1
BENT = 1.0 / 24.0  # of a reference's bend over four rows, that the mean of a curve lacks between the middle two
SETTLES = 8.0  # time constants of a current loop, after which a leap is forgotten
RAMPS = 2.0 ** np.arange(-2.0, 8.5, 0.5)  # rows that the largest change may take in a drive that limits its rate
SHORT_RAMP = 2.0  # rows of the longest ramp whose first row still tells when in it the ramp began
CLOSE = 0.002  # how far from the best rate a search may end, as a share of it


class ReferenceFollowing(NamedTuple):
    """How the current of one run follows its reference."""

    missed: Array  # by the best sum of neighbours, in standard deviations of what it misses as a rule
    leaping: Array  # how far the reference leaps, in the same
    steps: Mask  # whether it leaps at once
    foresight: tuple[float, float]  # weight of the next row in those away from leaps, and its standard deviation
    noise: float  # standard deviation [A] of what it misses as a rule


class LimitedFollowing(NamedTuple):
    """How the currents of a log follow at the one rate that fits them best."""

    shown: list[ReferenceFollowing]
    ramp: float  # rows that the largest change of a reference takes


def marked(records: Sequence[Record], model: Model) -> list[Record]:
    """The runs, all marked where one shows that its setpoints change between rows, or hold: they are of one log."""
    followed = [(record, one) for record in records if (one := follow(record, model)) is not None]
    shown = [one for _, one in followed]
    leaping = [pair for pair in followed if (pair[1].leaping > TELLING).any()]
    leaps_missed = any(changes_between(one.missed, one.leaping) for one in shown)
    against = against_next([one.foresight for one in shown])
    between = against > MISSED
    if not between and (leaps_missed or sum(int(misses(*one[:3]).sum()) for one in shown) >= FEWEST):
        # only what no rate explains is between rows; whether rows hold, a longer ramp than a short one cannot show
        limited = at_one_rate(leaping, model)
        between = leaps_missed and any(changes_between(one.missed, one.leaping) for one in limited.shown)
        if limited.ramp <= SHORT_RAMP:
            shown, leaps_missed = limited.shown, between
    held = any(holds(*one[:3]) for one in shown) and not any(misses(*one[:3]).any() for one in shown)
    held &= not leaps_missed and not between and against < DOUBTED
    return [
        replace(record, fast=replace(record.fast, setpoints_between=between, setpoints_held=held))
        if record.fast is not None
        else record
        for record in records
    ]


def at_one_rate(followed: Sequence[tuple[Record, ReferenceFollowing]], model: Model) -> LimitedFollowing:
    """How currents follow if the drive limits their rate, under the one limit that fits all runs best.

    followed : each run, and how its current follows without a limit.
    """
    swiftest = max(
        float(np.max(np.abs(np.diff(record.fast.values[REFERENCE])))) / record.fast.interval
        for record, _ in followed
        if record.fast is not None
    )

    def at(log_rows: float) -> list[ReferenceFollowing]:
        rate = swiftest / math.exp(log_rows)
        return [again for record, one in followed if (again := follow(record, model, rate, one.noise)) is not None]

    def squares_missed(log_rows: float) -> float:
        return sum(float(np.sum(one.missed**2)) for one in at(log_rows))

    grid = np.log(RAMPS)
    best = int(np.argmin([squares_missed(one) for one in grid]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    log_rows = float(minimize_scalar(squares_missed, bounds=bounds, options={"xatol": CLOSE}).x)
    return LimitedFollowing(at(log_rows), math.exp(log_rows))


def against_next(shares: Sequence[tuple[float, float]]) -> float:
    """By how many standard deviations the next row's weight in a current, over all runs, is below zero.

    A cubic through four rows has a mean between the middle two with -1/24 of each outer one; two setpoints in an
    interval have a mean with -1/32. A current that is stamped too early gives the next row a weight above zero.

    shares : the weight in each run, with its standard deviation.
    """
    weights = [error**-2 for _, error in shares]
    pulled = sum(share * weight for (share, _), weight in zip(shares, weights, strict=True))
    return -pulled / math.sqrt(sum(weights)) if any(weights) else 0.0


def holds(missed: Array, leaping: Array, steps: Mask) -> bool:
    """Whether every leap that steps at once is met, and there are enough of them; rows as in `ReferenceFollowing`."""
    enough = int(np.sum(steps & (leaping > TELLING))) >= FEWEST
    return enough and not bool(misses(missed, leaping, steps).any())


def misses(missed: Array, leaping: Array, steps: Mask) -> Mask:
    """Rows at which a leap that steps at once is missed by more than noise and what a filter makes of it."""
    lost = (np.abs(missed) > MISSED) & (missed**2 > SHARE * leaping**2)
    return np.asarray(steps & (leaping > TELLING) & lost, np.bool_)


def changes_between(missed: Array, leaping: Array) -> bool:
    """Whether a current misses its reference at the leaps, in squares, by more than noise and rounding explain.

    missed, leaping : of each row, in standard deviations of the noise.
    """
    telling = leaping > TELLING
    beyond = int(np.sum(np.abs(missed[telling]) > MISSED))
    return beyond >= FEWEST and float(np.sum(missed[telling] ** 2)) > SHARE * float(np.sum(leaping[telling] ** 2))


def follow(
    record: Record, model: Model, rate: float = math.inf, noise: float | None = None
) -> ReferenceFollowing | None:
    """How a run's current follows its reference, in a drive that changes it no faster than a rate [A/s].

    noise : standard deviation [A] in which to count; by default that of what is missed. Where it is given, the next
        row's weight is not looked for.

    None without a current, its reference and a loop's bandwidth, with too few rows or no noise, where the file does not
    say what its stamps mean, and where a servo inside the drive moves the reference between rows.
    """
    clock, bandwidth = record.fast, model.bench.current_loop_bandwidth
    if clock is None or not bandwidth or not {CURRENT, REFERENCE} <= clock.values.keys():
        return None
    if {CURRENT, REFERENCE} & clock.unstamped or moved_by_a_servo(clock):
        return None
    reference, current = clock.values[REFERENCE], clock.values[CURRENT]
    asked, most = led(reference, model.bench, clock.interval), rate * clock.interval
    command, begin = rate_limited(asked, most), float(asked[0])
    ends, means = loop(command, bandwidth, clock.interval, begin, ramp_shares(command, most, begin))
    following = means if CURRENT in clock.means else ends
    use = clock.all_valid(CURRENT, REFERENCE) & ~at_ceiling(clock, model)
    use[: TAPS[-1]] = use[TAPS[0] :] = False
    sums = np.column_stack([np.ones_like(following), following, *(neighbour(following, by) for by in TAPS.tolist())])
    if int(use.sum()) < 2 * sums.shape[1]:
        return None
    missed = current - sums @ np.linalg.lstsq(sums[use], current[use], rcond=None)[0]
    foresight = 0.0, math.inf
    if noise is None:
        noise = float(np.median(np.abs(missed[use]))) / 0.6745
        if noise == 0.0:
            return None
        leapt = settling(leaps(reference) > TELLING * noise, 1.0 / (2.0 * math.pi * bandwidth), clock.interval)
        calm = use & ~leapt
        foresight = share_of_next(sums[calm], current[calm])
    return ReferenceFollowing(
        missed[use] / noise, leaps(reference)[use] / noise, steps(reference)[use], foresight, noise
    )


def share_of_next(sums: Array, current: Array) -> tuple[float, float]:
    """Weight of the next row in a current, and its standard deviation; infinite where rows do not tell it.

    sums : the loop's answer to the reference, at each row and at its neighbours (`TAPS`).
    """
    count = sums.shape[1]
    if len(current) < 2 * count:
        return 0.0, math.inf
    weights, _, rank, _ = np.linalg.lstsq(sums, current, rcond=None)
    if rank < count:
        return 0.0, math.inf
    spread = float(np.sqrt(np.mean((current - sums @ weights) ** 2)))
    at = 2 + TAPS.tolist().index(1)
    return float(weights[at]), spread * float(np.linalg.norm(np.linalg.pinv(sums)[at])) or math.inf


def leaps(reference: Array) -> Array:
    """How far a reference bends at each row, zero where that is no more than a wave does that its rows show."""
    change = np.diff(reference)
    near = maximum_filter1d(np.abs(change), 2 * NEAR)[1:]
    bends = np.abs(np.diff(change))
    return np.concatenate([[0.0], np.where(bends > LEAP * near, bends, 0.0), [0.0]])


def steps(reference: Array) -> Mask:
    """Rows at which a reference steps or begins to ramp at once: a setpoint between rows makes two changes of one."""
    change = np.diff(reference, prepend=reference[0])
    bend = np.diff(change, append=change[-1])
    return isolated(change) | isolated(bend)


def isolated(values: Array) -> Mask:
    """Values that dwarf those before and after."""
    size = np.abs(values)
    around = np.maximum(np.roll(size, 1), np.roll(size, -1))
    around[[0, -1]] = math.inf
    return np.asarray(around < STEP * size, np.bool_)


def bend(values: Array) -> Array:
    """By how much the two rows around an interval's ends lie above these, as a curve through all four bends."""
    return neighbour(values, 1) + neighbour(values, -2) - values - neighbour(values, -1)


def unknown_between(reference: Array, noise: float, settles: float, interval: float) -> Mask:
    """Rows whose current depends on when inside its interval a leap came into force, or on how a curve bends there.

    A loop settles afterwards. A curve between rows lacks up to `BENT` of its bend; what is less than the noise is no
    matter.
    """
    changing = (leaps(reference) > TELLING * noise) | (np.abs(bend(reference)) > noise / BENT)
    return settling(changing, settles, interval)


def settling(changing: Mask, settles: float, interval: float) -> Mask:
    """Rows from the one before a change on, until a loop of this time constant [s] has forgotten when it came."""
    rows = 3 + math.ceil(SETTLES * settles / interval)
    return np.asarray(np.convolve(changing, np.ones(rows))[1 : len(changing) + 1] > 0.5, np.bool_)


def setpoint_notes(records: Sequence[Record]) -> tuple[str, ...]:
    """What a log that is slower than its setpoints leaves open; nothing where it keeps up with them."""
    if not any(record.fast is not None and record.fast.setpoints_between for record in records):
        return ()
    return ("setpoints change between the rows of the log: a delay of less than an interval of it cannot be told",)
