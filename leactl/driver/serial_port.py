"""One serial line to one device, without threads: lines of text out and in.

No method waits unless it is given a time, so that a slow instrument can be used from within a fast loop.
"""

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from leactl.driver.clock import Clock
from leactl.errors import DeviceError

LONGEST_LINE = 256  # bytes, unless a driver expects more; of a longer line only the end is kept
MOST_LINES = 64  # lines in the queue; further lines drop the oldest


class SerialLine(Protocol):
    """A connection: a serial device of this machine, or the near end of an emulated line."""

    def read(self, timeout: float) -> bytes:
        """Bytes that have arrived; waits at most `timeout` seconds for the first.

        Raises
        ------
        OSError : the device is gone.
        """

    def write(self, data: bytes) -> int:
        """Write as many bytes as are accepted at once; returns their number.

        Raises
        ------
        OSError : the device is gone.
        """

    def close(self) -> None:
        """Close the line and drop bytes that are not sent yet."""


class SerialPort:
    """Lines of one device, each ended by `line_end`; a carriage return before it is removed."""

    def __init__(self, connect: Callable[[], SerialLine], clock: Clock, name: str = "serial") -> None:
        self._connect = connect
        self.clock = clock
        self.name = name
        self.line_end = b"\n"  # of both directions; the driver of a device with another one sets it
        self.longest_line = LONGEST_LINE
        self._line: SerialLine | None = None
        self._users = 0
        self._begun = b""
        self._lines: deque[bytes] = deque(maxlen=MOST_LINES)

    @property
    def connected(self) -> bool:
        """Whether there is a connection, dead or alive."""
        return self._line is not None

    def open(self) -> None:
        """Connect for the first user of the port, and count the users.

        Raises
        ------
        DeviceError : the device is absent or refuses.
        """
        if self._line is None:
            self._open_line()
        self._users += 1

    def close(self) -> None:
        """Disconnect when the last user has closed the port."""
        self._users = max(0, self._users - 1)
        if self._users == 0:
            self._shut()

    def reopen(self) -> None:
        """Replace a connection that may be dead by a new one.

        Raises
        ------
        DeviceError : the device is absent or refuses.
        """
        self._shut()
        self._open_line()

    def write(self, data: bytes) -> None:
        """Send bytes; never waits.

        Raises
        ------
        DeviceError : the line is closed or gone, or takes no more because the device holds it up.
        """
        if self._line is None:
            raise DeviceError(f"bus '{self.name}': not open")
        try:
            taken = self._line.write(data)
        except OSError as error:
            raise self._gone(error) from None
        if taken < len(data):
            raise DeviceError(f"bus '{self.name}': {len(data) - taken} of {len(data)} bytes were not taken")

    def take_line(self) -> bytes | None:
        """The oldest complete line, without its end; None if there is none; never waits.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        if not self._lines:
            self._receive(0.0)
        return self._lines.popleft() if self._lines else None

    def wait(self, moment: float) -> None:
        """Wait for a complete line, at most until this moment on the clock.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        while not self._lines and (seconds_left := moment - self.clock.now()) > 0.0:
            self._receive(seconds_left)

    def discard(self) -> None:
        """Drop all lines that have arrived, complete or not.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        self._receive(0.0)
        self._forget()

    def _receive(self, timeout: float) -> None:
        if self._line is None:
            raise DeviceError(f"bus '{self.name}': not open")
        try:
            read = self._line.read(timeout)
        except OSError as error:
            raise self._gone(error) from None
        *lines, begun = (self._begun + read).split(self.line_end)
        self._lines.extend(line[-self.longest_line :].rstrip(b"\r") for line in lines)
        self._begun = begun[-self.longest_line :]

    def _open_line(self) -> None:
        try:
            self._line = self._connect()
        except (OSError, ValueError, ImportError) as error:
            raise DeviceError(f"bus '{self.name}': {error}") from None

    def _shut(self) -> None:
        self._forget()
        line, self._line = self._line, None
        if line is not None:
            with suppress(OSError):  # it is gone already, which is what was asked for
                line.close()

    def _forget(self) -> None:
        self._lines.clear()
        self._begun = b""

    def _gone(self, error: OSError) -> DeviceError:
        return DeviceError(f"bus '{self.name}': the device is gone: {error}")
