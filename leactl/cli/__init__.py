"""The commands: one file a noun, each parses, calls and prints. What a command needs is imported when it runs."""

import math

import typer


def finite(value: float | list[float] | None) -> float | list[float] | None:
    """Raise `typer.BadParameter` for an option that is NaN or infinite: click's own ranges let NaN pass below 8.2."""
    for number in value if isinstance(value, list) else [value]:
        if number is not None and not math.isfinite(number):
            raise typer.BadParameter(f"{number} is not a finite number")
    return value
