"""A run told as it goes, one JSON line at a time, to a file, a pipe or stdout, for scripts and dashboards.

The loop only puts a line into a queue; a thread writes. Whoever reads slowly, hangs or goes away costs the run nothing:
what has no room is left out and counted.
"""

import errno
import json
import math
import os
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from leactl.errors import InputError
from leactl.runner.progress import Progress

STDOUT = Path("-")
MOST_WAITING = 10_000  # lines; a reader that is further behind misses some
LOOKS_A_SECOND = 20  # at the newest values, of which each second's mean is told
LAST_S = 1.0  # that the end of a run waits for a slow reader


class EventLines:
    """Lines for one reader: `with EventLines(path) as lines: ...` around the run."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lines: deque[bytes] = deque()
        self._left_out = 0
        self._ended = threading.Event()
        self._progress: Progress | None = None
        self._began = time.monotonic()
        self.fault = ""  # why nothing more could be written
        self._file = -1
        self._writer = threading.Thread(target=self._write, name="event lines", daemon=True)

    def __enter__(self) -> Self:
        """Open what is written to.

        Raises
        ------
        InputError : it cannot be opened, or is a pipe that nobody reads.
        """
        if self._path == STDOUT:
            self._file = os.dup(1)
        else:
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NONBLOCK | os.O_CLOEXEC
            try:
                self._file = os.open(self._path, flags, 0o644)
            except OSError as error:
                reason = "nobody reads this pipe" if error.errno == errno.ENXIO else error.strerror
                raise InputError(f"--events {self._path}: {reason}") from None
        self._writer.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._ended.set()
        self._writer.join(LAST_S)
        if not self._writer.is_alive():
            os.close(self._file)

    def put(self, event: str, **told: Any) -> None:
        """Say that something happened; never waits and never fails."""
        if len(self._lines) >= MOST_WAITING:
            self._left_out += 1
            return
        self._lines.append(json.dumps({"event": event, **told}, default=str).encode() + b"\n")

    def begin(self, progress: Progress, **told: Any) -> None:
        """Say that a run begins, and tell its channels' means once a second from now on."""
        self._progress, self._began = progress, time.monotonic()
        self.put("begin", **told)

    def end(self, **told: Any) -> None:
        """Say how the run ended, last of all."""
        self._progress = None
        self.put("end", **told)

    def step(self, row: Mapping[str, Any]) -> None:
        """Say that a step has ended."""
        self.put("step", name=row["name"], start_s=row["start"], stop_s=row["stop"])

    def event(self, row: Mapping[str, Any]) -> None:
        """Tell an event of the run's record."""
        self.put("event", time_s=round(row["time"], 6), **{key: row[key] for key in ("level", "source", "message")})

    # -- in the thread ------------------------------------------------------------------------------------------------

    def _write(self) -> None:
        sums: dict[str, list[float]] = {}
        told = time.monotonic()
        while not self.fault:
            over = self._ended.wait(1.0 / LOOKS_A_SECOND)
            self._look(sums)
            now = time.monotonic()
            if self._progress is not None and sums and now - told >= 1.0:
                told = now
                means = {name: round(sum(values) / len(values), 6) for name, values in sums.items()}
                self.put("values", wall_s=round(now - self._began, 3), means=means)
                sums.clear()
            self._send()
            if over and not self._lines:
                return

    def _look(self, sums: dict[str, list[float]]) -> None:
        progress = self._progress
        if progress is None:
            return
        newest = {"loop": progress.values, **progress.own}
        for stream, channels in progress.streams.items():
            for channel, value in zip(channels, newest.get(stream, ()), strict=False):
                if math.isfinite(value):
                    sums.setdefault(channel.name if stream == "loop" else f"{stream}/{channel.name}", []).append(value)

    def _send(self) -> None:
        """Write what waits, as far as the reader takes it."""
        while self._lines or self._left_out:
            if not self._lines:
                count, self._left_out = self._left_out, 0
                self.put("left_out", lines=count)
            line = self._lines[0]
            try:
                sent = os.write(self._file, line)
            except BlockingIOError:
                return
            except OSError as error:
                self.fault = f"--events {self._path}: {error.strerror}; nothing more was written there"
                return
            if sent < len(line):
                self._lines[0] = line[sent:]
            else:
                self._lines.popleft()
