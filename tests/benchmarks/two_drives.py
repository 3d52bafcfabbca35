"""A run of two drives whose answers are an emulator's at first and are played again then: nothing else is timed."""

import math
from collections.abc import Callable
from pathlib import Path

import can

from leactl.bench.bench import Bench
from leactl.bench.benchfile import CanBus
from leactl.driver.clock import Clock
from leactl.driver.i2c_port import SmBus
from leactl.emulation.bench.emulated_bench import EmulatedBench
from leactl.runfile.write.writer import RunWriter
from leactl.runner.channel_limits import ChannelLimits
from leactl.runner.flushing import FLUSH_INTERVAL_S, Recording
from leactl.runner.loop import Loop
from leactl.runner.operators import confirm_at_once
from leactl.runner.progress import Progress
from leactl.runner.request import Request, prepare
from leactl.runner.stop_requests import OperatorInput, RunControl, StopRequest
from leactl.runner.watchdog import NoWatchdog
from leactl.safety.supervisor import Axis, Supervisor
from tests.benchmarks.replay import RehearsedBus
from tests.runfile.specimen import info
from tests.safety.guards import guard_of

FLUSH_EVERY = round(1000 * FLUSH_INTERVAL_S)  # cycles

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
PROTOCOL = """
name: cycles
setup: free
rate_Hz: {rate:g}
record_Hz: {rate:g}
steps:
  - mode: {{test: current, load: current}}
  - set: {{role: load, current_A: 1.0}}
  - signal: {{role: test, kind: sine, offset_A: 3.0, amplitude_A: 1.0, frequency_Hz: 1.0, duration_s: {seconds:g}}}
"""


class Rehearsal:
    """Wiring to drives at a bus that answers from an emulator first and from a record then."""

    def __init__(self, clock: Clock, connect: Callable[[], RehearsedBus]) -> None:
        self.clock, self._connect = clock, connect
        self.bus: RehearsedBus | None = None

    def can(self, name: str, bus: CanBus) -> Callable[[], can.BusABC]:
        def connect() -> can.BusABC:
            self.bus = self._connect()
            return self.bus

        return connect

    def apply_weight_torque(self, torque: float) -> None:
        """Nothing."""

    def wait_for_disk(self) -> None:
        return

    def i2c(self, name: str, bus: object) -> Callable[[], SmBus]:
        raise NotImplementedError("this bench has no I2C bus")


class FlushByCycles:
    """The recorder's pace, counted in cycles, where these take no wall time."""

    def __init__(self, writer: RunWriter) -> None:
        self._writer, self._cycles = writer, 0
        self.free_bytes = math.inf

    def warnings(self):
        return []

    def after_cycle(self) -> None:
        self._cycles += 1
        if self._cycles % FLUSH_EVERY == 0:
            self._writer.flush()


def request_in(folder: Path, seconds: float, rate: float = 1000.0) -> Request:
    """The request of a run of so many seconds."""
    (folder / "bench.yaml").write_text(BENCH)
    (folder / "cycles.yaml").write_text(PROTOCOL.format(rate=rate, seconds=seconds))
    return prepare(str(folder / "cycles.yaml"), str(folder / "bench.yaml"), [], "", "", "", folder, False)


def machine_of(request: Request) -> EmulatedBench:
    """The bench to rehearse with; one serves all runs, for the first works out the plant's matrices."""
    return EmulatedBench(request.bench, request.devices, "free", "", seed=1)


def prepared(request: Request, wiring: Rehearsal, number: int, flush=FlushByCycles):
    """A loop on open devices, ready to run, the bench and the writer to be closed afterwards, and what is shown."""
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
        NoWatchdog(),
        RunControl(StopRequest(), OperatorInput(), confirm_at_once),
        Recording(writer, flush(writer), progress, ChannelLimits((), bench.streams(), request.bench.name)),
    )
    return loop, bench, writer, progress
