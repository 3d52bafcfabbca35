"""One cycle at 1 kHz with two drives beside a bare python-can exchange of the seven frames it consists of."""

import can

from leactl.emulation.clock import EmulatedClock
from tests.benchmarks.replay import SYNC, RehearsedBus, ReplayBus
from tests.benchmarks.rounds import compare
from tests.benchmarks.two_drives import Rehearsal, machine_of, prepared, request_in

LIMIT = 2.5
CYCLES = 16000


def rehearsal(machine):
    """Wiring whose time passes only while somebody waits."""
    clock = EmulatedClock()
    return Rehearsal(clock, lambda: RehearsedBus(machine, clock))


def exchange(bus, messages, cycles):
    """What no host can do without: three frames out, four in."""
    identifiers = [(message.arbitration_id, bytes(message.data)) for message in messages]
    for _ in range(cycles):
        for identifier, data in identifiers:
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        for _ in range(4):
            bus.recv(0.001)


def test_a_cycle_costs_little_beside_the_frames_it_exchanges(tmp_path, figure):
    request, loops = request_in(tmp_path, CYCLES / 1000), []
    machine = machine_of(request)

    def cycles():
        loops[-1][0].run()

    def prepare_next():
        wiring = rehearsal(machine)
        loops.append((*prepared(request, wiring, len(loops)), wiring))

    def finish():
        loop, bench, writer, _progress, wiring = loops[-1]
        assert CYCLES <= loop.cycles <= CYCLES * 1.01
        assert [frame.identifier for frame in wiring.bus.answers] == [0x181, 0x281, 0x182, 0x282]
        bench.close()
        writer.close("complete")

    prepare_next()
    cycles()
    finish()
    bare = ReplayBus(loops[-1][-1].bus.answers)
    demand = bytes.fromhex("0f0000000a")
    messages = [
        can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        for identifier, data in ((0x201, demand), (0x202, demand), (SYNC, b""))
    ]
    result = compare(cycles, lambda: exchange(bare, messages, CYCLES), each=CYCLES, before=prepare_next, after=finish)
    bare.shutdown()
    figure(f"cycle of two drives, driver + supervisor + recorder: {result:us} of bare python-can; limit {LIMIT}")
    assert result.ratio <= LIMIT
