"""Which wires of a machine are scanned, how they are called in a bench file, and what is told of one that cannot be."""

import re
import uuid
from types import SimpleNamespace

import pytest

from leactl.bench import benchfile
from leactl.bench.benchfile import CanBus, I2cBus
from leactl.bench.scan import Watcher, WireReport
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.report.scan import bench_file_part, lines
from leactl.runner import locks, scan
from leactl.runner.scan import ScannedWire, named_wires, wires_of_this_machine

QUIET = Watcher(lambda _text: None, lambda: None)


def test_without_a_name_the_wires_that_the_machine_has_are_scanned(tmp_path, monkeypatch):
    for name, kind in (("lo", "772"), ("can0", "280"), ("can1", "280")):
        folder = tmp_path / "sys/class/net" / name
        folder.mkdir(parents=True)
        (folder / "type").write_text(f"{kind}\n")
        (folder / "operstate").write_text("up\n")
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/i2c-1").touch()
    (tmp_path / "sys/class/tty/console").mkdir(parents=True)
    (tmp_path / "sys/class/tty/console/active").write_text("tty0 ttyS0\n")
    ports = [SimpleNamespace(device=f"/dev/{name}") for name in ("ttyUSB0", "ttyS0")]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    assert [(wire.shown, wire.name) for wire in wires_of_this_machine(tmp_path)] == [
        ("can0", "can0"),
        ("can1", "can1"),
        ("/dev/ttyUSB0", "ttyusb0"),
        ("/dev/i2c-1", "i2c1"),
    ]


def test_each_wire_has_a_name_that_a_bench_file_takes_and_no_other_has():
    ports = [
        "/dev/ttyUSB0",
        "/dev/a/ttyUSB0",
        "/dev/ttyUSB0_2",
        "/dev/serial/by-id/usb-Silicon_Labs_CP2102N_USB_to_UART_Bridge_Controller_0001",
    ]
    wires = named_wires(["can0", "can0", "slcan:/dev/ttyACM0"], [0], ports, ["10.0.0.7", "10.0.0.7:5025"], 500_000)
    names = [wire.name for wire in wires]
    assert len(wires) == len(set(names)) == 9
    assert all(re.fullmatch(r"[a-z][a-z0-9_]{0,39}", name) for name in names)
    adapter = next(wire.buses[0] for wire in wires if wire.shown == "slcan:/dev/ttyACM0")
    assert (adapter.interface, adapter.channel, adapter.bitrate) == ("slcan", "/dev/ttyACM0", 500_000)
    assert [bus.resource for bus in next(wire.buses for wire in wires if wire.shown == "10.0.0.7")] == [
        "TCPIP::10.0.0.7::5025::SOCKET",
        "TCPIP::10.0.0.7::5555::SOCKET",
    ]


def test_an_interface_that_is_down_is_told_with_the_command_that_brings_it_up(monkeypatch):
    monkeypatch.setattr(scan, "can_interfaces", lambda: {"can98": "down"})
    (wire,) = named_wires(["can98"], [], [], [], 1_000_000)
    report = WireReport(wire.shown)
    scan.scan(wire, report, QUIET)
    assert report.fault == "can98: the interface is down; sudo ip link set can98 up type can bitrate 1000000"
    assert not (report.complete or report.asked)


@pytest.fixture
def emulated():
    file, devices, _document = benchfile.load("emulated")
    return EmulatedBench(file, devices, "free", "")


def scanned(name, bus, wiring):
    wire = ScannedWire(name, name, (bus,))
    report = WireReport(name)
    scan.scan(wire, report, QUIET, wiring)
    return wire, report


def test_the_devices_of_a_whole_bench_are_seen_and_written_as_a_bench_file_has_them(emulated):
    can = CanBus(kind="can", interface="virtual", channel=uuid.uuid4().hex)
    both = [scanned("can0", can, emulated), scanned("i2c1", I2cBus(kind="i2c", number=98), emulated)]
    assert [report.fault for _wire, report in both] == ["", ""]
    assert [(each.driver, each.sighting.address) for _wire, report in both for each in report.answered] == [
        ("elmo_can", 1),
        ("elmo_can", 2),
        ("ads1115", 0x48),
    ]
    assert not any(machine.read()[1] > 0.1 for machine in emulated.machines.values())
    part = bench_file_part(both)
    assert "  i2c1: {kind: i2c, number: 98}\n" in part
    assert "      address: 72\n      inputs: FILL_IN  # such as [{name: torque, quantity: torque, role: test," in part
    assert any(line.startswith("i2c1         0x48        ads1115") for line in lines(both))


def test_a_bus_that_a_scan_holds_is_refused_to_a_second_one(emulated):
    bus = CanBus(kind="can", interface="virtual", channel=uuid.uuid4().hex)
    with locks.bus_held(bus):
        _wire, report = scanned("can0", bus, emulated)
    assert "is driven by a run, process" in report.fault
    assert report.answered == []


def test_a_text_with_line_feeds_from_a_device_stays_within_its_comment(emulated):
    bus = CanBus(kind="can", interface="virtual", channel=uuid.uuid4().hex)
    wire, report = scanned("can0", bus, emulated)
    first = report.answered[0]
    identity = first.sighting.identity._replace(model="drive\n  evil: {driver: elmo_can}")
    report.answered[0] = first._replace(sighting=first.sighting._replace(identity=identity))
    part = bench_file_part([(wire, report)])
    assert "  elmo_can_1:  # drive\\n  evil:" in part
    assert not any(line.startswith("  evil") for line in part.splitlines())
