"""What the supervisor takes of a cycle at 1 kHz: two drives, a torque sensor, and every interlock configured."""

from leactl import yamlfile
from leactl.driver.contract import Row, StreamSpec
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.emulated_bench import EmulatedBench
from leactl.quantities import ChannelSpec
from leactl.safety.cross_checks import TorqueModel
from leactl.safety.interlocks import Interlocks
from leactl.safety.supervisor import Axis, Supervisor
from tests.benchmarks import test_control_cycle as cycle
from tests.benchmarks.rounds import compare
from tests.safety.guards import guard_of

LIMIT = 0.10  # of the cycle's CPU time
TORQUE_EVERY_MS = 2  # an ADS1115 converts in 1.2 ms, and is read by the cycle after
INTERLOCKS = """
q_axis_current: {warn_A: 26, trip_A: 28, for_s: 0.5, stuck_s: 1}
velocity: {warn_rad_s: 36, trip_rad_s: 38, for_s: 0.1, rate_rad_s_per_s: 10000}
angle: {trip_rad: 1e6}
torque: {role: test, warn_Nm: 15, trip_Nm: 16, for_s: 0.2, rate_Nm_per_s: 1e5, stuck_s: 1}
torque_disagreement: {tolerance_Nm: 2.0, for_s: 0.2}
bus_voltage: {warn_low_V: 24, warn_high_V: 35}
supply: {expected_V: 29.6, band_V: 5}
"""


class Sensor:
    """A stream as an analogue input declares it; its rows are given to the supervisor directly."""

    def __init__(self, streams):
        self.name, self.streams = "torque_sensor", streams


def test_the_supervisor_takes_a_tenth_of_a_cycle_at_the_most(tmp_path, figure):
    request, loops = cycle.request_in(tmp_path), []
    machine = EmulatedBench(request.bench, request.devices, "free", "", seed=1)
    rows = []
    torque = StreamSpec("torque_sensor", (ChannelSpec("torque", "torque", "test", "torque_sensor"),))

    def prepare_next():
        loop, bench, writer, _wiring = cycle.prepared(request, machine, len(loops))
        axes = {role: Axis(drive, drive) for role, drive in bench.drives.items()}
        model = TorqueModel(0.49, 0.208, 0.0238, 0.0024)
        interlocks = yamlfile.parse(INTERLOCKS).validate(Interlocks)
        devices, clock = [Sensor([torque])], EmulatedClock()
        judge = Supervisor(request.bench.limits, axes, devices, clock, guard_of(axes), interlocks, model)
        judge.begin(0.001)
        rows[:] = [Row("torque_sensor", k / 1000 + 4e-4, (0.001 * (k & 7),)) for k in range(cycle.CYCLES)]
        loops.append((loop, bench, writer, judge))

    def cycles():
        loops[-1][0].run()

    def judged():
        """The same number of checks, on the values that the last exchange left, and rows at their own pace."""
        _loop, bench, _writer, judge = loops[-1]
        now = 0.0
        supplies = [spec.name for drive in bench.drives.values() for spec in drive.streams]
        for drive in bench.drives.values():
            drive.values[3:7] = 0.01, 0.02, 0.3, 1.0
        first, second = (drive.values for drive in bench.drives.values())
        for number, row in enumerate(rows):
            now += 0.001
            if number % 1000 == 0:
                for name in supplies:
                    judge.receive(Row(name, now, (29.6,)))
            if number % TORQUE_EVERY_MS == 0:
                judge.receive(row)
            first[3] = second[3] = row.values[0]  # noise, by which a channel shows that it is not stuck
            judge.check(now)
        assert not judge.warnings

    def finish():
        _loop, bench, writer, _judge = loops[-1]
        bench.close()
        writer.close("complete")

    found = compare(judged, cycles, each=cycle.CYCLES, rounds=7, before=prepare_next, after=finish)
    figure(f"supervisor's check and receive, all interlocks: {found:us} of a cycle of two drives; limit {LIMIT}")
    assert found.ratio <= LIMIT
