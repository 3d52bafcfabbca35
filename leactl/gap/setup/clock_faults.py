"""Find channels whose clock differs from the others': by an offset, a drift, or leaps where samples were lost.

A delay or a filter of a machine is as late at the end of a run as at its start, and never early.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import EffectParameter
from leactl.gap.setup.contract import SetUpFault, with_values
from leactl.gap.setup.delays import Lateness, lateness, width_of
from leactl.gap.setup.expected_channels import ExpectedChannel, direct_pairs
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Key, Record
from leactl.gap.signals.smoothing import slope, smooth
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
DRIFT, DROPPED = "clock_drift", "dropped_samples"
FAULT_PROBABILITY = 0.99  # probability of a fault of a clock
FEWEST_STRETCHES = 5  # stretches with a measured lateness that a run needs
LEAST_DRIFT_STDS = 5.0  # standard errors of a drift, or of an offset
STAMP_ERROR = 1.0  # samples by which an unspecified stamp may be wrong; a drift, offset or leap of a clock is larger
MOST_SCATTER_SHARE = 0.2  # median distance of stretches from a drift's line, as a share of the total drift
LEAST_CLOCK_SHARE = 0.5  # smallest share of a channel's squared error that a corrected clock removes
MOST_DRIFT_DIFFERENCE = 0.5  # largest difference between the drifts of runs, as a share of a drift
MOST_QUIET_ERROR = 2.0  # error of a channel over its noise, up to which its clock is right
MOST_LEAPS = 4  # leaps in a run
MOST_STRETCH_COST = 9.0  # squared standard errors that one stretch costs at most: a leap may lie within it
LEAST_LEAP_GAIN = 10.0  # squared standard errors by which leaps have to fit better than a drift
STRETCHES = 32  # stretches of a run


@dataclass(frozen=True)
class LatenessCourse:
    """Lateness of a channel over a run: a line, or a constant with leaps."""

    start: float  # lateness at the first sample, in samples
    drift: float  # samples per sample
    leaps: tuple[tuple[int, float], ...] = ()  # sample at which the lateness leaps, and height [samples] of the leap

    def at_samples(self, count: int) -> Array:
        """Return the lateness [samples] at each of the first `count` samples, shape (count,)."""
        samples = np.arange(count)
        shift = self.start + self.drift * samples
        for begin, height in self.leaps:
            shift = shift + height * (samples >= begin)
        return np.asarray(shift, np.float64)


def find_clock_fault(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the clock fault of the channel that shows it in most runs, if any channel does."""
    courses: dict[Key, dict[str, LatenessCourse]] = {}
    suspect_pairs: dict[Key, list[tuple[Record, ExpectedChannel, Lateness]]] = {}
    pair_counts: dict[Key, int] = {}
    for record in records:
        for pair in direct_pairs(record, model):
            assert record.fast is not None
            pair_counts[pair.key] = pair_counts.get(pair.key, 0) + 1
            if is_in_time(pair):
                continue
            stretches = lateness(pair.measured, pair.expected, record.fast.all_valid(*pair.inputs), STRETCHES)
            if len(stretches.late) >= FEWEST_STRETCHES:
                suspect_pairs.setdefault(pair.key, []).append((record, pair, stretches))
    for key, group in suspect_pairs.items():
        leaps_by_run = {
            record.name: course
            for record, pair, stretches_of_pair in group
            if (course := leap_course(record, pair, stretches_of_pair))
        }
        # a wrong clock acts in every run and shows in most runs; samples may be lost in a single run
        drift_by_run = (
            drift_courses(group) if 2 * len(leaps_by_run) < len(group) and 2 * len(group) >= pair_counts[key] else {}
        )
        if course_by_run := drift_by_run or leaps_by_run:
            courses[key] = course_by_run
    if not courses:
        return None
    key = max(courses, key=lambda key: len(courses[key]))
    return fault_of(key, suspect_pairs[key][0][1].reference_label, courses[key], records)


def is_in_time(pair: ExpectedChannel) -> bool:
    """Return whether a channel follows its expected values to within its noise, and is not early by `STAMP_ERROR`."""
    width = width_of(pair.expected)
    expected = smooth(pair.expected, width)
    columns = np.stack([expected, -slope(expected, 1.0), np.ones(len(expected))], axis=1)
    coefficients, *_ = np.linalg.lstsq(columns, smooth(pair.measured, width), rcond=1e-10)
    residual = pair.measured - coefficients[0] * pair.expected
    noise = noise_of(residual) / np.sqrt(np.sqrt(4.0 * np.pi) * width)
    smooth_residual = smooth(pair.measured, width) - columns @ coefficients
    is_early = coefficients[1] < -STAMP_ERROR * abs(coefficients[0])
    return not is_early and float(np.std(smooth_residual)) < MOST_QUIET_ERROR * noise


def drift_courses(group: Sequence[tuple[Record, ExpectedChannel, Lateness]]) -> dict[str, LatenessCourse]:
    """Return a channel's course by run if it drifts alike in the runs, or else is early; empty if it does neither."""
    lines = {record.name: fit_line(stretches) for record, _, stretches in group}
    drifting = {
        run: course for run, (course, error, scatter, span) in lines.items() if drifts(course, error, scatter, span)
    }
    drift_rates = [course.drift for course in drifting.values()]
    is_agreed = drifting and float(np.ptp(drift_rates)) <= MOST_DRIFT_DIFFERENCE * float(np.min(np.abs(drift_rates)))
    other_runs = [run for run in lines if run not in drifting]
    contradicting_runs = [
        run
        for run in other_runs
        if is_agreed
        and abs(lines[run][0].drift - np.mean(drift_rates))
        > LEAST_DRIFT_STDS * lines[run][1] + 0.3 * abs(np.mean(drift_rates))
    ]
    if is_agreed and not contradicting_runs and len(drifting) >= max(len(lines) // 2, 1):
        courses = {
            record.name: LatenessCourse(lines[record.name][0].start - pair.expected_delay, lines[record.name][0].drift)
            for record, pair, _ in group
        }
        return courses if mends(group, courses) else {}
    offsets = {record.name: (stretches.mean(), pair, record) for record, pair, stretches in group}
    early_count, not_early_count = 0, 0
    for (mean, error), pair, record in offsets.values():
        allowed_lead = STAMP_ERROR * (2.0 if set(pair.inputs) & unstamped_channels(record) else 1.0)
        early_count += mean - pair.expected_delay + LEAST_DRIFT_STDS * error < -allowed_lead
        not_early_count += mean - pair.expected_delay - LEAST_DRIFT_STDS * error > -allowed_lead
    if 2 * early_count > len(offsets) and not not_early_count:
        courses = {
            run: LatenessCourse(mean - pair.expected_delay, 0.0) for run, ((mean, _), pair, _) in offsets.items()
        }
        return courses if mends(group, courses, with_lag=False) else {}
    return {}


def unstamped_channels(record: Record) -> set[Key]:
    """Return the channels of a run whose file does not say what a stamp means."""
    return set() if record.fast is None else record.fast.unstamped


def fit_line(stretches: Lateness) -> tuple[LatenessCourse, float, float, float]:
    """Fit a line to the lateness of stretches.

    Returns
    -------
    tuple : the line, the standard error of its drift, the median distance of the stretches from it [samples], and the
        distance between the middles of the first and the last stretch [samples].
    """
    columns = np.stack([np.ones(len(stretches.late)), stretches.middle], axis=1) / stretches.error[:, None]
    coefficients, *_ = np.linalg.lstsq(columns, stretches.late / stretches.error, rcond=None)
    residual = stretches.late - coefficients[0] - coefficients[1] * stretches.middle
    inflation = max(float(np.sqrt(np.sum((residual / stretches.error) ** 2) / (len(residual) - 2))), 1.0)
    drift_error = float(np.sqrt(np.linalg.inv(columns.T @ columns)[1, 1])) * inflation
    return (
        LatenessCourse(float(coefficients[0]), float(coefficients[1])),
        drift_error,
        float(np.median(np.abs(residual))),
        float(np.ptp(stretches.middle)),
    )


def drifts(course: LatenessCourse, error: float, scatter: float, span: float) -> bool:
    """Return whether a channel drifts by more than 2 `STAMP_ERROR` over its run, significantly and along a line."""
    total = abs(course.drift) * span
    return (
        total > 2.0 * STAMP_ERROR
        and abs(course.drift) > LEAST_DRIFT_STDS * error
        and scatter < MOST_SCATTER_SHARE * total
    )


def leap_course(record: Record, pair: ExpectedChannel, stretches: Lateness) -> LatenessCourse | None:
    """Return the course of a channel that becomes earlier in leaps and stays so; None if it does not."""
    error = np.maximum(stretches.error, float(np.median(np.abs(np.diff(stretches.late)))) + 0.05)
    first_indices = leap_indices(stretches.late, error)
    if not first_indices or len(first_indices) > MOST_LEAPS:
        return None
    drift_line = fit_line(stretches)[0]
    drift_misfit = float(
        np.sum(
            np.minimum(
                ((stretches.late - drift_line.start - drift_line.drift * stretches.middle) / error) ** 2,
                MOST_STRETCH_COST,
            )
        )
    )
    segments = np.split(stretches.late, first_indices)
    medians = [float(np.median(segment)) for segment in segments]
    level_misfit = sum(
        float(np.sum(np.minimum(((segment - median) / level_error) ** 2, MOST_STRETCH_COST)))
        for segment, median, level_error in zip(segments, medians, np.split(error, first_indices), strict=True)
    )
    heights = np.diff(medians)
    if (
        (heights > -2.0 * STAMP_ERROR).any()
        or drift_misfit - level_misfit < LEAST_LEAP_GAIN
        or min(len(segment) for segment in segments[1:]) < 2
    ):
        return None
    # a first estimate halfway between the middles of two stretches; `refine_leaps` finds the sample
    samples = [int(0.5 * (stretches.middle[step - 1] + stretches.middle[step])) for step in first_indices]
    start = medians[0]
    leaps = tuple((sample, float(round(height))) for sample, height in zip(samples, heights.tolist(), strict=True))
    course = LatenessCourse(0.0, 0.0, refine_leaps(record, pair, start, leaps))
    return course if mends([(record, pair, stretches)], {record.name: course}) else None


def leap_indices(lateness_by_stretch: Array, error: Array) -> list[int]:
    """Return the indices at which the level of a series changes, by dynamic programming with a penalty per level."""
    count = len(lateness_by_stretch)

    def cost(begin: int, end: int) -> float:
        segment = lateness_by_stretch[begin:end]
        return float(np.sum(np.minimum(((segment - np.median(segment)) / error[begin:end]) ** 2, MOST_STRETCH_COST)))

    penalty = 2.0 * LEAST_LEAP_GAIN
    least_cost, last_begin = [0.0] + [np.inf] * count, [0] * (count + 1)
    for end in range(1, count + 1):
        for begin in range(end):
            total_cost = least_cost[begin] + cost(begin, end) + penalty
            if total_cost < least_cost[end]:
                least_cost[end], last_begin[end] = total_cost, begin
    first_indices, end = [], count
    while end > 0:
        end = last_begin[end]
        if end:
            first_indices.append(end)
    return sorted(first_indices)


def refine_leaps(
    record: Record, pair: ExpectedChannel, start: float, leaps: tuple[tuple[int, float], ...]
) -> tuple[tuple[int, float], ...]:
    """Return the leaps, each moved to the sample with the smallest squared residual.

    start : samples, lateness before the first leap.
    """
    refined_leaps, shift_before = [], start
    samples = np.arange(len(pair.measured), dtype=np.float64)
    reach = len(pair.measured) // STRETCHES
    for sample, height in leaps:
        begin, end = max(sample - reach, 0), min(sample + reach, len(pair.measured))
        residual_before, residual_after = (
            np.interp(samples[begin:end] - shift, samples, pair.expected) - pair.measured[begin:end]
            for shift in (shift_before, shift_before + height)
        )
        squares = np.concatenate([[0.0], np.cumsum(residual_before**2)]) + np.concatenate(
            [np.cumsum((residual_after**2)[::-1])[::-1], [0.0]]
        )
        refined_leaps.append((begin + int(np.argmin(squares)), height))
        shift_before += height
    return tuple(refined_leaps)


def mends(
    group: Sequence[tuple[Record, ExpectedChannel, Lateness]],
    courses: Mapping[str, LatenessCourse],
    with_lag: bool = True,
) -> bool:
    """Return whether corrected clocks remove at least `LEAST_CLOCK_SHARE` of the squared error, in the median run."""
    return (
        float(np.median([mended_share(pair, courses[record.name], with_lag) for record, pair, _ in group]))
        >= LEAST_CLOCK_SHARE
    )


def mended_share(pair: ExpectedChannel, course: LatenessCourse, with_lag: bool) -> float:
    """Return the share of a channel's squared error that a corrected clock removes.

    with_lag : whether a constant lag is fitted as well, to the channel as logged and as corrected.
    """
    width = width_of(pair.expected)
    expected = smooth(pair.expected, width)
    lag_columns = [slope(expected, 1.0)] if with_lag else []
    columns = np.stack([expected, *lag_columns, np.ones(len(expected))], axis=1)

    def residual_squares(values: Array) -> float:
        values = smooth(values, width)
        return float(np.sum((values - columns @ np.linalg.lstsq(columns, values, rcond=1e-10)[0]) ** 2))

    squares_before, squares_after = (
        residual_squares(pair.measured),
        residual_squares(without_lateness(pair.measured, course)),
    )
    return 1.0 - squares_after / squares_before if squares_before > 0.0 else 0.0


def without_lateness(values: Array, course: LatenessCourse) -> Array:
    """Return a channel with its lateness removed; the end values are held beyond its ends."""
    samples = np.arange(len(values), dtype=np.float64)
    return np.asarray(np.interp(samples + course.at_samples(len(values)), samples, values), np.float64)


def fault_of(
    key: Key, reference_label: str, courses: Mapping[str, LatenessCourse], records: Sequence[Record]
) -> SetUpFault:
    """Return the fault of a channel's clock, with its evidence, its parameters and its mend."""
    intervals = {record.name: record.fast.interval for record in records if record.fast is not None}
    mend = partial(with_corrected_clock, key=key, courses=courses)
    runs_text = "" if len(courses) == len(records) else f" in {len(courses)} of {len(records)} runs"
    if any(course.leaps for course in courses.values()):
        lost_samples = {run: -sum(height for _, height in course.leaps) for run, course in courses.items()}
        run, most_lost = max(lost_samples.items(), key=lambda item: item[1])
        first_leap = courses[run].leaps[0][0] * intervals[run]
        evidence = (
            f"goes ahead of {reference_label} by {most_lost:.0f} samples in leaps{runs_text},"
            f" in {run} first after {first_leap:.4g} s"
        )
        change = "stamp each sample when it is taken, and log a lost one as NaN: no line of a mapping puts it back"
        return SetUpFault(
            DROPPED,
            key,
            FAULT_PROBABILITY,
            evidence,
            change,
            mend,
            (EffectParameter("samples_lost", most_lost, 0.5, "1"),),
        )
    drift = float(np.median([course.drift for course in courses.values()]))
    offset = float(np.median([course.start * intervals[run] for run, course in courses.items()]))
    drift_text = f"and {1e6 * drift:.4g} us later every second" if drift else "all the time"
    evidence = f"is {1e3 * offset:.4g} ms late against {reference_label} at the start {drift_text}{runs_text}"
    change = f"give its stream `clock: {{offset_s: {-offset:.6g}}}` in the mapping" + (
        f", and its `step_s` or `rate_Hz` by the factor {1.0 - drift:.8g}" if drift else ""
    )
    parameters = (EffectParameter("offset", offset, 0.0, "s"), EffectParameter("drift", drift, 0.0, "1"))
    return SetUpFault(DRIFT, key, FAULT_PROBABILITY, evidence, change, mend, parameters)


def with_corrected_clock(record: Record, key: Key, courses: Mapping[str, LatenessCourse]) -> Record:
    """Return a record with the lateness of a channel removed; samples beyond its ends become invalid."""
    clock, course = record.fast, courses.get(record.name)
    if clock is None or course is None or key not in clock.values:
        return record
    shift = course.at_samples(len(clock.time))
    stamps = np.arange(len(shift)) + shift
    inside = (stamps >= 0.0) & (stamps <= len(shift) - 1.0)
    shifted = with_values(record, key, without_lateness(clock.values[key], course))
    assert shifted.fast is not None
    return replace(shifted, fast=replace(shifted.fast, valid=clock.valid | {key: clock.valid[key] & inside}))
