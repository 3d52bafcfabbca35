"""What a residual depends on: state, time or nothing logged, whatever the size of the machine."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.gap.verdict.state_regression import (
    LEAST_CERTAINTY,
    Sample,
    certainty,
    confirmed_variables,
    learn,
    slow_gain,
)

ROWS, RUNS, STRETCHES = 1500, 2, 24
NOISE = 0.01
ORDERS = (1.0, 2.0, 3.0, 31.0)


def made(seed, rest, by=1.0, size=1.0):
    """Two runs whose speed steps and whose current is a wave of its own; a rest and noise."""
    random = np.random.default_rng(seed)
    rows = ROWS * RUNS
    velocity = np.repeat(random.uniform(-25.0, 25.0, rows // 50), 50) + random.normal(0.0, 0.5, rows)
    current = 12.0 * np.sin(0.031 * np.arange(rows) + random.uniform(0.0, 6.0)) + random.normal(0.0, 1.0, rows)
    angle = np.mod(np.cumsum(velocity) * 0.013, 2.0 * np.pi)
    state = {"velocity": velocity, "q_axis_current": current, "angle": angle}
    left = rest(random, state, rows) + random.normal(0.0, NOISE, rows)
    run = np.repeat(np.arange(RUNS), ROWS)
    stretch = run * (STRETCHES + 1) + np.tile(np.arange(ROWS) * STRETCHES // ROWS, RUNS)
    return Sample(size * left, state | {"velocity": by * velocity, "q_axis_current": current / by}, stretch)


def described(rest, by=1.0, size=1.0):
    """Variables that are borne out on other runs, and the share that they close there."""
    fitted, others = made(1, rest, by, size), made(2, rest, by, size)
    noise = len(fitted) * (size * NOISE) ** 2
    trial, chosen, ridge = learn(fitted, ORDERS, float(np.sum(fitted.residual**2)) - noise)
    kept = confirmed_variables(trial, chosen, ridge, others)
    free = trial.function(kept, ridge)
    after = float(np.sum((others.residual - free.of(others)) ** 2))
    return set(free.variables), 1.0 - (after - noise) / (float(np.sum(others.residual**2)) - noise), free


def of_speed(_, state, rows):
    return 0.002 * state["velocity"] * np.abs(state["velocity"]) / 25.0


def of_both(_, state, rows):
    return 1e-4 * state["velocity"] * state["q_axis_current"] ** 2


def of_angle(_, state, rows):
    return 0.05 * np.sin(31.0 * state["angle"] + 0.7) * np.sign(state["velocity"])


def of_time(random, _, rows):
    return 0.1 * np.cumsum(random.normal(0.0, 0.03, rows))


def of_bursts(random, _, rows):
    return 0.3 * np.repeat(random.random(rows // 20) < 0.05, 20)


@pytest.mark.parametrize(
    ("rest", "variables"),
    [(of_speed, {"velocity"}), (of_both, {"velocity", "q_axis_current"}), (of_angle, {"angle"})],
)
def test_what_a_rest_is_a_function_of_is_told(rest, variables):
    told, closed, free = described(rest)
    assert told == variables
    assert closed > 0.9
    assert free.strongest_order() == (31.0 if rest is of_angle else 1.0)


@pytest.mark.parametrize("rest", [of_bursts, of_time, lambda *_: 0.0])
def test_what_no_state_tells_is_a_function_of_nothing(rest):
    assert described(rest)[0] == set()


@settings(max_examples=3, deadline=None)
@given(st.sampled_from([0.02, 0.4, 7.0, 300.0]), st.sampled_from([1e-4, 0.3, 2000.0]))
def test_a_similar_machine_has_the_same_answer(by, size):
    told, closed, _ = described(of_both, by, size)
    assert told == {"velocity", "q_axis_current"}
    assert closed == pytest.approx(described(of_both)[1], abs=1e-6)


def test_what_drifts_is_like_its_neighbours_and_bursts_are_not():
    drifting, bursting = made(3, of_time), made(3, of_bursts)
    for sample, slow in ((drifting, True), (bursting, False)):
        gained = slow_gain(sample.residual, sample.stretch)
        is_sure = certainty(gained, sample.stretch) >= LEAST_CERTAINTY
        assert bool(is_sure and gained.sum() > 0.2 * np.sum(sample.residual**2)) is slow


def test_one_stretch_alone_makes_nothing_certain():
    assert certainty(np.ones(50), np.zeros(50, int)) == 0.5
    assert certainty(np.ones(50) + np.arange(50) / 50, np.arange(50)) > LEAST_CERTAINTY
