"""Serial lines of this machine, over pseudo terminals, and what a bench file says of them."""

import os
import time
from copy import deepcopy

import pytest
import yaml

from leactl.bench import benchfile
from leactl.bench.benchfile import SerialBus
from leactl.bench.tty import Tty
from leactl.bench.wiring import MachineWiring
from leactl.driver.clock import MonotonicClock
from leactl.driver.serial_port import SerialPort
from leactl.emulation.wires.pseudo_terminal import PseudoTerminal
from leactl.errors import DeviceError, InputError

SUPPLY = {
    "driver": "scpi_supply",
    "bus": "line",
    "role": "test",
    "settings": {
        "dialect": "e36xx",
        "model": "E3633A",
        "feeds": "leads",
        "voltage_limit_V": 8.0,
        "current_limit_A": 10.0,
    },
}


@pytest.fixture
def far():
    far = PseudoTerminal()
    yield far
    far.close()


@pytest.fixture
def port(far):
    wiring = MachineWiring()
    port = SerialPort(wiring.serial("line", SerialBus(kind="serial", port=far.path)), wiring.clock, "line")
    port.open()
    yield port
    port.close()


def write(tmp_path, **changes):
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    bench["buses"]["line"] = {"kind": "serial", **changes}
    bench["devices"]["supply"] = SUPPLY
    return bench, tmp_path / "bench.yaml"


def test_lines_go_either_way(far, port):
    port.write(b"*IDN?\n")
    assert far.read() == b"*IDN?\n"
    far.write(b"HEWLETT-PACKARD,E3633A,0,1\r\n+5.4")
    port.wait(MonotonicClock.now() + 5.0)
    assert port.take_line() == b"HEWLETT-PACKARD,E3633A,0,1"
    assert port.take_line() is None


def test_a_wait_ends_at_its_moment(port):
    began = time.monotonic()
    port.wait(began + 0.05)
    assert 0.05 <= time.monotonic() - began < 1.0


def test_a_line_that_nobody_reads_holds_nobody_up(port):
    with pytest.raises(DeviceError, match=r"bus 'line': \d+ of 4096 bytes were not taken"):
        for _ in range(100):
            port.write(b"x" * 4096)
    began = time.monotonic()
    port.close()
    assert time.monotonic() - began < 1.0


def test_a_device_that_is_pulled_out_is_told(far, port):
    os.close(far._master)
    far._master = os.open(os.devnull, os.O_RDONLY)
    os.close(far._slave)
    far._slave = os.open(os.devnull, os.O_RDONLY)
    with pytest.raises(DeviceError, match="bus 'line': the device is gone"):
        port.wait(MonotonicClock.now() + 1.0)


def test_a_device_that_is_held_by_another_program_is_refused(far, port):
    with pytest.raises(OSError, match="another program holds it"):
        Tty(SerialBus(kind="serial", port=far.path))


@pytest.mark.parametrize(
    ("place", "said"),
    [
        ("/dev/ttyNOWHERE", "bus 'line': /dev/ttyNOWHERE: no such device; is it plugged in and switched on?"),
        ("/dev/null", "bus 'line': /dev/null: "),
    ],
)
def test_what_cannot_be_opened_is_told_in_one_line(place, said):
    wiring = MachineWiring()
    port = SerialPort(wiring.serial("line", SerialBus(kind="serial", port=place)), wiring.clock, "line")
    with pytest.raises(DeviceError) as refused:
        port.open()
    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("settings", "seconds"),
    [({}, 10 / 9600), ({"stop_bits": 2, "parity": "even", "data_bits": 7, "baudrate": 19200}, 11 / 19200)],
)
def test_a_byte_takes_its_bits(settings, seconds):
    assert SerialBus(kind="serial", **settings).byte_s == pytest.approx(seconds)


@pytest.mark.parametrize("wrong", [{"baudrate": 0}, {"parity": "mark"}, {"port": ""}, {"speed": 9600}])
def test_a_line_that_makes_no_sense_is_refused(tmp_path, wrong):
    bench, path = write(tmp_path, **wrong)
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    with pytest.raises(InputError, match=r"buses\.line"):
        benchfile.load(str(path))


def test_a_serial_line_has_one_device(tmp_path):
    bench, path = write(tmp_path)
    bench["devices"]["other"] = deepcopy(SUPPLY)
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    with pytest.raises(InputError, match="bus 'line' is that of supply; another one was expected"):
        benchfile.load(str(path))


def test_a_supply_needs_a_serial_line(tmp_path):
    bench, path = write(tmp_path)
    bench["devices"]["supply"] = SUPPLY | {"bus": "can0"}
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    with pytest.raises(InputError, match="'can0': scpi_supply needs line"):
        benchfile.load(str(path))


def test_a_serial_line_is_put_elsewhere(tmp_path):
    bench, path = write(tmp_path)
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    file = benchfile.load(str(path))[0]
    assert benchfile.changed_buses(file, ["line=serial:/dev/pts/7"])["line"].port == "/dev/pts/7"
    with pytest.raises(InputError, match=r"NAME=serial:PORT, with a serial line of it \(can0, line\)"):
        benchfile.changed_buses(file, ["line=pty"])
