"""Find the steps of an imported recording: by times, by a column of labels, or by the holds of a channel."""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from leactl.errors import InputError
from leactl.runfile.importing.holds import NotDistinct, find_holds
from leactl.runfile.importing.mapping import Mapping, StepsByColumn, StepsByHolds, is_channel_path
from leactl.runfile.importing.streams import Stream
from leactl.yamlfile import Document

MOST_LABELS_SHOWN = 10  # labels in a message


class ImportedStep(NamedTuple):
    """A step of the run file, with times on the run's clock [s]."""

    name: str
    start: float
    stop: float
    settle: float
    parameters: dict[str, Any]


def steps_of(streams: dict[str, Stream], mapping: Mapping, document: Document, source: str) -> list[ImportedStep]:
    """Find the steps of one run by its mapping; empty if the mapping defines none.

    Raises
    ------
    InputError : steps outside the recording or overlapping, labels that do not occur, or no level that is held.
    """
    end = max(float(stream.time[-1]) for stream in streams.values())
    if mapping.steps:
        return by_instants(mapping, end, document, source)
    if mapping.steps_by_column:
        return by_column(streams, mapping.steps_by_column, document, source)
    if mapping.steps_by_holds:
        return by_holds(streams, mapping.steps_by_holds, document, source)
    return []


def by_instants(mapping: Mapping, end: float, document: Document, source: str) -> list[ImportedStep]:
    """Return the steps whose times the mapping states."""
    faults, earliest_start = [], 0.0
    for index, step in enumerate(mapping.steps):
        if not earliest_start <= step.start_s:
            message = (
                f"start_s {step.start_s:g}: after {earliest_start:g} s was expected, where the step before it ends"
            )
            faults.append(document.fault(("steps", index), message))
        if step.stop_s > end:
            faults.append(document.fault(("steps", index), f"{source}: stop_s {step.stop_s:g}; it ends at {end:.6g} s"))
        earliest_start = step.stop_s
    if faults:
        raise InputError(faults)
    return [ImportedStep(s.name, s.start_s, s.stop_s, s.settle_s, dict(s.parameters)) for s in mapping.steps]


def by_column(
    streams: dict[str, Stream], settings: StepsByColumn, document: Document, source: str
) -> list[ImportedStep]:
    """Return a step for each stretch of rows with one label."""
    stream = streams[settings.stream]
    labels = stream.labels or []
    changes = [row for row, (label, next_label) in enumerate(pairwise(labels), start=1) if label != next_label]
    steps = []
    for first, after in pairwise([0, *changes, len(labels)]):
        if labels[first] in settings.names:
            start, stop = instants_of(stream, first, after)
            steps.append(ImportedStep(settings.names[labels[first]], start, stop, settings.settle_s, {}))
            for name, value in settings.parameters.items():
                parameter = (
                    median_level(streams, value, start, stop, settings.settle_s) if is_channel_path(value) else value
                )
                if parameter is None:
                    reason = f"{source}: {value} has no reading from {start + settings.settle_s:g} s to {stop:g} s"
                    raise InputError(document.fault(("steps_by_column", "settle_s"), f"{reason}; a shorter one has"))
                if not (isinstance(parameter, float) and math.isnan(parameter)):
                    steps[-1].parameters[name] = parameter
    if not steps:
        present = ", ".join(list(dict.fromkeys(labels))[:MOST_LABELS_SHOWN])
        message = (
            f"{source}: none of {', '.join(settings.names)} stands in column {settings.column!r}, which has {present}"
        )
        raise InputError(document.fault(("steps_by_column", "names"), message))
    return steps


def by_holds(streams: dict[str, Stream], settings: StepsByHolds, document: Document, source: str) -> list[ImportedStep]:
    """Find a step for each stretch in which a channel holds a level."""
    name, channel = settings.channel.split("/")
    stream, values = streams[name], streams[name].channel(channel)
    is_setpoint = stream.spec(channel).quantity.endswith("_reference")
    try:
        holds = find_holds(stream.time, values, settings.least_s, settings.settle_s, is_setpoint)
    except NotDistinct as reason:
        message = f"{source}: levels of {settings.channel} are not distinct from noise: {reason}; a setpoint, steps or"
        raise InputError(document.fault(("steps_by_holds", "channel"), f"{message} steps_by_column can tell")) from None
    steps = []
    for hold in holds:
        start, stop = instants_of(stream, hold.first, hold.after)
        settled = values[hold.first : hold.after][stream.time[hold.first : hold.after] >= start + settings.settle_s]
        level = float(np.nanmedian(settled))
        direction = {} if math.isnan(hold.before) else {"direction": "rising" if hold.before < level else "falling"}
        steps.append(
            ImportedStep(
                "hold", start, stop, settings.settle_s, {settings.parameter: level, **direction, **settings.parameters}
            )
        )
    if not steps:
        message = f"{source}: {settings.channel} holds no level for least_s {settings.least_s:g}"
        raise InputError(document.fault(("steps_by_holds", "least_s"), message))
    return steps


def instants_of(stream: Stream, first: int, after: int) -> tuple[float, float]:
    """Return start and stop [s] of a stretch of rows: stamps of its first row and of row `after`, or the last."""
    return float(stream.time[first]), float(stream.time[min(after, len(stream.time) - 1)])


def median_level(
    streams: dict[str, Stream], channel_path: str, start: float, stop: float, settle: float
) -> float | None:
    """Return the median of a channel in the settled part of a step.

    NaN if the channel has no sample in the whole step, None if it has samples in the step but not in the settled part.
    """
    name, channel = channel_path.split("/")
    stream = streams[name]
    values = stream.channel(channel)
    if not np.isfinite(values[(stream.time >= start) & (stream.time < stop)]).any():
        return math.nan
    settled = values[(stream.time >= start + settle) & (stream.time < stop)]
    return float(np.nanmedian(settled)) if np.isfinite(settled).any() else None
