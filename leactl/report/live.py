"""The live view of a run in a terminal: step, progress, time left, and the newest value of every channel.

It draws from a thread of its own four times a second and only reads what the loop has left for it. A terminal that
takes nothing (Ctrl-S, a dead connection) holds that thread and nothing else: the view is left behind, never waited for.
"""

import io
import math
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from leactl.quantities import ChannelSpec
from leactl.runner.operators import HOW
from leactl.runner.progress import Progress

FRAMES_PER_S = 4
WARM_DEGC = 50.0  # from which on it is told how long a winding can go on
PATIENCE_S = 1.0  # how long a view may take to clear the screen
SHORT = {"q_axis_": "", "_reference": " ref", "drive_enabled": "enabled", "_": " "}


@contextmanager
def live_view(progress: Progress, console: Console) -> Iterator[None]:
    """Show a run while the block lasts; a console that is no terminal shows nothing.

    What goes wrong with the view is left in `progress.view_fault`.
    """
    if not console.is_terminal:
        yield
        return
    ended = threading.Event()
    thread = threading.Thread(target=_show, args=(progress, console, ended), name="leactl-view", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(PATIENCE_S)
        if thread.is_alive():
            progress.view_fault = f"the terminal takes no output; the view was left behind after {PATIENCE_S:g} s"


def _show(progress: Progress, console: Console, ended: threading.Event) -> None:
    try:
        own = _apart(console)
        with Live(
            console=own,
            get_renderable=lambda: draw(progress, own.width),
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        ) as live:
            while not ended.wait(1 / FRAMES_PER_S):
                live.refresh()
    except Exception as error:  # noqa: BLE001 (nothing in a view is worth a run)
        progress.view_fault = f"the view has failed: {type(error).__name__}: {error}"


def _apart(console: Console) -> Console:
    """The same terminal by a descriptor of its own: a write that never ends holds no lock that the run's end needs."""
    try:
        place = os.dup(console.file.fileno())
    except (OSError, io.UnsupportedOperation):
        return console
    return Console(file=os.fdopen(place, "w", encoding="utf-8", errors="replace"), force_terminal=True)


def draw(progress: Progress, width: int) -> RenderableType:
    """One frame for a terminal of this width."""
    left = progress.left_s
    head = Table.grid(expand=True, padding=(0, 1))
    head.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    head.add_column(justify="right", no_wrap=True)
    head.add_row(Text(progress.title, style="bold"), f"{duration(progress.done_s)} of {duration(progress.total_s)}")
    shown = f"{progress.share:.0%}" + (f", {duration(left)} left" if math.isfinite(left) else "")
    head.add_row(Text(progress.step or "starting"), shown)
    bar = ProgressBar(total=1.0, completed=progress.share, width=min(width, 120))
    parts: list[RenderableType] = [head, bar, _channels(progress, width)]
    if progress.warnings:
        parts.append(Text(f"warning: {progress.warnings[-1]}", style="bold yellow"))
    if progress.prompt:
        parts.append(Text(f"{progress.prompt}  {HOW}", style="bold yellow"))
    elif progress.hint:
        parts.append(Text(progress.hint, style="bold"))
    return Group(*parts)


def duration(seconds: float) -> str:
    """`75` as `1:15`, `4000` as `1:06:40`."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _channels(progress: Progress, width: int) -> Table:
    """Values in as many columns as fit, one block a role."""
    cells = []
    for stream, channels in progress.streams.items():
        values = progress.values if stream == "loop" else progress.own.get(stream, ())
        cells += _cells(channels, values)
    estimates, bounds = progress.windings
    going = progress.time_left() if max(bounds.values(), default=0.0) > WARM_DEGC else {}
    for role, estimate in estimates.items():
        cells.append((f"{role} winding", f"{estimate:.0f}, at most {bounds[role]:.0f} degC"))
        if math.isfinite(going.get(role, math.inf)):
            cells.append((f"{role} winding at its limit in", duration(going[role])))
    columns = max(1, width // 40)
    table = Table.grid(expand=False, padding=(0, 2))
    for _ in range(columns):
        table.add_column(no_wrap=True, overflow="ellipsis", max_width=22)
        table.add_column(justify="right", no_wrap=True, min_width=13)
    rows = -(-len(cells) // columns)
    for row in range(rows):
        line: list[Any] = []
        for name, value in cells[row::rows]:
            line += [Text(name, style="dim"), Text(value)]
        table.add_row(*line)
    return table


def _cells(channels: Sequence[ChannelSpec], values: Sequence[float]) -> list[tuple[str, str]]:
    cells = []
    for place, channel in enumerate(channels):
        value = values[place] if place < len(values) else math.nan
        if channel.quantity.endswith("_reference") and math.isnan(value):
            continue
        cells.append((f"{channel.role} {_shortened(channel.quantity, SHORT)}", f"{value:.3f} {channel.unit}"))
    return cells


def _shortened(text: str, words: Mapping[str, str]) -> str:
    for long, short in words.items():
        text = text.replace(long, short)
    return text
