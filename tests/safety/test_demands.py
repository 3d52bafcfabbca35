"""Demands of one drive under supervision: which of them pass, and for how long one counts as heat."""

import pytest

from leactl.driver.contract import Mode
from leactl.errors import InputError, SafetyTrip
from leactl.safety.thermal.turning import FIELDS, HEAT
from tests.safety.test_d_axis import PERIOD, Supervised


def test_a_mode_that_the_drive_refuses_leaves_the_limits_of_the_one_before(monkeypatch):
    seen = Supervised("q_axis_current")

    def refused(_mode):
        raise InputError("no such mode")

    monkeypatch.setattr(seen.drive, "engage", refused)
    with pytest.raises(InputError):
        seen.supervisor.engage("test", Mode.VELOCITY)
    with pytest.raises(SafetyTrip, match="test q_axis_current_reference of 35 is outside the limits"):
        seen.supervisor.command("test", 35.0)


def test_an_end_without_a_word_lets_nothing_pass_either():
    seen = Supervised("q_axis_current")
    seen.supervisor.latch("")
    for command in (lambda: seen.supervisor.command("test", 1.0), lambda: seen.supervisor.engage("test", Mode.CURRENT)):
        with pytest.raises(SafetyTrip, match="the run has ended"):
            command()


def test_a_demand_counts_until_a_reading_of_its_own_exchange_has_come():
    seen = Supervised("q_axis_current", "d_axis_current")
    seen.follow(PERIOD, 0.0, 0.0, 0.0)  # which the guard looks at, and forgets
    log, heats, flowing = seen.guard.logs[0], [], []
    for demand, reading in ((20.0, 0.0), (0.0, 0.0), (0.0, 3.0)):
        seen.follow(PERIOD, demand, reading, 0.0)
        heats.append(log[-FIELDS + HEAT] / PERIOD)
        flowing.append(seen.guard.flowing[0])
    assert heats == pytest.approx([0.0, 400.0, 9.0])
    assert flowing == pytest.approx([400.0, 400.0, 9.0])
