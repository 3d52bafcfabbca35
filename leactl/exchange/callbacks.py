"""Write the Python file of callbacks for one joint: the source that ships here, with the joint's figures inserted."""

from importlib import resources
from pathlib import Path
from textwrap import wrap
from typing import Any

from leactl import __version__
from leactl.exchange.destinations import ACTS_ON, CALLBACKS, CURRENT, MJCF
from leactl.exchange.robot_patch import Patch
from leactl.model.nominal import Model
from leactl.vocabulary.effect import effect_definition

LINE_WIDTH = 110  # characters of a line in the file of callbacks
PARAMETERS_LINE = "PARAMETERS: dict[str, Any] = {}\n"  # line of `mujoco_effects` that gets a joint's parameters


def callbacks(model: Model, patched: Patch, source: Path, into: Path, out: Path) -> str:
    """Return the text of the Python file of callbacks for one joint.

    Parameters
    ----------
    source, into, out : the model file, the user's file and the patched file, whose names the heading gives.
    """
    text = (resources.files("leactl.exchange") / "mujoco_effects.py").read_text(encoding="utf-8")
    body = text.split('"""\n', 1)[1]
    parameters_line = f"PARAMETERS: dict[str, Any] = {_literal(parameters(model, patched))}\n"
    return _heading(patched, source, into, out) + body.replace(PARAMETERS_LINE, parameters_line, 1)


def _literal(value: Any, indent: str = "") -> str:
    """Return a value as Python text; a mapping or list that does not fit on one line gets one line per entry."""
    inner_indent = indent + "    "
    if not isinstance(value, dict | list) or len(indent) + len(repr(value)) < LINE_WIDTH - 10:
        return repr(value)
    if isinstance(value, list):
        lines = [f"{inner_indent}{_literal(item, inner_indent)},\n" for item in value]
        return f"[\n{''.join(lines)}{indent}]"
    lines = [f"{inner_indent}{key!r}: {_literal(item, inner_indent)},\n" for key, item in value.items()]
    return f"{{\n{''.join(lines)}{indent}}}"


def parameters(model: Model, patched: Patch) -> dict[str, Any]:
    """Return the figures of one joint that its callbacks need."""
    entries = [destination.entry for destination in patched.effects if destination.goes_to == CALLBACKS]
    expected, joint = patched.expected, patched.joint
    return {
        "joint": joint.name,
        "coulomb_friction": expected.get("frictionloss", joint.friction),
        "viscous_damping": model.viscous_damping or 0.0,
        "gear_ratio": model.gear_ratio,
        "drive": _drive(model, patched, [entry.effect for entry in entries]),
        "effects": [{"effect": entry.effect, "parameters": dict(entry.parameters)} for entry in entries],
    }


def _drive(model: Model, patched: Patch, effect_names: list[str]) -> dict[str, Any] | None:
    """Return the figures of the actuator's law; None if MuJoCo keeps simulating the actuator."""
    actuator, loop = patched.joint.actuator, model.bench.current_loop_bandwidth or 0.0
    if actuator is None or patched.law is None:
        return None
    has_drive_effect = any(ACTS_ON[effect] != "joint" for effect in effect_names)
    if patched.law == CURRENT and (has_drive_effect or loop):
        constant, gain = model.torque_constant or 1.0, patched.expected.get("gain", actuator.gain)
        return {
            "gear": actuator.gear * gain / actuator.gain,
            "per_ctrl": gain / constant,
            "torque_constant": constant,
            "loop_bandwidth": loop,
            "limits_itself": "torque_limit" in effect_names,
        }
    drive = model.drive
    if drive is None or not (has_drive_effect or drive.damping):
        return None
    return {
        "gear": actuator.gear,
        "per_ctrl": 1.0 / actuator.gear,
        "gain": drive.gain,
        "damping": drive.damping,
        "voltage_limit": drive.voltage_limit,
        "resistance": model.phase_resistance,
        "torque_constant": model.torque_constant,
        "back_emf_constant": model.back_emf_constant or model.torque_constant,
        "limits_itself": True,
    }


def _heading(patched: Patch, source: Path, into: Path, out: Path) -> str:
    """Return the docstring of the file: how to use it, and where each effect is."""
    lines = [
        f"Callbacks for MuJoCo: what acts on joint '{patched.joint.name}' beside what MJCF can hold.",
        "",
        f"Written by leactl {__version__} (leactl model export) from {source.name} for {into.name}.",
        "It needs `mujoco` alone:",
        "",
        f'    model = mujoco.MjModel.from_xml_path("{out.name}")',
        "    data = mujoco.MjData(model)",
        "    effects = install(model)  # ctrl means what it did; effects.remove() takes them off again",
        "    mujoco.mj_step(model, data)",
        "",
    ]
    for destination in patched.effects:
        meaning = effect_definition(destination.entry.effect).meaning
        where = {CALLBACKS: "here", MJCF: f"in {out.name}"}.get(destination.goes_to, f"nowhere, {destination.reason}")
        lines += wrap(f"- {destination.entry.effect} ({where}): {meaning}", LINE_WIDTH, subsequent_indent="  ")
    if not patched.effects:
        lines.append("The model has no effects.")
    text = "\n".join(lines).replace("\\", "\\\\").replace('"""', "'''")
    return f'"""{text}\n"""\n'
