"""The recipes of CONTRIBUTING.md, followed: files added to a package of their own, and used from the command line."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from leactl.runfile.read.reader import Run
from tests.cli.sessions import FILE
from tests.cli.terminal import leactl
from tests.runner.conftest import SPIN

ROOT = Path(__file__).parents[2]
RECIPES = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A folder for sys.path with the package as pip leaves it."""
    folder = tmp_path_factory.mktemp("environment")
    files = dict(FILE.findall(RECIPES))
    project = tomllib.loads(files.pop("pyproject.toml"))["project"]
    experiments = (ROOT / "docs" / "reference" / "experiments.md").read_text(encoding="utf-8")
    files["ripple.py"] = re.search(r"```python\n(.*?)```", experiments, re.DOTALL)[1]
    files["__init__.py"] = ""
    (folder / "my_bench").mkdir()
    for name, text in files.items():
        (folder / "my_bench" / name).write_text(text, encoding="utf-8")
    information = folder / "my_bench-0.1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1\n")
    groups = project["entry-points"].items()
    lines = [line for group, points in groups for line in (f"[{group}]", *(f"{n} = {m}" for n, m in points.items()))]
    (information / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture
def said(package, tmp_path, monkeypatch):
    """What a command says in an environment with the package."""
    monkeypatch.chdir(tmp_path)
    path = os.pathsep.join([str(package), str(ROOT), os.environ.get("PYTHONPATH", "")])

    def run(*words):
        command = [sys.executable, "-m", "leactl", *map(str, words)]
        surroundings = os.environ | {"PYTHONPATH": path, "LEACTL_STATE": str(tmp_path / "state")}
        done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


def test_the_driver_keeps_the_contract_and_reads_the_emulated_bench(said, tmp_path):
    assert said("driver", "check", "tmp102").startswith("tmp102: keeps the driver contract, in 7 trials")
    assert "period_s" in said("driver", "info", "tmp102")
    [device] = re.findall(r"^  room: .*$", RECIPES, re.MULTILINE)
    bench = leactl("bench", "show", "emulated").stdout.replace("devices:\n", f"devices:\n{device}\n", 1)
    (tmp_path / "mine.yaml").write_text(bench)
    said("bench", "check", "mine.yaml")
    assert re.search(r"ambient_temperature .* degC .* room", said("bench", "read", "mine.yaml"))


def test_the_effect_is_one_of_the_library_and_acts(said, tmp_path):
    assert "A steady wind turns the joint." in said("gap", "effects", "sea_wind")
    calm = said("bench", "model", "emulated")
    [effects] = re.findall(r"# add below: (effects: .*)$", RECIPES, re.MULTILINE)
    for name, text in {"calm.yaml": calm, "windy.yaml": f"{calm}{effects}\n", "spin.yaml": SPIN}.items():
        (tmp_path / name).write_text(text)
    said("run", "spin.yaml", "--bench", "emulated", "--out", "runs")
    [run] = Path("runs").glob("*.h5")
    velocities = []
    for name in ("calm", "windy"):
        said("gap", "simulate", f"{name}.yaml", run, "--out", f"{name}.h5")
        with Run.open(Path(f"{name}.h5")) as simulated:
            velocities.append(np.nanmean(simulated.channel("velocity").values))
    assert velocities[1] < velocities[0] - 0.1, "the wind is against the joint"


def test_the_experiment_analyses_a_run(said):
    said("run", "torque-constant", "--bench", "emulated", "--condition", "design", "--set", "trials=1", "--out", "runs")
    [run] = Path("runs").glob("*.h5")
    assert "torque_ripple" in said("analyze", run, "--as", "torque-ripple")


def test_the_motor_is_taken_by_its_path(said, tmp_path):
    (tmp_path / "my-motor.yaml").write_text(said("motor", "show", "lea").replace("name: lea", "name: mine", 1))
    assert "mine" in said("motor", "show", "my-motor.yaml")
    assert "standstill" in said("thermal", "limits", "--motor", "my-motor.yaml")
