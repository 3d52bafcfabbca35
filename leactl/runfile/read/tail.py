"""The last rows of a run, and those that its writer adds while it is followed."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.runfile.read.reader import Run
from leactl.runfile.read.traces import channel_names
from leactl.runfile.summary import RECORDING

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StreamRows:
    """Consecutive rows of one stream."""

    stream: str
    names: tuple[str, ...]  # of the channels
    units: tuple[str, ...]
    time: Array  # (rows,), s since the run's start
    values: Array  # (rows, channels); NaN where nothing was measured

    def as_json(self) -> Iterator[dict[str, Any]]:
        """Yield a JSON object for each row; a missing sample is null."""
        for time, row in zip(self.time.tolist(), self.values.tolist(), strict=True):
            cells = (value if math.isfinite(value) else None for value in row)
            yield {"stream": self.stream, "time_s": time, "values": dict(zip(self.names, cells, strict=True))}

    def __len__(self) -> int:
        return len(self.time)


class RunTail:
    """A run file that is read from its end on, as often as asked.

    The file is opened anew each time, so that a run that is being written, has been closed since or was left by a kill
    reads alike.
    """

    def __init__(self, path: Path, words: Sequence[str], rows: int) -> None:
        """Take a run file.

        Parameters
        ----------
        words : choose channels as in `channel_names`; without any, those of the stream with most rows are read.
        rows : how many of each stream are read first.

        Raises
        ------
        InputError : not a run file.
        MissingChannel : a word chooses no channel.
        """
        self._path = path
        with Run.open(path) as run:
            chosen = channel_names(run, list(words))
            longest = max(run.rows, key=lambda stream: run.rows[stream], default="")
            self._channels = {
                stream: [spec for spec in specs if f"{stream}/{spec.name}" in chosen]
                for stream, specs in run.streams.items()
                if words or stream == longest
            }
            self._next = {stream: max(run.rows[stream] - rows, 0) for stream in self._channels}
            self.status = run.status

    @property
    def is_recording(self) -> bool:
        """Whether the run had not been closed when it was read last: its writer goes on, or was killed."""
        return self.status == RECORDING

    def read(self) -> list[StreamRows]:
        """Read the rows that were added since the last call, stream by stream; the last `rows` of each at the first.

        Raises
        ------
        InputError : the file has become none of a run, or is gone.
        """
        with Run.open(self._path) as run:
            self.status = run.status
            added = [self._rows_of(run, stream) for stream, channels in self._channels.items() if channels]
        return [rows for rows in added if len(rows)]

    def _rows_of(self, run: Run, stream: str) -> StreamRows:
        first, last = self._next[stream], run.rows[stream]
        self._next[stream] = max(first, last)
        channels = self._channels[stream]
        return StreamRows(
            stream,
            tuple(channel.name for channel in channels),
            tuple(channel.units for channel in channels),
            run.values(stream, "time", first, last),
            np.column_stack([run.values(stream, channel.name, first, last) for channel in channels]),
        )


def thinned(rows: StreamRows, every: float, shown_until: dict[str, float]) -> StreamRows:
    """Rows at least `every` seconds apart, also from the last one kept before, which `shown_until` holds by stream."""
    kept = []
    last = shown_until.get(rows.stream, -math.inf)
    for index, time in enumerate(rows.time.tolist()):
        if time - last >= every:
            kept.append(index)
            last = time
    shown_until[rows.stream] = last
    return replace(rows, time=rows.time[kept], values=rows.values[kept])
