"""Writing of rows to the disk: in a thread if the loop keeps wall time, inline if the loop simulates time."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RecordingFailed, RunInfo, RunWriter
from leactl.runner.channel_limits import ChannelLimits
from leactl.runner.progress import Progress
from leactl.safety.disk import free_bytes

FLUSH_INTERVAL_S = 0.8  # a kill may cost one second of rows (run-format), part of which the writing itself takes
PROMISED_FLUSH_S = 1.0  # longest time from one flush to the next, by the run format
WARNING_INTERVAL_S = 60.0  # at most one warning of a slow disk in this time


@dataclass(frozen=True)
class Recording:
    """Receivers of a run's samples and events: its file, the flush to the disk, the view, limits on channels."""

    writer: RunWriter
    flush: "Flush"
    progress: Progress
    limits: ChannelLimits


class SparseWriter(RunWriter):
    """A run file that takes at most one row of each stream in a given time."""

    def __init__(
        self,
        directory: Path,
        info: RunInfo,
        streams: Mapping[str, Sequence[ChannelSpec]],
        wait_for_disk: Callable[[], None],
        interval_s: float,
    ) -> None:
        super().__init__(directory, info, streams, wait_for_disk)
        self._interval_s = interval_s
        self._due: dict[str, float] = {}

    def append_row(self, stream: str, time: float, values: Sequence[float]) -> None:
        """Add a row if it is due."""
        if self._is_due(stream, time):
            super().append_row(stream, time, values)

    def append(self, stream: str, times: np.ndarray[Any, Any], block: np.ndarray[Any, Any]) -> None:
        """Add the rows that are due, of `times` [s], shape (n,), and `block`, shape (n, channels)."""
        due_rows = [index for index, time in enumerate(times.tolist()) if self._is_due(stream, time)]
        if due_rows:
            super().append(stream, times[due_rows], block[due_rows])

    def _is_due(self, stream: str, time: float) -> bool:
        """Return whether a row of this time [s] is to be written, and set when the stream's next row is due."""
        due_time = self._due.setdefault(stream, time)
        if time < due_time:
            return False
        self._due[stream] = due_time + self._interval_s * (math.floor((time - due_time) / self._interval_s) + 1)
        return True


class InlineFlush:
    """Flush from within the loop, about once a second of wall time."""

    def __init__(self, writer: RunWriter) -> None:
        self._writer = writer
        self._due = time.monotonic()
        self.free_bytes = math.inf  # on the disk, after the last flush

    def after_cycle(self) -> None:
        """Flush if due.

        Raises
        ------
        RecordingFailed : the disk takes no more rows.
        """
        if time.monotonic() >= self._due:
            self._writer.flush()
            self.free_bytes = free_bytes(self._writer.path)
            self._due = time.monotonic() + FLUSH_INTERVAL_S

    def warnings(self) -> list[str]:
        """Return no warnings: the time of the loop stands still while this writes."""
        return []

    def stop(self) -> None:
        """Do nothing: there is no thread to end."""


class ThreadedFlush:
    """Flush from a thread, so that a slow disk cannot hold up the loop."""

    def __init__(self, writer: RunWriter) -> None:
        self._writer = writer
        self.free_bytes = math.inf  # on the disk, after the last flush
        self._warnings: deque[str] = deque()
        self._flushed, self._next_warning_at = time.monotonic(), -math.inf
        self._ended = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="leactl-flush", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        """Flush in each interval until `stop` or a failure, which `after_cycle` raises."""
        while not self._ended.wait(FLUSH_INTERVAL_S):
            try:
                self._writer.flush()
                self._warn_if_slow(time.monotonic())
                self.free_bytes = free_bytes(self._writer.path)
            except BaseException as failure:  # noqa: BLE001 (a thread that dies in silence would record nothing more)
                self._failure = failure
                return

    def _warn_if_slow(self, now: float) -> None:
        """Warn of a disk so slow that a kill now would cost more rows than the run format promises."""
        gap_s, self._flushed = now - self._flushed, now
        if gap_s > PROMISED_FLUSH_S and now >= self._next_warning_at:
            self._next_warning_at = now + WARNING_INTERVAL_S
            self._warnings.append(
                f"the disk is slow: rows were on it {gap_s:.2g} s after those before, {PROMISED_FLUSH_S:g} s at most"
                " were expected; a crash now may cost as much of the run"
            )

    def warnings(self) -> list[str]:
        """Return the warnings since the last call, and clear them."""
        return [self._warnings.popleft() for _ in range(len(self._warnings))]

    def after_cycle(self) -> None:
        """Raise the failure of the thread, if any.

        Raises
        ------
        RecordingFailed : the disk takes no more rows.
        """
        failure = self._failure
        if failure is None:
            return
        if isinstance(failure, RecordingFailed):
            raise failure
        raise RecordingFailed(f"{self._writer.path}: recording failed: {type(failure).__name__} {failure}") from failure

    def stop(self) -> None:
        """End the thread, after a flush that is under way.

        Raises
        ------
        RecordingFailed : rows were lost.
        """
        self._ended.set()
        self._thread.join()
        self.after_cycle()


Flush = InlineFlush | ThreadedFlush
