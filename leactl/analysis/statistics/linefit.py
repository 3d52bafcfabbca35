"""Lines through level means, and what a reader must know of them: lack of fit, unexplained scatter, runs that differ.

Every hold is one point at the same weight. The standard error comes from the scatter of the points about the fit, not
from the noise within a hold: friction that sticks differently each time, drift and temperature move a level as a whole,
and a standard error of the mean, autocorrelation or not, knows nothing of what was constant during that hold. What
noise does explain is only compared with the scatter. Runs are pooled: they share slopes, and each has its own
intercept, since a sensor's zero moves between runs.

What the first slope belongs to is measured and may carry errors that also move the response: friction that is higher
in one hold makes the rotor slower in it. Least squares would take a part of that scatter for slope, 7 % of the damping
at the paper's r squared of 0.93. The setpoint of the current is free of such errors and serves as instrument.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import Estimate, listed
from leactl.analysis.signals.levels import HoldMeans
from leactl.analysis.statistics.regression import (
    Array,
    LeastSquaresFit,
    PartialFTest,
    indicator_columns,
    least_squares,
    partial_f_test,
    scatter_over_noise,
    widened_by,
)
from leactl.errors import NotIdentifiable
from leactl.runfile.reader import Run

DRIFTS_BELOW = 1e-3  # probability under which residuals go with time by more than chance
TIME_ALONE = 0.3  # of its spread, that the levels must leave of time to tell a drift from them
WORTH = 0.002  # of the response's range, that a drift is worth a note
FOLLOWS_BELOW = 1e-3  # probability under which a regressor goes with the setpoints by more than chance


@dataclass(frozen=True, eq=False)
class LineFit:
    """A fit whose coefficients are slopes by name, then one intercept a run."""

    fit: LeastSquaresFit
    slopes: tuple[str, ...]
    levels: HoldMeans

    @property
    def mean_intercept(self) -> Array:
        """Weights of the intercept, averaged over the runs."""
        return np.array([0.0] * len(self.slopes) + [1.0 / self._intercepts] * self._intercepts)

    def slope(self, name: str) -> float:
        """Value of one slope."""
        return float(self.fit.coefficients[self.slopes.index(name)])

    def estimate(self, slope: str, name: str, units: str, relative_std: float = 0.0) -> Estimate:
        """One slope as an estimate of this name; where runs differ in it, its uncertainty is that of their mean."""
        common, between = self.common_to_runs(slope)
        weights = np.eye(len(common.coefficients))[0]
        return widened_by(common, between).estimate(name, units, weights, relative_std)

    def common_to_runs(self, slope: str) -> tuple[LeastSquaresFit, PartialFTest | None]:
        """The fit with this slope first, common to the runs, all else each run's own; how far they lie apart in it."""
        runs, index = indicator_columns(self.levels.run), self.slopes.index(slope)
        column = self.fit.projected[:, [index]]
        others = [self.fit.projected[:, [k]] for k in range(len(self.slopes)) if k != index]
        try:
            design = np.hstack([column, *(runs * other for other in others), runs])
            common = least_squares(design, self.fit.explained, design, slope)
        except NotIdentifiable:  # a run that cannot tell the others by itself shares them
            design = np.hstack([column, *others, runs])
            common = least_squares(design, self.fit.explained, design, slope)
        judged = widened_by(
            common, partial_f_test(design, self.fit.explained, indicator_columns(setpoint_groups(self.levels)))
        )
        return judged, partial_f_test(design, self.fit.explained, runs * column)

    @property
    def lack_of_fit(self) -> PartialFTest | None:
        """How far the means of levels lie from the fit, against the scatter of their repeats."""
        return partial_f_test(self.fit.projected, self.fit.explained, indicator_columns(setpoint_groups(self.levels)))

    @property
    def _intercepts(self) -> int:
        return len(self.fit.coefficients) - len(self.slopes)


def fit_lines(columns: dict[str, Array], response: Array, levels: HoldMeans, place: str) -> LineFit:
    """Fit response = sum(slope * column) + intercept of the run, judged by level means where those depart from it.

    The first column is measured, with the setpoint as its instrument; the others are free of error.

    Raises
    ------
    NotIdentifiable : columns that the levels do not tell apart, or no degree of freedom left.
    """
    ones = indicator_columns(levels.run)
    design = np.column_stack([*columns.values(), ones])
    instruments = np.column_stack([levels.setpoint, design[:, 1:]])
    fit = least_squares(design, response, instruments, place)
    follows = partial_f_test(design[:, 1:], design[:, 0], levels.setpoint[:, np.newaxis])
    if follows is not None and follows.probability > FOLLOWS_BELOW:
        raise NotIdentifiable(
            f"{place}: the means of {len(levels)} holds do not follow their setpoints by more than chance; levels "
            "further apart are needed"
        )
    raw = LineFit(fit, tuple(columns), levels)
    return replace(raw, fit=widened_by(fit, raw.lack_of_fit))


def fit_notes(line: LineFit, expected: Array, units: str) -> list[str]:
    """What the reader of a fit must know; `expected` are the standard errors of the points by noise alone."""
    notes = []
    if ratio := scatter_over_noise(line.fit, expected):
        notes.append(
            f"levels scatter about the fit {ratio:.1f} times as much as the noise within them explains: "
            "something other than noise moves them, such as sticking friction"
        )
    notes += drift_notes(line, units)
    found = line.lack_of_fit
    if found is not None and found.clear:
        notes.append(
            "level means depart from the fit by more than their repeats scatter "
            f"(most: {_furthest(line.fit, line.levels)} {units}); uncertainties are those of the level means, "
            f"{found.dof:g} degrees of freedom"
        )
    for slope in line.slopes:
        _, runs = line.common_to_runs(slope)
        if runs is not None and runs.clear:
            notes.append(
                f"{slope} differs between the runs by more than scatter; its uncertainty is that of their mean, "
                f"{runs.dof:g} degrees of freedom"
            )
    return notes


def drift_notes(line: LineFit, units: str) -> list[str]:
    """A note for each run in which what the fit leaves goes with time, or in which time cannot be told from levels."""
    notes, levels, design = [], line.levels, line.fit.projected
    start = np.array([hold.start for hold in levels.holds])
    for number in np.unique(levels.run):
        own = levels.run == number
        time = np.where(own, start - start[own].mean(), 0.0)
        left = time - design @ np.linalg.lstsq(design, time, rcond=None)[0]
        which = f" of run {number + 1}" if len(np.unique(levels.run)) > 1 else ""
        if np.std(left) < TIME_ALONE * np.std(time):
            notes.append(f"levels{which} were visited in the order of time: a drift cannot be told from the slope")
            continue
        found = partial_f_test(design, line.fit.explained, time[:, np.newaxis])
        moved = float(left @ line.fit.residuals) / float(left @ left) * float(np.ptp(start[own]))
        if found is None or found.probability > DRIFTS_BELOW or abs(moved) < WORTH * float(np.ptp(line.fit.explained)):
            continue
        notes.append(
            f"levels{which} drift by {moved:+.2g} {units} from first to last: the zero of a sensor or of the current,"
            " or what warms; the intervals hold it as scatter"
        )
    return notes


def setpoint_groups(levels: HoldMeans) -> npt.NDArray[np.int64]:
    """A number for each hold, the same for repeats of one setpoint from one side, in whichever run."""
    keys = np.column_stack([np.round(levels.setpoint, 9), levels.direction])
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)


def paths_of(runs: Sequence[Run]) -> str:
    """The runs, as messages begin."""
    return listed((run.path for run in runs), most=2)


def setup_notes(runs: Sequence[Run], setups: Sequence[str], why: str) -> list[str]:
    """A note for each run whose shaft was not connected as the experiment takes it to be."""
    odd = [run for run in runs if run.mechanical and run.mechanical not in setups]
    return [f"{run.path}: setup is '{run.mechanical}', {' or '.join(setups)} was expected: {why}" for run in odd]


def _furthest(fit: LeastSquaresFit, levels: HoldMeans) -> str:
    cells = setpoint_groups(levels)
    means = np.bincount(cells, fit.residuals) / np.bincount(cells)
    worst = int(np.argmax(np.abs(means)))
    index = int(np.flatnonzero(cells == worst)[0])
    side = {1: " rising", -1: " falling", 0: ""}[int(levels.direction[index])]
    return f"{levels.setpoint[index]:g} {levels.holds[index].unit}{side} by {means[worst]:+.2g}"
