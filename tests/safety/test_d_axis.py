"""A drive that measures its d-axis current: it heats as the q-axis current does, and has the same limit."""

import math

import numpy as np
import pytest

from leactl.driver.contract import Mode
from leactl.errors import SafetyTrip
from leactl.model.motor import load_motor
from leactl.quantities import ChannelSpec
from leactl.safety.limits import Limits
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.thermal.guard import GuardSettings, ThermalGuard

PERIOD = 0.001
LIMITS = Limits(
    current_A=30,
    velocity_rad_s=40,
    torque_Nm=17,
    bus_voltage_low_V=20,
    bus_voltage_high_V=60,
    age_s=2.5,
    winding_temperature_degC=130,
    ambient_temperature_degC=25,
)


class Drive:
    """A drive that stands still, and reads what it is told to."""

    name, streams, engaged = "drive_test", (), True

    def __init__(self, *quantities):
        self.loop_channels = tuple(ChannelSpec(name, name, "test", self.name) for name in quantities)
        self.values = [0.0] * len(quantities)

    def engage(self, mode):
        """Nothing: it is engaged."""

    def release(self):
        """Nothing: the test reads no more of it."""

    def command(self, value):
        """Nothing: its readings are the test's."""


class Supervised:
    """One such drive under supervision, on a clock of the test's own."""

    def __init__(self, *quantities):
        self.seconds = 0.0
        motor = load_motor("lea")[0]
        settings = GuardSettings(130.0, 25.0, 30.0, 40.0, 0.22)
        self.guard = ThermalGuard({"test": motor}, settings, {"test": np.full(3, 28.0)})
        self.drive = Drive(*quantities)
        axes = {"test": Axis(self.drive, self.drive)}
        self.supervisor = Supervisor(LIMITS, axes, [], self, self.guard)
        self.supervisor.begin(PERIOD)
        self.supervisor.engage("test", Mode.CURRENT)

    def now(self):
        """The clock."""
        return self.seconds

    def follow(self, seconds, demand, *values):
        """Read these values for so long."""
        for _ in range(round(seconds / PERIOD)):
            self.seconds += PERIOD
            self.supervisor.command("test", demand)
            self.drive.values[:] = values
            self.supervisor.check(self.seconds)
        return self.guard.hottest["test"]


@pytest.mark.parametrize("direct", [-24.0, 9.0, 0.0])
def test_it_heats_as_the_q_axis_current_does(direct):
    both = Supervised("q_axis_current", "d_axis_current").follow(1.0, 8.0, 8.0, direct)
    whole = math.hypot(8.0, direct)
    alone = Supervised("q_axis_current").follow(1.0, whole, whole)
    assert both == pytest.approx(alone, rel=1e-9)


def test_one_that_is_not_known_counts_as_the_bench_s_limit():
    unknown = Supervised("q_axis_current", "d_axis_current").follow(0.02, 8.0, 8.0, math.nan)
    most = Supervised("q_axis_current").follow(0.02, 8.0, math.nan)
    assert unknown == pytest.approx(most, rel=1e-9)


@pytest.mark.parametrize("lost", [(math.nan, 0.0), (8.0, math.nan)])
def test_a_sample_that_is_lost_counts_as_the_worst_and_trips_by_its_age_alone_on_either_axis(lost):
    seen = Supervised("q_axis_current", "d_axis_current")
    for _ in range(200):
        seen.follow(PERIOD, 8.0, *lost)
        seen.follow(PERIOD, 8.0, 8.0, 0.0)
    calm = Supervised("q_axis_current").follow(0.4, 8.0, 8.0)
    assert seen.guard.hottest["test"] - 28.0 > 5.0 * (calm - 28.0)
    with pytest.raises(SafetyTrip, match=rf"test {'d' if lost[0] == 8.0 else 'q'}_axis_current: no reading for 0\.05"):
        seen.follow(0.1, 8.0, *lost)


def test_it_has_the_limit_of_the_current():
    with pytest.raises(SafetyTrip, match=r"d_axis_current of 30\.1"):
        Supervised("q_axis_current", "d_axis_current").follow(0.01, 1.0, 1.0, 30.1)
