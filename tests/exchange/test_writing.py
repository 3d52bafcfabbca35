"""Patches of MJCF and URDF: what MuJoCo reads of them, what stays as it was, and what does not fit."""

import difflib
import math

import pytest
import yaml

from leactl.errors import InputError
from leactl.exchange.compiled import read_joint
from leactl.exchange.export_request import ExportRequest, export
from leactl.exchange.robot_joint import import_joint
from leactl.model.nominal import Model
from tests.exchange.robots import MOTOR, SERVO, arm, chain, leg, written

mujoco = pytest.importorskip("mujoco", reason="what is patched is compiled by leactl[mujoco]")


def nominal(path, joint="knee", **words):
    """The model of a joint's file, with some keys changed."""
    supply, current = words.pop("supply", None), words.pop("current", False)
    return yaml.safe_load(import_joint(path, joint, supply, current).text) | words


def exported(folder, document, into, to="mjcf", joint="knee", **words):
    """Patch a file; gives what was exported and the joint that MuJoCo reads."""
    model, out = folder / "augmented.yaml", folder / f"out{into.suffix}"
    model.write_text(yaml.safe_dump(document))
    answer = export(ExportRequest(model, to, into, joint, out, **words))
    return answer, read_joint(out, joint)


def changed_lines(before, after):
    lines = difflib.unified_diff(before.read_text().splitlines(), after.read_text().splitlines(), n=0, lineterm="")
    return [line for line in lines if line[0] in "+-" and line[1] == " "]


def test_calibrated_figures_are_read_by_mujoco_and_all_else_stays(tmp_path):
    robot = leg(tmp_path)
    document = nominal(robot, supply=24.0, coulomb_friction=0.31, viscous_damping=0.08)
    document["rotor_inertia"] += 0.004
    document["drive"]["gain"] *= 1.2
    answer, joint = exported(tmp_path, document, robot)
    assert (joint.armature, joint.friction, joint.damping) == pytest.approx((0.014, 0.31, 0.08 + 0.6))
    assert joint.inertia == pytest.approx(document["rotor_inertia"] + 0.6 * 0.15**2)
    assert (joint.actuator.kp, joint.actuator.kv, joint.actuator.force_limit) == pytest.approx((18.0, 0.0, 8.0))
    assert changed_lines(robot, tmp_path / "out.xml") == [
        '-      <joint name="knee" type="hinge" axis="0 1 0" armature="0.01" frictionloss="0.2"',
        '-             range="-2 2"/>',
        '+      <joint name="knee" type="hinge" axis="0 1 0" armature="0.014" frictionloss="0.31"',
        '+             range="-2 2" damping="0.68" solreffriction="0.002 1" solimpfriction="0.999 0.9999 0.001"/>',
        '-    <position name="servo" joint="knee" kp="15" kv="0.6" forcerange="-8 8"/> <!-- by hand -->',
        '+    <position name="servo" joint="knee" kp="18" kv="0" forcerange="-8 8"/> <!-- by hand -->',
    ]
    told = {(change.element, change.attribute): (change.before, change.after) for change in answer.patched.changes}
    assert told["position 'servo'", "kp"] == ("15", "18")
    assert told["joint 'knee'", "damping"] == (None, "0.68")
    again = import_joint(tmp_path / "out.xml", "knee", supply=24.0).model
    assert again.rotor_inertia == pytest.approx(document["rotor_inertia"])
    assert again.load == Model(**document).load


def test_bodies_heavier_than_the_model_leave_no_armature_and_a_note(tmp_path):
    robot = leg(tmp_path)
    document = nominal(robot, supply=24.0, rotor_inertia=0.001)
    answer, joint = exported(tmp_path, document, robot)
    assert joint.armature == 0.0
    assert any("the bodies alone have an inertia" in note for note in answer.patched.notes)


def test_a_load_of_another_weight_is_noted(tmp_path):
    robot = leg(tmp_path)
    answer, _ = exported(tmp_path, {"name": "knee", "rotor_inertia": 0.03}, robot)
    assert any("bodies weigh 0.8829 N*m, the model's load 0 N*m" in note for note in answer.patched.notes)


@pytest.mark.parametrize("compiler", ['<compiler angle="radian"/>', "", '<compiler angle="degree"/>'])
def test_a_spring_goes_into_the_file_in_its_own_unit_of_angle(tmp_path, compiler):
    robot = leg(tmp_path, "")
    robot.write_text(robot.read_text().replace('<compiler angle="radian"/>', compiler))
    spring = {"effect": "position_spring", "parameters": {"stiffness": 3.0, "rest_angle": 0.4}}
    answer, joint = exported(tmp_path, nominal(robot, effects=[spring]), robot)
    assert (joint.stiffness, joint.spring_rest) == pytest.approx((3.0, 0.4))
    assert answer.patched.effects[0].goes_to == "mjcf"
    (tmp_path / "out.xml").unlink()
    spring["parameters"]["reach"] = 1.0
    answer, _ = exported(tmp_path, nominal(robot, effects=[spring]), robot)
    assert answer.patched.effects[0].goes_to == "callbacks"


def test_a_general_actuator_with_a_gear_keeps_its_law(tmp_path):
    law = '<general joint="knee" gainprm="15" biastype="affine" biasprm="0 -15 -0.6" gear="-3" forcerange="-8 8"/>'
    robot = leg(tmp_path, law)
    document = nominal(robot, supply=24.0)
    document["drive"]["gain"] *= 0.5
    _, joint = exported(tmp_path, document, robot)
    assert (joint.actuator.kp, joint.actuator.kv) == pytest.approx((0.5 * 9 * 15.0, 0.0))
    assert (joint.damping, joint.actuator.force_limit) == pytest.approx((0.05 + 9 * 0.6, 24.0))


def test_a_default_class_does_not_stand_against_a_figure(tmp_path):
    robot = leg(tmp_path, '<position joint="knee" kp="15" forcerange="-8 8"/>')
    robot.write_text(robot.read_text().replace("</default>", '<position kv="0.6"/></default>'))
    _, joint = exported(tmp_path, nominal(robot, supply=24.0), robot)
    assert (joint.actuator.kv, joint.damping) == pytest.approx((0.0, 0.65))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_ctrl_in_amperes_gets_the_calibrated_torque_constant_as_its_gain(tmp_path, sense):
    robot = leg(tmp_path, f'<motor joint="knee" gear="{sense * 1.8} 0 0 0 0 0"/>')
    document = nominal(robot, current=True, torque_constant=1.62)
    _, joint = exported(tmp_path, document, robot, ctrl_is_current=True)
    assert joint.actuator.gain == pytest.approx(sense * 1.62)
    (tmp_path / "out.xml").unlink()
    _, joint = exported(tmp_path, document, robot)
    assert joint.actuator.gain == sense * 1.8


def test_a_urdf_gets_damping_friction_and_what_is_left_out_is_told(tmp_path):
    for dynamics in ('<dynamics damping="0.1" friction="0.2"/>', ""):
        robot = arm(tmp_path, dynamics)
        document = nominal(robot, "elbow", viscous_damping=0.3, coulomb_friction=0.4)
        document["rotor_inertia"] += 0.01
        document["effects"] = [{"effect": "quadratic_drag", "parameters": {"coefficient": 0.1}}]
        answer, joint = exported(tmp_path, document, robot, "urdf", "elbow")
        assert (joint.damping, joint.friction) == (0.3, 0.4)
        assert answer.patched.effects[0].reason == "URDF has no word for it"
        assert any("no armature; 0.01 kg*m^2" in note for note in answer.patched.notes)
        (tmp_path / "out.urdf").unlink()


FAULTS = [
    (MOTOR, {"drive": {"type": "position_servo", "gain": 9.0, "voltage_limit": 12.0}}, "a <position> actuator on"),
    (
        SERVO,
        {"drive": {"type": "position_servo", "voltage_limit": 12.0}, "torque_constant": None},
        "servo needs torque_c",
    ),
    ("", {"drive": {"type": "position_servo", "gain": 9.0, "voltage_limit": 12.0}}, "joint 'knee' has none"),
    (SERVO, {"effects": [{"effect": "cogging", "parameters": {"order": 3.0}}]}, "effect cogging has no 'amplitude'"),
]


@pytest.mark.parametrize(("actuator", "keys", "line"), FAULTS)
def test_a_model_that_does_not_fit_the_file_writes_nothing(tmp_path, actuator, keys, line):
    robot = leg(tmp_path, actuator)
    document = {"name": "knee", "torque_constant": 1.0, "phase_resistance": 1.0, "rotor_inertia": 0.03} | keys
    document = {key: value for key, value in document.items() if value is not None}
    with pytest.raises(InputError, match=line):
        exported(tmp_path, document, robot, callbacks=tmp_path / "knee.py")
    assert {path.name for path in tmp_path.iterdir()} == {"robot.xml", "augmented.yaml"}


def test_a_joint_that_stands_in_an_included_file_is_named_as_such(tmp_path):
    text = leg(tmp_path).read_text()
    body = text[text.index("    <body") : text.index("  </worldbody>")]
    written(tmp_path / "thigh.xml", f"<mujocoinclude>{body}</mujocoinclude>")
    robot = written(tmp_path / "whole.xml", text.replace(body, '<include file="thigh.xml"/>'))
    document = nominal(robot, supply=24.0)
    with pytest.raises(InputError, match="not written in this file, but included"):
        exported(tmp_path, document, robot)


def test_what_does_not_compile_at_its_new_place_is_not_written(tmp_path):
    robot = leg(tmp_path)
    (tmp_path / "image.png").write_bytes(b"")
    field = '<asset><hfield name="floor" file="floor.png" size="1 1 1 1"/></asset>'
    document = nominal(robot, supply=24.0)
    robot.write_text(robot.read_text().replace("<worldbody>", field + "<worldbody>"))
    with pytest.raises(InputError, match="does not compile"):
        exported(tmp_path, document, robot)
    with pytest.raises(InputError, match=r"is MJCF; --to urdf was asked for"):
        exported(tmp_path, document, leg(tmp_path), to="urdf")
    assert not (tmp_path / "out.xml").exists()


def test_a_figure_that_the_file_keeps_mujoco_from_reading_is_told_of(tmp_path):
    robot = leg(tmp_path)
    robot.write_text(robot.read_text().replace("</mujoco>", '<compiler angle="degree"/></mujoco>'))
    robot.write_text(robot.read_text().replace('range="-2 2"', ""))
    spring = {"effect": "position_spring", "parameters": {"stiffness": 3.0, "rest_angle": 0.4}}
    with pytest.raises(InputError, match="MuJoCo reads springref"):
        exported(tmp_path, nominal(robot, supply=24.0, effects=[spring]), robot)
    assert not (tmp_path / "out.xml").exists()


NAMES = ["knee", "left knee", "'knee'", "k\\nee", '"""', "Knie-Ä", "a\nb"]


@pytest.mark.parametrize("name", NAMES)
def test_callbacks_of_a_joint_of_any_name_are_python(tmp_path, name):
    robot, odd = leg(tmp_path), name.replace("&", "&amp;").replace('"', "&quot;").replace("\n", "&#10;")
    robot.write_text(robot.read_text().replace('"knee"', f'"{odd}"'))
    drag = {"effect": "quadratic_drag", "parameters": {"coefficient": 0.5}}
    document = nominal(robot, name, supply=24.0, effects=[drag])
    exported(tmp_path, document, robot, joint=name, callbacks=tmp_path / "knee.py")
    module = {"__name__": "knee"}
    exec(compile((tmp_path / "knee.py").read_text(), "knee.py", "exec"), module)
    assert module["PARAMETERS"]["joint"] == name
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out.xml"))
    effects, state = module["install"](model), mujoco.MjData(model)
    try:
        state.qvel[0] = 2.0
        mujoco.mj_forward(model, state)
    finally:
        effects.remove()
    assert float(state.qfrc_passive[0]) == pytest.approx(-0.65 * 2.0 - 0.5 * 4.0)
    assert effects.drive is None  # no effect acts on the drive, whose law stays MuJoCo's


def test_a_joint_among_others_is_patched_alone(tmp_path):
    robot = chain(tmp_path, trunk="<freejoint/>", hip=' damping="1"', knee=' damping="2" frictionloss="0.1"')
    document = nominal(robot, "knee", coulomb_friction=0.2)
    exported(tmp_path, document, robot)
    assert len(changed_lines(robot, tmp_path / "out.xml")) == 2
    assert math.isclose(read_joint(tmp_path / "out.xml", "hip").damping, 1.0)
