"""The wheel alone, in an empty environment and another folder, carries plug-ins, protocols, pages and the demo."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.long
def test_the_wheel_runs_the_demo_in_an_empty_environment(tmp_path):
    wheels, environment, elsewhere = tmp_path / "wheels", tmp_path / "environment", tmp_path / "elsewhere"
    elsewhere.mkdir()
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", wheels, ROOT], check=True)
    [wheel] = wheels.glob("leactl-*.whl")
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    subprocess.run([environment / "bin/python", *pip[1:], "install", wheel], check=True)

    def leactl(*arguments):
        clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
        run = [environment / "bin/leactl", *arguments]
        return subprocess.run(
            run, cwd=elsewhere, env=clean | {"LEACTL_STATE": str(tmp_path)}, check=True, capture_output=True, text=True
        ).stdout

    drivers = json.loads(leactl("driver", "list", "--json"))
    named = {item["name"] for item in drivers["drivers"]}
    assert {"elmo_can", "ads1115", "scpi_supply", "bk1688b", "korad_ka"} <= named
    assert "torque-constant" in leactl("protocol", "list")
    assert leactl("docs", "safety") == (ROOT / "docs/explanation/safety.md").read_text(encoding="utf-8")
    answer = json.loads(leactl("demo", "--json"))
    assert len(answer["files"]) == 6
    assert all((elsewhere / name).is_file() for name in answer["files"])
    leactl("runs", "plot", answer["files"][0], "--html", "plot.html")
    assert "<svg" in (elsewhere / "plot.html").read_text(encoding="utf-8")
