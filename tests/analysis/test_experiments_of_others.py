"""Experiments of other packages: the documented example, registered by entry point, used from the command line."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.synthetic import Bench
from tests.cli.terminal import leactl

DOCS = Path(__file__).parents[2] / "docs" / "reference" / "experiments.md"


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Bench(tmp_path)


def installed(folder, text):
    """A folder for sys.path with a package as pip leaves it."""
    (folder / "ripple.py").write_text(text, encoding="utf-8")
    information = folder / "ripple-0.3.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: ripple\nVersion: 0.3\n")
    (information / "entry_points.txt").write_text("[leactl.experiments]\ntorque-ripple = ripple\n")
    return str(folder)


def example():
    text = re.search(r"```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)[1]
    assert text.count("\n") < 60
    return text


def recorded(bench):
    time = np.arange(2000) / 200.0
    torque = 1.0 + 0.05 * np.sqrt(2.0) * np.sin(50.0 * time)
    steps = [("hold", 0.0, 5.0, 0.0, {"current_A": 1.0}), ("hold", 5.0, 10.0, 0.0, {"current_A": 1.0})]
    return bench.write("torque-ripple", time, {"torque": torque}, steps).name


def test_the_documented_example_analyses_a_run(bench, tmp_path):
    path = recorded(bench)
    done = leactl("analyze", path, "--json", PYTHONPATH=installed(tmp_path, example()))
    assert (done.returncode, done.stderr) == (0, "")
    answer = json.loads(done.stdout)
    assert answer["experiment"] == "torque-ripple"
    assert answer["results"][0]["value"] == pytest.approx(0.05, rel=0.01)
    shown = leactl("report", path, "--html", "sheet.html", PYTHONPATH=str(tmp_path))
    assert shown.returncode == 0, shown.stderr
    page = (tmp_path / "sheet.html").read_text(encoding="utf-8")
    assert "Torque ripple: how much single readings" in page


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import not_there\n", "cannot be used: ModuleNotFoundError: No module named 'not_there'"),
        ("RESULTS = {}\n", "cannot be used: it has no function analyze(runs, **options)"),
        ("RESULTS = {}\ndef analyze(runs):\n    return 1 / 0\n", "failed: ZeroDivisionError: division by zero"),
        ("RESULTS = {}\ndef analyze(runs):\n    return 3\n", "gave int; a leactl Result was expected"),
        ("RESULTS, CHANNELS = {}, {'velocity': 'load'}\ndef analyze(runs): ...\n", "no velocity of load; the run has"),
    ],
)
def test_one_that_cannot_be_used_is_reported_in_a_line_and_harms_no_other(bench, tmp_path, text, message):
    place = installed(tmp_path, text)
    done = leactl("analyze", recorded(bench), PYTHONPATH=place)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert leactl("analyze", bench.torque().name, PYTHONPATH=place).returncode == 0


def test_a_result_that_is_not_declared_is_refused(bench, tmp_path):
    place = installed(tmp_path, example().replace('RESULTS = {"torque_ripple"', 'RESULTS = {"ripple"'))
    done = leactl("analyze", recorded(bench), PYTHONPATH=place)
    assert done.returncode == 2
    assert "gave torque_ripple [N*m]; it declares ripple [N*m]" in done.stderr
