"""Detect setpoints that change between the rows of a log, as they do where the log is slower than their source.

If each row keeps its setpoint over its interval, as `sampling` promises, the rows contain all that the drive follows: a
linear drive's current is then one weighted sum of the neighbouring rows of the reference. If setpoints change inside
their intervals, that sum fails where the reference leaps. It also fails there if a drive limits the rate of its
current, but holds again with the right limit, one for the whole log. No drive knows the setpoint of the next row: a
weight of that row in the sum replaces setpoints between the rows.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d
from scipy.optimize import minimize_scalar

from leactl.effects.hysteresis_and_lags import ramp_shares, rate_limited
from leactl.gap.signals.derived import loop_response, moved_by_a_servo, with_setpoint_lead
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Clocked, Record
from leactl.gap.signals.stamps import TAPS, neighbour
from leactl.gap.signals.voltage_ceiling import at_ceiling
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
CURRENT, REFERENCE = ("q_axis_current", "test"), ("q_axis_current_reference", "test")
LEAP_RATIO = 0.7  # bend of a leap over the largest change nearby
LEAP_WINDOW = 3  # rows on either side of a bend that count as nearby
MOST_NEIGHBOUR_CHANGE = 0.05  # largest change of a reference in the rows next to a step, as a share of the step
LEAST_LEAP_STDS = 20.0  # size of a leap that counts, in standard deviations of the current's usual residual
LEAST_MISS_STDS = 5.0  # residual of a row that a current misses, in the same standard deviations
# standard deviations by which the next row's weight in a current is below zero if setpoints change between rows
LEAST_NEXT_ROW_STDS = 5.0
FEWEST_MISSES = 3  # missed rows that show a change between rows
FEWEST_FOLLOWED_STEPS = 3  # steps of a reference that a current follows if rows hold their setpoints
LEAST_DOUBT_STDS = 4.0  # standard deviations of the next row's weight below zero that leave it open whether rows hold
# share of the leaps' squares that a current misses if setpoints change between rows: a log of every second or fourth
# setpoint misses 0.01 to 0.1, one with all setpoints 1e-5
LEAST_MISSED_SHARE = 2e-3
BEND_SHARE = 1.0 / 24.0  # share of a bend over four rows by which the mean between the middle two differs from a line
SETTLING_TIME_CONSTANTS = 8.0  # time constants of a current loop after which a leap has no influence
RAMP_ROWS = 2.0 ** np.arange(-2.0, 8.5, 0.5)  # rows that the largest change takes at the rate limits that are tried
SHORT_RAMP_ROWS = 2.0  # rows of the longest ramp whose first row still shows when the ramp began
RATE_TOLERANCE = 0.002  # relative tolerance of the search for the best rate


class ReferenceFollowing(NamedTuple):
    """How the current of one run follows its reference."""

    residuals: Array  # of the best sum of neighbouring rows, in units of `noise`
    leap_sizes: Array  # of the reference at each row, in units of `noise`
    is_step: Mask  # whether the reference steps within one row
    next_row_weight: tuple[float, float]  # weight of the next row, away from leaps, and its standard deviation
    noise: float  # A, robust standard deviation of the residual


class LimitedFollowing(NamedTuple):
    """How the currents of a log follow at the common rate limit that fits them best."""

    followings: list[ReferenceFollowing]
    ramp: float  # rows that the largest change of a reference takes


def mark_setpoints(records: Sequence[Record], model: Model) -> list[Record]:
    """Mark all runs of a log by whether its setpoints change between rows, or hold over a row.

    One run that shows a change marks all runs.
    """
    followed = [(record, following) for record in records if (following := follow(record, model)) is not None]
    followings = [following for _, following in followed]
    leaping_runs = [
        (record, following) for record, following in followed if (following.leap_sizes > LEAST_LEAP_STDS).any()
    ]
    leaps_missed = any(changes_between(following.residuals, following.leap_sizes) for following in followings)
    next_row_evidence = stds_against_next_row([following.next_row_weight for following in followings])
    changing = next_row_evidence > LEAST_NEXT_ROW_STDS
    if not changing and (
        leaps_missed or sum(int(misses(*following[:3]).sum()) for following in followings) >= FEWEST_MISSES
    ):
        # a rate limit explains misses as well; a long ramp cannot show whether rows hold
        limited = follow_at_common_rate(leaping_runs, model)
        changing = leaps_missed and any(
            changes_between(following.residuals, following.leap_sizes) for following in limited.followings
        )
        if limited.ramp <= SHORT_RAMP_ROWS:
            followings, leaps_missed = limited.followings, changing
    holding = any(holds(*following[:3]) for following in followings) and not any(
        misses(*following[:3]).any() for following in followings
    )
    holding &= not leaps_missed and not changing and next_row_evidence < LEAST_DOUBT_STDS
    return [
        replace(record, fast=replace(record.fast, setpoints_between=changing, setpoints_held=holding))
        if record.fast is not None
        else record
        for record in records
    ]


def follow_at_common_rate(followed: Sequence[tuple[Record, ReferenceFollowing]], model: Model) -> LimitedFollowing:
    """Return how the currents follow under the common rate limit that fits all runs best.

    followed : each run, and how its current follows without a limit.
    """
    fastest_rate = max(
        float(np.max(np.abs(np.diff(record.fast.values[REFERENCE])))) / record.fast.interval
        for record, _ in followed
        if record.fast is not None
    )

    def followings_at(log_rows: float) -> list[ReferenceFollowing]:
        rate = fastest_rate / math.exp(log_rows)
        return [
            limited
            for record, following in followed
            if (limited := follow(record, model, rate, following.noise)) is not None
        ]

    def residual_squares(log_rows: float) -> float:
        return sum(float(np.sum(following.residuals**2)) for following in followings_at(log_rows))

    grid = np.log(RAMP_ROWS)
    best = int(np.argmin([residual_squares(log_rows) for log_rows in grid]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    log_rows = float(minimize_scalar(residual_squares, bounds=bounds, options={"xatol": RATE_TOLERANCE}).x)
    return LimitedFollowing(followings_at(log_rows), math.exp(log_rows))


def stds_against_next_row(weights_and_stds: Sequence[tuple[float, float]]) -> float:
    """Return how many standard deviations the next row's weight in the current, over all runs, is below zero.

    A cubic through four rows has a mean between the middle two with -1/24 of each outer one; two setpoints in an
    interval have a mean with -1/32. A current that is stamped too early gives the next row a weight above zero.

    weights_and_stds : weight of the next row in each run, and its standard deviation.
    """
    precisions = [std**-2 for _, std in weights_and_stds]
    weighted_sum = sum(weight * precision for (weight, _), precision in zip(weights_and_stds, precisions, strict=True))
    return -weighted_sum / math.sqrt(sum(precisions)) if any(precisions) else 0.0


def holds(residuals: Array, leap_sizes: Array, is_step: Mask) -> bool:
    """Return whether the current follows every step of the reference, of at least `FEWEST_FOLLOWED_STEPS` steps."""
    has_enough_steps = int(np.sum(is_step & (leap_sizes > LEAST_LEAP_STDS))) >= FEWEST_FOLLOWED_STEPS
    return has_enough_steps and not bool(misses(residuals, leap_sizes, is_step).any())


def misses(residuals: Array, leap_sizes: Array, is_step: Mask) -> Mask:
    """Return the steps of the reference that the current misses by more than noise and a filter explain."""
    is_missed = (np.abs(residuals) > LEAST_MISS_STDS) & (residuals**2 > LEAST_MISSED_SHARE * leap_sizes**2)
    return np.asarray(is_step & (leap_sizes > LEAST_LEAP_STDS) & is_missed, np.bool_)


def changes_between(residuals: Array, leap_sizes: Array) -> bool:
    """Return whether a current misses its reference at the leaps by more squares than noise and rounding explain.

    residuals, leap_sizes : by row, in standard deviations of the noise.
    """
    is_leap = leap_sizes > LEAST_LEAP_STDS
    missed_count = int(np.sum(np.abs(residuals[is_leap]) > LEAST_MISS_STDS))
    return missed_count >= FEWEST_MISSES and float(np.sum(residuals[is_leap] ** 2)) > LEAST_MISSED_SHARE * float(
        np.sum(leap_sizes[is_leap] ** 2)
    )


def follow(
    record: Record, model: Model, rate: float = math.inf, noise: float | None = None
) -> ReferenceFollowing | None:
    """Return how a run's current follows its reference in a drive with a rate limit [A/s].

    noise : A, unit of the residuals; by default their robust standard deviation. Where it is given, the weight of the
        next row is not fitted.

    None is returned if the run has no current or no reference, too few rows or no noise; if the model has no bandwidth
    of the loop; if the file does not say what its stamps mean; and if a servo inside the drive moves the reference
    between rows.
    """
    clock, bandwidth = record.fast, model.bench.current_loop_bandwidth
    if clock is None or not bandwidth or not {CURRENT, REFERENCE} <= clock.values.keys():
        return None
    if {CURRENT, REFERENCE} & clock.unstamped or moved_by_a_servo(clock):
        return None
    reference, current = clock.values[REFERENCE], clock.values[CURRENT]
    led_reference, largest_change = with_setpoint_lead(reference, model.bench, clock.interval), rate * clock.interval
    command, begin = rate_limited(led_reference, largest_change), float(led_reference[0])
    ends, means = loop_response(command, bandwidth, clock.interval, begin, ramp_shares(command, largest_change, begin))
    following = means if CURRENT in clock.means else ends
    is_used = clock.all_valid(CURRENT, REFERENCE) & ~at_ceiling(clock, model)
    is_used[: TAPS[-1]] = is_used[TAPS[0] :] = False
    design = np.column_stack(
        [np.ones_like(following), following, *(neighbour(following, shift) for shift in TAPS.tolist())]
    )
    if int(is_used.sum()) < 2 * design.shape[1]:
        return None
    residuals = current - design @ np.linalg.lstsq(design[is_used], current[is_used], rcond=None)[0]
    next_row_weight = 0.0, math.inf
    if noise is None:
        noise = float(np.median(np.abs(residuals[is_used]))) / 0.6745
        if noise == 0.0:
            return None
        is_near_leap = settling_rows(
            leaps(reference) > LEAST_LEAP_STDS * noise, 1.0 / (2.0 * math.pi * bandwidth), clock.interval
        )
        is_calm = is_used & ~is_near_leap
        next_row_weight = weight_of_next_row(design[is_calm], current[is_calm])
    return ReferenceFollowing(
        residuals[is_used] / noise, leaps(reference)[is_used] / noise, steps(reference)[is_used], next_row_weight, noise
    )


def weight_of_next_row(design: Array, current: Array) -> tuple[float, float]:
    """Return the weight of the next row in a current, and its standard deviation; infinite if it is not determined.

    design : one, the loop's response to the reference at each row, and at its neighbours (`TAPS`), as columns.
    """
    count = design.shape[1]
    if len(current) < 2 * count:
        return 0.0, math.inf
    weights, _, rank, _ = np.linalg.lstsq(design, current, rcond=None)
    if rank < count:
        return 0.0, math.inf
    residual_rms = float(np.sqrt(np.mean((current - design @ weights) ** 2)))
    next_row = 2 + TAPS.tolist().index(1)
    return float(weights[next_row]), residual_rms * float(np.linalg.norm(np.linalg.pinv(design)[next_row])) or math.inf


def leaps(reference: Array) -> Array:
    """Return the bend of a reference at each row, zero where a smooth wave would bend as much."""
    change = np.diff(reference)
    largest_near = maximum_filter1d(np.abs(change), 2 * LEAP_WINDOW)[1:]
    bends = np.abs(np.diff(change))
    return np.concatenate([[0.0], np.where(bends > LEAP_RATIO * largest_near, bends, 0.0), [0.0]])


def steps(reference: Array) -> Mask:
    """Return the rows at which a reference steps, or begins to ramp, within one row.

    A setpoint that changes between two rows spreads a step over two changes.
    """
    change = np.diff(reference, prepend=reference[0])
    bend = np.diff(change, append=change[-1])
    return isolated_values(change) | isolated_values(bend)


def isolated_values(values: Array) -> Mask:
    """Return the mask of values larger than both neighbours by a factor of more than 1 / `MOST_NEIGHBOUR_CHANGE`."""
    sizes = np.abs(values)
    largest_neighbour = np.maximum(np.roll(sizes, 1), np.roll(sizes, -1))
    largest_neighbour[[0, -1]] = math.inf
    return np.asarray(largest_neighbour < MOST_NEIGHBOUR_CHANGE * sizes, np.bool_)


def bend(values: Array) -> Array:
    """Return, for the interval before each row, the outer two of the four rows around it less the inner two."""
    return neighbour(values, 1) + neighbour(values, -2) - values - neighbour(values, -1)


def unknown_setpoints(clock: Clocked, model: Model) -> Mask:
    """Return the samples of a log with setpoints between its rows whose current an unrecorded setpoint may have moved.

    Elsewhere, and where a servo inside the drive moves the reference, there is none.
    """
    bandwidth = model.bench.current_loop_bandwidth
    if not clock.setpoints_between or not bandwidth or not {CURRENT, REFERENCE} <= clock.values.keys():
        return np.zeros(len(clock.time), bool)
    if moved_by_a_servo(clock):
        return np.zeros(len(clock.time), bool)
    time_constant = 1.0 / (2.0 * math.pi * bandwidth)
    return rows_with_unknown_setpoints(
        clock.values[REFERENCE], noise_of(clock.values[CURRENT]), time_constant, clock.interval
    )


def rows_with_unknown_setpoints(reference: Array, noise: float, time_constant: float, interval: float) -> Mask:
    """Return the rows whose current depends on the course of the setpoint inside an interval: at leaps and bends.

    The rows while the loop settles are included. A curve between rows differs from a line by up to `BEND_SHARE` of its
    bend; bends below the noise do not count.
    """
    changing = (leaps(reference) > LEAST_LEAP_STDS * noise) | (np.abs(bend(reference)) > noise / BEND_SHARE)
    return settling_rows(changing, time_constant, interval)


def settling_rows(changing: Mask, time_constant: float, interval: float) -> Mask:
    """Return the rows from one before each change until a loop with time constant `settles` [s] has settled."""
    rows = 3 + math.ceil(SETTLING_TIME_CONSTANTS * time_constant / interval)
    return np.asarray(np.convolve(changing, np.ones(rows))[1 : len(changing) + 1] > 0.5, np.bool_)


def setpoint_notes(records: Sequence[Record]) -> tuple[str, ...]:
    """Return a note if setpoints change between the rows of the log, else nothing."""
    if not any(record.fast is not None and record.fast.setpoints_between for record in records):
        return ()
    return ("setpoints change between the rows of the log: a delay of less than an interval of it cannot be told",)
