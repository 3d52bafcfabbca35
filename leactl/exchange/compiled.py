"""One joint of a compiled MuJoCo model: inertia, weight, friction, spring, and the actuator on it."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.exchange.xml_text import XmlText, read_xml

Array = npt.NDArray[np.float64]
MUJOCO_MISSING = "MuJoCo is not installed: pip install 'leactl[mujoco]'"
MOST_LISTED_NAMES = 20  # names of joints that a fault lists
DAMPING_SPEED = 1e-6  # rad/s at which damping is measured; there the higher terms of a polynomial vanish
EQUALITY_TOLERANCE = 1e-9  # relative difference up to which two figures count as equal


@dataclass(frozen=True)
class JointActuator:
    """The actuator on a joint; its figures are at the joint, with its `gear` taken into account."""

    name: str
    index: int
    kind: str  # torque, position, velocity or other
    gear: float
    gain: float  # N*m for a unit of ctrl
    kp: float  # N*m/rad, of a position actuator
    kv: float  # N*m*s/rad, of a position or velocity actuator
    force_limit: float | None  # N*m, of its forcerange; None if its force is not limited
    control_range: tuple[float, float] | None  # limits of ctrl; None if it is not limited
    time_constant: float  # s, of a first-order lag between ctrl and force; zero if there is no lag


@dataclass(frozen=True)
class Joint:
    """One joint of a compiled model, SI units; of a slide, N stand for N*m, m for rad and kg for kg*m^2."""

    name: str
    slides: bool
    inertia: float  # kg*m^2, of all bodies that the joint moves, with its armature; the joints below are held
    armature: float  # kg*m^2, of the joint's attribute
    damping: float  # N*m*s/rad, at standstill, of the joint and its actuators
    attribute_damping: float  # N*m*s/rad, of the joint's attribute
    friction: float  # N*m, frictionloss
    stiffness: float  # N*m/rad
    spring_rest: float  # rad
    level_torque: float  # N*m, holds the moved bodies level; of a slide, the weight along it [N]
    hanging_angle: float  # rad, angle at which the moved bodies hang straight down
    mass: float  # kg, of the moved bodies
    lever: float  # m, from its axis to the centre of that mass
    torque_limit: float | None  # N*m, limit of all actuators together (actuatorfrcrange); None if there is none
    range: tuple[float, float] | None  # rad; None if the joint is not limited
    actuator: JointActuator | None
    timestep: float  # s, of the file
    notes: tuple[str, ...]  # on facts of the file that a model file cannot express


def is_urdf(text: XmlText) -> bool:
    """Return whether a file is URDF; otherwise it is MJCF."""
    return text.root == "robot"


@dataclass(frozen=True)
class Compiled:
    """A file, the model that MuJoCo makes of it, and MuJoCo's warnings."""

    model: Any  # mujoco.MjModel
    text: XmlText
    warnings: tuple[str, ...]  # of MuJoCo, one line each


def compile_file(path: Path) -> Compiled:
    """Return an MJCF or URDF file compiled with MuJoCo; shapes of a URDF are left out, so that no mesh is needed.

    Raises
    ------
    InputError : MuJoCo is not installed, the file cannot be read, or MuJoCo finds fault with it.
    """
    text = read_xml(path)
    if text.root not in ("mujoco", "robot"):
        raise InputError(f"{path}:1:1  <{text.root}> is the outermost element; <mujoco> or <robot> was expected")
    mujoco = import_mujoco()
    try:
        with warnings_of(mujoco) as warnings:
            if is_urdf(text):
                model = mujoco.MjModel.from_xml_string(_without_shapes(text.raw))
            else:
                model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as fault:
        raise InputError(f"{path}: MuJoCo does not compile it: {' '.join(str(fault).split())}") from None
    return Compiled(model, text, tuple(warnings))


@contextmanager
def warnings_of(mujoco: Any) -> Iterator[list[str]]:
    """Yield a list that collects MuJoCo's warnings, which it otherwise writes to a log in the user's folder."""
    handler_before, warnings = mujoco.get_mju_user_warning(), list[str]()
    mujoco.set_mju_user_warning(lambda text: warnings.append(" ".join(str(text).split())))
    try:
        yield warnings
    finally:
        mujoco.set_mju_user_warning(handler_before)


def import_mujoco() -> Any:
    """Return the `mujoco` package.

    Raises
    ------
    InputError : MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as fault:
        raise InputError(MUJOCO_MISSING) from fault
    return mujoco


def _without_shapes(raw: bytes) -> str:
    """Return a URDF without `<visual>` and `<collision>`, since the inertia is in `<inertial>` alone."""
    root = ElementTree.fromstring(raw)
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return ElementTree.tostring(root, encoding="unicode")


def read_joint(path: Path, name: str) -> Joint:
    """Return one joint of an MJCF or URDF file.

    Raises
    ------
    InputError : the file cannot be compiled or has no such joint; or the joint is a ball or free joint, tied to another
        joint, part of a closed loop, or driven by a tendon, from outside, with gear 0 or by several actuators.
    """
    return joint_of(compile_file(path), name)


def joint_of(compiled: Compiled, name: str) -> Joint:
    """Return one joint of a compiled file.

    Raises
    ------
    InputError : as of `read_joint`, but for faults of the file.
    """
    mujoco, model, text = import_mujoco(), compiled.model, compiled.text
    names = {model.joint(index).name: index for index in range(model.njnt)}
    if not name or name not in names:
        raise InputError(
            f"{text.name}: no joint '{name}'; {_suggestion(name, [known_name for known_name in names if known_name])}"
        )
    index = names[name]
    kind = int(model.jnt_type[index])
    if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
        kind_name = "ball" if kind == mujoco.mjtJoint.mjJNT_BALL else "free"
        raise InputError(f"{text.name}: joint '{name}' is a {kind_name} joint; a hinge or slide was expected")
    state = mujoco.MjData(model)
    mujoco.mj_forward(model, state)
    compiled_joint = _CompiledJoint(mujoco, model, state, text.name, index)
    compiled_joint.notes += [f"MuJoCo warns: {warning}" for warning in compiled.warnings]
    compiled_joint.refuse_loops(text)
    compiled_joint.refuse_tendons()
    return compiled_joint.joint(kind == mujoco.mjtJoint.mjJNT_SLIDE)


def _suggestion(name: str, known_names: list[str]) -> str:
    """Return the known joint name that is closest to an unknown one, or a list of the known names."""
    if not known_names:
        return "the file names none"
    if close_matches := get_close_matches(name, known_names, n=1):
        return f"did you mean '{close_matches[0]}'?"
    listed_names = ", ".join(known_names[:MOST_LISTED_NAMES])
    unlisted = len(known_names) - MOST_LISTED_NAMES
    return f"known: {listed_names}{f' and {unlisted} more' if unlisted > 0 else ''}"


class _CompiledJoint:
    """A joint of a compiled model in the position that the file gives it."""

    def __init__(self, mujoco: Any, model: Any, state: Any, file: str, index: int) -> None:
        self.mujoco, self.model, self.state, self.file, self.index = mujoco, model, state, file, index
        self.name = model.joint(index).name
        self.dof, self.position = int(model.jnt_dofadr[index]), int(model.jnt_qposadr[index])
        self.body = int(model.jnt_bodyid[index])
        self.notes: list[str] = []

    def moves(self, body: int) -> bool:
        """Return whether the joint moves a body."""
        while body > self.body:
            body = int(self.model.body_parentid[body])
        return body == self.body

    def refuse_loops(self, text: XmlText) -> None:
        """Raise InputError for equality constraints on the joint, or between a body that it moves and a fixed one."""
        model, kinds, bodies_alone = self.model, self.mujoco.mjtEq, [self.mujoco.mjtObj.mjOBJ_BODY] * self.model.neq
        object_types = getattr(model, "eq_objtype", bodies_alone)  # sites too since 3.2
        for equality in range(model.neq):
            if not model.eq_active0[equality]:
                continue
            kind, tied_ids = (
                int(model.eq_type[equality]),
                (int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])),
            )
            if kind == kinds.mjEQ_JOINT and self.index in tied_ids:
                raise InputError(f"{self.file}: joint '{self.name}' is tied to another by an equality constraint")
            if kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
                are_sites = int(object_types[equality]) == self.mujoco.mjtObj.mjOBJ_SITE
                bodies = [int(model.site_bodyid[tied_id]) if are_sites else tied_id for tied_id in tied_ids]
                if self.moves(bodies[0]) != self.moves(bodies[1]):
                    raise InputError(f"{self.file}: joint '{self.name}' is part of a loop that an equality closes")
        for element in text.elements:
            if element.name == "mimic" and self.name in (element.attributes.get("joint"), self._owner(text, element)):
                raise InputError(
                    f"{self.file}:{text.line(element)}:1  joint '{self.name}' is tied to another by <mimic>"
                )

    def _owner(self, text: XmlText, element: Any) -> str | None:
        """Return the name of the element around another; None if it has no name or there is none."""
        return text.elements[element.parent].attributes.get("name") if element.parent is not None else None

    def refuse_tendons(self) -> None:
        """Raise InputError for active tendons whose length depends on the joint's position."""
        model, lengths_before = self.model, np.array(self.state.ten_length)
        for shift in (1e-3, 0.3):  # a length may have its extreme at the first position
            state = self._at(float(self.state.qpos[self.position]) + shift)
            for tendon in np.flatnonzero(np.abs(state.ten_length - lengths_before) > 1e-12):
                if self._pulls(int(tendon)):
                    name = model.tendon(tendon).name or tendon
                    raise InputError(f"{self.file}: tendon '{name}' acts on joint '{self.name}'")

    def _pulls(self, tendon: int) -> bool:
        """Return whether a tendon has a spring, friction, a limit, an actuator or an equality constraint."""
        model, kinds = self.model, self.mujoco.mjtTrn
        properties = ("stiffness", "damping", "frictionloss", "limited", "armature")
        if any(
            np.any(getattr(model, f"tendon_{name}")[tendon]) for name in properties if hasattr(model, f"tendon_{name}")
        ):
            return True
        is_driven = (np.asarray(model.actuator_trntype) == kinds.mjTRN_TENDON) & (model.actuator_trnid[:, 0] == tendon)
        is_tied = (np.asarray(model.eq_type) == self.mujoco.mjtEq.mjEQ_TENDON) & (
            (model.eq_obj1id == tendon) | (model.eq_obj2id == tendon)
        )
        return bool(np.any(is_driven) or np.any(is_tied))

    def _at(self, position: float, speed: float = 0.0) -> Any:
        """Return the state of the whole model with the joint at a position [rad] and a speed [rad/s]."""
        state = self.mujoco.MjData(self.model)
        state.qpos[:] = self.state.qpos
        state.qpos[self.position], state.qvel[self.dof] = position, speed
        self.mujoco.mj_forward(self.model, state)
        return state

    def joint(self, slides: bool) -> Joint:
        """Return all figures of the joint."""
        model, dof = self.model, self.dof
        level_torque, hanging_angle = self._weight(slides)
        stiffness = float(np.ravel(model.jnt_stiffness[self.index])[0])
        actuator = self._actuator()
        self._note_polynomials()
        lower_joints = [
            model.joint(other_joint).name or f"number {other_joint}"
            for other_joint in range(model.njnt)
            if other_joint != self.index and self.moves(int(model.jnt_bodyid[other_joint])) and other_joint > self.index
        ]
        if lower_joints:
            self.notes.append(f"inertia and weight are those with {', '.join(lower_joints)} where the file has them")
        if model.opt.density or model.opt.viscosity:
            self.notes.append("the medium's drag (density, viscosity) is not taken along")
        is_limited = bool(model.jnt_actfrclimited[self.index])
        return Joint(
            name=self.name,
            slides=slides,
            inertia=self._inertia(),
            armature=float(model.dof_armature[dof]),
            damping=self._damping(),
            attribute_damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
            stiffness=stiffness,
            spring_rest=float(model.qpos_spring[self.position]),
            level_torque=level_torque,
            hanging_angle=hanging_angle,
            mass=float(model.body_subtreemass[self.body]),
            lever=self._lever(),
            torque_limit=self._smaller(model.jnt_actfrcrange[self.index], "actuatorfrcrange") if is_limited else None,
            range=_pair(model.jnt_range[self.index]) if model.jnt_limited[self.index] else None,
            actuator=actuator,
            timestep=float(model.opt.timestep),
            notes=tuple(self.notes),
        )

    def _inertia(self) -> float:
        """Return the inertia [kg*m^2] that the joint accelerates while all other joints are held."""
        unit_acceleration, torques = np.zeros(self.model.nv), np.zeros(self.model.nv)
        unit_acceleration[self.dof] = 1.0
        self.mujoco.mj_mulM(self.model, self.state, torques, unit_acceleration)
        return float(torques[self.dof])

    def _damping(self) -> float:
        """Return the damping at standstill [N*m*s/rad], including what actuators add to the joint's attribute.

        The medium's drag is left out: it depends on the bodies, and is no coefficient of the joint.
        """
        medium, start = self.model.opt, float(self.state.qpos[self.position])
        medium_before = medium.density, medium.viscosity
        medium.density = medium.viscosity = 0.0
        torque_at_rest, torque_in_motion = (
            float(self._at(start, speed).qfrc_passive[self.dof]) for speed in (0.0, DAMPING_SPEED)
        )
        medium.density, medium.viscosity = medium_before
        damping = (torque_at_rest - torque_in_motion) / DAMPING_SPEED
        attribute = float(self.model.dof_damping[self.dof])
        return attribute if abs(damping - attribute) <= 1e-6 * max(attribute, 1e-6) else damping

    def _weight(self, slides: bool) -> tuple[float, float]:
        """Return the torque [N*m] of the moved bodies held level, and the angle [rad] at which they hang."""
        start = float(self.state.qpos[self.position])
        sine = self._bias(start)
        if slides:
            return sine, 0.0
        cosine = self._bias(start + 0.5 * math.pi)
        level_torque = math.hypot(sine, cosine)
        if level_torque <= EQUALITY_TOLERANCE * float(self.model.body_subtreemass[self.body]):
            return 0.0, 0.0
        return level_torque, math.remainder(start - math.atan2(sine, cosine), 2.0 * math.pi)

    def _bias(self, position: float) -> float:
        """Return the torque [N*m] against gravity at a position [rad], less gravity compensation."""
        state = self._at(position)
        return float(state.qfrc_bias[self.dof] - state.qfrc_gravcomp[self.dof])

    def _lever(self) -> float:
        """Return the distance [m] of the moved bodies' centre of mass from the joint's axis."""
        axis = self.state.xaxis[self.index]
        offset = self.state.subtree_com[self.body] - self.state.xanchor[self.index]
        return float(np.linalg.norm(offset - axis * float(axis @ offset)))

    def _actuator(self) -> JointActuator | None:
        """Return the actuator on the joint; None if there is none.

        Raises
        ------
        InputError : several actuators act on the joint, or one from outside of it or with gear 0.
        """
        indices = list(self._acting())
        if len(indices) > 1:
            names = ", ".join(f"'{self.model.actuator(index).name or index}'" for index in indices)
            raise InputError(f"{self.file}: several actuators act on joint '{self.name}': {names}; one was expected")
        return self._figures(indices[0]) if indices else None

    def _acting(self) -> Iterator[int]:
        """Yield the indices of the actuators on the joint; raise InputError if one acts on it indirectly."""
        model, kinds = self.model, self.mujoco.mjtTrn
        on_joints = (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT)
        state = self._at(float(self.state.qpos[self.position]), 1.0)
        output_indices = getattr(model, "actuator_outadr", range(len(model.actuator_trntype)))  # several each since 4.0
        for index in range(len(model.actuator_trntype)):
            is_on_a_joint = int(model.actuator_trntype[index]) in on_joints
            if is_on_a_joint and int(model.actuator_trnid[index][0]) == self.index:
                yield index
            elif not is_on_a_joint and abs(float(state.actuator_velocity[output_indices[index]])) > 1e-12:
                name = model.actuator(index).name or index
                raise InputError(f"{self.file}: actuator '{name}' acts on joint '{self.name}' from outside of it")

    def _figures(self, index: int) -> JointActuator:
        """Return the figures of an actuator at the joint, and add notes on what a model file cannot express."""
        model, mujoco = self.model, self.mujoco
        gear = float(model.actuator_gear[index][0])
        gain, bias = (
            np.asarray(values[index], np.float64) for values in (model.actuator_gainprm, model.actuator_biasprm)
        )
        dynamics = int(model.actuator_dyntype[index])
        has_lag = dynamics in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
        kind = self._kind(index, gain, bias) if has_lag or dynamics == mujoco.mjtDyn.mjDYN_NONE else "other"
        if kind == "position" and has_lag:
            self.notes.append("the lag of the position actuator (timeconst) is not taken along")
        if gear == 0.0:
            raise InputError(f"{self.file}: the actuator on joint '{self.name}' has gear 0 and drives nothing")
        if np.ravel(getattr(model, "actuator_delay", np.zeros(len(model.actuator_gear))))[index]:
            self.notes.append("the actuator's delay is not taken along; write it as the effect transport_delay")
        is_limited = bool(model.actuator_forcelimited[index])
        force = self._smaller(model.actuator_forcerange[index], "forcerange") if is_limited else None
        return JointActuator(
            name=model.actuator(index).name,
            index=index,
            kind=kind,
            gear=gear,
            gain=gear * float(gain[0]),
            kp=gear**2 * float(gain[0]) if kind == "position" else 0.0,
            kv=-(gear**2) * float(bias[2]) if kind in ("position", "velocity") else 0.0,
            force_limit=None if force is None else abs(gear) * force,
            control_range=_pair(model.actuator_ctrlrange[index]) if model.actuator_ctrllimited[index] else None,
            time_constant=float(model.actuator_dynprm[index][0]) if has_lag else 0.0,
        )

    def _kind(self, index: int, gain: Array, bias: Array) -> str:
        """Return the kind of actuator by its gain and bias; 'other' if no kind of a model file equals it."""
        model, mujoco = self.model, self.mujoco
        if int(model.actuator_gaintype[index]) != mujoco.mjtGain.mjGAIN_FIXED:
            return "other"
        if int(model.actuator_biastype[index]) == mujoco.mjtBias.mjBIAS_NONE:
            return "torque"
        if int(model.actuator_biastype[index]) != mujoco.mjtBias.mjBIAS_AFFINE or bias[0] or bias[2] > 0.0:
            return "other"
        tolerance = EQUALITY_TOLERANCE * abs(float(gain[0]))
        if gain[0] > 0.0 and abs(gain[0] + bias[1]) <= tolerance:
            return "position"
        return "velocity" if gain[0] > 0.0 and bias[1] == 0.0 and abs(gain[0] + bias[2]) <= tolerance else "other"

    def _note_polynomials(self) -> None:
        """Add notes on nonlinear damping and springs, which MuJoCo has since version 3.6."""
        for field, index, name in (
            ("dof_dampingpoly", self.dof, "damping"),
            ("jnt_stiffnesspoly", self.index, "stiffness"),
            ("jnt_springyield", self.index, "stiffness"),
        ):
            if hasattr(self.model, field) and np.any(getattr(self.model, field)[index]):
                self.notes.append(f"of the joint's {name} the linear part alone is taken along")

    def _smaller(self, limits: Array, attribute: str) -> float:
        """Return the smaller magnitude of two limits; add a note if they are not symmetric."""
        low, high = _pair(limits)
        if abs(low + high) > EQUALITY_TOLERANCE * max(abs(low), abs(high)):
            self.notes.append(
                f"{attribute} {low:g} to {high:g} is not the same both ways; the smaller of the two counts"
            )
        return min(abs(low), abs(high))


def _pair(values: Array) -> tuple[float, float]:
    """Return two values as numbers."""
    return float(values[0]), float(values[1])
