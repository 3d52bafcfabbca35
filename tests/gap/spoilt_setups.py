"""Faults of a set-up planted in sound records: each of the vocabulary, at sizes that real logs have them at.

Nothing of the diagnosis plants: values, stamps and columns are changed as a wrong mapping, drive or recorder would.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

CURRENT, REFERENCE = ("q_axis_current", "test"), ("q_axis_current_reference", "test")
VELOCITY, ANGLE = ("velocity", "test"), ("angle", "test")
TORQUE, VOLTAGE = ("torque", "test"), ("q_axis_voltage", "test")
DEGREES, RPM = 180.0 / math.pi, 30.0 / math.pi
SCALES = {
    CURRENT: (2 / 3, math.sqrt(1.5), math.sqrt(2), math.sqrt(0.5), math.sqrt(3), 1.5, 1000.0),
    TORQUE: (1000.0, 0.1, 10.0, 0.5, 2.0, 1 / 9.80665, 8.8507),
    VOLTAGE: (1000.0, math.sqrt(3), math.sqrt(3) / 3, 2.0),
    VELOCITY: (RPM, DEGREES, 0.5 / math.pi, 10.0, 2.0),
    ANGLE: (DEGREES, 0.5 / math.pi),
}


@dataclass(frozen=True)
class Planted:
    """A fault in a case, and the causes that name it rightly."""

    kind: str
    channel: str
    size: str
    right: frozenset[tuple[str, str]]  # name and quantity of causes that say it; any of them
    spoil: Callable


def with_values(record, changed):
    """A record with some channels changed; what was taken in between samples is changed alike."""
    if record.fast is None:
        return record
    there = {key: values for key, values in changed.items() if key in record.fast.values}
    between = {key: pair for key, pair in record.fast.between.items() if key not in there}
    return replace(record, fast=replace(record.fast, values=record.fast.values | there, between=between))


def on_values(key, change):
    """Spoil one channel of a record."""

    def spoil(record):
        if record.fast is None or key not in record.fast.values:
            return record
        return with_values(record, {key: change(record.fast.values[key])})

    return spoil


def swapped(first, second):
    """Exchange two channels of a record."""

    def spoil(record):
        clock = record.fast
        if clock is None or first not in clock.values or second not in clock.values:
            return record
        return with_values(record, {first: clock.values[second], second: clock.values[first]})

    return spoil


def retimed(factor):
    """Stretch the stamps of a record."""

    def spoil(record):
        clocks = [
            clock and replace(clock, time=factor * clock.time, interval=factor * clock.interval, between={})
            for clock in (record.fast, record.slow)
        ]
        return replace(record, fast=clocks[0], slow=clocks[1])

    return spoil


def drifted(key, offset, drift):
    """Let a channel's clock run off: what it reads at a time is what was there earlier, ever more so."""

    def spoil(record):
        if record.fast is None or key not in record.fast.values:
            return record
        time = record.fast.time
        late = offset * record.fast.interval + drift * (time - time[0])
        return with_values(record, {key: np.interp(time - late, time, record.fast.values[key])})

    return spoil


def dropped(key, holes, length):
    """Lose some samples of a channel while its stamps go on evenly."""

    def spoil(record):
        if record.fast is None or key not in record.fast.values:
            return record
        values = record.fast.values[key]
        keep = np.ones(len(values), bool)
        for hole in holes:
            begin = int(hole * len(values))
            keep[begin : begin + length] = False
        kept = values[keep]
        return with_values(record, {key: np.concatenate([kept, np.full(len(values) - len(kept), kept[-1])])})

    return spoil


def common(case):
    """Channels that the runs of a case have."""
    clocks = [record.fast for record in [*case.fitted, *case.held_out] if record.fast is not None]
    return set().union(*(clock.values for clock in clocks))


def spoilt(case, planted):
    """A case with a fault in every run."""
    return replace(
        case,
        fitted=[planted.spoil(record) for record in case.fitted],
        held_out=[planted.spoil(record) for record in case.held_out],
    )


def plants(case, random):
    """Every fault that the channels of a case can have, each once, at a drawn size."""
    there = common(case)
    moving = [record.fast for record in [*case.fitted, *case.held_out] if record.fast is not None]
    long = max(len(clock.time) for clock in moving)
    made = []

    def add(kind, key, size, names, spoil):
        made.append(Planted(kind, "" if key is None else key[0], size, frozenset(names), spoil))

    for key in (CURRENT, REFERENCE, VELOCITY, ANGLE, TORQUE, VOLTAGE):
        if key in there:
            add("channel_sign", key, "-1", {("channel_sign", key[0])}, on_values(key, lambda v: -v))
    for key, factors in SCALES.items():
        if key in there:
            factor = float(random.choice(factors))
            names = {("channel_scale", key[0])}
            add("channel_scale", key, f"{factor:.4g}", names, on_values(key, lambda v, f=factor: f * v))
    if CURRENT in there and REFERENCE in there:
        factor = float(random.choice(SCALES[CURRENT]))
        current, reference = (on_values(key, lambda v, f=factor: f * v) for key in (CURRENT, REFERENCE))
        names = {("channel_scale", "q_axis_current"), ("channel_scale", "q_axis_current_reference")}
        add("channel_scale", ("both currents", ""), f"{factor:.4g}", names, lambda record: current(reference(record)))
    if ANGLE in there:
        poles = int(random.integers(3, 30))
        add("pole_pairs", ANGLE, f"{poles}", {("pole_pairs", "angle")}, on_values(ANGLE, lambda v: poles * v))
        counts = float(random.choice([4.0, 2.0, 0.5, 0.25, 1.6384]))
        add(
            "encoder_counts",
            ANGLE,
            f"{counts:.4g}",
            {("encoder_counts", "angle")},
            on_values(ANGLE, lambda v: counts * v),
        )
    pairs = [(CURRENT, VELOCITY), (ANGLE, VELOCITY), (TORQUE, CURRENT), (CURRENT, REFERENCE), (VOLTAGE, CURRENT)]
    for first, second in pairs:
        if first in there and second in there:
            names = {("channel_swap", first[0]), ("channel_swap", second[0])}
            add("channel_swap", (f"{first[0]}/{second[0]}", ""), "", names, swapped(first, second))
    for factor in (float(random.choice([1000.0, 1e-3])), float(random.choice([2.0, 0.5, 4.0, 10.0]))):
        add("time_base", None, f"{factor:.4g}", {("time_base", "time")}, retimed(factor))
    for key in (TORQUE, VELOCITY, CURRENT):
        if key in there:
            off, total = random.uniform(-4.0, 4.0), random.choice([-1.0, 1.0]) * 10.0 ** random.uniform(0.7, 1.5)
            seconds = min(float(clock.time[-1] - clock.time[0]) for clock in moving)
            drift = total * max(clock.interval for clock in moving) / seconds
            size = f"{off:.2g} + {total:.3g} samples"
            add("clock_drift", key, size, {("clock_drift", key[0])}, drifted(key, off, drift))
            length = int(random.integers(5, 40))
            holes = sorted(random.uniform(0.15, 0.85, int(random.integers(1, 4))).tolist())
            size = f"{len(holes)} x {length} of {long}"
            names = {("dropped_samples", key[0]), ("clock_drift", key[0])}
            add("dropped_samples", key, size, names, dropped(key, holes, length))
    return made
