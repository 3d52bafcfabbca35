"""The script of docs/how-to: four actuators in three conditions, killed at drawn moments and gone on with."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from itertools import product
from pathlib import Path

import pytest

from leactl.runfile.read.reader import Run
from tests.cli.terminal import leactl
from tests.cli.test_campaign import finished

SCRIPT = Path(__file__).parents[2] / "docs" / "how-to" / "four-actuators.sh"
TRUTH = {"LEA-1": 0.490, "LEA-2": 0.481, "LEA-3": 0.502, "LEA-4": 0.495}  # N*m/A, as the script has it
CELLS = set(product(TRUTH, ("unloaded", "design", "loaded")))
EXPERIMENTS = ("torque-constant", "friction")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    return tmp_path


def begin():
    """Start the script in a process group of its own."""
    return subprocess.Popen(
        ["sh", str(SCRIPT)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def killed(words, after_s):
    """Run the script and kill all of its processes so long after it told these words."""
    script = begin()
    told = []
    while not told or words not in told[-1]:
        told.append(script.stderr.readline())
        assert told[-1], told
    time.sleep(after_s)  # the moment itself, which is drawn
    os.killpg(script.pid, signal.SIGKILL)
    script.communicate(timeout=60)
    assert script.returncode == -signal.SIGKILL


def killed_and_gone_on_with(here, moments):
    """Kill the script at each of these moments, then run it to its end."""
    runs, before = here / "four-actuators" / "runs", {}
    for words, after_s in moments:
        killed(words, after_s)
        now = finished(runs)
        assert {key: now.get(key) for key in before} == before  # what was finished stays as it was
        before = now
    script = begin()
    out, err = script.communicate(timeout=240)
    assert script.returncode == 0, err
    now = finished(runs)
    assert {key: now.get(key) for key in before} == before
    assert "24 of 24 runs are finished in runs" in out


def runs_of_cells(folder):
    """Count the complete runs by actuator, condition and experiment; each is on the bench of its actuator."""
    count = Counter()
    for path in folder.glob("*.h5"):
        with Run.open(path) as run:
            assert run.status == "complete"
            assert run.attributes["bench"] == f"bench-of-{run.attributes['actuator'].lower()}"
            count[run.attributes["actuator"], run.attributes["condition"], run.attributes["protocol"]] += 1
    return count


def rows_of(report):
    """The torque constants of a report by actuator and condition."""
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", report.read_text(encoding="utf-8")))
    matches = re.findall(r"torque constant (\w+) (LEA-\d) ([\d.]+) ±", text)
    return {(actuator, condition): float(value) for condition, actuator, value in matches}


def look_at_all_of_it(here):
    folder = here / "four-actuators"
    assert runs_of_cells(folder / "runs") == {(*cell, name): 1 for cell in CELLS for name in EXPERIMENTS}
    [report] = here.rglob("*.html")
    constants = rows_of(report)
    assert constants.keys() == CELLS
    for (actuator, _), value in constants.items():
        assert value == pytest.approx(TRUTH[actuator], rel=0.002)
    [_index] = here.rglob("*.sqlite")
    query = ("runs", "list", folder / "runs", "--where", "status == 'complete'", "--json")
    listed = leactl(*query)
    assert listed.stderr == ""  # nothing had to be read anew: the index has all of it
    assert {row["file"] for row in json.loads(listed.stdout)["runs"]} == {
        path.name for path in (folder / "runs").glob("*.h5")
    }


@pytest.mark.long
def test_four_actuators_in_three_conditions_survive_two_kills(here):
    drawn = random.Random(25)
    moments = [(f"[{drawn.randint(*within)}/24", drawn.uniform(0.0, 0.7)) for within in ((2, 10), (12, 23))]
    killed_and_gone_on_with(here, moments)
    look_at_all_of_it(here)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(10))
def test_four_actuators_that_are_killed_often(here, seed):
    drawn = random.Random(seed)
    runs = sorted(drawn.sample(range(1, 25), 3))
    words = [*(f"[{number}/24" for number in runs), drawn.choice(["reading", "friction ...", "writing"])]
    killed_and_gone_on_with(here, [(word, drawn.uniform(0.0, 0.7)) for word in words])
    look_at_all_of_it(here)
