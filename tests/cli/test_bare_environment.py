"""Commands where there is no HOME, and in a terminal of 20 columns: they end in order and show every value."""

import os
import re
import subprocess
import sys

import pytest

from tests.cli.terminal import COMMAND

NOBODY = "import sys\nsys.modules['pwd'] = None\n"  # as for a user whom the system does not know
QUICK = ("--condition", "loaded", "--set", "trials=1", "--set", "settle_s=0.5", "--set")  # and hold_s


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bare")
    state = str(folder / "state")
    done = homeless(
        folder, "run", "friction", *QUICK, "hold_s=1", "--actuator", "LEA-7", "--out", ".", LEACTL_STATE=state
    )
    assert done.returncode == 0, done.stderr
    next(folder.glob("*.h5")).rename(folder / "friction.h5")
    longer = ("hold_s=1.25", "--set", "levels_A=[0.76, 0.89]")  # parameters that differ stand in the list
    done = homeless(folder, "run", "friction", *QUICK, *longer, "--out", ".", LEACTL_STATE=state)
    assert done.returncode == 0, done.stderr
    (folder / "nobody").mkdir()
    (folder / "nobody" / "sitecustomize.py").write_text(NOBODY, encoding="utf-8")
    return folder


def homeless(folder, *arguments, **more):
    environment = {name: os.environ[name] for name in os.environ.keys() - {"HOME", "LEACTL_STATE", "XDG_STATE_HOME"}}
    return subprocess.run(
        [*COMMAND, *arguments], cwd=folder, env=environment | more, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    "command",
    ["runs list .", "runs show friction.h5", "analyze friction.h5", "report friction.h5 --json", "motor show lea"],
)
def test_what_reads_alone_needs_no_home(folder, command):
    path = os.pathsep.join([str(folder / "nobody"), os.environ.get("PYTHONPATH", "")])
    done = homeless(folder, *command.split(), PYTHONPATH=path)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
    assert done.stdout or "done in" in done.stderr


def test_a_run_without_a_home_says_what_to_set(folder):
    path = os.pathsep.join([str(folder / "nobody"), os.environ.get("PYTHONPATH", "")])
    words = ("run", "friction", *QUICK, "hold_s=1", "--out", "made")
    refused = homeless(folder, *words, PYTHONPATH=path)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == "leactl: there is no home directory for leactl's state; set LEACTL_STATE to a directory\n"
    assert not (folder / "made").exists()
    done = homeless(folder, *words, PYTHONPATH=path, LEACTL_STATE=str(folder / "kept"))
    assert done.returncode == 0, done.stderr


def seen(folder, columns, *arguments):
    """What a command shows in a terminal of so many columns."""
    pexpect = pytest.importorskip("pexpect")
    environment = {name: os.environ[name] for name in os.environ.keys() - {"COLUMNS"}} | {"PYTHONIOENCODING": "utf-8"}
    child = pexpect.spawn(
        sys.executable,
        [*COMMAND[1:], *arguments],
        cwd=folder,
        env=environment,
        dimensions=(24, columns),
        encoding="utf-8",
        timeout=60,
    )
    child.expect(pexpect.EOF)
    child.close()
    assert child.exitstatus == 0, child.before
    assert "Traceback" not in child.before
    return child.before


@pytest.mark.parametrize("command", ["runs list .", "runs show friction.h5", "analyze friction.h5"])
def test_a_terminal_of_20_columns_loses_no_value(folder, command):
    narrow, wide = (seen(folder, columns, *command.split()) for columns in (20, 200))
    values = re.findall(r"\S*\d\S*", wide.partition("\no forward")[0])  # the plot has ticks of its own in each width
    assert len(values) >= 5
    wrapped = re.sub(r"\s", "", narrow)  # a value may go on in the next line
    assert [value for value in values if value not in wrapped] == []
