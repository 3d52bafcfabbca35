"""Write the events of a run as JSON lines while it runs, to a file, a pipe or stdout, for scripts and dashboards.

The loop only puts a line into a queue; a thread writes it. A reader that is slow, hangs or goes away never delays the
run: lines for which the queue has no room are dropped and counted.
"""

import errno
import json
import math
import os
import select
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from leactl.errors import InputError
from leactl.regular_files import BINARY, CLOEXEC, NONBLOCK
from leactl.runner.progress import Progress

STDOUT = Path("-")
MOST_QUEUED = 10_000  # lines
# rate at which the newest value of each channel is sampled; the mean over a second is written
SAMPLES_PER_S = 20
# longest time for a slow reader at the end of a run; a write that blocks is waited for twice as long
END_WAIT_S = 1.0


class EventLines:
    """Writes the lines of one run to one output: `with EventLines(path) as lines: ...` encloses the run."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._queued: deque[bytes] = deque()
        self._dropped = 0
        self._lock = threading.Lock()  # held only while lines are queued
        self._ending = threading.Event()
        self._progress: Progress | None = None  # of a run that has begun and not ended
        self._run_began = time.monotonic()
        self.fault = ""  # why the last lines are missing
        self._file = -1
        self._thread = threading.Thread(target=self._write_until_end, name="event lines", daemon=True)

    def __enter__(self) -> Self:
        """Open the output.

        Raises
        ------
        InputError : the output cannot be opened, or is a pipe that nobody reads.
        """
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | NONBLOCK | CLOEXEC | BINARY
        try:
            self._file = os.dup(1) if self._path == STDOUT else os.open(self._path, flags, 0o644)
        except OSError as error:
            reason = "nobody reads this pipe" if error.errno == errno.ENXIO else error.strerror
            raise InputError(f"--events {self._path}: {reason}") from None
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        """Have the thread write what is queued, wait for it at most `2 * END_WAIT_S`, and close the output."""
        self._ending.set()
        self._thread.join(2.0 * END_WAIT_S)
        if self._thread.is_alive():  # in a write that does not return: stdout may block, a disk may hang
            self.fault = self.fault or _reader_fault(self._path)
        else:
            os.close(self._file)

    def put(self, event: str, **fields: Any) -> None:
        """Queue a line without waiting for the reader."""
        with self._lock:
            self._append(event, fields)

    def _append(self, event: str, fields: Mapping[str, Any]) -> None:
        """Queue a line, or drop and count it if the queue is full; the line `end` is never dropped.

        The caller holds the lock.
        """
        if len(self._queued) >= MOST_QUEUED and event != "end":
            self._dropped += 1
            return
        if self._dropped:  # the count is written where the lines are missing
            dropped, self._dropped = self._dropped, 0
            self._queued.append(json_line("left_out", {"lines": dropped}))
        self._queued.append(json_line(event, fields))

    def begin(self, progress: Progress, **fields: Any) -> None:
        """Queue the line `begin`; from then on, the means of the channels are written once a second."""
        self._run_began = time.monotonic()
        self.put("begin", **fields)
        self._progress = progress

    def end(self, **fields: Any) -> None:
        """Queue the line `end`, which is the last one."""
        with self._lock:
            self._progress = None
            self._append("end", fields)

    def step(self, row: Mapping[str, Any]) -> None:
        """Queue the line `step` of a step that has ended; `row` is the row of the step in the run file."""
        self.put("step", name=row["name"], start_s=row["start"], stop_s=row["stop"])

    def event(self, row: Mapping[str, Any]) -> None:
        """Queue the line `event`; `row` is the row of the event in the run file."""
        self.put("event", time_s=round(row["time"], 6), **{key: row[key] for key in ("level", "source", "message")})

    # -- in the thread ------------------------------------------------------------------------------------------------

    def _write_until_end(self) -> None:
        """Write lines until the run has ended; store any error in `fault`."""
        try:
            self._write_lines()
        except Exception as error:  # noqa: BLE001 (a failure to show a run must not end it)
            self.fault = f"--events {self._path}: {type(error).__name__}: {error}; lines are missing from there on"

    def _write_lines(self) -> None:
        """Take samples and write lines until the run has ended, then write what is still queued."""
        samples: dict[str, list[float]] = {}
        means_due = time.monotonic() + 1.0
        while not self._ending.wait(1.0 / SAMPLES_PER_S):
            self._sample(samples)
            now = time.monotonic()
            if now >= means_due:
                means_due += 1.0
                if means_due <= now:  # after a stall, such as a write that blocked
                    means_due = now + 1.0
                self._queue_means(samples)
                samples.clear()
            self._write_queued()
        deadline = time.monotonic() + END_WAIT_S
        while not self._write_queued():
            if time.monotonic() > deadline:
                self.fault = _reader_fault(self._path)
                return
            select.select([], [self._file], [], END_WAIT_S / 10)

    def _sample(self, samples: dict[str, list[float]]) -> None:
        """Add every channel's newest value, if it is finite, to the samples of the channel."""
        progress = self._progress
        if progress is None:
            return
        newest = {"loop": progress.values, **progress.device_values}
        for stream, channels in progress.streams.items():
            for channel, value in zip(channels, newest.get(stream, ()), strict=False):
                if math.isfinite(value):
                    name = channel.name if stream == "loop" else f"{stream}/{channel.name}"
                    samples.setdefault(name, []).append(value)

    def _queue_means(self, samples: Mapping[str, list[float]]) -> None:
        """Queue the line of the channels' means, if a run is under way."""
        means = {name: round(sum(values) / len(values), 6) for name, values in samples.items()}
        with self._lock:
            if self._progress is not None and means:  # no line may follow the end of the run
                wall_s = round(time.monotonic() - self._run_began, 3)
                self._append("values", {"wall_s": wall_s, "means": means})

    def _write_queued(self) -> bool:
        """Write queued lines until the output would block; return whether the queue is empty."""
        while self._queued:
            oldest = self._queued[0]
            try:
                sent = os.write(self._file, oldest)
            except BlockingIOError:
                return False
            if sent < len(oldest):
                self._queued[0] = oldest[sent:]
            else:
                self._queued.popleft()
        return True


def _reader_fault(path: Path) -> str:
    return f"--events {path}: the reader takes nothing; the last lines are missing"


def json_line(event: str, fields: Mapping[str, Any]) -> bytes:
    """Return an event as one line of JSON."""
    return json.dumps({"event": event, **fields}, default=str).encode() + b"\n"
