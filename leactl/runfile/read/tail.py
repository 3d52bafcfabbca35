"""The last rows of a run, and those that its writer adds while it is followed."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
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
        for stamp, row in zip(self.time.tolist(), self.values.tolist(), strict=True):
            cells = (value if math.isfinite(value) else None for value in row)
            yield {"stream": self.stream, "time_s": stamp, "values": dict(zip(self.names, cells, strict=True))}

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
        words : choose channels as in `channel_names`; without any, those of the stream with most channels are read,
            which stays the same while rows are added.
        rows : how many of each stream are read first.

        Raises
        ------
        InputError : not a run file.
        MissingChannel : a word chooses no channel.
        """
        self._path = path
        with Run.open(path) as run:
            chosen = channel_names(run, list(words))
            widest = max(run.streams, key=lambda stream: len(run.streams[stream]), default="")
            self._channels = {
                stream: specs_shown
                for stream, specs in run.streams.items()
                if (specs_shown := [spec for spec in specs if f"{stream}/{spec.name}" in chosen])
                and (words or stream == widest)
            }
            self.other_streams = tuple(name for name in run.streams if name not in self._channels)
            self._next = {stream: max(run.rows[stream] - rows, 0) for stream in self._channels}
            self._note_status(run)

    @property
    def is_recording(self) -> bool:
        """Whether the run had not been closed when it was read last: its writer goes on, or was killed."""
        return self._status == RECORDING

    @property
    def status_text(self) -> str:
        """How the run ended, with the reason where the file has one; `recording` while it has not ended."""
        return f"{self._status}: {self._reason}" if self._reason else self._status

    def unwritten_s(self) -> float:
        """Time since the file was written last [s], by this computer's clock; 0 if it is gone."""
        try:
            return max(time.time() - self._path.stat().st_mtime, 0.0)
        except OSError:
            return 0.0

    def read(self) -> list[StreamRows]:
        """Read the rows that were added since the last call, stream by stream; the last `rows` of each at the first.

        Raises
        ------
        InputError : the file has become none of a run or one of another run, or is gone.
        """
        with Run.open(self._path) as run:
            if not all(self._is_continued(run, stream) for stream in self._channels):
                raise InputError(f"{self._path}: has become the file of another run; begin anew")
            self._note_status(run)
            added = [self._rows_of(run, stream) for stream in self._channels]
        return [rows for rows in added if len(rows)]

    def _note_status(self, run: Run) -> None:
        self._status = run.status
        self._reason = " ".join(str(run.attributes.get("status_reason", "")).split())

    def _is_continued(self, run: Run, stream: str) -> bool:
        """Whether a stream has the channels that were chosen, and the rows that were read."""
        names = {spec.name for spec in run.streams.get(stream, ())}
        return names.issuperset(spec.name for spec in self._channels[stream]) and run.rows[stream] >= self._next[stream]

    def _rows_of(self, run: Run, stream: str) -> StreamRows:
        first, last = self._next[stream], run.rows[stream]
        self._next[stream] = last
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
    for index, stamp in enumerate(rows.time.tolist()):
        if stamp - last >= every:
            kept.append(index)
            last = stamp
    shown_until[rows.stream] = last
    return replace(rows, time=rows.time[kept], values=rows.values[kept])
