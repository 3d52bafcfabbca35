"""Where equations leave the form of an effect open, the replay of the fitted runs that comes nearest chooses it."""

import math

import numpy as np
import pytest

from leactl.gap.open_forms import FORM_STDS, MOST_FORM_STD, across_open_form, nearest_to_runs
from leactl.gap.replay import replay
from leactl.gap.search.effect_regression import Evidence
from tests.gap.synthetic import CONSTANT, FRICTION, INTERVAL_S, model, record

RATIO, SPEED = 0.4, 0.35
STRIBECK, SPRING = ("stribeck", (SPEED, 1.0)), ("position_spring", (2.0, 0.0))
# ratio and speed of friction laws whose tails are alike, 0.27 at 0.44 rad/s and so on; the second is the true one
PAIRS = [(1.75, 0.24), (RATIO, SPEED), (0.2, 0.6)]


def with_friction(ratio, speed):
    parameters = {"breakaway_ratio": ratio, "stribeck_velocity": speed, "shape": 1.0}
    return model(("stribeck", parameters), resistance_coefficient=0.0)


@pytest.fixture
def evidence():
    """Of runs in which the current goes slowly up and down through what starts the rotor."""
    time = INTERVAL_S * np.arange(3000)
    level = FRICTION / CONSTANT
    records = []
    for period in (1.1, 1.7):
        run = record("free", reference=1.8 * level * np.sin(2.0 * np.pi * time / period), seconds=3.0)
        job = replay(run, with_friction(RATIO, SPEED))
        for key, values in job.fast.items():
            run.fast.values[key] = np.nan_to_num(values)
        run.fast.values["angle", "test"] = job.angle[:: job.parts][: len(time)]
        records.append(run)
    return Evidence(records, model(resistance_coefficient=0.0), only=[STRIBECK])


def test_the_law_that_lets_the_rotor_start_as_it_did_is_the_nearest(evidence):
    models = [with_friction(*pair) for pair in PAIRS]
    assert nearest_to_runs(evidence, [STRIBECK], models) == 1
    assert nearest_to_runs(evidence, [STRIBECK], models[::-1]) == 1
    assert nearest_to_runs(evidence, [STRIBECK], [models[2], models[0], models[1]]) == 2


def test_the_least_certain_form_is_moved_along_its_least_certain_direction(evidence):
    evidence.form_spread[STRIBECK] = np.array([[0.1**2]])
    evidence.form_spread[SPRING] = np.array([[0.0, 0.0], [0.0, 0.2**2]])
    moved = across_open_form(evidence, [STRIBECK, SPRING])
    assert [candidate for candidate, _ in moved] == [STRIBECK] * len(FORM_STDS)
    rests = [form[1] for _, (_, form) in moved]
    assert [form[0] for _, (_, form) in moved] == pytest.approx([SPRING[1][0]] * len(FORM_STDS))
    assert rests == [0.0] * len(FORM_STDS)  # a rest at zero has no logarithm
    alone = [form for ((_, form),) in across_open_form(evidence, [STRIBECK])]
    assert sorted(math.log(form[0] / SPEED) for form in alone) == pytest.approx(sorted(0.1 * std for std in FORM_STDS))
    assert {form[1] for form in alone} == {1.0}


@pytest.mark.parametrize("std", [0.0, 0.01, math.inf])
def test_a_form_that_is_known_or_that_no_run_shows_is_not_moved(evidence, std):
    evidence.form_spread[STRIBECK] = np.array([[std**2]])
    assert across_open_form(evidence, [STRIBECK]) == []
    assert across_open_form(evidence, []) == []


def test_no_form_is_moved_farther_than_its_widest_bound(evidence):
    evidence.form_spread[STRIBECK] = np.array([[9.0]])
    farthest = max(form[0] for ((_, form),) in across_open_form(evidence, [STRIBECK]))
    assert farthest == pytest.approx(SPEED * math.exp(max(FORM_STDS) * MOST_FORM_STD))
