"""The emulated bench of heated leads in a process of its own: `python -m tests.kills.heated [BENCH]`.

It tells by lines of JSON on stdout where its serial line is, then when the current through the leads begins and ends.
"""

import json
import sys

from leactl.bench import benchfile
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.wires.serving import bridge_buses, serve
from leactl.runner.stop_requests import handled_signals

FLOWING_A = 0.05


def main():
    file, devices, _document = benchfile.load(sys.argv[1] if len(sys.argv) > 1 else "emulated-heated")
    bench = EmulatedBench(file, benchfile.devices_of_run(devices, ()), "heated", "")
    flowing = False

    def look(_now):
        nonlocal flowing
        if (bench.rig.line_current > FLOWING_A) is not flowing:
            flowing = not flowing
            print(json.dumps({"flowing": flowing}), flush=True)

    bench.time.follow(look)
    with handled_signals() as stop, bridge_buses(file, bench.wires, bench.serial_wires) as bridges:
        print(json.dumps(bridges["supply0"].address), flush=True)
        serve(bench.time, list(bridges.values()), [], lambda: bool(stop.cause))


if __name__ == "__main__":
    main()
