"""A package of its own brings an effect by an entry point; what it forgets is named."""

import json
import os
import subprocess
import sys

import pytest

MODULE = '''
import numpy as np
from leactl.effects.contract import Effect

class SeaWind(Effect):
    """A steady torque from outside."""

    name = "sea_wind"

    def terms(self, signals, form):
        return {} if signals.angle is None else {"drag": {"torque": np.ones_like(signals.angle)}}

    def parameters(self, form, found, model):
        return {"torque": found["torque"]}

    def act(self, parameters, plant):
        plant.rotor_torque.append(lambda now: -parameters["torque"] + 0.0 * now.angle)
'''
DEFINITION = """\
effect: sea_wind
family: machine
meaning: "A steady wind turns the joint."
parameters:
  torque: {units: "N*m", low: 0.01, high: 10, meaning: "against the joint"}
acts_over: [direction]
shown_on: [joint]
shows_in: "torque balance, alike at any speed"
confused_with: "current_sensor_offset"
shown_by: "slow turns both ways"
faint: {size: 0.05, units: "N*m"}
"""


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "windy"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "sea_wind.py").write_text(MODULE)
    (folder / "sea_wind.yaml").write_text(DEFINITION)
    info = tmp_path / "windy-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: windy\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[leactl.effects]\nsea_wind = windy.sea_wind\n")
    return tmp_path


def leactl(package, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "leactl", *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(package), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        check=False,
    )


def test_an_effect_of_another_package_is_one_of_the_library(package):
    completed = leactl(package, "gap", "effects", "sea_wind", "--json")
    assert completed.returncode == 0, completed.stderr
    assert json.loads(completed.stdout)["parameters"][0]["name"] == "torque"


def test_a_definition_that_is_missing_is_named(package):
    (package / "windy" / "sea_wind.yaml").unlink()
    completed = leactl(package, "gap", "effects", "sea_wind")
    assert completed.returncode == 2
    assert "sea_wind.yaml" in completed.stderr
    assert "Traceback" not in completed.stderr


def test_a_form_that_is_missing_is_named(package):
    (package / "windy" / "sea_wind.py").write_text("")
    completed = leactl(package, "gap", "effects", "sea_wind")
    assert completed.returncode == 2
    assert "windy.sea_wind: no class of effect sea_wind is there" in completed.stderr
