"""Traces of a supply behind a real TCP connection, replayed by the command: sound, cut off, and never connected."""

import json
import socket
from contextlib import suppress

import pytest

from leactl.bench import benchfile
from leactl.bench.bench import Bench
from leactl.bench.benchfile import VisaBus
from leactl.bench.wire_replay import ReplayWiring
from leactl.bench.wire_trace import CALLS, TracedLine, TracedWiring, WireTrace, read_trace
from leactl.bench.wiring import MachineWiring
from leactl.driver.serial_port import SerialPort
from leactl.emulation.clock import EmulatedClock
from leactl.errors import DeviceError
from tests.cli.terminal import leactl

from .supply_bench import HEATED, SupplyBench

PERIOD_S = 0.2
FILE = """
name: traced-over-tcp
motors: {{test: lea, load: lea}}
buses:
  lan: {{kind: visa, resource: "{resource}"}}
devices:
  supply: {{driver: scpi_supply, bus: lan, role: test, settings: {settings}}}
limits: {{current_A: 30, velocity_rad_s: 40, torque_Nm: 17, bus_voltage_low_V: 20, bus_voltage_high_V: 60, age_s: 2.5,
  winding_temperature_degC: 130}}
"""


class Traced:
    """A bench whose only device is a supply at this resource, and the trace of what is done with it."""

    def __init__(self, folder, resource):
        self.path, self.bench_path = folder / "run.trace", folder / "bench.yaml"
        settings = HEATED | {"answer_s": 2.0, "period_s": PERIOD_S}
        self.bench_path.write_text(FILE.format(resource=resource, settings=json.dumps(settings)))
        file, devices, _ = benchfile.load(str(self.bench_path))
        self.trace = WireTrace(self.path)
        self.bench = Bench(file, devices, TracedWiring(MachineWiring(), self.trace))
        self.bench.pass_calls_through(self.trace.trace_calls, CALLS)
        self.clock, self.supply = self.bench.clock, self.bench.drivers["supply"]

    def rows(self, count):
        """Rows of the loop, none of whose looks is near the end of a period: times differ by some us in a replay."""
        rows, end = [], self.clock.now() + 30.0
        while len(rows) < count and self.clock.now() < end:
            taken = self.supply.take()
            rows += taken
            self.clock.sleep_until(self.clock.now() + (1.25 * PERIOD_S if taken else 0.005))
        return rows

    def replayed(self):
        """What the command tells of the trace."""
        self.trace.__exit__()
        done = leactl("driver", "replay", self.path, "--bench", self.bench_path, "--json")
        answer = json.loads(done.stdout)
        assert (done.returncode, answer["difference"]) == (0, None), done.stderr
        return answer

    def wires(self):
        return [line for line in read_trace(self.path) if line.kind in "><!"]


@pytest.fixture
def far(make_at_line):
    """A supply behind a TCP server in another process."""
    return make_at_line(SupplyBench, "tcp")


@pytest.fixture
def traced(far, tmp_path):
    made = Traced(tmp_path, far.wire.resource)
    yield made
    with suppress(DeviceError):
        made.supply.close()


def test_a_supply_over_tcp_is_replayed_to_the_last_byte(traced):
    traced.bench.open()
    traced.supply.supply(8.0, 9.0)
    traced.supply.switch_on()
    assert len(traced.rows(3)) == 3
    assert traced.supply.safe_state(2.0).safe
    traced.bench.close()
    told = traced.replayed()
    wires = traced.wires()
    assert told["transfers"] == len(wires)
    assert (told["raised"], told["cut_short"]) == ([], False)
    assert {line.owner for line in wires} == {"lan"}
    sent = b"".join(bytes.fromhex(line.text) for line in wires if line.kind == ">")
    assert b"*IDN?\n" in sent
    assert b"OUTP ON\n" in sent


def test_a_connection_that_ends_is_replayed_with_the_new_one_that_made_it_safe(traced):
    traced.bench.open()
    traced.rows(1)
    host, port = traced.bench.file.buses["lan"].address
    with socket.create_connection((host, port)):
        with pytest.raises(DeviceError) as gone:
            traced.rows(100)
        assert traced.supply.safe_state(2.0).safe
    traced.bench.close()
    told = traced.replayed()
    assert any(line.kind == "!" for line in traced.wires())
    assert told["raised"] == [f"DeviceError: {gone.value}"]


def test_a_connection_that_is_refused_is_replayed(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        port = nobody.getsockname()[1]
    traced = Traced(tmp_path, f"TCPIP::127.0.0.1::{port}::SOCKET")
    with pytest.raises(DeviceError, match="the connection is refused"):
        traced.bench.open()
    told = traced.replayed()
    assert len(told["raised"]) == 1
    assert "the connection is refused" in told["raised"][0]
    assert {line.kind for line in traced.wires()} == {"!"}


class Full:
    """A line that takes three bytes."""

    def write(self, data):
        return min(3, len(data))

    def read(self, timeout):
        return b""

    def close(self): ...


def test_bytes_that_a_full_line_did_not_take_are_not_taken_again(tmp_path):
    def refused(connect):
        port = SerialPort(connect, EmulatedClock(), "lan")
        port.open()
        with pytest.raises(DeviceError) as told:
            port.write(b"OUTP ON\n")
        return str(told.value)

    path = tmp_path / "full.trace"
    with WireTrace(path) as trace:
        said = refused(lambda: TracedLine(Full(), "lan", trace))
    assert said == "bus 'lan': 5 of 8 bytes were not taken"
    bus = VisaBus(kind="visa", resource="TCPIP::127.0.0.1::5025::SOCKET")
    assert refused(ReplayWiring(read_trace(path), ["lan"]).serial("lan", bus)) == said
