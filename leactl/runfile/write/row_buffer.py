"""Buffer rows between control loop and disk: the loop fills one array while the writer empties the other."""

import math
import struct
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

INITIAL_ROWS = 4096  # of a stream's buffer; it grows if a flush comes late


class RowBuffer:
    """Rows of one stream, with the stamp in column 0; the buffer grows until `take` empties it."""

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._row = struct.Struct(f"={channels + 1}d")  # packing takes half the time of assignments to the array
        self._rows = np.empty((INITIAL_ROWS, channels + 1))
        self._spare = np.empty_like(self._rows)
        self._count = 0
        self._last = -math.inf
        self._lock = threading.Lock()

    def append_row(self, time: float, values: Sequence[float]) -> None:
        """Add one row.

        Raises
        ------
        ValueError : wrong number of values, or a stamp that is not after the last one.
        """
        if len(values) != self._channels:  # numpy would spread a single value over the whole row
            raise ValueError(f"{len(values)} values for {self._channels} channels")
        with self._lock:
            if not self._last < time < math.inf:
                raise ValueError(f"time {time!r} does not come after {self._last!r}")
            count = self._count
            if count == len(self._rows):
                self._grow(count + 1)
            self._row.pack_into(self._rows, count * self._row.size, time, *values)  # type: ignore[arg-type]
            self._last = time
            self._count = count + 1

    def append(self, stamps: np.ndarray[Any, Any], values: np.ndarray[Any, Any]) -> None:
        """Add rows, `stamps` (n,) and `values` (n, channels): all of them, or none if one is wrong.

        Raises
        ------
        ValueError : wrong shapes, or stamps that do not increase.
        """
        stamps = np.asarray(stamps, "f8")
        values = np.asarray(values, "f8")
        if stamps.ndim != 1 or values.shape != (len(stamps), self._channels):
            raise ValueError(f"block of shape {values.shape} for {stamps.shape} stamps and {self._channels} channels")
        if not len(stamps):
            return
        with self._lock:
            if not (np.isfinite(stamps).all() and stamps[0] > self._last and (stamps[1:] > stamps[:-1]).all()):
                raise ValueError(f"times do not increase strictly after {self._last!r}")
            end = self._count + len(stamps)
            if end > len(self._rows):
                self._grow(end)
            self._rows[self._count : end, 0] = stamps
            self._rows[self._count : end, 1:] = values
            self._last = float(stamps[-1])
            self._count = end

    def take(self) -> np.ndarray[Any, Any]:
        """Return the rows so far, (n, 1 + channels), and empty the buffer; the array is valid until the next call."""
        with self._lock:
            rows, self._rows = self._rows, self._spare
            self._spare = rows
            filled_rows = rows[: self._count]
            self._count = 0
            return filled_rows

    def _grow(self, least_rows: int) -> None:
        """Move the rows to an array of at least `least_rows` rows and at least twice the present size."""
        rows = np.empty((max(least_rows, 2 * len(self._rows)), self._channels + 1))
        rows[: self._count] = self._rows[: self._count]
        self._rows = rows
