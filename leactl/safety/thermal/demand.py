"""What a plan asks of the drives, action by action: currents where they are planned, and the most where they are not.

A drive that follows a speed or an angle takes what friction, inertia and the other drive's torque make it take. Where a
current is planned the speed may be anything up to the bench's limit, or none at all.
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
    Sought,
    Tare,
)
from leactl.safety.limits import LEADS
from leactl.safety.thermal.box import Array, Box
from leactl.safety.thermal.guard import GuardSettings

TURNING_RAD_S = 0.1  # from which on a rotor that is to turn does so one way
CURRENT_MODES = (Mode.CURRENT, Mode.TORQUE_PROFILE)


@dataclass(frozen=True)
class PlanState:
    """One action with the modes and setpoints that hold in it."""

    name: str
    duration: float
    modes: Mapping[str, Mode]
    setpoints: Mapping[str, SetpointProfile]
    leads: Mapping[str, float]  # A, through two leads of a role
    shortest: float  # s, after which it may end: its duration but where it ends by a criterion

    @property
    def constant(self) -> bool:
        """Whether every setpoint stays as it is, wherever that may be."""
        return all(isinstance(profile, Sought) or profile.low == profile.high for profile in self.setpoints.values())

    @property
    def ends(self) -> "list[PlanState]":
        """The state with every setpoint that is still to be chosen at either of its ends; itself where none is."""
        sought = {role: profile for role, profile in self.setpoints.items() if isinstance(profile, Sought)}
        if not sought:
            return [self]
        chosen = itertools.product(*((Constant(one.low), Constant(one.high)) for one in sought.values()))
        return [replace(self, setpoints={**self.setpoints, **dict(zip(sought, ends, strict=True))}) for ends in chosen]

    @property
    def listed(self) -> bool:
        """Whether any setpoint is a list."""
        return any(isinstance(profile, Samples) for profile in self.setpoints.values())


def states(plan: Plan) -> Iterator[PlanState]:
    """Every action of a plan; waits for a person or a reading take no time here, the guard watches them."""
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
        yield PlanState(name, duration, dict(modes), dict(setpoints), {k: v for k, v in leads.items() if v}, shortest)
        if isinstance(action, Segment):
            setpoints |= {
                role: profile if isinstance(profile, Sought) else Constant(profile.at(action.duration_s))
                for role, profile in action.setpoints.items()
            }


def _name_and_duration(plan: Plan, action: Action) -> tuple[str, float]:
    if isinstance(action, Segment):
        return action.name, action.duration_s
    return type(action).__name__.lower(), action.samples / plan.rate_Hz if isinstance(action, Tare) else 0.0


@dataclass(frozen=True)
class HeldTorque:
    """Bounds of the torque with which a drive holds its shaft [N*m], and the setpoint at which it does."""

    low: float
    high: float
    told: float

    def strained(self, balance: float, least: float, most: float) -> "HeldTorque":
        """Of a shaft at rest, where the other drive asks for `balance` and friction carries from `least` to `most`.

        A torque stays as it is while friction can carry the difference, and follows at that distance where it cannot.
        """
        low = min(balance + least, max(self.low, balance - most))
        high = max(balance - least, min(self.high, balance + most))
        return HeldTorque(low, high, self.told)

    def joined(self, other: "HeldTorque") -> "HeldTorque":
        """Bounds that hold whichever of the two has come to be; none, where they hold the shaft elsewhere."""
        if self.told != other.told:
            return HeldTorque(-math.inf, math.inf, self.told)
        return HeldTorque(min(self.low, other.low), max(self.high, other.high), self.told)


def either(held: Mapping[int, HeldTorque], other: Mapping[int, HeldTorque]) -> dict[int, HeldTorque]:
    """Bounds by place among the roles, whichever of two courses was taken."""
    both = {place: held[place].joined(other[place]) for place in held.keys() & other.keys()}
    alone = {**other, **held}
    return {place: both.get(place, HeldTorque(-math.inf, math.inf, one.told)) for place, one in alone.items()}


class Demand:
    """Currents and speeds of all actuators of a bench under its plans, from one moment to the next."""

    def __init__(self, motors: Mapping[str, Motor], settings: GuardSettings) -> None:
        self._motors, self._settings, self._roles = dict(motors), settings, tuple(motors)
        self.held: Mapping[int, HeldTorque] = {}  # by place among the roles, as the latest moment left them

    def heats(self, plan: Plan, state: PlanState, at: Sequence[float]) -> tuple[Array, Array, Array]:
        """Square currents at these moments, electrical speeds at the least and speeds at the most [rad/s] of all roles.

        The next call goes on from the last of these moments.
        """
        squares, turned, speeds, self.held = self._followed(plan, state, at)
        return squares, turned, speeds

    def squares(self, plan: Plan, state: PlanState, at: Sequence[float]) -> tuple[Array, Array, Array]:
        """The same for moments that are only looked ahead to."""
        return self._followed(plan, state, at)[:3]

    def _followed(
        self, plan: Plan, state: PlanState, at: Sequence[float]
    ) -> tuple[Array, Array, Array, dict[int, HeldTorque]]:
        """Square currents, both speeds and strains; of each actuator the worst of the ends of what is not chosen yet.

        No setpoint between the ends asks for more: a role's own current is largest at one of them, and the bounds of
        what another drive holds against it rise with it.
        """
        courses = [self._followed_at(plan, end, at) for end in state.ends]
        squares, turned, speeds, helds = courses[0]
        for other in courses[1:]:
            squares, speeds = np.maximum(squares, other[0]), np.maximum(speeds, other[2])
            turned, helds = np.minimum(turned, other[1]), either(helds, other[3])
        return squares, turned, speeds, helds

    def _followed_at(
        self, plan: Plan, state: PlanState, at: Sequence[float]
    ) -> tuple[Array, Array, Array, dict[int, HeldTorque]]:
        currents, most = np.zeros((len(self._roles), len(at))), self._settings.most_current
        speeds, planned = self._speeds(plan, state, at)
        accelerations = self._accelerations(plan, state, at)
        helds: dict[int, HeldTorque] = {}
        for k, role in enumerate(self._roles):
            if state.modes.get(role) in CURRENT_MODES:
                currents[k] = [state.setpoints[role].at(t) for t in at]
        squares = currents**2
        for k, role in enumerate(self._roles):
            if state.modes.get(role) in (Mode.VELOCITY, Mode.ANGLE):
                torques, helds[k] = self._held_torques(plan, state, k, currents, at, speeds, accelerations)
                wanted = torques / self._motors[role].torque_constant
                currents[k] = np.minimum(wanted, most)
                # what asks for more than may flow takes the longer: the same impulse at the most that may
                longer = wanted * currents[k]
                squares[k] = longer * most**2 / max(most**2, float(np.mean(longer)))
            if role in state.leads:  # where no drive stands beside the supply, which a heated set-up has none of
                squares[k] = LEADS * state.leads[role] ** 2
        turned = np.array([self._motors[role].pole_pairs for role in self._roles]) * planned
        return squares, turned, speeds, helds

    def _held_torques(
        self,
        plan: Plan,
        state: PlanState,
        place: int,
        currents: Array,
        at: Sequence[float],
        speeds: Array,
        accelerations: Array,
    ) -> tuple[Array, HeldTorque]:
        """What a drive that follows a speed or an angle needs at the most: the other's torque, friction and inertia.

        Friction helps to hold what drives a shaft onward and adds to what drives it back. One that hardly turns may
        stick either way; one at rest keeps its strain until the other drive's torque overcomes friction.
        """
        mode, profile = state.modes[self._roles[place]], state.setpoints[self._roles[place]]
        told = np.array([profile.at(t) for t in at])
        velocities = told if mode is Mode.VELOCITY else np.zeros(len(told))
        most = 0.0
        least, driving, inertia = (np.zeros(len(told)) for _ in range(3))
        for k, role in enumerate(self._roles):
            if k == place or plan.setup == "coupled":
                motor, box = self._motors[role], Box.of(self._motors[role])
                least += box.coulomb_friction.low + box.viscous_damping.low * np.abs(velocities)
                most += box.coulomb_friction.high + box.viscous_damping.high * speeds[k]
                inertia += motor.rotor_inertia * accelerations[place]
                if k != place:
                    driving += motor.torque_constant * currents[k]
        turning = np.sign(velocities) * (np.abs(velocities) >= TURNING_RAD_S)
        resting = velocities == 0.0 if mode is Mode.VELOCITY else np.full(len(told), profile.low == profile.high)
        held = self.held.get(place, HeldTorque(-most, most, 0.0))  # engaged at no current
        if mode is Mode.ANGLE and held.told != told[0]:
            held = HeldTorque(-math.inf, math.inf, told[0])
        torques = np.empty(len(told))
        for n, (balance, low) in enumerate(zip((-driving).tolist(), least.tolist(), strict=True)):
            if turning[n]:
                ends = balance + turning[n] * low, balance + turning[n] * most
                held = HeldTorque(min(ends), max(ends), told[n])
            elif resting[n]:
                held = held.strained(balance, low, most)
            else:
                held = HeldTorque(balance - most, balance + most, told[n])
            torques[n] = max(abs(held.low), abs(held.high))
        return torques + inertia, held

    def _speeds(self, plan: Plan, state: PlanState, at: Sequence[float]) -> tuple[Array, Array]:
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

    def _accelerations(self, plan: Plan, state: PlanState, at: Sequence[float]) -> Array:
        """Of each role at each time, where it follows a speed or listed angles; none where a setpoint jumps."""
        accelerations = np.zeros((len(self._roles), len(at)))
        if len(at) < 2 or plan.setup in ("locked", "heated"):
            return accelerations
        for k, role in enumerate(self._roles):
            mode, profile = state.modes.get(role), state.setpoints.get(role)
            if profile is not None and (mode is Mode.VELOCITY or (mode is Mode.ANGLE and isinstance(profile, Samples))):
                order = 1 if mode is Mode.VELOCITY else 2
                spacing = profile.period if isinstance(profile, Samples) else at[1] - at[0]
                told = [profile.at(t) for t in np.arange(at[0], at[-1] + (order + 0.5) * spacing, spacing)]
                changes = np.abs(np.diff(told, order)) / spacing**order
                accelerations[k] = changes[((np.asarray(at) - at[0]) / spacing + 1e-6).astype(np.int64)]
        return accelerations
