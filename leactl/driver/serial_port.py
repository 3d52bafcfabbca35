"""One serial line to one device, without threads: lines of text or binary frames, out and in.

No method waits unless it is given a time, so that a slow instrument can be used from within a fast loop. Bytes stay in
the order in which they came, whether a driver takes lines or frames of them.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, Protocol

from leactl.driver.clock import Clock
from leactl.errors import DeviceError

LONGEST_LINE = 256  # bytes, unless a driver sets another length; only the end of a longer line is kept


class FrameCut(NamedTuple):
    """What a `Framing` finds at the beginning of the bytes that have arrived."""

    noise: int  # bytes that cannot begin a frame, whatever follows; they are dropped, and the rest is framed again
    length: int  # of the frame behind them, even if it has not arrived in full; 0: more bytes are needed to find it


Framing = Callable[[bytes], FrameCut]
"""Finds the first frame of a binary protocol in one byte or more, by its header, length and checksum.

The result depends on the bytes alone, never on how they were delivered: a USB adapter splits a frame and closes the
gap between two frames as it likes. A checksum is therefore checked here: a frame that fails it may be noise, or may
have hidden the beginning of a valid one, so that only its first byte is noise.
"""


class SerialLine(Protocol):
    """A connection: a serial device of this machine, an instrument's socket, or the near end of an emulated line."""

    def read(self, timeout: float) -> bytes:
        """Return bytes that have arrived; wait at most `timeout` seconds for the first byte.

        Raises
        ------
        OSError : the device is gone.
        """

    def write(self, data: bytes) -> int:
        """Write as many bytes as are accepted at once; return their number.

        Raises
        ------
        OSError : the device is gone.
        """

    def close(self) -> None:
        """Close the line and drop bytes that are not sent yet."""


class SerialPort:
    """Lines of one device, each ended by `line_end` (a carriage return before it is removed), or frames of bytes."""

    def __init__(self, connect: Callable[[], SerialLine], clock: Clock, name: str = "serial") -> None:
        self._connect = connect
        self.clock = clock
        self.name = name
        self.line_end = b"\n"  # of both directions; the driver of a device with another one sets it
        self.longest_line = LONGEST_LINE  # bytes kept of a line, and of a frame whose length is not known yet
        self.rest_s = 0.0  # a device loses a write that follows the last one sooner; `write` itself does not wait
        self._line: SerialLine | None = None
        self._users = 0
        self._received = b""
        self._last_received = -math.inf  # time [s] at which bytes came last, or the line was opened
        self._last_written = -math.inf

    @property
    def rested_at(self) -> float:
        """Moment on the clock from which the device takes another write, `rest_s` after the last write [s]."""
        return self._last_written + self.rest_s

    @property
    def heard_at(self) -> float:
        """Moment on the clock at which bytes came last, or the line was opened [s]."""
        return self._last_received

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
            self._disconnect()

    def reopen(self) -> None:
        """Replace a connection that may be dead by a new one.

        Raises
        ------
        DeviceError : the device is absent or refuses.
        """
        self._disconnect()
        self._open_line()

    def write(self, data: bytes) -> None:
        """Send bytes; never wait.

        Raises
        ------
        DeviceError : the line is closed or gone, or takes no more because the device holds it up.
        """
        if self._line is None:
            raise DeviceError(f"bus '{self.name}': not open")
        self._last_written = self.clock.now()
        try:
            accepted = self._line.write(data)
        except OSError as error:
            raise self._gone_error(error) from None
        if accepted < len(data):
            raise DeviceError(f"bus '{self.name}': {len(data) - accepted} of {len(data)} bytes were not taken")

    def take_line(self) -> bytes | None:
        """Return the oldest complete line, without its end; None if there is none; never wait.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        line = self._take(self._frame_by_line_end)
        return None if line is None else line.removesuffix(self.line_end)[-self.longest_line :].rstrip(b"\r")

    def take_frame(self, framing: Framing) -> bytes | None:
        """Return the oldest complete frame by this rule, and drop noise before it; None if there is none; never wait.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        return self._take(framing)

    def take_until_silent(self, seconds: float) -> bytes | None:
        """Return all bytes that have arrived, once none has come for `seconds`; None before; never wait.

        It is for answers without an end, a length or a checksum; `seconds` must be longer than an adapter holds bytes
        back (`silent_for`), or the answer comes in pieces.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        self._receive(0.0)
        if not self._received or self.clock.now() - self._last_received < seconds:
            return None
        received = self._received[-self.longest_line :]
        self._forget()
        return received

    def wait(self, moment: float, framing: Framing | None = None) -> None:
        """Wait for a complete line, or a frame by this rule, at most until this moment on the clock.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        rule = framing or self._frame_by_line_end
        while not self._frame_length(rule) and (seconds_left := moment - self.clock.now()) > 0.0:
            self._receive(seconds_left)

    def discard(self) -> None:
        """Drop all bytes that have arrived, such as a late answer to an earlier question.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        self._receive(0.0)
        self._forget()

    def silent_for(self, seconds: float) -> bool:
        """Drop all bytes that have arrived, and return whether none came for `seconds`.

        Some protocols need such a silence before a question (Modbus RTU: 3.5 characters). An adapter on USB passes
        bytes on late, up to 16 ms with FTDI's default latency timer: the silence on the line may be longer than it
        seems here, or bytes may still be on their way. It therefore tells nothing about the end of a frame.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        self.discard()
        return self.clock.now() - self._last_received >= seconds

    def _take(self, framing: Framing) -> bytes | None:
        """Return and remove the oldest complete frame; None if there is none."""
        length = self._frame_length(framing)
        if not length:
            self._receive(0.0)
            length = self._frame_length(framing)
        frame, self._received = self._received[:length], self._received[length:]
        return frame or None

    def _frame_length(self, framing: Framing) -> int:
        """Drop noise and return the length of the complete frame at the start of the bytes; 0 if there is none."""
        length = 0
        while self._received:
            noise, length = framing(self._received)
            if not noise:
                break
            self._received, length = self._received[noise:], 0
        if not length:
            self._received = self._received[-self.longest_line :]
        return length if length <= len(self._received) else 0

    def _frame_by_line_end(self, received: bytes) -> FrameCut:
        """Return the length of the first line with its end; a `Framing`."""
        end = received.find(self.line_end)
        return FrameCut(0, end + len(self.line_end) if end >= 0 else 0)

    def _receive(self, timeout: float) -> None:
        """Add bytes that arrive within `timeout` [s] to those received.

        Raises
        ------
        DeviceError : the line is closed or gone.
        """
        if self._line is None:
            raise DeviceError(f"bus '{self.name}': not open")
        try:
            received = self._line.read(timeout)
        except OSError as error:
            raise self._gone_error(error) from None
        if received:
            self._received += received
            self._last_received = self.clock.now()

    def _open_line(self) -> None:
        """Connect to the device.

        Raises
        ------
        DeviceError : the device is absent or refuses.
        """
        try:
            self._line = self._connect()
        except (OSError, ValueError, ImportError) as error:
            raise DeviceError(f"bus '{self.name}': {error}") from None
        self._last_received = self.clock.now()

    def _disconnect(self) -> None:
        """Close the connection, if there is one, and drop what has arrived."""
        self._forget()
        line, self._line = self._line, None
        if line is not None:
            with suppress(OSError):  # the line is closed already
                line.close()

    def _forget(self) -> None:
        """Drop all bytes that have arrived."""
        self._received = b""

    def _gone_error(self, error: OSError) -> DeviceError:
        """Return the error to raise for a device that is gone."""
        return DeviceError(f"bus '{self.name}': the device is gone: {error}")
