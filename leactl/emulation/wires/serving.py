"""An emulated bench for drivers in other processes: its far ends answer on real buses, by the wall clock.

CAN uses any of python-can's interfaces (`udp_multicast`, SocketCAN) or an slcan adapter on a pseudo terminal; I2C uses
the kernel's i2c-stub, a plain register store that this process fills; a serial line is a pseudo terminal, and the raw
socket of an instrument a TCP server.
"""

import select
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Protocol

import can

from leactl.bench.benchfile import BenchFile, CanBus, I2cBus, SerialBus, VisaBus
from leactl.bench.wiring import MachineWiring
from leactl.driver.far_end import StoreKeeper
from leactl.driver.i2c_port import SmBus, swap_bytes
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.buses import CanWire, EmulatedCanBus, message_of
from leactl.emulation.wires.listening_socket import ListeningSocket
from leactl.emulation.wires.pseudo_terminal import PseudoTerminal
from leactl.emulation.wires.serial import EmulatedSerialLine, SerialWire
from leactl.emulation.wires.slcan import SlcanAdapter
from leactl.errors import DeviceError, InputError

LONGEST_LAG_S = 0.002  # by which the plant may be behind the wall clock
STUB_NAME = "SMBus stub driver"  # in sysfs
LONGEST_STUB_LAG_S = 1e-4  # instead, if a chip of i2c-stub is served
MOST_FRAMES_AT_ONCE = 64  # of a host; a cycle of two drives has seven


class HostSide(Protocol):
    """The part of a real CAN bus that the far ends use."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return one frame, or None if there is none."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame."""

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""

    def shutdown(self) -> None:
        """Close the bus."""


class Bridge(Protocol):
    """A real bus joined to an emulated one."""

    address: str  # tells the user how to open the real bus

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""

    def carry(self) -> None:
        """Pass on what has arrived on either side."""

    def close(self) -> None:
        """Close both sides."""


class CanBridge:
    """A real CAN bus joined to the emulated segment."""

    def __init__(self, address: str, real_bus: HostSide, wire: CanWire) -> None:
        self.address, self.real_bus = address, real_bus
        self._emulated_bus = EmulatedCanBus(wire)

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""
        return self.real_bus.fileno()

    def carry(self) -> None:
        """Pass on the frames of both sides, up to a limit: a busy host must not hold up the bench's time."""
        for _ in range(MOST_FRAMES_AT_ONCE):
            message = self.real_bus.recv(0.0)
            if message is None:
                break
            if message.is_fd or not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                with suppress(can.CanOperationError):  # the emulated bus is off: the host's frame is lost
                    self._emulated_bus.send(message)
                self._pass_answers()
        self._pass_answers()

    def _pass_answers(self) -> None:
        """Send the frames that have arrived from the emulated bus to the real one."""
        while self._emulated_bus.arrived:
            self.real_bus.send(message_of(self._emulated_bus.arrived.popleft()))

    def close(self) -> None:
        """Close both sides."""
        self._emulated_bus.shutdown()
        self.real_bus.shutdown()


class SerialBridge:
    """A pseudo terminal joined to the emulated serial line."""

    def __init__(self, wire: SerialWire) -> None:
        self._terminal = PseudoTerminal()
        self.address = f"serial on {self._terminal.path}"
        self._emulated_line = EmulatedSerialLine(wire)

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""
        return self._terminal.fileno()

    def carry(self) -> None:
        """Pass on the bytes of both sides."""
        self._emulated_line.write(self._terminal.read())
        if answer := self._emulated_line.read(0.0):
            self._terminal.write(answer)

    def close(self) -> None:
        """Close both sides."""
        self._emulated_line.close()
        self._terminal.close()


class SocketBridge:
    """A TCP server joined to the emulated line."""

    def __init__(self, wire: SerialWire) -> None:
        self._server, self._wire = ListeningSocket(), wire
        self.address = f"visa on {self._server.resource}"
        self._emulated_line = EmulatedSerialLine(wire)

    def fileno(self) -> int:
        """Return the descriptor that `select` waits for."""
        return self._server.fileno()

    def carry(self) -> None:
        """Pass on the bytes of both sides; answers for an earlier client than the present one are dropped."""
        if self._server.accept():
            self._emulated_line = EmulatedSerialLine(self._wire)
        self._emulated_line.write(self._server.read())
        if answer := self._emulated_line.read(0.0):
            self._server.write(answer)

    def close(self) -> None:
        """Close both sides."""
        self._emulated_line.close()
        self._server.close()


class StubChip:
    """One chip of i2c-stub, whose registers a device's far end maintains."""

    def __init__(self, bus: SmBus, address: int, keeper: StoreKeeper, silent: Sequence[object] = ()) -> None:
        self._bus, self._address, self._keeper, self._silent = bus, address, keeper, silent

    def read(self, register: int) -> int:
        """Read a register of the chip."""
        return swap_bytes(self._bus.read_word_data(self._address, register))

    def write(self, register: int, value: int) -> None:
        """Write a register of the chip."""
        self._bus.write_word_data(self._address, register, swap_bytes(value))

    def carry(self, now: float) -> None:
        """Let the far end update the registers; those of an unplugged chip can be read, but do not change any more."""
        if self._keeper not in self._silent:
            self._keeper.keep(self, now)


@contextmanager
def bridge_buses(
    file: BenchFile, wires: Mapping[str, CanWire], serial_wires: Mapping[str, SerialWire]
) -> Iterator[dict[str, Bridge]]:
    """Bridge every CAN bus, serial line and raw socket of the file to its wire within the block.

    Raises
    ------
    InputError : a bus of the file exists in one process only.
    DeviceError : a bus is absent or cannot be opened.
    """
    with ExitStack() as open_bridges:
        bridges: dict[str, Bridge] = {}
        for name, bus in file.buses.items():
            if isinstance(bus, CanBus):
                address, real_bus = _open_real_bus(name, bus)
                bridges[name] = CanBridge(address, real_bus, wires[name])
            elif isinstance(bus, SerialBus):
                bridges[name] = SerialBridge(serial_wires[name])
            elif isinstance(bus, VisaBus):
                bridges[name] = SocketBridge(serial_wires[name])
            else:
                continue
            open_bridges.callback(bridges[name].close)
        yield bridges


def _open_real_bus(name: str, bus: CanBus) -> tuple[str, HostSide]:
    """Open the real CAN bus of a bench file, or an slcan adapter; return its address for the user, and the bus.

    Raises
    ------
    InputError : the interface ends with this process.
    DeviceError : the bus cannot be opened.
    """
    if bus.interface == "pty":
        adapter = SlcanAdapter()
        return f"slcan on {adapter.path}", adapter
    if bus.interface in ("emulated", "virtual"):
        raise InputError(
            f"bus '{name}': interface '{bus.interface}' ends with this process; put it elsewhere, as with"
            f" --bus {name}=udp_multicast:239.74.163.2, --bus {name}=socketcan:vcan0 or --bus {name}=pty"
        )
    try:
        return f"{bus.interface} {bus.channel}", MachineWiring().can(name, bus)()
    except (OSError, ValueError, ImportError, can.CanError) as error:
        raise DeviceError(f"bus '{name}': {error}") from None


def stub_bus(number: int, root: Path = Path("/")) -> SmBus | None:
    """Return the bus of an i2c-stub; None if the bus is no stub, so that no real chip is ever written to."""
    name_file = root / f"sys/class/i2c-dev/i2c-{number}/name"
    if not name_file.is_file() or not name_file.read_text(encoding="ascii").startswith(STUB_NAME):
        return None
    return MachineWiring().i2c("stub", I2cBus(kind="i2c", number=number))()


def stub_chips(file: BenchFile, bench: EmulatedBench) -> dict[str, list[StubChip]]:
    """Return the chips of i2c-stub by I2C bus of the file; none for a bus whose number is not that of a stub.

    Raises
    ------
    InputError : a device's far end cannot keep the registers of a stub.
    DeviceError : the stub cannot be opened.
    """
    chips: dict[str, list[StubChip]] = {}
    for name, bus in file.buses.items():
        if not isinstance(bus, I2cBus):
            continue
        try:
            stub_port = stub_bus(bus.number)
        except OSError as error:
            raise DeviceError(f"bus '{name}': {error}") from None
        chips[name] = []
        emulated_bus = bench.i2c_buses[name]
        for address, far_end in emulated_bus.devices.items():
            if stub_port is None:
                continue
            if not isinstance(far_end, StoreKeeper):
                raise InputError(f"bus '{name}': the emulator at address 0x{address:02X} cannot stand behind i2c-stub")
            chips[name].append(StubChip(stub_port, address, far_end, emulated_bus.silent))
    return chips


def serve(clock: EmulatedClock, bridges: Sequence[Bridge], chips: Sequence[StubChip], stop: Callable[[], bool]) -> None:
    """Serve until `stop` returns true, with the clock in step with the wall clock.

    Raises
    ------
    DeviceError : a real bus failed.
    """
    start_time = time.monotonic() - clock.now()
    descriptors = [bridge.fileno() for bridge in bridges]
    longest_wait = LONGEST_STUB_LAG_S if chips else LONGEST_LAG_S
    try:
        while not stop():
            select.select(descriptors, [], [], longest_wait)
            clock.sleep_until(time.monotonic() - start_time)
            for bridge in bridges:
                bridge.carry()
            for chip in chips:
                chip.carry(clock.now())
    except (OSError, can.CanError) as error:
        raise DeviceError(f"a served bus failed: {error}") from None
