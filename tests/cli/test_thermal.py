"""`leactl thermal` and the runs that it warns of, as a shell sees them."""

import json
import re
from pathlib import Path

import pytest

from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl

BURSTS = """
name: bursts
setup: locked
rate_Hz: 50
parameters: {current_A: 20, trials: 1}
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: $current_A, duration_s: 6}
  - hold: {role: test, current_A: 0, duration_s: 1}
  - hold: {role: test, current_A: $current_A, duration_s: 6}
  - hold: {role: test, current_A: 0, duration_s: 1}
"""
HOT = ["--set", "current_A=24"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "bursts.yaml").write_text(BURSTS)
    return tmp_path


def test_limits_of_the_lea_slowly_standing_and_at_speed(here):
    done = leactl("thermal", "limits", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    body = json.loads(done.stdout)
    assert done.stdout == leactl("thermal", "limits", "--motor", "lea", "--json").stdout
    slowly, standing, turning = body["continuous"]
    assert 13.7 < slowly["current"]["nominal"] < 13.9
    assert 12.65 < standing["current"]["nominal"] < 12.75
    assert 10.95 < turning["current"]["nominal"] < 11.1
    assert (slowly["motion"], standing["motion"], turning["speed"]) == ("slowly", "standing", 31.4)
    for row in (*body["continuous"], *body["peak"]):
        assert row["current"]["guaranteed"] < row["current"]["nominal"] < row["current"]["favourable"]
        assert row["torque"]["nominal"] == pytest.approx(0.49 * row["current"]["nominal"])
    falling = [row["current"]["guaranteed"] for row in body["peak"]]
    assert falling == sorted(falling, reverse=True)
    assert falling[-1] > standing["current"]["guaranteed"]


def test_limits_fit_80_columns_and_say_the_same(here):
    done = leactl("thermal", "limits", COLUMNS="80")
    assert done.returncode == 0
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "continuous, slowly [A]             11.87       13.79       16.09" in done.stdout


def test_warmer_air_and_further_speeds(here):
    body = json.loads(leactl("thermal", "limits", "--ambient", "60", "--speed", "5", "--speed", "40", "--json").stdout)
    assert [row["speed"] for row in body["continuous"]] == [0.0, 0.0, 5.0, 40.0]
    assert body["continuous"][0]["current"]["nominal"] < 12.0


@pytest.mark.parametrize(
    "arguments",
    [["--motor", "leaa"], ["--motor", "none.yaml"], ["--motor", "bare.yaml"], ["--motor", "absurd.yaml"]],
)
def test_a_motor_that_cannot_be_used_is_one_line_and_status_2(here, arguments):
    text = leactl("motor", "show", "lea").stdout
    head, _tolerances, _rest = text.partition("tolerances:")
    assert _tolerances
    (here / "bare.yaml").write_text(head)
    (here / "absurd.yaml").write_text(text.replace("phase_resistance: 0.1", "phase_resistance: 0.7"))
    done = leactl("thermal", "limits", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1, done.stderr
    if "bare.yaml" in arguments:
        assert "motor 'lea': no `tolerances:`" in done.stderr


@pytest.mark.parametrize("option", [("--speed", "inf"), ("--speed", "nan"), ("--ambient", "nan"), ("--ambient", "300")])
def test_figures_that_are_none_are_status_2(here, option):
    done = leactl("thermal", "limits", *option)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr


def test_state_of_a_real_bench_is_hot_until_something_is_known(here):
    done = leactl("thermal", "state", "--bench", "testbed", "--json")
    rows = json.loads(done.stdout)["windings"]
    assert [row["role"] for row in rows] == ["test", "load"]
    assert all(row["hottest_phase_degC"] == row["limit_degC"] == 130.0 for row in rows)
    assert all("nothing is known of it" in row["known"] for row in rows)
    text = leactl("thermal", "state", "--bench", "testbed").stdout
    assert "testbed.load: counts as hot: nothing is known of it" in text


def test_plan_names_the_step_and_the_waits(here):
    cool = json.loads(leactl("thermal", "plan", "bursts.yaml", "--set", "current_A=8", "--json").stdout)
    assert (cool["passes"], cool["cooldowns"]) == (None, [])
    hot = json.loads(leactl("thermal", "plan", "bursts.yaml", *HOT, "--json").stdout)
    assert hot["passes"]["role"] == "test"
    assert 7.0 < hot["passes"]["time_s"] < 13.0
    [wait] = hot["cooldowns"]
    assert wait["start_s"] in (6.0, 7.0)
    text = leactl("thermal", "plan", "bursts.yaml", *HOT).stdout
    assert f"a wait of {wait['duration_s']:g} s at {wait['start_s']:g} s helps (--insert-cooldown)" in text


def test_a_run_that_would_pass_is_refused_before_anything_moves(here):
    done = leactl("run", "bursts.yaml", *HOT)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert "may take the test winding to its limit of 130 degC after " in done.stderr
    assert "--insert-cooldown adds " in done.stderr
    assert not (here / "runs").exists()


def test_a_run_with_waits_holds_them_in_its_file(here):
    done = leactl("run", "bursts.yaml", *HOT, "--insert-cooldown", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["status"] == "complete"
    with Run.open(here / answer["run"]) as run:
        names = [step.name for step in run.steps]
    assert "cooldown" in names


def test_a_real_bench_of_which_nothing_is_known_is_refused_and_begins_when_it_is_said_to_be_cold(here, testbed):
    refused = leactl("run", "bursts.yaml", "--set", "current_A=8", "--bench", testbed)
    assert refused.returncode == 2
    assert "--cold where nothing has heated them" in refused.stderr
    begun = leactl("run", "bursts.yaml", "--set", "current_A=8", "--bench", testbed, "--cold")
    assert begun.returncode == 5, begun.stderr  # the bus is not there


@pytest.mark.long
def test_commissioning_says_what_the_first_heat_would_be_and_moves_nothing(here):
    asked = ("thermal", "commission", "--set", "current_A=9", "--actuator", "LEA-1", "--attended", "--dry-run")
    done = leactl(*asked, COLUMNS="80")
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines())) <= 80
    body = json.loads(leactl(*asked, "--json").stdout)
    assert (body["admitted"], body["done"], body["runs"], body["motor_file"]) == (False, False, [], None)
    assert f"{body['next_heating_s']:.0f} s of heating come next" in done.stdout
    assert "not admitted" in done.stderr
    assert [path.name for path in here.iterdir()] == ["bursts.yaml"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "--actuator: which one is commissioned was expected"),
        (["friction", "--actuator", "LEA-1", "--bench", "emulated"], "a heated protocol was expected"),
        (["--actuator", "LEA-1", "--given", "no-such.h5"], "no-such.h5"),
        (["--actuator", "LEA-1", "--camera-gain", "nan"], "--camera-gain"),
        (["--actuator", "LEA-1", "--runs", "0"], "--runs"),
    ],
)
def test_commissioning_refuses_what_it_cannot_use_in_one_line(here, words, told):
    done = leactl("thermal", "commission", *words, "--dry-run")
    assert done.returncode == 2
    assert told in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("file", "trace"), [("LEA-1.yaml", "LEA-1.yaml"), ("LEA-1.trace", "LEA-1.asc")])
def test_a_motor_file_is_not_the_trace_as_well(here, file, trace):
    done = leactl("thermal", "commission", "--actuator", "LEA-1", "--file", file, "--trace", trace)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [f"leactl: {file}: is named for two outputs; give each a file of its own"]
    assert not list(here.glob("LEA-1.*"))


@pytest.mark.long
def test_the_paper_s_heat_is_admitted_and_run_after_two_short_heats(here):
    done = leactl("thermal", "commission", "--set", "current_A=9", "--actuator", "LEA-1", "--attended", "--json")
    assert done.returncode == 0, done.stderr
    body = json.loads(done.stdout)
    assert body["done"]
    assert [run["whole"] for run in body["runs"]] == [False, False, True]
    page = " ".join((Path(__file__).parents[2] / "docs" / "explanation" / "thermal.md").read_text().split())
    match = re.search(
        r"heats of (\d+) s and (\d+) s, and the whole of (\d+) s, by then with at most (\S+) degC of (\S+?)\. ", page
    )
    seconds, temperatures = [run["heating_s"] for run in body["runs"]], [body["peak_degC"], body["limit_degC"]]
    assert list(map(float, match.groups())) == pytest.approx([*seconds, *temperatures], abs=0.5)
    with Run.open(here / body["runs"][-1]["run"]) as run:
        assert run.attributes["status"] == "complete"
