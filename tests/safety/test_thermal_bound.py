"""The bound of the winding's temperature against plants anywhere inside the box, and against the box's exact worst."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from leactl.errors import InputError
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.temperature_bound import ThermalBound, delay_bound, inflow
from leactl.safety.thermal.turning import Rotor
from tests.safety.phases import LEA, STEP_S, Plant, advance, follow

GUARD_S = 0.1
FINE = round(GUARD_S / STEP_S)
ONE = np.ones(1)


def bounded(currents, speeds, box=None, start=28.0):
    """Bounds at the end of every guard's step, shape (3, n)."""
    bound, rotor = ThermalBound([box or Box.of(LEA)], start), Rotor(LEA, 40.0, 0.0)
    angles = np.cumsum(speeds * STEP_S)
    results = []
    for begin in range(0, len(currents) - FINE + 1, FINE):
        part = slice(begin, begin + FINE)
        log = np.stack([np.full(FINE, STEP_S), currents[part] ** 2 * STEP_S, angles[part], speeds[part]], axis=1)
        span = rotor.span(log, GUARD_S)
        fastest = np.max(np.abs(speeds[part])) * ONE
        heats = span.square / GUARD_S * ONE, span.aligned * ONE, fastest
        bound.step(GUARD_S, *heats, 25.0, span.delay(bound.decay_s) * ONE)
        results.append(bound.nodes()[:, 0])
    return np.array(results).T


corner = st.sampled_from([-1.0, 1.0]) | st.floats(-1.0, 1.0)
course = st.lists(
    st.tuples(
        st.integers(1, 30 * FINE),  # fine steps: the guard's see currents change in their midst
        st.sampled_from([0.0, 8.0, 13.0, 20.0, 30.0]),
        st.sampled_from([0.0, 0.02, 0.3, 2.0, 12.0, 31.0]),
    ),
    min_size=1,
    max_size=5,
)


@settings(max_examples=40)
@given(places=st.tuples(*[corner] * 11), offset=st.floats(0.0, np.pi), course=course)
def test_no_plant_of_the_box_is_hotter_than_its_bound(places, offset, course):
    currents = np.concatenate([np.full(n, i) for n, i, _ in course])
    speeds = np.concatenate([np.full(n, w) for n, _, w in course])
    true = follow(Plant.inside(places, offset), currents, speeds)[:, FINE::FINE]
    bound = bounded(currents, speeds)
    assert np.all(true <= bound + 1e-6)


@given(
    duration=st.floats(0.01, 0.5),
    rate=st.floats(0.01, 0.4),
    heat=st.lists(st.floats(0.0, 30.0), min_size=2, max_size=40).filter(lambda heat: max(heat) > 0.1),
)
def test_heat_that_comes_late_leaves_no_more_behind_than_its_lateness_says(duration, rate, heat):
    """Any heat that is even within equal parts against an even one, both as they decay until the end of the step."""
    at = np.linspace(0.0, duration, len(heat) + 1)
    edges = np.exp(-rate * (duration - at))
    left, even = np.dot(np.diff(edges), heat) / np.diff(at)[0], (1.0 - edges[0]) / duration * np.sum(heat)
    behind = np.average(0.5 * (at[1:] + at[:-1]), weights=heat) - 0.5 * duration
    late = delay_bound(max(behind, 0.0), duration, 0.0, 1.0 / rate)
    assert left <= even * (1.0 + rate * late) * (1.0 + 1e-9)
    assert late <= duration


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_plant_that_wanders_through_its_box_stays_below_as_well(seed):
    draw = np.random.default_rng(seed)
    currents = np.repeat(draw.uniform(0.0, 25.0, 12), 2 * FINE)
    speeds = np.repeat(draw.uniform(-3.0, 3.0, 12), 2 * FINE)
    # what leads from winding to housing stays as it is: cells are bounded one by one
    fixed = draw.uniform(-1.0, 1.0)
    state, angle, true = None, 0.0, []
    for k, (current, speed) in enumerate(zip(currents, speeds, strict=True)):
        places = draw.choice([-1.0, 1.0], 11)
        places[3] = fixed
        plant = Plant.inside(places, 0.3)
        state = np.full(4, 28.0) if state is None else state
        state = advance(plant, state, current, angle, speed)
        angle += speed * STEP_S
        if (k + 1) % FINE == 0:
            true.append((state[:3].max(), state[:3].mean(), state[3]))
    over = bounded(currents, speeds) - np.array(true).T
    assert np.min(over) > -1e-6


def settled(box, current, aligned, speed):
    bound = ThermalBound([box], 25.0)
    bound.settle(current**2 * ONE, aligned * ONE, speed * ONE, 25.0)
    return min(float(bound.hottest()[0]), 1e6)


def continuous(box, aligned, speed):
    return brentq(lambda i: settled(box, i, aligned, speed) - 130.0, 1.0, 40.0, xtol=1e-6)


def worst_continuous(aligned, speed):
    """Of all plants with constant parameters: the least current that holds one at 130 degC."""
    results = []
    for across, air in itertools.product(np.linspace(-1.0, 1.0, 21), (-1.0, 1.0)):
        p = Plant.inside((1.0, 1.0, air, across, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0))

        def hottest(current, p=p):
            square = (current * p.current_gain) ** 2
            shares = np.array([1.0 + aligned, 1.0 - aligned / 2.0, 1.0 - aligned / 2.0]) / 3.0
            to_housing, to_air = 1.0 / (3 * p.winding_housing_resistance), 1.0 / (3 * p.winding_ambient_resistance)
            warmer = shares * p.phase_resistance * square * p.resistance_coefficient
            cold = shares * p.phase_resistance * square * (1.0 - 25.0 * p.resistance_coefficient)
            matrix = np.diag([*(to_housing + to_air - warmer), 3 * to_housing + 1.0 / p.housing_ambient_resistance])
            matrix[:3, 3] = matrix[3, :3] = -to_housing
            friction = (p.coulomb_friction + p.viscous_damping * speed) * speed
            right = [*(to_air * p.ambient + cold), p.ambient / p.housing_ambient_resistance + friction]
            return float(np.linalg.solve(matrix, right).max())

        results.append(brentq(lambda i: hottest(i) - 130.0, 1.0, 14.0))
    return min(results)


@pytest.mark.parametrize(
    ("aligned", "speed", "expected"), [(0.0, 0.0, (13.7, 13.9)), (1.0, 0.0, (12.65, 12.75)), (0.0, 31.4, (10.95, 11.1))]
)
def test_continuous_current_of_the_lea_and_what_a_bound_takes_from_it(aligned, speed, expected):
    nominal, guarded = (continuous(box, aligned, speed) for box in (Box.exact(LEA), Box.of(LEA)))
    assert expected[0] < nominal < expected[1]
    assert guarded >= 0.98 * worst_continuous(aligned, speed)
    assert guarded <= worst_continuous(aligned, speed)
    if speed == 0.0:
        assert guarded >= 0.85 * nominal


def test_the_steps_of_the_guard_end_where_constant_heat_leads():
    current, far = 10.8, 40_000.0  # A, s
    bound = ThermalBound([Box.of(LEA)], 28.0)
    bound.settle(current**2 * ONE, ONE, 0.0 * ONE, 25.0)
    end = bound.hottest()[0]
    bound = ThermalBound([Box.of(LEA)], 28.0)
    bound.step(far, current**2 * ONE, ONE, 0.0 * ONE, 25.0, delay=0.0)
    for _ in range(3000):
        bound.step(GUARD_S, current**2 * ONE, ONE, 0.0 * ONE, 25.0)
    assert end <= bound.hottest()[0] < end + 2.0


@pytest.mark.parametrize("wrong", [{"squares": np.nan}, {"speeds": np.inf}, {"duration": -1.0}, {"ambient": np.nan}])
def test_what_is_no_number_leaves_no_promise(wrong):
    told = {"duration": 0.1, "squares": 1.0, "aligned": 1.0, "speeds": 0.0, "ambient": 25.0} | wrong
    bound = ThermalBound([Box.of(LEA)], 25.0)
    bound.step(told["duration"], told["squares"] * ONE, told["aligned"] * ONE, told["speeds"] * ONE, told["ambient"])
    assert bound.hottest()[0] == np.inf


def test_a_runaway_ends_and_leaves_the_next_actuator_alone():
    bound = ThermalBound([Box.of(LEA), Box.of(LEA)], 25.0)
    for _ in range(100):
        bound.step(2.0, np.array([1e6, 0.0]), np.ones(2), np.zeros(2), 25.0)
    assert bound.hottest()[0] > 9999.0
    assert 25.0 < bound.hottest()[1] <= 28.0


def test_a_motor_without_tolerances_gets_no_bound():
    with pytest.raises(InputError, match="no `tolerances:`"):
        Box.of(LEA.model_copy(update={"tolerances": None}))


def test_actuators_side_by_side_do_not_touch_each_other():
    both = ThermalBound([Box.of(LEA), Box.exact(LEA)], 25.0)
    alone = ThermalBound([Box.of(LEA)], 25.0)
    for _ in range(50):
        both.step(GUARD_S, np.array([400.0, 0.0]), np.ones(2), np.zeros(2), 25.0)
        alone.step(GUARD_S, 400.0 * ONE, ONE, 0.0 * ONE, 25.0)
    assert both.nodes()[:, 0] == pytest.approx(alone.nodes()[:, 0], abs=1e-9)
    assert both.nodes()[:, 1] == pytest.approx(25.0, abs=0.002)


temperature = st.floats(-40.0, 200.0)


@given(
    ends=st.tuples(temperature, temperature).map(sorted),
    source=temperature,
    conductances=st.tuples(st.floats(0.01, 10.0), st.floats(0.01, 10.0)).map(sorted),
    within=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
)
def test_no_conductance_lets_more_heat_in_than_the_line_of_the_worst(ends, source, conductances, within):
    (floor, ceiling), (low, high) = ends, conductances
    own, conductance = (a + share * (b - a) for share, (a, b) in zip(within, (ends, conductances), strict=True))
    constant, slope = inflow(*(np.array([each]) for each in (source, ceiling, floor, low, high)))
    assert constant - slope * own >= conductance * (source - own) - 1e-9
    if source >= ceiling:
        assert constant - slope * own == pytest.approx(high * (source - own), abs=1e-9)


@pytest.mark.parametrize("beside", [-40.0, 0.0, 60.0])
def test_a_winding_heats_by_the_resistance_that_is_the_highest_at_its_temperature(beside):
    box = Box.of(LEA)
    temperature, rise = box.reference_temperature + beside, box.resistance_coefficient
    warmth = 1.0 + max(rise.low * beside, rise.high * beside)
    heat = 2.0 * box.phase_resistance.high * warmth * 100.0 * box.current_gain**2
    bound = ThermalBound([box], temperature)  # as warm as the air: no heat flows
    fastest = bound.fastest_warming(100.0 * ONE, ONE, 0.0 * ONE, temperature - box.ambient_rise)
    assert fastest == pytest.approx(heat / box.winding_capacitance.low)


def test_heat_leaves_as_fast_as_it_does_from_the_fastest_winding():
    """What comes late is held against the shortest time constant, whichever actuator has it."""
    light = LEA.model_copy(update={"thermal": LEA.thermal.model_copy(update={"winding_capacitance": 5.0})})
    own = [ThermalBound([Box.of(motor)], 25.0).decay_s for motor in (LEA, light)]
    assert own[1] < own[0]
    for motors in ((LEA, light), (light, LEA)):
        assert ThermalBound([Box.of(motor) for motor in motors], 25.0).decay_s == own[1]


@given(tolerance=st.floats(0.0, 0.2), ambient=st.floats(-20.0, 40.0), air=st.floats(-3.0, 3.0))
def test_a_network_at_its_limit_whose_rises_lack_a_share_leaves_the_true_winding_at_its_limit_at_most(
    tolerance, ambient, air
):
    told = LEA.tolerances.model_copy(update={"temperature_rise": tolerance})
    box = Box.of(LEA.model_copy(update={"tolerances": told}))
    true_air = ambient + air
    assert true_air + (box.limit(200.0, ambient) - true_air) / (1.0 - tolerance) <= 130.0 + 1e-9
    assert Box.of(LEA).limit(200.0, ambient) == 130.0
    assert Box.of(LEA).limit(90.0, ambient) == 90.0
