"""One cycle at 1 kHz with two drives beside a bare python-can exchange of the seven frames it consists of."""

import math
from collections.abc import Callable

import can

from leactl.bench.bench import Bench
from leactl.bench.benchfile import CanBus
from leactl.driver.i2c_port import SmBus
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.emulation.clock import EmulatedClock
from leactl.runfile.write.writer import RunWriter
from leactl.runner.channel_limits import ChannelLimits
from leactl.runner.loop import Loop
from leactl.runner.operators import granted
from leactl.runner.progress import Progress
from leactl.runner.recorder import FLUSH_S, Recording
from leactl.runner.request import prepare
from leactl.runner.signals import People, StopRequest, Wishes
from leactl.runner.watchdog import Unwatched
from leactl.safety.supervisor import Axis, Supervisor
from tests.benchmarks.replay import SYNC, RehearsedBus, ReplayBus
from tests.benchmarks.rounds import compare
from tests.runfile.specimen import info
from tests.safety.guards import guard_of

LIMIT = 2.5
CYCLES = 16000
FLUSH_EVERY = round(1000 * FLUSH_S)  # cycles

BENCH = """
name: two-drives
motors: {test: lea, load: lea}
buses:
  can0: {kind: can, interface: emulated}
devices:
  drive_test: {driver: elmo_can, bus: can0, role: test, settings: {node: 1, counts_per_turn: 40000}}
  drive_load: {driver: elmo_can, bus: can0, role: load, settings: {node: 2, counts_per_turn: 40000}}
limits:
  current_A: 30
  velocity_rad_s: 40
  torque_Nm: 17
  bus_voltage_low_V: 20
  bus_voltage_high_V: 60
  age_s: 2.5
  winding_temperature_degC: 130
emulated: {}
"""
PROTOCOL = f"""
name: cycles
setup: free
rate_Hz: 1000
record_Hz: 1000
steps:
  - mode: {{test: current, load: current}}
  - set: {{role: load, current_A: 1.0}}
  - signal: {{role: test, kind: sine, offset_A: 3.0, amplitude_A: 1.0, frequency_Hz: 1.0, duration_s: {CYCLES / 1000}}}
"""


class Rehearsal:
    """Wiring to drives that answer from an emulator first and from a record then."""

    def __init__(self, machine: EmulatedBench) -> None:
        self.clock = EmulatedClock()
        self._machine = machine
        self.bus: RehearsedBus | None = None

    def can(self, name: str, bus: CanBus) -> Callable[[], can.BusABC]:
        def connect() -> can.BusABC:
            self.bus = RehearsedBus(self._machine, self.clock)
            return self.bus

        return connect

    def hang(self, torque: float) -> None:
        """Nothing."""

    def wait_for_disk(self) -> None:
        return

    def i2c(self, name: str, bus: object) -> Callable[[], SmBus]:
        raise NotImplementedError("this bench has no I2C bus")


class FlushByCycles:
    """The recorder's pace, counted in cycles, since the cycles here take no wall time."""

    def __init__(self, writer: RunWriter) -> None:
        self._writer, self._cycles = writer, 0
        self.free_bytes = math.inf

    def warnings(self):
        return []

    def after_cycle(self) -> None:
        self._cycles += 1
        if self._cycles % FLUSH_EVERY == 0:
            self._writer.flush()


def request_in(tmp_path):
    (tmp_path / "bench.yaml").write_text(BENCH)
    (tmp_path / "cycles.yaml").write_text(PROTOCOL)
    return prepare(str(tmp_path / "cycles.yaml"), str(tmp_path / "bench.yaml"), [], "", "", "", tmp_path, False)


def prepared(request, machine, number):
    """A loop on open devices, ready to run, and what it wants closed afterwards."""
    wiring = Rehearsal(machine)
    bench = Bench(request.bench, request.devices, wiring)
    axes = {role: Axis(drive, drive) for role, drive in bench.drives.items()}
    supervisor = Supervisor(request.bench.limits, axes, bench.others, bench.clock, guard_of(axes))
    bench.open()
    writer = RunWriter(request.directory, info(f"20261120T101530Z-cycles-{number:04}"), bench.streams())
    progress = Progress("", request.plan.duration_s, bench.streams())
    loop = Loop(
        request.plan,
        bench,
        supervisor,
        Unwatched(),
        People(StopRequest(), Wishes(), granted),
        Recording(writer, FlushByCycles(writer), progress, ChannelLimits((), bench.streams(), request.bench.name)),
    )
    return loop, bench, writer, wiring


def exchange(bus, messages, cycles):
    """What no host can do without: three frames out, four in."""
    identifiers = [(message.arbitration_id, bytes(message.data)) for message in messages]
    for _ in range(cycles):
        for identifier, data in identifiers:
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        for _ in range(4):
            bus.recv(0.001)


def test_a_cycle_costs_little_beside_the_frames_it_exchanges(tmp_path, figure):
    request, loops = request_in(tmp_path), []
    # one for all rounds: the first works out the plant's matrices, which are no part of a cycle
    machine = EmulatedBench(request.bench, request.devices, "free", "", seed=1)

    def cycles():
        loop, *_ = loops[-1]
        loop.run()

    def prepare_next():
        loops.append(prepared(request, machine, len(loops)))

    def finish():
        loop, bench, writer, wiring = loops[-1]
        assert CYCLES <= loop.cycles <= CYCLES * 1.01
        assert [frame.identifier for frame in wiring.bus.answers] == [0x181, 0x281, 0x182, 0x282]
        bench.close()
        writer.close("complete")

    prepare_next()
    cycles()
    finish()
    bare = ReplayBus(loops[-1][3].bus.answers)
    demand = bytes.fromhex("0f0000000a")
    messages = [
        can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        for identifier, data in ((0x201, demand), (0x202, demand), (SYNC, b""))
    ]
    found = compare(cycles, lambda: exchange(bare, messages, CYCLES), each=CYCLES, before=prepare_next, after=finish)
    bare.shutdown()
    figure(f"cycle of two drives, driver + supervisor + recorder: {found:us} of bare python-can; limit {LIMIT}")
    assert found.ratio <= LIMIT
