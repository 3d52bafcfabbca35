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

from leactl.bench.bench import Bench
from leactl.bench.benchfile import BenchFile, CanBus, CheckedDevice, I2cBus, LineBus
from leactl.bench.wiring import Wiring
from leactl.driver.contract import Confirmation, OwnRecording, Row, SampleBlock
from leactl.driver.i2c_port import SmBus, swap_bytes
from leactl.driver.serial_port import SerialLine
from leactl.errors import InputError
from leactl.runfile.publish import refuse_existing

if TYPE_CHECKING:
    import can

HEAD = "# leactl wire trace 1"
SENT, HEARD, FAILED, CALLED, ENDED = ">", "<", "!", "=", "~"
KINDS = (SENT, HEARD, FAILED, CALLED, ENDED)
CONNECT = "connect "  # precedes the error of a line that could not be connected
NOT_ACCEPTED = "/"  # precedes the bytes that a full line did not accept
CAN_LOGS = (".asc", ".blf", ".log")  # suffixes for which python-can writes a log of CAN frames
FLUSH_S = 0.5  # time between two flushes of the file
CALLS = (  # methods of a driver that are traced; these calls and its input determine the bytes that it sends
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
    "recorded",
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


def files_of_trace(path: Path) -> list[Path]:
    """Return the files that a trace to `path` makes: the log of CAN frames, if `path` names one, and the trace."""
    return [path, path.with_suffix(".trace")] if path.suffix.lower() in CAN_LOGS else [path]


class WireTrace:
    """A trace that is being written.

    If the path has a suffix in `CAN_LOGS`, CAN frames are written to a log of that format, and all else to a file with
    the suffix `.trace`.
    """

    def __init__(self, path: Path) -> None:
        """Create the file, or both files.

        Raises
        ------
        InputError : a file exists or cannot be written.
        """
        *can_logs, self.path = files_of_trace(path)
        self._files = ExitStack()
        self._busy: set[str] = set()  # devices and buses with a traced call under way
        self._can_log: Any = None
        self._flushed = -math.inf  # s, time of the last flush
        self._is_empty = True  # until a line or a frame is to be written
        self._paths = {path, self.path}
        self._clock_offset = 0.0  # s, duration of the earlier runs, if the clock began at 0 again for this run
        self.fault = ""  # why lines are missing from here on
        self.now: Callable[[], float] = lambda: 0.0  # the bench's clock, once there is one
        for new_path in self._paths:
            refuse_existing(new_path)
        try:
            self._text: TextIO = self._files.enter_context(self.path.open("x", encoding="utf-8"))
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
        if can_logs:
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
        """Remove the files, because the next attempt refuses to overwrite them."""
        for path in self._paths:
            path.unlink(missing_ok=True)

    def follow(self, now: Callable[[], float]) -> None:
        """Use this clock [s] from now on; an emulated bench has a new clock for each run, which begins at 0."""
        if now() < self.now():
            self._clock_offset += self.now()
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

    def write_failure(self, owner: str, error: Exception, transfer: str = "") -> None:
        """Add the line of a transfer that failed; a line break within the error's text becomes `\\n`."""
        self.write(owner, FAILED, transfer + str(error).replace("\\", "\\\\").replace("\n", "\\n"))

    def write_frame(self, owner: str, kind: str, message: "can.Message") -> None:
        """Add a CAN frame, as a line or to the log of CAN frames."""
        self._is_empty = False
        if not self.fault:
            with self._errors_to_fault():
                self._store_frame(owner, kind, message)

    @contextmanager
    def _errors_to_fault(self) -> Iterator[None]:
        """Store an error of the trace, such as a full disk, in `fault`; it must not delay the stop of a drive."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 (a failure of the trace must not end the run)
            reason = " ".join(str(error).split()) or type(error).__name__
            self.fault = f"{self.path}: nothing more was written: {reason}"

    def _store_frame(self, owner: str, kind: str, message: "can.Message") -> None:
        """Add a CAN frame to the log of CAN frames if there is one, otherwise as a line."""
        if self._can_log is None:
            self.write(owner, kind, frame_text(message))
            return
        stamped_message = copy.copy(message)
        # python-can 4.6 gives a frame in a .blf the time of the first one if its own time is earlier
        stamped_message.timestamp, stamped_message.channel, stamped_message.is_rx = (
            self._clock_offset + self.now(),
            owner,
            kind == HEARD,
        )
        self._can_log(stamped_message)

    def trace_calls(self, owner: str, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that also adds a line when it begins and when it ends.

        No lines are added while another traced call of the same device or bus is under way.
        """

        def call(*arguments: Any) -> Any:
            if owner in self._busy:
                return function(*arguments)
            with self._errors_to_fault():
                self.write(owner, CALLED, f"{name} {json.dumps(arguments)}")
            self._busy.add(owner)
            try:
                result = function(*arguments)
            except BaseException as error:
                self.write(owner, ENDED, outcome_text(None, error))
                raise
            finally:
                self._busy.discard(owner)
                if name == "close":
                    self._flushed = -math.inf  # flush the next line: the clock may not advance before the next run
            with self._errors_to_fault():
                values = function.__self__.values if name == "end_cycle" else result  # type: ignore[attr-defined]
                self.write(owner, ENDED, outcome_text(values))
            return result

        return call


def frame_text(message: "can.Message") -> str:
    """Return a CAN frame as text: identifier and data in hex, then its marks.

    The marks are x for an extended identifier, e for an error frame, r for a remote frame, F for CAN FD, and B for data
    at the faster bit rate.
    """
    marks = ("x" if message.is_extended_id else "") + ("e" if message.is_error_frame else "")
    marks += ("r" if message.is_remote_frame else "") + ("F" if message.is_fd else "")
    marks += "B" if message.bitrate_switch else ""
    return f"{message.arbitration_id:03x} {bytes(message.data).hex()} {marks}".rstrip(" ")


def outcome_text(result: Any, error: BaseException | None = None) -> str:
    """Return the reproducible result of a call as JSON: an error, readings, notices, or a confirmation; else null."""
    if error is not None:
        return json.dumps({"raised": type(error).__name__, "text": str(error)})
    if isinstance(result, Confirmation):
        return json.dumps({"safe": result.safe})
    if isinstance(result, Mapping):  # of a tare
        return json.dumps({name: float(value) for name, value in result.items()})
    if isinstance(result, OwnRecording):
        return json.dumps([*result.headings, result.interval, len(result.values), zlib.crc32(result.values.tobytes())])
    if isinstance(result, list | tuple):
        return json.dumps([_reproducible(item) for item in result])
    return "null"


def _reproducible(item: Any) -> Any:
    """Return an item of a result without its time stamp: a replay reads the clock at times some microseconds apart."""
    if isinstance(item, SampleBlock):  # a fast converter's values as text would take too much of a cycle
        return [item.stream, len(item.times), zlib.crc32(item.values.tobytes())]
    if isinstance(item, Row):
        return [item.stream, [float(value) for value in item.values], item.fault]
    return item if isinstance(item, str) else float(item)


def differs_from_trace(outcome: str, recorded: str) -> bool:
    """Return whether the outcome of a call differs from the outcome in a trace.

    Older traces have null for rows, notices and tares; only an error differs from null.
    """
    return outcome != recorded and (recorded != "null" or "raised" in json.loads(outcome))


class TracedWiring:
    """Wiring whose connections write all transfers to a trace."""

    def __init__(self, wiring: Wiring, trace: WireTrace) -> None:
        self._wiring, self._trace = wiring, trace
        self.clock = wiring.clock
        trace.follow(wiring.clock.now)

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """Return a function that connects to a CAN bus."""
        connect = self._wiring.can(name, bus)
        return lambda: TracedCan(connect(), name, self._trace)  # type: ignore[return-value]

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """Return a function that connects to an I2C bus."""
        connect = self._wiring.i2c(name, bus)
        return lambda: TracedI2c(connect(), name, self._trace)

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Return a function that connects to a serial line."""
        connect = self._wiring.serial(name, bus)

        def traced_connect() -> SerialLine:
            try:
                line = connect()
            except OSError as error:
                self._trace.write_failure(name, error, CONNECT)
                raise
            return TracedLine(line, name, self._trace)

        return traced_connect

    def emulator_of(self, device: str) -> Any:
        """Return the emulator that replaces a maker's library; its calls are not traced."""
        return self._wiring.emulator_of(device)

    def wait_for_disk(self) -> None:
        """Wait for the disk of the wiring, before each write of the run file."""
        self._wiring.wait_for_disk()

    def apply_weight_torque(self, torque: float) -> None:
        """Apply the torque of weights [N*m]."""
        self._wiring.apply_weight_torque(torque)


class TracedLine:
    """A traced serial line."""

    def __init__(self, line: SerialLine, name: str, trace: WireTrace) -> None:
        self._line, self._name, self._trace = line, name, trace
        self.close = line.close

    def read(self, timeout: float) -> bytes:
        """Return bytes that have arrived."""
        try:
            received = self._line.read(timeout)
        except OSError as error:
            self._trace.write_failure(self._name, error)
            raise
        if received:
            self._trace.write(self._name, HEARD, received.hex())
        return received

    def write(self, data: bytes) -> int:
        """Write bytes, and mark in the trace the bytes that were not accepted; return the number of accepted bytes."""
        try:
            accepted = self._line.write(data)
        except OSError as error:
            self._trace.write_failure(self._name, error)
            raise
        refused = f"{NOT_ACCEPTED}{data[accepted:].hex()}" if accepted < len(data) else ""
        self._trace.write(self._name, SENT, f"{data[:accepted].hex()}{refused}")
        return accepted


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
            self._trace.write_failure(self._name, error)
            raise
        self._trace.write_frame(self._name, SENT, message)

    def recv(self, timeout: float) -> "can.Message | None":
        """Receive a frame."""
        try:
            message = self._bus.recv(timeout)
        except Exception as error:
            self._trace.write_failure(self._name, error)
            raise
        if message is not None:
            self._trace.write_frame(self._name, HEARD, message)
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
        self._trace.write(self._name, HEARD, f"{i2c_addr:02x} {register:02x} {swap_bytes(word):04x}")
        return word

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write a register."""
        self._transfer(lambda: self._bus.write_word_data(i2c_addr, register, value), f"{i2c_addr:02x} {register:02x}")
        self._trace.write(self._name, SENT, f"{i2c_addr:02x} {register:02x} {swap_bytes(value):04x}")

    def _transfer(self, transfer: Callable[[], Any], address: str) -> Any:
        """Make a transfer; if it fails, add a line with the address and the errno."""
        try:
            return transfer()
        except OSError as error:
            self._trace.write(self._name, FAILED, f"{address} {error.errno or 0}")
            raise


def read_trace(path: Path) -> list[TraceLine]:
    """Read a trace up to its last complete line.

    Raises
    ------
    InputError : the file is no trace, or has an invalid line, given by its number.
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
    return list(_parse_lines(path, lines))


def _parse_lines(path: Path, lines: Sequence[str]) -> Iterator[TraceLine]:
    """Yield the lines of a trace, from the second line of the file on.

    Raises
    ------
    InputError : an invalid line, with its number.
    """
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


def bench_with_trace(
    file: BenchFile, devices: Sequence[CheckedDevice], wiring: Wiring, trace: WireTrace | None
) -> Bench:
    """Return a bench with closed devices, whose wires and calls go through a trace if there is one."""
    if trace is None:
        return Bench(file, devices, wiring)
    bench = Bench(file, devices, TracedWiring(wiring, trace))
    bench.pass_calls_through(trace.trace_calls, CALLS)
    return bench


def expect_calls(path: Path, lines: Sequence[TraceLine], left_out: Container[str]) -> None:
    """Check that a trace has a call that can be replayed.

    Raises
    ------
    InputError : the trace has no call, or only calls of the devices in `left_out`.
    """
    if not any(line.kind == CALLED and line.owner not in left_out for line in lines):
        raise InputError(f"{path}: holds no call of a device on a bus; a trace of a whole run was expected")


def expect_can_frames(path: Path, lines: Sequence[TraceLine], buses: Sequence[str]) -> None:
    """Check that a trace holds CAN frames: they may be in a separate log, or none was ever sent or received.

    Raises
    ------
    InputError : the trace has lines and `buses` is not empty, but no frame of any of these buses is in it.
    """
    if buses and lines and not any(line.owner in buses and line.kind in (SENT, HEARD) for line in lines):
        raise InputError(
            f"{path}: holds no frame of {', '.join(buses)}: none passed, or --trace was given a name that ends in"
            f" {', '.join(CAN_LOGS)}, which puts them in a log of their own that cannot be replayed"
        )
