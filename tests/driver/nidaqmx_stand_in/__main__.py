"""`python -m tests.driver.nidaqmx_stand_in < CASES`: the driver on whatever libnidaqmx is found; JSON in, JSON out.

Time passes by the reads alone, 20 ms each, so that what comes is the same on any machine.
"""

import json
import os
import sys

from leactl_plugins.ni_daq.driver import NiDaq
from leactl_plugins.ni_daq.settings import NiDaqSettings

from leactl.bench.host_checks import ni_daqmx
from leactl.emulation.clock import EmulatedClock
from leactl.errors import LeactlError


def acquired(settings, reads, fail, samples):
    os.environ |= {"STAND_IN_FAIL": fail, "STAND_IN_SAMPLES": str(samples)}
    clock = EmulatedClock()
    daq = NiDaq("daq", "bench", NiDaqSettings(**settings), None, clock)
    told = {"error": "", "blocks": []}
    try:
        daq.open()
        told["identity"] = daq.identity()
        told["skews"] = [channel.skew_s for channel in daq.streams[0].channels]
        for _ in range(reads):
            told["blocks"] += [[block.times.tolist(), block.values.tolist()] for block in daq.take()]
            clock.sleep_until(clock.now() + 0.02)
    except LeactlError as error:
        told["error"] = f"{error.exit_status}: {error}"
    told["notices"] = list(daq.notices())
    daq.close()
    return told


if __name__ == "__main__":
    told = [acquired(**case) for case in json.load(sys.stdin)]
    print(json.dumps({"acquired": told, "doctor": [finding.found for finding in ni_daqmx()]}))
