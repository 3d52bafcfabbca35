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
        ValueError : the model lacks the joint or the actuator, or its integrator is RK4, which evaluates a step four
            times.
        """
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise ValueError("integrator RK4 evaluates a step four times; what has a memory needs another integrator")
        self.model, self.parameters = model, parameters
        self._effects: dict[str, list[Mapping[str, float]]] = {}
        for entry in parameters["effects"]:
            self._effects.setdefault(entry["effect"], []).append(entry["parameters"])
        limits = ("torque_limit", "command_slew_limit")  # in the order of the model
        self._command_limits = [
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
        self._start_state: dict[str, float] = {}  # state of the effects at the start of the present step
        self._end_state: dict[str, float] = {}  # state of the effects at the end of the present step
        self._setpoints: deque[tuple[float, float]] = deque()  # times and values of the set-point, for its delay
        self.force = self.drive_torque = 0.0
        self.friction = float(self.parameters["coulomb_friction"])

    def remove(self) -> None:
        """Restore callbacks, the actuator's law and the joint's friction to their state before `install`.

        If several are installed, remove them in reverse order.
        """
        self._remove()

    def angle_reading(self, data: Any) -> float:
        """Return the angle [rad] that the joint's encoder reads, with its errors."""
        angle = float(data.qpos[self._position])
        errors = [
            effect["amplitude"] * math.sin(angle + effect["phase"])
            for effect in self._parameters_of("encoder_eccentricity")
        ]
        errors += [_wave(effect, angle) for effect in self._parameters_of("transmission_error")]
        return angle + sum(errors)

    def step(self, data: Any) -> None:
        """Compute the step that begins; MuJoCo calls it by `mjcb_passive`."""
        model, angle, speed = self.model, float(data.qpos[self._position]), float(data.qvel[self.dof])
        interval = float(model.opt.timestep)
        if math.isnan(self._time) or data.time < self._time:
            self.reset()
            self._first = float(data.time)
        if data.time == self._first:
            self._start_state = self._initial_state(data, speed)
        elif data.time > self._time:
            self._start_state = self._end_state
        # a step may be computed twice, with another ctrl
        self._time, self._end_state = float(data.time), dict(self._start_state)
        if self.drive is not None:
            law = self._servo if "voltage_limit" in self.drive else self._current
            self.drive_torque = law(self.drive, self._control(self.drive, data), angle, speed, interval)
        run_in = math.prod(
            1.0 + effect["excess"] * math.exp(-data.time / effect["time_constant"])
            for effect in self._parameters_of("friction_run_in")
        )
        self.friction = self._sliding_friction(angle, speed, run_in)
        torque = self.drive_torque * sum(_wave(effect, angle) for effect in self._parameters_of("torque_ripple"))
        torque += self._additional_torque(angle, speed) - (run_in - 1.0) * self.parameters["viscous_damping"] * speed
        preslidings = self._parameters_of("presliding")
        if preslidings:
            torque -= self._presliding_torque(sum(effect["displacement"] for effect in preslidings), speed, interval)
        model.dof_frictionloss[self.dof] = 0.0 if preslidings else self.friction
        data.qfrc_passive[self.dof] += torque

    def _parameters_of(self, name: str) -> Sequence[Mapping[str, float]]:
        """Return the parameters of every effect of a name."""
        return self._effects.get(name, ())

    def _initial_state(self, data: Any, speed: float) -> dict[str, float]:
        """Return the state of the effects at a start, as if the set-point had been there for long."""
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
        """Return the set-point that `ctrl` stands for: angle of a servo [rad], current [A] otherwise."""
        model, index = self.model, self.actuator
        address = int(model.actuator_ctrladr[index]) if hasattr(model, "actuator_ctrladr") else index
        value = float(data.ctrl[address])
        if model.actuator_ctrllimited[index]:
            low, high = (float(limit) for limit in model.actuator_ctrlrange[index])
            value = min(max(value, low), high)
        return value * float(drive["per_ctrl"])

    def _delayed(self, value: float) -> float:
        """Return the value a delay earlier, interpolated linearly; the first value before the start."""
        delay = sum(effect["delay"] for effect in self._parameters_of("transport_delay"))
        if not delay:
            return value
        if self._setpoints and self._setpoints[-1][0] == self._time:
            self._setpoints.pop()
        self._setpoints.append((self._time, value))
        time_due = self._time - delay
        while len(self._setpoints) > 1 and self._setpoints[1][0] <= time_due:
            self._setpoints.popleft()
        (time_before, value_before), (time_after, value_after) = (
            self._setpoints[0],
            self._setpoints[min(1, len(self._setpoints) - 1)],
        )
        share = (
            min(max((time_due - time_before) / (time_after - time_before), 0.0), 1.0)
            if time_after > time_before
            else 0.0
        )
        return value_before + share * (value_after - value_before)

    def _servo(self, drive: Mapping[str, Any], setpoint: float, angle: float, speed: float, interval: float) -> float:
        """Return the torque [N*m] of a motor whose voltage a position servo sets from the error of the angle."""
        setpoint = self._limited_setpoint(self._delayed(setpoint), interval)
        error = setpoint - angle
        if any(abs(error) < effect["band"] for effect in self._parameters_of("servo_dead_band")):
            error = 0.0
        voltage = drive["gain"] * error
        if drive["damping"]:
            voltage += drive["damping"] * (self._setpoint_speed(setpoint) - speed)
        voltage = min(max(voltage, -drive["voltage_limit"]), drive["voltage_limit"])
        back_emf, resistance, constant = (
            drive["back_emf_constant"] * speed,
            drive["resistance"],
            drive["torque_constant"],
        )
        for effect in self._parameters_of("dead_time"):
            voltage -= effect["voltage"] * math.tanh((voltage - back_emf) / resistance / effect["current"])
        current = (voltage - back_emf) / resistance
        share = self._saturation_factor(current)
        # the back-EMF of an unsaturated motor brakes by the joint's damping in the MJCF file
        self.force = constant * (voltage / resistance + (share - 1.0) * current) / drive["gear"]
        return float(constant * share * current)

    def _limited_setpoint(self, setpoint: float, interval: float) -> float:
        """Return the set-point [rad] of a servo after its limits of speed and acceleration."""
        state = self._end_state
        for effect in self._parameters_of("reference_rate_limit"):
            highest_speed, gain = effect["speed"] or math.inf, effect.get("acceleration", 0.0) * interval
            speed = mean_speed = (setpoint - state["point"]) / interval
            if gain:  # the highest speed from which equal steps of braking end at the set-point
                speed = math.copysign(gain * (math.sqrt(0.25 + 2.0 * abs(mean_speed) / gain) - 0.5), mean_speed)
            speed = math.copysign(min(abs(speed), abs(mean_speed), highest_speed), mean_speed)
            state["speed"] = state["speed"] + min(max(speed - state["speed"], -gain), gain) if gain else speed
            state["point"] += state["speed"] * interval
            setpoint = state["point"]
        return setpoint

    def _setpoint_speed(self, setpoint: float) -> float:
        """Return the speed [rad/s] of the set-point, over the shortest interval in which it has changed."""
        state = self._end_state
        if setpoint != state["before"]:
            time_since_change = self._time - state["changed"] or float(self.model.opt.timestep)
            state["interval"] = min(state["interval"], time_since_change)
            state["setpoint_speed"] = (setpoint - state["before"]) / state["interval"]
            state["before"], state["changed"] = setpoint, self._time
        elif self._time - state["changed"] >= state["interval"]:
            state["setpoint_speed"] = 0.0
        return state["setpoint_speed"]

    def _current(self, drive: Mapping[str, Any], setpoint: float, angle: float, speed: float, interval: float) -> float:
        """Return the torque [N*m] of a current that follows its set-point."""
        for name, effect in self._command_limits:
            centre, largest_change = (
                (0.0, effect["current"])
                if name == "torque_limit"
                else (self._end_state["command"], effect["rate"] * interval)
            )
            change = min(max(setpoint - centre, -largest_change), largest_change)
            setpoint = centre + change
            if name == "command_slew_limit":
                self._end_state["command"] = setpoint
                setpoint -= 0.5 * change * abs(change) / largest_change  # the mean of a step that ramps and then holds
        for effect in self._parameters_of("power_foldback"):
            largest_current = effect["power"] / drive["torque_constant"] / abs(speed) if speed else math.inf
            setpoint = min(max(setpoint, -largest_current), largest_current)
        for effect in self._parameters_of("voltage_limit"):
            drop = effect["stall_current"] * speed / effect["no_load_speed"]
            setpoint = min(max(setpoint, -effect["stall_current"] - drop), effect["stall_current"] - drop)
        motor_current = setpoint = self._delayed(setpoint)
        if drive["loop_bandwidth"]:
            time_constant = 1.0 / (2.0 * math.pi * drive["loop_bandwidth"])
            if self._time == self._first:
                self._end_state["current"] = setpoint
            end_current = setpoint + (self._end_state["current"] - setpoint) * math.exp(-interval / time_constant)
            # the mean over the step
            motor_current = setpoint - time_constant * (end_current - self._end_state["current"]) / interval
            self._end_state["current"] = end_current
        motor_current -= sum(effect["offset"] for effect in self._parameters_of("current_sensor_offset"))
        motor_current /= math.prod(effect["gain"] for effect in self._parameters_of("current_sensor_gain"))
        torque = drive["torque_constant"] * self._saturation_factor(motor_current) * motor_current
        self.force = torque / drive["gear"]
        return float(torque)

    def _saturation_factor(self, current: float) -> float:
        """Return the factor on the torque constant at a current [A]."""
        losses = (
            effect["loss"] * (abs(current) / effect.get("current", 25.0)) ** effect.get("exponent", 2.0)
            for effect in self._parameters_of("saturation")
        )
        return float(math.prod(1.0 - loss for loss in losses))

    def _additional_torque(self, angle: float, speed: float) -> float:
        """Return the torque [N*m] on the joint in addition to its motor and its friction."""
        total = sum(_wave(effect, angle) for effect in self._parameters_of("cogging"))
        for effect in self._parameters_of("unbalance"):
            total += effect["amplitude"] * math.sin(self.parameters["gear_ratio"] * angle + effect["phase"])
        for effect in self._parameters_of("gravity_load"):
            total -= effect["amplitude"] * math.cos(angle + effect["phase"])
        for effect in self._parameters_of("position_spring"):
            deflection = angle - effect["rest_angle"]
            total -= (
                effect["stiffness"] * deflection / math.sqrt(1.0 + (deflection / effect.get("reach", math.inf)) ** 2)
            )
        return total - sum(effect["coefficient"] for effect in self._parameters_of("quadratic_drag")) * speed * abs(
            speed
        )

    def _sliding_friction(self, angle: float, speed: float, run_in: float) -> float:
        """Return the friction [N*m] of the sliding joint."""
        friction = self.parameters["coulomb_friction"] * run_in
        friction += sum(effect["coefficient"] for effect in self._parameters_of("load_dependent_friction")) * abs(
            self.drive_torque
        )
        for effect in self._parameters_of("stribeck"):
            friction *= 1.0 + effect["breakaway_ratio"] * math.exp(
                -((abs(speed) / effect["stribeck_velocity"]) ** effect.get("shape", 1.0))
            )
        for effect in self._parameters_of("asymmetric_friction"):
            friction *= 1.0 + effect["asymmetry"] * (math.copysign(1.0, speed) if speed else 0.0)
        for effect in self._parameters_of("position_dependent_friction"):
            friction *= 1.0 + effect["amplitude"] * math.cos(effect["order"] * angle + effect["phase"])
        return float(friction)

    def _presliding_torque(self, reach: float, speed: float, interval: float) -> float:
        """Return the torque [N*m] of friction that yields elastically before it slides (Dahl, 1968)."""
        sliding_friction, inertia = self.friction, 1.0 / float(self.model.dof_invweight0[self.dof])
        reach = max(
            reach, 0.5 * interval**2 / inertia * sliding_friction
        )  # stiffer than a step resolves would shake the joint
        bristle_change = speed * interval / reach
        bristle = self._end_state["bristle"] = (self._end_state["bristle"] + bristle_change) / (
            1.0 + abs(bristle_change)
        )
        # a fifth of critical, fading above the speed that bent bristles give the joint
        damping = 0.4 * math.sqrt(sliding_friction / reach * inertia)
        if sliding_friction > 0.0:
            damping /= 1.0 + speed**2 * inertia / (sliding_friction * reach)
        return float(sliding_friction * bristle + damping * (1.0 - abs(bristle)) * speed)


def install(model: Any, parameters: Mapping[str, Any] | None = None) -> JointEffects:
    """Install callbacks by which the effects act in every step of a model; callbacks set before are still called.

    The law of the joint's actuator is replaced by this file's; the meaning of `ctrl` does not change.

    Parameters
    ----------
    parameters : figures in place of this file's.

    Raises
    ------
    ValueError : the model has no such joint or no actuator on it, or its integrator is RK4.
    """
    effects = JointEffects(model, PARAMETERS if parameters is None else parameters)
    passive_before, gain_before, bias_before = (
        mujoco.get_mjcb_passive(),
        mujoco.get_mjcb_act_gain(),
        mujoco.get_mjcb_act_bias(),
    )
    index, friction_before = effects.actuator, float(model.dof_frictionloss[effects.dof])
    law_fields = ("actuator_gaintype", "actuator_biastype", "actuator_forcelimited")
    laws_before = {name: getattr(model, name)[index] for name in law_fields} if effects.drive is not None else {}
    if effects.drive is not None:
        model.actuator_gaintype[index] = mujoco.mjtGain.mjGAIN_USER
        model.actuator_biastype[index] = mujoco.mjtBias.mjBIAS_USER
        if effects.drive["limits_itself"]:
            model.actuator_forcelimited[index] = 0

    def apply_passive(stepped_model: Any, data: Any) -> None:
        if passive_before is not None:
            passive_before(stepped_model, data)
        if stepped_model is model:
            effects.step(data)

    def apply_gain(stepped_model: Any, data: Any, actuator: int) -> float:
        if stepped_model is model and actuator == index:
            return 0.0
        return 1.0 if gain_before is None else float(gain_before(stepped_model, data, actuator))

    def apply_bias(stepped_model: Any, data: Any, actuator: int) -> float:
        if stepped_model is model and actuator == index:
            return effects.force
        return 0.0 if bias_before is None else float(bias_before(stepped_model, data, actuator))

    def remove() -> None:
        mujoco.set_mjcb_passive(passive_before)
        mujoco.set_mjcb_act_gain(gain_before)
        mujoco.set_mjcb_act_bias(bias_before)
        model.dof_frictionloss[effects.dof] = friction_before
        for name, value in laws_before.items():
            getattr(model, name)[index] = value

    mujoco.set_mjcb_passive(apply_passive)
    mujoco.set_mjcb_act_gain(apply_gain)
    mujoco.set_mjcb_act_bias(apply_bias)
    effects._remove = remove
    return effects


def _actuator_on(model: Any, joint: int) -> int:
    """Return the index of the actuator on a joint; raise ValueError if there is none."""
    on_joints = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    for index, kind in enumerate(model.actuator_trntype):
        if int(kind) in on_joints and int(model.actuator_trnid[index][0]) == joint:
            return index
    raise ValueError(f"the model has no actuator on joint '{model.joint(joint).name}'")


def _wave(effect: Mapping[str, float], angle: float) -> float:
    """Return a sine over the angle, with the effect's amplitude, order and phase."""
    return effect["amplitude"] * math.sin(effect["order"] * angle + effect["phase"])
