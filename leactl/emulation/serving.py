"""An emulated bench for drivers in other processes: its far ends answer on real buses, by the wall clock.

CAN goes over any of python-can's interfaces (`udp_multicast`, SocketCAN) or an slcan adapter on a pseudo terminal; I2C
goes through the kernel's i2c-stub, a plain register store that this process fills.
"""

import select
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import can

from leactl.bench.benchfile import BenchFile, CanBus, I2cBus
from leactl.bench.wiring import MachineWiring
from leactl.driver.far_end import I2cEmulator
from leactl.emulation.emulated_bench import EmulatedBench
from leactl.emulation.slcan import SlcanAdapter
from leactl.emulation.wires import CanWire, EmulatedCanBus
from leactl.errors import DeviceError, InputError

PACE_S = 0.002  # the plant is never further behind the wall clock than this
STUB_NAME = "SMBus stub driver"
STUB_PACE_S = 1e-4
ADS_CONVERSION, ADS_CONFIG, ADS_START = 0, 1, 0x8000


class HostSide(Protocol):
    """What the far ends need of a real bus."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Take one frame, or None where none is there."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send one frame."""

    def fileno(self) -> int:
        """What `select` waits for."""

    def shutdown(self) -> None:
        """Let go."""


class CanBridge:
    """One real bus, and the emulated segment behind it."""

    def __init__(self, real: HostSide, wire: CanWire) -> None:
        self.real = real
        self._inner = EmulatedCanBus(wire)

    def carry(self) -> None:
        """Pass on what has arrived on either side."""
        while (message := self.real.recv(0.0)) is not None:
            if not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                self._inner.send(message)
                self._answer()
        self._answer()

    def _answer(self) -> None:
        while self._inner.arrived:
            identifier, data = self._inner.arrived.popleft()
            self.real.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def close(self) -> None:
        """Let both sides go."""
        self._inner.shutdown()
        self.real.shutdown()


class StubConverter:
    """An ADS1115 behind one chip of i2c-stub: sees a conversion started there and puts its result there at its end."""

    def __init__(self, bus: Any, address: int, far_end: I2cEmulator) -> None:
        self._bus, self._address, self._far_end = bus, address, far_end
        self._busy = False
        self._put(ADS_CONFIG, far_end.read(ADS_CONFIG, 0.0))

    def carry(self, now: float) -> None:
        """Look at the store once."""
        if self._busy:
            held = self._far_end.read(ADS_CONFIG, now)
            if held & ADS_START:
                self._put(ADS_CONVERSION, self._far_end.read(ADS_CONVERSION, now))
                self._put(ADS_CONFIG, held)
                self._busy = False
            return
        asked = self._get(ADS_CONFIG)
        if asked & ADS_START and asked != self._far_end.read(ADS_CONFIG, now):
            self._far_end.write(ADS_CONFIG, asked, now)
            self._put(ADS_CONFIG, asked & ~ADS_START)
            self._busy = True

    def _get(self, register: int) -> int:
        high, low = self._bus.read_i2c_block_data(self._address, register, 2)
        return int(high) << 8 | int(low)

    def _put(self, register: int, value: int) -> None:
        self._bus.write_i2c_block_data(self._address, register, [value >> 8, value & 0xFF])


def real_buses(file: BenchFile, changed: Mapping[str, CanBus]) -> dict[str, tuple[CanBus, HostSide]]:
    """Open the real side of every CAN bus, with where it is; `changed` has those that the command line puts elsewhere.

    Raises
    ------
    InputError : the bus of the file exists in one process only.
    DeviceError : the bus is absent or refuses.
    """
    opened: dict[str, tuple[CanBus, HostSide]] = {}
    for name, bus in file.buses.items():
        if not isinstance(bus, CanBus):
            continue
        wanted = changed.get(name, bus)
        if wanted.interface == "pty":
            opened[name] = (wanted, SlcanAdapter())
            continue
        if wanted.interface in ("emulated", "virtual"):
            raise InputError(
                f"bus '{name}': interface '{wanted.interface}' ends with this process; put it elsewhere, as with"
                f" --bus {name}=udp_multicast:239.74.163.2, --bus {name}=socketcan:vcan0 or --bus {name}=pty"
            )
        try:
            opened[name] = (wanted, MachineWiring().can(name, wanted)())
        except (OSError, ValueError, ImportError, can.CanError) as error:
            raise DeviceError(f"bus '{name}': {error}") from None
    return opened


def stub_bus(number: int, root: Path = Path("/")) -> Any | None:
    """The i2c-stub of this number; None where there is none, so that no real chip is ever written to."""
    name = root / f"sys/class/i2c-dev/i2c-{number}/name"
    if not name.is_file() or not name.read_text(encoding="ascii").startswith(STUB_NAME):
        return None
    return MachineWiring().i2c("stub", I2cBus(kind="i2c", number=number))()


def serve(file: BenchFile, bench: EmulatedBench, buses: Mapping[str, HostSide], stop: Callable[[], bool]) -> list[str]:
    """Serve until `stop` says so; returns the I2C buses that no stub stood in for."""
    bridges = [CanBridge(real, bench.wires[name]) for name, real in buses.items()]
    converters: list[StubConverter] = []
    unserved: list[str] = []
    for name, bus in file.buses.items():
        if isinstance(bus, I2cBus):
            store = stub_bus(bus.number)
            if store is None:
                unserved.append(name)
            else:
                ends = bench.i2c_buses[name].devices
                converters += [StubConverter(store, address, end) for address, end in ends.items()]
    began = time.monotonic()
    handles = [bridge.real.fileno() for bridge in bridges]
    pace = STUB_PACE_S if converters else PACE_S
    try:
        while not stop():
            select.select(handles, [], [], pace)
            now = time.monotonic() - began
            bench.clock.sleep_until(now)
            for bridge in bridges:
                bridge.carry()
            for converter in converters:
                converter.carry(now)
    finally:
        for bridge in bridges:
            bridge.close()
    return unserved
