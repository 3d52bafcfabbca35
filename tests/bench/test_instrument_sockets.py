"""Raw sockets of instruments, over TCP connections of this machine, and what a bench file says of them."""

import errno
import json
import re
import select
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from leactl.bench import benchfile
from leactl.bench.benchfile import VisaBus
from leactl.bench.wiring import MachineWiring
from leactl.driver.clock import MonotonicClock
from leactl.driver.serial_port import SerialPort
from leactl.errors import DeviceError, InputError
from leactl.runner.locks import _bus_key
from tests.bench.test_serial_lines import SUPPLY

ROOT = Path(__file__).parents[2]
LONG_S = 20.0


class Instrument:
    """An instrument's side: a TCP server."""

    def __init__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.resource = f"TCPIP::127.0.0.1::{self.listener.getsockname()[1]}::SOCKET"
        self.client = None

    def accept(self):
        self.client, _ = self.listener.accept()
        self.client.settimeout(LONG_S)

    def close(self):
        self.listener.close()
        if self.client:
            self.client.close()


def port_at(resource):
    wiring = MachineWiring()
    return SerialPort(wiring.serial("supply0", VisaBus(kind="visa", resource=resource)), wiring.clock, "supply0")


@pytest.fixture
def far():
    far = Instrument()
    yield far
    far.close()


@pytest.fixture
def port(far):
    port = port_at(far.resource)
    port.open()
    far.accept()
    yield port
    port.close()


def test_lines_go_either_way_whatever_the_packets_are(far, port):
    port.write(b"*IDN?\n")
    assert far.client.recv(64) == b"*IDN?\n"
    far.client.sendall(b"RIGOL TECHNOLOGIES,DP811,DP8C1,00.01.16\n5.4")
    port.wait(MonotonicClock.now() + LONG_S)
    assert port.take_line() == b"RIGOL TECHNOLOGIES,DP811,DP8C1,00.01.16"
    assert port.take_line() is None
    far.client.sendall(b"000\n")
    port.wait(MonotonicClock.now() + LONG_S)
    assert port.take_line() == b"5.4000"


def test_an_instrument_that_closes_the_connection_is_gone(far, port):
    far.client.sendall(b"5.4000\n")
    far.client.close()
    port.wait(MonotonicClock.now() + LONG_S)
    assert port.take_line() == b"5.4000"
    with pytest.raises(DeviceError, match=r"the device is gone: 127.0.0.1 port \d+ has closed the connection; end"):
        port.wait(MonotonicClock.now() + LONG_S)


def test_a_new_connection_begins_without_what_the_old_one_left(far, port):
    far.client.sendall(b"half an ans")
    assert select.select([port._line._socket], [], [], LONG_S)[0]
    assert port.take_line() is None
    port.reopen()
    far.client.close()
    far.accept()
    far.client.sendall(b"0\n")
    port.wait(MonotonicClock.now() + LONG_S)
    assert port.take_line() == b"0"


def test_an_instrument_that_does_not_read_holds_nobody_up_and_hears_nothing_late(far, port):
    with pytest.raises(DeviceError, match=r"bus 'supply0': \d+ of 65536 bytes were not taken"):
        for _ in range(1000):
            port.write(b"x" * 65536)
    port.close()
    with pytest.raises(ConnectionResetError):  # an end in order would deliver all of it first
        while far.client.recv(65536):
            pass


def test_a_refused_connection_is_told_in_one_line():
    far = Instrument()
    far.close()
    with pytest.raises(DeviceError) as refused:
        port_at(far.resource).open()
    assert re.fullmatch(r"bus 'supply0': 127\.0\.0\.1 port \d+: the connection is refused; .*\?", str(refused.value))


def test_an_address_that_does_not_answer_is_given_up():
    """A listener whose queue is full drops what else comes, as an instrument that is off does."""
    listener = socket.create_server(("127.0.0.1", 0), backlog=0)
    resource = f"TCPIP::127.0.0.1::{listener.getsockname()[1]}::SOCKET"
    waiting = []
    began = time.monotonic()
    try:
        with pytest.raises(DeviceError, match=r"port \d+: no answer within 0\.3 s; is it switched on"):
            for _ in range(8):
                waiting.append(port_at(resource))
                waiting[-1].open()
    finally:
        for port in waiting:
            port.close()
        listener.close()
    assert time.monotonic() - began < LONG_S


PULLED = """
import json, socket, subprocess, sys
from leactl.driver.clock import MonotonicClock
from leactl.errors import DeviceError
from tests.bench.test_instrument_sockets import Instrument, port_at

subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
far = Instrument()
port = port_at(far.resource)
port.open()
far.accept()
subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
began = MonotonicClock.now()
try:
    port.write(b"OUTP ON\\n")
    port.wait(began + 20.0)
    told = "nothing"
except DeviceError as error:
    told = str(error)
took = MonotonicClock.now() - began
subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
far.client.settimeout(2.0)
try:
    heard = far.client.recv(64).decode()
except OSError as error:
    heard = type(error).__name__
print(json.dumps([told, took, heard]))
"""


def test_what_was_sent_into_a_pulled_cable_is_dropped_and_told(tmp_path):
    """In a network of its own, whose only interface goes down; the output must not go on once it is up again."""
    isolated = ["unshare", "--user", "--map-root-user", "--net"]
    if not (shutil.which("unshare") and shutil.which("ip")) or subprocess.run([*isolated, "true"]).returncode:
        pytest.skip("no network namespaces here")
    done = subprocess.run([*isolated, sys.executable, "-c", PULLED], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told, took, heard = json.loads(done.stdout)
    assert told == f"bus 'supply0': the device is gone: [Errno {errno.ETIMEDOUT}] Connection timed out"
    assert took < LONG_S
    assert heard in ("TimeoutError", "ConnectionResetError")


def write(tmp_path, resource, driver="scpi_supply"):
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    bench["buses"]["lan"] = {"kind": "visa", "resource": resource}
    bench["devices"]["supply"] = SUPPLY | {"bus": "lan", "driver": driver}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    return str(path)


@pytest.mark.parametrize("resource", ["TCPIP::192.168.0.5::5025::SOCKET", "tcpip0::192.168.0.5::5025::socket"])
def test_a_resource_names_address_and_port(tmp_path, resource):
    file = benchfile.load(write(tmp_path, resource))[0]
    assert file.buses["lan"].address == ("192.168.0.5", 5025)
    assert _bus_key(file.buses["lan"])[0] == "tcp-192.168.0.5-5025"


@pytest.mark.parametrize(
    ("resource", "said"),
    [
        ("TCPIP::192.168.0.5::INSTR", "not the name of a raw socket; TCPIP::ADDRESS::PORT::SOCKET was expected"),
        ("USB0::0x1AB1::0x0E11::DP8C1::INSTR", "not the name of a raw socket"),
        ("TCPIP::192.168.0.5::SOCKET", "not the name of a raw socket"),
        ("TCPIP::192.168.0.5::5025::SOCKET\n", "not the name of a raw socket"),
        ("TCPIP::supply.lab::5025::SOCKET", "'supply.lab' is not an IPv4 address; one was expected"),
        ("TCPIP::192.168.0.256::5025::SOCKET", "'192.168.0.256' is not an IPv4 address"),
        ("TCPIP::0.0.0.0::5025::SOCKET", "0.0.0.0 is not the address of one instrument"),
        ("TCPIP::224.0.0.1::5025::SOCKET", "224.0.0.1 is not the address of one instrument"),
        ("TCPIP::192.168.0.5::0::SOCKET", "port 0; 1 to 65535 was expected"),
        ("TCPIP::192.168.0.5::65536::SOCKET", "port 65536; 1 to 65535 was expected"),
        (5025, "5025: a text was expected"),
    ],
)
def test_a_resource_that_is_no_raw_socket_is_refused(tmp_path, resource, said):
    with pytest.raises(InputError, match=r"buses\.lan.*" + re.escape(said)) as refused:
        benchfile.load(write(tmp_path, resource))
    assert len([fault for fault in refused.value.faults if "buses.lan" in fault]) == 1


def test_an_instrument_has_one_driver_whatever_its_buses_are_called(tmp_path):
    path = Path(write(tmp_path, "TCPIP::192.168.0.5::5025::SOCKET"))
    bench = yaml.safe_load(path.read_text())
    bench["buses"]["again"] = {"kind": "visa", "resource": "tcpip0::192.168.0.5::5025::socket"}
    bench["devices"]["other"] = SUPPLY | {"bus": "again", "settings": dict(SUPPLY["settings"])}
    path.write_text(yaml.safe_dump(bench, sort_keys=False))
    with pytest.raises(InputError, match=r"192\.168\.0\.5 port 5025 is that of supply; another one was expected"):
        benchfile.load(str(path))


def test_a_driver_for_a_serial_line_alone_is_refused(tmp_path):
    with pytest.raises(InputError, match="'lan': bk1688b needs a bus of kind serial under buses"):
        benchfile.load(write(tmp_path, "TCPIP::192.168.0.5::5025::SOCKET", driver="bk1688b"))


def test_a_socket_is_put_elsewhere(tmp_path):
    file = benchfile.load(write(tmp_path, "TCPIP::192.168.0.5::5025::SOCKET"))[0]
    changed = benchfile.changed_buses(file, ["lan=visa:TCPIP::127.0.0.1::5555::SOCKET"])
    assert changed["lan"].address == ("127.0.0.1", 5555)
    with pytest.raises(InputError, match=r"--bus lan=visa:here: not the name of a raw socket"):
        benchfile.changed_buses(file, ["lan=visa:here"])
    with pytest.raises(InputError, match=r"NAME=visa:RESOURCE, with a raw socket of it, .*\(can0, lan\)"):
        benchfile.changed_buses(file, ["lan=serial:/dev/ttyUSB0"])
