"""Steps of a long computation on stderr: one line that is rewritten on a terminal, plain lines anywhere else."""

import signal
import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn

from leactl.errors import Stopped


class Steps:
    """A callable that shows each step of a computation as it begins, and at the end the total duration.

    Raises
    ------
    Stopped : a Ctrl-C was swallowed by a callback of a library before this step.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(file=sys.__stderr__ if sys.stderr.isatty() else sys.stderr)
        self._start_s = time.monotonic()
        self._interrupted = False
        self._shown: Progress | None = None
        if self._console.is_terminal:
            columns = (TextColumn("{task.description} ...", markup=False), TimeElapsedColumn())
            self._shown = Progress(*columns, console=self._console, transient=True, refresh_per_second=4)
            self._task = self._shown.add_task("reading")

    def __call__(self, step: str) -> None:
        """Show the step that begins; stop here where Ctrl-C was pressed before."""
        if self._interrupted:
            raise Stopped("stopped")
        if self._shown is not None:
            self._shown.update(self._task, description=step)
        else:
            self._say(f"{step} ...")

    def __enter__(self) -> Self:
        self._before = signal.signal(signal.SIGINT, self._stop)
        self._unraisable, sys.unraisablehook = sys.unraisablehook, self._dropped
        if self._shown is not None:
            self._shown.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)
        sys.unraisablehook = self._unraisable
        if self._shown is not None:
            self._shown.stop()
        if kind is None:
            self._say(f"done in {time.monotonic() - self._start_s:.1f} s")

    def _stop(self, number: int, frame: object) -> None:
        # an exception in a callback of HDF5 or in a finalizer is dropped, so that the next step checks this flag
        self._interrupted = True
        raise KeyboardInterrupt

    def _dropped(self, unraisable: "sys.UnraisableHookArgs") -> None:
        """Hide the trace of a swallowed Ctrl-C from the terminal; the next step stops the computation."""
        if not (self._interrupted and isinstance(unraisable.exc_value, KeyboardInterrupt)):
            self._unraisable(unraisable)

    def _say(self, line: str) -> None:
        print(line, file=self._console.file, flush=True)
