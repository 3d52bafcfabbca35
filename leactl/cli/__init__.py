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

# The matrix products are small: where other processes hold the cores, waiting threads of OpenBLAS cost as much time as
# the work. NumPy reads the variable at its first import; a value that the user has set stays.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

TRACE = typer.Option(
    None, "--trace", metavar="FILE", help="Write every byte of every wire; CAN frames apart with .asc, .blf, .log."
)


@contextmanager
def traced_to(path: Path | None) -> "Iterator[WireTrace | None]":
    """Open the trace file of `--trace`, close it after the block, and warn on stderr if lines are missing in it.

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
    """Return the value of an option; raise `typer.BadParameter` if it is NaN or infinite.

    Ranges of click before 8.2 accept NaN.
    """
    for number in value if isinstance(value, list) else [value]:
        if number is not None and not math.isfinite(number):
            raise typer.BadParameter(f"{number} is not a finite number")
    return value


def print_answer(text: str) -> OSError | None:
    """Print the answer of a command on stdout, and return the error if stdout cannot be written.

    Stdout may have no reader any more, or its disk may be full. The caller raises the error after it has printed on
    stderr how the run ended.
    """
    try:
        typer.echo(text)
    except OSError as error:
        return error
    return None


def confirmed(question: str) -> bool:
    """Ask the user on stderr, and return whether the answer is yes.

    `typer.confirm` writes a space to stdout, where JSON may follow.
    """
    typer.echo(f"{question} [y/N]: ", err=True, nl=False)
    answer = sys.stdin.readline()
    if not answer.endswith("\n"):
        typer.echo(err=True)
    return answer.strip().lower() in ("y", "yes")
