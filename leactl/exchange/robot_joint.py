"""Read a joint of MJCF or URDF as a model file, with a list of the figures that such a file lacks."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from leactl import yamlfile
from leactl.errors import InputError
from leactl.exchange.compiled import Joint, JointActuator, read_joint
from leactl.model.nominal import Model

DIGITS = 9  # significant digits of figures in a file; further digits of a compiled model are rounding errors
MOST_HANGING_OFFSET = 1e-6  # rad from straight down, up to which a load is a pendulum
SLIDE_UNITS = {"N*m": "N", "rad": "m", "rad/s": "m/s", "kg*m^2": "kg", "N*m*s/rad": "N*s/m"}
KEYS_WITHOUT_SOURCE = {
    "bench.velocity_filter_bandwidth": "how the drive filters its velocity",
    "encoder_lines": "the encoder's counts",
    "thermal": "how the winding heats",
}
"""Keys that a diagnosis can use and that neither MJCF nor URDF can state, with their meaning."""


@dataclass(frozen=True)
class ImportedJoint:
    """A model file made from a joint, and the figures that its source lacks."""

    model: Model
    text: str  # of the file
    joint: Joint
    missing: dict[str, str]  # by key of a model file: reason why it is left out
    notes: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return model, joint, actuator, missing keys and notes as JSON values."""
        joint, drive = self.joint, self.joint.actuator
        figures = {
            "name": joint.name,
            "type": "slide" if joint.slides else "hinge",
            "inertia": joint.inertia,
            "armature": joint.armature,
            "damping": joint.damping,
            "frictionloss": joint.friction,
            "stiffness": joint.stiffness,
            "springref": joint.spring_rest,
            "gravity_torque": joint.level_torque,
            "hanging_angle": joint.hanging_angle,
            "range": joint.range,
            "torque_limit": joint.torque_limit,
        }
        actuator = drive and {
            "name": drive.name,
            "type": drive.kind,
            "gear": drive.gear,
            "gain": drive.gain,
            "kp": drive.kp,
            "kv": drive.kv,
            "torque_limit": drive.force_limit,
            "ctrlrange": drive.control_range,
            "time_constant": drive.time_constant,
        }
        return {
            "model": yamlfile.parse(self.text).data,
            "joint": figures,
            "actuator": actuator,
            "missing": [{"key": key, "reason": reason} for key, reason in self.missing.items()],
            "notes": list(self.notes),
        }


def import_joint(path: Path, name: str, supply: float | None = None, ctrl_is_current: bool = False) -> ImportedJoint:
    """Return one joint of an MJCF or URDF file as a model file.

    Parameters
    ----------
    supply : voltage [V] of a position servo's supply, which neither format has.
    ctrl_is_current : whether ctrl of a torque actuator is the current in A, so that its gain is the torque constant.

    Raises
    ------
    InputError : as of `read_joint`; or the actuator is not of the kind that `supply` or `ctrl_is_current` goes with.
    """
    joint = read_joint(path, name)
    kind = None if joint.actuator is None else joint.actuator.kind
    if supply is not None and kind != "position":
        raise InputError(f"--supply {supply:g}: no position actuator drives joint '{name}'; leave it out")
    if ctrl_is_current and kind != "torque":
        raise InputError(f"--ctrl current: no torque actuator drives joint '{name}'; leave it out")
    builder = _ModelKeys(joint, path)
    builder.mechanics()
    builder.weight()
    builder.drive(supply, ctrl_is_current)
    missing = builder.missing | KEYS_WITHOUT_SOURCE
    heading = [yamlfile.printable(f"# joint '{name}' of {path.name}, as MuJoCo compiles it")]
    heading += [yamlfile.printable(f"# not in that file: {key}: {reason}") for key, reason in missing.items()]
    keys = {key: builder.keys[key] for key in Model.model_fields if key in builder.keys}
    text = "\n".join(heading) + "\n" + yaml.safe_dump(rounded(keys), sort_keys=False, allow_unicode=True)
    model = yamlfile.parse(text, yamlfile.printable(f"{path}: joint '{name}'")).validate(Model)
    return ImportedJoint(model, text, joint, missing, tuple([*joint.notes, *builder.notes]))


def rounded(value: Any) -> Any:
    """Return a value with all its numbers rounded to `DIGITS` significant digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


class _ModelKeys:
    """Builder of the keys of a model file, section by section."""

    def __init__(self, joint: Joint, path: Path) -> None:
        self.joint, self.file = joint, path.name
        self.keys: dict[str, Any] = {"name": joint.name}
        self.missing: dict[str, str] = {}
        self.notes: list[str] = []

    def mechanics(self) -> None:
        """Add damping, friction and spring; a zero is MuJoCo's default and counts as missing."""
        joint = self.joint
        for key, value, attribute in (
            ("viscous_damping", joint.damping, "damping"),
            ("coulomb_friction", joint.friction, "frictionloss"),
        ):
            if value > 0.0:
                self.keys[key] = value
            else:
                self.missing[key] = f"{attribute} is 0, as where nobody wrote it"
        if joint.armature == 0.0:
            self.notes.append("armature is 0: the inertia is that of the bodies alone, without the rotor's")
        if joint.stiffness > 0.0:
            spring = {"stiffness": joint.stiffness, "rest_angle": joint.spring_rest}
            self.keys["effects"] = [{"effect": "position_spring", "parameters": spring}]
        if joint.slides:
            self.keys["units"] = SLIDE_UNITS

    def weight(self) -> None:
        """Split the inertia into a point mass on a lever, which gives the weight, and the remainder."""
        joint = self.joint
        self.keys["rotor_inertia"] = joint.inertia
        if joint.slides:
            if joint.level_torque:
                self.notes.append(f"the weight along the slide, {joint.level_torque:.4g} N, has no key in a model file")
            return
        if joint.level_torque == 0.0:
            return
        load: dict[str, Any] = {"type": "pendulum", "mass": joint.mass, "length": joint.lever}
        if abs(joint.hanging_angle) > MOST_HANGING_OFFSET:
            load["type"] = "arm"
            load["zero_angle"] = math.remainder(-0.5 * math.pi - joint.hanging_angle, 2.0 * math.pi)
        load["gravity"] = joint.level_torque / (joint.mass * joint.lever)
        self.keys["load"] = load
        self.keys["rotor_inertia"] = joint.inertia - joint.mass * joint.lever**2

    def drive(self, supply: float | None, ctrl_is_current: bool) -> None:
        """Add the motor's figures that the actuator states."""
        actuator = self.joint.actuator
        self.missing["gear_ratio"] = "turns of the motor for one of the joint"
        if actuator is None:
            self._no_motor("no actuator is on the joint")
        elif actuator.kind == "torque":
            self._no_motor(f"a unit of ctrl makes {actuator.gain:.6g} N*m (give --ctrl current where that unit is 1 A)")
            if ctrl_is_current:
                self.keys["torque_constant"] = abs(actuator.gain)
                del self.missing["torque_constant"]
                if actuator.gain < 0.0:
                    self.notes.append("a positive ctrl turns the joint backwards; turn the sign of the runs' current")
            if actuator.time_constant:
                self.keys["bench"] = {"current_loop_bandwidth": 1.0 / (2.0 * math.pi * actuator.time_constant)}
                del self.missing["bench.current_loop_bandwidth"]
            self._torque_limit(actuator)
        elif actuator.kind == "position":
            self._servo(actuator, supply)
        else:
            kind_text = "a velocity actuator" if actuator.kind == "velocity" else "an actuator of another law"
            self._no_motor(f"{kind_text} is on the joint; model files have a position servo or none")
            self.missing["drive"] = "see torque_constant"

    def _no_motor(self, reason: str) -> None:
        """Note that the motor's figures are missing, and why."""
        self.missing["torque_constant"] = reason
        self.missing["phase_resistance"] = "the winding"
        self.missing["bench.current_loop_bandwidth"] = "how fast the drive's current follows"

    def _force_limits(self, actuator: JointActuator) -> list[float]:
        """Return the limits [N*m] of the actuator's force and of the joint's torque that the file has."""
        return [limit for limit in (actuator.force_limit, self.joint.torque_limit) if limit is not None]

    def _torque_limit(self, actuator: JointActuator) -> None:
        """Add a note on the smallest limit of a torque actuator."""
        limits = self._force_limits(actuator)
        if actuator.control_range is not None:
            limits.append(abs(actuator.gain) * min(map(abs, actuator.control_range)))
        if limits:
            self.notes.append(
                f"the torque is limited to {min(limits):.6g} N*m; write torque_limit under effects: with a"
                " torque_constant"
            )

    def _servo(self, actuator: JointActuator, supply: float | None) -> None:
        """Add a motor at a voltage whose response equals that of kp, kv and the force limit.

        Its torque is K/R clip(gain error, V) - K^2/R w, so that kv is K^2/R, the force limit K/R V, and kp K/R gain.
        """
        limits = self._force_limits(actuator)
        back_emf_damping, bearing_damping = actuator.kv, self.joint.damping
        if not back_emf_damping and bearing_damping:
            back_emf_damping, bearing_damping = bearing_damping, 0.0
            self.notes.append(
                f"how much of the damping of {back_emf_damping:.6g} N*m*s/rad is the motor's back-EMF, no file says:"
                " all of it counts as such"
            )
        lacking = []
        if supply is None:
            lacking.append("the supply's voltage (give --supply)")
        if not limits or min(limits) <= 0.0:
            lacking.append("a limit of its force (forcerange)")
        if not back_emf_damping:
            lacking.append("any damping (kv, or the joint's)")
        if lacking or supply is None:
            reason = f"a position actuator is on the joint; as a servo it lacks {', '.join(lacking)}"
            self.missing |= {"drive": reason, "torque_constant": "see drive", "phase_resistance": "see drive"}
            return
        constant = back_emf_damping * supply / min(limits)
        gain = actuator.kp * supply / min(limits)
        self.keys |= {
            "torque_constant": constant,
            "back_emf_constant": constant,
            "phase_resistance": constant * supply / min(limits),
            "drive": {"type": "position_servo", "gain": gain, "voltage_limit": supply},
        }
        self.keys.pop("viscous_damping", None)
        if bearing_damping:
            self.keys["viscous_damping"] = bearing_damping
        else:
            self.missing["viscous_damping"] = "apart from what brakes as back-EMF"
        if actuator.kv:
            self.notes.append(
                "MuJoCo limits kp times the error less kv times the speed together; the servo limits the voltage and"
                " its back-EMF brakes beyond"
            )
        if actuator.gear != 1.0:
            self.notes.append(f"ctrl is {actuator.gear:g} times the angle that is asked for")
