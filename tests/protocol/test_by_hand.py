"""What is done by hand, as protocols: the setpoint asked for and no more, every drive off at the end."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl import yamlfile
from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.protocol.by_hand import Jog, motion_steps, plan_of, reading_steps, tare_steps
from leactl.protocol.plan import SETPOINT_QUANTITY, Engage, Tare
from leactl.protocol.protocolfile import expand_document
from tests.protocol.writing import segments

amounts = st.floats(-1e3, 1e3)
rates = st.none() | st.floats(0.1, 1e3)
motions = st.builds(
    Jog,
    st.sampled_from(["test", "load"]),
    st.sampled_from([Mode.CURRENT, Mode.VELOCITY, Mode.ANGLE]),
    amounts,
    st.floats(0.02, 100),
    rates,
)


@given(motions, amounts)
def test_a_jog_reaches_its_setpoint_at_its_rate_and_leaves_the_drive_off(jog, stands_at):
    jog.check()
    plan = plan_of("jog", "free", jog.steps(stands_at))
    begins = stands_at if jog.mode is Mode.ANGLE else 0.0
    goal = begins + jog.value
    assert plan.actions[0] == Engage({jog.role: jog.mode})
    assert plan.actions[-1] == Engage({jog.role: Mode.OFF})
    assert plan.peaks() == {(jog.role, SETPOINT_QUANTITY[jog.mode]): max(abs(begins), abs(goal))}
    at = begins
    for segment in segments(plan):
        profile = segment.setpoints[jog.role]
        assert profile.at(0.0) == (at if segment.duration_s else profile.at(segment.duration_s))
        if segment.name == "ramp" and jog.rate is not None:
            change = abs(profile.at(segment.duration_s) - at)
            assert change == pytest.approx(jog.rate * segment.duration_s, abs=1e-9)
        at = profile.at(segment.duration_s)
    assert [s.duration_s for s in segments(plan) if s.name == "jog"] == [jog.hold_s]
    assert at == (goal if jog.mode is Mode.ANGLE else 0.0)


@given(motions)
def test_the_text_in_the_run_file_is_a_protocol_that_runs_the_same(jog):
    plan = plan_of("jog", "coupled", jog.steps())
    assert expand_document(yamlfile.parse(plan.text), None, {}, "").actions == plan.actions


def test_reading_and_zeroing_engage_no_drive():
    read, zero = plan_of("read", "coupled", reading_steps(2.0)), plan_of("zero", "coupled", tare_steps())
    assert [type(action) for action in zero.actions] == [Tare]
    assert (read.duration_s, read.peaks(), zero.peaks()) == (2.0, {}, {})
    assert not any(isinstance(action, Engage) for action in read.actions)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"role": "bench"}, "--role bench: test or load was expected"),
        ({"value": math.nan}, "--current nan: a finite number was expected"),
        ({"value": math.inf}, "--current inf: a finite number was expected"),
        ({"hold_s": 0.0}, "--for 0: a time above 0 s was expected"),
        ({"hold_s": math.nan}, "--for nan: a time above 0 s was expected"),
        ({"rate": -1.0}, "--rate -1: a rate above 0 was expected"),
        ({"rate": math.nan}, "--rate nan: a rate above 0 was expected"),
    ],
)
def test_what_no_protocol_can_be_written_of_is_refused(changes, words):
    with pytest.raises(InputError) as refused:
        Jog("test", Mode.CURRENT, 1.0, 1.0)._replace(**changes).check()
    assert refused.value.faults == [words]


@pytest.mark.parametrize(
    ("setup", "roles", "modes"),
    [
        ("coupled", ["test", "load"], {"load": Mode.VELOCITY, "test": Mode.CURRENT}),
        ("coupled", ["test"], {"test": Mode.VELOCITY}),
        ("free", ["test", "load"], {"test": Mode.VELOCITY, "load": Mode.VELOCITY}),
        ("locked", ["test", "load"], {"test": Mode.CURRENT}),
    ],
)
def test_a_bench_turns_and_pulls_as_far_as_its_set_up_allows(setup, roles, modes):
    plan = plan_of("drill", setup, motion_steps(setup, roles, 5.0, 4.0, 1.0))
    engaged = [action.modes for action in plan.actions if isinstance(action, Engage)]
    assert engaged == [modes, dict.fromkeys(modes, Mode.OFF)]
    goals = {Mode.VELOCITY: 5.0, Mode.CURRENT: 4.0}
    assert sorted(plan.peaks().values()) == sorted(goals[mode] for mode in modes.values())


@pytest.mark.parametrize(("setup", "roles"), [("heated", ["test"]), ("locked", ["load"]), ("free", [])])
def test_where_nothing_can_be_moved_no_protocol_is_written(setup, roles):
    with pytest.raises(InputError, match="nothing could be moved"):
        motion_steps(setup, roles, 5.0, 4.0, 1.0)
