"""A far end in a process of its own, on a real bus: `python -m tests.driver.far_end_process can|i2c|serial|tcp PLACE`.

Requests come as lines of JSON on stdin, [name, arguments], and each is answered by one line; the end of stdin ends it.
"""

import json
import os
import select
import sys
import time
from pathlib import Path

from leactl.bench.benchfile import CanBus
from leactl.bench.wiring import MachineWiring
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.buses import CanWire
from leactl.emulation.wires.serial import SerialWire
from leactl.emulation.wires.serving import CanBridge, SerialBridge, SocketBridge, StubChip, serve, stub_bus
from tests.driver.failing import DRIVES, SERIAL_ENDS, FailingConverter

CHIP = 0x48


class Requests:
    """What the test asks for: a new device, a look at the bus, or a method of the device."""

    def __init__(self, make, look):
        self._make, self._look = make, look
        self._device = None
        self._line = b""

    def stop(self):
        """Answer what has come, and let time pass before more is heard; true at the end of stdin."""
        if select.select([sys.stdin], [], [], 0)[0]:
            read = os.read(sys.stdin.fileno(), 4096)
            if not read:
                return True
            *lines, self._line = (self._line + read).split(b"\n")
            for line in lines:
                print(json.dumps(self._answer(*json.loads(line))), flush=True)
        return False

    def _answer(self, name, arguments):
        if name == "new":
            self._look()  # frames meant for the device before
            self._device = self._make(*arguments)
            self._look()
            return None
        if name == "look":
            return self._look()
        return getattr(self._device, name)(*arguments)


def serve_drive(place):
    clock = EmulatedClock()
    wire = CanWire(clock)
    bus = MachineWiring().can("can0", CanBus(kind="can", **place))()
    bridge = CanBridge("", bus, wire)
    print(json.dumps("ready"), flush=True)
    try:
        serve(clock, [bridge], [], Requests(lambda kind, node: DRIVES[kind](wire, node), bridge.carry).stop)
    finally:
        bridge.close()


def serve_converter(place):
    clock = EmulatedClock()
    stub = stub_bus(place["number"])
    chips = [StubChip(stub, CHIP, FailingConverter())]
    began = time.monotonic()

    def make(clock_error):
        converter = FailingConverter(clock_error)
        chips[0] = StubChip(stub, CHIP, converter)
        return converter

    def look():
        clock.sleep_until(time.monotonic() - began)
        chips[0].carry(clock.now())

    print(json.dumps("ready"), flush=True)
    serve(clock, [], chips, Requests(make, look).stop)


def serve_line(place):
    clock = EmulatedClock()
    wire = SerialWire(clock, 10 / 115200)
    if "resource_file" in place:
        bridge = SocketBridge(wire)
        Path(place["resource_file"]).write_text(bridge.address.split()[-1])
    else:
        bridge = SerialBridge(wire)
        Path(place["link"]).symlink_to(bridge.address.split()[-1])

    def make(kind, *arguments):
        wire.device = SERIAL_ENDS[kind](*arguments)
        return wire.device

    print(json.dumps("ready"), flush=True)
    try:
        serve(clock, [bridge], [], Requests(make, bridge.carry).stop)
    finally:
        bridge.close()


if __name__ == "__main__":
    serve_end = {"can": serve_drive, "i2c": serve_converter, "serial": serve_line, "tcp": serve_line}[sys.argv[1]]
    serve_end(json.loads(sys.argv[2]))
