"""Rows of a run as lines of text, a column for each channel."""

from collections.abc import Iterator

from leactl.runfile.read.tail import StreamRows

LEAST_WIDTH = 10  # characters of a column: six digits, a sign, a point and room between two
DIGITS = 6
TIME = "time s"


class RowPrinter:
    """A printer of rows of several streams; a heading opens the first row and each change of stream."""

    def __init__(self, columns: int | None) -> None:
        """Take the width of the terminal in characters; None where lines may be of any length."""
        self._columns, self._stream = columns, ""
        self.left_out: tuple[str, ...] = ()  # channels that have no room beside the others

    def lines(self, rows: StreamRows) -> Iterator[str]:
        """Yield a line for each row, after a heading where the stream changes."""
        headings = [f"{name} {unit}".rstrip() for name, unit in zip(rows.names, rows.units, strict=True)]
        widths = [max(len(heading) + 2, LEAST_WIDTH) for heading in headings]
        shown = self._shown(rows.stream, widths)
        self.left_out = rows.names[shown:]
        if rows.stream != self._stream:
            self._stream = rows.stream
            cells = [f"{heading:>{width}}" for heading, width in zip(headings[:shown], widths, strict=False)]
            yield f"# {rows.stream}: {TIME}".ljust(self._first(rows.stream)) + "".join(cells)
        for time, values in zip(rows.time.tolist(), rows.values.tolist(), strict=True):
            cells = [f"{value:>{width}.{DIGITS}g}" for value, width in zip(values[:shown], widths, strict=False)]
            yield f"{time:>{self._first(rows.stream)}.{DIGITS}f}" + "".join(cells)

    @staticmethod
    def _first(stream: str) -> int:
        """Return the width of the column of times, whose heading begins with the stream's name."""
        return max(len(f"# {stream}: {TIME}"), 2 * DIGITS)

    def _shown(self, stream: str, widths: list[int]) -> int:
        """Return how many columns fit into the terminal, one at least."""
        if self._columns is None:
            return len(widths)
        room = self._columns - self._first(stream)
        fitting = [count for count in range(1, len(widths) + 1) if sum(widths[:count]) <= room]
        return max(fitting, default=1)
