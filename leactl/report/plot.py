"""A plot made of characters: fitted lines as fine dots, points as letters; ASCII where nothing else can be shown."""

import itertools
import math
from collections.abc import Iterator, Sequence

from leactl.analysis.estimate import Plot, Series

MARKS = "ox+#%@"
SEVERAL = "*"  # points of two kinds in one place
MARGIN = 0.04  # of the range, free around the points
TICKS = (6, 8)  # at most about so many along x and y
# Braille, 2 x 4 dots a character, Unicode 3.0 chart U+2800: bit of the dot in column x, row y
BRAILLE = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


class PlotAxis:
    """One direction of the plot: its range, and ticks at round numbers; `log` spaces decades evenly."""

    def __init__(self, values: Sequence[float], ticks: int, log: bool = False) -> None:
        self.log = log
        if log:
            values = [math.log10(value) for value in values if value > 0.0] or [0.0, 1.0]
        low, high = min(values), max(values)
        room = (high - low) * MARGIN or abs(high) * 0.1 or 1.0
        self.low, self.high = low - room, high + room
        if log:
            self.ticks = decades(self.low, self.high, ticks)
            return
        step = round_step((self.high - self.low) / ticks)
        first, last = math.ceil(self.low / step), math.floor(self.high / step)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        self.ticks = {k * step: f"{k * step:.{digits}f}" for k in range(first, last + 1)}

    def share(self, value: float) -> float:
        """Where a value lies, 0 to 1 from low to high; what no logarithm takes lies at the low end."""
        if self.log:
            value = math.log10(value) if value > 0.0 else self.low
        return (value - self.low) / (self.high - self.low)


def decades(low: float, high: float, most: int) -> dict[float, str]:
    """Ticks of a logarithmic axis between two powers of ten: 1, 2 and 5 of each decade, or whole decades alone."""
    powers = range(math.floor(low), math.ceil(high) + 1)
    for mantissas in ((1, 2, 5), (1, 3), (1,)):
        ticks = [factor * 10.0**power for power in powers for factor in mantissas]
        inside = [value for value in ticks if low <= math.log10(value) <= high]
        if len(inside) <= most:
            break
    return {value: f"{value:g}" for value in inside[:: math.ceil(len(inside) / most) or 1]}


def round_step(least: float) -> float:
    """The next 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= least * (1 - 1e-9))


def draw(plot: Plot, width: int, height: int = 16, ascii_only: bool = False) -> list[str]:
    """Lines of text, none wider than `width`; empty where there are no finite points."""
    shown = [series for series in plot.points if any(True for _ in pairs(series))]
    if not shown:
        return []
    pairs_shown = [pair for series in (*shown, *plot.lines) for pair in pairs(series)]
    x = PlotAxis([pair[0] for pair in pairs_shown], TICKS[0], plot.x_log)
    y = PlotAxis([pair[1] for pair in pairs_shown], TICKS[1])
    gutter = max(len(text) for text in y.ticks.values())
    columns = max(width - gutter - 2, 10)
    canvas = Canvas(columns, height, x, y, ascii_only)
    for line in plot.lines:
        canvas.line(list(pairs(line)))
    for mark, series in zip(MARKS, shown, strict=False):
        canvas.points(mark, list(pairs(series)))
    names = [f"{mark} {series.label}" for mark, series in zip(MARKS, shown, strict=False)]
    names += [f"{SEVERAL} several"] if canvas.overlaps else []
    labels, marks = f"{plot.y_label} over {plot.x_label}:", "   ".join(names)
    legend = [f"{labels}  {marks}"] if len(labels) + 2 + len(marks) <= width else [labels[:width], marks[:width]]
    return [*legend, *rows_with_axis(canvas, gutter), *floor_with_axis(canvas, gutter)]


def rows_with_axis(canvas: "Canvas", gutter: int) -> list[str]:
    """The canvas with its y axis to the left, tick labels in a gutter of so many columns."""
    bar, tee = ("|", "+") if canvas.ascii_only else ("│", "┤")
    ticks = {canvas.row(value): text for value, text in canvas.y.ticks.items()}
    return [
        f"{ticks.get(index, ''):>{gutter}} {tee if index in ticks else bar}{''.join(cells)}".rstrip()
        for index, cells in enumerate(canvas.cells)
    ]


def floor_with_axis(canvas: "Canvas", gutter: int) -> list[str]:
    """The x axis below the canvas and its tick labels."""
    corner, flat, tick = ("+", "-", "+") if canvas.ascii_only else ("└", "─", "┴")
    floor = [flat] * canvas.columns
    for value in canvas.x.ticks:
        floor[canvas.column(value)] = tick
    under = tick_line({canvas.column(value): text for value, text in canvas.x.ticks.items()}, canvas.columns)
    return [f"{'':{gutter}} {corner}{''.join(floor)}", f"{'':{gutter}}  {under}".rstrip()]


def pairs(series: Series) -> Iterator[tuple[float, float]]:
    """Finite points."""
    both = zip(series.x, series.y, strict=True)
    return ((x, y) for x, y in both if math.isfinite(x) and math.isfinite(y))


def tick_line(ticks: dict[int, str], columns: int) -> str:
    """Tick texts below their places, those left out that would touch the one before."""
    text = ""
    for column, label in sorted(ticks.items()):
        start = min(max(column - len(label) // 2, 0), columns - len(label))
        if start >= len(text) + (1 if text else 0):
            text = text.ljust(start) + label
    return text


class Canvas:
    """Cells of characters, the topmost row first."""

    def __init__(self, columns: int, rows: int, x: PlotAxis, y: PlotAxis, ascii_only: bool) -> None:
        self.columns, self.rows, self.x, self.y, self.ascii_only = columns, rows, x, y, ascii_only
        self.cells = [[" "] * columns for _ in range(rows)]
        self.overlaps = False
        self._fine = (1, 1) if ascii_only else (2, 4)
        self._marked: dict[tuple[int, int], str] = {}
        self._dots: dict[tuple[int, int], int] = {}

    def column(self, value: float) -> int:
        """The column of a value along x."""
        return cell_index(self.x.share(value), self.columns)

    def row(self, value: float) -> int:
        """The row of a value along y."""
        return cell_index(1.0 - self.y.share(value), self.rows)

    def points(self, mark: str, points: Sequence[tuple[float, float]]) -> None:
        """Set a mark at each point."""
        for x, y in points:
            row, column = self.row(y), self.column(x)
            if self._marked.setdefault((row, column), mark) != mark:
                self.overlaps, shown_mark = True, SEVERAL
            else:
                shown_mark = mark
            self.cells[row][column] = shown_mark

    def line(self, points: Sequence[tuple[float, float]]) -> None:
        """Draw from point to point in the finest dots there are."""
        wide, high = self.columns * self._fine[0], self.rows * self._fine[1]
        for (x0, y0), (x1, y1) in itertools.pairwise(points):
            a0, b0 = self.x.share(x0) * wide, (1.0 - self.y.share(y0)) * high
            a1, b1 = self.x.share(x1) * wide, (1.0 - self.y.share(y1)) * high
            steps = math.ceil(max(abs(a1 - a0), abs(b1 - b0), 1.0))
            for k in range(steps + 1):
                share = k / steps
                self._dot(min(int(a0 + share * (a1 - a0)), wide - 1), min(int(b0 + share * (b1 - b0)), high - 1))

    def _dot(self, across: int, down: int) -> None:
        (column, x), (row, y) = divmod(across, self._fine[0]), divmod(down, self._fine[1])
        if self._fine == (1, 1):
            self.cells[row][column] = "."
            return
        bits = self._dots.get((row, column), 0) | BRAILLE[x][y]
        self._dots[row, column] = bits
        self.cells[row][column] = chr(0x2800 + bits)


def cell_index(share: float, count: int) -> int:
    """The cell of a share of the way, from 0 to count - 1."""
    return min(max(int(share * count), 0), count - 1)
