"""Ways from a driver to its far end: in this process on emulated time, or in another process on a real bus.

LEACTL_TEST_CAN=INTERFACE:CHANNEL (as in socketcan:vcan0) and LEACTL_TEST_I2C=NUMBER (of an i2c-stub with a chip at
0x48) add the buses of this machine's kernel.
"""

import json
import os
import socket
import subprocess
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path

from leactl.bench.benchfile import CanBus, I2cBus, SerialBus, VisaBus
from leactl.bench.wiring import MachineWiring
from leactl.driver.clock import MonotonicClock
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.buses import CanWire, EmulatedCanBus, EmulatedI2cBus
from leactl.emulation.wires.serial import EmulatedSerialLine, SerialWire
from tests.driver.failing import SERIAL_ENDS, FailingConverter, FailingDrive

ROOT = Path(__file__).parents[2]
CAN = ["in_process", "udp_multicast", *(["kernel"] if "LEACTL_TEST_CAN" in os.environ else [])]
I2C = ["in_process", *(["kernel"] if "LEACTL_TEST_I2C" in os.environ else [])]

SERIAL = ["in_process", "pty"]


class CanInProcess:
    """An emulated wire; every answer is there when `send` returns, and time passes only by waiting."""

    exact = True
    returns_own = False
    settings = {}

    def __init__(self):
        self.clock = EmulatedClock()
        self.wire = CanWire(self.clock)

    def connect(self):
        return EmulatedCanBus(self.wire)

    def drive(self, node):
        return FailingDrive(self.wire, node)


class CanElsewhere:
    """A real bus; other load on the machine may hold up either side, so the times allowed are long."""

    exact = False
    settings = {"consumer_heartbeat_ms": 1000, "sdo_timeout_s": 1.0}

    def __init__(self, process, place, kind="failing"):
        self.clock, bus = MonotonicClock(), CanBus(kind="can", **place)
        self.connect, self.returns_own = MachineWiring().can("can0", bus), bus.returns_own
        self._process, self._kind = process, kind

    def drive(self, node):
        self._process.ask("new", self._kind, node)
        return FarEnd(self._process)


class I2cInProcess:
    exact = True

    def __init__(self):
        self.clock = EmulatedClock()
        self.bus = EmulatedI2cBus(self.clock)

    def connect(self):
        return self.bus

    def converter(self, clock_error):
        self.bus.devices[0x48] = FailingConverter(clock_error)
        return self.bus.devices[0x48]

    def look(self):
        """Nothing: the far end is called by the transfer itself."""


class I2cElsewhere:
    exact = False

    def __init__(self, process, place):
        self.clock = MonotonicClock()
        self.connect = MachineWiring().i2c("i2c-1", I2cBus(kind="i2c", **place))
        self._process = process

    def converter(self, clock_error):
        self._process.ask("new", clock_error)
        return FarEnd(self._process)

    def look(self):
        """Bring the store up to now: it tells nobody what was written, and the far end's own look may come late."""
        self._process.ask("look")


class SerialInProcess:
    """An emulated line, at 9600 baud with two stop bits where nothing else is said."""

    exact = True
    settings = {}

    def __init__(self, byte_s=11 / 9600):
        self.clock = EmulatedClock()
        self.wire = SerialWire(self.clock, byte_s)

    def connect(self):
        return EmulatedSerialLine(self.wire)

    def device(self, kind, *arguments):
        self.wire.device = SERIAL_ENDS[kind](*arguments)
        return self.wire.device


class SerialToLine:
    """A serial line by its port; other load on the machine may hold up either side, so the times allowed are long."""

    exact = False
    settings = {"answer_s": 2.0, "period_s": 0.2}

    def __init__(self, port):
        self.clock, self.port = MonotonicClock(), port
        self.connect = MachineWiring().serial("supply0", SerialBus(kind="serial", port=port))

    def device(self, *_arguments):
        """Nothing: whoever made the line has put a device there."""


class SerialElsewhere(SerialToLine):
    """A pseudo terminal, and what is at its end in another process."""

    def __init__(self, process, place):
        super().__init__(place["link"])
        self._process = process

    def device(self, kind, *arguments):
        self._process.ask("new", kind, *arguments)
        return FarEnd(self._process)


class SocketElsewhere:
    """A TCP server, and what is behind it in another process."""

    exact = False
    settings = SerialToLine.settings

    def __init__(self, process, place):
        self.clock = MonotonicClock()
        self.resource = Path(place["resource_file"]).read_text()
        self.connect = MachineWiring().serial("supply0", VisaBus(kind="visa", resource=self.resource))
        self._process = process

    def device(self, kind, *arguments):
        self._process.ask("new", kind, *arguments)
        return FarEnd(self._process)


class FarEnd:
    """The device in the other process; its methods are asked for there."""

    def __init__(self, process):
        self._process = process

    def __getattr__(self, name):
        return partial(self._process.ask, name)


class FarEndProcess:
    """A process with one far end on a real bus."""

    def __init__(self, kind, place):
        command = [sys.executable, "-m", "tests.driver.far_end_process", kind, json.dumps(place)]
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        assert self._answer() == "ready"

    def ask(self, name, *arguments):
        self._process.stdin.write(json.dumps([name, arguments]) + "\n")
        return self._answer()

    def _answer(self):
        line = self._process.stdout.readline()
        assert line, f"the far end's process ended with status {self._process.wait()}"
        return json.loads(line)

    def end(self):
        with suppress(BrokenPipeError):
            self._process.stdin.close()
        status = self._process.wait()
        self._process.stdout.close()
        assert status == 0


def can_place(transport):
    if transport == "kernel":
        interface, _, channel = os.environ["LEACTL_TEST_CAN"].partition(":")
        return {"interface": interface, "channel": channel}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:  # a port of our own: other tests may run beside
        free.bind(("", 0))
        port = free.getsockname()[1]
    return {"interface": "udp_multicast", "channel": "239.74.163.2", "options": {"port": port}}


def i2c_place():
    return {"number": int(os.environ["LEACTL_TEST_I2C"])}
