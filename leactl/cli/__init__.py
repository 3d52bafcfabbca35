"""The commands, one file per noun: each parses its arguments, calls the library and prints the result.

A command imports what it needs when it runs.
"""

import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from leactl.bench.wire_trace import WireTrace

# Matrix products here are small: threads of theirs that wait for a core which another process has cost as much time as
# the work. Read when NumPy is first imported; whoever sets it otherwise is heeded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

TRACE = typer.Option(
    None, "--trace", metavar="FILE", help="Write every byte of every wire; CAN frames apart with .asc, .blf, .log."
)


@contextmanager
def traced_to(path: Path | None) -> "Iterator[WireTrace | None]":
    """Open the trace that `--trace` names, close it after the block, and warn on stderr if lines are missing in it.

    Raises
    ------
    InputError : the file exists or cannot be written.
    """
    if path is None:
        yield None
        return
    from leactl.bench.wire_trace import WireTrace

    trace = WireTrace(path)
    try:
        with trace:
            yield trace
    finally:
        if trace.fault:
            print(f"leactl: warning: {trace.fault}", file=sys.stderr)


def finite(value: float | list[float] | None) -> float | list[float] | None:
    """Raise `typer.BadParameter` for an option that is NaN or infinite: the ranges of click before 8.2 accept NaN."""
    for number in value if isinstance(value, list) else [value]:
        if number is not None and not math.isfinite(number):
            raise typer.BadParameter(f"{number} is not a finite number")
    return value


def print_answer(text: str) -> OSError | None:
    """Print what a run has given; where stdout takes nothing, return the error, which is raised when all else is told.

    Nobody may read stdout any more, or its disk be full: how the run ended is told on stderr all the same.
    """
    try:
        typer.echo(text)
    except OSError as error:
        return error
    return None


def confirmed(question: str) -> bool:
    """Ask the user on stderr only: `typer.confirm` writes a space to stdout, where JSON may follow."""
    typer.echo(f"{question} [y/N]: ", err=True, nl=False)
    answer = sys.stdin.readline()
    if not answer.endswith("\n"):
        typer.echo(err=True)
    return answer.strip().lower() in ("y", "yes")
