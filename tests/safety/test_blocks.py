"""A block of samples is judged as its rows would be one by one, however it is cut."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from leactl.driver.contract import Row, SampleBlock, StreamSpec
from leactl.errors import SafetyTrip
from leactl.quantities import ChannelSpec
from leactl.safety.interlocks import Interlocks
from leactl.safety.limits import Limits
from leactl.safety.thermal.measured import MeasuredStreams
from leactl.safety.watching import Panel
from tests.safety.guards import guard_of

LIMITS = Limits(
    current_A=30, velocity_rad_s=40, torque_Nm=17, bus_voltage_low_V=20, bus_voltage_high_V=60, age_s=2.5,
    winding_temperature_degC=130,
)  # fmt: skip
CHANNELS = tuple(ChannelSpec(name, name, "test", "daq") for name in ("torque", "velocity", "phase_voltage_ab"))
INTERLOCKS = {
    "plain": {},
    "warning": {"velocity": {"warn_rad_s": 10, "trip_rad_s": 20, "for_s": 0.02}},
    "rate": {"torque": {"rate_Nm_per_s": 2000.0}},
}
quiet = st.sampled_from([-9.0, -1.0, 0.0, 2.0, 9.0])  # a jump of 18 is too fast where the rate is watched
wild = st.one_of(quiet, st.floats(-45, 45), st.just(float("nan")))
rows_of = st.lists(
    st.one_of(st.tuples(*[quiet] * 3), st.tuples(*[quiet] * 3), st.tuples(*[wild] * 3)), min_size=1, max_size=12
)


def judged(interlocks, feed):
    """What a panel does with what `feed` gives it: trip, warnings, last values, and when it grows too old."""
    warnings = []

    def trip(cause):
        raise SafetyTrip(cause)

    panel = Panel(CHANNELS, LIMITS, Interlocks(**interlocks), trip, warnings.append)
    panel.begin(0.0, 2.5)
    try:
        feed(panel)
        due = panel.check_age(1.0)
    except SafetyTrip as error:
        return str(error), warnings
    return due, warnings, str(list(panel.values))


@given(st.sampled_from(list(INTERLOCKS)), rows_of, st.sets(st.integers(1, 12), max_size=5))
@example("rate", [(0.0, 0.0, 0.0), (-9.0, 0.0, 0.0), (9.0, 0.0, 0.0)], {1})
def test_blocks_and_rows_are_judged_alike(name, rows, cut):
    times = 0.005 * np.arange(1, len(rows) + 1)
    values = np.array(rows)
    cuts = sorted({0, len(rows), *(place for place in cut if place < len(rows))})

    def by_row(panel):
        for time, row in zip(times.tolist(), rows, strict=True):
            panel.look(list(row), time)

    def by_block(panel):
        for start, stop in itertools.pairwise(cuts):
            panel.look_through(SampleBlock("daq", times[start:stop], values[start:stop]))

    assert judged(INTERLOCKS[name], by_block) == judged(INTERLOCKS[name], by_row)


def test_temperatures_that_come_in_blocks_are_held_against_the_guard():
    stream = StreamSpec("camera", (ChannelSpec("winding", "winding_temperature", "test", "camera"),))
    tripped = []
    measured = MeasuredStreams(guard_of(), [stream], tripped.append)
    measured.look_through(SampleBlock("camera", np.array([0.0, 0.1]), np.array([[26.0], [60.0]])))
    assert len(tripped) == 1
    assert "measured at 60.0 degC" in tripped[0]


def test_a_block_gives_its_rows_and_its_last():
    block = SampleBlock("daq", np.array([1.0, 2.0]), np.array([[3.0, 4.0], [5.0, 6.0]]))
    assert list(block.rows()) == [Row("daq", 1.0, [3.0, 4.0]), Row("daq", 2.0, [5.0, 6.0])]
    assert block.last == Row("daq", 2.0, [5.0, 6.0])


@pytest.mark.parametrize("ends", [True, False])
def test_only_a_stream_that_says_it_ends_may_fall_silent(ends):
    from leactl.emulation.clock import EmulatedClock
    from leactl.safety.supervisor import Supervisor

    class Source:
        name, streams = "daq", (StreamSpec("daq", CHANNELS[2:], ends=ends),)

    clock = EmulatedClock()
    supervisor = Supervisor(LIMITS, {}, [Source()], clock, guard_of())
    supervisor.begin(0.01)
    supervisor.receive(SampleBlock("daq", np.array([0.0]), np.array([[1.0]])))
    for number in range(1, 300):
        clock.sleep_until(number * 0.01)
        if not ends and number > 250:
            with pytest.raises(SafetyTrip, match="no reading for"):
                supervisor.check(clock.now())
            return
        supervisor.check(clock.now())
    assert ends
