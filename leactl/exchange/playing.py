"""Simulate runs in the user's MuJoCo model: `ctrl` gets each reference, and the angle is read at each time stamp."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.exchange.compiled import compile_file, import_mujoco, joint_of, warnings_of
from leactl.gap.servo.runs import starting_speed
from leactl.gap.signals.record import Clocked, Record

Array = npt.NDArray[np.float64]
HELD_INERTIA_FACTOR = 1e6  # armature of other joints, which holds them, over the joint's inertia or 1 kg*m^2
ANGLE_REFERENCE, ANGLE = ("angle_reference", "test"), ("angle", "test")


def check_playable(records: Sequence[Record]) -> None:
    """Raise InputError if runs cannot be simulated with a position actuator.

    Raises
    ------
    InputError : a line for each run without an angle or its reference.
    """
    faults = [
        f"{record.path}: no {quantity} of test; a run of a position servo was expected"
        for record in records
        for quantity, _ in (ANGLE, ANGLE_REFERENCE)
        if record.fast is None or record.fast.get(quantity) is None
    ]
    if faults:
        raise InputError(faults)


def play(
    robot: Path, name: str, records: Sequence[Record], install: Callable[[Any], Any] | None = None
) -> tuple[Array, ...]:
    """Return the angle [rad] of a joint at the time stamps of each run, from the run's first measured state on.

    `ctrl` keeps the reference of each time stamp until the next. Other joints stay at their positions in the file.

    Parameters
    ----------
    install : installs callbacks on a compiled model and returns an object whose `remove` uninstalls them.

    Raises
    ------
    InputError : the file cannot be compiled, no position actuator drives the joint, or a motion grows without bounds.
    """
    mujoco = import_mujoco()
    compiled = compile_file(robot)
    model, joint = compiled.model, joint_of(compiled, name)
    actuator = joint.actuator
    if actuator is None or actuator.kind != "position":
        raise InputError(f"{robot}: no position actuator drives joint '{name}'; runs of other drives are not played")
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    dof, position = int(model.jnt_dofadr[index]), int(model.jnt_qposadr[index])
    other_dofs = np.arange(model.nv) != dof
    model.dof_armature[other_dofs] = HELD_INERTIA_FACTOR * np.maximum(joint.inertia, 1.0)
    control = int(getattr(model, "actuator_ctrladr", range(actuator.index + 1))[actuator.index])
    played = []
    effects = None if install is None else install(model)
    try:
        with warnings_of(mujoco):
            for record in records:
                assert record.fast is not None
                state = mujoco.MjData(model)
                measured = record.fast.values[ANGLE]
                state.qpos[position] = measured[0]
                state.qvel[dof] = starting_speed(measured, record.fast.interval)
                control_values = actuator.gear * record.fast.values[ANGLE_REFERENCE]
                played.append(_angles(mujoco, model, state, (position, control), record.fast, control_values))
                if not np.all(np.isfinite(played[-1])):
                    raise InputError(f"{robot}: joint '{name}' moves beyond all bounds in {record.path.name}")
    finally:
        if effects is not None:
            effects.remove()
    return tuple(played)


def _angles(
    mujoco: Any, model: Any, state: Any, addresses: tuple[int, int], clock: Clocked, control_values: Array
) -> Array:
    """Return the angle [rad] at each time stamp, interpolated between steps; all NaN if the motion is unstable.

    addresses : of the joint's position in qpos, and of its actuator in ctrl.
    """
    position, control = addresses
    stamps, angles = (clock.time - clock.time[0]).tolist(), []
    time_before, angle = 0.0, float(state.qpos[position])
    angle_before = angle
    for stamp, value in zip(stamps, control_values.tolist(), strict=True):
        while state.time < stamp - 1e-9:
            time_before, angle_before = float(state.time), float(state.qpos[position])
            mujoco.mj_step(model, state)
            if state.time <= time_before or any(warning.number for warning in _unstable(mujoco, state)):
                return np.full(len(stamps), np.nan)  # MuJoCo resets the state of an unstable motion
        angle = float(state.qpos[position])
        share = (stamp - time_before) / (state.time - time_before) if state.time > time_before else 1.0
        angles.append(angle_before + min(share, 1.0) * (angle - angle_before))
        state.ctrl[control] = value
    return np.array(angles, np.float64)


def _unstable(mujoco: Any, state: Any) -> list[Any]:
    """Return MuJoCo's warnings of an unstable motion, with the number of times that each was raised."""
    kinds = mujoco.mjtWarning
    return [state.warning[int(kind)] for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)]


def rms_of_error(records: Sequence[Record], played: Sequence[Array]) -> list[float]:
    """Return the RMS error of the angle [rad] of each run, over its valid samples."""
    errors = []
    for record, angles in zip(records, played, strict=True):
        assert record.fast is not None
        error = (angles - record.fast.values[ANGLE])[record.fast.all_valid(ANGLE, ANGLE_REFERENCE)]
        errors.append(math.sqrt(float(np.mean(error**2))))
    return errors
