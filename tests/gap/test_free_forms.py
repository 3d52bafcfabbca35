"""An effect has to explain more than a free function of the variables in which another effect's law may be inexact."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.effects.contract import Signals
from leactl.gap.search.free_forms import TURN, missed_by_form, outdoes_free_forms
from leactl.gap.search.regression import Normal, Rows, stack
from leactl.gap.signals.effect_variables import hats
from leactl.model.nominal import Model

SPRING, UNBALANCE, DRAG = ("position_spring", (1.0,)), ("unbalance", ()), ("quadratic_drag", ())
NOISE, COUNT = 0.02, 600


def run(law, seed=0, equation="free_torque", drag=0.0, shown=True):
    """A shaft that swings over a turn and a half, under a torque that goes with its angle by some law."""
    random = np.random.default_rng(seed)
    time = 0.01 * np.arange(COUNT)
    angle, velocity = 2.4 * np.sin(2.0 * time + seed), 4.8 * np.cos(2.0 * time + seed)
    columns = {
        ("calibration", "viscous_damping"): velocity,
        ("effect", SPRING[0], repr(SPRING[1]), "stiffness"): -angle,
        ("effect", UNBALANCE[0], repr(UNBALANCE[1]), "sin"): np.sin(angle),
        ("effect", DRAG[0], repr(DRAG[1]), "drag"): velocity * np.abs(velocity),
    }
    left = law(angle) + drag * velocity * np.abs(velocity) + NOISE * random.normal(size=COUNT)
    index = np.arange(COUNT)
    signals = Signals(
        "free", time, Model(name="m"), 0.01, angle=angle if shown else None, velocity=velocity, current=left
    )
    return Rows(
        f"r{seed}", "k", "free", equation, "velocity", "test", "rad/s", left, columns, {}, index, index // 40, signals,
        NOISE,
    )  # fmt: skip


def normal(law, **more):
    return equations_of([run(law, seed, **more) for seed in range(3)])


def equations_of(runs):
    return Normal(stack(runs, {}), [1 / NOISE**2] * len(runs))


def linear(angle):
    return -0.5 * angle


def stiffening(angle):
    return -0.5 * angle - 0.03 * angle**3


def gain(equations, hypothesis, candidate):
    return equations.fit(hypothesis).misfit - equations.fit([*hypothesis, candidate]).misfit


def test_what_another_law_leaves_over_its_own_variable_is_no_further_effect():
    equations = normal(stiffening)
    assert gain(equations, [SPRING], UNBALANCE) > 1000.0
    assert not outdoes_free_forms(equations, [SPRING], UNBALANCE)


def test_an_effect_over_another_variable_stands_beside_a_law_that_is_inexact():
    equations = normal(stiffening, drag=0.05)
    assert outdoes_free_forms(equations, [SPRING], DRAG)
    assert not outdoes_free_forms(normal(stiffening), [SPRING], DRAG)


def test_nothing_is_let_free_where_no_run_shows_the_variable_or_it_holds_the_rest():
    """With the rotor locked the angle is all that a torque follows; a free function of it would explain anything."""
    for equations in (normal(stiffening, shown=False), normal(stiffening, equation="lock")):
        assert outdoes_free_forms(equations, [SPRING], UNBALANCE)
        assert missed_by_form(equations, [SPRING], SPRING) == math.inf


def test_a_sign_has_no_free_form():
    """Asymmetric friction acts over the direction alone: what its form misses nobody can see."""
    asymmetric = ("asymmetric_friction", ())
    several = [run(linear, seed) for seed in range(3)]
    for rows in several:
        direction = np.sign(rows.signals.velocity)
        rows.columns["effect", asymmetric[0], "()", "asymmetry"] = np.abs(direction)
    assert missed_by_form(equations_of(several), [asymmetric], asymmetric) == math.inf


def test_the_error_of_a_law_counts_only_where_the_other_effect_acts():
    """A spring that is not linear says nothing against a faint drag in another equation, which the spring is not in."""
    drag = 0.003
    springs = [run(stiffening, seed) for seed in range(3)]
    drags = [run(lambda angle: 0.0 * angle, seed, equation="velocity", drag=drag) for seed in range(3)]
    for rows in springs:
        del rows.columns["effect", DRAG[0], repr(DRAG[1]), "drag"]
    for rows in drags:
        del rows.columns["effect", SPRING[0], repr(SPRING[1]), "stiffness"]
    equations = equations_of([*springs, *drags])
    assert gain(equations, [SPRING], DRAG) < missed_by_form(equations, [SPRING, DRAG], SPRING)
    assert outdoes_free_forms(equations, [SPRING], DRAG)


def test_beside_no_effect_nothing_is_let_free():
    assert outdoes_free_forms(normal(linear), [], SPRING)


@given(st.integers(0, 2**20))
def test_a_law_that_is_right_misses_no_more_than_noise_and_a_wrong_one_what_it_leaves(seed):
    right, wrong = equations_of([run(linear, seed)]), equations_of([run(stiffening, seed)])
    assert missed_by_form(right, [SPRING], SPRING) < 40.0
    left = wrong.fit([SPRING]).misfit - COUNT
    assert missed_by_form(wrong, [SPRING], SPRING) == pytest.approx(left, rel=0.2)


@pytest.mark.parametrize("resting", [0.0, 0.8, 0.9])
def test_a_shaft_that_mostly_rests_shows_what_a_law_misses_where_it_moves(resting):
    several = []
    for seed in range(3):
        at_rest = np.arange(COUNT) < resting * COUNT
        several.append(run(lambda angle, at_rest=at_rest: stiffening(np.where(at_rest, 1.0, angle)), seed))
        several[-1].signals.angle[at_rest] = 1.0
        several[-1].columns["effect", SPRING[0], repr(SPRING[1]), "stiffness"][at_rest] = -1.0
    equations = equations_of(several)
    missed = missed_by_form(equations, [SPRING], SPRING)
    assert missed == pytest.approx(equations.fit([SPRING]).misfit - 3 * COUNT, rel=0.3)
    assert missed > 100.0


def test_a_run_that_hides_the_variable_does_not_bind_the_others():
    """The spring of the hidden run is softer than that of the others at any of their knots."""
    others = equations_of([run(stiffening, seed) for seed in range(2)])
    hidden = run(lambda angle: -0.3 * angle, 2, shown=False)
    equations = equations_of([run(stiffening, 0), run(stiffening, 1), hidden])
    alone = missed_by_form(others, [SPRING], SPRING)
    assert alone > 1000.0
    free = equations.fit([SPRING]).misfit - missed_by_form(equations, [SPRING], SPRING)
    assert free == pytest.approx(others.fit([SPRING]).misfit - alone + COUNT, rel=0.2)


def test_functions_of_the_place_within_a_turn_go_on_over_its_end():
    knots = np.array([0.4, 1.0, 3.0, 5.0])
    end, start = hats(np.array([TURN - 1e-9, 1e-9]), knots, TURN)
    assert end == pytest.approx(start, abs=1e-6)
    assert start[0] > 0.0 < start[-1]
    assert np.allclose(hats(np.linspace(0.0, TURN, 99), knots, TURN).sum(axis=1), 1.0)


def test_columns_of_the_equations_stay_as_they_are():
    equations = normal(stiffening)
    names = [list(rows.columns) for rows in equations.stack.rows]
    outdoes_free_forms(equations, [SPRING], UNBALANCE)
    assert [list(rows.columns) for rows in equations.stack.rows] == names
