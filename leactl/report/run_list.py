"""The list of runs as text: one line for each run; in a terminal, long lines are wrapped and indented."""

import sys
import textwrap
from collections.abc import Collection, Sequence
from typing import Any

from leactl.report.terminal import duration, terminal_columns
from leactl.runfile.catalog.selection import differing
from leactl.runfile.summary import Summary

WIDEST_NAME = 50  # characters; `20261120T101530Z-torque-sensor-calibration-7f3a.h5` has 50
INDENT = "    "


def run_list(shown_runs: Sequence[Summary], all_runs: Sequence[Summary], named_parameters: Collection[str]) -> str:
    """Return a line for each run: file, status, duration, actuator, condition and parameters.

    Parameters
    ----------
    all_runs : all runs of the folder; a parameter is shown if it differs among the runs of one protocol.
    named_parameters : names of parameters that are always shown, and `seed` for the seed.
    """
    columns = terminal_columns() if sys.stdout.isatty() else 0
    name_width = min(max((len(run.file) for run in shown_runs), default=0), WIDEST_NAME)
    varied_parameters = differing(all_runs)
    lines = []
    for run in shown_runs:
        if run.fault:
            lines += _wrapped_entry(f"{run.file:<{name_width}}", f"unreadable: {run.fault}", columns)
            continue
        shown_names = {
            name for name in run.parameters if name in named_parameters or (run.protocol, name) in varied_parameters
        }
        protocol = "" if run.protocol in run.file else run.protocol
        details = [
            protocol,
            run.actuator,
            run.condition,
            *([f"seed={run.seed}"] if "seed" in named_parameters and run.seed is not None else []),
            *(f"{name}={_value_text(run.parameters[name])}" for name in sorted(shown_names)),
            *([f"tags={','.join(run.tags)}"] if run.tags else []),
        ]
        run_text = f"{run.file:<{name_width}}  {run.status:<9} {_duration_text(run.duration):>8}"
        lines += _wrapped_entry(run_text, "  ".join(filter(None, details)), columns)
    return "".join(f"{line}\n" for line in lines)


def _wrapped_entry(head: str, tail: str, columns: int) -> list[str]:
    """Return head and tail on one line; in a terminal that is too narrow, each wrapped and the tail indented."""
    line = f"{head}  {tail}".rstrip()
    if not columns or len(line) <= columns:
        return [line]
    wrap = {"width": columns, "subsequent_indent": INDENT, "break_on_hyphens": False}
    return [*textwrap.wrap(head, **wrap), *textwrap.wrap(tail, initial_indent=INDENT, **wrap)]  # type: ignore[arg-type]


def _value_text(value: Any) -> str:
    """Return the value of a parameter as text without spaces in a list."""
    if isinstance(value, list):
        return f"[{','.join(map(_value_text, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _duration_text(seconds: float) -> str:
    """Return a duration [s] as text: in seconds below a minute, else in minutes and hours."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    return duration(seconds)
