"""The live view of a run: step, progress, remaining time, and the newest value of every channel.

A terminal shows frames that are repainted four times a second; a pipe, a file or a terminal that cannot move its cursor
gets a line every few seconds. A thread of its own draws the view, from the `Progress` that the control loop publishes.
A terminal that accepts no output (Ctrl-S, a dead connection) blocks that thread alone; the run does not wait for it.
"""

import io
import math
import os
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

from rich.cells import cell_len, set_cell_size
from rich.console import Console
from rich.text import Text

from leactl.quantities import ChannelSpec
from leactl.report.html import without_control_characters
from leactl.report.terminal import duration, encodable, encoding_of, shows_all
from leactl.runner.operators import HOW_TO_ANSWER
from leactl.runner.progress import Progress

FRAMES_PER_S = 4
FIRST_LINE_S = 5.0  # until the first line; a shorter run has none
LONGEST_PAUSE_S = 30.0  # between two lines
PAUSE_DIVISOR = 10  # the next line comes after a tenth of the time so far, so that long runs write few lines
PATIENCE_S = 1.0  # wait for a view to clear the screen, after which it is left behind
LEAST_CELL_WIDTH = 40  # characters; a name and its value need so many side by side
MOST_CELL_WIDTH = 56  # characters; in wider cells a value is too far from its name
MOST_BAR_WIDTH = 120  # characters
SHORT_FORMS = {"q_axis_": "", "_reference": " ref", "drive_enabled": "enabled", "_": " "}
HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
TO_THE_TOP, CLEAR_LINE, CLEAR_BELOW = "\x1b[H", "\x1b[K", "\x1b[J"


@contextmanager
def live_view(progress: Progress, console: Console) -> Iterator[None]:
    """Show a run while the block lasts; a fault of the view goes to `progress.view_fault`."""
    show = _paint if console.is_terminal and not console.is_dumb_terminal else _write
    ended = threading.Event()
    thread = threading.Thread(target=_run_view, args=(show, progress, console, ended), name="leactl-view", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(PATIENCE_S)
        if thread.is_alive():
            progress.view_fault = f"stderr takes no output; the view was left behind after {PATIENCE_S:g} s"


def _run_view(
    show: Callable[[Progress, Console, Callable[[float], bool]], None],
    progress: Progress,
    console: Console,
    ended: threading.Event,
) -> None:
    """Call `show` until the run ends; if it raises an error, set `progress.view_fault`."""
    try:
        show(progress, _separate_console(console), ended.wait)
    except Exception as error:  # noqa: BLE001 (a fault of the view must not end the run)
        progress.view_fault = f"the view has failed: {type(error).__name__}: {error}"


def _separate_console(console: Console) -> Console:
    """Return a console on a copy of the descriptor, so that a write that blocks holds no lock of the run."""
    encoding = encoding_of(console.file)
    try:
        copy = os.dup(console.file.fileno())
    except (OSError, io.UnsupportedOperation):
        return console
    return Console(file=os.fdopen(copy, "w", encoding=encoding, errors="replace"), force_terminal=console.is_terminal)


def _paint(progress: Progress, console: Console, wait: Callable[[float], bool]) -> None:
    """Paint frames over each other until `wait` returns true at the end of the run, then clear the last one.

    After a resize or a question to the operator the position of the last frame is not known, and the next frame begins
    at the top of the terminal.
    """
    size, frame_height = _size(console), 0
    console.file.write(HIDE_CURSOR)
    try:
        while not wait(1 / FRAMES_PER_S):
            current_size = _size(console)
            position_unknown = current_size != size or bool(progress.prompt)
            size = current_size
            lines = draw(progress, *size, console.encoding)
            with console.capture() as capture:
                for line in lines:
                    console.print(line, end=f"{CLEAR_LINE}\n", soft_wrap=True, highlight=False)
            return_sequence = TO_THE_TOP if position_unknown else _to_frame_start(frame_height)
            console.file.write(f"{return_sequence}{capture.get().removesuffix(chr(10))}{CLEAR_BELOW}")
            console.file.flush()
            frame_height = len(lines)
    finally:
        console.file.write(f"{_to_frame_start(frame_height)}{CLEAR_BELOW}{SHOW_CURSOR}")
        console.file.flush()


def _to_frame_start(height: int) -> str:
    """Return the escape sequence that moves the cursor from the last line of a frame to the start of its first."""
    return f"\x1b[{height - 1}A\r" if height > 1 else "\r"


def _size(console: Console) -> tuple[int, int]:
    """Return columns and lines of the terminal now, since COLUMNS and LINES do not follow a resized window."""
    try:
        columns, lines = os.get_terminal_size(console.file.fileno())
    except (OSError, io.UnsupportedOperation):
        columns = lines = 0
    return (columns, lines) if columns and lines else (console.width, console.height)


def _write(progress: Progress, console: Console, wait: Callable[[float], bool]) -> None:
    """Write a line every few seconds until `wait` returns true at the end of the run."""
    elapsed_s = 0.0
    while not wait(pause_s := min(max(FIRST_LINE_S, elapsed_s / PAUSE_DIVISOR), LONGEST_PAUSE_S)):
        elapsed_s += pause_s
        text = encodable(without_control_characters(log_line(progress)), console.encoding)
        console.file.write(f"{text}\n")
        console.file.flush()


def log_line(progress: Progress) -> str:
    """Return step, progress, time and newest values of a run in one line."""
    values = ", ".join(f"{name} {value}" for name, value in _values(progress))
    parts = [f"{progress.title}: {progress.step or 'starting'}", _progress_text(progress), _time_text(progress), values]
    parts += [f"warning: {progress.warnings[-1]}"] if progress.warnings else []
    return "; ".join(filter(None, [*parts, progress.pause, progress.prompt or progress.hint]))


def draw(progress: Progress, width: int, height: int, encoding: str = "utf-8") -> list[Text]:
    """Return the lines of one frame for a terminal of this size.

    If the frame is too small, the values are left out first, then title and bar, and last the hint how to stop the run.
    """
    line_width = width - 1  # some terminals wrap a line that fills them
    messages = [(f"warning: {progress.warnings[-1]}", "bold yellow")] if progress.warnings else []
    if progress.prompt:
        messages.append((f"{progress.prompt}  {HOW_TO_ANSWER}", "bold yellow"))
    elif progress.hint:
        messages += [(text, "bold") for text in (progress.pause, progress.hint) if text]
    message_lines = [
        Text(line, style) for text, style in messages for line in textwrap.wrap(_plain(text, encoding), line_width)
    ]
    message_lines = message_lines[-height:]
    step = _name_and_value(progress.step or "starting", _progress_text(progress), line_width, encoding)
    title = _name_and_value(progress.title, _time_text(progress), line_width, encoding, "bold")
    free_height = height - len(message_lines)
    bar = _bar(progress.share, min(line_width, MOST_BAR_WIDTH), encoding)
    head_lines = [title, step, bar] if free_height > 2 else [step][:free_height]
    return [
        *head_lines,
        *_table(_values(progress), line_width, free_height - len(head_lines), encoding),
        *message_lines,
    ]


def _progress_text(progress: Progress) -> str:
    """Return the done part of the plan in percent, and the remaining time if it is known."""
    remaining = progress.left_s
    return f"{progress.share:.0%}" + (f", {duration(remaining)} left" if math.isfinite(remaining) else "")


def _time_text(progress: Progress) -> str:
    """Return the done and the total duration of the plan."""
    return f"{duration(progress.done_s)} of {duration(progress.total_s)}"


def _bar(share: float, width: int, encoding: str) -> Text:
    """Return a bar whose done part has another character as well as another colour, since colours may be off."""
    done_character, undone_character = "━─" if shows_all(encoding) else "#-"
    done_width = round(share * width)
    return Text.assemble((done_character * done_width, "green"), (undone_character * (width - done_width), "dim"))


def _name_and_value(name: str, value: str, width: int, encoding: str, style: str = "") -> Text:
    """Return a line with a name at the left and a value at the right; if it is too long, the name is cut first."""
    value = _plain(value, encoding)
    if cell_len(value) >= width:
        return Text(set_cell_size(value, width))
    name = _plain(name, encoding)
    name_width = width - cell_len(value) - 1
    if cell_len(name) > name_width:
        name = set_cell_size(name, max(name_width - 3, 0)) + "..."[:name_width]
    return Text.assemble((set_cell_size(name, name_width), style), " ", value)


def _plain(text: str, encoding: str) -> str:
    """Return a text on one line, without control characters and characters that the encoding lacks."""
    return encodable(without_control_characters(" ".join(text.split())), encoding)


def _table(cells: Sequence[tuple[str, str]], width: int, height: int, encoding: str) -> list[Text]:
    """Return names and values in as many columns as fit; the last line counts the values for which there is no room."""
    columns = max(1, (width + 1) // LEAST_CELL_WIDTH)
    cell_width = min(MOST_CELL_WIDTH, (width - 2 * (columns - 1)) // columns)
    rows = -(-len(cells) // columns)
    if rows > height:
        if height < 1:
            return []
        shown_count = (height - 1) * columns
        remark = Text(_plain(f"{len(cells) - shown_count} more values in a higher window", encoding)[:width], "dim")
        return [*_table(cells[:shown_count], width, height - 1, encoding), remark]
    lines = []
    for row in range(rows):
        line = [_name_and_value(name, value, cell_width, encoding, "dim") for name, value in cells[row::rows]]
        lines.append(Text("  ").join(line))
    return lines


def _values(progress: Progress) -> list[tuple[str, str]]:
    """Return names and values of all channels and windings."""
    cells = []
    for stream, channels in progress.streams.items():
        cells += _cells(channels, progress.values if stream == "loop" else progress.device_values.get(stream, ()))
    estimates, bounds = progress.windings
    seconds_to_limit = progress.time_to_limit()
    for role, estimate in estimates.items():
        cells.append((f"{role} winding", f"{estimate:.0f}, at most {bounds[role]:.0f} degC"))
        if math.isfinite(seconds_to_limit.get(role, math.inf)):
            cells.append((f"{role} winding at its limit in", duration(seconds_to_limit[role])))
    return cells


def _cells(channels: Sequence[ChannelSpec], values: Sequence[float]) -> list[tuple[str, str]]:
    """Return names and values of the channels of one stream, without setpoints that have no value."""
    cells = []
    for index, channel in enumerate(channels):
        value = values[index] if index < len(values) else math.nan
        if channel.quantity.endswith("_reference") and math.isnan(value):
            continue
        value_text = f"{value:g}" if channel.unit == "1" else f"{value:.3f} {channel.unit}"
        cells.append((f"{channel.role} {_shortened(channel.quantity, SHORT_FORMS)}", value_text))
    return cells


def _shortened(text: str, short_forms: Mapping[str, str]) -> str:
    """Return a text with each of the words replaced by its short form."""
    for word, short_form in short_forms.items():
        text = text.replace(word, short_form)
    return text
