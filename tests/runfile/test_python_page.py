"""The page about Python: its snippet runs as it stands, and what it lists is there."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

from leactl.runfile.reader import Run
from tests.cli.terminal import leactl

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "python.md"


def test_the_snippet_runs_as_it_stands(tmp_path):
    done = leactl("run", "current-step", "--bench", "emulated", "--out", tmp_path, LEACTL_STATE=str(tmp_path / "state"))
    assert done.returncode == 0, done.stderr
    [run] = tmp_path.glob("*.h5")
    run.rename(tmp_path / "run.h5")
    [snippet] = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", snippet], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("complete locked ")
    assert "N*m" in done.stdout


def test_every_member_that_the_page_lists_is_there():
    table = PAGE.read_text(encoding="utf-8").split("|---|---|")[1]
    members = {name for cell in re.findall(r"^\| (.*?) \|", table, re.M) for name in re.findall(r"`(\w+)", cell)}
    assert len(members) >= 12
    known = dict(inspect.getmembers(Run))
    assert members <= known.keys()
