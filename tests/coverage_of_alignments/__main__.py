"""`python -m tests.coverage_of_alignments --seeds 200`: methods and cases; status 1 where one covers too rarely."""

import argparse
import math
import sys

import numpy as np

from leactl.runfile.align.alignment import Alignment, fit_alignment
from leactl.runfile.align.onsets import ties_by_onset
from leactl.runfile.align.similarity import align_by_similarity
from tests.runfile.test_alignment import DRIFT, heating, pair

COVERED = 0.95


def likeness(seed: int, noise: float) -> tuple[float, float]:
    """Error and claim of one pair of channels that measured the same [s]."""
    own, reference, offset, rate = pair(seed, noise)
    result = align_by_similarity(own, reference, 2.0, "both", near_s=5.0, drift_within=DRIFT)
    return judged(result, 8.0, offset, rate)


def onset(seed: int, noise: float) -> tuple[float, float]:
    """Error and claim of one camera that saw heating and cooling begin [s]."""
    rng = np.random.default_rng(seed)
    starts, ends = 60 + rng.uniform(0, 1), 600 + rng.uniform(0, 1)
    offset, rate = 40 + rng.uniform(-20, 20), 1 + rng.normal(0, DRIFT / 2)
    base, own = np.arange(0, 700, 1 / 30), np.arange(0, 640, 1 / 30)
    current = np.where((base >= starts) & (base < ends), 9.0, 0.0) + 0.01 * rng.normal(size=len(base))
    seen = np.round(heating(offset + rate * own, starts, ends) + noise * rng.normal(size=len(own)), 2)
    ties = ties_by_onset(own, seen, base, current, 4.0, 40.0, 60.0, 5.0)
    return judged(fit_alignment("onset", ties, DRIFT, 0.0), 300.0, offset, rate)


def judged(found: Alignment, at: float, offset: float, rate: float) -> tuple[float, float]:
    """Error and claim at one moment of the record's clock."""
    return float(found.on_run(np.array([at]))[0]) - (offset + rate * at), found.uncertainty(at)


CASES = {
    ("likeness", "steps of 5 A, noise 0.05 A, 1 kHz against 200 Hz"): lambda seed: likeness(seed, 0.05),
    ("likeness", "the same, noise 0.5 A"): lambda seed: likeness(seed, 0.5),
    ("onset", "9 A through two leads, camera noise 0.1 K, 30 Hz, two onsets"): lambda seed: onset(seed, 0.1),
    ("onset", "the same, camera noise 0.3 K"): lambda seed: onset(seed, 0.3),
}


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    seeds = parser.parse_args().seeds
    worst = 1.0
    print(f"| method | case | 95 % interval, half, median | covered, {seeds} seeds |\n|---|---|---|---|")
    for (method, case), trial in CASES.items():
        errors, claims = np.array([trial(seed) for seed in range(seeds)]).T
        covered = float(np.mean(np.abs(errors) < claims))
        worst = min(worst, covered)
        print(f"| {method} | {case} | {1e3 * np.median(claims):.3g} ms | {100 * covered:.1f} % |", flush=True)
    chance = 1.96 * math.sqrt(COVERED * (1.0 - COVERED) / seeds)
    return 0 if worst >= COVERED - chance else 1


if __name__ == "__main__":
    sys.exit(main())
