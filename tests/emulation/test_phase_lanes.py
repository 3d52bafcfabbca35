"""Many lanes of heat at once: each lane on its own, against the network and against plain equations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from leactl.emulation.plant.parameters import ActuatorParameters, PhaseParameters, ThermalParameters
from leactl.emulation.plant.phase_lanes import PhaseLane, PhaseLanes
from leactl.errors import InputError
from tests.emulation.five_nodes import EVEN, TWO_LEADS, integrated, settled

LEA = ActuatorParameters()
CLOCK = 0.01  # s


def protocol(lanes: int, seconds: float, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Currents and velocities in levels of half a second, one column a lane."""
    random, levels = np.random.default_rng(seed), round(seconds / 0.5)
    current, velocity = random.uniform(-25.0, 25.0, (levels, lanes)), random.uniform(-30.0, 30.0, (levels, lanes))
    velocity[random.uniform(size=velocity.shape) < 0.5] = 0.0
    return np.repeat(current, 50, axis=0), np.repeat(velocity, 50, axis=0)


def varied(count: int) -> list[PhaseLane]:
    random = np.random.default_rng(8)
    results = []
    for k in range(count):
        own = random.uniform(0.7, 1.3, 5)
        thermal = ThermalParameters(5.6 * own[0], 0.3 * own[1], 1.7 * own[2], 22.9 * own[3], 469.1 * own[4])
        phases = PhaseParameters(k * 0.5, 100.0 * (k % 2), 1.0, 1.0 + k % 3, 5.0)
        actuator = replace(LEA, thermal=thermal, phases=phases)
        results.append(PhaseLane(actuator, ambient_temperature=20.0 + k, friction_heat=k % 4 > 0))
    return results


def test_a_lane_does_not_know_its_neighbours():
    lanes, (current, velocity) = varied(6), protocol(6, 20.0)
    together = PhaseLanes(lanes, CLOCK).run(current, velocity)
    for k, lane in enumerate(lanes):
        alone = PhaseLanes([lane], CLOCK).run(current[:, k : k + 1], velocity[:, k : k + 1])
        np.testing.assert_allclose(together[:, k], alone[:, 0], rtol=1e-12)


@pytest.mark.parametrize("place", range(6))
def test_a_lane_follows_the_plain_equations(place):
    lane, (current, velocity) = varied(6)[place], protocol(6, 12.0)
    i, w = current[:, place], velocity[:, place]
    p = lane.actuator
    turned = np.concatenate([[0.0], np.cumsum(w * CLOCK)])

    def squares(time: float) -> np.ndarray:
        at = min(int(time / CLOCK), len(i) - 1)
        theta = p.pole_pairs * (turned[at] + w[at] * (time - at * CLOCK)) + p.phases.commutation_offset
        return np.array([2.0 / 3.0 * (i[at] * math.cos(theta - k * 2.0 * math.pi / 3.0)) ** 2 for k in range(3)])

    def friction(time: float) -> float:
        speed = abs(w[min(int(time / CLOCK), len(i) - 1)])
        return (p.viscous_damping * speed + p.coulomb_friction) * speed if lane.friction_heat else 0.0

    result = PhaseLanes([lane], CLOCK).run(i[:, None], w[:, None])[:, 0]
    times = np.arange(1, 13) * 1.0
    expected = integrated(p, squares, times, friction, lane.ambient_temperature)[:, :3].max(axis=1)
    np.testing.assert_allclose(result[99::100], expected, atol=0.05)


def test_a_second_run_goes_on_where_the_first_ended():
    current, velocity = protocol(3, 10.0)
    whole = PhaseLanes(varied(3), CLOCK).run(current, velocity)
    lanes = PhaseLanes(varied(3), CLOCK)
    parts = [lanes.run(current[part], velocity[part]) for part in (slice(0, 333), slice(333, None))]
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-10)


def test_direct_current_heats_two_leads_and_turning_all_three():
    still = np.zeros((30000, 1))
    nine = np.full_like(still, 9.0)
    slow = PhaseLanes([PhaseLane(friction_heat=False)], 1.0)
    assert slow.run(still, still, nine)[-1, 0] == pytest.approx(settled(LEA, 81.0 * TWO_LEADS)[0], abs=1e-6)
    turning = PhaseLanes([PhaseLane()], 1.0)
    speed = 2.0 * math.pi * 40.0 / 41.0  # 40 electrical turns a second
    friction = (LEA.viscous_damping * speed + LEA.coulomb_friction) * speed
    expected = settled(LEA, 81.0 * EVEN, friction)
    assert turning.run(nine, np.full_like(still, speed))[-1, 0] == pytest.approx(expected[0], abs=1e-6)
    assert turning.network.housing[0] == pytest.approx(expected[3], abs=1e-6)


def test_a_misread_current_heats_with_the_square_of_its_factor():
    current, velocity = protocol(1, 10.0)
    misread = PhaseLanes([PhaseLane(current_factor=math.sqrt(1.5))], CLOCK).run(current, velocity)
    true = PhaseLanes([PhaseLane()], CLOCK).run(math.sqrt(1.5) * current, velocity)
    np.testing.assert_allclose(misread, true, rtol=1e-12)


def test_blocked_air_acts_from_its_moment_and_settles_at_its_resistance():
    blocked = replace(LEA, phases=PhaseParameters(blocked_air_factor=4.0, blocked_air_from=500.0))
    settles = replace(LEA, thermal=replace(LEA.thermal, housing_ambient_resistance=4.0 * 1.7))
    lanes = PhaseLanes([PhaseLane(LEA), PhaseLane(blocked)], 0.5)
    result = lanes.run(np.full((60000, 2), 7.0), np.zeros((60000, 2)))
    np.testing.assert_allclose(result[:1000, 0], result[:1000, 1], rtol=1e-12)
    assert result[1001, 1] > result[1001, 0]
    assert result[-1, 1] == pytest.approx(settled(settles, 49.0 * np.array([4.0, 1.0, 1.0]) / 6.0)[0], abs=1e-4)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"current_factor": 0.0}, "current_factor"),
        ({"ambient_temperature": math.nan}, "ambient_temperature"),
        ({"friction_heat": 1.0}, "friction_heat"),
    ],
)
def test_a_lane_that_is_none_is_refused(settings, named):
    with pytest.raises(InputError, match=named):
        PhaseLane(**settings)
