"""`leactl motor` as a shell sees it."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from leactl.cli.motor import app
from leactl.errors import InputError
from tests.cli.terminal import leactl


def asked(*arguments):
    """Standard output of a command that ends well, in this process."""
    done = CliRunner().invoke(app, list(map(str, arguments)), catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout


@pytest.fixture
def walk(tmp_path):
    percent = np.arange(0, 101)
    part = 2.0 * np.pi * percent / 100.0
    rows = zip(percent, 10.0 * np.sin(part) + 6.0 * np.sin(2 * part + 1.0), -1.5 * np.sin(part / 2) ** 8, strict=True)
    path = tmp_path / "walk.csv"
    path.write_text("cycle_percent,angle_deg,torque_Nm_per_kg\n" + "".join(f"{a},{b},{c}\n" for a, b, c in rows))
    return path


def test_three_motors_ship():
    assert json.loads(asked("list", "--json")) == {"motors": ["ec-4pole-30", "lea", "u8-kv100"]}


def test_side_by_side_frames_that_differ_are_left_out_and_missing_is_a_dash():
    text = asked("compare")
    assert "torque_constant" not in text
    assert "windings differ" in text
    rows = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line and not line.startswith(" ")}
    assert rows["coulomb_friction"][1:] == ["-", "208", "17"]
    assert rows["torque_density"][1:] == ["0.34", "7.509", "4.433"]
    assert "torque_constant" in asked("compare", "lea", "ec-4pole-30")
    body = json.loads(asked("compare", "--json"))
    by_name = {row["name"]: row["values"] for row in body["rows"]}
    assert by_name["coulomb_friction"][0] is None
    assert by_name["network_torque"] == [None, pytest.approx(6.755, abs=1e-3), pytest.approx(1.063, abs=1e-3)]
    assert body["motors"] == ["ec-4pole-30", "lea", "u8-kv100"]


def test_one_motor_keeps_its_text_and_tells_what_follows():
    text = asked("show", "u8-kv100")
    assert text.startswith("# T-Motor U8-KV100")
    assert "lacks tolerances" in text
    body = json.loads(asked("show", "lea", "--json"))
    assert body["motor_constant"] == pytest.approx(0.954, abs=1e-3)
    assert body["torque_constant"] == 0.49
    assert body["figures"]["no_load_speed"] == pytest.approx(41.40, abs=1e-2)
    assert not [note for note in body["notes"] if "no-load" in note]


def test_a_no_load_speed_without_friction_says_so():
    told = "ec-4pole-30: its no-load speed is without friction, for its file lacks coulomb_friction"
    assert told in json.loads(asked("compare", "--json"))["notes"]
    assert told in json.loads(asked("show", "ec-4pole-30", "--json"))["notes"]
    assert "no-load speed is without friction" in asked("show", "ec-4pole-30")
    assert "no-load speed" not in asked("compare", "lea", "u8-kv100")


def test_what_harmonics_leave_out_is_told_with_its_share_and_its_line(walk):
    options = (walk, "--stride-time", "1.1", "--body-mass", "70", "--motor", "lea")
    assert json.loads(asked("energy", *options, "--json"))["cycles"][0]["notes"] == []
    lines = walk.read_text().splitlines()
    lines[51] = "50,150.0,-1.5"
    walk.write_text("\n".join(lines) + "\n")
    cycle = json.loads(asked("energy", *options, "--json"))["cycles"][0]
    (note,) = cycle["notes"]
    assert note.startswith(f"10 harmonics leave out {100.0 * cycle['angle_left_out']:.1f} % of the angle's range (rms)")
    assert "; line 52 alone is " in note
    text = " ".join(asked("energy", *options).split())
    assert note in text


def test_a_phase_inductance_in_mh_is_told(tmp_path):
    text = asked("show", "lea").partition("\n#")[0].replace("phase_inductance: 0.000128", "phase_inductance: 0.128")
    (tmp_path / "mine.yaml").write_text(text)
    note = json.loads(asked("show", tmp_path / "mine.yaml", "--json"))["notes"][-1]
    assert "phase inductance 0.128 H over phase resistance 0.264 ohm is 0.485 s" in note


def test_energy_of_three_motors_at_their_best_ratios_and_at_one(walk):
    options = (str(walk), "--stride-time", "1.1", "--body-mass", "70")
    body = json.loads(asked("energy", *options, "--json"))["cycles"][0]
    best = {motor["motor"]: motor for motor in body["motors"]}
    assert best["ec-4pole-30"]["energies_J"]["coulomb"] is None
    for motor, one in best.items():
        energies = one["energies_J"]
        for ratio in (0.8 * one["ratio"], 1.25 * one["ratio"]):
            other = json.loads(asked("energy", *options, "--motor", motor, "--ratio", ratio, "--json"))
            result = other["cycles"][0]["motors"][0]
            assert result["energies_J"]["electrical"] > energies["electrical"] or not result["feasible"]
    text = asked("energy", *options)
    assert "ec-4pole-30: its Coulomb friction is not known: losses are at least these" in text
    assert max(map(len, text.splitlines())) <= 100


def test_scale_and_preload_say_what_they_take_for_granted():
    text = asked("scale", "--radius", "82.5", "--known-radius", "34.75")
    assert "torque_constant [N*m/A]         0.14      0.7891     r^2" in text
    assert "delta winding throughout" in text
    body = json.loads(asked("preload", "--json"))
    holds = {reading["name"]: [gap["holds"] for gap in reading["gaps"]] for reading in body["readings"]}
    assert holds["static load, gap is deflection"] == [True, True, False]
    assert holds["told preload, beyond the gap at rest"] == [True, True, True]
    assert "12 bearings a side, 300 N each" in asked("preload")


def test_constants_of_one_winding_that_contradict_each_other_are_told(tmp_path):
    text = asked("show", "lea").partition("\n#")[0].replace("back_emf_constant: 0.49", "back_emf_constant: 0.98")
    (tmp_path / "mine.yaml").write_text(text)
    assert "back-EMF constant 0.98 V*s/rad: they" in asked("show", tmp_path / "mine.yaml")
    assert "back-EMF constant" not in asked("compare")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["energy", "walk.csv", "--stride-time", "1"], "needs --body-mass"),
        (["energy", "walk.csv", "--body-mass", "70"], "needs --stride-time"),
        (["scale", "--radius", "80"], "'u8-kv100' has no air_gap_radius; give it with --known-radius"),
        (["preload", "--motor", "u8-kv100"], "'u8-kv100' has no `bearings:`"),
        (["show", "lae"], "motor 'lae' is not known; known: ec-4pole-30, lea, u8-kv100"),
    ],
)
def test_unusable_input_is_one_line(walk, monkeypatch, arguments, message):
    monkeypatch.chdir(walk.parent)
    with pytest.raises(InputError) as caught:
        CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert len(caught.value.faults) == 1
    assert message in caught.value.faults[0]


def test_a_shell_gets_status_2_for_a_motor_that_lacks_what_a_limit_takes(tmp_path):
    done = leactl("thermal", "limits", "--motor", "ec-4pole-30", LEACTL_STATE=str(tmp_path))
    assert (done.returncode, done.stdout) == (2, "")
    assert "coulomb_friction: is required and missing" in done.stderr
