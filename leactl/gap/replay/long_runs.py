"""Read long runs in stretches at their full rate, so that memory does not grow with the length of a run.

All runs of a case share `MOST_ROWS` rows. A run longer than its share is read in `MOST_STRETCHES` stretches, one in
each sixteenth of it: the first, the last, and between them those whose level and swing differ most from the others'.
Temperatures depend on the whole history: they are read from end to end as means over many samples, with the mean
squares of current and speed over every sample in between.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.gap.replay.time_steps import steps_in_sample
from leactl.gap.signals.record import (
    FEWEST_SAMPLES,
    MOST_DURATION_RATIO,
    Clocked,
    Record,
    bridging_interval,
    is_slow,
    record_of,
)
from leactl.gap.signals.scales import TOP_QUANTILE, absolute_speeds
from leactl.gap.signals.smoothing import smooth
from leactl.model.nominal import BenchModel
from leactl.quantities import ChannelSpec
from leactl.runfile.layout import BLOCK_ROWS
from leactl.runfile.read.reader import Channel, Run
from leactl.runfile.verify.integrity import refuse_altered

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
MOST_ROWS = 3 << 17  # largest number of rows of all runs of a case together
MOST_SLOW_ROWS = 1 << 14  # largest number of rows of a run's temperatures, which change slowly
MOST_STRETCHES = 16  # largest number of stretches of a run
FEWEST_STRETCH_ROWS = 1 << 9  # rows of a stretch; a small share gives fewer stretches
MOST_CANDIDATES = 1 << 10  # largest number of candidate stretches of a run to choose among
STEPS_PER_ROW = 8  # steps of a replay in a sample above which the sample counts for more than a row
MOST_UNBROKEN_RATIO = 2.0  # duration of a stretch over the median duration, above which the stretch holds a pause
TEMPERATURE_MARGIN = 64  # samples of temperature on either side of a stretch, for smoothing
# channels that show the current, or else the speed, of a stretch; the first that a run has counts
CURRENT_CHANNELS = ("q_axis_current", "q_axis_current_reference", "torque_reference", "torque", "q_axis_voltage")
SPEED_CHANNELS = ("velocity", "angle", "velocity_reference", "angle_reference")


def read_records(paths: Sequence[Path], bench: BenchModel) -> dict[Path, list[Record]]:
    """Return the records of each run of a case: one, or several stretches where the run costs more than its share.

    Raises
    ------
    InputError : a file is no run file, is not as it was closed, or has channels that cannot be used; one line each.
    """
    faults: list[str] = []
    costs: dict[Path, float] = {}
    by_path: dict[Path, list[Record]] = {}
    for path in paths:
        try:
            refuse_altered([path])
            with Run.open(path) as run:
                costs[path] = cost_of(run, bench)
        except InputError as error:
            faults += error.faults
    share = fair_share(list(costs.values()), MOST_ROWS)
    for path, cost in costs.items():
        try:
            with Run.open(path) as run:
                by_path[path] = (
                    [record_of(run, whole_channels(run))] if cost <= share else records_of(run, share, bench)
                )
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    return by_path


def fair_share(costs: Sequence[float], total: float) -> float:
    """Return the largest cost per run with which all runs together stay within `total`; infinite if no run need be cut.

    Runs that cost less leave more for the others.
    """
    remaining = total
    for assigned_count, cost in enumerate(sorted(costs)):
        share = remaining / (len(costs) - assigned_count)
        if cost > share:
            return share
        remaining -= cost
    return math.inf


def cost_of(run: Run, bench: BenchModel) -> float:
    """Return the rows of a run on the clock of its drive, where a row with many steps of a replay counts as several.

    Infinite for a run whose clock has too many gaps, which is read in stretches.
    """
    name = leading_stream(run)
    if name is None or run.rows[name] < 2:
        return 0.0
    rows = run.rows[name]
    stamps = run.values(name, "time", 0, min(rows, MOST_ROWS + 1))
    interval = bridging_interval(stamps)
    clock_rows = float(stamps[-1] - stamps[0]) / interval if rows <= MOST_ROWS else rows  # gaps are bridged by rows
    return (
        math.inf
        if clock_rows > MOST_DURATION_RATIO * rows
        else max(clock_rows, rows) * rows_per_sample(interval, bench)
    )


def rows_per_sample(interval: float, bench: BenchModel) -> float:
    """Return the number of rows that a sample counts for: above one if a replay takes many steps in a sample."""
    return max(1.0, steps_in_sample(bench, interval) / STEPS_PER_ROW)


def leading_stream(run: Run) -> str | None:
    """Return the stream with most channels of drive and sensors; None where a run has only temperatures."""
    channel_counts = {name: sum(is_fast(spec) for spec in specs) for name, specs in run.streams.items()}
    busiest_stream = max(channel_counts, key=lambda name: (channel_counts[name], run.rows[name]), default=None)
    return busiest_stream if busiest_stream is not None and channel_counts[busiest_stream] else None


def is_fast(spec: ChannelSpec) -> bool:
    """Return whether a channel belongs on the clock of drive and sensors."""
    return bool(spec.quantity) and not is_slow(spec.quantity)


def records_of(run: Run, share: float, bench: BenchModel) -> list[Record]:
    """Return the records of a long run: of its temperatures, if any, and of each stretch; the first has all notes.

    share : largest number of rows to read.

    Raises
    ------
    InputError : channels that cannot be used, or that were condemned; one line each.
    """
    try:
        slow, notes = slow_record(run), list[str]()
    except InputError as error:  # a clock that jumps: temperatures cannot be followed over the whole run
        slow, notes = None, [f"{fault}; temperatures are left out" for fault in error.faults]
    walk = Walk.of(run, share, bench)
    stretches = stretches_of(walk, slow)
    notes.insert(0, walk.reading_note(stretches))
    notes += [note for note in stretches[0].notes if all(note in further.notes for further in stretches)]
    for stretch in stretches:
        stretch.notes = []
    if slow is None or slow.slow is None:
        return [replace(stretches[0], notes=notes), *stretches[1:]]
    clock = replace(slow.slow, driven=walk.drive_means_after(slow.slow.time))
    return [replace(slow, slow=clock, notes=[*notes, *slow.notes]), *stretches]


def stretches_of(walk: "Walk", slow: Record | None) -> list[Record]:
    """Return the stretches of a long run, each with the run's highest speed and counts, which a stretch at rest lacks.

    Raises
    ------
    InputError : no stretch can be used.
    """
    stretches: list[tuple[Record, Clocked]] = []
    faults: list[str] = []
    for start, stop in walk.windows():
        try:
            stretches.append(stretch_of(walk, start, stop, slow))
        except InputError as error:
            faults += error.faults
    if not stretches:
        raise InputError(list(dict.fromkeys(faults)))
    clocks = [clock for _, clock in stretches]
    fastest = max(
        (float(np.quantile(speed, TOP_QUANTILE)) for clock in clocks for speed in absolute_speeds(clock)), default=0.0
    )
    counts = {key: max(clock.counts.get(key, 0.0) for clock in clocks) for clock in clocks for key in clock.counts}
    return [
        replace(record, fast=replace(clock, fastest=fastest, counts={key: counts[key] for key in clock.counts}))
        for record, clock in stretches
    ]


def stretch_of(walk: "Walk", start: int, stop: int, slow: Record | None) -> tuple[Record, Clocked]:
    """Return the record of some rows of the leading stream, with other channels of that time, and its fast clock."""
    run = walk.run
    stamps = walk.values("time", start, stop)
    begin_time, end_time = float(stamps[0]), float(stamps[-1])
    rows_of_stream = {
        stream: (row_at(run, stream, begin_time), row_at(run, stream, end_time) + 1) for stream in run.streams
    }
    rows_of_stream[walk.stream] = start, stop
    channels = [
        run.section(stream, spec, *rows_of_stream[stream]) for stream, spec in channels_of(run) if is_fast(spec)
    ]
    record = record_of(run, channels, walk.interval)
    clock = record.fast
    assert clock is not None  # `record_of` raises where no channel is usable
    temperature_clock = (
        None if slow is None or slow.slow is None else temperatures_around(slow.slow, begin_time, end_time)
    )
    record = replace(record, slow=temperature_clock, stretch=f" from {begin_time - walk.begin:.6g} s")
    return record, replace(clock, begin=walk.begin)


def whole_channels(run: Run) -> list[Channel]:
    """Return every channel of a run, temperatures as means where they have many samples."""
    return [run.section(stream, spec, 0, run.rows[stream]) for stream, spec in channels_of(run) if is_fast(spec)] + [
        read_means(run, stream, spec) for stream, spec in channels_of(run) if is_slow(spec.quantity)
    ]


def channels_of(run: Run) -> list[tuple[str, ChannelSpec]]:
    """Return the channels of a run with their streams; of equal quantity, role, location and stream, the last."""
    measured = [(stream, spec) for stream, specs in run.streams.items() for spec in specs if spec.quantity]
    return list(
        {(stream, spec.quantity, spec.role, spec.location): (stream, spec) for stream, spec in measured}.values()
    )


def slow_record(run: Run) -> Record | None:
    """Return the record of a whole run's temperatures; None where no temperature has enough samples."""
    channels = [read_means(run, stream, spec) for stream, spec in channels_of(run) if is_slow(spec.quantity)]
    if not any(np.isfinite(channel.values).sum() >= FEWEST_SAMPLES for channel in channels):
        return None
    return record_of(run, channels)


def read_means(run: Run, stream: str, spec: ChannelSpec) -> Channel:
    """Return a channel as at most `MOST_SLOW_ROWS` means over equal numbers of samples, stamped with mean times."""
    rows = run.rows[stream]
    samples_per_mean = -(-rows // MOST_SLOW_ROWS)
    if samples_per_mean <= 1:
        return run.section(stream, spec, 0, rows)
    times, values = [], []
    for start, stop in blocks(rows - rows % samples_per_mean, samples_per_mean):
        section = run.section(stream, spec, start, stop)
        table = section.values.reshape(-1, samples_per_mean)
        is_finite = np.isfinite(table)
        finite_counts = is_finite.sum(axis=1)
        sums = np.where(is_finite, table, 0.0).sum(axis=1)
        times.append(section.time.reshape(-1, samples_per_mean).mean(axis=1))
        values.append(np.where(finite_counts > 0, sums / np.maximum(finite_counts, 1), np.nan))
    return replace(run.section(stream, spec, 0, 1), time=np.concatenate(times), values=np.concatenate(values))


def blocks(rows: int, width: int) -> Iterator[tuple[int, int]]:
    """Yield begin and end of blocks of rows whose lengths are multiples of a width."""
    length = max(BLOCK_ROWS // width, 1) * width
    for start in range(0, rows, length):
        yield start, min(start + length, rows)


def temperatures_around(clock: Clocked, begin_time: float, end_time: float) -> Clocked:
    """Return the temperatures around a stretch, with `TEMPERATURE_MARGIN` samples on either side."""
    start, stop = np.searchsorted(clock.time, [begin_time, end_time])
    window = slice(max(int(start) - TEMPERATURE_MARGIN, 0), int(stop) + TEMPERATURE_MARGIN)
    return replace(
        clock,
        time=clock.time[window],
        values={key: values[window] for key, values in clock.values.items()},
        valid={key: valid[window] for key, valid in clock.valid.items()},
        measured={key: valid[window] for key, valid in clock.measured.items()},
        between={},
        fed=None if clock.fed is None else clock.fed[window],
        aside=True,
    )


def row_at(run: Run, stream: str, time: float) -> int:
    """Return the first row of a stream that is not before a time [s], or the number of rows; found by bisection."""
    low, high = 0, run.rows[stream]
    while low < high:
        middle = (low + high) // 2
        if run.values(stream, "time", middle, middle + 1)[0] < time:
            low = middle + 1
        else:
            high = middle
    return low


@dataclass
class Walk:
    """A long run that is read block by block."""

    run: Run
    stream: str
    interval: float  # s, usual interval of its samples
    length: int  # rows of a stretch
    count: int  # largest number of stretches

    @classmethod
    def of(cls, run: Run, share: float, bench: BenchModel) -> Self:
        """Return the walk through a run of which at most `share` rows are read."""
        name = leading_stream(run)
        assert name is not None  # only a run with a drive is read in stretches
        interval = bridging_interval(run.values(name, "time", 0, min(run.rows[name], MOST_ROWS)))
        rows_to_read = max(min(int(share / rows_per_sample(interval, bench)), run.rows[name]), 2)
        count = min(MOST_STRETCHES, max(rows_to_read // FEWEST_STRETCH_ROWS, 2))
        return cls(run, name, interval, rows_to_read // count, count)

    @property
    def rows(self) -> int:
        """Number of rows of the leading stream."""
        return self.run.rows[self.stream]

    @property
    def begin(self) -> float:
        """First stamp [s]."""
        return float(self.values("time", 0, 1)[0])

    def values(self, name: str, start: int, stop: int) -> Array:
        """Return some rows of a channel of the leading stream."""
        return self.run.values(self.stream, name, start, stop)

    def windows(self) -> list[tuple[int, int]]:
        """Return begin and end of the stretches to read, in rows of the leading stream.

        There is one in each part of the run: the first, the last, and between them the stretch of each part that is
        farthest from all chosen ones by mean and root mean square of current and speed, each in units of its range.
        """
        rows = self.rows
        starts = np.linspace(0, rows - self.length, min(rows // self.length, MOST_CANDIDATES)).astype(np.intp)
        summaries = np.stack([self._summary(int(start)) for start in starts])
        durations, features = summaries[:, 0], summaries[:, 1:]
        is_unbroken = durations <= MOST_UNBROKEN_RATIO * np.median(durations)
        feature_ranges = np.ptp(features, axis=0)
        features = (features - features.min(axis=0)) / np.where(feature_ranges > 0.0, feature_ranges, 1.0)
        candidates_of_parts = [
            candidates[is_unbroken[candidates]] for candidates in np.array_split(np.arange(len(starts)), self.count)
        ]
        candidates_of_parts = [candidates for candidates in candidates_of_parts if len(candidates)]
        chosen = sorted({int(candidates_of_parts[0][0]), int(candidates_of_parts[-1][-1])})
        for candidates in candidates_of_parts[1:-1]:
            distances = np.min(np.linalg.norm(features[candidates][:, None] - features[chosen][None], axis=2), axis=1)
            chosen.append(int(candidates[np.argmax(distances)]))
        return [(int(start), int(start) + self.length) for start in starts[sorted(chosen)]]

    def _summary(self, start: int) -> Array:
        """Return the duration of a stretch [s], and mean and root mean square of its current and of its speed."""
        stop = start + self.length
        stamps = self.values("time", start, stop)
        summary = [stamps[-1] - stamps[0]]
        for values in self._currents_and_speeds(start, stop, stamps):
            finite = values[np.isfinite(values)]
            summary += [float(np.mean(finite)), float(np.sqrt(np.mean(finite**2)))] if len(finite) else [0.0, 0.0]
        return np.asarray(summary, np.float64)

    def _currents_and_speeds(self, start: int, stop: int, stamps: Array) -> Iterator[Array]:
        """Yield current and speed of some rows, or the channels that stand for them; an angle as its rate."""
        for quantities in (CURRENT_CHANNELS, SPEED_CHANNELS):
            spec = self._first_of(quantities)
            if spec is not None:
                values = self.values(spec.name, start, stop)
                yield speed_of_angle(values, stamps) if spec.quantity.startswith("angle") else values

    def _first_of(self, quantities: Sequence[str]) -> ChannelSpec | None:
        """Return the test drive's channel of the first quantity that the leading stream has; None if it has none."""
        specs = {spec.quantity: spec for spec in reversed(self.run.streams[self.stream]) if spec.role == "test"}
        return next((specs[quantity] for quantity in quantities if quantity in specs), None)

    def drive_means_after(self, edges: Array) -> dict[str, Array]:
        """Return mean and mean square of the current and mean square of the speed in the interval after each edge.

        edges : begin of each interval [s], ascending.
        """
        sums: dict[str, Array] = {}
        counts: dict[str, Array] = {}
        rows = self.rows
        current, speed = self._first_of(CURRENT_CHANNELS[:1]), self._first_of(SPEED_CHANNELS[:2])
        for start, stop in blocks(rows, 1):
            stamps = self.values("time", start, stop)
            interval_of_row = np.searchsorted(edges, stamps, side="right") - 1
            values_by_name: dict[str, Array] = {}
            if current is not None:
                currents = self.values(current.name, start, stop)
                values_by_name = {"current_mean": currents, "current_squared": currents**2}
            if speed is not None:
                speeds = self.values(speed.name, start, stop)
                if speed.quantity == "angle":
                    speeds = speed_of_angle(speeds, stamps)
                values_by_name["speed_squared"] = speeds**2
            for name, values in values_by_name.items():
                is_counted = np.isfinite(values) & (interval_of_row >= 0)
                intervals = interval_of_row[is_counted]
                sums[name] = sums.get(name, np.zeros(len(edges))) + np.bincount(
                    intervals, weights=values[is_counted], minlength=len(edges)
                )
                counts[name] = counts.get(name, np.zeros(len(edges))) + np.bincount(intervals, minlength=len(edges))
        return {name: means_with_gaps_filled(total, counts[name]) for name, total in sums.items()}

    def reading_note(self, stretches: Sequence[Record]) -> str:
        """Return the note that says how much of the run is read."""
        duration = float(self.values("time", self.rows - 1, self.rows)[0]) - self.begin
        stretch_duration, share = self.interval * self.length, 100.0 * len(stretches) * self.length / self.rows
        unrecorded = duration - self.interval * (self.rows - 1)
        # rounded stamps make the usual interval wrong by a share of itself, which is no pause
        paused = (
            f"; its clock jumps or it pauses: {unrecorded:.4g} s of it have no rows"
            if unrecorded > duration / 2
            else ""
        )
        return (
            f"{self.run.path.name}: {len(stretches)} stretches of {stretch_duration:.3g} s of a run of {duration:.6g} s"
            f" are looked at ({share:.2g} % of its rows), temperatures and what heats from end to end{paused}"
        )


def speed_of_angle(angle: Array, stamps: Array) -> Array:
    """Return the smoothed speed [rad/s] of an angle, at the mean interval of its stamps [s]."""
    if len(angle) < 2:
        return np.zeros(len(angle))
    return np.asarray(smooth(np.gradient(angle)) * (len(angle) - 1) / (stamps[-1] - stamps[0]), np.float64)


def means_with_gaps_filled(sums: Array, counts: Array) -> Array:
    """Return the sums divided by the counts, interpolated where a count is zero."""
    has_samples = np.flatnonzero(counts > 0)
    if len(has_samples) == 0:
        return np.zeros(len(sums))
    return np.interp(np.arange(len(sums)), has_samples, sums[has_samples] / counts[has_samples])
