"""Erratum of the print on friction currents: 0.03 A from 0.6 or 0.76 A meets neither printed end."""

import math
from importlib import resources

import numpy as np
import pytest
import yaml

from leactl.model.motor import load_motor

PRINTED = {"design": (0.60, 0.74), "loaded": (0.76, 0.89)}  # A; unloaded is as design
STEP = 0.03


def shipped():
    """Levels [A] of the protocol by condition."""
    told = yaml.safe_load((resources.files("leactl_protocols") / "friction.yaml").read_text())
    return {
        "design": told["parameters"]["levels_A"],
        "loaded": told["conditions"]["loaded"]["levels_A"],
    }


@pytest.mark.parametrize(("condition", "steps"), [("design", 4.67), ("loaded", 4.33)])
def test_printed_steps_miss_the_printed_end(condition, steps):
    first, last = PRINTED[condition]
    assert (last - first) / STEP == pytest.approx(steps, abs=0.005)


def test_a_printed_step_is_0_025_a_of_drive_amplitude():
    assert round(math.sqrt(3.0 / 2.0) * 0.025, 2) == STEP
    assert round(math.sqrt(3.0 / 2.0) * STEP, 2) != STEP  # as an amplitude 0.03 A would be 0.04 A of the q axis


@pytest.mark.parametrize("condition", PRINTED)
def test_the_protocol_has_five_even_levels_from_end_to_end(condition):
    assert shipped()[condition] == pytest.approx(np.linspace(*PRINTED[condition], 5), abs=1e-9)


def test_every_level_of_the_protocol_turns_the_rotor_it_is_for():
    """Kt i above the printed Coulomb friction; the levels of the design preload would leave a loaded rotor stuck."""
    coulomb = {"design": 0.2419, "loaded": 0.3037}  # N*m, the larger of unloaded and design
    turns = load_motor("lea")[0].torque_constant
    for condition, levels in shipped().items():
        assert turns * min(levels) > coulomb[condition]
    assert turns * shipped()["design"][0] < coulomb["loaded"]
