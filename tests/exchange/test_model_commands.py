"""`leactl model import` and `leactl model export` at the command line."""

import json

import pytest
import yaml

from tests.cli.terminal import leactl
from tests.exchange.robots import MOTOR, arm, leg

pytest.importorskip("mujoco", reason="robots are read by leactl[mujoco]")

EFFECTS = [
    {"effect": "stribeck", "parameters": {"breakaway_ratio": 0.5, "stribeck_velocity": 0.3}},
    {"effect": "transport_delay", "parameters": {"delay": 0.008}},
    {"effect": "joint_elasticity", "parameters": {"share": 0.5, "frequency": 20.0}},
]


@pytest.fixture
def augmented(tmp_path):
    """A robot, and its knee's model with effects."""
    robot, nominal = leg(tmp_path), tmp_path / "nominal.yaml"
    done = leactl("model", "import", robot, "--joint", "knee", "--supply", "24", "--out", nominal)
    assert (done.returncode, done.stdout) == (0, f"{nominal}\n")
    model = tmp_path / "augmented.yaml"
    model.write_text(yaml.safe_dump(yaml.safe_load(nominal.read_text()) | {"effects": EFFECTS}))
    return model


def test_a_model_is_printed_and_what_is_missing_goes_to_stderr(tmp_path):
    done = leactl("model", "import", leg(tmp_path, MOTOR), "--joint", "knee", "--ctrl", "current")
    assert yaml.safe_load(done.stdout)["torque_constant"] == 1.8
    assert "missing: phase_resistance: the winding\n" in done.stderr
    assert "note: the torque is limited to 7.2 N*m" in done.stderr


def test_json_has_the_model_the_joint_and_what_is_missing(tmp_path):
    answer = json.loads(leactl("model", "import", arm(tmp_path), "--joint", "elbow", "--json").stdout)
    assert answer["file"] is None
    assert answer["model"]["load"]["type"] == "arm"
    assert (answer["joint"]["type"], answer["joint"]["torque_limit"], answer["actuator"]) == ("hinge", 12.0, None)
    missing = {entry["key"]: entry["reason"] for entry in answer["missing"]}
    assert missing["torque_constant"] == "no actuator is on the joint"


def test_an_export_says_where_everything_went(augmented, tmp_path):
    robot, out, code = tmp_path / "robot.xml", tmp_path / "new.xml", tmp_path / "knee.py"
    words = ("model", "export", augmented, "--to", "mjcf", "--into", robot, "--out", out, "--callbacks", code)
    done = leactl(*words)
    assert (done.returncode, done.stdout) == (0, f"{out}\n{code}\n")
    assert "line 9: joint 'knee': damping not given -> 0.65\n" in done.stderr
    assert "line 15: position 'servo': kv 0.6 -> 0\n" in done.stderr
    assert "stribeck: in the callbacks\n" in done.stderr
    assert "joint_elasticity: left out: a second body behind the joint" in done.stderr
    again = leactl(*words)
    assert again.returncode == 2
    assert again.stderr.count("never overwritten") == 1
    assert "never overwritten" in leactl(*words[:-4], "--out", tmp_path / "b.xml", *words[-2:]).stderr
    assert not (tmp_path / "b.xml").exists()
    answer = json.loads(leactl(*words[:-4], "--out", tmp_path / "c.xml", "--json").stdout)
    assert answer["written"] == [str(tmp_path / "c.xml")]
    assert [(effect["effect"], effect["goes_to"]) for effect in answer["effects"]] == [
        ("stribeck", "callbacks"),
        ("transport_delay", "callbacks"),
        ("joint_elasticity", "nowhere"),
    ]
    assert {"element", "line", "attribute", "before", "after"} == set(answer["changes"][0])


def test_without_callbacks_their_effects_are_told_as_left_out(augmented, tmp_path):
    words = ("--to", "mjcf", "--into", tmp_path / "robot.xml", "--out", tmp_path / "new.xml")
    assert "stribeck: left out: give --callbacks FILE.py" in leactl("model", "export", augmented, *words).stderr


def test_a_table_has_figures_effects_and_the_delay_in_steps(augmented, tmp_path):
    table = json.loads(leactl("model", "export", augmented, "--to", "json", "--timestep", "0.002").stdout)
    assert (table["format"], table["joint"]) == ("leactl-actuator", "knee")
    assert table["delay"] == {"delay_s": 0.008, "timestep_s": 0.002, "steps": 4}
    assert table["friction"]["static_Nm"] == pytest.approx(1.5 * table["friction"]["dynamic_Nm"])
    actuator = table["actuator"]
    assert (actuator["stiffness_Nm_per_rad"], actuator["effort_limit_Nm"]) == pytest.approx((15.0, 8.0))
    first = table["effects"][0]
    assert first["parameters"][2]["value"] == 1.0  # a shape's default
    out = tmp_path / "knee.json"
    done = leactl("model", "export", augmented, "--to", "json", "--out", out, "--joint", "left")
    assert (done.returncode, json.loads(out.read_text())["joint"]) == (0, "left")


WRONG = [
    (("import", "robot.xml", "--joint", "kne"), "no joint 'kne'; did you mean 'knee'?"),
    (("import", "absent.xml", "--joint", "knee"), "absent.xml: No such file"),
    (("import", "robot.xml", "--joint", "knee", "--out", "robot.xml"), "never overwritten"),
    (("import", "robot.xml", "--joint", "knee", "--supply", "nan"), "invalid value for '--supply'"),
    (("export", "augmented.yaml", "--to", "mjcf"), "--to mjcf needs --into"),
    (("export", "augmented.yaml", "--to", "json", "--into", "robot.xml"), "--into does not go with --to json"),
    (("export", "robot.xml", "--to", "json"), "robot.xml"),
    (
        ("export", "augmented.yaml", "--to", "mjcf", "--into", "robot.xml", "--out", "a.xml", "--callbacks", "a.txt"),
        "a file named .py was expected",
    ),
    (
        ("export", "augmented.yaml", "--to", "mjcf", "--into", "robot.xml", "--out", "none/a.xml"),
        "none/a.xml: no folder none",
    ),
    (
        ("export", "augmented.yaml", "--to", "mjcf", "--into", "robot.xml", "--joint", "hip", "--out", "a.xml"),
        "no joint 'hip'",
    ),
]


@pytest.mark.parametrize(("words", "line"), WRONG)
def test_wrong_words_are_a_clear_line_and_status_2(augmented, tmp_path, monkeypatch, words, line):
    monkeypatch.chdir(tmp_path)
    before = sorted(path.name for path in tmp_path.iterdir())
    done = leactl("model", *words)
    assert done.returncode == 2
    assert line in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == before
