"""Every kind of step: what a file asks for and what the plan then does."""

import math

import pytest

from leactl.driver.contract import Mode
from leactl.protocol.plan import Constant, Engage, Prompt, Ramp, Segment, SetRecordRate, Tare, WaitUntil
from tests.protocol.writing import levels, plan, segments


def test_the_head_reaches_the_plan():
    limits = "acceptance: [{result: r_squared, low: 0.9, unit: '1'}]"
    result = plan(
        "hold: {duration_s: 1}",
        rate_Hz=100,
        parameters="{gain: 2, kinds: [a, b]}",
        more=f"title: Nothing moves\nanalysis: none-yet\nrecord_Hz: 50\n{limits}",
    )
    assert (result.name, result.title, result.setup, result.analysis) == (
        "trial",
        "Nothing moves",
        "coupled",
        "none-yet",
    )
    assert (result.rate_Hz, result.record_Hz) == (100, 50)
    assert result.parameters == {"gain": 2, "kinds": ["a", "b"]}
    assert [(limit.result, limit.low, limit.high, limit.unit) for limit in result.acceptance] == [
        ("r_squared", 0.9, math.inf, "1")
    ]


def test_recording_follows_the_loop_where_no_rate_is_given():
    assert plan("hold: {duration_s: 1}", rate_Hz=200).record_Hz == 200


def test_set_jumps_and_hold_stays():
    result = plan(
        "set: {role: test, current_A: 5}", "hold: {role: load, velocity_rad_s: -2, duration_s: 3, settle_s: 1}"
    )
    assert result.actions == (
        Engage({"test": Mode.CURRENT, "load": Mode.VELOCITY}),
        Segment(
            "set",
            0.0,
            0.0,
            {"test": Constant(5.0)},
            {"current_A": 5.0, "direction": "rising", "role": "test", "repeat": 1},
        ),
        Segment(
            "hold",
            3.0,
            1.0,
            {"load": Constant(-2.0)},
            {"velocity_rad_s": -2.0, "direction": "falling", "role": "load", "repeat": 1},
        ),
    )
    assert result.duration_s == 3.0


def test_a_hold_without_a_setpoint_touches_nothing():
    assert segments(plan("hold: {duration_s: 2}"))[0].setpoints == {}


def test_a_hold_may_say_what_it_is_for():
    assert segments(plan("hold: {name: start, role: test, current_A: 1, duration_s: 2}"))[0].name == "start"


@pytest.mark.parametrize(("pace", "duration"), [("duration_s: 4", 4.0), ("rate_A_s: 10", 0.5)])
def test_ramps_begin_where_the_role_is(pace, duration):
    result = plan("set: {role: test, current_A: 2}", f"ramp: {{role: test, to_current_A: -3, {pace}}}")
    ramp = segments(result)[1]
    assert ramp.setpoints == {"test": Ramp(2.0, -3.0, duration)}
    assert ramp.duration_s == duration
    assert ramp.setpoints["test"].at(duration / 2) == pytest.approx(-0.5)


def test_engaging_again_begins_at_zero():
    result = plan(
        "set: {role: test, current_A: 2}",
        "mode: {test: velocity}",
        "ramp: {role: test, to_velocity_rad_s: 3, duration_s: 1}",
    )
    assert segments(result)[-1].setpoints == {"test": Ramp(0.0, 3.0, 1.0)}
    assert result.peaks() == {("test", "q_axis_current_reference"): 2.0, ("test", "velocity_reference"): 3.0}


def test_an_angle_is_known_from_its_first_setpoint_on():
    result = plan(
        "hold: {role: test, angle_rad: 1, duration_s: 1}",
        "ramp: {role: test, to_angle_rad: 3, rate_rad_s: 4}",
        mode="{test: angle}",
    )
    assert segments(result)[-1].setpoints == {"test": Ramp(1.0, 3.0, 0.5)}
    assert result.peaks() == {("test", "angle_reference"): 3.0}


def test_a_sweep_from_both_sides_turns_beyond_its_ends():
    result = plan("sweep: {role: test, levels_A: [2, 1, 3], hold_s: 1, visit: both, overshoot_A: 0.5, turn_s: 0.25}")
    assert [(s.name, s.setpoints["test"].at(0), s.parameters.get("direction")) for s in segments(result)] == [
        ("hold", 1.0, "rising"),
        ("hold", 2.0, "rising"),
        ("hold", 3.0, "rising"),
        ("turn", 3.5, None),
        ("hold", 3.0, "falling"),
        ("hold", 2.0, "falling"),
        ("hold", 1.0, "falling"),
        ("turn", 0.5, None),
    ]
    assert {s.duration_s for s in segments(result) if s.name == "turn"} == {0.25}


def test_a_sweep_from_both_sides_goes_below_its_levels_first():
    result = plan("sweep: {role: test, levels_A: [-2, -1], hold_s: 1, visit: both, overshoot_A: 0.5}")
    assert levels(result, "turn") == [-2.5, -0.5, -2.5]
    directions = [s.parameters["direction"] for s in segments(result) if s.name == "hold"]
    assert directions == ["rising", "rising", "falling", "falling"]


def test_without_an_overshoot_the_top_level_is_the_turn():
    result = plan("sweep: {role: test, levels_A: [1, 2], hold_s: 1, visit: both}")
    assert levels(result) == [1, 2, 1]


@pytest.mark.parametrize(("visit", "order"), [("up", [1, 2, 3]), ("down", [3, 2, 1]), ("as_given", [2, 3, 1])])
def test_orders_of_visit(visit, order):
    assert levels(plan(f"sweep: {{role: test, levels_A: [2, 3, 1], hold_s: 1, visit: {visit}}}")) == order
    mirrored = plan(f"sweep: {{role: test, levels_A: [2, 3, 1], hold_s: 1, visit: {visit}, sign: -1}}")
    assert levels(mirrored) == [-level for level in order]


def test_a_rate_puts_a_ramp_before_each_level_and_leaves_the_hold_whole():
    result = plan("sweep: {role: test, levels_A: [1, 3, 3], hold_s: 2, settle_s: 0.5, rate_A_s: 4}")
    assert [(s.name, s.duration_s, s.settle_s) for s in segments(result)] == [
        ("ramp", 0.25, 0.0),
        ("hold", 2.0, 0.5),
        ("ramp", 0.5, 0.0),
        ("hold", 2.0, 0.5),
        ("hold", 2.0, 0.5),  # the same level again: no way to go
    ]


def test_a_sweep_rests_at_zero_after_every_repeat_but_the_last():
    result = plan("sweep: {role: test, levels_A: [2], hold_s: 1, rate_A_s: 1, repeats: 3, pause_s: 60}")
    names = [s.name for s in segments(result)]
    assert names == ["ramp", "hold", "ramp", "pause", "ramp", "hold", "ramp", "pause", "ramp", "hold"]
    assert levels(result, "pause") == [0, 0]
    assert [s.parameters["repeat"] for s in segments(result) if s.name == "hold"] == [1, 2, 3]


def test_a_hold_tells_its_level_direction_repeat_and_role():
    hold = segments(plan("sweep: {role: load, levels_rad_s: [-4], hold_s: 1}"))[0]
    assert hold.parameters == {"velocity_rad_s": -4.0, "direction": "falling", "repeat": 1, "role": "load"}


def test_repeats_inside_repeats_count_on():
    result = plan(
        "repeat: {times: 2, steps: [{repeat: {times: 2, steps: [{sweep: "
        "{role: test, levels_A: [1], hold_s: 1, repeats: 2}}]}}]}"
    )
    assert [s.parameters["repeat"] for s in segments(result)] == [1, 2, 3, 4, 5, 6, 7, 8]


def test_a_grid_has_its_first_axis_outermost_and_rests_between_rows():
    result = plan(
        "grid: {axes: [{role: load, levels_rad_s: [10, 20]}, {role: test, levels_A: [1, 2]}],"
        " hold_s: 3, settle_s: 1, rest_s: 30, repeats: 2}"
    )
    told = [(s.name, s.parameters.get("velocity_rad_s"), s.parameters.get("current_A")) for s in segments(result)]
    row_10, row_20, rest = [("hold", 10, 1), ("hold", 10, 2)], [("hold", 20, 1), ("hold", 20, 2)], ("rest", None, None)
    assert told == [*row_10, rest, *row_20, rest, *row_10, rest, *row_20]
    assert segments(result)[2].setpoints == {"load": Constant(0.0), "test": Constant(0.0)}
    assert [s.parameters["repeat"] for s in segments(result) if s.name == "hold"] == [1, 1, 1, 1, 2, 2, 2, 2]


def test_grid_axes_of_one_unit_are_told_apart_by_role():
    result = plan(
        "grid: {axes: [{role: load, levels_A: [3]}, {role: test, levels_A: [1]}], hold_s: 3}",
        mode="{test: current, load: torque_profile}",
    )
    told = segments(result)[0].parameters
    assert (told["load_current_A"], told["test_current_A"]) == (3, 1)


def test_grid_axes_with_rates_move_together():
    result = plan(
        "grid: {axes: [{role: load, levels_rad_s: [10], rate_rad_s2: 5},"
        " {role: test, levels_A: [2], rate_A_s: 8}], hold_s: 3}"
    )
    assert segments(result)[0].setpoints == {"load": Ramp(0.0, 10.0, 2.0), "test": Ramp(0.0, 2.0, 2.0)}


def test_actions_that_are_no_setpoints():
    result = plan(
        "tare: {samples: 500}",
        "prompt: Lock the shaft",
        "record: {rate_Hz: 0}",
        "record: {rate_Hz: 25}",
        "wait_until: {quantity: velocity, role: test, below: 0.1, unit: rad/s, timeout_s: 5}",
        "wait_until: {quantity: velocity, role: test, above: -1, below: 0.1, unit: rad/s, timeout_s: 5}",
        "mode: {test: off}",
    )
    assert result.actions[1:] == (
        Tare(500),
        Prompt("Lock the shaft"),
        SetRecordRate(0),
        SetRecordRate(25),
        WaitUntil("velocity", "test", -math.inf, 0.1, 5.0),
        WaitUntil("velocity", "test", -1.0, 0.1, 5.0),
        Engage({"test": Mode.OFF}),
    )
    assert result.duration_s == 5.0  # taring: a reading a cycle, at 100 Hz
    assert [(row.start_s, row.duration_s) for row in result.timeline()][1:3] == [(0.0, 5.0), (5.0, 0.0)]


def test_the_timeline_tells_each_action_in_a_row():
    result = plan(
        "ramp: {role: test, to_current_A: 5, rate_A_s: 10}",
        "hold: {role: load, velocity_rad_s: 3, duration_s: 2, settle_s: 1}",
        "prompt: Look",
        "signal: {role: test, kind: sine, amplitude_A: 2, offset_A: 1, frequency_Hz: 25, duration_s: 1}",
        rate_Hz=100,
    )
    assert result.timeline() == [
        (0.0, "mode", 0.0, 0.0, "test current, load velocity"),
        (0.0, "ramp", 0.5, 0.0, "test 0 -> 5 A"),
        (0.5, "hold", 2.0, 1.0, "load 3 rad/s"),
        (2.5, "prompt", 0.0, 0.0, "Look"),
        (2.5, "sine", 1.0, 0.0, "test -1 .. 3 A"),
    ]
