"""`python -m tests.paper FOLDER`: the paper's figures, the truth and the results of a campaign `paper` side by side.

Status 1 where a result is further from the truth than is asked of it.
"""

import argparse
import math
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from leactl.analysis.analyze import analyze_runs, experiment_of
from leactl.analysis.estimate import Estimate, Result
from leactl.report.terminal import interval_text, paper_figures, value_text
from leactl.runfile.read.reader import Run

from .truths import truths

SAMPLE_S = 1e-3  # of the control loops' records
ASKED = {  # relative, by experiment and result
    ("torque-constant", "torque_constant"): 0.005,
    ("back-emf", "back_emf_constant"): 0.005,
    ("friction", "viscous_damping"): 0.03,
    ("friction", "coulomb_friction"): 0.03,
    ("thermal", "parallel_thermal_resistance"): 0.02,
    ("thermal", "housing_capacitance"): 0.05,
    ("thermal", "phase_resistance"): 0.005,
    ("thermal", "rmse"): 0.05,
    ("current-step", "overshoot"): 0.05,
    ("current-step", "settling_time"): 0.05,
    ("position-step", "overshoot"): 0.05,
    ("position-step", "settling_time"): 0.05,
    ("position-noise", "bandwidth"): 0.05,
    ("efficiency", "driving_loss"): 0.02,
    ("efficiency", "driven_loss"): 0.02,
}
ASKED_ABSOLUTE = {
    ("current-step", "rise_time"): SAMPLE_S,
    ("position-step", "rise_time"): SAMPLE_S,
    ("efficiency", "driving_efficiency"): 0.02,
}


@dataclass(frozen=True)
class Row:
    """One result beside the truth."""

    experiment: str
    item: Estimate
    printed: str
    true: float

    @property
    def most(self) -> float:
        """How far from the truth it may be, in its unit; zero where nothing is asked."""
        key = self.experiment, self.item.name
        return max(ASKED.get(key, 0.0) * abs(self.true), ASKED_ABSOLUTE.get(key, 0.0))

    @property
    def off(self) -> bool:
        """Whether it is further from the truth than is asked of it."""
        if math.isnan(self.item.value):
            return not self.item.low <= self.true
        return self.most > 0.0 and not abs(self.item.value - self.true) <= self.most

    @property
    def held(self) -> str:
        """Whether the 95 % interval holds the truth; empty where there is none."""
        if math.isnan(self.item.low):
            return ""
        return "yes" if self.item.low <= self.true <= self.item.high else "no"

    def line(self) -> str:
        """A row of the table."""
        known = self.true and math.isfinite(self.item.value)
        error = f"{round(self.item.value / self.true - 1.0, 4) + 0.0:+.2%}" if known else ""
        key = self.experiment, self.item.name
        asked = f"{ASKED[key]:.1%}" if key in ASKED else f"{self.most:g} {self.item.units}" if self.most else ""
        cells = (
            f"{self.experiment}: {self.item.name}",
            self.item.actuator,
            self.item.condition,
            self.printed,
            f"{self.true:.6g}",
            value_text(self.item),
            interval_text(self.item),
            self.item.units,
            error,
            asked,
            self.held,
        )
        return "| " + " | ".join(cells) + " |"


def main() -> int:
    """Parse, analyse, set side by side."""
    parser = argparse.ArgumentParser(prog="python -m tests.paper", description=__doc__)
    parser.add_argument("folder", type=Path, help="of the runs, runs/paper")
    parser.add_argument("--all", action="store_true", help="every result that has a true value")
    asked = parser.parse_args()
    rows = [row for result in results(asked.folder) for row in beside(result)]
    print("| | actuator | preload | paper | true | found | 95 % interval | units | off by | asked | holds it |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        if asked.all or row.printed or row.most:
            print(row.line())
    judged = [row for row in rows if row.held]
    print(f"\n{sum(row.held == 'yes' for row in judged)} of {len(judged)} intervals hold the truth.")
    for row in (off := [row for row in rows if row.off]):
        print(f"{row.experiment}: {row.item.name} {row.item.condition} is further off than is asked.")
    return 1 if off else 0


def results(folder: Path) -> list[Result]:
    """The answer of every experiment in a folder."""
    paths = defaultdict(list)
    for path in sorted(folder.glob("*.h5")):
        with Run.open(path) as run:
            paths[experiment_of(run)].append(path)
    return [analyze_runs(group) for _, group in sorted(paths.items())]


def beside(result: Result) -> list[Row]:
    """Every result that has a true value, in the order of its analysis."""
    outcomes = []
    known = {condition: truths(result.experiment, condition, result) for _, condition in result.groups}
    for item in result.results:
        true = known[item.condition].get(item.name)
        if true is not None:
            printed = paper_figures(result.experiment, item.condition).get(item.name, "")
            outcomes.append(Row(result.experiment, item, printed, true))
    return outcomes


if __name__ == "__main__":
    sys.exit(main())
