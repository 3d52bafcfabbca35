"""Steps of an imported recording: by instants, by a column that tells them, or where a channel holds its level."""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.importing_mapping import Mapping, StepsByColumn, StepsByHolds
from leactl.runfile.importing_streams import Stream
from leactl.yamlfile import Document

Array = npt.NDArray[np.float64]
SCATTER = 5.0  # standard deviations of a channel's noise that a level may be left by
ROUNDED = 1e-9  # of a channel's largest value, that a mean of equal numbers may be off by
MOST_SEEN = 10  # labels that a fault names
MAD = 1.4826  # standard deviations in the median of absolute deviations, of normal noise


class Step(NamedTuple):
    """A step as the run file has it, times on the run's clock [s]."""

    name: str
    start: float
    stop: float
    settle: float
    parameters: dict[str, Any]


def steps_of(streams: dict[str, Stream], mapping: Mapping, document: Document, source: str) -> list[Step]:
    """Steps of one run, as its mapping tells them; none where it tells nothing.

    Raises
    ------
    InputError : steps beyond the recording or over one another, labels that never stand, no level that is held.
    """
    end = max(float(stream.time[-1]) for stream in streams.values())
    if mapping.steps:
        return by_instants(mapping, end, document, source)
    if mapping.steps_by_column:
        return by_column(streams, mapping.steps_by_column, document, source)
    if mapping.steps_by_holds:
        return by_holds(streams, mapping.steps_by_holds, document, source)
    return []


def by_instants(mapping: Mapping, end: float, document: Document, source: str) -> list[Step]:
    """Steps that the mapping writes out."""
    faults, before = [], 0.0
    for index, step in enumerate(mapping.steps):
        if not before <= step.start_s:
            why = f"start_s {step.start_s:g}: after {before:g} s was expected, where the step before it ends"
            faults.append(document.fault(("steps", index), why))
        if step.stop_s > end:
            faults.append(document.fault(("steps", index), f"{source}: stop_s {step.stop_s:g}; it ends at {end:.6g} s"))
        before = step.stop_s
    if faults:
        raise InputError(faults)
    return [Step(s.name, s.start_s, s.stop_s, s.settle_s, dict(s.parameters)) for s in mapping.steps]


def by_column(streams: dict[str, Stream], by: StepsByColumn, document: Document, source: str) -> list[Step]:
    """A step for each stretch of rows with one label."""
    stream = streams[by.stream]
    labels = stream.labels or []
    changes = [row for row, (one, other) in enumerate(pairwise(labels), start=1) if one != other]
    found = []
    for first, after in pairwise([0, *changes, len(labels)]):
        if labels[first] in by.names:
            start, stop = during(stream, first, after)
            levels = {
                name: level(streams, place, start + by.settle_s, stop, document.fault(("steps_by_column",), source))
                for name, place in by.parameters.items()
            }
            found.append(Step(by.names[labels[first]], start, stop, by.settle_s, levels))
    if not found:
        seen = ", ".join(list(dict.fromkeys(labels))[:MOST_SEEN])
        told = f"{source}: none of {', '.join(by.names)} stands in column {by.column!r}, which has {seen}"
        raise InputError(document.fault(("steps_by_column", "names"), told))
    return found


def by_holds(streams: dict[str, Stream], by: StepsByHolds, document: Document, source: str) -> list[Step]:
    """A step for each stretch in which a channel stays within its noise."""
    name, channel = by.channel.split("/")
    stream, values = streams[name], streams[name].channel(channel)
    found = []
    for first, after in held(values):
        start, stop = during(stream, first, after)
        if stop - start < by.least_s:
            continue
        settled = values[first:after][stream.time[first:after] >= start + by.settle_s]
        held_at = float(np.nanmedian(settled))
        came = {"direction": "rising" if values[first - 1] < held_at else "falling"} if first else {}
        found.append(Step("hold", start, stop, by.settle_s, {by.parameter: held_at, **came, **by.parameters}))
    if not found:
        told = f"{source}: {by.channel} holds no level for least_s {by.least_s:g}"
        raise InputError(document.fault(("steps_by_holds", "least_s"), told))
    return found


def held(values: Array) -> Iterator[tuple[int, int]]:
    """Stretches (first row, row after the last) in which a channel stays by its own mean, as near as its noise lets it.

    The noise is that of neighbouring rows, so a setpoint that is repeated exactly is held exactly. Two rows off it
    in a row end a stretch; what is missing ends none.
    """
    known = np.flatnonzero(np.isfinite(values))
    changes = np.abs(np.diff(values[known], prepend=values[known[0]]))
    near = max(SCATTER * MAD * float(np.median(changes)) / math.sqrt(2.0), ROUNDED * float(np.abs(values[known]).max()))
    first, total, count = 0, 0.0, 0
    off: tuple[int, float] | None = None  # the row before, where it was off its level: one alone is a stray reading
    for row, value in zip(known.tolist(), values[known].tolist(), strict=True):
        if not count or abs(value - total / count) <= near:
            total, count, off = total + value, count + 1, None
        elif off is None:
            off = row, value
        else:
            yield first, off[0]
            first, total, count, off = off[0], value, 1, None
    yield first, len(values)


def during(stream: Stream, first: int, after: int) -> tuple[float, float]:
    """Instants of a stretch of rows: from its first to that of the row after it, or to the end."""
    return float(stream.time[first]), float(stream.time[min(after, len(stream.time) - 1)])


def level(streams: dict[str, Stream], place: str, start: float, stop: float, fault: str) -> float:
    """Median of a channel during a step; a refusal begins with `fault`."""
    name, channel = place.split("/")
    stream = streams[name]
    values = stream.channel(channel)[(stream.time >= start) & (stream.time < stop)]
    if not np.isfinite(values).any():
        raise InputError(f"{fault}: {place} has no reading from {start:g} s to {stop:g} s; is settle_s too long?")
    return float(np.nanmedian(values))
