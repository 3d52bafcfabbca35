"""Callbacks for MuJoCo: effects on a joint that MJCF cannot express.

`leactl model export --callbacks` writes a copy of this file with the figures of a joint. It needs `mujoco` alone.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco

PARAMETERS: dict[str, Any] = {}


class JointEffects:
    """The actuator's law and the friction of one joint, stepped along with one `MjData` of a compiled model.

    Attributes
    ----------
    drive_torque : N*m at the joint that the motor makes in the present step.
    friction : N*m at which the joint slides in the present step.
    """

    def __init__(self, model: Any, parameters: Mapping[str, Any]) -> None:
        """Look up the joint and its actuator.

        Raises
        ------
        ValueError : the model lacks one of the two, or its integrator evaluates a step several times (RK4).
        """
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise ValueError("integrator RK4 evaluates a step four times; what has a memory needs another integrator")
        self.model, self.parameters = model, parameters
        self._effects: dict[str, list[Mapping[str, float]]] = {}
        for entry in parameters["effects"]:
            self._effects.setdefault(entry["effect"], []).append(entry["parameters"])
        limits = ("torque_limit", "command_slew_limit")  # in the order of the model
        self._commands = [
            (entry["effect"], entry["parameters"]) for entry in parameters["effects"] if entry["effect"] in limits
        ]
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, parameters["joint"])
        if joint < 0:
            raise ValueError(f"the model has no joint '{parameters['joint']}'")
        self.dof, self._position = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        self.drive: Mapping[str, Any] | None = parameters["drive"]
        self.actuator = -1 if self.drive is None else _actuator_on(model, joint)
        self._remove: Callable[[], None] = lambda: None
        self.reset()

    def reset(self) -> None:
        """Clear the state of the effects, as at a start; a clock that goes back does the same."""
        self._time = self._first = math.nan
        self._start: dict[str, float] = {}  # state of the effects at the start of the present step
        self._now: dict[str, float] = {}  # the same at its end
        self._setpoints: deque[tuple[float, float]] = deque()  # times and values of the set-point, for its delay
        self.force = self.drive_torque = 0.0
        self.friction = float(self.parameters["coulomb_friction"])

    def remove(self) -> None:
        """Restore callbacks, the actuator's law and the joint's friction to their state before `install`.

        If several are installed, remove them in reverse order.
        """
        self._remove()

    def angle_reading(self, data: Any) -> float:
        """Angle [rad] that the joint's encoder reads, with its errors."""
        angle = float(data.qpos[self._position])
        errors = [
            effect["amplitude"] * math.sin(angle + effect["phase"]) for effect in self._each("encoder_eccentricity")
        ]
        errors += [_wave(effect, angle) for effect in self._each("transmission_error")]
        return angle + sum(errors)

    def step(self, data: Any) -> None:
        """Compute the step that begins; MuJoCo calls it by `mjcb_passive`."""
        model, angle, speed = self.model, float(data.qpos[self._position]), float(data.qvel[self.dof])
        interval = float(model.opt.timestep)
        if math.isnan(self._time) or data.time < self._time:
            self.reset()
            self._first = float(data.time)
        if data.time == self._first:
            self._start = self._at_rest(data, speed)
        elif data.time > self._time:
            self._start = self._now
        self._time, self._now = float(data.time), dict(self._start)  # a step may be computed twice, with another ctrl
        if self.drive is not None:
            law = self._servo if "voltage_limit" in self.drive else self._current
            self.drive_torque = law(self.drive, self._control(self.drive, data), angle, speed, interval)
        run_in = math.prod(
            1.0 + effect["excess"] * math.exp(-data.time / effect["time_constant"])
            for effect in self._each("friction_run_in")
        )
        self.friction = self._level(angle, speed, run_in)
        torque = self.drive_torque * sum(_wave(effect, angle) for effect in self._each("torque_ripple"))
        torque += self._additional_torque(angle, speed) - (run_in - 1.0) * self.parameters["viscous_damping"] * speed
        bends = self._each("presliding")
        if bends:
            torque -= self._bent(sum(effect["displacement"] for effect in bends), speed, interval)
        model.dof_frictionloss[self.dof] = 0.0 if bends else self.friction
        data.qfrc_passive[self.dof] += torque

    def _each(self, name: str) -> Sequence[Mapping[str, float]]:
        return self._effects.get(name, ())

    def _at_rest(self, data: Any, speed: float) -> dict[str, float]:
        setpoint = 0.0 if self.drive is None else self._control(self.drive, data)
        setpoints = {name: setpoint for name in ("point", "before", "command", "current")}
        return setpoints | {
            "speed": 0.0,
            "changed": data.time,
            "interval": math.inf,
            "setpoint_speed": 0.0,
            "bristle": math.tanh(10.0 * speed),
        }

    def _control(self, drive: Mapping[str, Any], data: Any) -> float:
        """Set-point that `ctrl` stands for: angle of a servo [rad], current [A] otherwise."""
        model, index = self.model, self.actuator
        address = int(model.actuator_ctrladr[index]) if hasattr(model, "actuator_ctrladr") else index
        value = float(data.ctrl[address])
        if model.actuator_ctrllimited[index]:
            low, high = (float(end) for end in model.actuator_ctrlrange[index])
            value = min(max(value, low), high)
        return value * float(drive["per_ctrl"])

    def _delayed(self, value: float) -> float:
        """Value a delay earlier, interpolated linearly; the first value before the start."""
        delay = sum(effect["delay"] for effect in self._each("transport_delay"))
        if not delay:
            return value
        if self._setpoints and self._setpoints[-1][0] == self._time:
            self._setpoints.pop()
        self._setpoints.append((self._time, value))
        due = self._time - delay
        while len(self._setpoints) > 1 and self._setpoints[1][0] <= due:
            self._setpoints.popleft()
        (begin, first), (end, last) = self._setpoints[0], self._setpoints[min(1, len(self._setpoints) - 1)]
        share = min(max((due - begin) / (end - begin), 0.0), 1.0) if end > begin else 0.0
        return first + share * (last - first)

    def _servo(self, drive: Mapping[str, Any], setpoint: float, angle: float, speed: float, interval: float) -> float:
        """Torque [N*m] of a motor whose voltage a position servo sets from the error of the angle."""
        setpoint = self._limited_setpoint(self._delayed(setpoint), interval)
        error = setpoint - angle
        if any(abs(error) < effect["band"] for effect in self._each("servo_dead_band")):
            error = 0.0
        voltage = drive["gain"] * error
        if drive["damping"]:
            voltage += drive["damping"] * (self._setpoint_speed(setpoint) - speed)
        voltage = min(max(voltage, -drive["voltage_limit"]), drive["voltage_limit"])
        emf, resistance, constant = drive["back_emf_constant"] * speed, drive["resistance"], drive["torque_constant"]
        for effect in self._each("dead_time"):
            voltage -= effect["voltage"] * math.tanh((voltage - emf) / resistance / effect["current"])
        current = (voltage - emf) / resistance
        share = self._share(current)
        # the back-EMF of an unsaturated motor brakes by the joint's damping in the MJCF file
        self.force = constant * (voltage / resistance + (share - 1.0) * current) / drive["gear"]
        return float(constant * share * current)

    def _limited_setpoint(self, setpoint: float, interval: float) -> float:
        """Set-point of a servo after its limits of speed and acceleration."""
        now = self._now
        for effect in self._each("reference_rate_limit"):
            highest_speed, gain = effect["speed"] or math.inf, effect.get("acceleration", 0.0) * interval
            speed = mean_speed = (setpoint - now["point"]) / interval
            if gain:  # the fastest from which equal steps of braking end at the value
                speed = math.copysign(gain * (math.sqrt(0.25 + 2.0 * abs(mean_speed) / gain) - 0.5), mean_speed)
            speed = math.copysign(min(abs(speed), abs(mean_speed), highest_speed), mean_speed)
            now["speed"] = now["speed"] + min(max(speed - now["speed"], -gain), gain) if gain else speed
            now["point"] += now["speed"] * interval
            setpoint = now["point"]
        return setpoint

    def _setpoint_speed(self, setpoint: float) -> float:
        """Speed [rad/s] of the set-point, over the shortest interval in which it has changed."""
        now = self._now
        if setpoint != now["before"]:
            gap = self._time - now["changed"] or float(self.model.opt.timestep)
            now["interval"] = min(now["interval"], gap)
            now["setpoint_speed"] = (setpoint - now["before"]) / now["interval"]
            now["before"], now["changed"] = setpoint, self._time
        elif self._time - now["changed"] >= now["interval"]:
            now["setpoint_speed"] = 0.0
        return now["setpoint_speed"]

    def _current(self, drive: Mapping[str, Any], setpoint: float, angle: float, speed: float, interval: float) -> float:
        """Torque [N*m] of a current that follows its set-point."""
        for name, effect in self._commands:
            before, most = (
                (0.0, effect["current"])
                if name == "torque_limit"
                else (self._now["command"], effect["rate"] * interval)
            )
            change = min(max(setpoint - before, -most), most)
            setpoint = before + change
            if name == "command_slew_limit":
                self._now["command"] = setpoint
                setpoint -= 0.5 * change * abs(change) / most  # the mean of a step that ramps there and holds
        for effect in self._each("power_foldback"):
            most = effect["power"] / drive["torque_constant"] / abs(speed) if speed else math.inf
            setpoint = min(max(setpoint, -most), most)
        for effect in self._each("voltage_limit"):
            drop = effect["stall_current"] * speed / effect["no_load_speed"]
            setpoint = min(max(setpoint, -effect["stall_current"] - drop), effect["stall_current"] - drop)
        motor_current = setpoint = self._delayed(setpoint)
        if drive["loop_bandwidth"]:
            lag = 1.0 / (2.0 * math.pi * drive["loop_bandwidth"])
            if self._time == self._first:
                self._now["current"] = setpoint
            ends = setpoint + (self._now["current"] - setpoint) * math.exp(-interval / lag)
            motor_current = setpoint - lag * (ends - self._now["current"]) / interval  # the mean over the step
            self._now["current"] = ends
        motor_current -= sum(effect["offset"] for effect in self._each("current_sensor_offset"))
        motor_current /= math.prod(effect["gain"] for effect in self._each("current_sensor_gain"))
        torque = drive["torque_constant"] * self._share(motor_current) * motor_current
        self.force = torque / drive["gear"]
        return float(torque)

    def _share(self, current: float) -> float:
        """Factor on the torque constant at a current."""
        losses = (
            effect["loss"] * (abs(current) / effect.get("current", 25.0)) ** effect.get("exponent", 2.0)
            for effect in self._each("saturation")
        )
        return float(math.prod(1.0 - loss for loss in losses))

    def _additional_torque(self, angle: float, speed: float) -> float:
        """Torque [N*m] on the joint in addition to its motor and its friction."""
        total = sum(_wave(effect, angle) for effect in self._each("cogging"))
        for effect in self._each("unbalance"):
            total += effect["amplitude"] * math.sin(self.parameters["gear_ratio"] * angle + effect["phase"])
        for effect in self._each("gravity_load"):
            total -= effect["amplitude"] * math.cos(angle + effect["phase"])
        for effect in self._each("position_spring"):
            deflection = angle - effect["rest_angle"]
            total -= (
                effect["stiffness"] * deflection / math.sqrt(1.0 + (deflection / effect.get("reach", math.inf)) ** 2)
            )
        return total - sum(effect["coefficient"] for effect in self._each("quadratic_drag")) * speed * abs(speed)

    def _level(self, angle: float, speed: float, run_in: float) -> float:
        """Friction [N*m] of the sliding joint."""
        level = self.parameters["coulomb_friction"] * run_in
        level += sum(effect["coefficient"] for effect in self._each("load_dependent_friction")) * abs(self.drive_torque)
        for effect in self._each("stribeck"):
            level *= 1.0 + effect["breakaway_ratio"] * math.exp(
                -((abs(speed) / effect["stribeck_velocity"]) ** effect.get("shape", 1.0))
            )
        for effect in self._each("asymmetric_friction"):
            level *= 1.0 + effect["asymmetry"] * (math.copysign(1.0, speed) if speed else 0.0)
        for effect in self._each("position_dependent_friction"):
            level *= 1.0 + effect["amplitude"] * math.cos(effect["order"] * angle + effect["phase"])
        return float(level)

    def _bent(self, reach: float, speed: float, interval: float) -> float:
        """Torque [N*m] of friction that yields elastically before it slides (Dahl, 1968)."""
        level, inertia = self.friction, 1.0 / float(self.model.dof_invweight0[self.dof])
        reach = max(reach, 0.5 * interval**2 / inertia * level)  # stiffer than a step resolves would shake the joint
        turned = speed * interval / reach
        bent = self._now["bristle"] = (self._now["bristle"] + turned) / (1.0 + abs(turned))
        damping = 0.4 * math.sqrt(level / reach * inertia)  # a fifth of critical, while it bends
        return float(level * bent + damping * (1.0 - abs(bent)) * speed)


def install(model: Any, parameters: Mapping[str, Any] | None = None) -> JointEffects:
    """Let the effects act whenever a model is stepped; callbacks that were set before are still called.

    The law of the joint's actuator is replaced by this file's; the meaning of `ctrl` does not change.

    Parameters
    ----------
    parameters : figures in place of this file's.

    Raises
    ------
    ValueError : the model has no such joint or no actuator on it, or its integrator is RK4.
    """
    effects = JointEffects(model, PARAMETERS if parameters is None else parameters)
    passive, gain, bias = mujoco.get_mjcb_passive(), mujoco.get_mjcb_act_gain(), mujoco.get_mjcb_act_bias()
    index, friction = effects.actuator, float(model.dof_frictionloss[effects.dof])
    laws = ("actuator_gaintype", "actuator_biastype", "actuator_forcelimited")
    before = {name: getattr(model, name)[index] for name in laws} if effects.drive is not None else {}
    if effects.drive is not None:
        model.actuator_gaintype[index] = mujoco.mjtGain.mjGAIN_USER
        model.actuator_biastype[index] = mujoco.mjtBias.mjBIAS_USER
        if effects.drive["limits_itself"]:
            model.actuator_forcelimited[index] = 0

    def every_passive(of: Any, data: Any) -> None:
        if passive is not None:
            passive(of, data)
        if of is model:
            effects.step(data)

    def every_gain(of: Any, data: Any, actuator: int) -> float:
        if of is model and actuator == index:
            return 0.0
        return 1.0 if gain is None else float(gain(of, data, actuator))

    def every_bias(of: Any, data: Any, actuator: int) -> float:
        if of is model and actuator == index:
            return effects.force
        return 0.0 if bias is None else float(bias(of, data, actuator))

    def remove() -> None:
        mujoco.set_mjcb_passive(passive)
        mujoco.set_mjcb_act_gain(gain)
        mujoco.set_mjcb_act_bias(bias)
        model.dof_frictionloss[effects.dof] = friction
        for name, value in before.items():
            getattr(model, name)[index] = value

    mujoco.set_mjcb_passive(every_passive)
    mujoco.set_mjcb_act_gain(every_gain)
    mujoco.set_mjcb_act_bias(every_bias)
    effects._remove = remove
    return effects


def _actuator_on(model: Any, joint: int) -> int:
    on_joints = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    for index, kind in enumerate(model.actuator_trntype):
        if int(kind) in on_joints and int(model.actuator_trnid[index][0]) == joint:
            return index
    raise ValueError(f"the model has no actuator on joint '{model.joint(joint).name}'")


def _wave(at: Mapping[str, float], angle: float) -> float:
    return at["amplitude"] * math.sin(at["order"] * angle + at["phase"])
