"""A whole plan under the bound before anything moves: how hot each winding may become, where, and what wait would help.

Where a drive follows a speed or an angle its current is not planned; friction, inertia and the other drive's torque
bound it. Where a current is planned the speed may be anything up to the bench's limit, or none at all.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leactl.driver.contract import Mode
from leactl.model.motor import Motor
from leactl.protocol.plan import Action, Constant, Engage, Plan, Profile, Samples, Segment, Tare
from leactl.safety.thermal.bound import ThermalBound
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.guard import MARGIN_K, STEP_S, Budgets, GuardSettings

PARTS = 10  # samples of a step, where setpoints vary along a line
COARSE_K = 2.0  # that a node may rise by in one step, where they do not
LONGEST_S = 2.0
LEAST_S = 1e-6  # rounding of a sum of steps, which is no step of its own
MOST_WAIT_S = 4 * 3600.0
WAIT_ROUNDING_S = 5.0
CURRENT_MODES = (Mode.CURRENT, Mode.TORQUE_PROFILE)


@dataclass(frozen=True)
class Passing:
    """Where a plan would pass the limit."""

    action: int
    step: str
    time_s: float
    role: str


@dataclass(frozen=True)
class Forecast:
    """What a plan does to the windings."""

    peaks: Mapping[str, float]  # degC, of each role's hottest phase
    passing: Passing | None


class Foresight:
    """Plans on one bench, from one state of its windings."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings, start: Mapping[str, Array]) -> None:
        """Begin from bounds of hottest phase, mean of the phases and housing [degC] of each role.

        Raises
        ------
        InputError : a motor without tolerances.
        """
        self._motors, self._settings = dict(motors), settings
        self._roles = tuple(motors)
        boxes = [Box.of(motor) for motor in motors.values()]
        self._bound, self._budgets = ThermalBound(boxes, settings.ambient), Budgets(boxes, settings)
        self._bound.set(np.stack([start[role] for role in self._roles], axis=1))
        self._start = self._bound.state

    def forecast(self, plan: Plan) -> Forecast:
        """Follow a plan from its start until its end, or until a winding may pass its limit."""
        self._bound.state = self._start
        return self._follow(plan, _states(plan), 0.0)

    def with_waits(self, plan: Plan) -> tuple[Plan, Forecast]:
        """The plan with a wait wherever it would pass the limit and one can help; the forecast is of that plan.

        A wait stands before an action at which no current is asked for, as near as there is one before the hot step.
        """
        while True:
            found = self.forecast(plan)
            if found.passing is None:
                return plan, found
            longer = self._wait_before(plan, found.passing)
            if longer is None:
                return plan, found
            plan = longer

    def _wait_before(self, plan: Plan, passing: Passing) -> Plan | None:
        for place in range(passing.action, -1, -1):
            if not _at_rest(plan, place):
                continue
            waits = replace(plan, actions=(*plan.actions[:place], _wait(MOST_WAIT_S), *plan.actions[place:]))
            if not self._passes_later(waits, passing):
                continue
            low, high = 0.0, MOST_WAIT_S
            while high - low > WAIT_ROUNDING_S:
                middle = 0.5 * (low + high)
                tried = replace(plan, actions=(*plan.actions[:place], _wait(middle), *plan.actions[place:]))
                low, high = (low, middle) if self._passes_later(tried, passing) else (middle, high)
            seconds = math.ceil(high / WAIT_ROUNDING_S) * WAIT_ROUNDING_S
            return replace(plan, actions=(*plan.actions[:place], _wait(seconds), *plan.actions[place:]))
        return None

    def _passes_later(self, plan: Plan, before: Passing) -> bool:
        """Whether a plan that is longer by one action gets beyond the step that was too hot."""
        found = self.forecast(replace(plan, actions=plan.actions[: before.action + 2]))
        return found.passing is None

    def _follow(self, plan: Plan, states: Iterator["_State"], time: float) -> Forecast:
        peaks = dict(zip(self._roles, self._bound.hottest().tolist(), strict=True))
        limit = self._settings.limit - MARGIN_K
        for index, state in enumerate(states):
            for duration, squares, aligned, speeds in self._pieces(plan, state):
                before = self._bound.hottest().tolist()
                # no cooler than the guard, which knows no more than what has flowed since its last step
                share = (1.0 + aligned) * (1.0 + self._bound.unevenness(self._budgets.step(self._budgets.left(before))))
                self._bound.step(duration, squares, share - 1.0, speeds, self._settings.ambient, even=True)
                time += duration
                after = self._bound.hottest().tolist()
                for role, was, hottest in zip(self._roles, before, after, strict=True):
                    peaks[role] = max(peaks[role], hottest)
                    if not (hottest < limit or hottest < was):
                        return Forecast(peaks, Passing(index, state.name, time, role))
        return Forecast(peaks, None)

    def _pieces(self, plan: Plan, state: "_State") -> Iterator[tuple[float, Array, Array, Array]]:
        """Heat of one action, step by step."""
        time = 0.0
        while (left := state.duration - time) > LEAST_S:
            if state.constant:
                squares, aligned, speeds = self._heats(plan, state, [0.0], 0.0)
                rate = self._bound.fastest(squares, aligned, speeds, self._settings.ambient)
                step = min(left, LONGEST_S, max(COARSE_K / rate if rate > 0.0 else LONGEST_S, 0.01))
            else:
                step = min(left, STEP_S)
                # a list of setpoints is taken as the loop takes it: between its own samples anything may stand
                parts = max(PARTS, math.ceil(step * plan.rate_Hz - 1e-6)) if state.listed else PARTS
                at = [time + step * (k + 0.5) / parts for k in range(parts)]
                squares, aligned, speeds = self._heats(plan, state, at, step)
            yield step, squares, aligned, speeds
            time += step

    def _heats(self, plan: Plan, state: "_State", at: Sequence[float], step: float) -> tuple[Array, Array, Array]:
        """Mean square currents, how far each stands at one electrical angle, and speeds of all roles at the most."""
        currents = np.zeros((len(self._roles), len(at)))
        speeds, planned = self._speeds(plan, state, at)
        accelerations = self._accelerations(plan, state, at)
        for k, role in enumerate(self._roles):
            if state.modes.get(role) in CURRENT_MODES:
                currents[k] = [abs(state.setpoints[role].at(t)) for t in at]
        squares, most = np.mean(currents**2, axis=1), self._settings.most_current
        for k, role in enumerate(self._roles):
            if state.modes.get(role) in (Mode.VELOCITY, Mode.ANGLE):
                wanted = self._held_current(plan, role, k, currents, speeds, accelerations)
                # what asks for more than may flow takes the longer: the same impulse at the most that may
                squares[k] = min(float(np.mean(wanted * np.minimum(wanted, most))), most**2)
        turned = np.array([self._motors[role].pole_pairs for role in self._roles]) * planned * STEP_S
        aligned = 1.0 / np.maximum(turned, 1.0)  # |sin x / x|
        return squares, aligned, speeds

    def _held_current(
        self, plan: Plan, role: str, place: int, currents: Array, speeds: Array, accelerations: Array
    ) -> Array:
        """What a drive that follows a speed needs at the most: the other's torque, friction and inertia of both."""
        motor = self._motors[role]
        resisting = 0.0
        for k, other in enumerate(self._roles):
            if k == place or plan.setup == "coupled":
                box = Box.of(self._motors[other])
                resisting += box.coulomb_friction.high + box.viscous_damping.high * speeds[k]
                resisting += self._motors[other].rotor_inertia * accelerations[place]
        against = np.zeros(currents.shape[1])
        if plan.setup == "coupled":
            for k, other in enumerate(self._roles):
                if k != place:
                    against += self._motors[other].torque_constant * currents[k]
        return np.asarray((against + resisting) / motor.torque_constant, np.float64)

    def _speeds(self, plan: Plan, state: "_State", at: Sequence[float]) -> tuple[Array, Array]:
        """Of each role: the speed at the most, and the speed that it keeps at the least."""
        count = len(self._roles)
        if plan.setup in ("locked", "heated"):
            return np.zeros(count), np.zeros(count)
        most, least = np.zeros(count), np.zeros(count)
        for k, role in enumerate(self._roles):
            mode = state.modes.get(role)
            if mode is Mode.VELOCITY:
                told = [abs(state.setpoints[role].at(t)) for t in at]
                most[k], least[k] = max(told), min(told)
            elif mode is Mode.ANGLE:
                told = [state.setpoints[role].at(t) for t in at]
                most[k] = float(np.max(np.abs(np.diff(told)))) / (at[1] - at[0]) if len(at) > 1 else 0.0
            elif mode in CURRENT_MODES:
                most[k] = self._settings.most_speed
        if plan.setup == "coupled":
            led = [k for k, role in enumerate(self._roles) if state.modes.get(role) in (Mode.VELOCITY, Mode.ANGLE)]
            most[:], least[:] = (most[led[0]], least[led[0]]) if led else (most.max(), 0.0)
        return most, least

    def _accelerations(self, plan: Plan, state: "_State", at: Sequence[float]) -> Array:
        """Of each role at each time, where it follows a speed or listed angles; none where a setpoint jumps."""
        found = np.zeros((len(self._roles), len(at)))
        if len(at) < 2 or plan.setup in ("locked", "heated"):
            return found
        for k, role in enumerate(self._roles):
            mode, profile = state.modes.get(role), state.setpoints.get(role)
            if profile is not None and (mode is Mode.VELOCITY or (mode is Mode.ANGLE and isinstance(profile, Samples))):
                order = 1 if mode is Mode.VELOCITY else 2
                spacing = profile.period if isinstance(profile, Samples) else at[1] - at[0]
                told = [profile.at(t) for t in np.arange(at[0], at[-1] + (order + 0.5) * spacing, spacing)]
                changes = np.abs(np.diff(told, order)) / spacing**order
                found[k] = changes[((np.asarray(at) - at[0]) / spacing + 1e-6).astype(np.int64)]
        return found


@dataclass(frozen=True)
class _State:
    """One action with the modes and setpoints that hold in it."""

    name: str
    duration: float
    modes: Mapping[str, Mode]
    setpoints: Mapping[str, Profile]

    @property
    def constant(self) -> bool:
        """Whether every setpoint stays as it is."""
        return all(profile.low == profile.high for profile in self.setpoints.values())

    @property
    def listed(self) -> bool:
        """Whether any setpoint is a list."""
        return any(isinstance(profile, Samples) for profile in self.setpoints.values())


def _states(plan: Plan) -> Iterator[_State]:
    """Every action of a plan; waits for a person or a reading take no time here, the guard watches them."""
    modes: dict[str, Mode] = {}
    setpoints: dict[str, Profile] = {}
    for action in plan.actions:
        name, duration = _name_and_duration(plan, action)
        if isinstance(action, Engage):
            modes |= action.modes
            setpoints |= dict.fromkeys(action.modes, Constant(0.0))
        if isinstance(action, Segment):
            setpoints |= action.setpoints
        yield _State(name, duration, dict(modes), dict(setpoints))
        if isinstance(action, Segment):
            ended = {role: Constant(profile.at(action.duration_s)) for role, profile in action.setpoints.items()}
            setpoints |= ended


def _name_and_duration(plan: Plan, action: Action) -> tuple[str, float]:
    if isinstance(action, Segment):
        return action.name, action.duration_s
    return type(action).__name__.lower(), action.samples / plan.rate_Hz if isinstance(action, Tare) else 0.0


def _at_rest(plan: Plan, place: int) -> bool:
    """Whether no current is asked for, and no speed, as an action begins."""
    last = None
    for index, state in enumerate(_states(plan)):
        if index == place:
            break
        last = state
    if last is None:
        return True
    return all(
        last.modes.get(role, Mode.OFF) in (Mode.OFF, Mode.ANGLE) or profile.at(math.inf) == 0.0
        for role, profile in last.setpoints.items()
    )


def _wait(seconds: float) -> Segment:
    return Segment("cooldown", seconds, seconds, {}, {})
