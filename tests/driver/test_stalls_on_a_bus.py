"""Host and drive both stall at random on a real bus: each reading of a row is from that row's SYNC, or NaN.

STALLED_CYCLES is the number of cycles, of which about one in twelve stalls on each side;
docs/how-to/testing.md has the command for a kernel's bus.
"""

import os
import random

import pytest

from .elmo_bench import ElmoBench, ages_of
from .failing import STALL_EVERY, STALLS_S
from .transports import CAN, CanElsewhere

CYCLES = int(os.environ.get("STALLED_CYCLES", "300"))
ANSWER_S = 0.005


@pytest.mark.parametrize("transport", [name for name in CAN if name != "in_process"])
def test_no_row_holds_another_cycles_values_whoever_stalls(transport, far_end_process):
    bench = ElmoBench(wire=CanElsewhere(*far_end_process("can", transport), kind="counting"))
    clock, draw = bench.clock, random.Random(11)
    bench.drive.open()
    try:
        bench.cycle()
        before = bench.far.counted()
        bench.far.stall_at_random(12)
        stale, empty, host_stalls = [], 0, set()
        for number in range(before + 1, before + 1 + CYCLES):
            bench.drive.begin_cycle()
            bench.port.sync()
            if draw.random() < 1 / STALL_EVERY:
                host_stalls.add(number)
                clock.sleep_until(clock.now() + draw.uniform(*STALLS_S))
            bench.drive.end_cycle(clock.now() + ANSWER_S)
            bench.drive.feed()
            ages = ages_of(bench.drive.values, number)
            empty += ages.count(None)
            if not {*ages} <= {0, None}:
                stale.append((number, ages))
        irregular, stalls = bench.drive._answers.irregular, bench.far.stalls()
    finally:
        bench.close()
    assert stale == []
    too_late = [number for number, seconds in stalls if seconds > ANSWER_S and number not in host_stalls]
    print(
        f"{CYCLES} cycles, {len(stalls)} stalls of the drive, {len(host_stalls)} of the host, {empty} left out;",
        irregular,
    )
    assert too_late  # else nothing was tried
    assert irregular.late + irregular.surplus >= 2 * len(too_late)  # two answers to each SYNC
