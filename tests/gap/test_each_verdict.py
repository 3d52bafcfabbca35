"""Each verdict of `gap diagnose` at the command line, from runs of drawn machines that share no equation with it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from leactl.joints.machine import draw_machine
from leactl.joints.make import draw_runs
from tests.cli.terminal import leactl
from tests.gap.drawn_machines import write_cases

LOGGED = ("current", "angle", "current_reference", "velocity")


VERDICTS = [  # with the effects of the machine, and whether its model file is exact
    ("none", [], True),
    ("calibration", [], False),
    ("effect", ["quadratic_drag"], False),
    ("unknown", ["push_in_time"], False),
]


def drawn(effects, exact):
    """A machine whose model file is off or exact, and runs with these effects."""
    machine = draw_machine(np.random.default_rng([2, 0]), "geared_joint")
    machine = replace(machine, channels=LOGGED, sampling=True, rate=500.0, seconds=6.0)
    runs = draw_runs(np.random.default_rng([2, 1]), machine, effects, "strong")
    true = runs[0].specimen.true_base()
    of_the_rotor = {name: value for name, value in true.items() if name != "back_emf_constant"}
    # whose back-EMF constant is its torque constant
    return replace(machine, **of_the_rotor) if exact else machine, runs


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    """Folder with the case of each verdict."""
    folder = tmp_path_factory.mktemp("verdicts")
    write_cases(folder, {verdict: drawn(effects, exact) for verdict, effects, exact in VERDICTS})
    return folder


@pytest.mark.parametrize(("verdict", "effects"), [item[:2] for item in VERDICTS])
def test_each_verdict_is_reached(cases, verdict, effects):
    folder = cases / verdict
    done = leactl("gap", "diagnose", *sorted(folder.glob("*.h5")), "--model", folder / "nominal.yaml", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["verdict"] == verdict, answer["notes"]
    assert [cause["effect"] for cause in answer["causes"] if cause["probability"] >= 0.5] == (
        effects if verdict == "effect" else []
    )
