"""The live view of a run: step, progress, time left, and the newest value of every channel.

On a terminal it is a picture, painted over four times a second; on a pipe, a file or a terminal that cannot move its
cursor it is a line every few seconds. It draws from a thread of its own and only reads what the loop has left for it.
A terminal that takes nothing (Ctrl-S, a dead connection) holds that thread and nothing else: the view is left behind,
never waited for.
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
FIRST_LINE_S = 5.0  # a run that is over before needs no line
SLOWEST_LINE_S = 30.0
LINES_A_DECADE = 10  # a line once a tenth of the time so far has passed again: long runs fill no log
WARM_DEGC = 50.0  # from which on it is told how long a winding can go on
PATIENCE_S = 1.0  # how long a view may take to clear the screen
CELL = 40  # characters a name and its value need side by side
WIDEST_CELL = 56  # beyond which a value stands too far from its name to be read with it
WIDEST_BAR = 120
SHORT = {"q_axis_": "", "_reference": " ref", "drive_enabled": "enabled", "_": " "}
HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
TO_THE_TOP, CLEAR_LINE, CLEAR_BELOW = "\x1b[H", "\x1b[K", "\x1b[J"


@contextmanager
def live_view(progress: Progress, console: Console) -> Iterator[None]:
    """Show a run while the block lasts.

    What goes wrong with the view is left in `progress.view_fault`.
    """
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
    """The same terminal by a descriptor of its own: a write that never ends holds no lock that the run's end needs."""
    encoding = encoding_of(console.file)
    try:
        copy = os.dup(console.file.fileno())
    except (OSError, io.UnsupportedOperation):
        return console
    return Console(file=os.fdopen(copy, "w", encoding=encoding, errors="replace"), force_terminal=console.is_terminal)


def _paint(progress: Progress, console: Console, wait: Callable[[float], bool]) -> None:
    """Paint frames over each other until `wait` says that the run has ended, then clear them away.

    A terminal that is resized folds or cuts what stands on it in ways of its own, and a question to the operator is
    written by another thread: then nobody knows where the last frame lies, and the next begins at the top.
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
    """From the last line of a frame to the start of its first."""
    return f"\x1b[{height - 1}A\r" if height > 1 else "\r"


def _size(console: Console) -> tuple[int, int]:
    """Columns and lines as they are now: COLUMNS and LINES do not follow a window."""
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
    """A run as it stands, in one line."""
    values = ", ".join(f"{name} {value}" for name, value in _values(progress))
    parts = [f"{progress.title}: {progress.step or 'starting'}", _how_far(progress), _so_far(progress), values]
    parts += [f"warning: {progress.warnings[-1]}"] if progress.warnings else []
    return "; ".join(filter(None, [*parts, progress.pause, progress.prompt or progress.hint]))


def draw(progress: Progress, width: int, height: int, encoding: str = "utf-8") -> list[Text]:
    """One frame for a terminal of this size.

    Where not all fits, the values go first, then title and bar; how to stop the run goes last.
    """
    across = width - 1  # a line that fills the terminal wraps on some
    below = [(f"warning: {progress.warnings[-1]}", "bold yellow")] if progress.warnings else []
    if progress.prompt:
        below.append((f"{progress.prompt}  {HOW}", "bold yellow"))
    elif progress.hint:
        below += [(text, "bold") for text in (progress.pause, progress.hint) if text]
    foot = [Text(line, style) for text, style in below for line in textwrap.wrap(_plain(text, encoding), across)]
    foot = foot[-height:]
    step = _beside(progress.step or "starting", _how_far(progress), across, encoding)
    title = _beside(progress.title, _so_far(progress), across, encoding, "bold")
    room = height - len(foot)
    head = [title, step, _bar(progress.share, min(across, WIDEST_BAR), encoding)] if room > 2 else [step][:room]
    return [*head, *_table(_values(progress), across, room - len(head), encoding), *foot]


def _how_far(progress: Progress) -> str:
    remaining = progress.left_s
    return f"{progress.share:.0%}" + (f", {duration(remaining)} left" if math.isfinite(remaining) else "")


def _so_far(progress: Progress) -> str:
    return f"{duration(progress.done_s)} of {duration(progress.total_s)}"


def _bar(share: float, width: int, encoding: str) -> Text:
    """What is done in another character than what is not: colours may be switched off."""
    done, open_ = "━─" if shows_all(encoding) else "#-"
    filled = round(share * width)
    return Text.assemble((done * filled, "green"), (open_ * (width - filled), "dim"))


def _beside(name: str, value: str, width: int, encoding: str, style: str = "") -> Text:
    """A name at the left and a value at the right, which stays whole as long as it can where the name is cut."""
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
    """Values in as many columns as fit, one below the other; the last line counts those that have no room."""
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
        line = [_beside(name, value, across, encoding, "dim") for name, value in cells[row::rows]]
        lines.append(Text("  ").join(line))
    return lines


def _values(progress: Progress) -> list[tuple[str, str]]:
    """Names and values of all channels and windings."""
    cells = []
    for stream, channels in progress.streams.items():
        cells += _cells(channels, progress.values if stream == "loop" else progress.own.get(stream, ()))
    estimates, bounds = progress.windings
    going = progress.time_left() if max(bounds.values(), default=0.0) > WARM_DEGC else {}
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
