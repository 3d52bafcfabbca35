"""Print the newest readings of a bench at intervals while a run takes them: `leactl bench read --follow`.

A thread of its own prints the lines, from the `Progress` that the control loop publishes. Where the reader of stdout
takes no lines, that thread waits and the run does not.
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
from leactl.report.run_tail import RowFormatter
from leactl.report.terminal import encoding_of_stdout
from leactl.runfile.read.tail import StreamRows
from leactl.runfile.read.traces import chosen_channels
from leactl.runner.progress import Progress

FIRST_LINE_S: Final = 1.0  # until the first line: most devices have a reading then, and nobody suspects a hang
LEAST_PAUSE_S: Final = 0.01  # between two lines
SILENT_AFTER_S: Final = 5.0  # time without a reading, after which a device counts as silent


class ReadingSampler:
    """A sampler of the newest value of each chosen channel of a bench.

    A value is NaN where its stream has no new row since the last sample, or where the row has none for the channel.
    """

    def __init__(self, bench: str, streams: Mapping[str, Sequence[ChannelSpec]], channel_words: Sequence[str]) -> None:
        """Choose the channels to sample.

        Parameters
        ----------
        bench : name of the bench, for messages and headings.
        streams : the channels of each stream of the bench.
        channel_words : names of channels as `channel_names` takes them; without any, all but setpoints are chosen.

        Raises
        ------
        MissingChannel : a word is the name of no channel.
        """
        chosen_names = set(chosen_channels(streams, channel_words, "", f"bench '{bench}'"))
        self._bench = bench
        self._channels = [
            (stream, column, spec)
            for stream, specs in streams.items()
            for column, spec in enumerate(specs)
            if f"{stream}/{spec.name}" in chosen_names and (channel_words or not spec.quantity.endswith("_reference"))
        ]
        names = [spec.name for _, _, spec in self._channels]
        self.names = tuple(
            name if names.count(name) == 1 else f"{stream}/{name}"
            for name, (stream, _, _) in zip(names, self._channels, strict=True)
        )
        self._units = tuple("" if spec.unit == "1" else spec.unit for _, _, spec in self._channels)
        self._last_rows: dict[str, Sequence[float]] = {}  # by stream, as of the last sample
        self._last_reading_s = dict.fromkeys((spec.device for _, _, spec in self._channels), 0.0)
        self._silent_devices: set[str] = set()  # that have been reported

    def sample(self, progress: Progress) -> StreamRows:
        """Return the newest readings as one row; a row that the last sample had already does not count."""
        newest_rows = {"loop": progress.values, **progress.device_values}
        new_rows = {stream: row for stream, row in newest_rows.items() if row is not self._last_rows.get(stream)}
        self._last_rows = newest_rows
        values = [
            new_rows[stream][column] if column < len(new_rows.get(stream, ())) else math.nan
            for stream, column, _ in self._channels
        ]
        for value, (_, _, spec) in zip(values, self._channels, strict=True):
            if math.isfinite(value):
                self._last_reading_s[spec.device] = progress.time_s
        time = np.array([progress.time_s])
        return StreamRows(self._bench, self.names, self._units, time, np.array([values]).reshape(1, -1))

    def newly_silent(self, time_s: float, interval_s: float) -> Iterator[str]:
        """Yield a warning for each device that has become silent; each device is reported once.

        A device is silent if it has had no reading for SILENT_AFTER_S and for `interval_s`.

        Parameters
        ----------
        time_s : time of the newest sample since the start of the run.
        interval_s : time between two samples.
        """
        for device, last_s in self._last_reading_s.items():
            if time_s - last_s >= max(SILENT_AFTER_S, interval_s) and device not in self._silent_devices:
                self._silent_devices.add(device)
                yield f"{device}: no reading for {time_s - last_s:.0f} s; its columns are nan until one comes"


class Follower:
    """A printer of the readings of a run on stdout, one line in each interval, and of its warnings on stderr."""

    def __init__(self, sampler: ReadingSampler, interval_s: float, as_json: bool) -> None:
        """Prepare to print a sample every `interval_s` seconds: in columns, or as JSON with an object on each line."""
        self._sampler, self._interval_s, self._as_json = sampler, interval_s, as_json
        self._output, self._encoding = os.dup(sys.stdout.fileno()), encoding_of_stdout()
        columns = os.get_terminal_size(self._output).columns if os.isatty(self._output) else 0
        self._formatter = RowFormatter(columns or None)
        self.stdout_error: OSError | None = None  # why stdout takes no more lines
        self._printing_fault = ""  # an unexpected error of the printing thread; empty without one
        self.printed_warnings: list[str] = []  # on stderr

    def stop_cause(self) -> str:
        """Return the cause to stop the run once no more lines can be printed; empty before."""
        return self._printing_fault if self.stdout_error is None else f"stdout: {self.stdout_error.strerror}"

    @contextmanager
    def watch(self, progress: Progress) -> Iterator[None]:
        """Print while the block lasts; `progress.view_fault` says if stdout took no output at its end."""
        ended = threading.Event()
        thread = threading.Thread(target=self._print_until, args=(ended, progress), name="leactl-follow", daemon=True)
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

    def _print_until(self, ended: threading.Event, progress: Progress) -> None:
        """Print a sample in each interval of run time, until the run ends or stdout takes no more."""
        try:
            pause = min(self._interval_s, FIRST_LINE_S)
            due_s = pause
            printed_s = -math.inf
            while not ended.wait(pause) and self.stdout_error is None:
                if progress.time_s > printed_s:  # else the control loop has made no new cycle
                    printed_s = progress.time_s
                    self._print_sample(progress)
                due_s = max(due_s + self._interval_s, progress.time_s)  # lines that a slow reader missed are skipped
                pause = max(LEAST_PAUSE_S, due_s - progress.time_s)
        except Exception as error:  # noqa: BLE001 (the run has to stop when nothing more is printed)
            self._printing_fault = f"the lines have failed: {type(error).__name__}: {error}"

    def _print_sample(self, progress: Progress) -> None:
        """Print one line of readings, and every warning of the run that has not been printed."""
        rows = self._sampler.sample(progress)
        if self._as_json:
            (row,) = rows.as_json()
            lines = [json.dumps({"event": "reading", "time_s": round(row["time_s"], 6), "values": row["values"]})]
        else:
            lines = list(self._formatter.lines(rows))
        self._write("".join(f"{line}\n" for line in lines))
        if omitted_channels := self._formatter.omitted_channels.get(rows.stream):  # empty where JSON is printed
            self._warn(f"no room for {', '.join(omitted_channels)}: choose by --channel, or widen the terminal")
        sampled_s = float(rows.time[0])  # not progress.time_s: writing the line may have taken long
        for text in [*progress.warnings, *self._sampler.newly_silent(sampled_s, self._interval_s)]:
            self._warn(f"warning: {text}")

    def _warn(self, text: str) -> None:
        """Print a text on stderr, unless it has been printed before."""
        if text not in self.printed_warnings:
            self.printed_warnings.append(text)
            with suppress(OSError):  # stderr has no reader; the run's file has the warning too
                print(f"leactl: {text}", file=sys.stderr, flush=True)

    def _write(self, text: str) -> None:
        """Write a text to stdout; if that fails, store the error in `stdout_error`."""
        unwritten = text.encode(self._encoding, errors="replace")
        try:
            while unwritten:
                unwritten = unwritten[os.write(self._output, unwritten) :]
        except OSError as error:
            self.stdout_error = error
