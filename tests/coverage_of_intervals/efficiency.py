"""`python -m tests.coverage_of_intervals.efficiency`: efficiency maps of many seeds; status 1 where a limit is not met.

Each seed runs a grid on the emulated bench. `noise`: the bench is as its files say. `instruments`: torque sensor and
the resistance that the analysis is told are off by what it is told of their uncertainty.
"""

import argparse
import math
import os
import sys
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from multiprocessing import Pool
from pathlib import Path

import numpy as np

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes share the cores already

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.estimate import Grid, Result
from leactl.bench import benchfile
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute
from tests.analysis.coupled import Truth

from .__main__ import HEAD
from .judgement import LEAST_COVERED, MOST_COVERED, judge

SPEEDS, CURRENTS = (2.62, 26.18, 13.09), (18.0, 1.2, 12.0, 6.0)
# the true values are those at the asked speed: at 18 A and 2.62 rad/s it is still off by 0.2 % after 1.5 s
SETS = (
    f"speeds_rad_s={list(SPEEDS)}",
    f"currents_A={[-i for i in CURRENTS]}",
    "hold_s=3.5",
    "settle_s=2.5",
    "rest_s=5",
)
STEP_A = 11186e-6 * math.sqrt(1.5)  # a thousandth of the drive's rated current, in which it takes its demand
CASES = {"noise": {}, "instruments": {"torque_gain_std": 0.01, "resistance_std": 0.02}}
MOST_POINTS, MOST_LOSS = 0.02, 0.02  # efficiency off by, and relative error of losses, any seed, with noise alone


def main() -> int:
    """Parse, run, judge, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.coverage_of_intervals.efficiency", description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    print(HEAD, flush=True)
    faults = []
    for case in CASES:
        with Pool(asked.processes) as pool:
            answers = pool.map(answered, [(case, seed) for seed in range(1, asked.seeds + 1)], chunksize=1)
        truths = [true_values(Truth(), result.grids) for result in answers]
        for name in truths[0]:
            values = [truth[name] for truth in truths]
            outcome = judge(name, case, values, [result.find(name) for result in answers])
            errors = (outcome.mean_error, outcome.worst_error, outcome.bias, outcome.scatter, outcome.printed)
            shown = "".join(f"{error:10.4%}" for error in errors)
            print(f"{name:34}{case:12}{outcome.seeds:6}{outcome.covered:10.1%}{shown}", flush=True)
            if not LEAST_COVERED <= outcome.covered <= MOST_COVERED:
                faults.append(f"{name}, {case}: the interval holds the true value in {outcome.covered:.1%} of seeds")
            most = MOST_LOSS if "loss" in name else MOST_POINTS / min(map(abs, values))
            if case == "noise" and not outcome.worst_error <= most:
                faults.append(f"{name}, {case}: the worst seed is off by {outcome.worst_error:.2%}")
    for fault in faults:
        print(fault)
    return 1 if faults else 0


def answered(wanted: tuple[str, int]) -> Result:
    """The answer of one seed."""
    case, seed = wanted
    told = CASES[case]
    rng = np.random.default_rng([seed, sorted(CASES).index(case)])
    text = (benchfile.SHIPPED / "emulated.yaml").read_text().replace("name: emulated", "name: mine", 1)
    resistance = Truth().r
    if told:
        gain = 1.0 + rng.normal(0.0, told["torque_gain_std"])
        text += f"  effects: [{{name: torque_sensor_gain, gain: {gain!r}}}]\n"
        resistance *= 1.0 + rng.normal(0.0, told["resistance_std"])
    with tempfile.TemporaryDirectory() as folder:
        os.environ["LEACTL_STATE"] = f"{folder}/state"
        bench = Path(folder) / "mine.yaml"
        bench.write_text(text)
        sets = [f"seed={seed}", *SETS]
        request = prepare("efficiency", str(bench), sets, "a1", "design", "", Path(folder), False)
        outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
        if outcome.error is not None:
            raise outcome.error
        return analyze_runs([outcome.path], phase_resistance=float(resistance), **told)


def true_values(truth: Truth, grids: Sequence[Grid]) -> dict[str, float]:
    """Closed form at the points of the maps that were held, by the name of the result; powers at 25 degC.

    Speeds are those that the encoder saw: near the voltage's limit and soon after a step they are not quite the asked.
    """
    results = {}
    for grid in grids:
        w = np.abs(np.array(grid.values["velocity_rad_s"]))
        held = np.isfinite(w)
        i = STEP_A * np.round(np.abs(grid.axes["current_A"]) / STEP_A)
        driving = grid.name.endswith("driving")
        powers = truth.driving(w, i) if driving else truth.driven(w, i)
        own, electrical, mechanical = np.broadcast_arrays(*powers)
        share = mechanical / electrical if driving else electrical / mechanical
        lost = electrical - mechanical if driving else mechanical - electrical
        results |= {
            f"{grid.name}_efficiency": float(share[held].mean()),
            f"{grid.name}_efficiency_highest": float(share[held].max()),
            f"{grid.name}_loss": float(lost[held].mean()),
            f"{grid.name}_loss_copper": float((truth.r * own**2)[held].mean()),
            f"{grid.name}_loss_friction": float((truth.drag(w) * w)[held].mean()),
        }
    return results


if __name__ == "__main__":
    sys.exit(main())
