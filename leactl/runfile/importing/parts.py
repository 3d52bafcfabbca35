"""Split one recording into several runs: by rows, by times, or by the direction of a sweep."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.runfile.importing.mapping import ByDirection, Mapping
from leactl.runfile.importing.streams import Stream
from leactl.yamlfile import Document

Array = npt.NDArray[np.float64]
Streams = dict[str, Stream]


def split_recording(path: Path, streams: Streams, mapping: Mapping, document: Document) -> list[tuple[str, Streams]]:
    """Split a recording; returns (suffix of the file name, streams) of each run, with suffix "" if nothing is split.

    Raises
    ------
    InputError : a part lies outside the recording, or no sweep is long enough.
    """
    if mapping.by_direction:
        return by_direction(path, streams, mapping.by_direction, document)
    if not mapping.parts:
        return [("", streams)]
    faults, runs = [], []
    for index, part in enumerate(mapping.parts):
        if part.rows is not None:
            start_row, stop_row = part.rows
            part_streams = {name: stream.rows(start_row, stop_row) for name, stream in streams.items()}
            is_within_recording = stop_row <= min(len(stream.time) for stream in streams.values())
        else:
            start_s, stop_s = part.time_s or (0.0, 0.0)
            part_streams = cut_to(streams, start_s, stop_s)
            is_within_recording = (
                stop_s <= max(float(stream.time[-1]) for stream in streams.values()) * (1 + 1e-9) + 1e-9
            )
        if not is_within_recording or any(len(stream.time) < 2 for stream in part_streams.values()):
            rows = ", ".join(f"{n} {len(s.time)} rows, {s.time[-1]:.6g} s" for n, s in streams.items())
            faults.append(document.fault(("parts", index), f"{path}: reaches beyond the recording ({rows})"))
        else:
            runs.append((part.suffix, from_zero(part_streams)))
    if faults:
        raise InputError(faults)
    return runs


def by_direction(path: Path, streams: Streams, settings: ByDirection, document: Document) -> list[tuple[str, Streams]]:
    """Return one run for each sweep, with suffix `forward`, `reverse`, `forward-2` and so on."""
    name, channel = settings.channel.split("/")
    stream = streams[name]
    runs: list[tuple[str, Streams]] = []
    counts = {"forward": 0, "reverse": 0}
    for first, after, is_forward in sweeps(stream.channel(channel), settings.least):
        direction = "forward" if is_forward else "reverse"
        counts[direction] += 1
        suffix = direction if counts[direction] == 1 else f"{direction}-{counts[direction]}"
        end = stream.time[after - 1] + 0.5 * (stream.time[after - 1] - stream.time[after - 2])
        runs.append((suffix, from_zero(cut_to(streams, float(stream.time[first]), float(end)))))
    if not runs:
        message = f"{path}: {settings.channel} never travels {settings.least:g} in one direction"
        raise InputError([document.fault(("by_direction", "least"), message)])
    return runs


def sweeps(values: Array, least_travel: float) -> list[tuple[int, int, bool]]:
    """Find the sweeps between turning points that travel at least `least_travel`.

    A turning point is an extreme from which the channel then returns by `least_travel`; jitter around a value is none.

    Returns
    -------
    For each sweep: first row, row after the last, and whether the channel rises.
    """
    turning_points: list[tuple[int, bool]] = []  # row of the extreme, and whether it is a maximum
    finite_rows = np.flatnonzero(np.isfinite(values))
    if not len(finite_rows):
        return []
    low = high = int(finite_rows[0])
    is_forward: bool | None = None
    for index in finite_rows.tolist():
        if values[index] > values[high]:
            high = index
        if values[index] < values[low]:
            low = index
        if is_forward is not False and values[high] - values[index] >= least_travel:
            turning_points.append((high, True))
            is_forward, low = False, index
            high = index
        elif is_forward is not True and values[index] - values[low] >= least_travel:
            turning_points.append((low, False))
            is_forward, high = True, index
            low = index
    if is_forward is None:
        return []
    ends = [*turning_points, ((high if is_forward else low), is_forward)]
    # a turning point belongs to the sweep that ends there, and the next sweep begins with the row after it
    starts = [ends[0][0], *(turning_point + 1 for turning_point, _ in ends[1:-1])]
    stretches = [(first, last + 1, rises) for first, (last, rises) in zip(starts, ends[1:], strict=True)]
    return [(first, after, rises) for first, after, rises in stretches if travel(values[first:after]) >= least_travel]


def travel(values: Array) -> float:
    """Return the highest minus lowest value."""
    return float(np.nanmax(values) - np.nanmin(values))


def cut_to(streams: Streams, begin: float, end: float) -> Streams:
    """Return the rows of every stream from time `begin` to before `end` [s]."""
    return {
        name: stream.rows(int(np.searchsorted(stream.time, begin)), int(np.searchsorted(stream.time, end)))
        for name, stream in streams.items()
    }


def from_zero(streams: Streams) -> Streams:
    """Shift all streams so that the earliest stamp is 0."""
    start = min(float(stream.time[0]) for stream in streams.values() if len(stream.time))
    return {name: replace(stream, time=stream.time - start) for name, stream in streams.items()}
