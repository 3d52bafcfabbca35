"""The network of three phases: against closed forms, plain equations and the balance of energy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leactl.emulation.plant.parameters import ActuatorParameters, PhaseParameters, ThermalParameters
from leactl.emulation.plant.phases import PhaseNetwork, lead_squares, turning_squares
from leactl.emulation.plant.thermal import ExactThermalNetwork
from tests.emulation.five_nodes import AT_REST, EVEN, TWO_LEADS, capacitances, conductances, integrated, settled

LEA = ActuatorParameters()
angles = st.floats(-20.0, 20.0)


def held(p: ActuatorParameters, squares: np.ndarray, duration: float, step: float, ambient: float = 25.0) -> np.ndarray:
    """Phases and housing [degC] after squares of the phase currents [A^2] held for a duration."""
    network = PhaseNetwork([p], [ambient])
    for _ in range(round(duration / step)):
        network.step(step, squares[:, None])
    return np.append(network.temperatures[:, 0], network.housing)


# ---------------------------------------------------------------- currents


@given(start=angles, turn=st.floats(-30.0, 30.0) | st.floats(-1e-6, 1e-6))
def test_mean_squares_are_those_of_the_phase_currents(start, turn):
    theta = start + turn * (np.arange(20000) + 0.5) / 20000
    expected = [(2.0 / 3.0 * 49.0 * np.cos(theta - k * 2.0 * math.pi / 3.0) ** 2).mean() for k in range(3)]
    result = turning_squares(np.array([49.0]), np.array([start]), np.array([start + turn]))[:, 0]
    np.testing.assert_allclose(result, expected, atol=1e-4)
    assert result.sum() == pytest.approx(49.0)


def test_half_an_electrical_turn_a_step_is_no_standstill():
    squares = turning_squares(np.full(3, 9.0), np.arange(3) * math.pi, (1 + np.arange(3)) * math.pi)
    np.testing.assert_allclose(squares, 3.0, atol=1e-12)


def test_at_rest_one_phase_takes_two_thirds_and_two_leads_a_whole_each():
    at_rest = turning_squares(np.array([9.0]), np.zeros(1), np.zeros(1))[:, 0]
    np.testing.assert_allclose(at_rest, 9.0 * AT_REST)
    np.testing.assert_allclose(lead_squares(np.array([9.0]))[:, 0], 9.0 * TWO_LEADS)


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("offset", [0.0, 0.4, math.pi / 6, 2.0])
def test_at_rest_it_settles_at_the_closed_form(offset):
    squares = turning_squares(np.array([13.7**2]), np.array([offset]), np.array([offset]))[:, 0]
    np.testing.assert_allclose(held(LEA, squares, 40000.0, 1.0), settled(LEA, squares), atol=1e-6)


def test_direct_current_through_two_leads_settles_at_the_closed_form():
    result = held(LEA, 81.0 * TWO_LEADS, 40000.0, 1.0)
    np.testing.assert_allclose(result, settled(LEA, 81.0 * TWO_LEADS), atol=1e-6)
    assert result == pytest.approx([120.52, 120.52, 95.28, 99.04], abs=0.01)  # 9 A, the paper's heating


@pytest.mark.parametrize("coefficient", [0.0, 0.004])
def test_three_equal_phases_are_the_winding_of_two_nodes(coefficient):
    p = replace(LEA, resistance_coefficient=coefficient)
    two = ExactThermalNetwork(p.thermal, 25.0)
    for _ in range(60000):
        two.step(0.01, p.resistance(two.winding) * 400.0)
    phases = held(p, 400.0 * EVEN, 600.0, 0.01)
    # the two nodes have their resistance from a step's start: 0.01 s of 0.08 K/s late
    np.testing.assert_allclose(phases, [two.winding] * 3 + [two.housing], atol=5e-3)


# ---------------------------------------------------------------- the figures of the design


def test_the_continuous_current_of_two_nodes_held_at_rest_ends_near_155_celsius():
    assert settled(LEA, 13.7**2 * EVEN)[0] == pytest.approx(128.3, abs=0.5)
    assert held(LEA, 13.7**2 * AT_REST, 20000.0, 0.5)[0] == pytest.approx(155.0, abs=1.0)


def test_the_20_s_peak_of_two_nodes_held_at_rest_ends_near_314_celsius():
    # 32 A is 32.11 A rounded: 130 degC after 20 s by two nodes, 15.7 N*m; 0.1 A is 3.6 K
    assert held(LEA, 32.114**2 * EVEN, 20.0, 0.01)[0] == pytest.approx(130.0, abs=0.01)
    assert held(LEA, 32.114**2 * AT_REST, 20.0, 0.01)[0] == pytest.approx(314.34, abs=0.02)
    assert held(LEA, 32.0**2 * AT_REST, 20.0, 0.01)[0] == pytest.approx(310.73, abs=0.02)


# ---------------------------------------------------------------- time


@pytest.mark.parametrize(
    "phases",
    [
        PhaseParameters(),
        PhaseParameters(fixture_capacitance=300.0, fixture_resistance=0.8),
        PhaseParameters(blocked_air_factor=5.0, blocked_air_from=40.0),
        PhaseParameters(30.0, 150.0, 0.5, 0.3, 25.0),
    ],
    ids=["plain", "fixture", "blocked air", "fixture and fan"],
)
def test_follows_the_plain_equations(phases):
    p = replace(LEA, phases=phases)
    network, found, times = PhaseNetwork([p], [35.0]), [], np.arange(1, 121)
    level = lambda time: (900.0 if time % 30.0 < 10.0 else 50.0) * np.array([0.6, 0.3, 0.1])  # noqa: E731
    for k in range(12000):
        network.step(0.01, level(k * 0.01)[:, None], np.array([12.0]))
        if (k + 1) % 100 == 0:
            found.append([*network.temperatures[:, 0], network.housing[0], network.fixture[0]])
    expected = integrated(p, level, times, lambda _time: 12.0, 35.0)
    np.testing.assert_allclose(found, expected, atol=0.02)


def test_error_of_the_resistance_goes_with_the_square_of_the_step():
    exact = integrated(LEA, lambda _time: 1024.0 * AT_REST, [20.0])[0, 0]
    errors = [held(LEA, 1024.0 * AT_REST, 20.0, step)[0] - exact for step in (0.2, 0.1, 0.05)]
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.5)
    assert errors[1] / errors[2] == pytest.approx(4.0, abs=0.5)
    assert abs(errors[2]) < 0.02


def test_without_current_one_long_step_is_as_good_as_many():
    long, short = (PhaseNetwork([LEA], [25.0]) for _ in range(2))
    for network, rest in ((long, [300.0]), (short, [0.5] * 600)):
        for _ in range(100):
            network.step(0.05, 500.0 * AT_REST[:, None])
        for duration in rest:
            network.step(duration, np.zeros((3, 1)))
    np.testing.assert_allclose(long.temperatures, short.temperatures, atol=1e-9)
    assert long.housing == pytest.approx(short.housing, abs=1e-9)


# ---------------------------------------------------------------- energy

thermals = st.builds(
    ThermalParameters,
    winding_ambient_resistance=st.floats(1.0, 1000.0),
    winding_housing_resistance=st.floats(0.05, 5.0),
    housing_ambient_resistance=st.floats(0.2, 10.0),
    winding_capacitance=st.floats(3.0, 100.0),
    housing_capacitance=st.floats(50.0, 2000.0),
)
fixtures = st.builds(
    PhaseParameters, fixture_capacitance=st.just(0.0) | st.floats(20.0, 2000.0), fixture_resistance=st.floats(0.2, 20.0)
)


@given(
    thermal=thermals,
    phases=fixtures,
    coefficient=st.floats(0.0, 0.005),
    ambient=st.floats(-20.0, 50.0),
    levels=st.lists(st.tuples(*[st.floats(0.0, 100.0)] * 3, st.floats(0.0, 30.0)), min_size=1, max_size=4),
)
def test_heat_in_is_heat_out_and_heat_stored(thermal, phases, coefficient, ambient, levels):
    p = replace(LEA, thermal=thermal, phases=phases, resistance_coefficient=coefficient)
    network = PhaseNetwork([p], [ambient])
    fastest = max(np.diag(conductances(p)) / capacitances(p))  # 1/s
    step, to_ambient = 0.05 / fastest, conductances(p).sum(axis=0)
    nodes = lambda: np.array([*network.temperatures[:, 0], network.housing[0], network.fixture[0]]) - ambient  # noqa: E731
    heat_in = heat_out = 0.0
    for *squares, housing_heat in levels:
        for _ in range(100):
            resistances, rises = network.resistances[:, 0], nodes()
            network.step(step, np.array(squares)[:, None], np.array([housing_heat]))
            heat_in += step * (0.5 * (resistances + network.resistances[:, 0]) @ squares + housing_heat)
            heat_out += step * float(to_ambient @ (0.5 * (rises + nodes())))
    stored = float(capacitances(p) @ nodes())
    assert heat_out + stored == pytest.approx(heat_in, rel=2e-3, abs=1e-6)
