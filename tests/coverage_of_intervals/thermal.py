"""`python -m tests.coverage_of_intervals.thermal`: heated records of many seeds against the plant they were made from.

The plant is that of `tests.analysis.heated`, three phases solved by themselves. Status 1 where a limit is not met.
"""

import argparse
import math
import os
import sys
import tempfile
from multiprocessing import Pool
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes share the cores already

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.estimate import Result
from tests.analysis.heated import HeatedBench, Plant, conduction

from .judgement import LEAST_COVERED, MOST_COVERED, judge

RISE, AIR = 105.0, 25.0
MOST_RMSE = 1.05  # times the noise, where noise is all there is
NETWORK, JOINT = 5, 11.07  # parameters first in the covariance, and 95 % of chi squared with as many
WORST = {"parallel_thermal_resistance": 0.02, "housing_capacitance": 0.05, "line_resistance": 0.005}
EXACT = {"camera_offset_std": 0.0, "camera_gain_std": 0.0}
INSTRUMENTS = {
    "camera_offset_std": 1.0,
    "camera_gain_std": 0.01,
    "voltage_gain_std": 0.002,
    "current_gain_std": 0.003,
}
CASES = {"noise": (0.0, EXACT), "drift": (0.05, EXACT), "instruments": (0.05, INSTRUMENTS)}
HEAD = f"{'result':30}{'case':12}{'seeds':>6}" + "".join(
    f"{word:>10}" for word in ("covered", "mean", "worst", "bias", "scatter", "printed")
)


def main() -> int:
    """Parse, make, analyse, judge, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.coverage_of_intervals.thermal", description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--rate", type=float, default=5.0, help="of camera and supply [Hz]")
    asked = parser.parse_args()
    plant = Plant()
    true, faults = {**plant.known, **currents(plant)}, []
    print(HEAD)
    for case in CASES:
        wanted = [(case, seed, asked.rate) for seed in range(1, asked.seeds + 1)]
        with Pool(asked.processes) as pool:
            results = pool.map(answered, wanted, chunksize=1)
        for name, value in true.items():
            outcome = judge(name, case, value, [result.find(name) for result in results])
            errors = (outcome.mean_error, outcome.worst_error, outcome.bias, outcome.scatter, outcome.printed)
            shown = "".join(f"{error:10.4%}" for error in errors)
            print(f"{name:30}{case:12}{outcome.seeds:6}{outcome.covered:10.1%}{shown}", flush=True)
            if not LEAST_COVERED <= outcome.covered <= MOST_COVERED:
                faults.append(f"{name}, {case}: the interval holds the true value in {outcome.covered:.1%} of seeds")
            if case != "instruments" and outcome.worst_error > WORST.get(name, math.inf):
                faults.append(f"{name}, {case}: the worst seed is off by {outcome.worst_error:.2%}")
        joint = np.mean([distance(result, plant) < JOINT for result in results])
        over = max(result.find("rmse_over_noise").value for result in results)
        print(f"{'all five together':30}{case:12}{asked.seeds:6}{joint:10.1%}   residuals {over:.4f} of the noise")
        if case == "noise" and over > MOST_RMSE:
            faults.append(f"residuals reach {over:.3f} times the noise")
    for fault in faults:
        print(fault)
    return 1 if faults else 0


def answered(wanted: tuple[str, int, float]) -> Result:
    """The answer of one seed."""
    case, seed, rate = wanted
    drift, stds = CASES[case]
    rng = np.random.default_rng([seed, sorted(CASES).index(case)])
    off = {name: float(rng.normal(0.0, std)) for name, std in stds.items()}

    def misread(time: object, camera: dict[str, np.ndarray], supply: dict[str, np.ndarray]) -> None:
        supply["line_voltage"] *= 1.0 + off.get("voltage_gain_std", 0.0)
        supply["line_current"] *= 1.0 + off.get("current_gain_std", 0.0)

    with tempfile.TemporaryDirectory() as folder:
        path = HeatedBench(Path(folder), rng).run(
            rate_Hz=rate,
            drift=drift,
            offset=off["camera_offset_std"],
            gain=1.0 + off["camera_gain_std"],
            lag=float(rng.uniform(-5.0, 5.0)),
            moment=float(rng.uniform()),
            edit=misread,
        )
        return analyze_runs([path], **stds)


def distance(result: Result, plant: Plant) -> float:
    """How far the network's parameters lie from the truth together, by their joint covariance; chi squared."""
    [covariance] = result.covariances
    left = np.array([result.find(name).value - plant.known[name] for name in covariance.names[:NETWORK]])
    whole = np.array(covariance.values)[:NETWORK, :NETWORK]
    spread = np.sqrt(np.diag(whole))
    table = whole / np.outer(spread, spread)
    return float((left / spread) @ np.linalg.solve(table, left / spread))


def currents(plant: Plant) -> dict[str, float]:
    """Currents that take the hottest phase to its limit, by the plant's own four bodies."""
    results = {}
    for motion, shares in (("", (1 / 3, 1 / 3, 1 / 3)), ("_standing", (2 / 3, 1 / 6, 1 / 6))):
        for name, duration in (("continuous_current", 1e5), ("peak_current_20s", 20.0), ("peak_current_300s", 300.0)):

            def over(current: float, shares: tuple[float, ...] = shares, duration: float = duration) -> float:
                capacities, flows = conduction(plant)
                heat = 0.5 * plant.line_resistance * current**2 * np.array([*shares, 0.0])
                whole = np.zeros((5, 5))
                whole[:4, :4] = (np.diag(plant.alpha * heat) - flows) / capacities[:, None]
                whole[:4, 4] = heat / capacities
                return float(expm(whole * duration)[:3, 4].max()) - RISE

            results[name + motion] = float(brentq(over, 1.0, 15.0 if duration > 1e3 else 50.0))
    return results


if __name__ == "__main__":
    sys.exit(main())
