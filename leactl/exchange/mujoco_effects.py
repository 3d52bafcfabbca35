"""Callbacks for MuJoCo: what acts on a joint beside what MJCF can hold.

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
        limits = ("torque_limit", "command_slew_limit")  # one after the other as the model has them
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
        """Forget the past, as at a start; a clock that goes back does the same."""
        self._time = self._first = math.nan
        self._start: dict[str, float] = {}  # memory at the start of the present step
        self._now: dict[str, float] = {}  # the same at its end
        self._asked: deque[tuple[float, float]] = deque()  # time and value of what a delay still has in it
        self.force = self.drive_torque = 0.0
        self.friction = float(self.parameters["coulomb_friction"])

    def remove(self) -> None:
        """Put callbacks, the actuator's law and the joint's friction back as they were before `install`.

        Of several, the one that was installed last goes first.
        """
        self._remove()

    def angle_reading(self, data: Any) -> float:
        """Angle [rad] that the joint's encoder shows, with its errors."""
        angle = float(data.qpos[self._position])
        errors = [at["amplitude"] * math.sin(angle + at["phase"]) for at in self._each("encoder_eccentricity")]
        errors += [_wave(at, angle) for at in self._each("transmission_error")]
        return angle + sum(errors)

    def step(self, data: Any) -> None:
        """Work out the step that begins; MuJoCo calls it by `mjcb_passive`."""
        model, angle, speed = self.model, float(data.qpos[self._position]), float(data.qvel[self.dof])
        interval = float(model.opt.timestep)
        if math.isnan(self._time) or data.time < self._time:
            self.reset()
            self._first = float(data.time)
        if data.time == self._first:
            self._start = self._at_rest(data, speed)
        elif data.time > self._time:
            self._start = self._now
        self._time, self._now = float(data.time), dict(self._start)  # an instant may come twice, with another ctrl
        if self.drive is not None:
            law = self._servo if "voltage_limit" in self.drive else self._current
            self.drive_torque = law(self.drive, self._control(self.drive, data), angle, speed, interval)
        more = math.prod(
            1.0 + at["excess"] * math.exp(-data.time / at["time_constant"]) for at in self._each("friction_run_in")
        )
        self.friction = self._level(angle, speed, more)
        torque = self.drive_torque * sum(_wave(at, angle) for at in self._each("torque_ripple"))
        torque += self._beside(angle, speed) - (more - 1.0) * self.parameters["viscous_damping"] * speed
        bends = self._each("presliding")
        if bends:
            torque -= self._bent(sum(at["displacement"] for at in bends), speed, interval)
        model.dof_frictionloss[self.dof] = 0.0 if bends else self.friction
        data.qfrc_passive[self.dof] += torque

    def _each(self, name: str) -> Sequence[Mapping[str, float]]:
        return self._effects.get(name, ())

    def _at_rest(self, data: Any, speed: float) -> dict[str, float]:
        asked = 0.0 if self.drive is None else self._control(self.drive, data)
        asks = {name: asked for name in ("point", "before", "command", "current")}
        return asks | {
            "pace": 0.0,
            "changed": data.time,
            "interval": math.inf,
            "haste": 0.0,
            "bristle": math.tanh(10.0 * speed),
        }

    def _control(self, drive: Mapping[str, Any], data: Any) -> float:
        """What ctrl asks for: rad of a servo, A of a current."""
        model, index = self.model, self.actuator
        address = int(model.actuator_ctrladr[index]) if hasattr(model, "actuator_ctrladr") else index
        value = float(data.ctrl[address])
        if model.actuator_ctrllimited[index]:
            low, high = (float(end) for end in model.actuator_ctrlrange[index])
            value = min(max(value, low), high)
        return value * float(drive["per_ctrl"])

    def _delayed(self, value: float) -> float:
        """The value a delay earlier, linear in between, the first value before the start."""
        delay = sum(at["delay"] for at in self._each("transport_delay"))
        if not delay:
            return value
        if self._asked and self._asked[-1][0] == self._time:
            self._asked.pop()
        self._asked.append((self._time, value))
        due = self._time - delay
        while len(self._asked) > 1 and self._asked[1][0] <= due:
            self._asked.popleft()
        (begin, first), (end, last) = self._asked[0], self._asked[min(1, len(self._asked) - 1)]
        share = min(max((due - begin) / (end - begin), 0.0), 1.0) if end > begin else 0.0
        return first + share * (last - first)

    def _servo(self, at: Mapping[str, Any], asked: float, angle: float, speed: float, interval: float) -> float:
        """Torque [N*m] of a motor on the voltage that a position servo makes of an angle's error."""
        asked = self._followed(self._delayed(asked), interval)
        error = asked - angle
        if any(abs(error) < of["band"] for of in self._each("servo_dead_band")):
            error = 0.0
        volts = at["gain"] * error
        if at["damping"]:
            volts += at["damping"] * (self._haste(asked) - speed)
        volts = min(max(volts, -at["voltage_limit"]), at["voltage_limit"])
        emf, resistance, constant = at["back_emf_constant"] * speed, at["resistance"], at["torque_constant"]
        for of in self._each("dead_time"):
            volts -= of["voltage"] * math.tanh((volts - emf) / resistance / of["current"])
        current = (volts - emf) / resistance
        share = self._share(current)
        # the back-EMF of an unsaturated motor brakes by the joint's damping in the MJCF file
        self.force = constant * (volts / resistance + (share - 1.0) * current) / at["gear"]
        return float(constant * share * current)

    def _followed(self, asked: float, interval: float) -> float:
        """The set-point that a servo moves to what is asked for, no faster than its limits allow."""
        now = self._now
        for at in self._each("reference_rate_limit"):
            speed, gain = at["speed"] or math.inf, at.get("acceleration", 0.0) * interval
            wanted = way = (asked - now["point"]) / interval
            if gain:  # the fastest from which equal steps of braking end at the value
                wanted = math.copysign(gain * (math.sqrt(0.25 + 2.0 * abs(way) / gain) - 0.5), way)
            wanted = math.copysign(min(abs(wanted), abs(way), speed), way)
            now["pace"] = now["pace"] + min(max(wanted - now["pace"], -gain), gain) if gain else wanted
            now["point"] += now["pace"] * interval
            asked = now["point"]
        return asked

    def _haste(self, asked: float) -> float:
        """Speed [rad/s] of what is asked for, over the shortest interval at which it has changed."""
        now = self._now
        if asked != now["before"]:
            gap = self._time - now["changed"] or float(self.model.opt.timestep)
            now["interval"] = min(now["interval"], gap)
            now["haste"] = (asked - now["before"]) / now["interval"]
            now["before"], now["changed"] = asked, self._time
        elif self._time - now["changed"] >= now["interval"]:
            now["haste"] = 0.0
        return now["haste"]

    def _current(self, at: Mapping[str, Any], wanted: float, angle: float, speed: float, interval: float) -> float:
        """Torque [N*m] of a current that follows what is asked for."""
        for name, of in self._commands:
            before, most = (
                (0.0, of["current"]) if name == "torque_limit" else (self._now["command"], of["rate"] * interval)
            )
            change = min(max(wanted - before, -most), most)
            wanted = before + change
            if name == "command_slew_limit":
                self._now["command"] = wanted
                wanted -= 0.5 * change * abs(change) / most  # the mean of a step that ramps there and holds
        for of in self._each("power_foldback"):
            most = of["power"] / at["torque_constant"] / abs(speed) if speed else math.inf
            wanted = min(max(wanted, -most), most)
        flowing = wanted = self._delayed(wanted)
        if at["loop_bandwidth"]:
            lag = 1.0 / (2.0 * math.pi * at["loop_bandwidth"])
            if self._time == self._first:
                self._now["current"] = wanted
            ends = wanted + (self._now["current"] - wanted) * math.exp(-interval / lag)
            flowing = wanted - lag * (ends - self._now["current"]) / interval  # the mean over the step
            self._now["current"] = ends
        flowing -= sum(of["offset"] for of in self._each("current_sensor_offset"))
        flowing /= math.prod(of["gain"] for of in self._each("current_sensor_gain"))
        torque = at["torque_constant"] * self._share(flowing) * flowing
        self.force = torque / at["gear"]
        return float(torque)

    def _share(self, current: float) -> float:
        """Factor on the torque constant at a current."""
        lost = (
            at["loss"] * (abs(current) / at.get("current", 25.0)) ** at.get("exponent", 2.0)
            for at in self._each("saturation")
        )
        return float(math.prod(1.0 - part for part in lost))

    def _beside(self, angle: float, speed: float) -> float:
        """Torque [N*m] that drives the joint beside its motor and its friction."""
        total = sum(_wave(at, angle) for at in self._each("cogging"))
        for at in self._each("unbalance"):
            total += at["amplitude"] * math.sin(self.parameters["gear_ratio"] * angle + at["phase"])
        for at in self._each("gravity_load"):
            total -= at["amplitude"] * math.cos(angle + at["phase"])
        for at in self._each("position_spring"):
            away = angle - at["rest_angle"]
            total -= at["stiffness"] * away / math.sqrt(1.0 + (away / at.get("reach", math.inf)) ** 2)
        return total - sum(at["coefficient"] for at in self._each("quadratic_drag")) * speed * abs(speed)

    def _level(self, angle: float, speed: float, more: float) -> float:
        """Friction [N*m] at which the joint slides."""
        level = self.parameters["coulomb_friction"] * more
        level += sum(at["coefficient"] for at in self._each("load_dependent_friction")) * abs(self.drive_torque)
        for at in self._each("stribeck"):
            level *= 1.0 + at["breakaway_ratio"] * math.exp(
                -((abs(speed) / at["stribeck_velocity"]) ** at.get("shape", 1.0))
            )
        for at in self._each("asymmetric_friction"):
            level *= 1.0 + at["asymmetry"] * (math.copysign(1.0, speed) if speed else 0.0)
        for at in self._each("position_dependent_friction"):
            level *= 1.0 + at["amplitude"] * math.cos(at["order"] * angle + at["phase"])
        return float(level)

    def _bent(self, reach: float, speed: float, interval: float) -> float:
        """Torque [N*m] of friction that bends over an angle before it slides (Dahl, 1968)."""
        level, inertia = self.friction, 1.0 / float(self.model.dof_invweight0[self.dof])
        reach = max(reach, 0.5 * interval**2 / inertia * level)  # stiffer than a step resolves would shake the joint
        turned = speed * interval / reach
        bent = self._now["bristle"] = (self._now["bristle"] + turned) / (1.0 + abs(turned))
        damping = 0.4 * math.sqrt(level / reach * inertia)  # a fifth of critical, while it bends
        return float(level * bent + damping * (1.0 - abs(bent)) * speed)


def install(model: Any, parameters: Mapping[str, Any] | None = None) -> JointEffects:
    """Let the effects act whenever a model is stepped; callbacks that are set already go on.

    The law of the joint's actuator becomes this file's; `ctrl` means what it did.

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
