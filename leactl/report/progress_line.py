"""The progress of a long computation on stderr: one line that is rewritten on a terminal, else a line for each step."""

import signal
import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn

from leactl.errors import Stopped


class ProgressLine:
    """A display of each step of a computation, whose name it is called with, and of the total duration at the end.

    Raises
    ------
    Stopped : a call after Ctrl-C raises it if a callback of a library has dropped the KeyboardInterrupt.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(file=sys.__stderr__ if sys.stderr.isatty() else sys.stderr)
        self._start_s = time.monotonic()
        self._interrupted = False
        self._progress: Progress | None = None
        if self._console.is_terminal:
            columns = (TextColumn("{task.description} ...", markup=False), TimeElapsedColumn())
            self._progress = Progress(*columns, console=self._console, transient=True, refresh_per_second=4)
            self._task = self._progress.add_task("reading")

    def __call__(self, step: str) -> None:
        """Show the step that begins.

        Raises
        ------
        Stopped : Ctrl-C was pressed, and a library has dropped its exception.
        """
        if self._interrupted:
            raise Stopped("stopped")
        if self._progress is not None:
            self._progress.update(self._task, description=step)
        else:
            self._print_line(f"{step} ...")

    def __enter__(self) -> Self:
        self._previous_handler = signal.signal(signal.SIGINT, self._stop)
        self._previous_hook, sys.unraisablehook = sys.unraisablehook, self._report_dropped
        if self._progress is not None:
            self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._previous_handler)
        sys.unraisablehook = self._previous_hook
        if self._progress is not None:
            self._progress.stop()
        if kind is None:
            self._print_line(f"done in {time.monotonic() - self._start_s:.1f} s")

    def _stop(self, number: int, frame: object) -> None:
        """Note Ctrl-C, and raise KeyboardInterrupt."""
        # Python drops an exception in a callback of HDF5 or in a finalizer; the next step checks this flag
        self._interrupted = True
        raise KeyboardInterrupt

    def _report_dropped(self, unraisable: "sys.UnraisableHookArgs") -> None:
        """Print no trace of a dropped Ctrl-C, which the next step raises; pass on any other exception."""
        if not (self._interrupted and isinstance(unraisable.exc_value, KeyboardInterrupt)):
            self._previous_hook(unraisable)

    def _print_line(self, line: str) -> None:
        print(line, file=self._console.file, flush=True)
