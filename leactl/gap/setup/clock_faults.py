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
FEWEST_STRETCHES = 5  # stretches of a run that show a lateness
LEAST_DRIFT_STDS = 5.0  # standard errors of a drift, or of an offset
STAMP_ERROR = 1.0  # samples by which an unspecified stamp may be wrong; drifts, offsets and leaps exceed it
MOST_SCATTER_SHARE = 0.2  # scatter of stretches about a drift, as a share of its total
LEAST_CLOCK_SHARE = 0.5  # smallest share of a channel's squared error that a corrected clock removes
MOST_DRIFT_DIFFERENCE = 0.5  # largest difference between the drifts of runs, as a share of a drift
MOST_QUIET_ERROR = 2.0  # error of a channel over its noise, up to which its clock is right
MOST_LEAPS = 4  # leaps in a run
MOST_STRETCH_COST = 9.0  # squared standard errors that one stretch costs at most: a leap may lie within it
LEAST_LEAP_GAIN = 10.0  # squared standard errors by which leaps have to fit better than a drift
STRETCHES = 32  # stretches of a run


@dataclass(frozen=True)
class LatenessCourse:
    """Lateness of a channel over a run: a line, or leaps."""

    start: float  # lateness at the first sample, in samples
    drift: float  # samples per sample
    leaps: tuple[tuple[int, float], ...] = ()  # samples at which it leaps, and by how much

    def late(self, count: int) -> Array:
        """Return the lateness [samples] at every sample."""
        samples = np.arange(count)
        late = self.start + self.drift * samples
        for begin, height in self.leaps:
            late = late + height * (samples >= begin)
        return np.asarray(late, np.float64)


def find_clock_fault(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the clock fault of the channel that shows it in most runs, if any channel does."""
    courses: dict[Key, dict[str, LatenessCourse]] = {}
    drifting_pairs: dict[Key, list[tuple[Record, ExpectedChannel, Lateness]]] = {}
    pair_counts: dict[Key, int] = {}
    for record in records:
        for pair in direct_pairs(record, model):
            assert record.fast is not None
            pair_counts[pair.key] = pair_counts.get(pair.key, 0) + 1
            if is_in_time(pair):
                continue
            stretches = lateness(pair.measured, pair.expected, record.fast.all_valid(*pair.inputs), STRETCHES)
            if len(stretches.late) >= FEWEST_STRETCHES:
                drifting_pairs.setdefault(pair.key, []).append((record, pair, stretches))
    for key, group in drifting_pairs.items():
        leaps = {
            record.name: course
            for record, pair, stretches_of_pair in group
            if (course := leap_course(record, pair, stretches_of_pair))
        }
        # a wrong clock acts in every run and shows in most runs; samples may be lost in a single run
        runs_off = drift_courses(group) if 2 * len(leaps) < len(group) and 2 * len(group) >= pair_counts[key] else {}
        if fault := runs_off or leaps:
            courses[key] = fault
    if not courses:
        return None
    key = max(courses, key=lambda key: len(courses[key]))
    return fault_of(key, drifting_pairs[key][0][1].reference_label, courses[key], records)


def is_in_time(pair: ExpectedChannel) -> bool:
    """Return whether a channel follows its companion with one lag that is not negative, and to within its noise."""
    width = width_of(pair.expected)
    expected = smooth(pair.expected, width)
    columns = np.stack([expected, -slope(expected, 1.0), np.ones(len(expected))], axis=1)
    solved, *_ = np.linalg.lstsq(columns, smooth(pair.measured, width), rcond=1e-10)
    residual = pair.measured - solved[0] * pair.expected
    noise = noise_of(residual) / np.sqrt(np.sqrt(4.0 * np.pi) * width)
    smooth_residual = smooth(pair.measured, width) - columns @ solved
    early = solved[1] < -STAMP_ERROR * abs(solved[0])
    return not early and float(np.std(smooth_residual)) < MOST_QUIET_ERROR * noise


def drift_courses(group: Sequence[tuple[Record, ExpectedChannel, Lateness]]) -> dict[str, LatenessCourse]:
    """Return the courses of runs in which a channel drifts alike, or is early; empty where it does neither."""
    lines = {record.name: fit_line(stretches) for record, _, stretches in group}
    known = {
        run: course for run, (course, error, scatter, count) in lines.items() if drifts(course, error, scatter, count)
    }
    speeds = [course.drift for course in known.values()]
    agreed = known and float(np.ptp(speeds)) <= MOST_DRIFT_DIFFERENCE * float(np.min(np.abs(speeds)))
    unsteady_runs = [run for run in lines if run not in known]
    contradicted = [
        run
        for run in unsteady_runs
        if agreed
        and abs(lines[run][0].drift - np.mean(speeds)) > LEAST_DRIFT_STDS * lines[run][1] + 0.3 * abs(np.mean(speeds))
    ]
    if agreed and not contradicted and len(known) >= max(len(lines) // 2, 1):
        courses = {
            record.name: LatenessCourse(lines[record.name][0].start - pair.expected_delay, lines[record.name][0].drift)
            for record, pair, _ in group
        }
        return courses if mends(group, courses) else {}
    offsets = {record.name: (stretches.mean(), pair, record) for record, pair, stretches in group}
    early, late = 0, 0
    for (mean, error), pair, record in offsets.values():
        allowed = STAMP_ERROR * (2.0 if set(pair.inputs) & unstamped_channels(record) else 1.0)
        early += mean - pair.expected_delay + LEAST_DRIFT_STDS * error < -allowed
        late += mean - pair.expected_delay - LEAST_DRIFT_STDS * error > -allowed
    if 2 * early > len(offsets) and not late:
        courses = {
            run: LatenessCourse(mean - pair.expected_delay, 0.0) for run, ((mean, _), pair, _) in offsets.items()
        }
        return courses if mends(group, courses, steady=False) else {}
    return {}


def unstamped_channels(record: Record) -> set[Key]:
    """Return the channels of a run whose file does not say what a stamp means."""
    return set() if record.fast is None else record.fast.unstamped


def fit_line(stretches: Lateness) -> tuple[LatenessCourse, float, float, float]:
    """Fit a line to the lateness of stretches; return it, the error of its drift, its scatter and its span."""
    columns = np.stack([np.ones(len(stretches.late)), stretches.middle], axis=1) / stretches.error[:, None]
    solved, *_ = np.linalg.lstsq(columns, stretches.late / stretches.error, rcond=None)
    residual = stretches.late - solved[0] - solved[1] * stretches.middle
    inflation = max(float(np.sqrt(np.sum((residual / stretches.error) ** 2) / (len(residual) - 2))), 1.0)
    error = float(np.sqrt(np.linalg.inv(columns.T @ columns)[1, 1])) * inflation
    return (
        LatenessCourse(float(solved[0]), float(solved[1])),
        error,
        float(np.median(np.abs(residual))),
        float(np.ptp(stretches.middle)),
    )


def drifts(course: LatenessCourse, error: float, scatter: float, span: float) -> bool:
    """Return whether a channel drifts by more than two samples over its run, significantly and along a line."""
    total = abs(course.drift) * span
    return (
        total > 2.0 * STAMP_ERROR
        and abs(course.drift) > LEAST_DRIFT_STDS * error
        and scatter < MOST_SCATTER_SHARE * total
    )


def leap_course(record: Record, pair: ExpectedChannel, stretches: Lateness) -> LatenessCourse | None:
    """Return the course of a channel that becomes earlier in leaps and stays so; None where it does not."""
    error = np.maximum(stretches.error, float(np.median(np.abs(np.diff(stretches.late)))) + 0.05)
    steps = leap_indices(stretches.late, error)
    if not steps or len(steps) > MOST_LEAPS:
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
    levels = np.split(stretches.late, steps)
    medians = [float(np.median(level)) for level in levels]
    level_misfit = sum(
        float(np.sum(np.minimum(((level - middle) / part) ** 2, MOST_STRETCH_COST)))
        for level, middle, part in zip(levels, medians, np.split(error, steps), strict=True)
    )
    heights = np.diff(medians)
    if (
        (heights > -2.0 * STAMP_ERROR).any()
        or drift_misfit - level_misfit < LEAST_LEAP_GAIN
        or min(len(level) for level in levels[1:]) < 2
    ):
        return None
    # a leap lies between two stretches: at the sample after which the later level fits better
    samples = [int(0.5 * (stretches.middle[step - 1] + stretches.middle[step])) for step in steps]
    start = medians[0]
    leaps = tuple((sample, float(round(height))) for sample, height in zip(samples, heights.tolist(), strict=True))
    course = LatenessCourse(0.0, 0.0, refine_leaps(record, pair, start, leaps))
    return course if mends([(record, pair, stretches)], {record.name: course}) else None


def leap_indices(late: Array, error: Array) -> list[int]:
    """Return the indices at which the level of a series changes, by dynamic programming with a penalty per level."""
    count = len(late)

    def cost(begin: int, end: int) -> float:
        part = late[begin:end]
        return float(np.sum(np.minimum(((part - np.median(part)) / error[begin:end]) ** 2, MOST_STRETCH_COST)))

    penalty = 2.0 * LEAST_LEAP_GAIN
    best, cut = [0.0] + [np.inf] * count, [0] * (count + 1)
    for end in range(1, count + 1):
        for begin in range(end):
            value = best[begin] + cost(begin, end) + penalty
            if value < best[end]:
                best[end], cut[end] = value, begin
    steps, end = [], count
    while end > 0:
        end = cut[end]
        if end:
            steps.append(end)
    return sorted(steps)


def refine_leaps(
    record: Record, pair: ExpectedChannel, start: float, leaps: tuple[tuple[int, float], ...]
) -> tuple[tuple[int, float], ...]:
    """Move each leap to the sample with the smallest squared residual."""
    refined_leaps, late = [], start
    stamps = np.arange(len(pair.measured), dtype=np.float64)
    reach = len(pair.measured) // STRETCHES
    for sample, height in leaps:
        begin, end = max(sample - reach, 0), min(sample + reach, len(pair.measured))
        residual_before, residual_after = (
            np.interp(stamps[begin:end] - shift, stamps, pair.expected) - pair.measured[begin:end]
            for shift in (late, late + height)
        )
        squares = np.concatenate([[0.0], np.cumsum(residual_before**2)]) + np.concatenate(
            [np.cumsum((residual_after**2)[::-1])[::-1], [0.0]]
        )
        refined_leaps.append((begin + int(np.argmin(squares)), height))
        late += height
    return tuple(refined_leaps)


def mends(
    group: Sequence[tuple[Record, ExpectedChannel, Lateness]],
    courses: Mapping[str, LatenessCourse],
    steady: bool = True,
) -> bool:
    """Return whether the median gain of the runs with corrected clocks is at least `LEAST_CLOCK_SHARE`."""
    return (
        float(np.median([mended_share(pair, courses[record.name], steady) for record, pair, _ in group]))
        >= LEAST_CLOCK_SHARE
    )


def mended_share(pair: ExpectedChannel, course: LatenessCourse, steady: bool) -> float:
    """Return the share of a channel's squared error that a corrected clock removes.

    steady : whether a constant lag is fitted in addition, before and after.
    """
    width = width_of(pair.expected)
    expected = smooth(pair.expected, width)
    lag_columns = [slope(expected, 1.0)] if steady else []
    columns = np.stack([expected, *lag_columns, np.ones(len(expected))], axis=1)

    def residual_squares(reads: Array) -> float:
        reads = smooth(reads, width)
        return float(np.sum((reads - columns @ np.linalg.lstsq(columns, reads, rcond=1e-10)[0]) ** 2))

    squares_before, squares_after = (
        residual_squares(pair.measured),
        residual_squares(without_lateness(pair.measured, course)),
    )
    return 1.0 - squares_after / squares_before if squares_before > 0.0 else 0.0


def without_lateness(values: Array, course: LatenessCourse) -> Array:
    """Return a channel with its lateness removed; the end values are held beyond its ends."""
    samples = np.arange(len(values), dtype=np.float64)
    return np.asarray(np.interp(samples + course.late(len(values)), samples, values), np.float64)


def fault_of(key: Key, against: str, courses: Mapping[str, LatenessCourse], records: Sequence[Record]) -> SetUpFault:
    """Return the fault of a channel's clock, with its evidence, its parameters and its mend."""
    intervals = {record.name: record.fast.interval for record in records if record.fast is not None}
    mend = partial(with_corrected_clock, key=key, courses=courses)
    within = "" if len(courses) == len(records) else f" in {len(courses)} of {len(records)} runs"
    if any(course.leaps for course in courses.values()):
        lost = {run: -sum(height for _, height in course.leaps) for run, course in courses.items()}
        run, most = max(lost.items(), key=lambda item: item[1])
        first_leap = courses[run].leaps[0][0] * intervals[run]
        evidence = (
            f"goes ahead of {against} by {most:.0f} samples in leaps{within}, in {run} first after {first_leap:.4g} s"
        )
        change = "stamp each sample when it is taken, and log a lost one as NaN: no line of a mapping puts it back"
        return SetUpFault(
            DROPPED, key, FAULT_PROBABILITY, evidence, change, mend, (EffectParameter("samples_lost", most, 0.5, "1"),)
        )
    drift = float(np.median([course.drift for course in courses.values()]))
    offset = float(np.median([course.start * intervals[run] for run, course in courses.items()]))
    going = f"and {1e6 * drift:.4g} us later every second" if drift else "all the time"
    evidence = f"is {1e3 * offset:.4g} ms late against {against} at the start {going}{within}"
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
    late = course.late(len(clock.time))
    stamps = np.arange(len(late)) + late
    inside = (stamps >= 0.0) & (stamps <= len(late) - 1.0)
    shifted = with_values(record, key, without_lateness(clock.values[key], course))
    assert shifted.fast is not None
    return replace(shifted, fast=replace(shifted.fast, valid=clock.valid | {key: clock.valid[key] & inside}))
