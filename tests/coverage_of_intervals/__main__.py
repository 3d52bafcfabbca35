"""`python -m tests.coverage_of_intervals DIRECTORY`: runs, analyses and figures; status 1 where a limit is not met."""

import argparse
import math
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes share the cores already

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.estimate import Estimate
from leactl.analysis.voltage_waves.line_voltages import PAIRS
from leactl.bench import benchfile
from leactl.model.motor import load_motor

from .judgement import Judgement, judge
from .rehearsal import CONDITIONS, EXPERIMENTS, Rehearsal, rehearse, wanted

HEAD = f"{'result':28}{'condition':14}{'seeds':>6}" + "".join(
    f"{word:>10}" for word in ("covered", "mean", "worst", "bias", "scatter", "printed")
)


def main() -> int:
    """Parse, run, judge, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.coverage_of_intervals", description=__doc__)
    parser.add_argument("directory", type=Path, help="where the runs are kept; those that are there are not run again")
    parser.add_argument("--seeds", type=int, default=200, help="how many")
    parser.add_argument("--first", type=int, default=1, help="the first of them")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--only", choices=EXPERIMENTS, action="append", help="an experiment; without it, all of them")
    parser.add_argument("--condition", choices=CONDITIONS, action="append", help="a preload; without it, all of them")
    asked = parser.parse_args()
    asked.directory.mkdir(parents=True, exist_ok=True)
    seeds = range(asked.first, asked.first + asked.seeds)
    rehearsals = wanted(asked.directory, seeds, asked.only or EXPERIMENTS, asked.condition or CONDITIONS)
    for count, made in enumerate(rehearse(rehearsals, asked.processes), start=1):
        print(f"{count}: {made.path.name}", file=sys.stderr)
    judgements = judged(rehearsals)
    print(HEAD)
    for item in judgements:
        print(shown(item))
    faults = [fault for item in judgements for fault in item.faults]
    for fault in faults:
        print(fault)
    return 1 if faults else 0


def shown(item: Judgement) -> str:
    """One line of the table."""
    errors = (item.mean_error, item.worst_error, item.bias, item.scatter, item.printed)
    numbers = "".join(f"{error:10.4%}" for error in errors)
    return f"{item.name:28}{item.condition:14}{item.seeds:6}{item.covered:10.1%}{numbers}"


def judged(rehearsals: list[Rehearsal]) -> list[Judgement]:
    """Every result that has a true value, under every condition."""
    estimates: dict[tuple[str, str], list[Estimate]] = {}
    for rehearsal in rehearsals:
        for item in analyze_runs([rehearsal.path]).results:
            estimates.setdefault((item.name, rehearsal.condition), []).append(item)
    true = {(name, label): value for label in CONDITIONS for name, value in true_values(label).items()}
    known = [key for key in sorted(true) if key in estimates]
    return [judge(*key, true[key], estimates[key]) for key in known]


def true_values(condition: str) -> dict[str, float]:
    """What the emulated bench is made of, by the name of the result that estimates it."""
    file, _, _ = benchfile.load("emulated")
    assert file.emulated is not None
    motor = load_motor(file.motors["test"])[0]
    plant = {"torque_constant": motor.torque_constant, **file.emulated.conditions[condition]}
    sides = {"torque_constant": ("rising", "falling")}
    named = {name: value for name, value in plant.items() if name in ("viscous_damping", "coulomb_friction")}
    named["torque_constant"] = plant["torque_constant"]
    each = {
        f"{name}_{side}": value for name, value in named.items() for side in sides.get(name, ("forward", "backward"))
    }
    line = math.sqrt(2.0) * motor.back_emf_constant
    voltages = {"back_emf_constant": motor.back_emf_constant, "line_to_line_constant": line}
    voltages |= {f"line_to_line_constant_{pair}": line for pair in PAIRS} | {"pole_pairs": float(motor.pole_pairs)}
    return named | each | voltages | {"sticking_torque": plant["coulomb_friction"]}


if __name__ == "__main__":
    sys.exit(main())
