"""A whole plan under the bound before anything moves: how hot each winding may become, where, and what wait would help.

Where a drive follows a speed or an angle its current is not planned; friction, inertia and the other drive's torque
bound it. Where a current is planned the speed may be anything up to the bench's limit, or none at all.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from leactl.driver.contract import Mode
from leactl.model.motor import Motor
from leactl.protocol.plan import Action, Constant, Engage, Plan, Profile, Samples, Segment, Tare
from leactl.safety.thermal.bound import LONGEST_STEP_S, ThermalBound, lateness
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.guard import MARGIN_K, STEP_S, TURN_S, Budgets, GuardSettings

PARTS = 10  # samples of a step, where setpoints vary along a line
COARSE_K = 2.0  # that a node may rise by in one step, where they do not
LONGEST_S = 2.0
LEAST_S = 1e-6  # rounding of a sum of steps, which is no step of its own
MOST_WAIT_S = 4 * 3600.0
WAIT_ROUNDING_S = 5.0
FAST = 3.0  # rad of electrical angle in a step, from which on it shares its heat among the phases by itself
TURNING_RAD_S = 0.1  # from which on a rotor that is to turn does so one way
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
            for piece in self._pieces(plan, state):
                before = self._bound.hottest().tolist()
                heat = piece.squares, piece.aligned, piece.speeds
                self._bound.step(piece.duration, *heat, self._settings.ambient, piece.late)
                time += piece.duration
                after = self._bound.hottest().tolist()
                for role, was, hottest in zip(self._roles, before, after, strict=True):
                    peaks[role] = max(peaks[role], hottest)
                    if not (hottest < limit or hottest < was):
                        return Forecast(peaks, Passing(index, state.name, time, role))
        return Forecast(peaks, None)

    def _pieces(self, plan: Plan, state: "_State") -> Iterator["_Piece"]:
        """Heat of one action, step by step: no less than the guard will find, which takes steps of its own.

        The guard's steps around the ends of an action see its currents change, those in between do not.
        """
        time = 0.0
        while (left := state.duration - time) > LEAST_S:
            own = self._budgets.step(self._budgets.left(self._bound.hottest().tolist()))
            if state.constant:
                squares, turned, speeds = self._heats(plan, state, [0.0])
                aligned, late = self._shared(turned, own, np.ones((len(turned), round(LONGEST_STEP_S / own))))
                rate = self._bound.fastest(squares, aligned, speeds, self._settings.ambient)
                step = min(left, LONGEST_S, max(COARSE_K / rate if rate > 0.0 else LONGEST_S, 0.01))
                if time < own - LEAST_S or left <= own + LEAST_S:
                    step, aligned, late = min(step, own), _aligned(turned * own), np.full(len(aligned), own)
                else:
                    step = min(step, left - own)
            else:
                step = min(left, STEP_S)
                # a list of setpoints is taken as the loop takes it: between its own samples anything may stand
                parts = max(PARTS, math.ceil(step * plan.rate_Hz - 1e-6)) if state.listed else PARTS
                at = [time + step * (k + 0.5) / parts for k in range(parts)]
                squares, turned, speeds = self._heats(plan, state, at)
                aligned, late = _aligned(turned * STEP_S), np.full(len(squares), own)
                if left > own and np.any((turned * own < FAST) & (turned * LONGEST_STEP_S > 1.0)):
                    aligned, late = self._shared(turned, own, self._evenness(plan, state, time, own))
            yield _Piece(step, squares, aligned, speeds, late)
            time += step

    def _evenness(self, plan: Plan, state: "_State", time: float, own: float) -> Array:
        """Mean over largest square current of spans of 1, 2, .. guard's steps from a moment on, within the action."""
        count = int(min(LONGEST_STEP_S, state.duration - time) / own + LEAST_S)
        at = [time + 0.5 * own * k for k in range(2 * count + 1)]
        squares = self._currents(plan, state, at)[0] ** 2
        ends = range(3, 2 * count + 2, 2)
        most = np.stack([squares[:, :end].max(axis=1) for end in ends], axis=1)
        mean = np.stack([squares[:, :end].mean(axis=1) for end in ends], axis=1)
        return np.asarray(np.divide(mean, most, out=np.ones_like(mean), where=most > 0.0), np.float64)

    def _shared(self, turned: Array, own: float, evenness: Array) -> tuple[Array, Array]:
        """Alignments and latenesses over the span that serves best to bound each, of 1, 2, .. guard's steps."""
        best: list[tuple[float, float, float]] = []
        for speed, evens in zip(turned.tolist(), evenness.tolist(), strict=True):
            shares = [(own * (k + 1), 1.0 / max(speed * own * (k + 1), 1.0), even) for k, even in enumerate(evens)]
            found = [(share, lateness(span, even, share, TURN_S)) for span, share, even in shares]
            best.append(min(((1.0 + a) * (1.0 + late / self._bound.decay_s), a, late) for a, late in found))
        return np.array([one[1] for one in best]), np.array([one[2] for one in best])

    def _heats(self, plan: Plan, state: "_State", at: Sequence[float]) -> tuple[Array, Array, Array]:
        """Mean square currents, electrical speeds at the least [rad/s], and speeds at the most, of all roles."""
        currents, turned, speeds = self._currents(plan, state, at)
        return np.mean(currents**2, axis=1), turned, speeds

    def _currents(self, plan: Plan, state: "_State", at: Sequence[float]) -> tuple[Array, Array, Array]:
        """Currents at these moments, and both speeds as of `_heats`."""
        currents = np.zeros((len(self._roles), len(at)))
        speeds, planned = self._speeds(plan, state, at)
        accelerations = self._accelerations(plan, state, at)
        for k, role in enumerate(self._roles):
            if state.modes.get(role) in CURRENT_MODES:
                currents[k] = [state.setpoints[role].at(t) for t in at]
        for k, role in enumerate(self._roles):
            if (mode := state.modes.get(role)) in (Mode.VELOCITY, Mode.ANGLE):
                told = [state.setpoints[role].at(t) if mode is Mode.VELOCITY else 0.0 for t in at]
                held = self._held_current(plan, k, currents, np.array(told), speeds, accelerations)
                currents[k] = np.minimum(held, self._settings.most_current)
        turned = np.array([self._motors[role].pole_pairs for role in self._roles]) * planned
        return currents, turned, speeds

    def _held_current(
        self, plan: Plan, place: int, currents: Array, velocities: Array, speeds: Array, accelerations: Array
    ) -> Array:
        """What a drive that follows a speed needs at the most: the other's torque, friction and inertia of both.

        Friction helps to hold what drives a rotor onward and adds to what drives it back; one that hardly turns may
        stick either way.
        """
        most, inertia = 0.0, 0.0
        least, driving = np.zeros(currents.shape[1]), np.zeros(currents.shape[1])
        for k, role in enumerate(self._roles):
            if k == place or plan.setup == "coupled":
                motor, box = self._motors[role], Box.of(self._motors[role])
                least += box.coulomb_friction.low + box.viscous_damping.low * np.abs(velocities)
                most += box.coulomb_friction.high + box.viscous_damping.high * speeds[k]
                inertia += motor.rotor_inertia * accelerations[place]
                if k != place:
                    driving += motor.torque_constant * currents[k]
        onward = driving * np.sign(velocities)
        known = np.maximum(np.abs(onward - least), np.abs(onward - most))
        torque = np.where(np.abs(velocities) >= TURNING_RAD_S, known, np.abs(driving) + most)
        return np.asarray((torque + inertia) / self._motors[self._roles[place]].torque_constant, np.float64)

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
        """Of each role that follows a speed or listed angles; where a setpoint jumps none is planned."""
        found = np.zeros(len(self._roles))
        if len(at) < 2 or plan.setup in ("locked", "heated"):
            return found
        for k, role in enumerate(self._roles):
            mode, profile = state.modes.get(role), state.setpoints.get(role)
            if profile is not None and (mode is Mode.VELOCITY or (mode is Mode.ANGLE and isinstance(profile, Samples))):
                order = 1 if mode is Mode.VELOCITY else 2
                spacing = profile.period if isinstance(profile, Samples) else at[1] - at[0]
                told = [profile.at(t) for t in np.arange(at[0], at[-1] + (order + 0.5) * spacing, spacing)]
                found[k] = float(np.max(np.abs(np.diff(told, order)))) / spacing**order
        return found


class _Piece(NamedTuple):
    """Part of an action, and the heat in it: arguments of `ThermalBound.step`."""

    duration: float
    squares: Array
    aligned: Array
    speeds: Array
    late: Array


def _aligned(turned: Array) -> Array:
    """|sin x / x| at the most, of currents that turn evenly by 2 x rad of twice the electrical angle."""
    return np.asarray(1.0 / np.maximum(turned, 1.0), np.float64)


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
