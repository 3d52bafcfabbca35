"""`leactl campaign` as a shell sees it: struck at any moment and gone on with, prompts, waits, two at once."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter

import pytest

from leactl.bench.benchfile import load
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from leactl.runner.thermal_admission import Windings
from tests.cli.terminal import COMMAND, leactl, start
from tests.runner.campaign.conftest import SMALL, SPIN

STEPS = "".join(f"  - {{name: s{n}, protocol: spin.yaml, set: {{hold_s: {8 + n}}}}}\n" for n in range(4))
ON_TESTBED = SMALL.replace("bench: emulated", "bench: testbed.yaml")


@pytest.fixture
def here(tmp_path, monkeypatch, testbed):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    (tmp_path / "spin.yaml").write_text(SPIN)
    (tmp_path / "small.yaml").write_text(SMALL.partition("steps:\n")[0] + "steps:\n" + STEPS)
    (tmp_path / "real.yaml").write_text(ON_TESTBED)
    return tmp_path


@pytest.fixture
def begin():
    """Start a command that is ended with the test at the latest."""
    made = []

    def begun(*arguments):
        made.append(start(*arguments))
        return made[-1]

    yield begun
    for process in made:
        process.kill()
        process.communicate()


def finished(folder):
    """Complete runs by what they are of the campaign; every file has to be readable."""
    results = {}
    for path in folder.glob("*.h5"):
        with Run.open(path) as run:
            told = dict(event.message.split(" = ") for event in run.events if event.source == "campaign")
            if run.status == "complete":
                assert verify(path) == []
                results.setdefault(told["run"], []).append(path.name)
    return results


def strike(number, after_s):
    """Go on with the campaign and strike it so long after its first run began; its exit status and what it said."""
    process = start("campaign", "small.yaml", "--out", "out")
    line = process.stderr.readline()
    while line and ": s" not in line:
        line = process.stderr.readline()
    time.sleep(after_s)  # the moment itself, which is drawn
    process.send_signal(number)
    _out, err = process.communicate(timeout=120)
    return process.returncode, err


def struck_until_done(here, seed, numbers):
    drawn, before = random.Random(seed), {}
    for number in numbers:
        returned, err = strike(number, drawn.uniform(0.0, 0.7))
        now = finished(here / "out")
        assert now.items() >= before.items()  # what was finished stays as it was
        before = now
        if returned != 0:  # it had not come to its end before
            assert returned == (-signal.SIGKILL if number == signal.SIGKILL else 4)
            if number != signal.SIGKILL:
                assert f"leactl: stopped by {signal.Signals(number).name}" in err
    done = leactl("campaign", "small.yaml", "--out", "out", "--json")
    assert done.returncode == 0, done.stderr
    files = json.loads(done.stdout)["files"]
    after = finished(here / "out")
    assert after.items() >= before.items()
    assert Counter({key: len(paths) for key, paths in after.items()}) == Counter(files.keys())
    assert len(files) == 8
    assert len(list((here / "out").glob("*.h5"))) == 8
    for path in (here / "out").glob("unfinished/*.h5"):
        with Run.open(path) as run:
            assert run.status in ("recording", "stopped")


def test_a_campaign_that_is_struck_goes_on_without_repeating_or_missing_a_run(here):
    struck_until_done(here, 3, [signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGKILL])


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_a_campaign_that_is_struck_often(here, seed):
    drawn = random.Random(1000 + seed)
    struck_until_done(here, seed, drawn.choices([signal.SIGKILL, signal.SIGINT, signal.SIGTERM], k=8))


STRUCK = """
import os, signal, sys

def strike(*_):
    os.kill(os.getpid(), {number:d})

{moment}
from leactl.cli.main import main
sys.argv[0] = "leactl"
main()
"""
AS_IT_ENDS = """
class Last:  # goes after Python has given its signals back to the system
    def __del__(self, kill=os.kill, process=os.getpid()):
        kill(process, {number:d})

last = Last()
"""
AS_THE_FOLDER_IS_LET_GO = """
from contextlib import contextmanager
from leactl.runner.campaign import folder
held = folder.held

@contextmanager
def struck(path):
    with held(path):
        yield
        strike()

folder.held = struck
"""
AS_IT_IS_TOLD = """
from leactl.runner.outcome import Outcome
told = Outcome.as_json
Outcome.as_json = lambda outcome: [told(outcome), strike()][0]
"""
BEFORE_THE_FIRST_RUN = """
from leactl.runner.campaign import entries
preview = entries.preview
entries.preview = lambda request: [strike(), preview(request)][1]
"""
AS_A_RUN_BEGINS = """
from leactl.runner import session
check = session.check
session.check = lambda request: [check(request), strike()][0]
"""
CAMPAIGN, RUN = ("campaign", "small.yaml"), ("run", "spin.yaml", "--set", "hold_s=1")


def struck(number, moment, *arguments):
    """A command whose process strikes itself at a moment."""
    program = STRUCK.format(number=number, moment=moment.format(number=number))
    return subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize(
    "number", [signal.SIGINT, *(pytest.param(item, marks=pytest.mark.long) for item in (signal.SIGTERM, signal.SIGHUP))]
)
@pytest.mark.parametrize(
    ("command", "moment"),
    [
        (CAMPAIGN, AS_IT_ENDS),
        pytest.param(CAMPAIGN, AS_THE_FOLDER_IS_LET_GO, marks=pytest.mark.long),
        (RUN, AS_IT_ENDS),
        (RUN, AS_IT_IS_TOLD),
    ],
)
def test_a_signal_that_comes_when_all_is_made_takes_nothing_from_it(here, number, command, moment):
    done = struck(number, moment, *command, "--out", "out", "--json")
    assert "Exception" not in done.stderr
    assert (done.returncode, json.loads(done.stdout)["reason"]) == (0, "")


@pytest.mark.parametrize(
    ("command", "moment"), [(CAMPAIGN, BEFORE_THE_FIRST_RUN), (CAMPAIGN, AS_A_RUN_BEGINS), (RUN, AS_A_RUN_BEGINS)]
)
def test_a_signal_that_no_run_listens_to_yet_stops_the_next(here, command, moment):
    done = struck(signal.SIGTERM, moment, *command, "--out", "out")
    assert (done.returncode, done.stderr.splitlines()[-1]) == (4, "leactl: stopped by SIGTERM")
    assert not finished(here / "out")


@pytest.mark.long
def test_a_campaign_under_way_is_seen_and_its_folder_is_taken(here, begin):
    (here / "long.yaml").write_text(SMALL.replace("current_A: 0.5", "hold_s: 3600"))
    process = begin("campaign", "long.yaml", "--out", "out", "--realtime")
    assert "[1/4" in process.stderr.readline()
    answer = json.loads(leactl("campaign", "status", "long.yaml", "--out", "out", "--json").stdout)
    assert (answer["under_way"], answer["finished"], len(answer["runs"])) == (True, 0, 4)
    second = leactl("campaign", "long.yaml", "--out", "out")
    assert second.returncode == 5
    assert second.stderr.startswith("leactl: out: the campaign is conducted already, process ")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err.splitlines()[-1]) == (4, "leactl: stopped by SIGINT")
    assert out == "0 of 4 runs are finished in out; the same command goes on\n"


def test_a_prompt_that_nobody_can_answer_ends_the_campaign_with_status_4(here):
    done = leactl("campaign", "real.yaml", input="")
    assert done.returncode == 4
    assert done.stderr == (
        f"leactl: Mount bench 'testbed-{os.getpid()}': condition 'unloaded', set-up free, for slow;"
        " stdin is no terminal to confirm it at: see to it, then start again with --yes\n"
    )
    assert done.stdout == "0 of 4 runs are finished in runs/small; the same command goes on\n"


def test_a_prompt_is_asked_at_the_terminal(here):
    pexpect = pytest.importorskip("pexpect")

    def answered(answer):
        arguments = [*COMMAND[1:], "campaign", "real.yaml", "--cold"]
        child = pexpect.spawn(sys.executable, arguments, env=os.environ, encoding="utf-8", timeout=60)
        child.expect(f"Mount bench 'testbed-{os.getpid()}': condition 'unloaded', set-up free, for slow")
        child.sendline(answer)
        child.expect(pexpect.EOF)
        child.close()
        return child.exitstatus, child.before

    assert answered("")[0] == 5  # on to its bus, which is not there
    status, told = answered("n")
    assert status == 4
    assert f"stopped by the operator: 'n' in answer to: Mount bench 'testbed-{os.getpid()}'" in told


@pytest.mark.long
def test_a_campaign_waits_for_windings_to_cool_and_holds_its_bench_meanwhile(here, begin):
    (here / "warm.yaml").write_text(ON_TESTBED.replace("current_A: 0.5", "current_A: 20, hold_s: 4"))
    process = begin("campaign", "warm.yaml", "--yes", "--out", "one")  # nothing is known of them: they count as hot
    line = process.stderr.readline()
    assert line.startswith("leactl: waiting 0:")
    assert line.endswith(" for the windings to cool, for slow, unloaded, repeat 1\n")
    second = leactl("campaign", "warm.yaml", "--out", "two")
    assert second.returncode == 5
    assert second.stderr.startswith(f"leactl: bench 'testbed-{os.getpid()}' has a campaign already, process ")
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=120)
    assert process.returncode == 4


@pytest.mark.long
def test_a_winding_that_a_supply_may_still_heat_is_refused_at_once_for_no_rest_cools_it(here, begin):
    (here / "warm.yaml").write_text(ON_TESTBED.replace("current_A: 0.5", "current_A: 20, hold_s: 4"))
    file, devices, _document = load("testbed.yaml")
    earlier = Windings(file, devices)
    earlier.may_be_left_on({"test": 140.0})
    earlier.keep_as_found()
    process = begin("campaign", "warm.yaml", "--yes", "--out", "one")
    assert "waiting" not in process.stderr.readline()
    assert "(test a supply may heat it still, since 20" in process.stderr.readline()
    assert process.wait(timeout=60) == 2
    assert finished(here / "one") == {}


def test_a_plan_is_printed_and_nothing_is_made(here):
    done = leactl("campaign", "small.yaml", "--dry-run", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert [row["run"] for row in answer["runs"]][:2] == ["s0//unloaded/1", "s1//unloaded/1"]
    planned = leactl("protocol", "plan", "spin.yaml", "--set", "hold_s=9", "--bench", "emulated", "--json")
    alone, row = json.loads(planned.stdout), answer["runs"][1]
    assert (row["step"], row["protocol"], row["duration_s"]) == ("s1", alone["name"], 9)
    keys = ("role", "quantity", "value", "unit")
    assert row["peaks"] == [{key: peak[key] for key in keys} for peak in alone["peaks"]]
    assert (row["peaks"][0]["role"], row["peaks"][0]["value"]) == ("test", 0.7)
    assert row["hottest_degC"] == alone["hottest_degC"]
    assert row["hottest_degC"]["test"] > 25
    assert not (here / "runs").exists()
    lines = leactl("campaign", "small.yaml", "--dry-run").stdout.splitlines()
    hottest = ", ".join(f"{role} {value:.0f}" for role, value in alone["hottest_degC"].items())
    assert re.split("  +", lines[2].strip()) == [
        "2",
        "0:09",
        f"s1 ({alone['name']})",
        "test 0.7 A",
        f"windings {hottest} degC at most",
        "unloaded",
        "repeat 1",
    ]
    text = leactl("campaign", "real.yaml", "--dry-run")
    assert text.stdout.count(f"mount bench 'testbed-{os.getpid()}'") == 4
    assert "4 of 4 runs are left, 0:01 of bench time, in runs/small" in text.stdout


def test_a_plan_is_refused_where_the_campaign_would_be(here):
    assert leactl("campaign", "small.yaml", "--out", "out").returncode == 0
    (here / "spin.yaml").write_text(SPIN.replace("rate_Hz: 50", "rate_Hz: 100"))
    (here / "file").write_text("")
    for name, where, words in (
        ("small.yaml", "out", "finished, and campaign, protocol or bench now say otherwise"),
        ("small.yaml", "file/out", "file/out: cannot be made or written to"),
    ):
        dry, real = (leactl("campaign", name, "--out", where, *also) for also in (["--dry-run"], []))
        assert (dry.returncode, dry.stdout, real.returncode) == (2, "", 2)
        assert words in dry.stderr


def test_unusable_input_is_status_2(here):
    done = leactl("campaign", "--variant", "x", "small.yaml")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "leactl: small.yaml:2:1  variants: variant 'x' is not known; known: none\n"
