"""Model files of robot joints: arms, gears, and motors whose torques are told in volts."""

import pytest

from leactl.errors import InputError
from leactl.gap.planning.advice import advise
from leactl.model.motor import load_motor
from leactl.model.nominal import Model, as_mapping, read_model

ARM = "load: {type: arm, mass: 2.0, length: 0.5, zero_angle: 0.2}\n"
FED = "name: arm\nfeedforward: {kS: 0.2, kV: 1.1, kA: 0.05}\n"
WHOLE = "name: joint\ngear_ratio: 47\n" + ARM + "transmission: {stiffness: 300, damping: 1.0}\n"


def read(folder, text):
    path = folder / "joint.yaml"
    path.write_text(text)
    return read_model(path)[0]


def test_a_joint_is_read_with_its_gear_its_arm_and_what_gives_between(tmp_path):
    joint = read(tmp_path, WHOLE)
    assert (joint.gear_ratio, joint.transmission.stiffness) == (47, 300)
    assert joint.load.level_torque == pytest.approx(2.0 * 9.80665 * 0.5)
    assert joint.load.inertia == pytest.approx(0.5)
    assert Model.model_validate(as_mapping(joint)) == joint


def test_an_arm_hangs_down_where_gravity_does_no_work_at_its_lowest(tmp_path):
    """Gravity takes m g l cos(angle + zero_angle): nothing straight down, all of it where the arm is level."""
    load = read(tmp_path, WHOLE).load
    assert load.hanging_angle == pytest.approx(-0.2 - 0.5 * 3.14159265)
    assert Model(name="none").load.level_torque == 0.0


def test_a_feedforward_stands_for_inertia_and_friction_and_is_written_as_it_was(tmp_path):
    fed = read(tmp_path, FED)
    assert (fed.rotor_inertia, fed.coulomb_friction, fed.torque_constant) == (0.05, 0.2, None)
    assert as_mapping(fed) == {"name": "arm", "feedforward": {"kS": 0.2, "kV": 1.1, "kA": 0.05}}
    assert fed.units_of("N*m*s^2/rad^2") == "V*s^2/rad^2"
    assert Model(name="m").units_of("N*m") == "N*m"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (FED + "rotor_inertia: 0.1\ntorque_constant: 0.2\n", "leave out torque_constant, rotor_inertia"),
        (FED + ARM, "those of `feedforward:` are in V"),
        ("name: a\nfeedforward: {kS: 0.2, kV: 1.1}\n", "kA"),
        ("name: a\nfeedforward: {kS: -0.2, kV: 1.1, kA: 0.1}\n", "feedforward.kS"),
        ("name: a\ngear_ratio: 0\n", "gear_ratio"),
        ("name: a\nload: {type: arm, mass: 2.0}\n", "an arm has a mass and a length"),
        ("name: a\nload: {type: arm, mass: 2.0, length: 1.0, arm_mass: 0.1}\n", "is a pendulum's"),
        ("name: a\nload: {type: pendulum, mass: 2.0, length: 1.0, zero_angle: 0.1}\n", "is an arm's"),
        ("name: a\ntransmission: {damping: 1.0}\n", "transmission.stiffness"),
    ],
)
def test_what_makes_no_sense_is_one_line_with_its_place(tmp_path, text, told):
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    (fault,) = caught.value.faults
    assert told in fault
    assert fault.startswith(f"{tmp_path / 'joint.yaml'}:")


@pytest.mark.parametrize("text", [FED, WHOLE])
def test_what_moves_or_guards_a_bench_refuses_a_joint_s_model(tmp_path, text):
    path = tmp_path / "joint.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_motor(str(path))
    assert any("unknown key" in fault for fault in caught.value.faults)


def test_a_joint_s_protocols_are_not_planned(tmp_path):
    path = tmp_path / "joint.yaml"
    path.write_text(FED)
    with pytest.raises(InputError) as caught:
        advise(path, [], ["friction"], {})
    assert "cannot be planned" in " ".join(caught.value.faults)
