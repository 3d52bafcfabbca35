"""A servo's friction found from sixteen logs, beside the fits of a ladder of friction models by CMA-ES.

The ladder is that of Better Actuator Models (Rhoban/bam, 2026): Coulomb and viscous friction, then Stribeck's, load
dependence, both, load from motor and outside told apart, and its square. All logs are simulated at once, one parameter
set after the other, as that tool's optimiser asks for them; what a whole generation at once would take is told too. An
evaluation costs the same from the first to the last, so that a part of them tells what all take.
"""

import subprocess
import sys
import time
from pathlib import Path

import cma
import numpy as np

from leactl.gap.servo.runs import servo_runs
from leactl.gap.signals.record import read_record
from tests.gap.test_foreign import FILES, imported, nominal

LIMIT = 50.0
EVALUATIONS, TIMED = 15_000, 96  # of each model: published, and timed here
MOTOR = {"torque_constant": 0.37, "phase_resistance": 3.5, "rotor_inertia": 2e-3, "viscous": 6e-3, "coulomb": 0.018}
STRIBECK = {"stribeck": 0.01, "stribeck_velocity": 0.2, "stribeck_shape": 1.0}
LOAD = {"load": 0.1}
BOTH = STRIBECK | LOAD | {"load_stribeck": 0.05}
DIRECTED = BOTH | {"outside": 1.0}
LADDER = {
    "M1": MOTOR,
    "M2": MOTOR | STRIBECK,
    "M3": MOTOR | LOAD,
    "M4": MOTOR | BOTH,
    "M5": MOTOR | DIRECTED,
    "M6": MOTOR | DIRECTED | {"squared": 0.01},
}
ABSENT = STRIBECK | LOAD | {"stribeck": 0.0, "load": 0.0, "load_stribeck": 0.0, "outside": 1.0, "squared": 0.0}


def simulated(runs, sets):
    """Angles (sets, runs, samples) of every log under every set of parameters."""
    p = {name: value[:, None] for name, value in sets.items()}
    angle = np.repeat(runs.angle[None, :, 0], len(p["coulomb"]), axis=0)
    speed, out, step = np.zeros_like(angle), np.empty((*angle.shape, runs.angle.shape[1])), runs.interval
    inertia = p["rotor_inertia"] + runs.inertia
    for sample in range(runs.angle.shape[1]):
        out[:, :, sample] = angle
        volts = np.clip(runs.gain * (runs.reference[:, sample] - angle), -runs.limit, runs.limit)
        current = runs.enabled[:, sample] * (volts - p["torque_constant"] * speed) / p["phase_resistance"]
        motor, hanging = p["torque_constant"] * current, -runs.level * np.sin(angle)
        gear = np.abs(motor - p["outside"] * hanging)
        low = np.exp(-((np.abs(speed) / p["stribeck_velocity"]) ** p["stribeck_shape"]))
        friction = p["coulomb"] + p["stribeck"] * low + gear * (p["load"] + p["load_stribeck"] * low)
        friction += p["squared"] * gear**2 + p["viscous"] * np.abs(speed)
        push = motor + hanging
        speed = speed + step / inertia * (push - np.clip(inertia / step * speed + push, -friction, friction))
        angle = angle + step * speed
    return out


def evolve(runs, start, evaluations, at_once):
    """Fit one model of the ladder by CMA-ES on logarithms; mean absolute error, and seconds for an evaluation."""
    began = time.perf_counter()
    names, sizes = list(start), np.array(list(start.values()))
    strategy = cma.CMAEvolutionStrategy(np.zeros(len(names)), 0.3, {"verbose": -9, "seed": 1})
    while strategy.countevals < evaluations:
        asked = strategy.ask()
        points = sizes * np.exp(np.clip(asked, -5.0, 5.0))
        errors: list[float] = []
        for part in np.split(points, range(at_once or len(points), len(points), at_once or len(points))):
            sets = {name: np.full(len(part), value) for name, value in ABSENT.items()}
            angles = simulated(runs, sets | {name: part[:, k] for k, name in enumerate(names)})
            errors += np.abs(angles - runs.angle)[:, runs.measured].mean(axis=1).tolist()
        strategy.tell(asked, errors)
    return strategy.result.fbest, (time.perf_counter() - began) / strategy.countevals


def test_a_servo_is_diagnosed_sooner_than_a_ladder_is_evolved(tmp_path, figure):
    files = imported("bam_xl330", "processed/*.json", tmp_path)
    began = time.perf_counter()
    command = [Path(sys.executable).with_name("leactl"), "gap", "diagnose", *files]
    command += ["--model", FILES / "bam_xl330_model.yaml", "--json", tmp_path / "answer.json"]
    subprocess.run(command, check=True, capture_output=True)
    own = time.perf_counter() - began
    runs = servo_runs([read_record(file) for file in files], nominal("bam_xl330"))
    peer, generations = 0.0, 0.0
    for start in LADDER.values():
        best, each = evolve(runs, start, TIMED, 1)
        assert best < 0.2
        peer += each * EVALUATIONS
        generations += evolve(runs, start, TIMED, None)[1] * EVALUATIONS
    figure(
        f"XL330, 16 logs: {own:.1f} s for a whole diagnosis beside {peer:.0f} s for six models of {EVALUATIONS}"
        f" evaluations ({TIMED} of each timed), {peer / own:.0f} times as long, {generations / own:.0f} times with a"
        f" generation at once; limit {LIMIT:.0f}"
    )
    assert peer >= LIMIT * own
