"""Read the last rows of a run, and the rows that its writer adds later."""

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
    """Reader of the last rows of a run file and of those added since the last call of `read`.

    Each call opens the file again, so that it makes no difference whether the run is still being written, has been
    closed, or was left by a kill.
    """

    def __init__(self, path: Path, words: Sequence[str], rows: int) -> None:
        """Open a run file, choose its channels and note its number of rows.

        Parameters
        ----------
        words : choose channels as in `channel_names`; if empty, the channels of the stream with most channels are read.
        rows : number of rows of each stream that the first call of `read` returns.

        Raises
        ------
        InputError : not a run file.
        MissingChannel : a word chooses no channel.
        """
        self._path = path
        with Run.open(path) as run:
            chosen = channel_names(run, list(words))
            widest_stream = max(run.streams, key=lambda stream: len(run.streams[stream]), default="")
            self._channels = {
                stream: specs_shown
                for stream, specs in run.streams.items()
                if (specs_shown := [spec for spec in specs if f"{stream}/{spec.name}" in chosen])
                and (words or stream == widest_stream)
            }
            self.other_streams = tuple(name for name in run.streams if name not in self._channels)
            self._next = {stream: max(run.rows[stream] - rows, 0) for stream in self._channels}
            self._note_status(run)

    @property
    def is_recording(self) -> bool:
        """Whether the run was not closed when it was read last: it is still being written, or its writer was killed."""
        return self._status == RECORDING

    @property
    def status_text(self) -> str:
        """How the run ended, with the reason where the file has one; `recording` while it has not ended."""
        return f"{self._status}: {self._reason}" if self._reason else self._status

    def unwritten_s(self) -> float:
        """Return the time since the file was last written [s], by this computer's clock; 0 if the file is gone."""
        try:
            return max(time.time() - self._path.stat().st_mtime, 0.0)
        except OSError:
            return 0.0

    def read(self) -> list[StreamRows]:
        """Read the rows that were added since the last call, stream by stream; at first, the last `rows` of each.

        Raises
        ------
        InputError : the file is gone, is no longer a run file, or is that of another run.
        """
        with Run.open(self._path) as run:
            if not all(self._is_continued(run, stream) for stream in self._channels):
                raise InputError(f"{self._path}: has become the file of another run; begin anew")
            self._note_status(run)
            added_rows = [self._rows_of(run, stream) for stream in self._channels]
        return [rows for rows in added_rows if len(rows)]

    def _note_status(self, run: Run) -> None:
        """Store the run's status, and the reason on one line."""
        self._status = run.status
        self._reason = " ".join(str(run.attributes.get("status_reason", "")).split())

    def _is_continued(self, run: Run, stream: str) -> bool:
        """Return whether a stream still has the channels that were chosen, and the rows that were read."""
        names = {spec.name for spec in run.streams.get(stream, ())}
        return names.issuperset(spec.name for spec in self._channels[stream]) and run.rows[stream] >= self._next[stream]

    def _rows_of(self, run: Run, stream: str) -> StreamRows:
        """Return the rows of a stream since the last call, and note that they were read."""
        start, stop = self._next[stream], run.rows[stream]
        self._next[stream] = stop
        channels = self._channels[stream]
        return StreamRows(
            stream,
            tuple(channel.name for channel in channels),
            tuple(channel.units for channel in channels),
            run.values(stream, "time", start, stop),
            np.column_stack([run.values(stream, channel.name, start, stop) for channel in channels]),
        )


def thinned(rows: StreamRows, interval_s: float, shown_until: dict[str, float]) -> StreamRows:
    """Return rows at least `interval_s` apart [s]; `shown_until` has the last stamp returned before, by stream."""
    kept_indices = []
    last_shown = shown_until.get(rows.stream, -math.inf)
    for index, stamp in enumerate(rows.time.tolist()):
        if stamp - last_shown >= interval_s:
            kept_indices.append(index)
            last_shown = stamp
    shown_until[rows.stream] = last_shown
    return replace(rows, time=rows.time[kept_indices], values=rows.values[kept_indices])
