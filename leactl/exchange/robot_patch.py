"""Make a patch of the user's MJCF or URDF file from an augmented model."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from leactl.errors import InputError
from leactl.exchange.compiled import Joint, JointActuator, compile_file, is_urdf, joint_of, read_joint
from leactl.exchange.destinations import CURRENT, MJCF, NOWHERE, SERVO, Destination, destinations
from leactl.exchange.robot_joint import DIGITS
from leactl.exchange.xml_text import Element, XmlText
from leactl.model.nominal import Model
from leactl.runfile.publish import new_file

WRITTEN_TOLERANCE = 1e-6  # relative difference between a written figure and the one that MuJoCo reads
# simulation steps, time constant of MuJoCo's friction at rest; with its default of 20 ms a sticking bearing creeps
STICKING_STEPS = 4.0
STICKING_IMPEDANCE = "0.999 0.9999 0.001"  # solimpfriction of a bearing that sticks


@dataclass(frozen=True)
class Change:
    """A change of one attribute of the user's file."""

    element: str  # as `joint 'knee'`
    line: int
    attribute: str
    before: str | None  # None if the file did not have it
    after: str | None  # None if it is removed


@dataclass
class Patch:
    """The user's file with a model's figures, and the destination of each effect."""

    text: bytes
    joint: Joint  # as the user's file had it
    law: str | None  # law by which callbacks can replace the joint's actuator; None if they cannot
    expected: dict[str, float]  # figures that MuJoCo has to read from the new file, by attribute
    changes: list[Change] = field(default_factory=list)
    effects: list[Destination] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Return changes, effects and notes as JSON values."""
        return {
            "changes": [vars(change) for change in self.changes],
            "effects": [
                {"effect": destination.entry.effect, "goes_to": destination.goes_to, "reason": destination.reason}
                for destination in self.effects
            ],
            "notes": self.notes,
        }


def patch(model: Model, into: Path, name: str, format: str, ctrl_is_current: bool = False) -> Patch:
    """Return the user's file with those figures of a model that its format can hold; all else stays as it is.

    Parameters
    ----------
    format : format of the file, mjcf or urdf.
    ctrl_is_current : whether ctrl of a torque actuator is the current in A, so that torque_constant is its gain.

    Raises
    ------
    InputError : as of `read_joint`; or the file is of the other format, the joint is in an included file, or its
        actuator is not the model's drive.
    """
    compiled = compile_file(into)
    text = compiled.text
    if is_urdf(text) != (format == "urdf"):
        raise InputError(f"{into}: is {'URDF' if is_urdf(text) else 'MJCF'}; --to {format} was asked for")
    joint = joint_of(compiled, name)
    joint_patch = _JointPatch(model, text, joint)
    joint_patch.check_drive(ctrl_is_current)
    joint_patch.mechanics()
    if is_urdf(text):
        joint_patch.urdf()
    else:
        joint_patch.mjcf(ctrl_is_current)
    return joint_patch.patch()


def law_of(model: Model, actuator: JointActuator | None) -> str | None:
    """Return the law by which callbacks can replace the joint's actuator; None if they cannot."""
    if actuator is None:
        return None
    if model.drive is not None:
        return SERVO if actuator.kind == "position" and not actuator.time_constant else None
    return CURRENT if actuator.kind == "torque" else None


@dataclass(frozen=True)
class ServoFigures:
    """Stiffness, braking and limits of a position servo that sets a voltage."""

    stiffness: float  # N*m/rad
    braking: float  # N*m*s/rad, by the back-EMF
    limit: float  # N*m, torque limit at standstill
    top_speed: float  # rad/s, speed at which the back-EMF equals the voltage limit


def servo_figures(model: Model) -> ServoFigures | None:
    """Return the figures of the model's position servo; None if it has no servo or no motor constants."""
    constant, resistance, drive = model.torque_constant, model.phase_resistance, model.drive
    if drive is None or constant is None or resistance is None:
        return None
    emf_constant = model.back_emf_constant or constant
    torque_per_volt = constant / resistance
    return ServoFigures(
        torque_per_volt * drive.gain,
        torque_per_volt * emf_constant,
        torque_per_volt * drive.voltage_limit,
        drive.voltage_limit / emf_constant,
    )


class _JointPatch:
    """Builder of the changes to one joint of a file."""

    def __init__(self, model: Model, text: XmlText, joint: Joint) -> None:
        self.model, self.text, self.joint = model, text, joint
        self.servo, self.law = servo_figures(model), law_of(model, joint.actuator)
        self.figures: dict[str, float] = {}  # by MJCF's names, angles in rad
        self.attribute_changes: dict[int, dict[str, str | None]] = {}
        self.new_children: dict[int, str] = {}
        self.changes: list[Change] = []
        self.notes: list[str] = []
        self.effects = list(destinations(model, self.law))

    def patch(self) -> Patch:
        """Return the patch with all changes so far."""
        text = self.text.changed(self.attribute_changes, self.new_children)
        return Patch(text, self.joint, self.law, self.figures, self.changes, self.effects, self.notes)

    def check_drive(self, ctrl_is_current: bool) -> None:
        """Raise InputError if the model's drive is not the kind of actuator that drives the joint."""
        file, name, actuator = self.text.name, self.joint.name, self.joint.actuator
        is_mjcf = not is_urdf(self.text)
        if ctrl_is_current and (actuator is None or actuator.kind != "torque" or self.model.torque_constant is None):
            raise InputError(
                f"{file}: --ctrl current goes with a torque actuator on joint '{name}' and a torque_constant"
            )
        if self.model.drive is None or not is_mjcf:
            return
        if self.servo is None:
            raise InputError(f"model {self.model.name}: a position servo needs torque_constant and phase_resistance")
        if self.law is None:
            actuator_text = (
                "none" if actuator is None else "one with a lag" if actuator.time_constant else f"a {actuator.kind} one"
            )
            raise InputError(
                f"{file}: the model's drive is a position servo, and joint '{name}' has {actuator_text};"
                " a <position> actuator on the joint was expected"
            )

    def mechanics(self) -> None:
        """Compute the joint's figures from the model's mechanics."""
        model, joint = self.model, self.joint
        if model.rotor_inertia is not None:
            body_inertia = joint.inertia - joint.armature
            armature = model.rotor_inertia + model.load.inertia - body_inertia
            if armature < -WRITTEN_TOLERANCE * body_inertia:
                self.notes.append(
                    f"the bodies alone have an inertia of {body_inertia:.6g} kg*m^2 about the joint, the model has"
                    f" {body_inertia + armature:.6g} in all: armature is 0, and {-armature:.6g} too much is left"
                )
            self.figures["armature"] = max(armature, 0.0) if abs(armature) > WRITTEN_TOLERANCE * body_inertia else 0.0
        if model.viscous_damping is not None or self.servo is not None:
            actuator_damping = joint.damping - joint.attribute_damping  # by the actuator's own attribute
            back_emf_damping = self.servo.braking if self.servo is not None else 0.0
            self.figures["damping"] = max((model.viscous_damping or 0.0) + back_emf_damping - actuator_damping, 0.0)
        if model.coulomb_friction is not None:
            self.figures["frictionloss"] = model.coulomb_friction
        for spring in (destination.entry.parameters for destination in self.effects if destination.goes_to == MJCF):
            self.figures |= {"stiffness": spring["stiffness"], "springref": spring["rest_angle"]}
        level_torque = model.load.level_torque
        if not joint.slides and abs(level_torque - joint.level_torque) > 1e-3 * max(level_torque, joint.level_torque):
            self.notes.append(
                f"held out level the bodies weigh {joint.level_torque:.6g} N*m,"
                f" the model's load {level_torque:.6g} N*m; the bodies stay as they are"
            )

    def mjcf(self, ctrl_is_current: bool) -> None:
        """Change the attributes of the joint and its actuator whose figures differ from the file's."""
        file_figures = figures_of(self.joint)
        values: dict[str, str | None] = {
            name: attribute_text(math.degrees(value) if name == "springref" and self._in_degrees() else value)
            for name, value in self.figures.items()
            if not same_figure(value, file_figures[name])
        }
        if "stiffness" in values or "damping" in values:
            values["springdamper"] = None
        if self.figures.get("frictionloss"):
            values |= {
                "solreffriction": f"{attribute_text(STICKING_STEPS * self.joint.timestep)} 1",
                "solimpfriction": STICKING_IMPEDANCE,
            }
        servo, actuator, constant = self.servo, self.joint.actuator, self.model.torque_constant
        if servo is not None and self.joint.torque_limit is not None and self.joint.torque_limit < servo.limit:
            values["actuatorfrcrange"] = symmetric_range(servo.limit)
        self._change(self._element("worldbody", "joint", "name"), values)
        if actuator is None:
            return
        if servo is not None and self.law == SERVO:
            self._change(self._element("actuator", None, "joint"), self._servo_attributes(actuator, servo))
            self.figures |= {"kp": servo.stiffness, "kv": 0.0, "forcerange": servo.limit}
        if ctrl_is_current and constant is not None and not same_figure(constant, abs(actuator.gain)):
            element = self._element("actuator", None, "joint")
            gears = (element.attributes.get("gear") or "1").split()
            gears[0] = attribute_text(actuator.gear * constant / abs(actuator.gain))
            self._change(element, {"gear": " ".join(gears)})
            self.figures["gain"] = math.copysign(constant, actuator.gain)

    def _servo_attributes(self, actuator: JointActuator, servo: ServoFigures) -> dict[str, str | None]:
        """Return the attributes of a <position> or <general> actuator; its back-EMF is in the joint's damping."""
        element, stiffness = (
            self._element("actuator", None, "joint"),
            attribute_text(servo.stiffness / actuator.gear**2),
        )
        values: dict[str, str | None] = {}
        if element.name == "position":
            if not same_figure(servo.stiffness, actuator.kp):
                values["kp"] = stiffness
            if actuator.kv:
                values |= {"kv": "0", "dampratio": None}
        elif not same_figure(servo.stiffness, actuator.kp) or actuator.kv:
            values |= {"gainprm": stiffness, "biasprm": f"0 -{stiffness} 0"}
        if actuator.force_limit is None or not same_figure(servo.limit, actuator.force_limit):
            values["forcerange"] = symmetric_range(servo.limit / abs(actuator.gear))
        if actuator.force_limit is None:
            values["forcelimited"] = "true"
        return values

    def urdf(self) -> None:
        """Change damping and friction in the joint's <dynamics>, and the effort in its <limit>."""
        joint = self._element("robot", "joint", "name")
        dynamics = {"damping": self.figures.get("damping"), "friction": self.figures.get("frictionloss")}
        values: dict[str, str | None] = {
            name: attribute_text(value) for name, value in dynamics.items() if value is not None
        }
        children = {child.name: child for child in self.text.children(joint)}
        if "dynamics" in children:
            self._change(children["dynamics"], values)
        elif values:
            attributes = " ".join(f'{name}="{value}"' for name, value in values.items())
            self.new_children[self.text.elements.index(joint)] = f"<dynamics {attributes}/>"
            line = self.text.line(joint)
            self.changes += [Change("dynamics", line, name, None, value) for name, value in values.items()]
        if self.servo is not None and "limit" in children:
            self._change(children["limit"], {"effort": attribute_text(self.servo.limit)})
        if armature := self.figures.pop("armature", 0.0):
            self.notes.append(f"URDF has no armature; {armature:.6g} kg*m^2 are left out")
        for name in ("stiffness", "springref"):
            self.figures.pop(name, None)
        self.effects = [
            Destination(destination.entry, NOWHERE, "URDF has no word for it") for destination in self.effects
        ]

    def _element(self, within: str, tag: str | None, attribute: str) -> Element:
        """Return the element of the joint, or of the actuator that refers to it."""
        for element in self.text.elements:
            is_named = element.attributes.get(attribute) == self.joint.name
            if attribute == "joint":
                is_named = is_named or element.attributes.get("jointinparent") == self.joint.name
            if is_named and within in element.path[:-1] and tag in (None, element.name):
                return element
        label = f"joint '{self.joint.name}'" if tag else f"the actuator on joint '{self.joint.name}'"
        raise InputError(
            f"{self.text.name}: {label} is not written in this file, but included, attached or replicated; name the"
            " file that MuJoCo saves (mj_saveLastXML) in its place"
        )

    def _in_degrees(self) -> bool:
        """Return whether the file gives angles in degrees, MJCF's default."""
        angle_units = [
            element.attributes.get("angle", "") for element in self.text.elements if element.name == "compiler"
        ]
        return not self.joint.slides and "radian" not in angle_units

    def _change(self, element: Element, values: dict[str, str | None]) -> None:
        """Change the attributes of an element whose texts differ; None removes one."""
        attributes_before = element.attributes
        changed_values = {name: value for name, value in values.items() if attributes_before.get(name) != value}
        label = f"{element.name} '{attributes_before.get('name', self.joint.name)}'"
        line = self.text.line(element)
        self.changes += [
            Change(label, line, name, attributes_before.get(name), value) for name, value in changed_values.items()
        ]
        self.attribute_changes.setdefault(self.text.elements.index(element), {}).update(changed_values)


def write_patch(patched: Patch, out: Path) -> None:
    """Write a patched file if MuJoCo compiles it and reads the written figures; otherwise write nothing.

    Raises
    ------
    InputError : the file does not compile at its path, or a default of it overrides a written figure.
    """
    with new_file(out) as path:
        path.write_bytes(patched.text)
        try:
            figures_read = figures_of(read_joint(path, patched.joint.name))
        except InputError as fault:
            raise InputError([line.replace(str(path), str(out)) for line in fault.faults]) from None
        for name, value in patched.expected.items():
            if not same_figure(value, figures_read[name]):
                raise InputError(
                    f"{out}: MuJoCo reads {name} {figures_read[name]:.9g} of joint '{patched.joint.name}', {value:.9g}"
                    " was written; a default or a compiler setting of the file stands against it"
                )


def figures_of(joint: Joint) -> dict[str, float]:
    """Return the figures that a patch may set, as MuJoCo reads them, by attribute."""
    actuator = joint.actuator
    return {
        "armature": joint.armature,
        "damping": joint.attribute_damping,
        "frictionloss": joint.friction,
        "stiffness": joint.stiffness,
        "springref": joint.spring_rest,
        "kp": actuator.kp if actuator else 0.0,
        "kv": actuator.kv if actuator else 0.0,
        "gain": actuator.gain if actuator else 0.0,
        "forcerange": (actuator.force_limit if actuator else None) or 0.0,
    }


def same_figure(first: float, second: float) -> bool:
    """Return whether two figures are equal within the rounding of a file."""
    return math.isclose(first, second, rel_tol=WRITTEN_TOLERANCE, abs_tol=1e-12)


def attribute_text(value: float) -> str:
    """Return a figure as the text of an attribute."""
    return f"{value:.{DIGITS}g}"


def symmetric_range(value: float) -> str:
    """Return the range from minus to plus a limit as the text of an attribute."""
    return f"{attribute_text(-value)} {attribute_text(value)}"
