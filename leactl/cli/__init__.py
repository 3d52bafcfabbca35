"""The commands: one file a noun, each parses, calls and prints. What a command needs is imported when it runs."""

import math
import os

import typer

# Matrix products here are small: threads of theirs that wait for a core which another process has cost as much time as
# the work. Read when NumPy is first imported; whoever sets it otherwise is heeded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def finite(value: float | list[float] | None) -> float | list[float] | None:
    """Raise `typer.BadParameter` for an option that is NaN or infinite: click's own ranges let NaN pass below 8.2."""
    for number in value if isinstance(value, list) else [value]:
        if number is not None and not math.isfinite(number):
            raise typer.BadParameter(f"{number} is not a finite number")
    return value
