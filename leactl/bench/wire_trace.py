"""Record every byte on every wire of runs, with the driver calls that caused it, so that a fault can be replayed.

A trace is text. Each line has the time of the bench's clock [s], the bus or device, the kind of line, and the bytes or
the call (docs/reference/wire-traces.md). The last line of a run that died may be incomplete and is not read.
"""

import copy
import json
import math
import re
import zlib
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

from leactl.bench.benchfile import CanBus, I2cBus, LineBus
from leactl.bench.wiring import Wiring
from leactl.driver.contract import Confirmation, Row, SampleBlock
from leactl.driver.i2c_port import SmBus, swapped
from leactl.driver.serial_port import SerialLine
from leactl.errors import InputError
from leactl.runfile.publish import refuse_existing

if TYPE_CHECKING:
    import can

HEAD = "# leactl wire trace 1"
SENT, HEARD, FAILED, CALLED, ENDED = ">", "<", "!", "=", "~"
KINDS = (SENT, HEARD, FAILED, CALLED, ENDED)
CONNECT = "connect "  # before the error of a line that could not be connected
NOT_TAKEN = "/"  # before the bytes that a full line did not take
CAN_LOGS = (".asc", ".blf", ".log")  # python-can's own formats
FLUSH_S = 0.5
CALLS = (  # methods of a driver that are traced; what it sends follows from these calls and from its input
    "open",
    "close",
    "safe_state",
    "stop_now",
    "pace",
    "engage",
    "release",
    "command",
    "begin_cycle",
    "end_cycle",
    "feed",
    "take",
    "notices",
    "tare",
    "supply",
    "protect",
    "switch_on",
    "switch_off",
)


class TraceLine(NamedTuple):
    """One line of a trace."""

    number: int  # in the file, from 1
    time: float  # s
    owner: str  # bus or device
    kind: str  # one of `KINDS`
    text: str


class WireTrace:
    """A trace that is being written; if the name has an ending of python-can's logs, CAN frames go to such a log."""

    def __init__(self, path: Path) -> None:
        """Create the file.

        Raises
        ------
        InputError : the file exists or cannot be written.
        """
        logged = path.suffix.lower() in CAN_LOGS
        self.path = path.with_suffix(".trace") if logged else path
        self._files = ExitStack()
        self._depth: dict[str, int] = {}
        self._can_log: Any = None
        self._flushed = -math.inf
        self._is_empty = True  # until a line or a frame is to be written
        self._paths = {path, self.path}
        self._earlier = 0.0  # s, duration of the runs before this one, if this one's clock began at 0 again
        self.fault = ""  # why lines are missing from here on
        self.now: Callable[[], float] = lambda: 0.0  # the bench's clock, once there is one
        for taken in self._paths:
            refuse_existing(taken)
        try:
            self._text: TextIO = self._files.enter_context(self.path.open("x", encoding="utf-8"))
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        if logged:
            try:
                import can

                self._can_log = self._files.enter_context(can.Logger(path))
            except OSError as error:
                self._files.close()
                self._remove()
                raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        self._text.write(f"{HEAD}\n")

    def __enter__(self) -> "WireTrace":
        return self

    def __exit__(self, *_exception: object) -> None:
        with self._errors_to_fault():
            self._files.close()
            if self._is_empty:  # the run was refused before a device was opened
                self._remove()

    def _remove(self) -> None:
        """Remove the files, which would stand in the way of the next attempt."""
        for made in self._paths:
            made.unlink(missing_ok=True)

    def follow(self, now: Callable[[], float]) -> None:
        """Use this clock from now on; an emulated bench has a new one for each run, which begins at 0."""
        if now() < self.now():
            self._earlier += self.now()
        self.now, self._flushed = now, -math.inf

    def write(self, owner: str, kind: str, text: str) -> None:
        """Add a line."""
        self._is_empty = False
        if self.fault:
            return
        with self._errors_to_fault():
            now = self.now()
            self._text.write(f"{now!r} {owner} {kind} {text}\n")  # to the last bit: drivers compare times
            if now - self._flushed >= FLUSH_S:
                self._flushed = now
                self._text.flush()

    def failed(self, owner: str, error: Exception, transfer: str = "") -> None:
        """Add the line of a transfer that failed; a line break within the error's text becomes `\\n`."""
        self.write(owner, FAILED, transfer + str(error).replace("\\", "\\\\").replace("\n", "\\n"))

    def frame(self, owner: str, kind: str, message: "can.Message") -> None:
        """Add a CAN frame."""
        self._is_empty = False
        if not self.fault:
            with self._errors_to_fault():
                self._add_frame(owner, kind, message)

    @contextmanager
    def _errors_to_fault(self) -> Iterator[None]:
        """Store an error of the trace, such as a full disk, in `fault`; it must not delay the stop of a drive."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 (nothing in a trace is worth a run)
            reason = " ".join(str(error).split()) or type(error).__name__
            self.fault = f"{self.path}: nothing more was written: {reason}"

    def _add_frame(self, owner: str, kind: str, message: "can.Message") -> None:
        if self._can_log is None:
            self.write(owner, kind, frame_text(message))
            return
        logged = copy.copy(message)
        # python-can 4.6 gives a frame in a .blf the time of the first one if its own time is earlier
        logged.timestamp, logged.channel, logged.is_rx = self._earlier + self.now(), owner, kind == HEARD
        self._can_log(logged)

    def called(self, owner: str, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a function: it adds a line when it is called and when it ends, unless another traced call made it."""

        def call(*arguments: Any) -> Any:
            if self._depth.get(owner, 0):
                return function(*arguments)
            with self._errors_to_fault():
                self.write(owner, CALLED, f"{name} {json.dumps(arguments)}")
            self._depth[owner] = 1
            try:
                result = function(*arguments)
            except BaseException as error:
                self.write(owner, ENDED, outcome_text(None, error))
                raise
            finally:
                self._depth[owner] = 0
                if name == "close":
                    self._flushed = -math.inf  # the next line is flushed: the clock may stand until another run
            with self._errors_to_fault():
                values = function.__self__.values if name == "end_cycle" else result  # type: ignore[attr-defined]
                self.write(owner, ENDED, outcome_text(values))
            return result

        return call


def frame_text(message: "can.Message") -> str:
    """A CAN frame as text: identifier and data in hex, then its marks.

    x marks an extended, e an error, r a remote frame; F one of CAN FD, B data at the faster bit rate.
    """
    marks = ("x" if message.is_extended_id else "") + ("e" if message.is_error_frame else "")
    marks += ("r" if message.is_remote_frame else "") + ("F" if message.is_fd else "")
    marks += "B" if message.bitrate_switch else ""
    return f"{message.arbitration_id:03x} {bytes(message.data).hex()} {marks}".rstrip(" ")


def outcome_text(result: Any, error: BaseException | None = None) -> str:
    """The reproducible result of a call as JSON: an error, readings, notices, or a confirmation; else null."""
    if error is not None:
        return json.dumps({"raised": type(error).__name__, "text": str(error)})
    if isinstance(result, Confirmation):
        return json.dumps({"safe": result.safe})
    if isinstance(result, Mapping):  # of a tare
        return json.dumps({name: float(value) for name, value in result.items()})
    if isinstance(result, list | tuple):
        return json.dumps([_reproducible(part) for part in result])
    return "null"


def _reproducible(part: Any) -> Any:
    """A part of a result without its stamp: the clock is read some microseconds apart in a replay."""
    if isinstance(part, SampleBlock):  # a fast converter's values as text would take too much of a cycle
        return [part.stream, len(part.times), zlib.crc32(part.values.tobytes())]
    if isinstance(part, Row):
        return [part.stream, [float(value) for value in part.values], part.fault]
    return part if isinstance(part, str) else float(part)


def is_unlike(outcome: str, stands: str) -> bool:
    """Whether a call ended otherwise than a trace has it; older traces have null for rows, notices and tares."""
    return outcome != stands and (stands != "null" or "raised" in json.loads(outcome))


class TracedWiring:
    """A wiring whose connections write all transfers to a trace."""

    def __init__(self, wiring: Wiring, trace: WireTrace) -> None:
        self._wiring, self._trace = wiring, trace
        self.clock = wiring.clock
        trace.follow(wiring.clock.now)

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """Function that connects to a CAN bus."""
        connect = self._wiring.can(name, bus)
        return lambda: TracedCan(connect(), name, self._trace)  # type: ignore[return-value]

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """Function that connects to an I2C bus."""
        connect = self._wiring.i2c(name, bus)
        return lambda: TracedI2c(connect(), name, self._trace)

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Function that connects to a serial line."""
        connect = self._wiring.serial(name, bus)

        def traced() -> SerialLine:
            try:
                line = connect()
            except OSError as error:
                self._trace.failed(name, error, CONNECT)
                raise
            return TracedLine(line, name, self._trace)

        return traced

    def library(self, device: str) -> Any:
        """The replacement of a maker's library, which is not traced."""
        return self._wiring.library(device)

    def wait_for_disk(self) -> None:
        """Wait as the wiring does before each write of the run file."""
        self._wiring.wait_for_disk()

    def hang(self, torque: float) -> None:
        """Apply the torque [N*m] of weights."""
        self._wiring.hang(torque)


class TracedLine:
    """A traced serial line."""

    def __init__(self, line: SerialLine, name: str, trace: WireTrace) -> None:
        self._line, self._name, self._trace = line, name, trace
        self.close = line.close

    def read(self, timeout: float) -> bytes:
        """Bytes that have arrived."""
        try:
            read = self._line.read(timeout)
        except OSError as error:
            self._trace.failed(self._name, error)
            raise
        if read:
            self._trace.write(self._name, HEARD, read.hex())
        return read

    def write(self, data: bytes) -> int:
        """Write bytes; those that were not accepted are marked in the trace."""
        try:
            taken = self._line.write(data)
        except OSError as error:
            self._trace.failed(self._name, error)
            raise
        refused = f"{NOT_TAKEN}{data[taken:].hex()}" if taken < len(data) else ""
        self._trace.write(self._name, SENT, f"{data[:taken].hex()}{refused}")
        return taken


class TracedCan:
    """A traced CAN bus, with the methods that a port uses."""

    def __init__(self, bus: "can.BusABC", name: str, trace: WireTrace) -> None:
        self._bus, self._name, self._trace = bus, name, trace
        self.shutdown = bus.shutdown

    def send(self, message: "can.Message") -> None:
        """Send a frame."""
        try:
            self._bus.send(message)
        except Exception as error:
            self._trace.failed(self._name, error)
            raise
        self._trace.frame(self._name, SENT, message)

    def recv(self, timeout: float) -> "can.Message | None":
        """Receive a frame."""
        try:
            message = self._bus.recv(timeout)
        except Exception as error:
            self._trace.failed(self._name, error)
            raise
        if message is not None:
            self._trace.frame(self._name, HEARD, message)
        return message


class TracedI2c:
    """A traced I2C bus; registers are traced with the high byte first, as in the device."""

    def __init__(self, bus: SmBus, name: str, trace: WireTrace) -> None:
        self._bus, self._name, self._trace = bus, name, trace
        self.close = bus.close

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        """Read a register."""
        word: int = self._transfer(
            lambda: self._bus.read_word_data(i2c_addr, register), f"{i2c_addr:02x} {register:02x}"
        )
        self._trace.write(self._name, HEARD, f"{i2c_addr:02x} {register:02x} {swapped(word):04x}")
        return word

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write a register."""
        self._transfer(lambda: self._bus.write_word_data(i2c_addr, register, value), f"{i2c_addr:02x} {register:02x}")
        self._trace.write(self._name, SENT, f"{i2c_addr:02x} {register:02x} {swapped(value):04x}")

    def _transfer(self, transfer: Callable[[], Any], where: str) -> Any:
        try:
            return transfer()
        except OSError as error:
            self._trace.write(self._name, FAILED, f"{where} {error.errno or 0}")
            raise


def read_trace(path: Path) -> list[TraceLine]:
    """Read a trace up to its last complete line.

    Raises
    ------
    InputError : no trace, or an invalid line, with its number.
    """
    try:
        text = path.read_bytes().decode("utf-8")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is no text; a trace that --trace has written was expected") from None
    head, *lines = text.split("\n")[:-1] or [""]
    if head != HEAD:
        raise InputError(f"{path}:1  '{head[:40]}': '{HEAD}' was expected")
    return list(_parsed(path, lines))


def _parsed(path: Path, lines: Sequence[str]) -> Iterator[TraceLine]:
    for number, line in enumerate(lines, start=2):
        time, owner, kind, text = [*line.split(" ", 3), "", "", "", ""][:4]
        try:
            seconds = float(time)
        except ValueError:
            seconds = math.nan
        if not math.isfinite(seconds) or kind not in KINDS or not owner:
            expected = f"seconds, a bus or a device, and one of {' '.join(KINDS)} were expected"
            raise InputError(f"{path}:{number}  '{line[:40]}': {expected}")
        if kind == FAILED:
            text = re.sub(r"\\(.)", lambda escaped: "\n" if escaped[1] == "n" else escaped[1], text)
        yield TraceLine(number, seconds, owner, kind, text)


def expect_calls(path: Path, lines: Sequence[TraceLine], left_out: Container[str]) -> None:
    """Refuse a trace that has nothing to replay.

    Raises
    ------
    InputError : the trace has no call of a device or bus but of those that are left out.
    """
    if not any(line.kind == CALLED and line.owner not in left_out for line in lines):
        raise InputError(f"{path}: holds no call of a device on a bus; a trace of a whole run was expected")


def expect_can_frames(path: Path, lines: Sequence[TraceLine], buses: Sequence[str]) -> None:
    """Refuse a trace whose CAN frames are in a separate log.

    Raises
    ------
    InputError : the trace has lines, but no frame of any of these buses.
    """
    if buses and lines and not any(line.owner in buses and line.kind in (SENT, HEARD) for line in lines):
        raise InputError(
            f"{path}: holds no frame of {', '.join(buses)}; a trace that can be replayed has a name that ends in none"
            f" of {', '.join(CAN_LOGS)}"
        )
