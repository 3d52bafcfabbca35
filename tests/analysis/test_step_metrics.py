"""Step metrics where noise or the resolution of readings is a good part of the response: right, or not known."""

import math

import numpy as np
import pytest

from leactl.analysis.responses.step_metrics import overshoot, rise_time, settling_time
from leactl.analysis.responses.step_trials import StepTrial
from leactl.analysis.statistics.jackknife import jackknife_over_trials, mean_of_levels
from tests.analysis.control_runs import ringing

SAMPLE_S = 1e-3
TIME = SAMPLE_S * np.arange(1, 800)
SEEDS = 40


def estimate(figure, levels):
    return mean_of_levels(
        "",
        "",
        [jackknife_over_trials(len(own), lambda kept, own=own: figure([own[k] for k in kept])) for own in levels],
    )


def noisy(answer, noise, random, trials=5, levels=3):
    """Trials of a response with noise [of the step]."""
    return [
        [
            StepTrial(1.0, TIME, answer(TIME) + random.normal(0.0, noise, len(TIME)), 0.0, 0.6, noise, 0.0, 0.0)
            for _ in range(trials)
        ]
        for _ in range(levels)
    ]


def first_order(lag):
    return lambda time: 1.0 - np.exp(-time / lag)


SLOWER = [(1e-3, 0.01), (2e-3, 0.02), (20e-3, 0.02)]


@pytest.mark.parametrize(
    ("lag", "noise"), [(0.3e-3, 0.01), *(pytest.param(*loop, marks=pytest.mark.long) for loop in SLOWER)]
)
def test_noise_does_not_make_a_fast_loop_settle_late(lag, noise):
    held = 0
    for seed in range(SEEDS):
        result = estimate(settling_time, noisy(first_order(lag), noise, np.random.default_rng(seed)))
        held += result.low <= lag * math.log(50.0) <= result.high
    assert held >= 0.85 * SEEDS


def test_noise_that_leaves_the_settling_open_gives_no_time():
    assert math.isnan(estimate(settling_time, noisy(first_order(0.3e-3), 0.05, np.random.default_rng(1))).value)


@pytest.mark.parametrize("natural", [20.0, pytest.param(60.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("above", [5.0, pytest.param(8.0, marks=pytest.mark.long), 20.0])
def test_an_overshoot_is_not_its_highest_noise(natural, above):
    true, held, values = 100.0 * math.exp(-math.pi * 0.75), 0, []  # of damping 0.6
    for seed in range(SEEDS):
        noise = 0.01 * true / above * math.sqrt(5.0)
        result = estimate(overshoot, noisy(ringing(natural, 0.6), noise, np.random.default_rng(seed)))
        held += result.low <= true <= result.high
        values.append(result.value)
    assert held >= 0.85 * SEEDS
    assert np.mean(values) == pytest.approx(true, rel=0.08)


@pytest.mark.parametrize("lag", [5e-3, 50e-3])
@pytest.mark.parametrize("quantum", [0.005, 0.02])
def test_rounding_that_every_trial_repeats_is_in_the_interval(lag, quantum):
    held = dict.fromkeys((rise_time, settling_time), 0)
    truths = {rise_time: lag * math.log(9.0), settling_time: lag * math.log(50.0)}
    for seed in range(SEEDS):
        step = 1.0 + np.random.default_rng(seed).uniform(0.0, quantum)
        read = np.round(step * first_order(lag)(TIME) / quantum) * quantum
        read = read / read[600:].mean()
        trials = [StepTrial(1.0, TIME, read, 0.0, 0.6, noise=1e-9, quantum=quantum, error_before=0.0)] * 2
        for figure, true in truths.items():
            result = estimate(figure, [trials])
            held[figure] += result.low <= true <= result.high
    assert held[rise_time] >= 0.8 * SEEDS
    assert held[settling_time] >= 0.8 * SEEDS or quantum == 0.02  # half a step is half of the band there: not known


@pytest.mark.parametrize("falls_s", [0.1, 0.3])
def test_a_top_on_which_friction_holds_the_rotor_is_no_higher_than_it_is(falls_s):
    """It goes up fast, sticks, lets go and sticks again: no curve through all of that is its top."""
    held, errors = 0, []
    for seed in range(SEEDS):
        over = np.random.default_rng(seed).uniform(0.003, 0.006)
        up = np.minimum(TIME / 0.07, 1.0) * (1.0 + over)
        down = over * np.clip((TIME - falls_s) / 0.1, 0.0, 1.0)
        read = 1e-4 * np.round((up - down) / 1e-4)
        trials = [
            StepTrial(1.0, TIME, read / read[600:].mean(), 0.0, 0.6, noise=1e-9, quantum=1e-4, error_before=0.0)
        ] * 2
        result = estimate(overshoot, [trials])
        held += result.low <= 100.0 * over <= result.high
        errors.append(result.value - 100.0 * over)
    assert held >= 0.7 * SEEDS
    assert abs(np.mean(errors)) < 0.005  # half a step of the readings
