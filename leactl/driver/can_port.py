"""One CAN bus shared by several drivers, without threads: frames are dispatched while a caller waits for one.

Which node ids a device can have is in the settings of its driver.
"""

import errno
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from leactl.driver.clock import Clock
from leactl.driver.far_end import LAST_OF_11_BITS
from leactl.driver.tally import Tally
from leactl.errors import DeviceError, NoBus

if TYPE_CHECKING:
    import can

Listener = Callable[[bytearray, float], None]

SYNC_ID = 0x080
NMT_ID = 0x000
LONGEST_BACKLOG_S = 0.01  # frames that had arrived by a deadline are dispatched for at most this time after it
LONGEST_QUEUE_WAIT_S = 0.002  # about 15 frames at 1 Mbit/s; any cycle can spare it twice
FD_NEEDS = (
    "a CAN-FD frame needs options: {fd: true} of the bus in the bench file, and on Linux: ip link set CHANNEL up type"
    " can bitrate 1000000 dbitrate 5000000 fd on"
)
CHECK_BUS_HINT = "look at cable, termination and bit rate"
# classes of an error frame (linux/can/error.h)
BUS_OFF = 0x40
HARMLESS_CLASSES = 0x102  # a lost arbitration, and a controller that has returned to the bus


class CanPort:
    """Send frames, and pass received ones to the listener of their identifier.

    The port is synchronous: a callback runs only while the caller waits, and an error in it is raised to that caller.
    """

    def __init__(
        self, connect: "Callable[[], can.BusABC]", clock: Clock, name: str = "can", returns_own: bool = False
    ) -> None:
        """Make a port that is not connected yet.

        returns_own : whether the bus may bring back what this port sends, which CAN by itself does not.
        """
        from can import Message

        self._message = Message
        self._connect = connect
        self.clock, self._now = clock, clock.now
        self.name, self.returns_own = name, returns_own
        self.bus: can.BusABC | None = None
        self._listeners: dict[int, Listener] = {}
        self._fd_listeners: dict[int, Listener] = {}
        self._messages: dict[int, can.Message] = {}
        self._users = 0
        self.queue_full = Tally()  # frames that found the interface's queue full
        self.error_frames = Tally()

    @property
    def connected(self) -> bool:
        """Whether there is a connection, dead or alive."""
        return self.bus is not None

    def open(self) -> None:
        """Connect for the first user of the port, and count the users.

        Raises
        ------
        DeviceError : the bus is absent or refuses.
        """
        if self.bus is None:
            self._open_bus()
        self._users += 1

    def _open_bus(self) -> None:
        """Connect to the bus, and count its error frames anew.

        Raises
        ------
        DeviceError : the bus is absent or refuses.
        """
        self.error_frames = Tally()
        try:
            self.bus = self._connect()
        except (OSError, ValueError, ImportError, _can_error()) as error:
            error_number = getattr(error, "errno", None)
            if error_number == errno.EAFNOSUPPORT:
                raise NoBus(f"bus '{self.name}': this machine has no SocketCAN; see: leactl doctor") from None
            absent = "there is no such CAN interface; see: leactl doctor"
            raise DeviceError(f"bus '{self.name}': {absent if error_number == errno.ENODEV else error}") from None

    def close(self) -> None:
        """Disconnect when the last user has closed the port."""
        self._users = max(0, self._users - 1)
        if self._users == 0:
            self._disconnect()

    def reopen(self) -> None:
        """Replace a connection that may be dead by a new one."""
        self._disconnect()
        self._open_bus()

    def _disconnect(self) -> None:
        """Shut the connection down, if there is one."""
        bus, self.bus = self.bus, None
        if bus is not None:
            try:
                bus.shutdown()
            except (OSError, _can_error()):
                return  # the bus is closed already

    def listen(self, identifier: int, listener: Listener | None) -> None:
        """Pass frames of this identifier to a listener; None removes it."""
        if listener is None:
            self._listeners.pop(identifier, None)
        else:
            self._listeners[identifier] = listener

    def listen_fd(self, identifier: int, listener: Listener | None) -> None:
        """Pass CAN-FD frames of this identifier, of 11 or 29 bits, to a listener; None removes it."""
        if listener is None:
            self._fd_listeners.pop(identifier, None)
        else:
            self._fd_listeners[identifier] = listener

    def send(self, identifier: int, data: bytes) -> None:
        """Send one classic frame with an 11-bit identifier.

        Raises
        ------
        DeviceError : the bus is closed, full or gone.
        """
        bus = self.bus
        if bus is None:
            raise DeviceError(f"bus '{self.name}': not open")
        message = self._messages.get(identifier)
        # equal data reuse the message; changed data need a new message, because the bus may still hold the old one
        if message is None or message.data != data:
            message = self._message(arbitration_id=identifier, data=data, is_extended_id=False)
            self._messages[identifier] = message
        try:
            bus.send(message)
        except (OSError, ValueError, _can_error()) as error:
            self._send_again(message, error)

    def send_fd(self, identifier: int, data: bytes) -> None:
        """Send one CAN-FD frame whose data goes at the faster rate; an identifier too large for 11 bits gets 29.

        Raises
        ------
        DeviceError : the bus is closed, full or gone, or carries classic frames only.
        """
        bus = self.bus
        if bus is None:
            raise DeviceError(f"bus '{self.name}': not open")
        message = self._message(
            arbitration_id=identifier,
            data=data,
            is_extended_id=identifier > LAST_OF_11_BITS,
            is_fd=True,
            bitrate_switch=True,
        )
        try:
            bus.send(message)
        except (OSError, ValueError, _can_error()) as error:
            self._send_again(message, error)

    def _send_again(self, message: "can.Message", error: Exception) -> None:
        """Repeat a frame that found the interface's queue full, for at most `LONGEST_QUEUE_WAIT_S`.

        Raises
        ------
        DeviceError : the queue stays full, or sending failed for another reason.
        """
        self.queue_full.count += 1
        deadline = self._now() + LONGEST_QUEUE_WAIT_S
        while _is_full(error) and self.bus is not None and self._now() < deadline:
            self.clock.sleep_until(self._now() + LONGEST_QUEUE_WAIT_S / 10)
            try:
                self.bus.send(message)
            except (OSError, ValueError, _can_error()) as repeated_error:
                error = repeated_error
            else:
                return
        hint = f"; {FD_NEEDS}" if message.is_fd and errno.EINVAL in _error_numbers(error) else ""
        raise DeviceError(f"bus '{self.name}': cannot send 0x{message.arbitration_id:03X}: {error}{hint}") from None

    def notices(self) -> list[str]:
        """Return one line for each notable event of the bus since the last call."""
        lines = []
        if count := self.queue_full.take_note():
            lines.append(
                f"bus '{self.name}': a frame had to wait for room in the interface's queue, {count};"
                " a longer one helps: ip link set CHANNEL txqueuelen 1000"
            )
        if count := self.error_frames.take_note():
            text = f"the controller reports an error by an error frame, {count}; {CHECK_BUS_HINT}"
            lines.append(f"bus '{self.name}': {text}")
        return lines

    def why_silent(self) -> str:
        """Return a possible reason why nobody answers, as the end of a sentence; empty if the bus showed no error."""
        count = self.error_frames.count
        return f"; the bus '{self.name}' has shown {count} error frames: {CHECK_BUS_HINT}" if count else ""

    def pump_until(self, came: Sequence[bool], deadline: float) -> bool:
        """Dispatch frames until listeners have set all of `came`, or until the deadline; return whether all are set.

        Frames that arrived by the deadline are still dispatched, for at most 10 ms even on a babbling bus.

        Raises
        ------
        DeviceError : the bus is closed or gone, or the controller has left it.
        """
        bus, now, listeners = self.bus, self._now, self._listeners
        if bus is None:
            raise DeviceError(f"bus '{self.name}': not open")
        while False in came:
            seconds_left = deadline - now()
            if seconds_left < 0.0:
                if seconds_left < -LONGEST_BACKLOG_S:
                    return False
                seconds_left = 0.0
            try:
                message = bus.recv(seconds_left)
            except (OSError, ValueError, _can_error()) as error:
                raise DeviceError(f"bus '{self.name}': cannot receive: {error}") from None
            if message is None:
                if seconds_left == 0.0:
                    return False
            elif message.is_error_frame:
                if message.arbitration_id & BUS_OFF:
                    raise DeviceError(
                        f"bus '{self.name}': the controller has left the bus (bus-off): too many of its frames failed;"
                        f" {CHECK_BUS_HINT}, then: leactl doctor"
                    )
                if not message.arbitration_id & HARMLESS_CLASSES:
                    self.error_frames.count += 1
            elif message.is_fd:
                listener = self._fd_listeners.get(message.arbitration_id)
                if listener is not None:
                    listener(message.data, message.timestamp)
            elif not (message.is_extended_id or message.is_remote_frame):
                listener = listeners.get(message.arbitration_id)
                if listener is not None:
                    listener(message.data, message.timestamp)
        return True

    def take_waiting(self) -> None:
        """Dispatch the frames that have arrived, without waiting for more.

        Raises
        ------
        DeviceError : the bus is closed or gone.
        """
        self.pump_until((False,), self._now())

    def sync(self) -> None:
        """Send the CANopen SYNC frame."""
        self.send(SYNC_ID, b"")


def _is_full(error: Exception) -> bool:
    """Return whether an error means that the interface's queue was full."""
    return errno.ENOBUFS in _error_numbers(error)


def _error_numbers(error: Exception) -> tuple[int | None, int | None]:
    """Return the error numbers of a failure: that of python-can, and that of the system."""
    return getattr(error, "error_code", None), getattr(error, "errno", None)


def _can_error() -> type[Exception]:
    """Return the base class of python-can's errors, imported when it is needed."""
    from can import CanError

    return CanError
