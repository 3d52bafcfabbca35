"""`leactl gap loop`: three withheld effects of a leg are named, and its MuJoCo model follows held-out runs."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from leactl.exchange.playing import play
from leactl.gap.signals.record import Clocked, Record
from tests.cli.answers import fits_the_page
from tests.cli.terminal import leactl
from tests.exchange.robots import MOTOR, chain, leg
from tests.exchange.withheld import KINDS, Leg, recorded

mujoco = pytest.importorskip("mujoco", reason="the loop is closed in leactl[mujoco]")

PLAIN = '<position name="servo" joint="knee" kp="15" forcerange="-8 8"/>'
WITHHELD = Leg(by_load=0.2, at_rest=0.7, band=0.03)
NAMES = {"load_dependent_friction", "stribeck", "servo_dead_band"}


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """A robot whose joint has all of the damping, and ten seconds of each kind of run, twice."""
    folder = tmp_path_factory.mktemp("loop")
    robot = leg(folder, PLAIN)
    robot.write_text(robot.read_text().replace('frictionloss="0.2"', 'frictionloss="0.2" damping="0.65"'))
    recorded(folder, WITHHELD, 10.0, np.random.default_rng(3))
    return folder


def words(folder, *more, robot="robot.xml", out="new.xml", joint="knee"):
    runs = [folder / f"{kind}-a.h5" for kind in KINDS]
    held_out = [word for kind in KINDS for word in ("--held-out", folder / f"{kind}-b.h5")]
    files = ("--out", folder / out, "--callbacks", folder / "knee.py")
    return ("gap", "loop", folder / robot, *runs, *held_out, "--joint", joint, *files, *more)


def test_three_withheld_effects_are_named_and_the_gap_closes_in_mujoco(workshop):
    done = leactl(*words(workshop, "--supply", "24", "--write-model", workshop / "augmented.yaml", "--json"))
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    fits_the_page("A closed loop", answer)
    assert set(answer["named"]) == NAMES
    assert answer["closed"] >= 0.8
    whole = answer["all"]
    assert whole["after_rad"] < 0.3 * whole["file_rad"] < 0.3 * whole["before_rad"]
    assert [run["run"] for run in answer["runs"]] == [f"{kind}-b.h5" for kind in KINDS]
    assert all(run["after_rad"] < 0.5 * run["before_rad"] for run in answer["runs"])
    document = yaml.safe_load((workshop / "augmented.yaml").read_text())
    band = next(effect["parameters"]["band"] for effect in document["effects"] if effect["effect"] == "servo_dead_band")
    assert band == pytest.approx(WITHHELD.band, rel=0.1)
    assert mujoco.MjModel.from_xml_path(str(workshop / "new.xml")).nu == 1
    assert not [path for path in workshop.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("more", "changes", "line"),
    [
        ((), {}, "as a servo it lacks the supply's voltage (give --supply)"),
        (("--supply", "24"), {"robot": "motor.xml"}, "no position actuator drives joint 'knee'"),
        (("--supply", "1000"), {"robot": "wild.xml"}, "moves beyond all bounds in"),
        (("--supply", "24"), {"joint": "hip"}, "no joint 'hip'"),
        (("--supply", "24"), {"out": "robot.xml"}, "never overwritten"),
        (("--supply", "24", "--held-out", "absent.h5"), {}, "absent.h5"),
        (("--supply", "24", "--write-model", "none/a.yaml"), {"out": "other.xml"}, "no folder none"),
    ],
)
def test_what_cannot_be_closed_is_told_before_minutes_are_spent(workshop, more, changes, line):
    leg(workshop, MOTOR, name="motor.xml")
    leg(workshop, PLAIN.replace("15", "1e12").replace("-8 8", "-1e9 1e9"), name="wild.xml")
    folder, others = workshop, {"out": "later.xml"} | changes
    given = list(words(folder, *more, **others))
    given[given.index(folder / "knee.py")] = folder / "later.py"
    done = leactl(*given)
    assert done.returncode == 2
    assert line in done.stderr
    assert not (folder / "later.py").exists()
    assert not (Path.cwd() / "MUJOCO_LOG.TXT").exists()
    assert "searching effects" not in done.stderr


def test_a_joint_plays_as_if_the_others_were_not_there(tmp_path):
    time = 0.0049 * np.arange(300)  # between two steps of the file, too
    values = {("angle", "test"): 0.1 + 0.0 * time, ("angle_reference", "test"): 0.1 + 0.8 * np.sin(3.0 * time)}
    record = Record(tmp_path / "goals.h5", "goals", "free", Clocked(time, 0.0049, values), None, {})
    servo = '<option timestep="0.001"/><actuator><position joint="knee" kp="9" kv="0.5" forcerange="-5 5"/></actuator>'
    whole = play(chain(tmp_path, "<freejoint/>", more=servo), "knee", [record])[0]
    text = (tmp_path / "chain.xml").read_text()
    for joint in ("<freejoint/>", '<joint name="hip" axis="0 1 0"/>'):
        text = text.replace(joint, "")
    (tmp_path / "alone.xml").write_text(text)
    alone = play(tmp_path / "alone.xml", "knee", [record])[0]
    assert np.ptp(alone) > 1.0
    assert whole == pytest.approx(alone, abs=1e-4)
