"""List the wires of this machine, and scan those that no run uses for devices that answer.

A wire is locked like the bus of a run while it is scanned: a run that begins meanwhile is refused, and a wire that a
run has locked is not scanned.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path

from pydantic import ValidationError

from leactl.bench.benchfile import Bus, CanBus, I2cBus, SerialBus, VisaBus
from leactl.bench.host_checks import bring_up_command, can_interfaces, i2c_buses, is_up
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
CONSOLES = "sys/class/tty/console/active"  # lists the serial consoles; a shell there may take a probe for a command
LONGEST_BUS_NAME = 40  # characters, in a bench file


@dataclass(frozen=True)
class ScannedWire:
    """A wire of this machine, with its possible settings."""

    name: str  # in a bench file
    shown: str  # to a person
    buses: tuple[Bus, ...]  # one for each set of settings with which the wire may be opened


def named_wires(
    can: Sequence[str], i2c: Sequence[int], serial: Sequence[str], lan: Sequence[str], bitrate: int
) -> list[ScannedWire]:
    """Return the wires that a person names.

    Parameters
    ----------
    can : each as `[INTERFACE:]CHANNEL`.
    lan : each as `ADDRESS[:PORT]`.
    bitrate : of every CAN bus [bit/s].

    Raises
    ------
    InputError : one line for each word that names no wire.
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
    named_wires_so_far: list[ScannedWire] = []
    for wire in {wire.shown: wire for wire in wires}.values():
        taken_names = {earlier.name for earlier in named_wires_so_far}
        numbered_names = (f"{wire.name[: LONGEST_BUS_NAME - 1 - len(str(number))]}_{number}" for number in count(2))
        named_wires_so_far.append(
            replace(wire, name=next(name for name in chain([wire.name], numbered_names) if name not in taken_names))
        )
    return named_wires_so_far


def wires_of_this_machine(root: Path = Path("/")) -> list[ScannedWire]:
    """Return the kernel's CAN interfaces, the I2C buses, and the serial ports except those of the system's console."""
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
    """Scan one wire and fill its report; a fault of the wire is stored there beside the answers that came before it.

    Raises
    ------
    Stopped : the watcher stops the scan.
    """
    try:
        with locks.bus_held(wire.buses[0]):
            _ask(wire, report, watcher, wiring or MachineWiring())
        report.complete = True
    except DeviceError as error:
        report.fault = str(error)


def _ask(wire: ScannedWire, report: WireReport, watcher: Watcher, wiring: Wiring) -> None:
    """Send the probes for the kind of the wire, and fill the report with the answers."""
    bus = wire.buses[0]
    if isinstance(bus, CanBus):
        ask_can(report, wiring.can(wire.name, bus), wiring.clock, can_probes(), watcher, fd=_carries_fd(bus))
    elif isinstance(bus, I2cBus):
        ask_i2c(report, wiring.i2c(wire.name, bus), wiring.clock, i2c_probes(), watcher)
    else:
        lines = [line_bus for line_bus in wire.buses if isinstance(line_bus, SerialBus | VisaBus)]
        probes = line_probes(bus.kind)
        ask_line(report, lambda line: wiring.serial(wire.name, line)(), wiring.clock, probes, lines, watcher)


def _carries_fd(bus: CanBus) -> bool:
    """Return whether an interface carries CAN-FD frames.

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
            f"{bus.channel}: there is no such CAN interface; connect its adapter, then:"
            f" {bring_up_command(str(bus.channel))}"
        )
    if not is_up(state):
        raise DeviceError(f"{bus.channel}: the interface is {state}; {bring_up_command(str(bus.channel))}")
    return bool(bus.options.get("fd"))


def _can_wire(word: str, bitrate: int) -> ScannedWire:
    """Return `[INTERFACE:]CHANNEL` as a wire.

    Raises
    ------
    InputError : the channel is missing, or python-can does not know the interface.
    """
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
    """Return python-can's option for CAN FD if the kernel has set up the interface for it, else no option."""
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
    """Return a serial port as a wire, with every baud rate at which a driver has a probe."""
    rates = rates_of(line_probes("serial").values())
    buses = tuple(SerialBus(kind="serial", port=port, baudrate=rate) for rate in rates)
    return ScannedWire(_name(Path(port).name), port, buses)


def _lan_wire(word: str) -> ScannedWire:
    """Return `ADDRESS[:PORT]` as a wire; if the port is missing, with every port of `SOCKET_PORTS`."""
    host, colon, port = word.partition(":")
    ports = [port] if colon else SOCKET_PORTS
    buses = tuple(VisaBus(kind="visa", resource=f"TCPIP::{host}::{number}::SOCKET") for number in ports)
    return ScannedWire(_name(f"lan_{host}"), word, buses)


def _name(text: str) -> str:
    """Return a text as a name that is valid in a bench file."""
    valid_text = re.sub(r"[^a-z0-9_]+", "_", text.lower()).strip("_")
    return f"{'' if valid_text[:1].isalpha() else 'bus_'}{valid_text}"[:LONGEST_BUS_NAME].rstrip("_")
