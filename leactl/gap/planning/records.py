"""Simulate the record of a protocol on a nominal bench: motion by the model, channels by replay, with noise.

Servos follow their reference within hundredths of a second; their current is computed from the motion. Machines start
cold, and every channel that a set-up can have is recorded, temperatures among them.
"""

from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from leactl import yamlfile
from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.gap.replay import replay
from leactl.gap.signals.record import Clocked, Key, Record
from leactl.gap.signals.rig import load_of
from leactl.model.nominal import Model
from leactl.protocol.plan import Engage, Plan, Segment

Array = npt.NDArray[np.float64]
TEMPERATURE_INTERVAL_S = 0.1  # s, between temperatures; at least the interval of the other channels
SERVO_LAG_S = 0.02  # s, time constant of each of a servo's two lags
AMBIENT_DEGC = 25.0
NEEDED_PARAMETERS = ("torque_constant", "rotor_inertia", "viscous_damping", "coulomb_friction")
SERVO_MODES = (Mode.VELOCITY, Mode.ANGLE)


@cache
def usual_noise() -> dict[str, float]:
    """Return the usual standard deviation of one sample, by quantity."""
    noise_file = resources.files("leactl.gap.planning") / "noise.yaml"
    std_by_quantity: dict[str, float] = yamlfile.parse(noise_file.read_text(encoding="utf-8"), noise_file.name).data
    return std_by_quantity


def planned_record(plan: Plan, model: Model, noise: Mapping[str, float]) -> Record:
    """Return the simulated record of one protocol.

    Raises
    ------
    InputError : a motion that the model cannot predict, or a protocol that changes the mode of a role.
    """
    setpoints = PlannedSetpoints(plan)
    record = Record(Path(f"{plan.name} (planned)"), plan.name, plan.setup, *clocks(plan, setpoints, model), {})
    job = replay(record, model)
    random = np.random.default_rng(0)
    for clock, replayed in ((record.fast, job.fast), (record.slow, job.slow)):
        if clock is None:
            continue
        for key, values in replayed.items():
            if key in clock.values and np.isfinite(values).any():
                first = values[np.isfinite(values)][0]
                clock.values[key] = np.where(np.isfinite(values), values, first)
        if plan.setup == "locked" and model.bench.shaft_stiffness is not None:
            clock.values |= twist_angle(clock, model.bench.shaft_stiffness)
        for key in clock.values:
            add_noise(clock, key, noise, random)
    return record


class PlannedSetpoints:
    """Setpoints of a protocol for each role, by sample; waits, prompts, taring and pauses take no time."""

    def __init__(self, plan: Plan) -> None:
        self.name = plan.name
        self.interval = 1.0 / plan.record_Hz
        duration = sum(action.duration_s for action in plan.actions if isinstance(action, Segment))
        samples = max(int(duration * plan.record_Hz), 2)
        self.time: Array = self.interval * np.arange(samples, dtype=np.float64)
        self.values = {role: np.zeros_like(self.time) for role in ("test", "load")}
        self.modes: dict[str, Mode] = {}
        start = 0.0
        for action in plan.actions:
            if isinstance(action, Engage):
                self._engage(action, start)
            elif isinstance(action, Segment):
                for role, profile in action.setpoints.items():
                    begin = int(np.searchsorted(self.time, start - 1e-9))
                    end = int(np.searchsorted(self.time, start + action.duration_s - 1e-9))
                    moments = (self.time[begin:end] - start).tolist()
                    self.values[role][begin:end] = [profile.at(moment) for moment in moments]
                    self.values[role][end:] = profile.at(action.duration_s)
                start += action.duration_s

    def _engage(self, action: Engage, start: float) -> None:
        """Note the modes of roles and zero their setpoints from `start` [s].

        Raises
        ------
        InputError : a role changes its mode.
        """
        for role, mode in action.modes.items():
            if mode is Mode.OFF:
                continue
            if self.modes.setdefault(role, mode) is not mode:
                raise InputError(f"protocol '{self.name}' changes the mode of {role} on its way; plan its parts alone")
            self.values[role][int(np.searchsorted(self.time, start)) :] = 0.0

    def current(self, role: str) -> Array | None:
        """Return the current setpoints of a role [A]; None if the role does not follow a current."""
        mode = self.modes.get(role)
        return self.values[role] if mode in (Mode.CURRENT, Mode.TORQUE_PROFILE) else None

    def speed(self, role: str) -> Array | None:
        """Return the speed of a role's servo [rad/s]; None if no servo drives the role."""
        mode = self.modes.get(role)
        if mode not in SERVO_MODES:
            return None
        decay = float(np.exp(-self.interval / SERVO_LAG_S))
        followed = self.values[role]
        for _ in range(2):
            followed = lfilter([1.0 - decay], [1.0, -decay], followed, zi=[decay * followed[0]])[0]
        return followed if mode is Mode.VELOCITY else np.gradient(followed, self.interval)


def clocks(plan: Plan, setpoints: PlannedSetpoints, model: Model) -> tuple[Clocked | None, Clocked]:
    """Return the fast and the slow clock of a set-up, with zeros in channels that a replay fills.

    A heated set-up has no fast clock.
    """
    camera_step = max(round(TEMPERATURE_INTERVAL_S / setpoints.interval), 1)
    slow: dict[Key, Array] = {
        (name, role): np.full_like(setpoints.time[::camera_step], AMBIENT_DEGC)
        for name, role in (("winding_temperature", "test"), ("housing_temperature", "test"))
    }
    slow["ambient_temperature", "bench"] = np.full_like(setpoints.time[::camera_step], AMBIENT_DEGC)
    if plan.setup == "heated":
        heating_current = setpoints.current("test")
        slow["line_current", "test"] = (np.zeros_like(setpoints.time) if heating_current is None else heating_current)[
            ::camera_step
        ]
        slow["line_voltage", "test"] = np.zeros_like(setpoints.time[::camera_step])
        return None, even_clock(setpoints.time[::camera_step], slow)
    current, load_current, speed = planned_motion(plan, setpoints, model)
    fast: dict[Key, Array] = {
        ("q_axis_current_reference", "test"): current,
        ("q_axis_current", "test"): current,
        ("q_axis_voltage", "test"): np.zeros_like(current),
        ("angle", "test"): np.cumsum(speed) * setpoints.interval,
        ("velocity", "test"): speed,
        ("bus_voltage", "bench"): np.zeros_like(current),
    }
    if setpoints.modes.get("test") in SERVO_MODES:
        fast["velocity_reference", "test"] = speed
    if plan.setup != "free":
        fast["torque", "test"] = np.zeros_like(current)
    if plan.setup == "coupled":
        fast["q_axis_current", "load"], fast["velocity", "load"] = load_current, speed
    return even_clock(setpoints.time, fast), even_clock(setpoints.time[::camera_step], slow)


def even_clock(time: Array, values: dict[Key, Array]) -> Clocked:
    """Return channels on one even clock, all valid; current and voltage are means, as drives average them."""
    valid = {key: np.ones(len(time), bool) for key in values}
    means = {("q_axis_current", "test"), ("q_axis_voltage", "test")} & set(values)
    values = {key: np.array(column) for key, column in values.items()}
    return Clocked(time, float(time[1] - time[0]), values, valid, means)


def planned_motion(plan: Plan, setpoints: PlannedSetpoints, model: Model) -> tuple[Array, Array, Array]:
    """Return the currents of test and load actuator [A], and the shaft's speed [rad/s].

    Raises
    ------
    InputError : the model lacks what the motion depends on, or has a load or a position servo.
    """
    zeros = np.zeros_like(setpoints.time)
    test_current = setpoints.current("test")
    if plan.setup == "locked":
        return (zeros if test_current is None else test_current), zeros, zeros
    missing = [name for name in NEEDED_PARAMETERS if getattr(model, name) is None]
    if (
        missing
        or model.drive is not None
        or load_of(Record(Path(plan.name), "", "", None, None, {}), model).type != "none"
    ):
        needs = ", ".join(missing) or "a bench without a pendulum, an arm or a position servo"
        raise InputError(f"protocol '{plan.name}' cannot be planned with model '{model.name}': it needs {needs}")
    shaft_speed = next((speed for role in ("test", "load") if (speed := setpoints.speed(role)) is not None), None)
    rotors = 2 if plan.setup == "coupled" else 1
    load_current = setpoints.current("load") if rotors == 2 else zeros
    if shaft_speed is None:
        total_current = (zeros if test_current is None else test_current) + (
            zeros if load_current is None else load_current
        )
        shaft_speed = driven_speed(total_current, rotors, setpoints.interval, model)
    # the servo's current is that of the motion less the other actuator's
    motion_current = rotors * motion_torque(shaft_speed, setpoints.interval, model) / (model.torque_constant or 1.0)
    if test_current is None:
        test_current = motion_current - (zeros if load_current is None else load_current)
    elif load_current is None or setpoints.current("load") is None:
        load_current = motion_current - test_current
    return test_current, zeros if load_current is None else load_current, shaft_speed


def motion_torque(speed: Array, interval: float, model: Model) -> Array:
    """Return the torque for the motion of one rotor [N*m]."""
    friction = (model.viscous_damping or 0.0) * speed + (model.coulomb_friction or 0.0) * np.sign(speed)
    return np.asarray((model.rotor_inertia or 0.0) * np.gradient(speed, interval) + friction, np.float64)


def driven_speed(current: Array, rotors: int, interval: float, model: Model) -> Array:
    """Return the speed of a shaft that a current alone drives [rad/s], with sticking friction."""
    inertia, damping = rotors * (model.rotor_inertia or 1.0), rotors * (model.viscous_damping or 0.0)
    friction, decay = rotors * (model.coulomb_friction or 0.0), float(np.exp(-damping * interval / inertia))
    gain = (1.0 - decay) / damping if damping else interval / inertia
    speed, speeds = 0.0, []
    for torque in ((model.torque_constant or 0.0) * current).tolist():
        free_speed = decay * speed + gain * torque
        friction_change = gain * friction
        speed = (
            0.0
            if abs(free_speed) <= friction_change
            else free_speed - (friction_change if free_speed > 0.0 else -friction_change)
        )
        speeds.append(speed)
    return np.asarray(speeds)


def twist_angle(clock: Clocked, stiffness: float) -> dict[Key, Array]:
    """Return the channel of a locked rotor's angle, the shaft's twist [rad]; empty if there is no torque channel."""
    torque = clock.values.get(("torque", "test"))
    return {} if torque is None else {("angle", "test"): torque / stiffness}


def add_noise(clock: Clocked, key: Key, noise: Mapping[str, float], random: np.random.Generator) -> None:
    """Add a sensor's noise to a channel; an angle is quantised instead."""
    std = noise.get(key[0], 0.0)
    if key[0] == "angle" and std > 0.0:
        count = std * np.sqrt(12.0)
        clock.values[key] = np.rint(clock.values[key] / count) * count
        clock.counts[key] = float(count)
    elif std > 0.0:
        clock.values[key] = clock.values[key] + std * random.standard_normal(len(clock.time))
