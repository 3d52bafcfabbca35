"""`python -m tests.coverage_of_intervals.loops DIRECTORY`: the control loops.

Status 1 where a result whose error has a limit misses that or 92 to 98 %, or a rise time is off by more than a sample.

Each seed has loops of its own, a little off those of the shipped bench, a drive that acts on a jump somewhere within
a cycle of the host, angles to step to whose tenths are no whole counts of the encoder, and noise of its own.
"""

import argparse
import contextlib
import json
import os
import shutil
import sys
from contextlib import nullcontext
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import yaml

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the processes share the cores already

from leactl.analysis.analyze import analyze_runs
from leactl.analysis.estimate import Estimate
from leactl.bench import benchfile
from leactl.emulation.bench import emulated_bench
from leactl.emulation.plant.exact.rig import Rig
from leactl.runner.operators import confirm_at_once
from leactl.runner.request import prepare
from leactl.runner.session import execute

from .__main__ import HEAD, shown
from .judgement import judge
from .plant import WatchedRig, current_loop_bandwidth, drawn_lag, drawn_levels, drawn_loops, position_bandwidth

CONDITION = "design"
SHORTER = {"current-noise": ["trials=1", "subtrials=1"]}
SAMPLE_S = 1e-3


def main() -> int:
    """Parse, run, judge, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.coverage_of_intervals.loops", description=__doc__)
    parser.add_argument("directory", type=Path, help="where the runs are kept; those that are there are not run again")
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    asked.directory.mkdir(parents=True, exist_ok=True)
    wanted = [(asked.directory, seed, name) for seed in range(1, asked.seeds + 1) for name in TRUTHS]
    found: dict[tuple[str, str], list[tuple[float, Estimate]]] = {}
    with Pool(asked.processes) as pool:
        for name, truths, path in pool.imap_unordered(rehearsed, wanted):
            print(path.name, file=sys.stderr)
            for item in analyze_runs([path]).results:
                if item.name in truths:
                    found.setdefault((name, item.name), []).append((truths[item.name], item))
    print(HEAD)
    faults = []
    for (name, result), pairs in sorted(found.items()):
        trues, estimates = zip(*pairs, strict=True)
        if name == "current-noise":
            held = sum(item.low <= true <= item.high for true, item in pairs)
            print(f"{name}: the true bandwidth lies within {held} of {len(pairs)} bounds")
            faults += [f"{name}: a true bandwidth lies beyond its bound"] * (held < len(pairs))
            continue
        judged = judge(result, name, trues, estimates)
        print(shown(judged))
        faults += judged.faults
        if result == "rise_time" and max(abs(item.value - true) for true, item in pairs) > SAMPLE_S:
            faults.append(f"rise_time, {name}: a seed is off by more than a sample")
    for fault in faults:
        print(fault)
    return 1 if faults else 0


BENCHES: list[emulated_bench.EmulatedBench] = []  # of this process, in order


class Seen(emulated_bench.EmulatedBench):
    """An emulated bench that is still there after its run."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        BENCHES[:] = [self]


def rehearsed(wanted: tuple[Path, int, str]) -> tuple[str, dict[str, float], Path]:
    """A run of one experiment with the loops of a seed, made unless it is there, and what is true of it."""
    directory, seed, name = wanted
    path = directory / f"{name}_{seed:04}.h5"
    truth = path.with_suffix(".json")
    if not truth.exists():
        loops = drawn_loops(seed)
        unfinished = path.with_suffix("")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir()
        os.environ["LEACTL_STATE"] = str(unfinished / "state")
        bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        bench["emulated"]["bench"] = loops
        (unfinished / "bench.yaml").write_text(yaml.safe_dump(bench, sort_keys=False))
        sets = [f"seed={seed}", *SHORTER.get(name, [])]
        if name == "position-step":
            sets += drawn_levels(seed)
        if name.endswith("noise"):
            sets += [f"{level}_seed={10_000 * seed + 1000 * k}" for k, level in enumerate(("small", "middle", "large"))]
        bench_file = str(unfinished / "bench.yaml")
        emulated_bench.Rig = WatchedRig if name.endswith("step") else Rig
        if name.endswith("step"):
            WatchedRig.lag = drawn_lag(seed)
            emulated_bench.EmulatedBench = Seen
        request = prepare(name, bench_file, sets, "a1", CONDITION, "", unfinished, False)
        outcome = execute(request, confirm_at_once, lambda _progress: nullcontext())
        if outcome.error is not None:
            raise outcome.error
        outcome.path.rename(path)
        truth.write_text(json.dumps(TRUTHS[name](loops, seed)))
        with contextlib.suppress(OSError):
            shutil.rmtree(unfinished)
    return name, json.loads(truth.read_text()), path


def steps_of(_loops, _seed):
    """True figures of the step experiment that has just been run."""
    return vars(BENCHES[-1].rig.figures()) | {"steady_state_error": 0.0}


TRUTHS = {
    "current-step": steps_of,
    "position-step": lambda loops, seed: {k: v for k, v in steps_of(loops, seed).items() if k != "steady_state_error"},
    "position-noise": lambda loops, seed: {"bandwidth": position_bandwidth(loops, CONDITION, 0.06, seed)},
    "current-noise": lambda loops, _seed: {"bandwidth": current_loop_bandwidth(loops)},
}


if __name__ == "__main__":
    sys.exit(main())
