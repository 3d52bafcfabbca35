"""Channels whose clock runs off against the others': by an offset, ever further, or in leaps where samples were lost.

A delay or a filter of a machine is as late at the end of a run as at its start, and never early.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import EffectParameter
from leactl.gap.setup.contract import SetUpFault, with_values
from leactl.gap.setup.lateness import Lateness, lateness, width_of
from leactl.gap.setup.side_by_side import Pair, direct_pairs
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Key, Record
from leactl.gap.signals.smoothing import slope, smooth
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
DRIFT, DROPPED = "clock_drift", "dropped_samples"
SEEN = 0.99
FEWEST = 5  # stretches of a run
STEADY = 5.0  # standard errors of a drift or a leap
SAMPLE = (
    1.0  # that a stamp may be off by where nothing promises it; a drift over the run, an offset and a leap are more
)
FOLLOWS = 0.2  # of a drift, that its stretches may scatter about it
MENDS = 0.5  # of what a channel is off by, that goes with its clock put right
ALIKE = 0.5  # of a drift, by which that of another run may differ
QUIET = 2.0  # times its noise, that a channel may be off by
MOST_LEAPS = 4
CAPPED = 9.0  # squares of standard errors, that one stretch may cost: a leap may lie within it
BETTER = 10.0  # squares of standard errors, by which leaps have to fit better than a drift
STRETCHES = 32


@dataclass(frozen=True)
class LatenessCourse:
    """How late a channel of a run is, over time: on a line, or in leaps."""

    start: float  # samples late at the first sample
    drift: float  # samples a sample
    leaps: tuple[tuple[int, float], ...] = ()  # samples at which it leaps, and by how much

    def late(self, count: int) -> Array:
        """Samples late at every sample."""
        at = np.arange(count)
        late = self.start + self.drift * at
        for begin, height in self.leaps:
            late = late + height * (at >= begin)
        return np.asarray(late, np.float64)


def out_of_time(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """The channel whose clock runs off most clearly, if one does."""
    courses: dict[Key, dict[str, LatenessCourse]] = {}
    told: dict[Key, list[tuple[Record, Pair, Lateness]]] = {}
    asked: dict[Key, int] = {}
    for record in records:
        for pair in direct_pairs(record, model):
            assert record.fast is not None
            asked[pair.key] = asked.get(pair.key, 0) + 1
            if in_time(pair):
                continue
            stretches = lateness(pair.reads, pair.expected, record.fast.all_valid(*pair.keys), STRETCHES)
            if len(stretches.late) >= FEWEST:
                told.setdefault(pair.key, []).append((record, pair, stretches))
    for key, group in told.items():
        leaps = {record.name: course for record, pair, one in group if (course := leaping(record, pair, one))}
        # a clock that runs off does so in every run, and shows in most; samples may be lost in one
        runs_off = drifting(group) if 2 * len(leaps) < len(group) and 2 * len(group) >= asked[key] else {}
        if fault := runs_off or leaps:
            courses[key] = fault
    if not courses:
        return None
    key = max(courses, key=lambda key: len(courses[key]))
    return fault_of(key, told[key][0][1].against, courses[key], records)


def in_time(pair: Pair) -> bool:
    """Whether a channel follows by one lag that is not early and leaves nothing but its noise."""
    width = width_of(pair.expected)
    expected = smooth(pair.expected, width)
    columns = np.stack([expected, -slope(expected, 1.0), np.ones(len(expected))], axis=1)
    solved, *_ = np.linalg.lstsq(columns, smooth(pair.reads, width), rcond=1e-10)
    left = pair.reads - solved[0] * pair.expected
    noise = noise_of(left) / np.sqrt(np.sqrt(4.0 * np.pi) * width)
    rest = smooth(pair.reads, width) - columns @ solved
    early = solved[1] < -SAMPLE * abs(solved[0])
    return not early and float(np.std(rest)) < QUIET * noise


def drifting(group: Sequence[tuple[Record, Pair, Lateness]]) -> dict[str, LatenessCourse]:
    """Courses of runs in which a channel drifts alike, or is early; empty where it does neither."""
    lines = {record.name: line(one) for record, _, one in group}
    known = {
        run: course for run, (course, error, scatter, count) in lines.items() if drifts(course, error, scatter, count)
    }
    speeds = [course.drift for course in known.values()]
    agreed = known and float(np.ptp(speeds)) <= ALIKE * float(np.min(np.abs(speeds)))
    rest = [run for run in lines if run not in known]
    contradicted = [
        run
        for run in rest
        if agreed and abs(lines[run][0].drift - np.mean(speeds)) > STEADY * lines[run][1] + 0.3 * abs(np.mean(speeds))
    ]
    if agreed and not contradicted and len(known) >= max(len(lines) // 2, 1):
        courses = {
            record.name: LatenessCourse(lines[record.name][0].start - pair.filtered, lines[record.name][0].drift)
            for record, pair, _ in group
        }
        return courses if mends(group, courses) else {}
    offsets = {record.name: (one.mean(), pair, record) for record, pair, one in group}
    early, late = 0, 0
    for (mean, error), pair, record in offsets.values():
        allowed = SAMPLE * (2.0 if set(pair.keys) & unstamped(record) else 1.0)
        early += mean - pair.filtered + STEADY * error < -allowed
        late += mean - pair.filtered - STEADY * error > -allowed
    if 2 * early > len(offsets) and not late:
        courses = {run: LatenessCourse(mean - pair.filtered, 0.0) for run, ((mean, _), pair, _) in offsets.items()}
        return courses if mends(group, courses, steady=False) else {}
    return {}


def unstamped(record: Record) -> set[Key]:
    """Channels of which a run does not say what a stamp means."""
    return set() if record.fast is None else record.fast.unstamped


def line(one: Lateness) -> tuple[LatenessCourse, float, float, float]:
    """A straight course through stretches, the error of its drift, its scatter, and the samples it spans."""
    columns = np.stack([np.ones(len(one.late)), one.middle], axis=1) / one.error[:, None]
    solved, *_ = np.linalg.lstsq(columns, one.late / one.error, rcond=None)
    left = one.late - solved[0] - solved[1] * one.middle
    inflation = max(float(np.sqrt(np.sum((left / one.error) ** 2) / (len(left) - 2))), 1.0)
    error = float(np.sqrt(np.linalg.inv(columns.T @ columns)[1, 1])) * inflation
    return (
        LatenessCourse(float(solved[0]), float(solved[1])),
        error,
        float(np.median(np.abs(left))),
        float(np.ptp(one.middle)),
    )


def drifts(course: LatenessCourse, error: float, scatter: float, span: float) -> bool:
    """Whether a channel is ever later, or earlier, by more than a sample over its run."""
    total = abs(course.drift) * span
    return total > 2.0 * SAMPLE and abs(course.drift) > STEADY * error and scatter < FOLLOWS * total


def leaping(record: Record, pair: Pair, one: Lateness) -> LatenessCourse | None:
    """The course of a channel that goes early in leaps and stays so; None where it does not."""
    error = np.maximum(one.error, float(np.median(np.abs(np.diff(one.late)))) + 0.05)
    steps = leaps_of(one.late, error)
    if not steps or len(steps) > MOST_LEAPS:
        return None
    straight = line(one)[0]
    bent = float(np.sum(np.minimum(((one.late - straight.start - straight.drift * one.middle) / error) ** 2, CAPPED)))
    levels = np.split(one.late, steps)
    medians = [float(np.median(level)) for level in levels]
    left = sum(
        float(np.sum(np.minimum(((level - middle) / part) ** 2, CAPPED)))
        for level, middle, part in zip(levels, medians, np.split(error, steps), strict=True)
    )
    heights = np.diff(medians)
    if (heights > -2.0 * SAMPLE).any() or bent - left < BETTER or min(len(level) for level in levels[1:]) < 2:
        return None
    # where between two stretches it leaps: the place after which the later course fits better
    places = [int(0.5 * (one.middle[step - 1] + one.middle[step])) for step in steps]
    start = medians[0]
    whole = tuple((place, float(round(height))) for place, height in zip(places, heights.tolist(), strict=True))
    course = LatenessCourse(0.0, 0.0, refined(record, pair, start, whole))
    return course if mends([(record, pair, one)], {record.name: course}) else None


def leaps_of(late: Array, error: Array) -> list[int]:
    """Indices at which levels of a series change, by the fewest levels that explain it."""
    count = len(late)

    def cost(begin: int, end: int) -> float:
        part = late[begin:end]
        return float(np.sum(np.minimum(((part - np.median(part)) / error[begin:end]) ** 2, CAPPED)))

    penalty = 2.0 * BETTER
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


def refined(
    record: Record, pair: Pair, start: float, leaps: tuple[tuple[int, float], ...]
) -> tuple[tuple[int, float], ...]:
    """Leaps at the places where what is left over is least."""
    at, late = [], start
    stamps = np.arange(len(pair.reads), dtype=np.float64)
    reach = len(pair.reads) // STRETCHES
    for place, height in leaps:
        begin, end = max(place - reach, 0), min(place + reach, len(pair.reads))
        before, after = (
            np.interp(stamps[begin:end] - shift, stamps, pair.expected) - pair.reads[begin:end]
            for shift in (late, late + height)
        )
        left = np.concatenate([[0.0], np.cumsum(before**2)]) + np.concatenate(
            [np.cumsum((after**2)[::-1])[::-1], [0.0]]
        )
        at.append((begin + int(np.argmin(left)), height))
        late += height
    return tuple(at)


def mends(
    group: Sequence[tuple[Record, Pair, Lateness]], courses: Mapping[str, LatenessCourse], steady: bool = True
) -> bool:
    """Whether channels go along with their companions once their clock is put right."""
    return float(np.median([gain_of(pair, courses[record.name], steady) for record, pair, _ in group])) >= MENDS


def gain_of(pair: Pair, course: LatenessCourse, steady: bool) -> float:
    """Share of what a channel is off by that goes with its clock put right; beside both a steady lag, if allowed."""
    width = width_of(pair.expected)
    expected = smooth(pair.expected, width)
    beside = [slope(expected, 1.0)] if steady else []
    columns = np.stack([expected, *beside, np.ones(len(expected))], axis=1)

    def left(reads: Array) -> float:
        reads = smooth(reads, width)
        return float(np.sum((reads - columns @ np.linalg.lstsq(columns, reads, rcond=1e-10)[0]) ** 2))

    before, after = left(pair.reads), left(put_right(pair.reads, course))
    return 1.0 - after / before if before > 0.0 else 0.0


def put_right(values: Array, course: LatenessCourse) -> Array:
    """A channel as it was when its stamps say; what lies beyond its ends is held."""
    at = np.arange(len(values), dtype=np.float64)
    return np.asarray(np.interp(at + course.late(len(values)), at, values), np.float64)


def fault_of(key: Key, against: str, courses: Mapping[str, LatenessCourse], records: Sequence[Record]) -> SetUpFault:
    """A channel's clock as a fault, with what it does and how it is put right."""
    intervals = {record.name: record.fast.interval for record in records if record.fast is not None}
    mend = partial(with_clock, key=key, courses=courses)
    within = "" if len(courses) == len(records) else f" in {len(courses)} of {len(records)} runs"
    if any(course.leaps for course in courses.values()):
        lost = {run: -sum(height for _, height in course.leaps) for run, course in courses.items()}
        run, most = max(lost.items(), key=lambda item: item[1])
        first = courses[run].leaps[0][0] * intervals[run]
        evidence = f"goes ahead of {against} by {most:.0f} samples in leaps{within}, in {run} first after {first:.4g} s"
        change = "stamp each sample when it is taken, and log a lost one as NaN: no line of a mapping puts it back"
        return SetUpFault(
            DROPPED, key, SEEN, evidence, change, mend, (EffectParameter("samples_lost", most, 0.5, "1"),)
        )
    drift = float(np.median([course.drift for course in courses.values()]))
    offset = float(np.median([course.start * intervals[run] for run, course in courses.items()]))
    going = f"and {1e6 * drift:.4g} us later every second" if drift else "all the time"
    evidence = f"is {1e3 * offset:.4g} ms late against {against} at the start {going}{within}"
    change = f"give its stream `clock: {{offset_s: {-offset:.6g}}}` in the mapping" + (
        f", and its `step_s` or `rate_Hz` by the factor {1.0 - drift:.8g}" if drift else ""
    )
    parameters = (EffectParameter("offset", offset, 0.0, "s"), EffectParameter("drift", drift, 0.0, "1"))
    return SetUpFault(DRIFT, key, SEEN, evidence, change, mend, parameters)


def with_clock(record: Record, key: Key, courses: Mapping[str, LatenessCourse]) -> Record:
    """A record whose channel is put right in time; what is beyond its ends is left out."""
    clock, course = record.fast, courses.get(record.name)
    if clock is None or course is None or key not in clock.values:
        return record
    late = course.late(len(clock.time))
    at = np.arange(len(late)) + late
    inside = (at >= 0.0) & (at <= len(late) - 1.0)
    shifted = with_values(record, key, put_right(clock.values[key], course))
    assert shifted.fast is not None
    return replace(shifted, fast=replace(shifted.fast, valid=clock.valid | {key: clock.valid[key] & inside}))
