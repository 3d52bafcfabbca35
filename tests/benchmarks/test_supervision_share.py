"""What the supervisor takes of a cycle at 1 kHz: two drives, a torque sensor, and every interlock configured."""

from leactl import yamlfile
from leactl.driver.contract import Row, StreamSpec
from leactl.emulation.clock import EmulatedClock
from leactl.quantities import ChannelSpec
from leactl.safety.interlocks import Interlocks
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.witnesses import TorqueModel
from tests.benchmarks.rounds import compare
from tests.benchmarks.test_control_cycle import CYCLES, rehearsal
from tests.benchmarks.two_drives import machine_of, prepared, request_in
from tests.safety.guards import LEA, guard_of

LIMIT = 0.12  # of the cycle's CPU time; 0.10 before both currents were held against the torque sensor
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


def readings_of(second):
    """Torques read in one second, each with the ends of the two cycles of 1 ms that share it.

    An ADS1115 converts in 1.2 ms, and is read by the cycle after.
    """
    starts = [second + k / 1000 for k in range(0, 1000, 2)]
    rows = [Row("torque_sensor", start + 4e-4, (0.002 * (k & 3),)) for k, start in enumerate(starts)]
    return [(row, start + 0.001, start + 0.002) for row, start in zip(rows, starts, strict=True)]


def test_the_supervisor_takes_an_eighth_of_a_cycle_at_the_most(tmp_path, figure):
    request, loops, seconds = request_in(tmp_path, CYCLES / 1000), [], [readings_of(k) for k in range(CYCLES // 1000)]
    machine = machine_of(request)
    torque = StreamSpec("torque_sensor", (ChannelSpec("torque", "torque", "test", "torque_sensor"),))

    def prepare_next():
        loop, bench, writer, _progress = prepared(request, rehearsal(machine), len(loops))
        axes = {role: Axis(drive, drive) for role, drive in bench.drives.items()}
        models = dict.fromkeys(axes, TorqueModel.of(LEA))
        interlocks = yamlfile.parse(INTERLOCKS).validate(Interlocks)
        devices, clock = [Sensor([torque])], EmulatedClock()
        judge = Supervisor(request.bench.limits, axes, devices, clock, guard_of(axes), interlocks, models)
        judge.begin(0.001)
        loops.append((loop, bench, writer, judge))

    def cycles():
        loops[-1][0].run()

    def judged():
        """The same number of checks, on the values that the last exchange left, and rows at their own pace."""
        _loop, bench, _writer, judge = loops[-1]
        supplies = [spec.name for drive in bench.drives.values() for spec in drive.streams]
        for drive in bench.drives.values():
            drive.values[3:7] = 0.01, 0.02, 0.3, 1.0
        first, second = (drive.values for drive in bench.drives.values())
        for readings in seconds:
            for name in supplies:
                judge.receive(Row(name, readings[0][0].time, (29.6,)))
            for row, now, later in readings:
                judge.receive(row)
                first[3] = second[3] = row.values[0]  # noise, by which a channel shows that it is not stuck
                judge.check(now)
                judge.check(later)
        assert not judge.warnings

    def finish():
        _loop, bench, writer, _judge = loops[-1]
        bench.close()
        writer.close("complete")

    result = compare(judged, cycles, each=CYCLES, rounds=7, before=prepare_next, after=finish)
    figure(f"supervisor's check and receive, all interlocks: {result:us} of a cycle of two drives; limit {LIMIT}")
    assert result.ratio <= LIMIT
