"""Overruns and free space at the very edges of what an interlock allows."""

import math

import pytest

from leactl.errors import InputError, SafetyTrip
from leactl.safety.disk import Disk, check_room, free_bytes
from leactl.safety.interlocks import ClockJump, DiskSpace, LoopOverruns
from leactl.safety.pace import Pace

PERIOD_S = 0.125  # and other binary fractions, whose sums are exact
SETTINGS = DiskSpace(trip_MB=100.0, warn_MB=500.0)


def trip(why):
    raise SafetyTrip(why)


def pace(**overruns):
    made = Pace(LoopOverruns(**overruns), ClockJump(jump_s=10.0), trip, 0.0)
    made.begin(PERIOD_S, 0.0)
    return made


def late_at(made, *times):
    """Overruns that do not follow one another: a check in time lies before each."""
    for now in times:
        made.previous_check = now - 3.0 * PERIOD_S
        made.judge_late(now)


def test_an_overrun_counts_for_the_whole_window_and_no_longer():
    settings = {"share_percent": 12.5, "window_s": 2.0, "in_a_row": 100}  # two of sixteen cycles
    late_at(pace(**settings), 1.0, 2.0, 3.125, 4.125)
    with pytest.raises(SafetyTrip, match=r"3 loop overruns in 2 s; 12\.5 % of the cycles are allowed"):
        late_at(pace(**settings), 1.0, 2.0, 3.0)


def test_overruns_in_a_row_are_counted_anew_after_a_cycle_in_time():
    made = pace(share_percent=99.0, window_s=600.0, in_a_row=3)
    for now in (1.0, 1.5):
        made.judge_late(now)
    made.previous_check = 1.75  # a cycle in time
    for now in (2.0, 2.5):
        made.judge_late(now)
    with pytest.raises(SafetyTrip, match="3 loop overruns in a row"):
        made.judge_late(3.0)


def test_a_clock_may_stand_still_and_step_by_what_is_allowed():
    made = pace(share_percent=99.0, window_s=600.0)
    made.judge_late(0.0)
    made.judge_late(10.0)
    with pytest.raises(SafetyTrip, match=r"went on by 10\.12 s in one cycle; 10 s are allowed"):
        made.judge_late(20.125)


def test_free_space_at_its_limits_is_enough():
    warnings = []
    disk = Disk(SETTINGS, trip, warnings.append)
    disk.look(500e6)
    assert warnings == []
    for free in (500e6 - 1.0, 100e6, 500e6, 499e6):
        disk.look(free)
    assert len(warnings) == 2, "once for each time that space becomes short"
    with pytest.raises(SafetyTrip):
        disk.look(100e6 - 1.0)


def test_a_plan_may_take_all_but_what_is_spared():
    check_room(SETTINGS, 150e6, 50e6)
    with pytest.raises(InputError, match="disk: 150 MB are free; 150 MB were expected, 50 MB for the run and 100 MB"):
        check_room(SETTINGS, 150e6 - 1.0, 50e6)


def test_a_file_system_without_a_size_limits_nothing(tmp_path, monkeypatch):
    usage = type("Usage", (), {"total": 0, "free": 0})
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage)
    assert free_bytes(tmp_path / "not" / "made" / "yet") == math.inf
