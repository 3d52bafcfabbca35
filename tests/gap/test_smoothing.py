"""Filters of the gap's equations: exact where they say so, and no side of an equation shifted against another."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.effects.hysteresis_and_lags import bristle, delayed, lagged, play, rate_limited
from leactl.effects.plant import plant_without_effects
from leactl.gap.replay.job import Job
from leactl.gap.replay.readings import measured_speed
from leactl.gap.signals.record import Record
from leactl.gap.signals.smoothing import (
    bent_mean_signs,
    interval_means,
    mean_signs,
    sharp_mean_signs,
    slope,
    smoothed_and_thinned,
    speeds,
    thinned_rows,
)
from tests.gap.synthetic import clocked, model

COEFFICIENTS = st.lists(st.floats(-3, 3), min_size=4, max_size=4)
INTERVAL = 0.01


def cubic(coefficients, at):
    return np.polyval(coefficients, at)


@given(COEFFICIENTS)
def test_slope_is_exact_for_cubics(coefficients):
    at = INTERVAL * np.arange(50)
    expected = np.polyval(np.polyder(coefficients), at)
    np.testing.assert_allclose(slope(cubic(coefficients, at), INTERVAL)[2:-2], expected[2:-2], atol=1e-9)


@given(COEFFICIENTS)
def test_middle_is_the_mean_over_the_interval_before_for_cubics(coefficients):
    at = INTERVAL * np.arange(50)
    whole = np.polyint(coefficients)
    expected = (np.polyval(whole, at[1:]) - np.polyval(whole, at[:-1])) / INTERVAL
    np.testing.assert_allclose(interval_means(cubic(coefficients, at))[2:-1], expected[1:-1], atol=1e-9)


@given(st.floats(0.5, 9), st.integers(1, 20), st.integers(120, 400))
def test_a_thinned_ramp_is_the_ramp_at_the_samples_named(width, step, length):
    ramp = np.arange(float(length))[:, None]
    index = thinned_rows(length, width, step)
    rows = smoothed_and_thinned(ramp, width, step)
    assert len(rows) == len(index)
    np.testing.assert_allclose(rows[:, 0], index, atol=1e-7)


@given(st.floats(1e-4, 0.05), st.floats(-5, 5))
def test_a_lagged_ramp_is_late_by_the_time_constant(constant, rate):
    time = 0.001 * np.arange(3000)
    late = lagged(rate * time, constant, 0.001)
    assert late[-1] == pytest.approx(rate * (time[-1] - constant), abs=1e-6)


@given(st.floats(0, 0.02))
def test_a_delayed_ramp_is_late_by_the_delay(delay):
    time = 0.001 * np.arange(200)
    np.testing.assert_allclose(delayed(time, delay, 0.001)[30:], time[30:] - delay, atol=1e-12)


SIGNALS = st.lists(st.floats(-10, 10), min_size=2, max_size=60).map(np.array)


@given(SIGNALS, st.floats(0.01, 5))
def test_play_stays_within_its_width_and_never_turns_before_its_drive(values, width):
    out = play(values, width)
    assert np.all(np.abs(values - out) <= width + 1e-9)
    moved = np.diff(np.concatenate([[0.0], out]))
    drive = np.diff(np.concatenate([[0.0], values]))
    assert np.all((moved == 0) | (np.sign(moved) == np.sign(drive)) | (np.abs(drive) < 1e-9))


@given(SIGNALS, st.floats(0.01, 5))
def test_bristle_friction_is_bounded_and_opposes_the_last_long_slide(angle, displacement):
    out = bristle(angle, displacement)
    assert np.all(np.abs(out) <= 1.0)
    long = np.concatenate([angle, angle[-1] + np.linspace(0, 40 * displacement, 20)])
    assert bristle(long, displacement)[-1] == pytest.approx(1.0, abs=1e-6)


@given(SIGNALS, st.floats(0.1, 5))
def test_a_rate_limit_holds(values, step):
    out = rate_limited(values, step)
    assert np.all(np.abs(np.diff(out)) <= step + 1e-9)


@given(SIGNALS, st.floats(0.01, 5))
def test_every_step_of_a_curve_with_a_memory_follows_from_the_one_before(values, width):
    played, bent, limited = play(values, width), bristle(values, width), rate_limited(values, width, 1.5)
    np.testing.assert_array_equal(played, np.clip(np.append(0.0, played[:-1]), values - width, values + width))
    moved = np.diff(values, prepend=values[0])
    decay = np.exp(-np.abs(moved) / width)
    np.testing.assert_allclose(bent, np.append(0.0, bent[:-1]) * decay + np.sign(moved) * (1.0 - decay), atol=1e-12)
    behind = np.append(1.5, limited[:-1])
    np.testing.assert_allclose(limited, behind + np.clip(values - behind, -width, width), atol=1e-12)


@given(st.floats(0.1, 5.0), st.floats(5.0, 15.0))
def test_which_way_is_a_mean_over_the_interval_in_which_a_speed_turns_back(rate, turns_at):
    at = np.arange(20.0)
    speeds = rate * (at - 0.5 - turns_at)  # means over the intervals that end at each sample
    fine = np.linspace(0.0, 19.0, 19001)
    which = np.sign(fine - turns_at)
    means = [np.mean(which[(fine > end - 1.0) & (fine <= end)]) for end in at[1:]]
    np.testing.assert_allclose(mean_signs(speeds)[1:], means, atol=2e-3)


def test_friction_turns_round_when_the_speed_does_and_not_when_its_smoothed_one_does():
    """Friction halves the deceleration at the turn, which smoothing moves by more than half a sample."""
    at = np.arange(100.0)
    turns_at = 50.4
    speed = np.where(at < turns_at, 2.0, 1.0) * (turns_at - at)  # at the ends of the intervals
    means = interval_means(speed)
    after = [
        np.sum(0.5 * (1.0 - sharp_mean_signs(means, noise))) for noise in (0.01, 100.0)
    ]  # as told, and as smoothed
    told, smoothed = np.abs(np.array(after) - (99.0 - turns_at))
    assert told < 0.3 < 0.5 < smoothed


def test_a_slow_turn_keeps_the_smoothed_sense():
    random = np.random.default_rng(1)
    speeds = 0.002 * np.arange(-100.0, 100.0) + 0.05 * random.standard_normal(200)
    assert np.all(np.diff(np.sign(sharp_mean_signs(speeds, 0.05))) >= 0.0)


@pytest.mark.parametrize("rate", [-7.0, 0.0, 12.0])
def test_a_run_that_begins_while_it_turns_has_its_speed_from_the_first_sample_on(rate):
    turned = rate * INTERVAL * np.arange(40)
    begun = Record(Path("a.h5"), "free", "free", clocked(40, INTERVAL, {("angle", "test"): turned}), None, {})
    np.testing.assert_allclose(speeds(turned, INTERVAL), rate, atol=1e-9)
    np.testing.assert_allclose(measured_speed(Job(begun, plant_without_effects(model()))), rate, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(
    begin=st.floats(0.0, 1.0),
    slowing=st.floats(1.0, 100.0),
    ratio=st.floats(0.05, 1.0),
    way=st.sampled_from((-1.0, 1.0)),
)
def test_where_friction_bends_a_speed_it_turns_back_where_two_lines_meet(begin, slowing, ratio, way):
    """Speeds as means over intervals: a friction that turns round makes what slows a rotor weaker afterwards."""
    moment, parts = 20.0 + begin, 200
    fine = (np.arange(40 * parts) + 0.5) / parts
    course = way * (moment - fine) * np.where(fine < moment, slowing, ratio * slowing)
    means, true = (values.reshape(40, parts).mean(axis=1) for values in (course, np.where(fine < moment, way, -way)))
    np.testing.assert_allclose(bent_mean_signs(means, 0.0)[1:-2], true[1:-2], atol=0.03)


@pytest.mark.parametrize("ratio", [0.9, 0.6, 0.3])
@pytest.mark.parametrize("slowing", [2.0, 4.0, 8.0, 30.0])
def test_lines_through_an_encoder_s_counts_tell_a_reversal_no_worse_than_the_speed_between_two(slowing, ratio):
    """Root mean square of how far off the moments are, in samples, over reversals at any place within one."""
    random, off = np.random.default_rng(5), []
    ends = np.arange(41.0)
    for moment in 20.0 + random.random(200):
        angle = np.where(ends < moment, -0.5 * slowing, -0.5 * ratio * slowing) * (ends - moment) ** 2 + random.random()
        counted = np.diff(np.round(angle))  # counts an interval
        off.append(
            [0.5 * np.sum(1.0 + told(counted)) - moment for told in (mean_signs, lambda s: bent_mean_signs(s, 1.0))]
        )
    even, bent = np.sqrt(np.mean(np.square(off), axis=0))
    assert bent <= 1.1 * even + 0.01
