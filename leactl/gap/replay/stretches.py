"""Runs longer than a diagnosis needs: read in stretches at their full rate, so that memory does not grow with them.

All runs of a case share `ROWS`. One that is longer than its share is looked at in `STRETCHES` stretches, the first and
the last among them, one in each sixteenth of it, where its level and swing are farthest from those of the others.
Temperatures go by what happens all the time: these are read from end to end as means over many samples, with the mean
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
from leactl.gap.replay.bench_times import steps_in_sample
from leactl.gap.signals.record import FEWEST, PAUSED, Clocked, Record, bridging_interval, is_slow, record_of
from leactl.gap.signals.scales import TOP, absolute_speeds
from leactl.gap.signals.smoothing import smooth
from leactl.model.nominal import BenchModel
from leactl.quantities import ChannelSpec
from leactl.runfile.layout import BLOCK_ROWS
from leactl.runfile.read.reader import Channel, Run
from leactl.runfile.verify.integrity import refuse_altered

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
ROWS = 3 << 17  # of all runs of a case together
SLOW_ROWS = 1 << 14  # of the temperatures of a run: what is slower than its drive needs no more
STRETCHES = 16
SHORTEST = 1 << 9  # rows of a stretch, of which there are fewer where a share is small
CANDIDATES = 1 << 10  # stretches of a run that those are chosen among
PARTS = 8  # steps of a replay in a sample, beyond which one counts for more than a row
BROKEN = 2.0  # of the usual time that a stretch takes, beyond which there is a pause in it
AROUND = 64  # samples of temperature to either side of a stretch, for what smooths them
CURRENTS = ("q_axis_current", "q_axis_current_reference", "torque_reference", "torque", "q_axis_voltage")
SPEEDS = ("velocity", "angle", "velocity_reference", "angle_reference")


def read_records(paths: Sequence[Path], bench: BenchModel) -> dict[Path, list[Record]]:
    """Read runs of a case, each as one record, or as several where it is longer than its share by its model's replay.

    Raises
    ------
    InputError : no run file, one that is not as it was closed, or whose channels cannot be used; one line each.
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
    share = fair_share(list(costs.values()), ROWS)
    for path, cost in costs.items():
        try:
            with Run.open(path) as run:
                by_path[path] = [record_of(run, whole(run))] if cost <= share else records_of(run, share, bench)
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    return by_path


def fair_share(costs: Sequence[float], most: float) -> float:
    """What each may have at most, so that all have no more than there is; what some do not need is for the others."""
    rest = most
    for taken, cost in enumerate(sorted(costs)):
        share = rest / (len(costs) - taken)
        if cost > share:
            return share
        rest -= cost
    return math.inf


def cost_of(run: Run, bench: BenchModel) -> float:
    """Rows that a run makes on the clock of its drive, those with many steps of a replay counted as several."""
    name = leading(run)
    if name is None or run.rows[name] < 2:
        return 0.0
    rows = run.rows[name]
    stamps = run.values(name, "time", 0, min(rows, ROWS + 1))
    interval = bridging_interval(stamps)
    made = float(stamps[-1] - stamps[0]) / interval if rows <= ROWS else rows  # a gap makes rows as well
    return math.inf if made > PAUSED * rows else max(made, rows) * weight(interval, bench)


def weight(interval: float, bench: BenchModel) -> float:
    """Rows that one sample counts for: more than one where a replay takes many steps from one to the next."""
    return max(1.0, steps_in_sample(bench, interval) / PARTS)


def leading(run: Run) -> str | None:
    """The stream with most channels of drive and sensors; None where a run has only temperatures."""
    fast = {name: sum(is_fast(spec) for spec in specs) for name, specs in run.streams.items()}
    best = max(fast, key=lambda name: (fast[name], run.rows[name]), default=None)
    return best if best is not None and fast[best] else None


def is_fast(spec: ChannelSpec) -> bool:
    """Whether a channel belongs on the clock of drive and sensors."""
    return bool(spec.quantity) and not is_slow(spec.quantity)


def records_of(run: Run, share: float, bench: BenchModel) -> list[Record]:
    """A long run as the records of its stretches and one of its temperatures, the notes with the first.

    share : rows that may be looked at.

    Raises
    ------
    InputError : channels that cannot be used, or that were condemned; one line each.
    """
    try:
        slow, told = slow_record(run), list[str]()
    except InputError as error:  # a clock that jumps: there is no whole run to follow temperatures over
        slow, told = None, [f"{fault}; temperatures are left out" for fault in error.faults]
    walk = Walk.of(run, share, bench)
    stretches = stretches_of(walk, slow)
    told.insert(0, walk.told(stretches))
    told += [note for note in stretches[0].notes if all(note in other.notes for other in stretches)]
    for stretch in stretches:
        stretch.notes = []
    if slow is None or slow.slow is None:
        return [replace(stretches[0], notes=told), *stretches[1:]]
    clock = replace(slow.slow, driven=walk.driven(slow.slow.time))
    return [replace(slow, slow=clock, notes=[*told, *slow.notes]), *stretches]


def stretches_of(walk: "Walk", slow: Record | None) -> list[Record]:
    """The stretches of a long run, each with its run's highest speed and counts: one that stands still has neither.

    Raises
    ------
    InputError : none of them can be used.
    """
    stretches: list[tuple[Record, Clocked]] = []
    faults: list[str] = []
    for first, stop in walk.windows():
        try:
            stretches.append(stretch_of(walk, first, stop, slow))
        except InputError as error:
            faults += error.faults
    if not stretches:
        raise InputError(list(dict.fromkeys(faults)))
    clocks = [clock for _, clock in stretches]
    fastest = max((float(np.quantile(speed, TOP)) for clock in clocks for speed in absolute_speeds(clock)), default=0.0)
    counts = {key: max(clock.counts.get(key, 0.0) for clock in clocks) for clock in clocks for key in clock.counts}
    return [
        replace(one, fast=replace(clock, fastest=fastest, counts={key: counts[key] for key in clock.counts}))
        for one, clock in stretches
    ]


def stretch_of(walk: "Walk", first: int, stop: int, slow: Record | None) -> tuple[Record, Clocked]:
    """Some rows of the leading stream, what other streams have meanwhile, and how warm it was; with its fast clock."""
    run = walk.run
    stamps = walk.values("time", first, stop)
    since, until = float(stamps[0]), float(stamps[-1])
    rows = {stream: (row_at(run, stream, since), row_at(run, stream, until) + 1) for stream in run.streams}
    rows[walk.stream] = first, stop
    channels = [run.section(stream, spec, *rows[stream]) for stream, spec in channels_of(run) if is_fast(spec)]
    record = record_of(run, channels, walk.interval)
    clock = record.fast
    assert clock is not None  # else nothing were usable
    warm = None if slow is None or slow.slow is None else cut_out(slow.slow, since, until)
    record = replace(record, slow=warm, stretch=f" from {since - walk.begin:.6g} s")
    return record, replace(clock, begin=walk.begin)


def whole(run: Run) -> list[Channel]:
    """Every channel of a run, temperatures as means where they are many."""
    return [run.section(stream, spec, 0, run.rows[stream]) for stream, spec in channels_of(run) if is_fast(spec)] + [
        meant(run, stream, spec) for stream, spec in channels_of(run) if is_slow(spec.quantity)
    ]


def channels_of(run: Run) -> list[tuple[str, ChannelSpec]]:
    """What a run measures, with the stream of each; of two of one place in a stream the last."""
    every = [(stream, spec) for stream, specs in run.streams.items() for spec in specs if spec.quantity]
    return list({(stream, spec.quantity, spec.role, spec.location): (stream, spec) for stream, spec in every}.values())


def slow_record(run: Run) -> Record | None:
    """The temperatures of a run from end to end; None where it has none."""
    channels = [meant(run, stream, spec) for stream, spec in channels_of(run) if is_slow(spec.quantity)]
    if not any(np.isfinite(channel.values).sum() >= FEWEST for channel in channels):
        return None
    return record_of(run, channels)


def meant(run: Run, stream: str, spec: ChannelSpec) -> Channel:
    """A channel as means over so many samples that no more than `SLOW_ROWS` are left, in the middle of each."""
    rows = run.rows[stream]
    width = -(-rows // SLOW_ROWS)
    if width <= 1:
        return run.section(stream, spec, 0, rows)
    times, values = [], []
    for first, stop in blocks(rows - rows % width, width):
        part = run.section(stream, spec, first, stop)
        table = part.values.reshape(-1, width)
        there = np.isfinite(table)
        count = there.sum(axis=1)
        sums = np.where(there, table, 0.0).sum(axis=1)
        times.append(part.time.reshape(-1, width).mean(axis=1))
        values.append(np.where(count > 0, sums / np.maximum(count, 1), np.nan))
    return replace(run.section(stream, spec, 0, 1), time=np.concatenate(times), values=np.concatenate(values))


def blocks(rows: int, width: int) -> Iterator[tuple[int, int]]:
    """Begin and end of blocks of rows, each a multiple of a width long."""
    length = max(BLOCK_ROWS // width, 1) * width
    for first in range(0, rows, length):
        yield first, min(first + length, rows)


def cut_out(clock: Clocked, since: float, until: float) -> Clocked:
    """Temperatures around a stretch."""
    first, last = np.searchsorted(clock.time, [since, until])
    kept = slice(max(int(first) - AROUND, 0), int(last) + AROUND)
    return replace(
        clock,
        time=clock.time[kept],
        values={key: values[kept] for key, values in clock.values.items()},
        valid={key: valid[kept] for key, valid in clock.valid.items()},
        between={},
        fed=None if clock.fed is None else clock.fed[kept],
        aside=True,
    )


def row_at(run: Run, stream: str, time: float) -> int:
    """The first row of a stream that is not before a time, found by halving."""
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
    """A long run, gone through once block by block."""

    run: Run
    stream: str
    interval: float  # s, usual one of its samples
    length: int  # rows of a stretch
    count: int  # of stretches, at most

    @classmethod
    def of(cls, run: Run, share: float, bench: BenchModel) -> Self:
        """A run of which so many rows may be looked at."""
        name = leading(run)
        assert name is not None  # a run without a drive is not too long for anything
        interval = bridging_interval(run.values(name, "time", 0, min(run.rows[name], ROWS)))
        looked_at = max(min(int(share / weight(interval, bench)), run.rows[name]), 2)
        count = min(STRETCHES, max(looked_at // SHORTEST, 2))
        return cls(run, name, interval, looked_at // count, count)

    @property
    def rows(self) -> int:
        """Of the leading stream."""
        return self.run.rows[self.stream]

    @property
    def begin(self) -> float:
        """The first stamp."""
        return float(self.values("time", 0, 1)[0])

    def values(self, name: str, start: int, stop: int) -> Array:
        """Some rows of a channel of the leading stream."""
        return self.run.values(self.stream, name, start, stop)

    def windows(self) -> list[tuple[int, int]]:
        """Begin and end of the stretches, in rows of the leading stream.

        One in each part of the run: the first, the last, and in between those that are farthest from all the others
        by mean and root mean square of current and speed, each counted in its range.
        """
        rows = self.rows
        starts = np.linspace(0, rows - self.length, min(rows // self.length, CANDIDATES)).astype(np.intp)
        seen = np.stack([self._seen(int(start)) for start in starts])
        spans, shapes = seen[:, 0], seen[:, 1:]
        whole = spans <= BROKEN * np.median(spans)
        ranges = np.ptp(shapes, axis=0)
        shapes = (shapes - shapes.min(axis=0)) / np.where(ranges > 0.0, ranges, 1.0)
        parts = [part[whole[part]] for part in np.array_split(np.arange(len(starts)), self.count)]
        parts = [part for part in parts if len(part)]
        chosen = sorted({int(parts[0][0]), int(parts[-1][-1])})
        for part in parts[1:-1]:
            apart = np.min(np.linalg.norm(shapes[part][:, None] - shapes[chosen][None], axis=2), axis=1)
            chosen.append(int(part[np.argmax(apart)]))
        return [(int(start), int(start) + self.length) for start in starts[sorted(chosen)]]

    def _seen(self, start: int) -> Array:
        """How long a stretch takes, and mean and root mean square of current and speed in it."""
        stop = start + self.length
        stamps = self.values("time", start, stop)
        summary = [stamps[-1] - stamps[0]]
        for values in self._moving(start, stop, stamps):
            good = values[np.isfinite(values)]
            summary += [float(np.mean(good)), float(np.sqrt(np.mean(good**2)))] if len(good) else [0.0, 0.0]
        return np.asarray(summary, np.float64)

    def _moving(self, start: int, stop: int, stamps: Array) -> Iterator[Array]:
        """Current and speed, or what stands for them; an angle as its change."""
        for wanted in (CURRENTS, SPEEDS):
            spec = self._first(wanted)
            if spec is not None:
                values = self.values(spec.name, start, stop)
                yield turned(values, stamps) if spec.quantity.startswith("angle") else values

    def _first(self, wanted: Sequence[str]) -> ChannelSpec | None:
        specs = {spec.quantity: spec for spec in reversed(self.run.streams[self.stream]) if spec.role == "test"}
        return next((specs[quantity] for quantity in wanted if quantity in specs), None)

    def driven(self, edges: Array) -> dict[str, Array]:
        """Mean and mean square of the current, and mean square of the speed, over the interval from each edge on."""
        sums: dict[str, Array] = {}
        counts: dict[str, Array] = {}
        rows = self.rows
        current, speed = self._first(CURRENTS[:1]), self._first(SPEEDS[:2])
        for first, stop in blocks(rows, 1):
            stamps = self.values("time", first, stop)
            place = np.searchsorted(edges, stamps, side="right") - 1
            powers: dict[str, Array] = {}
            if current is not None:
                flowing = self.values(current.name, first, stop)
                powers = {"current_mean": flowing, "current_squared": flowing**2}
            if speed is not None:
                turning = self.values(speed.name, first, stop)
                if speed.quantity == "angle":
                    turning = turned(turning, stamps)
                powers["speed_squared"] = turning**2
            for name, values in powers.items():
                good = np.isfinite(values) & (place >= 0)
                at = place[good]
                sums[name] = sums.get(name, np.zeros(len(edges))) + np.bincount(
                    at, weights=values[good], minlength=len(edges)
                )
                counts[name] = counts.get(name, np.zeros(len(edges))) + np.bincount(at, minlength=len(edges))
        return {name: bridged(total, counts[name]) for name, total in sums.items()}

    def told(self, stretches: Sequence[Record]) -> str:
        """How much of the run is looked at, for a person."""
        lasts = float(self.values("time", self.rows - 1, self.rows)[0]) - self.begin
        each, share = self.interval * self.length, 100.0 * len(stretches) * self.length / self.rows
        unrecorded = lasts - self.interval * (self.rows - 1)
        # stamps rounded to a few digits put the usual interval off by a share: that is no pause
        paused = (
            f"; its clock jumps or it pauses: {unrecorded:.4g} s of it have no rows" if unrecorded > lasts / 2 else ""
        )
        return (
            f"{self.run.path.name}: {len(stretches)} stretches of {each:.3g} s of a run of {lasts:.6g} s are looked at"
            f" ({share:.2g} % of its rows), temperatures and what heats from end to end{paused}"
        )


def turned(angle: Array, stamps: Array) -> Array:
    """Speed of an angle, at the mean pace of its stamps."""
    if len(angle) < 2:
        return np.zeros(len(angle))
    return np.asarray(smooth(np.gradient(angle)) * (len(angle) - 1) / (stamps[-1] - stamps[0]), np.float64)


def bridged(sums: Array, counts: Array) -> Array:
    """Means, those of nothing taken in between."""
    there = np.flatnonzero(counts > 0)
    if len(there) == 0:
        return np.zeros(len(sums))
    return np.interp(np.arange(len(sums)), there, sums[there] / counts[there])
