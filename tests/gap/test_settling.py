"""Rows in which a current is on its way: after a change whose moment no row tells, and where a run begins so."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.effects import library
from leactl.effects.plant import Plant
from leactl.gap.signals.derived import fast_signals
from leactl.gap.signals.setpoints import SETTLING_TIME_CONSTANTS, settling_rows
from tests.gap.synthetic import clocked, model, record

WIDE = {"current_loop_bandwidth": 1e5}  # Hz, of a loop that follows at once


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.floats(0.0, 0.01))
def test_a_row_is_settling_from_before_a_change_until_the_loop_has_forgotten_it(changing, settles):
    result = settling_rows(np.array(changing), settles, 1e-3)
    after = 1 + math.ceil(SETTLING_TIME_CONSTANTS * settles / 1e-3)
    assert result.tolist() == [any(changing[max(row - after, 0) : row + 2]) for row in range(len(changing))]


@pytest.mark.parametrize("begin", [0.0, -2.0, 1.5])
def test_a_slew_limited_drive_may_begin_a_run_on_its_way(begin):
    count, interval, rate, asked = 400, 1e-3, 20.0, 2.0
    flowing = np.minimum(begin + rate * interval * np.arange(1, count + 1), asked)
    channels = {("q_axis_current_reference", "test"): asked, ("q_axis_current", "test"): flowing}
    run = replace(record("free"), fast=clocked(count, interval, channels), slow=None)
    signals = fast_signals(run, model(), None)
    limited = library()["command_slew_limit"].terms(signals, (rate,))["current_following"]["strength"]
    assert signals.following + limited == pytest.approx(flowing, abs=0.1)


@pytest.mark.parametrize("as_mean", [True, False])
def test_a_command_is_limited_before_its_loop(as_mean):
    count, interval, parts, rate, bandwidth = 600, 1e-3, 200, 300.0, 40.0
    asked = np.repeat([0.0, 6.0, -4.0, 2.0, 2.05, -1.0], 100)
    step, limited, flowing, course = interval / parts, 0.0, 0.0, []
    for wanted in np.repeat(asked, parts):
        limited += min(max(wanted - limited, -rate * step), rate * step)
        flowing += (limited - flowing) * -math.expm1(-2.0 * math.pi * bandwidth * step)
        course.append(flowing)
    table = np.reshape(course, (count, parts))
    reading = table.mean(axis=1) if as_mean else table[:, -1]
    clock = clocked(count, interval, {("q_axis_current_reference", "test"): asked, ("q_axis_current", "test"): reading})
    clock = replace(clock, means={("q_axis_current", "test")} if as_mean else set())
    run = replace(record("free"), fast=clock, slow=None)
    signals = fast_signals(run, model(bench={"current_loop_bandwidth": bandwidth}), None)
    column = library()["command_slew_limit"].terms(signals, (rate,))["current_following"]["strength"]
    missed = reading - signals.following - column
    assert np.std(missed) < 0.005 * np.std(column)


@pytest.mark.parametrize("case", ["held", "unstamped", "between", "servo"])
def test_a_ramp_within_one_interval_is_late_by_half_of_it_where_the_command_is_known_to_hold(case):
    interval, parts, rate = 1e-3, 200, 300.0
    steps = np.array([0.0, 0.25, 0.1, -0.15, -0.1, 0.1])  # A, of which a ramp takes no more than 0.84 of an interval
    asked, keys = np.repeat(steps, 50), [("q_axis_current_reference", "test"), ("q_axis_current", "test")]
    reached, course = 0.0, []
    for wanted in np.repeat(asked, parts):
        reached += min(max(wanted - reached, -rate * interval / parts), rate * interval / parts)
        course.append(reached)
    means = np.reshape(course, (len(asked), parts)).mean(axis=1)
    clock = clocked(len(asked), interval, dict(zip(keys, [asked, means], strict=True)))
    if case == "servo":
        clock.values["velocity_reference", "test"] = np.zeros(len(asked))
    unstamped = set(keys) if case == "unstamped" else set()
    clock = replace(clock, means={keys[1]}, unstamped=unstamped, setpoints_between=case == "between")
    signals = fast_signals(replace(record("free"), fast=clock, slow=None), model(bench=WIDE), None)
    column = library()["command_slew_limit"].terms(signals, (rate,))["current_following"]["strength"]
    assert column == pytest.approx(means - asked if case == "held" else np.zeros_like(asked), abs=2e-3)


@given(st.floats(0.05, 20.0), st.sampled_from([1, 4, 16]))
def test_a_replayed_ramp_is_late_by_half_of_it_however_short_a_step_is(rows, parts):
    plant = Plant(model(), 1.0, 0.0)
    library()["command_slew_limit"].act({"rate": 1.0 / rows}, plant)  # A, in rows, for a leap of 1 A
    [limit] = plant.command
    means = limit(np.append(0.0, np.ones(40 * parts)), 1.0 / parts)
    assert np.sum(1.0 - means[1:]) / parts == pytest.approx(0.5 * rows)
