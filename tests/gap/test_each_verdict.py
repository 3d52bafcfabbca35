"""Each verdict of `gap diagnose` at the command line, from runs of drawn machines that share no equation with it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from leactl.joints.files import write_run
from leactl.joints.machine import draw_machine, nominal_text
from leactl.joints.make import draw_runs
from leactl.joints.stepped import simulate
from tests.cli.terminal import leactl

LOGGED = ("current", "angle", "current_reference", "velocity")


def answer(folder, effects, exact=False):
    """What the command says of a machine with these effects, whose model is off or exact."""
    machine = draw_machine(np.random.default_rng([2, 0]), "geared_joint")
    machine = replace(machine, channels=LOGGED, sampling=True, rate=500.0, seconds=6.0)
    runs = draw_runs(np.random.default_rng([2, 1]), machine, effects, "strong")
    true = runs[0].specimen.true_base()
    of_the_rotor = {name: value for name, value in true.items() if name != "back_emf_constant"}
    nominal = replace(machine, **of_the_rotor) if exact else machine  # whose back-EMF constant is its torque constant
    (folder / "nominal.yaml").write_text(nominal_text(nominal), encoding="utf-8")
    for run, signals in zip(runs, simulate(runs), strict=True):
        write_run(folder, "case", run, signals)
    done = leactl("gap", "diagnose", *sorted(folder.glob("*.h5")), "--model", folder / "nominal.yaml", "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("verdict", "effects", "exact"),
    [
        ("none", [], True),
        ("calibration", [], False),
        ("effect", ["quadratic_drag"], False),
        ("unknown", ["push_in_time"], False),
    ],
)
def test_each_verdict_is_reached(tmp_path, verdict, effects, exact):
    found = answer(tmp_path, effects, exact)
    assert found["verdict"] == verdict, found["notes"]
    assert [cause["effect"] for cause in found["causes"] if cause["probability"] >= 0.5] == (
        effects if verdict == "effect" else []
    )
