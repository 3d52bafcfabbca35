"""Search for a course and a plant in which a winding becomes hotter than its bound, or than the limit.

A trip ends a course, as it ends a run. The current then continues, with the rotor at its worst angle, for as long as a
drive continues without its host.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.model.motor import Motor
from leactl.runner.challenge.courses import GENES, ChallengeCourse, course
from leactl.runner.challenge.optimisers import OPTIMISERS
from leactl.runner.challenge.phases import PARAMETERS, Phases, mean_phasors
from leactl.safety.thermal.box import Box
from leactl.safety.thermal.guard import GuardSettings, ThermalGuard

Array = npt.NDArray[np.float64]
PLANT_STEP_S = 0.005  # step of the plant: a thousandth of the time that a winding takes to warm
COURSE_S = 8.0  # length of a course
WARM_SHARE = 0.2  # of the rise from the start to the limit: bound and plant are compared once the plant is as warm
START_SHARES = (0.0, 0.0, 0.6, 0.9)  # of the rise from ambient to the limit, at which a course may begin


@dataclass(frozen=True)
class Attempt:
    """Result of one course in one plant."""

    kind: str
    genes: Array
    over_k: float  # largest excess of any node over its bound; negative if the bound holds
    peak: float  # degC, of the hottest phase
    tripped: bool


@dataclass(frozen=True)
class SearchResult:
    """Result of a search on one motor at one rate."""

    role: str
    rate_hz: float
    reading: str
    attempts: int
    nearest: Attempt  # the attempt that came nearest to its bound, or farthest above it
    hottest: Attempt  # the attempt with the hottest phase

    def held(self, limit: float) -> bool:
        """Return whether no bound was below the truth and no winding above its limit."""
        return self.nearest.over_k <= 0.0 and self.hottest.peak <= limit


def hunt(
    role: str,
    motor: Motor,
    settings: GuardSettings,
    rate_hz: float,
    reading: str,
    seconds: float,
    seed: int = 0,
    guard_of: Callable[..., ThermalGuard] = ThermalGuard,
    optimiser: str = "changes",
) -> SearchResult:
    """Search for `seconds`, or for one attempt if it takes longer; return the nearest and the hottest attempt.

    Parameters
    ----------
    reading : one of `courses.READINGS`.
    guard_of : returns the guard that is challenged, from the arguments of `ThermalGuard`.
    optimiser : one of `optimisers.OPTIMISERS`.

    Raises
    ------
    InputError : the optimiser's package is not installed.
    """
    proposals = OPTIMISERS[optimiser](GENES + len(PARAMETERS) + 1, np.random.default_rng(seed))
    end_time = time.monotonic() + seconds
    nearest = hottest = attempt = run_attempt(next(proposals), motor, settings, rate_hz, reading, guard_of)
    count = 1
    while time.monotonic() < end_time:
        attempt = run_attempt(proposals.send(attempt), motor, settings, rate_hz, reading, guard_of)
        count += 1
        nearest = attempt if attempt.over_k > nearest.over_k else nearest
        hottest = attempt if attempt.peak > hottest.peak else hottest
    return SearchResult(role, rate_hz, reading, count, nearest, hottest)


def run_attempt(
    genes: Array,
    motor: Motor,
    settings: GuardSettings,
    rate_hz: float,
    reading: str,
    guard_of: Callable[..., ThermalGuard] = ThermalGuard,
) -> Attempt:
    """Simulate one course: in each cycle the guard limits the current and the plant heats; a trip ends the course.

    genes : those of the course, the shares of the plant's parameters, and that of the start, each from 0 to 1.
    """
    box = Box.of(motor)
    start = settings.ambient + START_SHARES[int(genes[-1] * len(START_SHARES))] * (settings.limit - settings.ambient)
    start += box.ambient_rise
    challenge = course(genes[:GENES], motor, settings, 1.0 / rate_hz, COURSE_S, reading)
    shares = np.rint(genes[GENES:-1]) if genes[5] > 0.2 else genes[GENES:-1]  # corners of the box are the hottest
    plant = Phases(box, shares, settings.ambient, start)
    guard = guard_of({"test": motor}, settings, {"test": np.full(3, start)})
    guard.begin(0.0)
    compared_from = start + WARM_SHARE * (settings.limit - start)
    largest_excess, peak = -math.inf, start
    currents, phasors = challenge.currents.copy(), mean_phasors(challenge, motor.pole_pairs)
    tripped = False
    for first, first_after in _plant_steps(challenge):
        for cycle in range(first, first_after):
            currents[cycle] = min(currents[cycle], guard.allowed["test"])
            square = float(currents[cycle]) ** 2
            motion = float(challenge.angles[cycle]), float(challenge.velocities[cycle])
            guard.logs[0] += (challenge.interval, square * challenge.interval, *motion)
            guard.flowing[0] = square
        now = first_after * challenge.interval
        plant.heat(
            currents[first:first_after] ** 2, phasors[first:first_after], (first_after - first) * challenge.interval
        )
        peak = max(peak, plant.hottest)
        if now < guard.due:
            continue
        tripped = bool(guard.check(now))
        bounds = guard.node_bounds["test"]
        if plant.hottest >= compared_from and guard.advanced == now:
            largest_excess = max(largest_excess, float(np.max(plant.nodes - bounds)))
        if tripped:  # a drive without its host continues with the last current, here at the worst angle
            plant.heat(currents[first_after - 1 : first_after] ** 2, plant.worst, settings.reserve_s)
            peak = max(peak, plant.hottest)
            break
    return Attempt(challenge.kind, genes, largest_excess, peak, tripped)


def _plant_steps(challenge: ChallengeCourse) -> Iterator[tuple[int, int]]:
    """Yield the first cycle of each step of the plant, and the first cycle after it."""
    count = max(1, round(PLANT_STEP_S / challenge.interval))
    for first in range(0, len(challenge.currents), count):
        yield first, min(first + count, len(challenge.currents))


def hunts(
    motors: Sequence[tuple[str, Motor]], rates_hz: Sequence[float], readings: Sequence[str]
) -> list[tuple[str, Motor, float, str]]:
    """Return role, motor, rate and reading of each search; a motor in two roles is searched once."""
    searched: list[tuple[str, Motor]] = []
    for role, motor in motors:
        if all(motor != other_motor for _, other_motor in searched):
            searched.append((role, motor))
    return [(*pair, rate, reading) for pair in searched for rate in rates_hz for reading in readings]
