"""A recording keeps no rows in memory that are on the disk."""

import subprocess
import sys

ROWS, FLUSHES, CHANNELS = 5000, 100, 14
GROWTH = 10.0  # MB, of 28 MB that are written
RECORD = f"""
import os, sys
from pathlib import Path
import numpy as np
from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RunWriter
from tests.runfile.specimen import info

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6

channels = [ChannelSpec(f"c{{k}}", "torque", "test", "sensor", location=f"at {{k}}") for k in range({CHANNELS})]
with RunWriter(Path(sys.argv[1]), info("20261120T101530Z-long-0001"), {{"loop": channels}}) as writer:
    for number in range({FLUSHES}):
        times = np.arange(number * {ROWS}, (number + 1) * {ROWS}) / 1000
        writer.append("loop", times, np.random.default_rng(number).normal(size=({ROWS}, {CHANNELS})))
        writer.flush()
        if number == {FLUSHES} // 10:
            before = resident()
    print(resident() - before, os.path.getsize(writer.path) / 1e6)
"""


def test_what_is_on_the_disk_is_not_kept_in_memory(tmp_path):
    answer = subprocess.run([sys.executable, "-c", RECORD, str(tmp_path)], capture_output=True, text=True, check=True)
    grown, written = map(float, answer.stdout.split())
    assert written >= 28.0
    assert grown <= GROWTH
