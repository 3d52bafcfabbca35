"""`python -m tests.verdicts`: verdicts over seeds; status 1 for too few of the paper's or too many false."""

import argparse
import sys
from collections import Counter

from .draws import PARAMETERS
from .trial import by_runs, by_values

LEAST_AS_PRINTED, MOST_FALSE = 0.75, 0.08


def main() -> int:
    """Parse, draw, count, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.verdicts", description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--through", choices=("runs", "values", "two-actuators"), default="runs")
    asked = parser.parse_args()
    kinds = {"runs": by_runs, "values": by_values, "two-actuators": lambda seed, effect: by_values(seed, effect, 2)}
    draw = kinds[asked.through]
    seeds = range(asked.first, asked.first + asked.seeds)
    printed, false = Counter[str](), Counter[str]()
    for seed in seeds:
        with_effect, without = draw(seed, True), draw(seed, False)
        printed.update(item.name for item in with_effect if item.as_printed)
        printed["all of them"] += all(item.as_printed for item in with_effect)
        false.update(item.name for item in without if item.any_shown)
    print(f"{asked.through}, {asked.seeds} seeds from {asked.first}")
    print(f"{'':20}{'as printed':>12}{'false':>8}")
    status = 0
    for name in (*(parameter.name for parameter in PARAMETERS), "all of them"):
        rate, wrong = printed[name] / asked.seeds, false[name] / asked.seeds
        print(f"{name:20}{rate:12.1%}" + (f"{wrong:8.1%}" if name != "all of them" else ""))
        if rate < LEAST_AS_PRINTED or wrong > MOST_FALSE:
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
