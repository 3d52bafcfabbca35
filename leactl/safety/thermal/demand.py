"""Currents and speeds that a plan demands of the drives, action by action; unplanned ones are bounded from above.

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
    leads: Mapping[str, float]  # A, through two leads, by role
    shortest: float  # s, earliest end of the action: its duration, or less if a criterion may end it

    @property
    def constant(self) -> bool:
        """Whether no setpoint changes during the action; a setpoint that is still sought counts as constant."""
        return all(
            isinstance(profile, SoughtSetpoint) or profile.low == profile.high for profile in self.setpoints.values()
        )

    @property
    def end_states(self) -> "list[PlanState]":
        """The state at each combination of ends of the setpoints that are still sought; only this state if none is."""
        sought_profiles = {
            role: profile for role, profile in self.setpoints.items() if isinstance(profile, SoughtSetpoint)
        }
        if not sought_profiles:
            return [self]
        end_choices = itertools.product(
            *((Constant(profile.low), Constant(profile.high)) for profile in sought_profiles.values())
        )
        return [
            replace(self, setpoints={**self.setpoints, **dict(zip(sought_profiles, end_profiles, strict=True))})
            for end_profiles in end_choices
        ]

    @property
    def listed(self) -> bool:
        """Whether any setpoint is a list."""
        return any(isinstance(profile, Samples) for profile in self.setpoints.values())


def states(plan: Plan) -> Iterator[PlanState]:
    """Yield the state of every action of a plan.

    Waits for a person or a reading count as 0 s; the guard bounds the temperature during them.
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
    """Return the name of an action for a forecast, and its planned duration [s]."""
    if isinstance(action, Segment):
        return action.name, action.duration_s
    return type(action).__name__.lower(), action.samples / plan.rate_Hz if isinstance(action, Tare) else 0.0


@dataclass(frozen=True)
class HeldTorque:
    """Bounds of the torque with which a drive holds its shaft [N*m], and the setpoint of that drive."""

    low: float
    high: float
    setpoint: float

    def strained(self, balance: float, least_friction: float, most_friction: float) -> "HeldTorque":
        """Return the bounds for a shaft at rest.

        The torque stays constant while friction can carry its difference from `balance`; otherwise it follows `balance`
        at the distance that friction carries.

        Parameters
        ----------
        balance : torque that balances the other drive [N*m].
        least_friction, most_friction : torque that friction carries in any case, and at the most [N*m].
        """
        low = min(balance + least_friction, max(self.low, balance - most_friction))
        high = max(balance - least_friction, min(self.high, balance + most_friction))
        return HeldTorque(low, high, self.setpoint)

    def joined(self, alternative: "HeldTorque") -> "HeldTorque":
        """Return bounds that hold for either of two torques; infinite bounds if their setpoints differ."""
        if self.setpoint != alternative.setpoint:
            return HeldTorque(-math.inf, math.inf, self.setpoint)
        return HeldTorque(min(self.low, alternative.low), max(self.high, alternative.high), self.setpoint)


def held_after_either(first: Mapping[int, HeldTorque], second: Mapping[int, HeldTorque]) -> dict[int, HeldTorque]:
    """Return held torques by role index that hold after either of two courses; infinite if only one holds the role."""
    joined = {index: first[index].joined(second[index]) for index in first.keys() & second.keys()}
    union = {**second, **first}
    return {
        index: joined.get(index, HeldTorque(-math.inf, math.inf, torque.setpoint)) for index, torque in union.items()
    }


class Demand:
    """Currents and speeds that a plan demands of all actuators of a bench, from one moment to the next."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings) -> None:
        self._motors, self._settings, self._roles = dict(motors), settings, tuple(motors)
        self.held: Mapping[int, HeldTorque] = {}  # by index of the role, at the latest moment of `heats`

    def heats(self, plan: Plan, state: PlanState, times: Sequence[float]) -> tuple[Array, Array, Array]:
        """Return the heat and motion of all roles at `times` [s] from the beginning of an action.

        These are square currents [A^2], shape (roles, times), and lowest electrical speeds and highest speeds [rad/s],
        shape (roles,) each. Held torques are remembered: the next call continues from the last of these times.
        """
        squares, electrical_speeds, speeds, self.held = self._worst_demand(plan, state, times)
        return squares, electrical_speeds, speeds

    def squares(self, plan: Plan, state: PlanState, times: Sequence[float]) -> tuple[Array, Array, Array]:
        """Return the same as `heats` for times further ahead; held torques stay as they are."""
        return self._worst_demand(plan, state, times)[:3]

    def _worst_demand(
        self, plan: Plan, state: PlanState, times: Sequence[float]
    ) -> tuple[Array, Array, Array, dict[int, HeldTorque]]:
        """Return square currents, lowest electrical speeds, highest speeds and held torques, at the worst end state.

        No setpoint between the ends demands more: the current of its role is largest at one end, and the bounds of the
        torque that another drive holds against it rise with it.
        """
        courses = [self._demand_at(plan, end_state, times) for end_state in state.end_states]
        squares, electrical_speeds, speeds, held_torques = courses[0]
        for course in courses[1:]:
            squares, speeds = np.maximum(squares, course[0]), np.maximum(speeds, course[2])
            electrical_speeds, held_torques = (
                np.minimum(electrical_speeds, course[1]),
                held_after_either(held_torques, course[3]),
            )
        return squares, electrical_speeds, speeds, held_torques

    def _demand_at(
        self, plan: Plan, state: PlanState, times: Sequence[float]
    ) -> tuple[Array, Array, Array, dict[int, HeldTorque]]:
        """Return the same as `_worst_demand` for a state whose setpoints are all known."""
        currents, current_limit = np.zeros((len(self._roles), len(times))), self._settings.most_current
        speeds, lowest_speeds = self._speeds(plan, state, times)
        accelerations = self._accelerations(plan, state, times)
        held_torques: dict[int, HeldTorque] = {}
        for index, role in enumerate(self._roles):
            if state.modes.get(role) in CURRENT_MODES:
                currents[index] = [state.setpoints[role].at(time) for time in times]
        squares = currents**2
        for index, role in enumerate(self._roles):
            if state.modes.get(role) in (Mode.VELOCITY, Mode.ANGLE):
                torques, held_torques[index] = self._held_torques(
                    plan, state, index, currents, times, speeds, accelerations
                )
                demanded = torques / self._motors[role].torque_constant
                currents[index] = np.minimum(demanded, current_limit)
                # a drive limits a current above the limit, and the current then lasts longer for the same impulse
                stretched_squares = demanded * currents[index]
                squares[index] = (
                    stretched_squares * current_limit**2 / max(current_limit**2, float(np.mean(stretched_squares)))
                )
            if role in state.leads:  # a heated set-up has no drive beside the supply
                squares[index] = LEADS * state.leads[role] ** 2
        electrical_speeds = np.array([self._motors[role].pole_pairs for role in self._roles]) * lowest_speeds
        return squares, electrical_speeds, speeds, held_torques

    def _held_torques(
        self,
        plan: Plan,
        state: PlanState,
        held_index: int,
        currents: Array,
        times: Sequence[float],
        speeds: Array,
        accelerations: Array,
    ) -> tuple[Array, HeldTorque]:
        """Return upper bounds of the torque of a drive that follows a speed or an angle [N*m], and its held torque.

        The bounds have shape (times,); the held torque is that of the last time. The torque balances the other drive,
        friction and inertia. Friction helps against a torque that drives the shaft onward, and adds to a torque that
        drives it back. A shaft that hardly turns may stick in either direction; a shaft at rest keeps its held torque
        until the torque of the other drive overcomes friction.
        """
        mode, profile = state.modes[self._roles[held_index]], state.setpoints[self._roles[held_index]]
        setpoints = np.array([profile.at(time) for time in times])
        velocities = setpoints if mode is Mode.VELOCITY else np.zeros(len(setpoints))
        most_friction = 0.0
        least_friction, driving_torque, inertia = (np.zeros(len(setpoints)) for _ in range(3))
        for index, role in enumerate(self._roles):
            if index == held_index or plan.setup == "coupled":
                motor, box = self._motors[role], Box.of(self._motors[role])
                least_friction += box.coulomb_friction.low + box.viscous_damping.low * np.abs(velocities)
                most_friction += box.coulomb_friction.high + box.viscous_damping.high * speeds[index]
                inertia += motor.rotor_inertia * accelerations[held_index]
                if index != held_index:
                    driving_torque += motor.torque_constant * currents[index]
        turning_direction = np.sign(velocities) * (np.abs(velocities) >= TURNING_RAD_S)
        is_resting = (
            velocities == 0.0 if mode is Mode.VELOCITY else np.full(len(setpoints), profile.low == profile.high)
        )
        # a drive engages with zero current
        held_torque = self.held.get(held_index, HeldTorque(-most_friction, most_friction, 0.0))
        if mode is Mode.ANGLE and held_torque.setpoint != setpoints[0]:
            held_torque = HeldTorque(-math.inf, math.inf, setpoints[0])
        torques = np.empty(len(setpoints))
        for sample, (balance, friction) in enumerate(
            zip((-driving_torque).tolist(), least_friction.tolist(), strict=True)
        ):
            if turning_direction[sample]:
                end_torques = (
                    balance + turning_direction[sample] * friction,
                    balance + turning_direction[sample] * most_friction,
                )
                held_torque = HeldTorque(min(end_torques), max(end_torques), setpoints[sample])
            elif is_resting[sample]:
                held_torque = held_torque.strained(balance, friction, most_friction)
            else:
                held_torque = HeldTorque(balance - most_friction, balance + most_friction, setpoints[sample])
            torques[sample] = max(abs(held_torque.low), abs(held_torque.high))
        return torques + inertia, held_torque

    def _speeds(self, plan: Plan, state: PlanState, times: Sequence[float]) -> tuple[Array, Array]:
        """Return the highest and the lowest speed of each role at these times [rad/s], shape (roles,) each."""
        count = len(self._roles)
        if plan.setup in ("locked", "heated"):
            return np.zeros(count), np.zeros(count)
        highest, lowest = np.zeros(count), np.zeros(count)
        for index, role in enumerate(self._roles):
            mode = state.modes.get(role)
            if mode is Mode.VELOCITY:
                setpoints = [abs(state.setpoints[role].at(time)) for time in times]
                highest[index], lowest[index] = max(setpoints), min(setpoints)
            elif mode is Mode.ANGLE:
                setpoints = [state.setpoints[role].at(time) for time in times]
                highest[index] = (
                    float(np.max(np.abs(np.diff(setpoints)))) / (times[1] - times[0]) if len(times) > 1 else 0.0
                )
            elif mode in CURRENT_MODES:
                highest[index] = self._settings.most_speed
        if plan.setup == "coupled":
            followers = [
                index for index, role in enumerate(self._roles) if state.modes.get(role) in (Mode.VELOCITY, Mode.ANGLE)
            ]
            highest[:], lowest[:] = (highest[followers[0]], lowest[followers[0]]) if followers else (highest.max(), 0.0)
        return highest, lowest

    def _accelerations(self, plan: Plan, state: PlanState, times: Sequence[float]) -> Array:
        """Return the magnitude of the acceleration of each role at each time [rad/s^2], shape (roles, times).

        It is 0 unless the role follows a speed or a list of angles; a jump of a setpoint between two actions adds none.
        """
        accelerations = np.zeros((len(self._roles), len(times)))
        if len(times) < 2 or plan.setup in ("locked", "heated"):
            return accelerations
        for index, role in enumerate(self._roles):
            mode, profile = state.modes.get(role), state.setpoints.get(role)
            if profile is not None and (mode is Mode.VELOCITY or (mode is Mode.ANGLE and isinstance(profile, Samples))):
                order = 1 if mode is Mode.VELOCITY else 2
                spacing = profile.period if isinstance(profile, Samples) else times[1] - times[0]
                setpoints = [
                    profile.at(time) for time in np.arange(times[0], times[-1] + (order + 0.5) * spacing, spacing)
                ]
                changes = np.abs(np.diff(setpoints, order)) / spacing**order
                accelerations[index] = changes[((np.asarray(times) - times[0]) / spacing + 1e-6).astype(np.int64)]
        return accelerations
