"""`python -m tests.coverage_of_intervals.laboratory`: the laboratory's experiments; status 1 where a limit is not met.

Every result with an interval is judged, over runs that the equations of `tests.analysis` make (laboratory_cases.py). Of
200 seeds one share in twenty lies outside 92 to 98 % by chance: a case with a fault is judged by up to 800.
"""

import argparse
import math
import os
import sys
import tempfile
from collections.abc import Sequence
from multiprocessing import Pool
from pathlib import Path

import numpy as np

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes share the cores already

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.estimate import Estimate
from tests.analysis.synthetic import Bench

from .__main__ import HEAD
from .judgement import LEAST_COVERED, Judgement, judge
from .laboratory_cases import CASES

AGAIN = 4  # times as many seeds at the most, where a case has a fault: 200 know a share to 1.5 %, 800 to 0.8 %
EXACT = "noise"  # the case to which limits of the error apply; elsewhere it is that of the instruments


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, make, analyse, judge, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.coverage_of_intervals.laboratory", description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--only", choices=CASES, action="append", help="an experiment; without it, all of them")
    asked = parser.parse_args(arguments)
    faults: list[str] = []
    for experiment in asked.only or CASES:
        print(f"\n{experiment}\n{HEAD}", flush=True)
        for case in CASES[experiment]:
            result: list[tuple[Judgement, bool]] = []
            answers: list[Answer] = []
            while not answers or (len(answers) < AGAIN * asked.seeds and any(faults_of(*item) for item in result)):
                first = len(answers) + 1
                wanted = [(experiment, case, seed) for seed in range(first, first + asked.seeds)]
                with Pool(asked.processes) as pool:
                    answers += pool.map(answered, wanted, chunksize=1)
                result = judged(case, answers)
            for item, bound in result:
                print(shown(item, bound), flush=True)
                faults += [f"{experiment}: {fault}" for fault in faults_of(item, bound)]
    for fault in faults:
        print(fault)
    return 1 if faults else 0


Answer = list[tuple[Estimate, float, bool]]  # what was found, what is true, and whether one end alone counts


def answered(wanted: tuple[str, str, int]) -> Answer:
    """Every result of one seed that has an interval.

    Raises
    ------
    KeyError : one of which no truth is known.
    """
    experiment, case, seed = wanted
    rng = np.random.default_rng([seed, list(CASES).index(experiment), list(CASES[experiment]).index(case)])
    with tempfile.TemporaryDirectory() as folder:
        made = CASES[experiment][case](Bench(Path(folder), rng))
        results = analyze_runs([made.path], **made.told).results
    return [
        (item, made.true[item.name], item.name in made.bounds)
        for item in results
        if not (math.isnan(item.low) and math.isnan(item.high)) and not math.isnan(made.true[item.name])
    ]


def judged(case: str, answers: Sequence[Answer]) -> list[tuple[Judgement, bool]]:
    """Each result over all seeds, and whether it is a bound."""
    found: dict[tuple[str, bool], list[tuple[Estimate, float]]] = {}
    for answer in answers:
        for item, true, bound in answer:
            found.setdefault((item.name, bound), []).append((item, true))
    return [
        (judge(name, case, [true for _, true in pairs], [item for item, _ in pairs]), bound)
        for (name, bound), pairs in found.items()
    ]


def shown(item: Judgement, bound: bool) -> str:
    """One line of the table; a bound has no error."""
    start = f"{item.name:28}{item.condition:14}{item.seeds:6}{item.covered:10.1%}"
    if bound:
        return f"{start}     bound"
    errors = (item.mean_error, item.worst_error, item.bias, item.scatter, item.printed)
    return start + "".join(f"{error:10.4%}" for error in errors)


def faults_of(item: Judgement, bound: bool) -> list[str]:
    """What of it does not meet a limit."""
    if bound:
        few = item.covered < LEAST_COVERED
        return [f"{item.name}, {item.condition}: the bound holds in {item.covered:.1%} of seeds"] if few else []
    return item.faults_of_coverage + (item.faults_of_error if item.condition == EXACT else [])


if __name__ == "__main__":
    sys.exit(main())
