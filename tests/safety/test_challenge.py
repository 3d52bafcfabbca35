"""The adversary of the thermal guard: courses that a bench could run, a plant that is right, and wrong guards found."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from leactl.errors import InputError
from leactl.runner.challenge.courses import GENES, KINDS, READINGS, course
from leactl.runner.challenge.hunt import Attempt, hunt, hunts, run_attempt
from leactl.runner.challenge.optimisers import OPTIMISERS
from leactl.runner.challenge.phases import PARAMETERS, Phases
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.guard import ThermalGuard
from tests.safety.guards import LEA, SETTINGS

FASTEST = LEA.torque_constant * SETTINGS.most_current / LEA.rotor_inertia


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), rate=st.sampled_from([20.0, 100.0, 1000.0]), reading=st.sampled_from(READINGS))
def test_every_course_is_one_that_the_bench_could_run(seed, rate, reading):
    genes = np.random.default_rng(seed).random(GENES)
    result = course(genes, LEA, SETTINGS, 1.0 / rate, 2.0, reading)
    assert np.all((result.currents >= 0.0) & (result.currents <= SETTINGS.most_current))
    fine, parts = result.passed_angles.ravel(), result.passed_angles.shape[1]
    step = result.interval / parts
    # between instants a step apart: where a rotor comes to rest, two accelerations meet within one
    assert np.max(np.abs(np.diff(fine, 2))) / step**2 <= FASTEST * 1.001
    assert result.angles.shape == result.velocities.shape == result.currents.shape


def test_every_kind_of_course_comes_to_be():
    draws = np.random.default_rng(0).random((60, GENES))
    assert {course(genes, LEA, SETTINGS, 0.01, 1.0, "true").kind for genes in draws} == set(KINDS)


def test_the_plant_goes_where_the_exponential_of_its_matrix_leads():
    box = Box.exact(LEA.model_copy(update={"resistance_coefficient": 0.0}))
    plant, seconds, square = Phases(box, np.zeros(len(PARAMETERS)), 25.0, 25.0), 8.0, 18.0**2
    for _ in range(1600):
        plant.heat(np.full(5, square), np.ones(5, np.complex128), seconds / 1600)
    t = LEA.thermal
    across, air = 1.0 / (3.0 * t.winding_housing_resistance), 1.0 / (3.0 * t.winding_ambient_resistance)
    phase, housing = t.winding_capacitance / 3.0, t.housing_capacitance
    matrix = np.zeros((5, 5))
    for k, share in enumerate((2.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0)):  # of a rotor that stands where one phase takes most
        matrix[k, k] = -(across + air) / phase
        matrix[k, 3], matrix[3, k] = across / phase, across / housing
        matrix[k, 4] = share * LEA.phase_resistance * square / phase
    matrix[3, 3] = -(3.0 * across + 1.0 / t.housing_ambient_resistance) / housing
    exact = 25.0 + (expm(matrix * seconds) @ [0.0, 0.0, 0.0, 0.0, 1.0])[:4]
    assert plant.state[0] == pytest.approx(exact, abs=0.02)


def test_a_motor_that_stands_in_two_roles_is_searched_once():
    other = LEA.model_copy(update={"name": "other"})
    assert [found[0] for found in hunts([("test", LEA), ("load", LEA)], [100.0], ["true"])] == ["test"]
    assert {found[0] for found in hunts([("test", LEA), ("load", other)], [100.0], ["true"])} == {"test", "load"}


# -- guards, right and wrong ------------------------------------------------------------------------------------------


def drawn(guard_of, rate, reading, count):
    """Attempts with genes drawn at random."""
    random = np.random.default_rng(7)
    for _ in range(count):
        yield run_attempt(random.random(GENES + len(PARAMETERS) + 1), LEA, SETTINGS, rate, reading, guard_of)


@pytest.mark.parametrize(("rate", "reading"), [(20.0, "true"), (100.0, "stuck"), (500.0, "noisy"), (100.0, "drifting")])
def test_the_guard_as_it_is_holds(rate, reading):
    results = list(drawn(ThermalGuard, rate, reading, 8))
    assert max(result.over_k for result in results) <= 0.0
    assert max(result.peak for result in results) <= SETTINGS.limit
    assert max(result.peak for result in results) > 100.0


class Wrong(ThermalGuard):
    """A guard one of whose parts is left out."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        for rotor in self.rotors:
            self.spoil(rotor)


class TurnsAlways(Wrong):
    """Shares all heat among the phases."""

    def spoil(self, rotor):
        whole = rotor.span

        def span(log, duration):
            result = whole(log, duration)
            result.angle_phasor = result.velocity_phasor = result.angle_phasor_moment = (
                result.velocity_phasor_moment
            ) = 0.0
            return result

        rotor.span = span


class NoDetour(Wrong):
    """Takes a rotor to turn evenly between two samples."""

    def spoil(self, rotor):
        rotor._detour_factor = 0.0


class NoNoise(Wrong):
    """Takes every change of the angle for travel."""

    def spoil(self, rotor):
        rotor._travel_back = np.zeros_like


class AngleAlone(Wrong):
    """Follows the angle, whatever the velocity says."""

    def spoil(self, rotor):
        whole = rotor.span

        def span(log, duration):
            result = whole(log, duration)
            result.velocity_phasor = result.velocity_phasor_moment = 0.0
            return result

        rotor.span = span


class StopsLate(ThermalGuard):
    """Takes the limit to be 20 K higher."""

    def __init__(self, motors, settings, start):
        super().__init__(motors, replace(settings, limit=settings.limit + 20.0), start)


@pytest.mark.parametrize(
    ("guard_of", "rate", "reading"),
    [
        (TurnsAlways, 500.0, "true"),
        (NoDetour, 20.0, "true"),
        (NoNoise, 500.0, "noisy"),
        (AngleAlone, 500.0, "drifting"),
        (StopsLate, 100.0, "true"),
    ],
)
def test_a_guard_that_is_wrong_is_found(guard_of, rate, reading):
    attempts = drawn(guard_of, rate, reading, 60)
    assert any(item.over_k > 0.1 or item.peak > SETTINGS.limit for item in attempts)


@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_what_came_near_is_tried_again_nearer_by(optimiser):
    """Of courses that are that are the nearer the more their genes are alike: twice as near as by draws alone."""
    proposals, aim = OPTIMISERS[optimiser](12, np.random.default_rng(3)), np.linspace(0.1, 0.9, 12)
    genes, apart = next(proposals), []
    for _ in range(600):
        assert genes.shape == (12,)
        assert ((genes >= 0.0) & (genes < 1.0)).all()
        apart.append(float(np.sqrt(np.mean((genes - aim) ** 2))))
        genes = proposals.send(Attempt("only", genes, -apart[-1], 0.0, tripped=False))
    drawn = np.sqrt(np.mean((np.random.default_rng(4).random((600, 12)) - aim) ** 2, axis=1)).min()
    assert min(apart) < 0.5 * drawn


def test_a_course_that_warms_nothing_ends_no_search():
    proposals = OPTIMISERS["cma"](6, np.random.default_rng(3))
    genes = next(proposals)
    for _ in range(300):
        genes = proposals.send(Attempt("only", genes, -math.inf, 0.0, tripped=False))
    assert genes.shape == (6,)


def test_an_optimiser_that_is_not_installed_says_how_it_is(monkeypatch):
    monkeypatch.setitem(sys.modules, "cma", None)
    with pytest.raises(InputError, match=r"optimiser 'cma' needs the package cma: pip install 'leactl\[cma\]'"):
        hunt("test", LEA, SETTINGS, 20.0, "true", 0.0, optimiser="cma")


@pytest.mark.long
def test_cma_finds_a_guard_that_stops_late():
    proposals = OPTIMISERS["cma"](GENES + len(PARAMETERS) + 1, np.random.default_rng(1))
    one, peaks = run_attempt(next(proposals), LEA, SETTINGS, 100.0, "true", StopsLate), []
    for _ in range(60):
        one = run_attempt(proposals.send(one), LEA, SETTINGS, 100.0, "true", StopsLate)
        peaks.append(one.peak)
    assert max(peaks) > SETTINGS.limit


def test_a_search_tells_what_it_found_and_whether_the_guard_held():
    held = hunt("test", LEA, SETTINGS, 20.0, "true", 0.0)
    assert (held.attempts, held.held(SETTINGS.limit)) == (1, True)
    assert not held.held(held.hottest.peak - 0.1)
