"""A planned or finished drill as text, a finished one as Markdown, and the progress of a drill on the terminal."""

import io
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from leactl.report.plan import peaks
from leactl.report.terminal import encodable, encoding_of_stdout, list_line, terminal_columns, wrapped
from leactl.runner.drill.finding import Drilled, DrillFinding, PlannedDrill, Tell

LEAST_TABLE_WIDTH = 72  # characters
MOST_TABLE_WIDTH = 160  # characters; the longest reason then takes two lines
LEAST_NAME_WIDTH, LEAST_END_WIDTH = 19, 13  # characters: of a fault's name, of the final state of the devices
VERDICT_WIDTH, AFTER_WIDTH, NO_TORQUE_WIDTH = 3, 6, 7  # characters


def print_drill(drilled: Drilled) -> None:
    """Print a finished drill in the width of the terminal, or in 80 columns into a pipe."""
    sys.stdout.write(render(drilled, terminal_columns(), encoding_of_stdout()))


def render(drilled: Drilled, width: int = 80, encoding: str = "utf-8") -> str:
    """Return the whole drill as text for a stream of this width and encoding."""
    width = min(max(width, LEAST_TABLE_WIDTH), MOST_TABLE_WIDTH)
    text_width = width - VERDICT_WIDTH - AFTER_WIDTH - NO_TORQUE_WIDTH - 5  # a space between two columns
    name_width, end_width = max(LEAST_NAME_WIDTH, text_width // 3), max(LEAST_END_WIDTH, text_width // 4)
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(width=VERDICT_WIDTH)
    table.add_column("rehearsed", overflow="fold", width=name_width)
    table.add_column("ended by", overflow="fold", width=text_width - name_width - end_width)
    table.add_column("after, s", justify="right", width=AFTER_WIDTH)
    table.add_column("no torque, s", justify="right", width=NO_TORQUE_WIDTH)
    table.add_column("end", overflow="fold", width=end_width)
    for finding in drilled.findings:
        table.add_row("ok" if finding.held else "NOT", *_cells(finding))
    buffer = io.StringIO()
    Console(file=buffer, width=width, color_system=None, markup=False, highlight=False, emoji=False).print(table)
    lines = [line.rstrip() for line in buffer.getvalue().splitlines()]
    lines += ["", *(wrapped("NOT AS IT OUGHT:", [text], width) for text in _failures(drilled))]
    lines += [wrapped("note:", [text], width) for text in _notes(drilled)]
    lines += [wrapped("not rehearsed:", [f"{name}: {reason}"], width) for name, reason in drilled.left_out.items()]
    lines.append(wrapped(summary(drilled), [], width))
    return encodable("\n".join(lines) + "\n", encoding)


def planned_body(drill: PlannedDrill) -> dict[str, Any]:
    """Return a planned drill as a JSON object: each rehearsal with its longest duration and peak demands."""
    return {
        "bench": drill.bench,
        "emulated": drill.emulated,
        "devices": list(drill.devices),
        "rehearsals": [
            {
                "name": rehearsal.name,
                "on": rehearsal.on,
                "explained": rehearsal.explained,
                "duration_s": rehearsal.plan.duration_s,
                "peaks": peaks(rehearsal.plan),
            }
            for rehearsal in drill.rehearsals
        ],
        "not_rehearsed": [{"name": name, "why": reason} for name, reason in drill.left_out.items()],
    }


def planned_text(body: Mapping[str, Any]) -> str:
    """Return a planned drill as text.

    Parameters
    ----------
    body : the document that `--json` prints.
    """
    lines = []
    for rehearsal in body["rehearsals"]:
        demands = [f"{peak['role']} {peak['quantity']} {peak['value']:g} {peak['unit']}" for peak in rehearsal["peaks"]]
        name = " ".join(filter(None, (rehearsal["name"], rehearsal["on"])))
        lines.append(f"{name}: {rehearsal['duration_s']:.1f} s at most, {', '.join(demands) or 'drives off'}")
        lines.append(list_line("  ", rehearsal["explained"]))
    lines += [
        list_line("not rehearsed: ", f"{omission['name']}: {omission['why']}") for omission in body["not_rehearsed"]
    ]
    lines.append(list_line("would open ", ", ".join(body["devices"]) or "no device"))
    bench_kind = "emulated in this process" if body["emulated"] else "real or served; each is asked for before"
    lines.append(f"{body['bench']} ({bench_kind}): {len(body['rehearsals'])} would be rehearsed; nothing was moved")
    return "\n".join(lines)


def markdown(drilled: Drilled) -> str:
    """Return the whole drill as a page of Markdown without a heading."""
    lines = [summary(drilled), "", "| | rehearsed | ended by | after, s | no torque after, s | end |", "|" + "---|" * 6]
    for finding in drilled.findings:
        cells = ["ok" if finding.held else "**NOT**", *_cells(finding)]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    lines += ["", *(f"- not as it ought: {text}" for text in _failures(drilled))]
    lines += [f"- {text}" for text in _notes(drilled)]
    lines += [f"- not rehearsed: {name}: {reason}" for name, reason in drilled.left_out.items()]
    return "\n".join(lines) + "\n"


def summary(drilled: Drilled) -> str:
    """Return a sentence on the number of rehearsals, and the number of those that ended as they should."""
    passed_count = sum(finding.held for finding in drilled.findings)
    bench_kind = "emulated" if drilled.emulated else "real or served"
    return f"{drilled.bench} ({bench_kind}): {len(drilled.findings)} rehearsed, {passed_count} ended as they ought to"


def _failures(drilled: Drilled) -> list[str]:
    """Return a line for each rehearsal that did not end as it should."""
    return [f"{_name(finding)}: {'; '.join(finding.faults)}" for finding in drilled.findings if not finding.held]


def _notes(drilled: Drilled) -> list[str]:
    """Return a line for each note on a rehearsal."""
    return [f"{_name(finding)}: {note}" for finding in drilled.findings for note in finding.notes]


def _name(finding: DrillFinding) -> str:
    """Return a fault's name, the device that it acts on, and its parameters."""
    parameters = [
        f"{name} {value:g}" if isinstance(value, float) else f"0x{value:X}" if name == "code" else _flag(name, value)
        for name, value in finding.parameters.items()
        if name != "unit"
    ]
    return " ".join(filter(None, (finding.name, finding.on, *parameters)))


def _flag(name: str, value: object) -> str:
    """Return the name of a parameter that is true, else its value."""
    return name if value is True else str(value)


def _cells(finding: DrillFinding) -> tuple[str, ...]:
    """Return the cells of a fault's row after its verdict."""
    return (
        _name(finding),
        finding.reason or finding.status,
        "" if finding.ended_s is None else f"{finding.ended_s:.2f}",
        "" if finding.zero_torque_s is None else f"{finding.zero_torque_s:.2f}",
        _final_state(finding),
    )


def _final_state(finding: DrillFinding) -> str:
    """Return the devices that still have power, and those whose safe state is not confirmed; else `safe`."""
    powered_devices = [name for name, state in finding.devices.items() if state.without_power is False]
    unconfirmed_devices = [
        name for name, state in finding.devices.items() if not state.confirmed and name not in powered_devices
    ]
    prefix = "off, " if finding.zero_torque_s is not None else ""
    texts = [f"{', '.join(powered_devices)} HAS POWER"] if powered_devices else []
    texts += [f"{', '.join(unconfirmed_devices)} {prefix}not confirmed"] if unconfirmed_devices else []
    return "; ".join(texts) or "safe"


@contextmanager
def progress(console: Console | None = None) -> Iterator[Tell]:
    """Show the fault that is rehearsed and the remaining time: one line on a terminal, else a line for each fault.

    Yields the function to call with the name of the rehearsal, the number of finished ones and the number of all.
    """
    console = console or Console(file=sys.__stderr__ if sys.stderr.isatty() else sys.stderr)
    start_time = time.monotonic()
    if not console.is_terminal:

        def print_line(rehearsal: str, done: int, count: int) -> None:
            remaining_text = (
                f", about {(time.monotonic() - start_time) / done * (count - done):.0f} s left" if done else ""
            )
            print(f"{done + 1} of {count}: {rehearsal}{remaining_text}", file=console.file, flush=True)

        yield print_line
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, refresh_per_second=4) as bar:
        task: TaskID = bar.add_task("")

        def advance(rehearsal: str, done: int, count: int) -> None:
            bar.update(task, description=f"{done + 1} of {count}: {rehearsal}", completed=done, total=count)

        yield advance
