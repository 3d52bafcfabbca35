"""A load behind teeth with play goes where mechanics takes it, whatever moves its motor."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.effects.teeth import MOST_SPEED_MISMATCH, PIECE_SAMPLES, follow_loads

INTERVAL_S = 1e-3
SAMPLES = 6 * PIECE_SAMPLES + 17  # of no whole number of pieces


def motor(seed, slowest=1.0, fastest=12.0):
    """Speed of a motor that swings about nothing at three frequencies."""
    draw = np.random.default_rng(seed)
    time = INTERVAL_S * np.arange(SAMPLES)
    rates, phases = draw.uniform(slowest, fastest, 3), draw.uniform(0.0, 2.0 * np.pi, 3)
    return sum(3.0 * np.sin(2.0 * np.pi * rate * time + phase) for rate, phase in zip(rates, phases, strict=True))


def one_by_one(speed, half, damping, friction, parts=50):
    """The same load in steps of its own, fifty to a sample, from the first to the last."""
    step, load, twist = INTERVAL_S / parts, speed[0], half * np.sign(speed[0])
    loads = [load]
    for before, after in itertools.pairwise(speed):
        for part in range(parts):
            moves = before + (after - before) * (part + 0.5) / parts
            load -= damping * load * step
            load -= np.clip(load, -friction * step, friction * step)
            twist += (moves - load) * step
            if abs(twist) > half:
                side = np.sign(twist)
                load, twist = side * max(side * load, side * moves), side * half
        loads.append(load)
    return np.array(loads)


@given(
    seed=st.integers(0, 10_000),
    half=st.floats(0.0005, 0.05),
    damping=st.floats(0.0, 5.0),
    friction=st.floats(0.0, 60.0),
)
def test_a_load_never_leaves_its_play_and_is_only_slowed_while_it_is_free(seed, half, damping, friction):
    speed = motor(seed)
    loads, twists = follow_loads(speed, INTERVAL_S, *(np.array([value]) for value in (half, damping, friction)))
    assert np.all(np.abs(twists) <= half * (1.0 + 1e-12))
    free = (np.abs(twists[0, :-1]) < 0.99 * half) & (np.abs(twists[0, 1:]) < 0.99 * half)
    apart = np.abs(twists[0, 1:] - twists[0, :-1]) < 0.5 * half  # nor did it cross the play between two samples
    before, after = np.abs(loads[0, :-1])[free & apart], np.abs(loads[0, 1:])[free & apart]
    assert np.all(after <= before + MOST_SPEED_MISMATCH * np.max(np.abs(speed))), "but for where pieces meet"


@pytest.mark.parametrize(("damping", "friction"), [(0.0, 0.0), (0.5, 10.0), (2.0, 80.0)])
@pytest.mark.parametrize("half", [0.002, 0.02])
def test_pieces_side_by_side_are_what_steps_one_by_one_give(half, damping, friction):
    speed = motor(3)
    loads, _ = follow_loads(speed, INTERVAL_S, np.array([half]), np.array([damping]), np.array([friction]))
    expected = one_by_one(speed, half, damping, friction)
    wrong = np.abs(loads[0] - expected)
    assert np.median(wrong) < 0.01
    assert np.mean(wrong > 0.2) < 0.05, "but for the moments at which flanks meet"


def test_where_the_teeth_stood_before_a_long_rest_is_not_forgotten():
    speed = np.zeros(SAMPLES)
    speed[1:100], speed[100:120], speed[-100:] = 1.0, -0.5, 1.0
    loads, twists = follow_loads(speed, INTERVAL_S, np.array([0.02]), np.zeros(1), np.array([200.0]))
    expected = one_by_one(speed, 0.02, 0.0, 200.0)
    assert 0.0 < twists[0, -101] < 0.015
    assert np.sum(np.abs(loads[0] - expected) > 0.1) <= 2


def test_several_loads_do_not_touch_each_other():
    speed, plays, rubs = motor(5), np.array([0.001, 0.01, 0.03]), np.array([0.0, 20.0, 5.0])
    together, _ = follow_loads(speed, INTERVAL_S, plays, np.zeros(3), rubs)
    for index in range(3):
        alone, _ = follow_loads(speed, INTERVAL_S, plays[index : index + 1], np.zeros(1), rubs[index : index + 1])
        assert np.array_equal(alone[0], together[index])


def test_a_load_falls_through_its_play_and_rests_on_the_other_flank():
    fall, half = 5.0, 0.02
    loads, twists = follow_loads(
        np.zeros(SAMPLES), INTERVAL_S, np.array([half]), np.zeros(1), np.zeros(1), np.full(SAMPLES, fall)
    )
    time = INTERVAL_S * np.arange(SAMPLES)
    falling = time < np.sqrt(2.0 * half / fall)
    assert falling.sum() > 10
    np.testing.assert_allclose(twists[0, falling], 0.5 * fall * time[falling] ** 2, atol=0.02 * half)
    np.testing.assert_allclose(loads[0, falling], -fall * time[falling], atol=1e-9)
    rests = time > np.sqrt(2.0 * half / fall) + 2.0 * INTERVAL_S
    np.testing.assert_allclose(twists[0, rests], half)
    np.testing.assert_allclose(loads[0, rests], 0.0, atol=1e-12)


def test_without_play_a_load_goes_as_its_motor_does():
    speed = motor(7)
    loads, _ = follow_loads(speed, INTERVAL_S, np.array([1e-9]), np.zeros(1), np.zeros(1))
    assert np.max(np.abs(loads[0] - speed)[1:]) < 1e-3
