"""Replay a trace against the drivers: make the same calls in the same order, with the recorded input on the wires.

The clock is that of the trace. A driver has to send the recorded bytes; the replay ends at the first difference,
because the recorded input would no longer answer the bytes that are sent.
"""

import errno
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from leactl.bench.bench import Bench
from leactl.bench.benchfile import BenchFile, CanBus, CheckedDevice, I2cBus, LineBus
from leactl.bench.wire_trace import (
    CALLED,
    CONNECT,
    ENDED,
    FAILED,
    HEARD,
    NOT_ACCEPTED,
    SENT,
    TraceLine,
    differs_from_trace,
    expect_calls,
    expect_can_frames,
    frame_text,
    outcome_text,
    read_trace,
)
from leactl.driver.contract import Mode
from leactl.driver.i2c_port import SmBus, swap_bytes
from leactl.driver.serial_port import SerialLine
from leactl.errors import InputError

if TYPE_CHECKING:
    import can


class Difference(NamedTuple):
    """The first difference between a replay and its trace."""

    line: int  # number of the line in the file
    owner: str  # bus or device
    stands: str  # text of the line in the trace
    came: str  # what happened in the replay in its place

    def __str__(self) -> str:
        return f"{self.owner}: {self.came} where the trace has {self.stands}"


class ReplayResult(NamedTuple):
    """Result of a replay."""

    calls: int  # calls that ended as in the trace
    transfers: int  # equal transfers on all wires
    difference: Difference | None
    raised: tuple[str, ...]  # errors of calls, each once, in the order of their first occurrence
    cut_short: bool  # the trace ends within a call


class Diverged(BaseException):
    """A transfer differs from the trace; a BaseException, so that no driver handles it."""

    def __init__(self, difference: Difference) -> None:
        super().__init__(str(difference))
        self.difference = difference


class ReplayClock:
    """The clock of the trace: each call sets it, and waits and transfers advance it."""

    def __init__(self) -> None:
        self._time = 0.0

    def now(self) -> float:
        """Return the time of the trace [s]."""
        return self._time

    def set(self, moment: float) -> None:
        """Set the time to that of a call in the trace [s]."""
        self._time = moment

    def sleep_until(self, moment: float) -> None:
        """Advance to a moment [s]; a moment in the past changes nothing."""
        self._time = max(self._time, moment)


class Wire:
    """One bus in the trace, with the position of the replay among the lines of the bus."""

    def __init__(self, name: str, lines: Sequence[TraceLine], replay: "ReplayWiring") -> None:
        self.name, self._lines, self._replay, self._next_index = name, lines, replay, 0

    def now(self) -> float:
        """Return the time of the trace [s]."""
        return self._replay.clock.now()

    def connect(self) -> None:
        """Connect a serial line or a raw socket, if that succeeded in the trace.

        Raises
        ------
        OSError : connecting failed in the trace.
        """
        line = self._line_of_call()
        if line is not None and line.kind == FAILED and line.text.startswith(CONNECT):
            self._take_line()
            raise OSError(line.text.removeprefix(CONNECT))

    def send(self, text: str) -> str:
        """Compare sent bytes with the next line of the trace; return the bytes that the line accepted then, in hex.

        Parameters
        ----------
        text : the bytes in hex, or a CAN frame as text (`frame_text`).

        Raises
        ------
        Diverged : the trace has another line.
        OSError : sending failed in the trace.
        """
        line = self._take_line()
        if line is None:
            if not self._replay.is_cut_short:
                raise Diverged(
                    Difference(self._replay.call_ends, self.name, "nothing more of this wire", f"'> {text}' was sent")
                )
            return text
        if line.kind == FAILED:
            raise OSError(line.text)
        accepted, _, refused = line.text.partition(NOT_ACCEPTED)
        if line.kind != SENT or accepted + refused != text:
            recorded = f"'{line.kind} {line.text}'"
            raise Diverged(Difference(line.number, self.name, recorded, f"'> {text}' was sent"))
        return accepted

    def hear(self, timeout: float) -> str | None:
        """Return the next input within the present call; if it has none, wait for `timeout` [s] and return None.

        The wait advances the clock of the trace.

        Raises
        ------
        OSError : receiving failed in the trace.
        """
        clock = self._replay.clock
        line = self._line_of_call()
        if line is None or line.kind == SENT:
            clock.sleep_until(clock.now() + timeout)
            return None
        self._take_line()
        if line.kind == FAILED:
            raise OSError(line.text)
        return line.text

    def transfer(self, kind: str, text: str) -> str:
        """Make a transfer on a bus that answers at once; return the text of its line in the trace.

        Parameters
        ----------
        kind : `SENT` or `HEARD`.
        text : beginning of the line.

        Raises
        ------
        Diverged : the next line has another kind or beginning.
        OSError : the transfer failed in the trace, with the same errno.
        """
        line = self._take_line()
        if line is None:
            raise OSError(errno.ENODEV, "the trace ends here")
        if line.text.startswith(text) and line.kind == FAILED:
            raise OSError(int(line.text.rpartition(" ")[2]), "as it was then")
        if line.kind != kind or not line.text.startswith(text):
            recorded = f"'{line.kind} {line.text}'"
            raise Diverged(Difference(line.number, self.name, recorded, f"'{kind} {text}' was asked for"))
        return line.text

    def rest(self) -> TraceLine | None:
        """Return the first line of the bus that the replay has not come to, or None."""
        return self._lines[self._next_index] if self._next_index < len(self._lines) else None

    def _line_of_call(self) -> TraceLine | None:
        """Return the next line of the bus, or None if it does not belong to the present call."""
        line = self.rest()
        return line if line is not None and line.number <= self._replay.call_ends else None

    def _take_line(self) -> TraceLine | None:
        """Return the next line of the bus and advance past it; None at the end of the trace."""
        line = self.rest()
        if line is None:
            return None
        self._next_index += 1
        self._replay.transfers += 1
        self._replay.clock.sleep_until(line.time)
        return line


class ReplayWiring:
    """Wiring whose connections play back a trace."""

    def __init__(self, lines: Sequence[TraceLine], buses: Sequence[str]) -> None:
        self.clock = ReplayClock()
        self.call_ends = 0  # number of the line at which the present call ended
        self.is_cut_short = False  # the trace ends within a call
        self.transfers = 0
        transfer_kinds = (SENT, HEARD, FAILED)
        self._wires = {
            name: Wire(name, [line for line in lines if line.owner == name and line.kind in transfer_kinds], self)
            for name in buses
        }

    def difference_at_the_end(self) -> Difference | None:
        """Return the first transfer of the trace that no call of the replay has made, or None."""
        rests = [line for wire in self._wires.values() if (line := wire.rest()) is not None]
        if self.is_cut_short or not rests:
            return None
        line = min(rests, key=lambda one: one.number)
        came = "nothing more was read" if line.kind == HEARD else "nothing more was sent"
        return Difference(line.number, line.owner, f"'{line.kind} {line.text}'", came)

    def can(self, name: str, bus: CanBus) -> "Callable[[], can.BusABC]":
        """Return a function that connects to a CAN bus of the trace."""
        return lambda: _CanSide(self._wires[name])  # type: ignore[return-value]

    def i2c(self, name: str, bus: I2cBus) -> Callable[[], SmBus]:
        """Return a function that connects to an I2C bus of the trace."""
        return lambda: _I2cSide(self._wires[name])

    def serial(self, name: str, bus: LineBus) -> Callable[[], SerialLine]:
        """Return a function that connects to a serial line of the trace."""
        return lambda: _LineSide(self._wires[name])

    def emulator_of(self, device: str) -> Any:
        """Raise InputError: a trace holds no calls of a library."""
        raise InputError(f"{device} has no bus")

    def wait_for_disk(self) -> None:
        """Do nothing: a replay writes no run file."""

    def apply_weight_torque(self, torque: float) -> None:
        """Do nothing: a replay has no weights."""


class _LineSide:
    """A serial line of a replay, as a driver's port uses it."""

    def __init__(self, wire: Wire) -> None:
        wire.connect()
        self._wire = wire

    def read(self, timeout: float) -> bytes:
        text = self._wire.hear(timeout)
        return bytes.fromhex(text) if text else b""

    def write(self, data: bytes) -> int:
        return len(self._wire.send(data.hex())) // 2

    def close(self) -> None:
        """Do nothing: a replay opens nothing."""


class _CanSide:
    """A CAN bus of a replay, as a driver's port uses it."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire

    def send(self, message: "can.Message") -> None:
        self._wire.send(frame_text(message))

    def recv(self, timeout: float) -> "can.Message | None":
        import can

        text = self._wire.hear(timeout)
        if text is None:
            return None
        identifier, data, marks = [*text.split(" "), "", ""][:3]
        if data and set(data) <= set("xerFB"):
            data, marks = "", data
        return can.Message(
            timestamp=self._wire.now(),
            arbitration_id=int(identifier, 16),
            data=bytes.fromhex(data),
            is_extended_id="x" in marks,
            is_error_frame="e" in marks,
            is_remote_frame="r" in marks,
            is_fd="F" in marks,
            bitrate_switch="B" in marks,
        )

    def shutdown(self) -> None:
        """Do nothing: a replay opens nothing."""


class _I2cSide:
    """An I2C bus of a replay, as a driver's port uses it."""

    def __init__(self, wire: Wire) -> None:
        self._wire = wire

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        text = self._wire.transfer(HEARD, f"{i2c_addr:02x} {register:02x}")
        return swap_bytes(int(text.rpartition(" ")[2], 16))

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        self._wire.transfer(SENT, f"{i2c_addr:02x} {register:02x} {swap_bytes(value):04x}")

    def close(self) -> None:
        """Do nothing: a replay opens nothing."""


def replay(path: Path, file: BenchFile, devices: Sequence[CheckedDevice]) -> ReplayResult:
    """Repeat the calls of a trace on the drivers of its bench; devices without a bus are left out.

    Each run of the trace gets new drivers; an `open` after a `close` begins the next run.

    Raises
    ------
    InputError : `path` is no trace, has an invalid line, is of another bench, holds no call of a device on a bus, or
        holds no frame of the CAN buses in use.
    """
    lines = read_trace(path)
    bus_devices = [device for device in devices if device.entry.bus]
    buses = sorted({device.entry.bus or "" for device in bus_devices})
    callers = {line.owner for line in lines if line.kind == CALLED}
    called_buses = {device.entry.bus for device in bus_devices if device.name in callers} | callers.intersection(buses)
    expect_can_frames(
        path, lines, [name for name in buses if isinstance(file.buses[name], CanBus) and name in called_buses]
    )
    left_out = {device.name for device in devices} - {device.name for device in bus_devices}
    expect_calls(path, lines, left_out)
    wiring = ReplayWiring(lines, buses)
    bench = Bench(file, bus_devices, wiring)
    end_lines = _end_lines(lines)
    calls, raised, is_closed = 0, list[str](), False

    def result(difference: Difference | None) -> ReplayResult:
        return ReplayResult(calls, wiring.transfers, difference, tuple(dict.fromkeys(raised)), wiring.is_cut_short)

    for line in lines:
        if line.kind != CALLED or line.owner in left_out:
            continue
        method = line.text.partition(" ")[0]
        if method == "open" and is_closed:
            bench, is_closed = Bench(file, bus_devices, wiring), False
        is_closed = is_closed or method == "close"
        call = _call_in_line(path, line, bench)
        end_line = end_lines.get(line.number)
        wiring.call_ends = end_line.number if end_line else lines[-1].number
        wiring.is_cut_short = wiring.is_cut_short or end_line is None
        wiring.clock.set(line.time)
        try:
            outcome = outcome_text(call())
        except Diverged as divergence:
            return result(divergence.difference)
        except Exception as error:  # noqa: BLE001 (whatever a driver raises is what is compared)
            outcome = outcome_text(None, error)
            raised.append(f"{type(error).__name__}: {error}")
        if end_line is not None and differs_from_trace(outcome, end_line.text):
            difference = Difference(
                end_line.number, line.owner, f"'{end_line.text}'", f"{method} ended with '{outcome}'"
            )
            return result(difference)
        calls += 1
    return result(wiring.difference_at_the_end())


def _end_lines(lines: Sequence[TraceLine]) -> dict[int, TraceLine]:
    """Return the line at which each call ended, by the number of the line at which it began."""
    open_calls: dict[str, int] = {}
    end_lines = {}
    for line in lines:
        if line.kind == CALLED:
            open_calls[line.owner] = line.number
        elif line.kind == ENDED and line.owner in open_calls:
            end_lines[open_calls.pop(line.owner)] = line
    return end_lines


def _call_in_line(path: Path, line: TraceLine, bench: Bench) -> Callable[[], Any]:
    """Return the call that a line describes, as a function without arguments.

    Raises
    ------
    InputError : the device or its method does not exist, or the arguments are no JSON list.
    """
    name, _, text = line.text.partition(" ")
    try:
        arguments = json.loads(text)
    except ValueError:
        raise InputError(f"{path}:{line.number}  '{text[:40]}': arguments as a JSON list were expected") from None
    if line.owner in bench.syncs:
        return bench.syncs[line.owner]
    driver = bench.drivers.get(line.owner)
    function = getattr(driver, name, None)
    if driver is None or not callable(function) or not isinstance(arguments, list):
        raise InputError(f"{path}:{line.number}  '{line.owner} = {line.text[:40]}': no call of a device of this bench")
    if name == "engage":
        try:
            arguments = [Mode(*arguments)]
        except (ValueError, TypeError):
            modes = ", ".join(mode.value for mode in Mode)
            raise InputError(f"{path}:{line.number}  '{line.text[:40]}': one of {modes} was expected") from None
    if name == "end_cycle":
        return lambda: (function(*arguments), driver.values)[1]  # type: ignore[attr-defined]
    return lambda: function(*arguments)
