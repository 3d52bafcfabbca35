"""Plots in characters: fitted lines as Braille dots, points as marks; or in plain ASCII for terminals that need it."""

import itertools
import math
from collections.abc import Iterator, Sequence

from leactl.analysis.estimate import Plot, Series

MARKS = "ox+#%@"
SEVERAL_MARK = "*"  # mark of a cell with points of several series
MARGIN = 0.04  # of the range, kept free at both ends
MOST_TICKS = (6, 8)  # along x and y, approximately
# bit of the dot in column x and row y of a Braille character, which has 2 x 4 dots (Unicode 3.0, chart U+2800)
BRAILLE = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


class PlotAxis:
    """One axis of a plot: its range, and ticks at round numbers; a logarithmic axis spaces decades evenly."""

    def __init__(self, values: Sequence[float], ticks: int, log: bool = False) -> None:
        """Set the range to that of the values with a margin, and place about `ticks` ticks.

        `low` and `high` are the ends of the range, or their logarithms to base 10 if `log`.
        """
        self.log = log
        if log:
            values = [math.log10(value) for value in values if value > 0.0] or [0.0, 1.0]
        low, high = min(values), max(values)
        margin = (high - low) * MARGIN or abs(high) * 0.1 or 1.0
        self.low, self.high = low - margin, high + margin
        if log:
            self.ticks = decade_ticks(self.low, self.high, ticks)
            return
        step = round_step((self.high - self.low) / ticks)
        first_tick, last_tick = math.ceil(self.low / step), math.floor(self.high / step)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        self.ticks = {k * step: f"{k * step:.{decimals}f}" for k in range(first_tick, last_tick + 1)}

    def share(self, value: float) -> float:
        """Return the position of a value: 0 at the low end of the axis, 1 at the high end; 0 if it has no logarithm."""
        if self.log:
            value = math.log10(value) if value > 0.0 else self.low
        return (value - self.low) / (self.high - self.low)


def decade_ticks(low: float, high: float, most_ticks: int) -> dict[float, str]:
    """Return up to `most_ticks` ticks from 10^low to 10^high: 1, 2 and 5, or 1 and 3, or 1 of each decade."""
    powers = range(math.floor(low), math.ceil(high) + 1)
    for mantissas in ((1, 2, 5), (1, 3), (1,)):
        ticks = [factor * 10.0**power for power in powers for factor in mantissas]
        ticks_in_range = [value for value in ticks if low <= math.log10(value) <= high]
        if len(ticks_in_range) <= most_ticks:
            break
    return {value: f"{value:g}" for value in ticks_in_range[:: math.ceil(len(ticks_in_range) / most_ticks) or 1]}


def round_step(least_step: float) -> float:
    """Return the smallest step that is 1, 2 or 5 times a power of ten and not below `least_step`."""
    power = 10.0 ** math.floor(math.log10(least_step))
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= least_step * (1 - 1e-9))


def draw(plot: Plot, width: int, height: int = 16, ascii_only: bool = False) -> list[str]:
    """Return the plot as lines of text, none wider than `width`; an empty list if the plot has no finite point."""
    drawable = [series for series in plot.points if any(True for _ in finite_points(series))]
    if not drawable:
        return []
    all_points = [point for series in (*drawable, *plot.lines) for point in finite_points(series)]
    x = PlotAxis([point[0] for point in all_points], MOST_TICKS[0], plot.x_log)
    y = PlotAxis([point[1] for point in all_points], MOST_TICKS[1])
    gutter = max(len(text) for text in y.ticks.values())
    columns = max(width - gutter - 2, 10)
    canvas = Canvas(columns, height, x, y, ascii_only)
    for line in plot.lines:
        canvas.line(list(finite_points(line)))
    for mark, series in zip(MARKS, drawable, strict=False):
        canvas.points(mark, list(finite_points(series)))
    legend_entries = [f"{mark} {series.label}" for mark, series in zip(MARKS, drawable, strict=False)]
    legend_entries += [f"{SEVERAL_MARK} several"] if canvas.overlaps else []
    axis_labels, legend_marks = f"{plot.y_label} over {plot.x_label}:", "   ".join(legend_entries)
    legend_line = f"{axis_labels}  {legend_marks}"
    legend = [legend_line] if len(legend_line) <= width else [axis_labels[:width], legend_marks[:width]]
    return [*legend, *rows_with_axis(canvas, gutter), *x_axis_lines(canvas, gutter)]


def rows_with_axis(canvas: "Canvas", gutter: int) -> list[str]:
    """Return the rows of the canvas with the y axis to their left; tick labels take `gutter` columns."""
    bar, tee = ("|", "+") if canvas.ascii_only else ("│", "┤")
    ticks = {canvas.row(value): text for value, text in canvas.y.ticks.items()}
    return [
        f"{ticks.get(index, ''):>{gutter}} {tee if index in ticks else bar}{''.join(cells)}".rstrip()
        for index, cells in enumerate(canvas.cells)
    ]


def x_axis_lines(canvas: "Canvas", gutter: int) -> list[str]:
    """Return two lines to print below the canvas: the x axis, and its tick labels."""
    corner, stroke, tick = ("+", "-", "+") if canvas.ascii_only else ("└", "─", "┴")
    axis_line = [stroke] * canvas.columns
    for value in canvas.x.ticks:
        axis_line[canvas.column(value)] = tick
    tick_labels = tick_line({canvas.column(value): text for value, text in canvas.x.ticks.items()}, canvas.columns)
    return [f"{'':{gutter}} {corner}{''.join(axis_line)}", f"{'':{gutter}}  {tick_labels}".rstrip()]


def finite_points(series: Series) -> Iterator[tuple[float, float]]:
    """Return the finite points of a series."""
    points = zip(series.x, series.y, strict=True)
    return ((x, y) for x, y in points if math.isfinite(x) and math.isfinite(y))


def tick_line(ticks: dict[int, str], columns: int) -> str:
    """Return one line of tick labels, each centred on its column; labels that would touch are left out."""
    text = ""
    for column, label in sorted(ticks.items()):
        start = min(max(column - len(label) // 2, 0), columns - len(label))
        if start >= len(text) + (1 if text else 0):
            text = text.ljust(start) + label
    return text


class Canvas:
    """A grid of characters to draw on, over two axes; row 0 is the topmost."""

    def __init__(self, columns: int, rows: int, x: PlotAxis, y: PlotAxis, ascii_only: bool) -> None:
        self.columns, self.rows, self.x, self.y, self.ascii_only = columns, rows, x, y, ascii_only
        self.cells = [[" "] * columns for _ in range(rows)]
        self.overlaps = False  # whether a cell has points of several series
        self._dots_per_cell = (1, 1) if ascii_only else (2, 4)
        self._first_marks: dict[tuple[int, int], str] = {}  # by row and column
        self._braille_bits: dict[tuple[int, int], int] = {}  # by row and column

    def column(self, value: float) -> int:
        """Return the column of a value along x."""
        return cell_index(self.x.share(value), self.columns)

    def row(self, value: float) -> int:
        """Return the row of a value along y."""
        return cell_index(1.0 - self.y.share(value), self.rows)

    def points(self, mark: str, points: Sequence[tuple[float, float]]) -> None:
        """Set a mark at each point (x, y); a cell that has another mark gets `SEVERAL_MARK`."""
        for x, y in points:
            row, column = self.row(y), self.column(x)
            if self._first_marks.setdefault((row, column), mark) != mark:
                self.overlaps, shown_mark = True, SEVERAL_MARK
            else:
                shown_mark = mark
            self.cells[row][column] = shown_mark

    def line(self, points: Sequence[tuple[float, float]]) -> None:
        """Draw straight lines from point to point, in Braille dots, or in one dot a character in ASCII."""
        dot_columns, dot_rows = self.columns * self._dots_per_cell[0], self.rows * self._dots_per_cell[1]
        for (x0, y0), (x1, y1) in itertools.pairwise(points):
            across0, down0 = self.x.share(x0) * dot_columns, (1.0 - self.y.share(y0)) * dot_rows
            across1, down1 = self.x.share(x1) * dot_columns, (1.0 - self.y.share(y1)) * dot_rows
            steps = math.ceil(max(abs(across1 - across0), abs(down1 - down0), 1.0))
            for k in range(steps + 1):
                share = k / steps
                across = min(int(across0 + share * (across1 - across0)), dot_columns - 1)
                down = min(int(down0 + share * (down1 - down0)), dot_rows - 1)
                self._set_dot(across, down)

    def _set_dot(self, across: int, down: int) -> None:
        """Set one dot; `across` and `down` count dots from the top left corner of the canvas."""
        (column, x), (row, y) = divmod(across, self._dots_per_cell[0]), divmod(down, self._dots_per_cell[1])
        if self._dots_per_cell == (1, 1):
            self.cells[row][column] = "."
            return
        bits = self._braille_bits.get((row, column), 0) | BRAILLE[x][y]
        self._braille_bits[row, column] = bits
        self.cells[row][column] = chr(0x2800 + bits)


def cell_index(share: float, count: int) -> int:
    """Return the index, from 0 to `count` - 1, of the cell at a share of the axis, which is cut to 0 to 1."""
    return min(max(int(share * count), 0), count - 1)
