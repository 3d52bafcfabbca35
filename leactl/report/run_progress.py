"""The live view of a run: step, progress, time left, and the newest value of every channel.

A terminal shows frames that are repainted four times a second; a pipe, a file or a terminal that cannot move its cursor
gets a line every few seconds. A separate thread draws the view and only reads what the loop publishes. A terminal that
accepts no output (Ctrl-S, a dead connection) blocks that thread alone; the run does not wait for it.
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
from leactl.runner.operators import HOW
from leactl.runner.progress import Progress

FRAMES_PER_S = 4
FIRST_LINE_S = 5.0  # a shorter run needs no line
SLOWEST_LINE_S = 30.0
LINES_A_DECADE = 10  # the next line comes after a tenth of the time so far, so that long runs write few lines
PATIENCE_S = 1.0  # how long a view may take to clear the screen
CELL = 40  # characters that a name and its value need side by side
WIDEST_CELL = 56  # characters; wider cells separate a value from its name
WIDEST_BAR = 120
SHORT = {"q_axis_": "", "_reference": " ref", "drive_enabled": "enabled", "_": " "}
HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
TO_THE_TOP, CLEAR_LINE, CLEAR_BELOW = "\x1b[H", "\x1b[K", "\x1b[J"


@contextmanager
def live_view(progress: Progress, console: Console) -> Iterator[None]:
    """Show a run while the block lasts; a fault of the view goes to `progress.view_fault`."""
    show = _paint if console.is_terminal and not console.is_dumb_terminal else _write
    ended = threading.Event()
    thread = threading.Thread(target=_shown, args=(show, progress, console, ended), name="leactl-view", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(PATIENCE_S)
        if thread.is_alive():
            progress.view_fault = f"stderr takes no output; the view was left behind after {PATIENCE_S:g} s"


def _shown(
    show: Callable[[Progress, Console, Callable[[float], bool]], None],
    progress: Progress,
    console: Console,
    ended: threading.Event,
) -> None:
    try:
        show(progress, _own_console(console), ended.wait)
    except Exception as error:  # noqa: BLE001 (nothing in a view is worth a run)
        progress.view_fault = f"the view has failed: {type(error).__name__}: {error}"


def _own_console(console: Console) -> Console:
    """Return a console on a copy of the descriptor, so that a write that never ends holds no lock of the run."""
    encoding = encoding_of(console.file)
    try:
        copy = os.dup(console.file.fileno())
    except (OSError, io.UnsupportedOperation):
        return console
    return Console(file=os.fdopen(copy, "w", encoding=encoding, errors="replace"), force_terminal=console.is_terminal)


def _paint(progress: Progress, console: Console, wait: Callable[[float], bool]) -> None:
    """Paint frames over each other until `wait` says that the run has ended, then clear them away.

    After a resize or a question to the operator the position of the last frame is not known, and the next frame begins
    at the top of the terminal.
    """
    size, height = _size(console), 0
    console.file.write(HIDE_CURSOR)
    try:
        while not wait(1 / FRAMES_PER_S):
            now = _size(console)
            lost = now != size or bool(progress.prompt)
            size = now
            lines = draw(progress, *size, console.encoding)
            with console.capture() as capture:
                for line in lines:
                    console.print(line, end=f"{CLEAR_LINE}\n", soft_wrap=True, highlight=False)
            back = TO_THE_TOP if lost else _back(height)
            console.file.write(f"{back}{capture.get().removesuffix(chr(10))}{CLEAR_BELOW}")
            console.file.flush()
            height = len(lines)
    finally:
        console.file.write(f"{_back(height)}{CLEAR_BELOW}{SHOW_CURSOR}")
        console.file.flush()


def _back(height: int) -> str:
    """Return the escape sequence from a frame's last line to the start of its first."""
    return f"\x1b[{height - 1}A\r" if height > 1 else "\r"


def _size(console: Console) -> tuple[int, int]:
    """Return columns and lines of the terminal now, since COLUMNS and LINES do not follow a resized window."""
    try:
        columns, lines = os.get_terminal_size(console.file.fileno())
    except (OSError, io.UnsupportedOperation):
        columns = lines = 0
    return (columns, lines) if columns and lines else (console.width, console.height)


def _write(progress: Progress, console: Console, wait: Callable[[float], bool]) -> None:
    """Write a line every few seconds until `wait` says that the run has ended."""
    passed = 0.0
    while not wait(pause := min(max(FIRST_LINE_S, passed / LINES_A_DECADE), SLOWEST_LINE_S)):
        passed += pause
        text = encodable(without_control_characters(log_line(progress)), console.encoding)
        console.file.write(f"{text}\n")
        console.file.flush()


def log_line(progress: Progress) -> str:
    """Return step, progress, time and newest values of a run in one line."""
    values = ", ".join(f"{name} {value}" for name, value in _values(progress))
    parts = [f"{progress.title}: {progress.step or 'starting'}", _how_far(progress), _so_far(progress), values]
    parts += [f"warning: {progress.warnings[-1]}"] if progress.warnings else []
    return "; ".join(filter(None, [*parts, progress.pause, progress.prompt or progress.hint]))


def draw(progress: Progress, width: int, height: int, encoding: str = "utf-8") -> list[Text]:
    """Return the lines of one frame for a terminal of this size.

    Where not all fits, the values are left out first, then title and bar; the hint how to stop the run stays longest.
    """
    across = width - 1  # a line that fills the terminal wraps on some
    below = [(f"warning: {progress.warnings[-1]}", "bold yellow")] if progress.warnings else []
    if progress.prompt:
        below.append((f"{progress.prompt}  {HOW}", "bold yellow"))
    elif progress.hint:
        below += [(text, "bold") for text in (progress.pause, progress.hint) if text]
    foot = [Text(line, style) for text, style in below for line in textwrap.wrap(_plain(text, encoding), across)]
    foot = foot[-height:]
    step = _name_and_value(progress.step or "starting", _how_far(progress), across, encoding)
    title = _name_and_value(progress.title, _so_far(progress), across, encoding, "bold")
    room = height - len(foot)
    head = [title, step, _bar(progress.share, min(across, WIDEST_BAR), encoding)] if room > 2 else [step][:room]
    return [*head, *_table(_values(progress), across, room - len(head), encoding), *foot]


def _how_far(progress: Progress) -> str:
    remaining = progress.left_s
    return f"{progress.share:.0%}" + (f", {duration(remaining)} left" if math.isfinite(remaining) else "")


def _so_far(progress: Progress) -> str:
    return f"{duration(progress.done_s)} of {duration(progress.total_s)}"


def _bar(share: float, width: int, encoding: str) -> Text:
    """Return a bar whose done part differs from the rest in its character too, since colours may be off."""
    done, open_ = "━─" if shows_all(encoding) else "#-"
    filled = round(share * width)
    return Text.assemble((done * filled, "green"), (open_ * (width - filled), "dim"))


def _name_and_value(name: str, value: str, width: int, encoding: str, style: str = "") -> Text:
    """Return a line with a name at the left and a value at the right; the name is cut before the value is."""
    value = _plain(value, encoding)
    if cell_len(value) >= width:
        return Text(set_cell_size(value, width))
    name = _plain(name, encoding)
    room = width - cell_len(value) - 1
    if cell_len(name) > room:
        name = set_cell_size(name, max(room - 3, 0)) + "..."[:room]
    return Text.assemble((set_cell_size(name, room), style), " ", value)


def _plain(text: str, encoding: str) -> str:
    return encodable(without_control_characters(" ".join(text.split())), encoding)


def _table(cells: Sequence[tuple[str, str]], width: int, height: int, encoding: str) -> list[Text]:
    """Return names and values in as many columns as fit; the last line counts those that do not."""
    columns = max(1, (width + 1) // CELL)
    across = min(WIDEST_CELL, (width - 2 * (columns - 1)) // columns)
    rows = -(-len(cells) // columns)
    if rows > height:
        if height < 1:
            return []
        shown = (height - 1) * columns
        more = Text(_plain(f"{len(cells) - shown} more values in a higher window", encoding)[:width], "dim")
        return [*_table(cells[:shown], width, height - 1, encoding), more]
    lines = []
    for row in range(rows):
        line = [_name_and_value(name, value, across, encoding, "dim") for name, value in cells[row::rows]]
        lines.append(Text("  ").join(line))
    return lines


def _values(progress: Progress) -> list[tuple[str, str]]:
    """Return names and values of all channels and windings."""
    cells = []
    for stream, channels in progress.streams.items():
        cells += _cells(channels, progress.values if stream == "loop" else progress.own.get(stream, ()))
    estimates, bounds = progress.windings
    going = progress.time_to_limit()
    for role, estimate in estimates.items():
        cells.append((f"{role} winding", f"{estimate:.0f}, at most {bounds[role]:.0f} degC"))
        if math.isfinite(going.get(role, math.inf)):
            cells.append((f"{role} winding at its limit in", duration(going[role])))
    return cells


def _cells(channels: Sequence[ChannelSpec], values: Sequence[float]) -> list[tuple[str, str]]:
    cells = []
    for index, channel in enumerate(channels):
        value = values[index] if index < len(values) else math.nan
        if channel.quantity.endswith("_reference") and math.isnan(value):
            continue
        shown = f"{value:g}" if channel.unit == "1" else f"{value:.3f} {channel.unit}"
        cells.append((f"{channel.role} {_shortened(channel.quantity, SHORT)}", shown))
    return cells


def _shortened(text: str, words: Mapping[str, str]) -> str:
    for long, short in words.items():
        text = text.replace(long, short)
    return text
