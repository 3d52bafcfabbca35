"""Plot of a run's channels over time in characters: one panel for each channel, with the steps of the run below it."""

import itertools
from collections.abc import Sequence

import numpy as np

from leactl.report.html import without_control_characters
from leactl.report.plot import Canvas, PlotAxis, rows_with_axis, x_axis_lines
from leactl.report.terminal import encodable, encoding_of_stdout, shows_all
from leactl.runfile.read.reader import Step
from leactl.runfile.read.traces import ChannelTrace

MOST_TICKS = (6, 4)  # along time and value, approximately: a panel has few rows
ROWS_BESIDE_CANVAS = 5  # of a panel: title, axis, tick labels, steps, a blank line
LEAST_CANVAS_ROWS, MOST_CANVAS_ROWS = 5, 16
SHADES = ("░", "-")  # characters for every other step, in Unicode and in ASCII


def panels_text(
    traces: Sequence[ChannelTrace], steps: Sequence[Step], span_s: tuple[float, float], width: int, screen_rows: int
) -> str:
    """Return panels for stdout that show the time span `span_s` (start and stop [s]) and share the screen's rows."""
    encoding = encoding_of_stdout()
    height = min(max(screen_rows // max(len(traces), 1) - ROWS_BESIDE_CANVAS, LEAST_CANVAS_ROWS), MOST_CANVAS_ROWS)
    lines = panels(traces, steps, span_s, width, height, not shows_all(encoding))
    return encodable("\n".join(lines) + "\n", encoding)


def panels(
    traces: Sequence[ChannelTrace],
    steps: Sequence[Step],
    span_s: tuple[float, float],
    width: int,
    height: int,
    ascii_only: bool = False,
) -> list[str]:
    """Return lines of text, none wider than `width`, one panel of `height` rows below the other.

    The panels show the time span `span_s` (start and stop [s]). A channel without a finite sample in that span has a
    line that says so in place of its panel.
    """
    start, stop = span_s
    time = PlotAxis([start, stop], MOST_TICKS[0])
    axes = [value_axis(trace) for trace in traces]
    labels = [label for axis in axes if axis for label in axis.ticks.values()]
    gutter = max(map(len, labels), default=0)
    columns = max(width - gutter - 2, 10)
    lines: list[str] = []
    for trace, axis in zip(traces, axes, strict=True):
        channel = trace.channel
        title = f"{trace.name}: {channel.quantity or 'quantity not given'} of {channel.role or 'no role'}"
        lines.append(without_control_characters(f"{title} [{channel.units}]")[:width])
        if axis is None:
            lines += ["  no value in this part of the run", ""]
            continue
        canvas = Canvas(columns, height, time, axis, ascii_only)
        for segment in segments(trace):
            canvas.line(segment)
        lines += [*rows_with_axis(canvas, gutter), *x_axis_lines(canvas, gutter)]
        if ruler := step_ruler(steps, canvas, start, stop):
            lines.append(f"{'':{gutter}}  {ruler}".rstrip())
        lines.append("")
    return [*lines, "time in s"]


def value_axis(trace: ChannelTrace) -> PlotAxis | None:
    """Return the value axis of a trace over its finite values; None without finite values."""
    finite_values = trace.values[np.isfinite(trace.values)]
    return (
        PlotAxis([float(finite_values.min()), float(finite_values.max())], MOST_TICKS[1])
        if len(finite_values)
        else None
    )


def segments(trace: ChannelTrace) -> list[list[tuple[float, float]]]:
    """Return the stretches of a trace between its missing samples, so that no line is drawn across a gap."""
    points = zip(trace.time.tolist(), trace.values.tolist(), strict=True)
    groups = itertools.groupby(points, key=lambda point: bool(np.isfinite(point[1])))
    stretches = [list(group) for is_finite, group in groups if is_finite]
    return [stretch if len(stretch) > 1 else stretch * 2 for stretch in stretches]  # a lone sample is a dot


def step_ruler(steps: Sequence[Step], canvas: Canvas, start: float, stop: float) -> str:
    """Return one line that shades every other step and names those that are wide enough for their name."""
    characters = [" "] * canvas.columns
    for index, step in enumerate(steps):
        if step.stop <= start or step.start >= stop:
            continue
        first_column, end_column = canvas.column(max(step.start, start)), canvas.column(min(step.stop, stop))
        shade = SHADES[canvas.ascii_only] if index % 2 else " "
        characters[first_column:end_column] = [shade] * (end_column - first_column)
        if len(step.name) < end_column - first_column:
            characters[first_column : first_column + len(step.name)] = without_control_characters(step.name)
    return "".join(characters).rstrip()
