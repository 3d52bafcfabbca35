"""Readings of a bench, a line at a time while a run takes them: `leactl bench read --follow`.

A thread prints the lines and only reads what the loop publishes, so that a reader of stdout that takes nothing delays
lines and never the run.
"""

import json
import math
import os
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Final

import numpy as np

from leactl.quantities import ChannelSpec
from leactl.report.run_progress import PATIENCE_S
from leactl.report.run_tail import RowPrinter
from leactl.report.terminal import encoding_of_stdout
from leactl.runfile.read.tail import StreamRows
from leactl.runfile.read.traces import chosen_channels
from leactl.runner.progress import Progress

FIRST_LOOK_S: Final = 1.0  # by then most devices have given a reading; a longer interval would seem to hang
LEAST_PAUSE_S: Final = 0.01
SILENT_S: Final = 5.0  # without a reading before a device is said to be silent


class Looks:
    """The newest row of each stream at each look; NaN where none came since the look before, or that row has none."""

    def __init__(self, bench: str, streams: Mapping[str, Sequence[ChannelSpec]], words: Sequence[str]) -> None:
        """Choose the channels.

        Parameters
        ----------
        bench : name of the bench, for messages and headings.
        streams : the channels of each stream of the bench.
        words : choose channels as in `channel_names`; without any, all but setpoints are read.

        Raises
        ------
        MissingChannel : a word chooses no channel.
        """
        chosen = set(chosen_channels(streams, words, "", f"bench '{bench}'"))
        self._bench = bench
        self._channels = [
            (stream, column, spec)
            for stream, specs in streams.items()
            for column, spec in enumerate(specs)
            if f"{stream}/{spec.name}" in chosen and (words or not spec.quantity.endswith("_reference"))
        ]
        names = [spec.name for _, _, spec in self._channels]
        self.names = tuple(
            name if names.count(name) == 1 else f"{stream}/{name}"
            for name, (stream, _, _) in zip(names, self._channels, strict=True)
        )
        self._units = tuple("" if spec.unit == "1" else spec.unit for _, _, spec in self._channels)
        self._rows: dict[str, Sequence[float]] = {}  # the newest one of each stream at the look before
        self._heard_s = dict.fromkeys((spec.device for _, _, spec in self._channels), 0.0)
        self._silent: set[str] = set()

    def take(self, progress: Progress) -> StreamRows:
        """Return the readings of this moment as one row; a row of the loop that was there before counts as none."""
        newest = {"loop": progress.values, **progress.own}
        fresh = {stream: row for stream, row in newest.items() if row is not self._rows.get(stream)}
        self._rows = newest
        values = [
            fresh[stream][column] if column < len(fresh.get(stream, ())) else math.nan
            for stream, column, _ in self._channels
        ]
        for value, (_, _, spec) in zip(values, self._channels, strict=True):
            if math.isfinite(value):
                self._heard_s[spec.device] = progress.time_s
        time = np.array([progress.time_s])
        return StreamRows(self._bench, self.names, self._units, time, np.array([values]).reshape(1, -1))

    def fallen_silent(self, time_s: float, interval_s: float) -> Iterator[str]:
        """Yield a line for each device whose readings stay away now; a device is named once.

        Parameters
        ----------
        time_s : of the newest look, since the run's start.
        interval_s : time between two looks.
        """
        for device, heard_s in self._heard_s.items():
            if time_s - heard_s >= max(SILENT_S, interval_s) and device not in self._silent:
                self._silent.add(device)
                yield f"{device}: no reading for {time_s - heard_s:.0f} s; its columns are nan until one comes"


class Follower:
    """Prints the readings of a run on stdout, one line in each interval, and its warnings on stderr."""

    def __init__(self, looks: Looks, interval_s: float, as_json: bool) -> None:
        """Take what is printed and how often [s]; JSON has an object on each line."""
        self._looks, self._interval_s, self._as_json = looks, interval_s, as_json
        self._output, self._encoding = os.dup(sys.stdout.fileno()), encoding_of_stdout()
        columns = os.get_terminal_size(self._output).columns if os.isatty(self._output) else 0
        self._printer = RowPrinter(columns or None)
        self.unread: OSError | None = None  # why stdout takes no more lines
        self._fault = ""  # of the printing itself
        self.told: list[str] = []  # warnings that stderr has already

    def stop_cause(self) -> str:
        """Return the cause to stop the run for, since no more lines will come; else an empty text."""
        return self._fault if self.unread is None else f"stdout: {self.unread.strerror}"

    @contextmanager
    def watch(self, progress: Progress) -> Iterator[None]:
        """Print while the block lasts."""
        ended = threading.Event()
        thread = threading.Thread(target=self._print, args=(progress, ended), name="leactl-follow", daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join(PATIENCE_S)
            if thread.is_alive():
                progress.view_fault = f"stdout takes no output; the lines were left behind after {PATIENCE_S:g} s"
            else:
                os.close(self._output)

    def _print(self, progress: Progress, ended: threading.Event) -> None:
        try:
            pause = min(self._interval_s, FIRST_LOOK_S)
            due_s = pause
            shown_s = -math.inf
            while not ended.wait(pause) and self.unread is None:
                if progress.time_s > shown_s:  # else the loop has made no cycle since
                    shown_s = progress.time_s
                    self._print_look(progress)
                due_s = max(due_s + self._interval_s, progress.time_s)  # what a slow reader has missed stays away
                pause = max(LEAST_PAUSE_S, due_s - progress.time_s)
        except Exception as error:  # noqa: BLE001 (a thread that dies in silence would leave a run that nobody sees)
            self._fault = f"the lines have failed: {type(error).__name__}: {error}"

    def _print_look(self, progress: Progress) -> None:
        rows = self._looks.take(progress)
        if self._as_json:
            (row,) = rows.as_json()
            lines = [json.dumps({"event": "reading", "time_s": round(row["time_s"], 6), "values": row["values"]})]
        else:
            lines = list(self._printer.lines(rows))
        self._write("".join(f"{line}\n" for line in lines))
        if left_out := self._printer.left_out.get(rows.stream):  # of no stream where JSON is printed
            self._warn(f"no room for {', '.join(left_out)}: choose by --channel, or widen the terminal")
        looked_s = float(rows.time[0])  # the writing may have waited since
        for text in [*progress.warnings, *self._looks.fallen_silent(looked_s, self._interval_s)]:
            self._warn(f"warning: {text}")

    def _warn(self, text: str) -> None:
        if text not in self.told:
            self.told.append(text)
            with suppress(OSError):  # nobody reads it any more; the run's file has it too
                print(f"leactl: {text}", file=sys.stderr, flush=True)

    def _write(self, text: str) -> None:
        waiting = text.encode(self._encoding, errors="replace")
        try:
            while waiting:
                waiting = waiting[os.write(self._output, waiting) :]
        except OSError as error:
            self.unread = error
