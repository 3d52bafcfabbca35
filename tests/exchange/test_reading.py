"""Joints of MJCF and URDF as model files: figures by hand, what is missing, and what is refused."""

import math
import sys
from pathlib import Path

import pytest

from leactl.errors import InputError
from leactl.exchange.robot_joint import import_joint
from tests.exchange.robots import LEG, MOTOR, arm, chain, leg, written

mujoco = pytest.importorskip("mujoco", reason="MJCF and URDF are read by leactl[mujoco]")

CAPSULE = {"mass": 0.6, "length": 0.15}


def model_of(path, joint="knee", **words):
    return import_joint(path, joint, **words).model


def test_a_pendulum_on_a_position_actuator_is_a_servo_of_that_stiffness_brake_and_limit(tmp_path):
    model = model_of(leg(tmp_path), supply=24.0)
    per_volt = model.torque_constant / model.phase_resistance
    assert per_volt * model.drive.gain == pytest.approx(15.0)
    assert per_volt * model.drive.voltage_limit == pytest.approx(8.0)
    assert per_volt * model.back_emf_constant == pytest.approx(0.6)
    assert (model.drive.voltage_limit, model.torque_constant) == (24.0, model.back_emf_constant)
    assert (model.viscous_damping, model.coulomb_friction) == (0.05, 0.2)
    load = model.load
    assert (load.type, load.mass, load.length) == ("pendulum", CAPSULE["mass"], CAPSULE["length"])
    assert load.level_torque == pytest.approx(0.6 * 9.81 * 0.15)
    radius, half = 0.02, 0.15  # of a capsule: a cylinder and two half balls
    cylinder, balls = math.pi * radius**2 * 2 * half, 4 / 3 * math.pi * radius**3
    rod, ends = (0.6 * part / (cylinder + balls) for part in (cylinder, balls))
    across = rod * ((2 * half) ** 2 / 12 + radius**2 / 4)
    across += ends * (0.4 * radius**2 + half**2 + 0.75 * half * radius)
    assert model.rotor_inertia == pytest.approx(0.01 + across, rel=1e-6)


def test_the_drag_of_a_medium_is_no_damping_of_the_joint(tmp_path):
    path = leg(tmp_path)
    dry = model_of(path, supply=24.0)
    path.write_text(path.read_text().replace("<option ", '<option density="1000" viscosity="0.1" '))
    assert model_of(path, supply=24.0) == dry
    assert any("the medium's drag" in note for note in import_joint(path, "knee", supply=24.0).notes)


@pytest.mark.parametrize(
    ("actuator", "words", "lacks"),
    [
        ("", {}, "no actuator"),
        (MOTOR, {}, "a unit of ctrl makes 1.8 N*m"),
        ('<velocity joint="knee" kv="2"/>', {}, "velocity actuator"),
        ('<muscle joint="knee"/>', {}, "another law"),
        ('<position joint="knee" kp="15" kv="1" forcerange="-8 8"/>', {}, "give --supply"),
        ('<position joint="knee" kp="15" kv="1"/>', {"supply": 12.0}, "forcerange"),
    ],
)
def test_what_no_file_says_of_the_motor_is_told_as_missing(tmp_path, actuator, words, lacks):
    imported = import_joint(leg(tmp_path, actuator), "knee", **words)
    assert lacks in imported.missing["torque_constant"] + imported.missing.get("drive", "")
    assert imported.model.torque_constant is imported.model.drive is None
    for key in imported.missing:
        assert f"# not in that file: {key}: " in imported.text
    assert {"gear_ratio", "thermal", "encoder_lines"} <= set(imported.missing)


def test_a_zero_that_is_mujoco_s_default_says_nothing(tmp_path):
    plain = leg(tmp_path, "")
    plain.write_text(plain.read_text().replace('damping="0.05"', "").replace('frictionloss="0.2"', ""))
    imported = import_joint(plain, "knee")
    assert imported.model.viscous_damping is imported.model.coulomb_friction is None
    assert {"viscous_damping", "coulomb_friction"} <= set(imported.missing)


def test_a_servo_without_kv_has_the_joint_s_damping_as_its_back_emf(tmp_path):
    imported = import_joint(leg(tmp_path, '<position joint="knee" kp="15" forcerange="-8 8"/>'), "knee", 12.0)
    model = imported.model
    assert model.torque_constant**2 / model.phase_resistance == pytest.approx(0.05)
    assert model.viscous_damping is None
    assert any("back-EMF" in note for note in imported.notes)


@pytest.mark.parametrize("kind", ["position", "general"])
def test_a_gear_scales_angle_and_force(tmp_path, kind):
    law = 'kp="15" kv="0.6"' if kind == "position" else 'gainprm="15" biastype="affine" biasprm="0 -15 -0.6"'
    actuator = f'<{kind} joint="knee" {law} gear="-3" forcerange="-8 8"/>'
    imported = import_joint(leg(tmp_path, actuator), "knee", supply=24.0)
    model = imported.model
    per_volt = model.torque_constant / model.phase_resistance
    assert per_volt * model.drive.gain == pytest.approx(9 * 15.0)
    assert per_volt * model.back_emf_constant == pytest.approx(9 * 0.6)
    assert per_volt * 24.0 == pytest.approx(3 * 8.0)
    assert any("-3 times the angle" in note for note in imported.notes)


def test_ctrl_that_is_a_current_gives_the_torque_constant_and_the_loop(tmp_path):
    lagging = '<general joint="knee" gainprm="1.8" dyntype="filterexact" dynprm="0.002"/>'
    model = model_of(leg(tmp_path, lagging), ctrl_is_current=True)
    assert model.torque_constant == 1.8
    assert model.bench.current_loop_bandwidth == pytest.approx(1 / (2 * math.pi * 0.002))
    with pytest.raises(InputError, match="no torque actuator"):
        import_joint(leg(tmp_path), "knee", ctrl_is_current=True)
    with pytest.raises(InputError, match="no position actuator"):
        import_joint(leg(tmp_path, MOTOR), "knee", supply=12.0)


def test_an_arm_s_weight_is_the_cosine_of_its_angle_above_level(tmp_path):
    model = model_of(arm(tmp_path), "elbow")
    load = model.load
    assert (load.type, model.viscous_damping, model.coulomb_friction) == ("arm", 0.1, 0.2)
    assert load.level_torque == pytest.approx(1.5 * 9.81 * 0.2)
    assert abs(math.cos(load.zero_angle)) == pytest.approx(1.0)  # level at zero
    assert model.rotor_inertia + load.inertia == pytest.approx(0.02 + 1.5 * 0.2**2)
    # URDF's axis points away: a positive angle lowers the arm, which hangs at a quarter turn
    assert math.remainder(load.hanging_angle - 0.5 * math.pi, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)


def test_a_reference_angle_counts_from_where_the_file_draws_the_joint(tmp_path):
    turned = leg(tmp_path)
    turned.write_text(turned.read_text().replace('range="-2 2"', 'ref="0.3" stiffness="2" springref="0.5"'))
    model = model_of(turned)
    assert model.load.hanging_angle == pytest.approx(0.3)
    (spring,) = model.effects
    assert (spring.effect, spring.parameters) == ("position_spring", {"stiffness": 2.0, "rest_angle": 0.5})


def test_a_hip_carries_the_shank_where_the_file_has_it_and_a_free_trunk_does_not_count(tmp_path):
    floating = import_joint(chain(tmp_path, trunk="<freejoint/>"), "hip")
    held = import_joint(chain(tmp_path), "hip")
    assert floating.joint.inertia == pytest.approx(held.joint.inertia)
    assert held.model.load.mass == pytest.approx(0.9)
    assert any("knee" in note for note in held.notes)
    assert not any("hip" in note for note in import_joint(chain(tmp_path), "knee").notes)


def test_a_slide_is_told_in_newtons_and_its_weight_noted(tmp_path):
    lift = leg(tmp_path, "")
    lift.write_text(lift.read_text().replace('type="hinge" axis="0 1 0"', 'type="slide" axis="0 0 1"'))
    imported = import_joint(lift, "knee")
    assert imported.model.units["N*m"] == "N"
    assert imported.model.rotor_inertia == pytest.approx(0.6 + 0.01)
    assert imported.model.load.type == "none"
    assert any("5.886 N" in note for note in imported.notes)


def test_what_compensates_gravity_takes_the_weight_off(tmp_path):
    light = leg(tmp_path)
    light.write_text(light.read_text().replace('name="thigh"', 'name="thigh" gravcomp="1"'))
    assert model_of(light).load.type == "none"


REFUSED = [
    ({"trunk": '<joint name="ball" type="ball"/>'}, "ball", "is a ball joint; a hinge or slide was expected"),
    ({"trunk": '<freejoint name="root"/>'}, "root", "is a free joint"),
    ({}, "kne", "no joint 'kne'; did you mean 'knee'?"),
    ({}, "wrist", "no joint 'wrist'; known: hip, knee"),
    (
        {"more": '<equality><joint joint1="knee" joint2="hip"/></equality>'},
        "hip",
        "is tied to another by an equality constraint",
    ),
    (
        {"more": '<equality><connect body1="shank" body2="wall" anchor="0 0 0"/></equality>'},
        "hip",
        "is part of a loop that an equality closes",
    ),
    (
        {"more": '<equality><connect site1="foot" site2="hook"/></equality>'},
        "knee",
        "is part of a loop that an equality closes",
    ),
    (
        {"more": '<tendon><fixed name="strap" stiffness="3"><joint joint="knee" coef="1"/></fixed></tendon>'},
        "knee",
        "tendon 'strap' acts on joint 'knee'",
    ),
    (
        {"more": '<actuator><motor name="a" joint="knee"/><velocity name="b" joint="knee" kv="1"/></actuator>'},
        "knee",
        "several actuators act on joint 'knee': 'a', 'b'",
    ),
    (
        {"more": '<actuator><motor name="pull" site="foot" gear="1 0 0 0 0 0"/></actuator>'},
        "knee",
        "actuator 'pull' acts on joint 'knee' from outside",
    ),
    ({"more": '<actuator><motor joint="knee" gear="0"/></actuator>'}, "knee", "has gear 0"),
]


@pytest.mark.parametrize(("parts", "joint", "line"), REFUSED)
def test_a_joint_that_no_model_file_describes_is_refused_in_one_line(tmp_path, parts, joint, line):
    path = chain(tmp_path, **parts)
    with pytest.raises(InputError) as fault:
        import_joint(path, joint)
    assert str(fault.value).startswith(f"{path}: ")
    assert line in str(fault.value)
    assert "\n" not in str(fault.value)


ALLOWED = [
    '<equality><connect body1="trunk" body2="wall" anchor="0 0 0"/></equality>',
    '<equality><connect active="false" body1="shank" body2="wall" anchor="0 0 0"/></equality>',
    '<tendon><fixed name="gauge"><joint joint="knee" coef="1"/></fixed></tendon>',
    '<actuator><motor joint="hip"/><motor joint="hip"/></actuator>',
]


@pytest.mark.parametrize("more", ALLOWED)
def test_what_does_not_act_on_the_joint_is_no_reason_to_refuse_it(tmp_path, more):
    assert import_joint(chain(tmp_path, more=more), "knee").model.rotor_inertia > 0.0


def test_a_mimicking_joint_is_refused_and_the_one_it_follows(tmp_path):
    path = arm(tmp_path, '<mimic joint="shoulder"/>')
    shoulder = (
        '<link name="upper"/><joint name="shoulder" type="fixed"><parent link="base"/><child link="upper"/></joint>'
    )
    path.write_text(path.read_text().replace("</robot>", shoulder + "</robot>"))
    with pytest.raises(InputError, match="elbow' is tied to another by <mimic>"):
        import_joint(path, "elbow")
    assert not (Path.cwd() / "MUJOCO_LOG.TXT").exists()  # where MuJoCo puts its warnings


BROKEN = [
    ("<mujoco><worldbody></mujoco>", ":1:", "no XML: mismatched tag"),
    ('<!DOCTYPE a [<!ENTITY b "c">]><mujoco/>', ":1:", "<!DOCTYPE> is not accepted"),
    ("<sdf/>", ":1:1", "<mujoco> or <robot> was expected"),
    ("<mujoco><nonsense/></mujoco>", ": ", "MuJoCo does not compile it"),
    (LEG.format(actuator='<motor joint="ankle"/>', timestep="0.001"), ": ", "MuJoCo does not compile it"),
    ("", ":1:", "no XML"),
]


@pytest.mark.parametrize(("text", "place", "line"), BROKEN)
def test_a_file_that_is_none_is_one_line(tmp_path, text, place, line):
    path = written(tmp_path / "robot.xml", text)
    with pytest.raises(InputError) as fault:
        import_joint(path, "knee")
    assert str(fault.value).startswith(f"{path}{place}")
    assert line in str(fault.value)
    assert "\n" not in str(fault.value)
    with pytest.raises(InputError, match="No such file"):
        import_joint(tmp_path / "absent.xml", "knee")


def test_without_mujoco_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'leactl\[mujoco\]'"):
        import_joint(leg(tmp_path), "knee")
