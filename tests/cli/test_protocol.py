"""`leactl protocol` as a person's shell sees it."""

import contextlib
import json
import signal
import subprocess
import sys
from importlib import resources

import pytest

from leactl.bench.benchfile import SHIPPED
from leactl.protocol import shipped
from tests.cli.terminal import COMMAND, leactl

MINE = """\
name: mine
title: Two levels
setup: locked
rate_Hz: 50
parameters: {levels_A: [1, 2], hold_s: 3}
conditions: {hot: {hold_s: 4}}
steps:
  - mode: {test: current}
  - sweep: {role: test, levels_A: $levels_A, hold_s: $hold_s, settle_s: 0.5}
  - mode: {test: off}
"""


@pytest.fixture
def mine(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(MINE)
    return path


def test_list():
    done = leactl("protocol", "list")
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split()[0] for line in done.stdout.splitlines()] == shipped.names()
    rows = json.loads(leactl("protocol", "list", "--json").stdout)["protocols"]
    setups = {row["name"]: row["setup"] for row in rows}
    assert (setups["friction"], setups["torque-constant"]) == ("free", "coupled")


def test_show_prints_the_file_as_it_is():
    text = (resources.files("leactl_protocols") / "friction.yaml").read_text()
    assert leactl("protocol", "show", "friction").stdout == text
    assert json.loads(leactl("protocol", "show", "friction", "--json").stdout)["text"] == text


def test_check(mine):
    done = leactl("protocol", "check", mine)
    assert (done.returncode, done.stdout) == (0, "mine: 4 actions, 0:00:06, no faults\n")
    answer = json.loads(leactl("protocol", "check", mine, "--json").stdout)
    assert answer["duration_s"] == 6
    assert answer["peaks"] == [{"role": "test", "quantity": "q_axis_current_reference", "value": 2.0, "unit": "A"}]


def test_check_takes_a_protocol_from_stdin():
    done = subprocess.run([*COMMAND, "protocol", "check", "-"], input=MINE, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "mine: 4 actions, 0:00:06, no faults\n")
    limit = "acceptance: [{result: torque, high: 1, unit: N*m}]\n"
    done = subprocess.run(
        [*COMMAND, "protocol", "check", "-"], input=MINE + limit, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("leactl: <stdin>:11:13  acceptance: the protocol names no analysis to judge them by")


def test_check_tells_faults_as_json(mine):
    mine.write_text(MINE.replace("hold_s: $hold_s", "hold_ms: 3"))
    done = leactl("protocol", "check", mine, "--json")
    assert done.returncode == 2
    message = "steps[1].sweep.hold_ms: 3: unknown key; hold_s was expected"
    assert json.loads(done.stdout)["faults"] == [{"file": str(mine), "line": 9, "column": 55, "message": message}]
    assert message in done.stderr
    (fault,) = json.loads(leactl("protocol", "check", "nothing", "--json").stdout)["faults"]
    assert (fault["file"], fault["line"], fault["column"]) == (None, None, None)


def test_check_tells_a_parameter_that_nothing_uses(mine):
    mine.write_text(MINE.replace("hold_s: 3}", "hold_s: 3, spare: 2}"))
    done = leactl("protocol", "check", mine)
    assert done.returncode == 0
    note = f"{mine}:5:50  parameters.spare: $spare stands nowhere in the file: to set it changes nothing"
    assert done.stderr == f"note: {note}\n"
    assert json.loads(leactl("protocol", "check", mine, "--json").stdout)["notes"] == [note]
    assert leactl("protocol", "check", "friction").stderr == ""


def test_check_tells_every_fault_at_its_place(mine):
    mine.write_text(MINE.replace("hold_s: $hold_s", "hold_ms: 3").replace("{test: off}", "{test: of}"))
    done = leactl("protocol", "check", mine)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines() == [
        f"leactl: {mine}:9:55  steps[1].sweep.hold_ms: 3: unknown key; hold_s was expected",
        f"leactl: {mine}:10:18  steps[2].mode.test: 'of': 'off', 'current', 'torque_profile', 'velocity' or 'angle' was"
        " expected",
    ]


def test_check_tells_an_analysis_that_is_not_known(mine):
    mine.write_text(MINE.replace("rate_Hz", "analysis: coastdown\nrate_Hz"))
    done = leactl("protocol", "check", mine)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"leactl: {mine}:4:11  analysis: 'coastdown' is not known; known: back-drive, ")


def test_check_does_not_wait_for_scipy():
    told = "import sys; from leactl.cli.main import main\ntry: main()\nfinally: print('scipy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", told, "protocol", "check", "coast-down"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[1:] == ["False"]


def test_a_condition_that_the_emulated_bench_does_not_have_is_refused_before_anything_is_planned():
    done = leactl("protocol", "plan", "friction", "--bench", "emulated", "--condition", "laoded")
    assert (done.returncode, done.stdout) == (2, "")
    expected = "condition 'laoded' is not one of the emulated bench's: unloaded, design, loaded"
    assert done.stderr == f"leactl: {expected}\n"


def test_plan_prints_the_timeline_duration_and_peaks(mine):
    done = leactl("protocol", "plan", mine, "--condition", "hot", "--set", "levels_A=[1, -2.5]", "--set", "seed=3")
    assert done.returncode == 0
    assert done.stdout.splitlines() == [
        "mine: Two levels",
        "  levels_A = [1, -2.5]",
        "  hold_s = 4",
        "   start/s    last/s  settle/s  step        setpoints",
        "     0.000     0.000     0.000  mode        test current",
        "     0.000     4.000     0.500  hold        test 1 A",
        "     4.000     4.000     0.500  hold        test -2.5 A",
        "     8.000     0.000     0.000  mode        test off",
        "duration 0:00:08 (8.000 s)",
        "peak test q_axis_current_reference 2.5 A",
    ]


def test_plan_as_json(mine):
    answer = json.loads(leactl("protocol", "plan", mine, "--json").stdout)
    assert answer["parameters"] == {"levels_A": [1, 2], "hold_s": 3}
    assert answer["timeline"][1] == {
        "start_s": 0.0, "name": "hold", "duration_s": 3.0, "settle_s": 0.5, "setpoints": "test 1 A"
    }  # fmt: skip


def test_plan_is_checked_against_a_bench(mine):
    assert leactl("protocol", "plan", mine, "--bench", "emulated").returncode == 0
    done = leactl("protocol", "plan", mine, "--bench", "emulated", "--set", "levels_A=[1, -45]")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "leactl: test q_axis_current_reference: 45 A is above the bench limit of 30 A\n"


HELD = (
    "hold: {role: test, current_A: 1, duration_s: 3, until: {%s, statistic: mean, window_s: 1, below: 30, unit: degC}}"
)
AWAITED = "quantity: winding_temperature, role: test"
LIMIT = "{channel: winding_temperature, statistic: max, high: 80, unit: degC}"
MISFITS = {
    "hold until": (HELD % AWAITED, "", "depends on winding_temperature of test; no device of bench 'emulated'"),
    "wait_until": (
        f"wait_until: {{{AWAITED}, below: 30, unit: degC, timeout_s: 1}}",
        "",
        "depends on winding_temperature of test; no device of bench 'emulated'",
    ),
    "acceptance": ("mode: {test: off}", f"acceptance: [{LIMIT}]", "measures no winding_temperature of role 'test'"),
    "needs": ("mode: {test: off}", "needs: [winding_temperature]", "needs winding_temperature; no device of bench"),
}


@pytest.mark.parametrize("name", MISFITS)
def test_channels_that_a_bench_does_not_measure_are_refused_by_the_plan_and_before_a_run(tmp_path, name):
    step, more, words = MISFITS[name]
    head = MINE.partition("steps:")[0].replace("levels_A: [1, 2], hold_s: 3", "").replace("hold_s: 4", "")
    (tmp_path / "warm.yaml").write_text(f"{head}steps:\n  - mode: {{test: current}}\n  - {step}\n{more}\n")
    planned = leactl("protocol", "plan", tmp_path / "warm.yaml", "--bench", "emulated")
    run = leactl("run", tmp_path / "warm.yaml", "--bench", "emulated", "--out", tmp_path / "runs")
    assert (planned.returncode, planned.stdout) == (run.returncode, run.stdout) == (2, "")
    assert planned.stderr == run.stderr
    assert words in run.stderr
    assert not list(tmp_path.glob("runs/*.h5"))


def test_a_plan_says_that_a_bench_is_built_for_another_set_up(mine, tmp_path):
    text = (SHIPPED / "testbed.yaml").read_text()
    (tmp_path / "one.yaml").write_text(text.replace("\nmotors", "\nsetup: coupled\nmotors", 1))
    done = leactl("protocol", "plan", mine, "--bench", tmp_path / "one.yaml")
    assert (done.returncode, done.stdout) == (2, "")
    assert "protocol 'mine' needs set-up 'locked'; bench 'testbed' is 'coupled'" in done.stderr


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            "hold_s=-1",
            ":9:54  steps[1].sweep.hold_s: -1: more than 0 was expected ($hold_s from --set hold_s=-1)",
        ),
        ("hold=1", "--set hold=1: no such parameter; known: levels_A, hold_s"),
        ("hold_s", "--set hold_s: name=value was expected"),
        ("hold_s=.nan", "--set hold_s=.nan: nan: a finite number was expected, as in the default 3"),
    ],
)
def test_a_value_that_cannot_be_used(mine, given, words):
    done = leactl("protocol", "plan", mine, "--set", given)
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1
    assert words in done.stderr


def test_plan_says_where_the_bound_of_a_winding_rests_on_one_sensor(mine, tmp_path):
    text = "the bound of the test winding rests on one sensor, q_axis_current: in set-up "
    lines = leactl("protocol", "plan", "friction", "--bench", "emulated").stdout.splitlines()
    assert f"{text}'free' nothing else shows a current that is misread" in lines
    assert text not in leactl("protocol", "plan", mine, "--bench", "emulated").stdout  # beside a torque sensor
    bench = (SHIPPED / "emulated.yaml").read_text().replace("name: emulated", "name: mine")
    (tmp_path / "bench.yaml").write_text("".join(x for x in bench.splitlines(True) if "torque_disagreement" not in x))
    answer = json.loads(leactl("protocol", "plan", mine, "--bench", tmp_path / "bench.yaml", "--json").stdout)
    (line,) = answer["one_sensor"]
    assert line.endswith("; interlocks.torque_disagreement would hold a second one against it")


@pytest.mark.parametrize("command", ["show", "check", "plan"])
def test_a_protocol_that_is_not_known(command):
    done = leactl("protocol", command, "torque")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        f"leactl: protocol 'torque' is not known; known: {', '.join(shipped.names())}, or a path to a .yaml\n"
    )


def test_ctrl_c_while_a_file_is_read_ends_as_stopped_by_a_person():
    more_than_a_pipe_holds = b"# a protocol that does not end\n" * 8000
    command = [*COMMAND, "protocol", "check", "-"]
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(command, **streams) as running:
        running.stdin.write(more_than_a_pipe_holds)  # returns once the command reads
        running.stdin.flush()
        for _ in range(50):  # one that comes just before the read is waiting is seen with the next
            running.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                running.wait(timeout=1)
                break
        out, error = running.stdout.read().decode(), running.stderr.read().decode()
    assert (running.returncode, out, error) == (4, "", "leactl: stopped\n")
