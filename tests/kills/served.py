"""The emulated bench in a process of its own: `python -m tests.kills.served BENCH.yaml [without-dead-man]`.

It tells by lines of JSON on stdout when a drive's current begins and ends, by the bench's own clock, and when the drive
had heard the host's last heartbeat then.
"""

import json
import sys

from leactl.bench import benchfile
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.wires.serving import bridge_buses, serve
from leactl.runner.stop_requests import handled_signals

FLOWING_A = 0.05
STEPS_PER_S = 1000


class Recorder:
    """A silent device on the bus that hears the heartbeats and looks at the plant."""

    due = float("-inf")  # at every step of the clock

    def __init__(self, bench, host):
        self._actuators, self._heartbeat = bench.rig.actuators, 0x700 + host
        self._flowing = dict.fromkeys(self._actuators, False)
        self._heard = None

    def receive(self, frame, now):
        if frame.identifier == self._heartbeat:
            self._heard = now
        return []

    def tick(self, now):
        for role, actuator in self._actuators.items():
            flowing = abs(actuator.current_true) > FLOWING_A
            if flowing != self._flowing[role]:
                self._flowing[role] = flowing
                print(json.dumps({"role": role, "flowing": flowing, "at": now, "heard": self._heard}), flush=True)
        return []


def main(path, *changes):
    file, devices, _document = benchfile.load(path)
    bench = EmulatedBench(file, devices, "coupled", "")
    bench.wires["can0"].attach(
        Recorder(bench, next(d.settings.host_bus_address for d in devices if d.settings.host_bus_address))
    )
    clock, drives = bench.time, [bench.far_ends[name] for name in ("drive_test", "drive_load")]
    if "without-dead-man" in changes:
        for drive in drives:
            drive._lose_host = lambda: None
    # a drive keeps its own time: where this process was held up, the moments it missed come one after the other
    clock.stop_at(lambda: (int(clock.now() * STEPS_PER_S + 1e-6) + 1) / STEPS_PER_S)
    clock.stop_at(lambda: min(drive.due for drive in drives))
    with handled_signals() as stop, bridge_buses(file, bench.wires, bench.serial_wires) as bridges:
        print(json.dumps(bridges["can0"].address), flush=True)
        serve(clock, list(bridges.values()), [], lambda: bool(stop.cause))


if __name__ == "__main__":
    main(*sys.argv[1:])
