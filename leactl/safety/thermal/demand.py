"""Currents and speeds that a plan demands of the drives, action by action, and upper bounds where none is planned.

The current of a drive that follows a speed or an angle is bounded by friction, inertia and the torque of the other
drive. Where a current is planned, the speed may be anything from zero up to the limit of the bench.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leactl.driver.contract import Mode
from leactl.model.motor import Motor
from leactl.protocol.plan import (
    Action,
    Constant,
    Engage,
    Plan,
    Samples,
    Segment,
    SetpointProfile,
    SetSupply,
    SoughtSetpoint,
    Tare,
)
from leactl.safety.limits import LEADS
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.guard import GuardSettings

TURNING_RAD_S = 0.1  # planned speed from which a rotor surely turns in the planned direction
CURRENT_MODES = (Mode.CURRENT, Mode.TORQUE_PROFILE)


@dataclass(frozen=True)
class PlanState:
    """One action of a plan with the modes and setpoints that hold during it."""

    name: str
    duration: float
    modes: Mapping[str, Mode]
    setpoints: Mapping[str, SetpointProfile]
    leads: Mapping[str, float]  # A, through two leads of a role
    shortest: float  # s, after which the action may end: its duration, or less where it ends by a criterion

    @property
    def constant(self) -> bool:
        """Whether no setpoint changes during the action; one that is still sought counts as constant."""
        return all(
            isinstance(profile, SoughtSetpoint) or profile.low == profile.high for profile in self.setpoints.values()
        )

    @property
    def ends(self) -> "list[PlanState]":
        """The state at each combination of ends of the setpoints that are still sought; itself where none is."""
        sought = {role: profile for role, profile in self.setpoints.items() if isinstance(profile, SoughtSetpoint)}
        if not sought:
            return [self]
        chosen = itertools.product(*((Constant(profile.low), Constant(profile.high)) for profile in sought.values()))
        return [replace(self, setpoints={**self.setpoints, **dict(zip(sought, ends, strict=True))}) for ends in chosen]

    @property
    def listed(self) -> bool:
        """Whether any setpoint is a list."""
        return any(isinstance(profile, Samples) for profile in self.setpoints.values())


def states(plan: Plan) -> Iterator[PlanState]:
    """Yield the state of every action of a plan.

    Waits for a person or a reading last 0 s here; the guard watches them.
    """
    modes: dict[str, Mode] = {}
    setpoints: dict[str, SetpointProfile] = {}
    leads: dict[str, float] = {}
    for action in plan.actions:
        name, duration = _name_and_duration(plan, action)
        if isinstance(action, Engage):
            modes |= action.modes
            setpoints |= dict.fromkeys(action.modes, Constant(0.0))
        if isinstance(action, Segment):
            setpoints |= action.setpoints
        if isinstance(action, SetSupply):
            leads |= {role: output[1] if output else 0.0 for role, output in action.outputs.items()}
        shortest = duration
        if isinstance(action, Segment) and action.until is not None:
            shortest = min(duration, action.settle_s + action.until.window_s)
        yield PlanState(
            name,
            duration,
            dict(modes),
            dict(setpoints),
            {role: current for role, current in leads.items() if current},
            shortest,
        )
        if isinstance(action, Segment):
            setpoints |= {
                role: profile if isinstance(profile, SoughtSetpoint) else Constant(profile.at(action.duration_s))
                for role, profile in action.setpoints.items()
            }


def _name_and_duration(plan: Plan, action: Action) -> tuple[str, float]:
    if isinstance(action, Segment):
        return action.name, action.duration_s
    return type(action).__name__.lower(), action.samples / plan.rate_Hz if isinstance(action, Tare) else 0.0


@dataclass(frozen=True)
class HeldTorque:
    """Bounds of the torque with which a drive holds its shaft [N*m], and the setpoint of that drive."""

    low: float
    high: float
    setpoint: float

    def strained(self, balance: float, least: float, most: float) -> "HeldTorque":
        """Return the bounds for a shaft at rest.

        The torque stays constant while friction can carry its difference from `balance`, and where friction cannot, it
        follows `balance` at the distance that friction carries.

        Parameters
        ----------
        balance : torque that balances the other drive [N*m].
        least, most : lowest and highest torque that friction may carry [N*m].
        """
        low = min(balance + least, max(self.low, balance - most))
        high = max(balance - least, min(self.high, balance + most))
        return HeldTorque(low, high, self.setpoint)

    def joined(self, alternative: "HeldTorque") -> "HeldTorque":
        """Return bounds that hold for either of two torques; infinite ones where their setpoints differ."""
        if self.setpoint != alternative.setpoint:
            return HeldTorque(-math.inf, math.inf, self.setpoint)
        return HeldTorque(min(self.low, alternative.low), max(self.high, alternative.high), self.setpoint)


def either(first: Mapping[int, HeldTorque], second: Mapping[int, HeldTorque]) -> dict[int, HeldTorque]:
    """Return bounds by role index that hold after either of two courses; infinite for a role of one course alone."""
    both = {index: first[index].joined(second[index]) for index in first.keys() & second.keys()}
    union = {**second, **first}
    return {index: both.get(index, HeldTorque(-math.inf, math.inf, torque.setpoint)) for index, torque in union.items()}


class Demand:
    """Currents and speeds that a plan demands of all actuators of a bench, from one moment to the next."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings) -> None:
        self._motors, self._settings, self._roles = dict(motors), settings, tuple(motors)
        self.held: Mapping[int, HeldTorque] = {}  # by index of the role, at the latest moment of `heats`

    def heats(self, plan: Plan, state: PlanState, at: Sequence[float]) -> tuple[Array, Array, Array]:
        """Return the heat and motion of all roles at the moments `at` [s] of an action, and remember held torques.

        Square currents [A^2], shape (roles, moments); lowest electrical speeds and highest speeds [rad/s], shape
        (roles,). The next call continues from the last of these moments.
        """
        squares, turned, speeds, self.held = self._worst_demand(plan, state, at)
        return squares, turned, speeds

    def squares(self, plan: Plan, state: PlanState, at: Sequence[float]) -> tuple[Array, Array, Array]:
        """Return the same as `heats` for moments ahead; held torques stay as they are."""
        return self._worst_demand(plan, state, at)[:3]

    def _worst_demand(
        self, plan: Plan, state: PlanState, at: Sequence[float]
    ) -> tuple[Array, Array, Array, dict[int, HeldTorque]]:
        """Return square currents, lowest and highest speeds and held torques, the worst over all ends of the state.

        No setpoint between the ends demands more: the current of its role is largest at one end, and the bounds of the
        torque that another drive holds against it rise with it.
        """
        courses = [self._demand_at(plan, end, at) for end in state.ends]
        squares, turned, speeds, held = courses[0]
        for course in courses[1:]:
            squares, speeds = np.maximum(squares, course[0]), np.maximum(speeds, course[2])
            turned, held = np.minimum(turned, course[1]), either(held, course[3])
        return squares, turned, speeds, held

    def _demand_at(
        self, plan: Plan, state: PlanState, at: Sequence[float]
    ) -> tuple[Array, Array, Array, dict[int, HeldTorque]]:
        """Return the same as `_worst_demand` for a state whose setpoints are all known."""
        currents, most = np.zeros((len(self._roles), len(at))), self._settings.most_current
        speeds, lowest_speeds = self._speeds(plan, state, at)
        accelerations = self._accelerations(plan, state, at)
        held: dict[int, HeldTorque] = {}
        for index, role in enumerate(self._roles):
            if state.modes.get(role) in CURRENT_MODES:
                currents[index] = [state.setpoints[role].at(time) for time in at]
        squares = currents**2
        for index, role in enumerate(self._roles):
            if state.modes.get(role) in (Mode.VELOCITY, Mode.ANGLE):
                torques, held[index] = self._held_torques(plan, state, index, currents, at, speeds, accelerations)
                demanded = torques / self._motors[role].torque_constant
                currents[index] = np.minimum(demanded, most)
                # a current above the limit is limited and lasts longer, for the same impulse
                stretched = demanded * currents[index]
                squares[index] = stretched * most**2 / max(most**2, float(np.mean(stretched)))
            if role in state.leads:  # a heated set-up has no drive beside the supply
                squares[index] = LEADS * state.leads[role] ** 2
        turned = np.array([self._motors[role].pole_pairs for role in self._roles]) * lowest_speeds
        return squares, turned, speeds, held

    def _held_torques(
        self,
        plan: Plan,
        state: PlanState,
        held_index: int,
        currents: Array,
        at: Sequence[float],
        speeds: Array,
        accelerations: Array,
    ) -> tuple[Array, HeldTorque]:
        """Bound the torque of a drive that follows a speed or an angle [N*m], at each moment and at the last one.

        The torque balances the other drive, friction and inertia. Friction helps against a torque that drives the shaft
        onward, and adds to one that drives it back. A shaft that hardly turns may stick in either direction; a shaft at
        rest keeps its held torque until the torque of the other drive overcomes friction.
        """
        mode, profile = state.modes[self._roles[held_index]], state.setpoints[self._roles[held_index]]
        setpoints = np.array([profile.at(time) for time in at])
        velocities = setpoints if mode is Mode.VELOCITY else np.zeros(len(setpoints))
        most = 0.0
        least, driving, inertia = (np.zeros(len(setpoints)) for _ in range(3))
        for index, role in enumerate(self._roles):
            if index == held_index or plan.setup == "coupled":
                motor, box = self._motors[role], Box.of(self._motors[role])
                least += box.coulomb_friction.low + box.viscous_damping.low * np.abs(velocities)
                most += box.coulomb_friction.high + box.viscous_damping.high * speeds[index]
                inertia += motor.rotor_inertia * accelerations[held_index]
                if index != held_index:
                    driving += motor.torque_constant * currents[index]
        turning = np.sign(velocities) * (np.abs(velocities) >= TURNING_RAD_S)
        resting = velocities == 0.0 if mode is Mode.VELOCITY else np.full(len(setpoints), profile.low == profile.high)
        held = self.held.get(held_index, HeldTorque(-most, most, 0.0))  # a drive engages with zero current
        if mode is Mode.ANGLE and held.setpoint != setpoints[0]:
            held = HeldTorque(-math.inf, math.inf, setpoints[0])
        torques = np.empty(len(setpoints))
        for moment, (balance, carried) in enumerate(zip((-driving).tolist(), least.tolist(), strict=True)):
            if turning[moment]:
                ends = balance + turning[moment] * carried, balance + turning[moment] * most
                held = HeldTorque(min(ends), max(ends), setpoints[moment])
            elif resting[moment]:
                held = held.strained(balance, carried, most)
            else:
                held = HeldTorque(balance - most, balance + most, setpoints[moment])
            torques[moment] = max(abs(held.low), abs(held.high))
        return torques + inertia, held

    def _speeds(self, plan: Plan, state: PlanState, at: Sequence[float]) -> tuple[Array, Array]:
        """Return the highest and the lowest speed of each role in these moments [rad/s], shape (roles,) each."""
        count = len(self._roles)
        if plan.setup in ("locked", "heated"):
            return np.zeros(count), np.zeros(count)
        most, least = np.zeros(count), np.zeros(count)
        for index, role in enumerate(self._roles):
            mode = state.modes.get(role)
            if mode is Mode.VELOCITY:
                setpoints = [abs(state.setpoints[role].at(time)) for time in at]
                most[index], least[index] = max(setpoints), min(setpoints)
            elif mode is Mode.ANGLE:
                setpoints = [state.setpoints[role].at(time) for time in at]
                most[index] = float(np.max(np.abs(np.diff(setpoints)))) / (at[1] - at[0]) if len(at) > 1 else 0.0
            elif mode in CURRENT_MODES:
                most[index] = self._settings.most_speed
        if plan.setup == "coupled":
            followers = [
                index for index, role in enumerate(self._roles) if state.modes.get(role) in (Mode.VELOCITY, Mode.ANGLE)
            ]
            most[:], least[:] = (most[followers[0]], least[followers[0]]) if followers else (most.max(), 0.0)
        return most, least

    def _accelerations(self, plan: Plan, state: PlanState, at: Sequence[float]) -> Array:
        """Return the acceleration of each role at each moment [rad/s^2], shape (roles, moments).

        0 unless the role follows a speed or a list of angles; a jump of a setpoint between two actions adds none.
        """
        accelerations = np.zeros((len(self._roles), len(at)))
        if len(at) < 2 or plan.setup in ("locked", "heated"):
            return accelerations
        for index, role in enumerate(self._roles):
            mode, profile = state.modes.get(role), state.setpoints.get(role)
            if profile is not None and (mode is Mode.VELOCITY or (mode is Mode.ANGLE and isinstance(profile, Samples))):
                order = 1 if mode is Mode.VELOCITY else 2
                spacing = profile.period if isinstance(profile, Samples) else at[1] - at[0]
                setpoints = [profile.at(time) for time in np.arange(at[0], at[-1] + (order + 0.5) * spacing, spacing)]
                changes = np.abs(np.diff(setpoints, order)) / spacing**order
                accelerations[index] = changes[((np.asarray(at) - at[0]) / spacing + 1e-6).astype(np.int64)]
        return accelerations
