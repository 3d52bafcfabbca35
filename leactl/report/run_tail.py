"""Rows of a run as lines of text, with a column for each channel."""

from collections.abc import Iterator
from typing import Final, NamedTuple

from leactl.runfile.read.tail import StreamRows


class Precision(NamedTuple):
    """Digits of the numbers in a row, and widths of its columns in characters."""

    decimals: int  # of the time
    digits: int  # significant digits of a value
    time_width: int
    least_width: int  # of a value's column: a space, sign, digits, point, and an exponent such as e-05


FULL_PRECISION: Final = Precision(decimals=6, digits=6, time_width=12, least_width=14)
NARROW_PRECISION: Final = Precision(decimals=3, digits=4, time_width=9, least_width=11)
LEAST_WIDTH_FOR_FULL = 40  # characters of a terminal; in a narrower one, rows have fewer digits
TIME_HEADING = "time s"


class RowFormatter:
    """Formats rows of several streams as lines; a heading comes before the first row and at each change of stream."""

    def __init__(self, terminal_width: int | None) -> None:
        """Set the width of the terminal in characters, or None for lines of any length."""
        self._terminal_width, self._stream = terminal_width, ""
        self._precision = (
            NARROW_PRECISION if terminal_width is not None and terminal_width < LEAST_WIDTH_FOR_FULL else FULL_PRECISION
        )
        self.omitted_channels: dict[str, tuple[str, ...]] = {}  # by stream: channels that do not fit into the terminal

    def lines(self, rows: StreamRows) -> Iterator[str]:
        """Yield a line for each row; before them, if the stream has changed, its name and the names of its columns.

        Without rows there is no line.
        """
        if not len(rows):
            return
        decimals, digits, time_width, _ = self._precision
        headings = [f"{name} {unit}".rstrip() for name, unit in zip(rows.names, rows.units, strict=True)]
        widths = self._shown_widths(headings)
        self.omitted_channels[rows.stream] = rows.names[len(widths) :]
        if rows.stream != self._stream:
            self._stream = rows.stream
            yield f"# {rows.stream}"[: self._terminal_width]
            cells = [f" {heading[: width - 1]:>{width - 1}}" for heading, width in zip(headings, widths, strict=False)]
            yield f"#{TIME_HEADING:>{time_width - 1}}" + "".join(cells)
        for time, values in zip(rows.time.tolist(), rows.values.tolist(), strict=True):
            cells = [f"{value:>{width}.{digits}g}" for value, width in zip(values, widths, strict=False)]
            yield f"{time:>{time_width}.{decimals}f}" + "".join(cells)

    def _shown_widths(self, headings: list[str]) -> list[int]:
        """Return the widths of the columns that fit into the terminal; the first column is always among them."""
        widths = [max(len(heading) + 2, self._precision.least_width) for heading in headings]
        if self._terminal_width is None:
            return widths
        free_width = self._terminal_width - self._precision.time_width
        fitting_counts = [count for count in range(1, len(widths) + 1) if sum(widths[:count]) <= free_width]
        return widths[: max(fitting_counts)] if fitting_counts else [max(free_width, self._precision.least_width)]
