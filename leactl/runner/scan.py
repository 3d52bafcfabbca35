"""Scan wires of this machine that no run uses: which they are, how they are opened, and what each of them says.

A wire is held like the bus of a run while it is asked: a run that comes meanwhile is refused, and a wire that a run
holds is left alone.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import ValidationError

from leactl.bench.benchfile import Bus, CanBus, I2cBus, SerialBus, VisaBus
from leactl.bench.host_checks import bring_up, can_interfaces, i2c_buses, is_up
from leactl.bench.scan import (
    Watcher,
    WireReport,
    ask_can,
    ask_i2c,
    ask_line,
    can_probes,
    i2c_probes,
    line_probes,
    rates_of,
)
from leactl.bench.wiring import MachineWiring, Wiring, unknown_interface
from leactl.errors import DeviceError, InputError
from leactl.runner import locks

SOCKET_PORTS = (5025, 5555)  # of instruments: IANA's scpi-raw, and what Rigol uses
FD_MTU = "72"  # bytes of a CAN-FD frame in the kernel; 16 of a classic one
ALWAYS_FD = ("virtual", "udp_multicast")  # interfaces of python-can without a controller
CONSOLES = "sys/class/tty/console/active"  # on which a shell may take questions for commands
LONGEST_NAME = 40


@dataclass(frozen=True)
class ScannedWire:
    """A wire of this machine: its name in a bench file and for a person, and the ways in which it may be open."""

    name: str
    shown: str
    buses: tuple[Bus, ...]


def named_wires(
    can: Sequence[str], i2c: Sequence[int], serial: Sequence[str], lan: Sequence[str], bitrate: int
) -> list[ScannedWire]:
    """The wires that a person named; CAN as `[INTERFACE:]CHANNEL`, LAN as `ADDRESS[:PORT]`.

    Raises
    ------
    InputError : every word that names no wire.
    """
    wires: list[ScannedWire] = []
    faults: list[str] = []
    for words, make in ((can, lambda word: _can_wire(word, bitrate)), (serial, _serial_wire), (lan, _lan_wire)):
        for word in words:
            try:
                wires.append(make(word))
            except (InputError, ValidationError) as error:
                text = (
                    str(error)
                    if isinstance(error, InputError)
                    else error.errors()[0]["msg"].removeprefix("Value error, ")
                )
                faults.append(f"{word!r}: {text}")
    if faults:
        raise InputError(faults)
    wires += [_i2c_wire(number) for number in i2c]
    once = {wire.shown: wire for wire in wires}
    return [_with_a_name_of_its_own(wire, list(once.values())[:place]) for place, wire in enumerate(once.values())]


def _with_a_name_of_its_own(wire: ScannedWire, before: Sequence[ScannedWire]) -> ScannedWire:
    """The wire with another name where wires before it have the same."""
    alike = sum(other.name == wire.name for other in before)
    return replace(wire, name=f"{wire.name[: LONGEST_NAME - 2]}_{alike + 1}") if alike else wire


def wires_of_this_machine(root: Path = Path("/")) -> list[ScannedWire]:
    """CAN interfaces of the kernel, I2C buses and serial ports that are there, but for the system's console."""
    from serial.tools import list_ports

    numbers = [int(path.name.removeprefix("i2c-")) for path in i2c_buses(root)]
    try:
        consoles = (root / CONSOLES).read_text(encoding="ascii").split()
    except OSError:
        consoles = []
    ports = sorted(port.device for port in list_ports.comports() if Path(port.device).name not in consoles)
    bitrate = CanBus.model_fields["bitrate"].default
    return named_wires(list(can_interfaces(root)), numbers, ports, [], bitrate)


def scan(wire: ScannedWire, report: WireReport, watcher: Watcher, wiring: Wiring | None = None) -> None:
    """Ask one wire; a fault of it stands in the report, with what answered before.

    Raises
    ------
    Stopped : by the watcher.
    """
    try:
        with locks.bus_held(wire.buses[0]):
            _ask(wire, report, watcher, wiring or MachineWiring())
        report.complete = True
    except DeviceError as error:
        report.fault = str(error)


def _ask(wire: ScannedWire, report: WireReport, watcher: Watcher, wiring: Wiring) -> None:
    bus = wire.buses[0]
    if isinstance(bus, CanBus):
        ask_can(report, wiring.can(wire.name, bus), wiring.clock, can_probes(), watcher, fd=_ready(bus))
    elif isinstance(bus, I2cBus):
        ask_i2c(report, wiring.i2c(wire.name, bus), wiring.clock, i2c_probes(), watcher)
    else:
        lines = [each for each in wire.buses if isinstance(each, SerialBus | VisaBus)]
        probes = line_probes(bus.kind)
        ask_line(report, lambda line: wiring.serial(wire.name, line)(), wiring.clock, probes, lines, watcher)


def _ready(bus: CanBus) -> bool:
    """Whether an interface carries CAN-FD frames.

    Raises
    ------
    DeviceError : the kernel has no such interface, or it is down.
    """
    if bus.interface != "socketcan":
        return bus.interface in ALWAYS_FD
    states = can_interfaces()
    state = states.get(str(bus.channel))
    if state is None:
        raise DeviceError(
            f"{bus.channel}: there is no such CAN interface; connect its adapter, then: {bring_up(str(bus.channel))}"
        )
    if not is_up(state):
        raise DeviceError(f"{bus.channel}: the interface is {state}; {bring_up(str(bus.channel))}")
    return bool(bus.options.get("fd"))


def _can_wire(word: str, bitrate: int) -> ScannedWire:
    interface, colon, channel = word.partition(":")
    if not colon:
        interface, channel = "socketcan", word
    if not channel:
        raise InputError("can0 was expected, or INTERFACE:CHANNEL of python-can as in slcan:/dev/ttyACM0")
    bus = CanBus(
        kind="can", interface=interface, channel=channel, bitrate=bitrate, options=_options(interface, channel)
    )
    if fault := unknown_interface(bus):
        raise InputError(fault)
    return ScannedWire(_name(channel if interface == "socketcan" else f"can_{Path(channel).name}"), word, (bus,))


def _options(interface: str, channel: str) -> dict[str, bool]:
    if interface != "socketcan":
        return {}
    try:
        mtu = (Path("/sys/class/net") / channel / "mtu").read_text(encoding="ascii").strip()
    except (OSError, ValueError):
        return {}
    return {"fd": True} if mtu == FD_MTU else {}


def _i2c_wire(number: int) -> ScannedWire:
    return ScannedWire(f"i2c{number}", f"/dev/i2c-{number}", (I2cBus(kind="i2c", number=number),))


def _serial_wire(port: str) -> ScannedWire:
    rates = rates_of(line_probes("serial").values())
    buses = tuple(SerialBus(kind="serial", port=port, baudrate=rate) for rate in rates)
    return ScannedWire(_name(Path(port).name), port, buses)


def _lan_wire(word: str) -> ScannedWire:
    host, colon, port = word.partition(":")
    ports = [port] if colon else SOCKET_PORTS
    buses = tuple(VisaBus(kind="visa", resource=f"TCPIP::{host}::{each}::SOCKET") for each in ports)
    return ScannedWire(_name(f"lan_{host}"), word, buses)


def _name(text: str) -> str:
    """A name that a bench file takes."""
    plain = re.sub(r"[^a-z0-9_]+", "_", text.lower()).strip("_")
    return f"{'' if plain[:1].isalpha() else 'bus_'}{plain}"[:LONGEST_NAME].rstrip("_")
