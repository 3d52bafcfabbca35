"""Lines through level means, with notes on lack of fit, unexplained scatter, drift and runs that differ.

Every hold is one point at the same weight. The standard error comes from the scatter of the points about the fit, not
from the noise within a hold: friction that sticks differently each time, drift and temperature move a level as a whole,
and a standard error of the mean within a hold, even with autocorrelation, does not include what is constant during
that hold. The noise within holds is only compared with the scatter. Runs are pooled: they share slopes, and each has
its own intercept, since a sensor's zero moves between runs.

The first column is measured, and its errors may also move the response: friction that is higher in one hold makes the
rotor slower in it. Ordinary least squares would bias the slope by that scatter, by 7 % of the damping at the paper's
r squared of 0.93. The setpoint of the current is free of such errors and serves as instrument.
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
from leactl.runfile.read.reader import Run

DRIFT_P_VALUE = 1e-3  # with a lower probability, residuals follow time by more than chance
LEAST_UNEXPLAINED_TIME = 0.3  # of the standard deviation of time; with less, drift and slope cannot be separated
LEAST_NOTED_DRIFT = 0.002  # of the response's range; a smaller drift causes no note
FOLLOWING_P_VALUE = 1e-3  # with a lower probability, a regressor follows the setpoints by more than chance


@dataclass(frozen=True, eq=False)
class LineFit:
    """A least-squares fit whose coefficients are named slopes, then one intercept for each run."""

    fit: LeastSquaresFit
    slopes: tuple[str, ...]  # names, in the order of the coefficients
    levels: HoldMeans  # the points of the fit

    @property
    def mean_intercept(self) -> Array:
        """Weights of the coefficients for the mean intercept of the runs, shape (coefficients,)."""
        return np.array([0.0] * len(self.slopes) + [1.0 / self._intercept_count] * self._intercept_count)

    def slope(self, name: str) -> float:
        """Return the value of one slope."""
        return float(self.fit.coefficients[self.slopes.index(name)])

    def estimate(self, slope: str, name: str, units: str, relative_std: float = 0.0) -> Estimate:
        """Estimate one slope; if the runs differ in it, its uncertainty is that of the runs' mean."""
        common_fit, run_test = self.common_to_runs(slope)
        weights = np.eye(len(common_fit.coefficients))[0]
        return widened_by(common_fit, run_test).estimate(name, units, weights, relative_std)

    def common_to_runs(self, slope: str) -> tuple[LeastSquaresFit, PartialFTest | None]:
        """Return the fit of one slope for all runs and all else for each run, and a test whether the runs differ in it.

        The test is None if it cannot be made.
        """
        run_columns, index = indicator_columns(self.levels.run_index), self.slopes.index(slope)
        column = self.fit.projected[:, [index]]
        other_columns = [self.fit.projected[:, [k]] for k in range(len(self.slopes)) if k != index]
        try:
            design = np.hstack([column, *(run_columns * other_column for other_column in other_columns), run_columns])
            common_fit = least_squares(design, self.fit.explained, design, slope)
        except NotIdentifiable:  # a run does not determine the other slopes alone: all runs share them
            design = np.hstack([column, *other_columns, run_columns])
            common_fit = least_squares(design, self.fit.explained, design, slope)
        widened_fit = widened_by(
            common_fit, partial_f_test(design, self.fit.explained, indicator_columns(setpoint_groups(self.levels)))
        )
        return widened_fit, partial_f_test(design, self.fit.explained, run_columns * column)

    @property
    def lack_of_fit(self) -> PartialFTest | None:
        """Return the test whether the means of levels depart from the fit by more than their repeats scatter."""
        return partial_f_test(self.fit.projected, self.fit.explained, indicator_columns(setpoint_groups(self.levels)))

    @property
    def _intercept_count(self) -> int:
        return len(self.fit.coefficients) - len(self.slopes)


def fit_lines(columns: dict[str, Array], response: Array, levels: HoldMeans, error_prefix: str) -> LineFit:
    """Fit response = sum(slope * column) + intercept of the run; lack of fit widens the uncertainty.

    The first column is measured, with the setpoint as its instrument; the others are free of error.

    Raises
    ------
    NotIdentifiable : the levels do not separate the columns, no degree of freedom is left, or the first column does not
        follow the setpoints.
    """
    run_columns = indicator_columns(levels.run_index)
    design = np.column_stack([*columns.values(), run_columns])
    instruments = np.column_stack([levels.setpoint, design[:, 1:]])
    fit = least_squares(design, response, instruments, error_prefix)
    setpoint_test = partial_f_test(design[:, 1:], design[:, 0], levels.setpoint[:, np.newaxis])
    if setpoint_test is not None and setpoint_test.p_value > FOLLOWING_P_VALUE:
        raise NotIdentifiable(
            f"{error_prefix}: the means of {len(levels)} holds do not follow their setpoints by more than chance; "
            "levels further apart are needed"
        )
    line = LineFit(fit, tuple(columns), levels)
    return replace(line, fit=widened_by(fit, line.lack_of_fit))


def fit_notes(line: LineFit, point_stds: Array, units: str) -> list[str]:
    """Return notes on excess scatter, drift, lack of fit and runs that differ.

    `point_stds` are the standard errors of the points by noise alone, shape (holds,).
    """
    notes = []
    if ratio := scatter_over_noise(line.fit, point_stds):
        notes.append(
            f"levels scatter about the fit {ratio:.1f} times as much as the noise within them explains: "
            "something other than noise moves them, such as sticking friction"
        )
    notes += drift_notes(line, units)
    lack_of_fit = line.lack_of_fit
    if lack_of_fit is not None and lack_of_fit.is_significant:
        notes.append(
            "level means depart from the fit by more than their repeats scatter "
            f"(most: {_largest_departure(line.fit, line.levels)} {units}); uncertainties are those of the level means, "
            f"{lack_of_fit.dof:g} degrees of freedom"
        )
    for slope in line.slopes:
        _, run_test = line.common_to_runs(slope)
        if run_test is not None and run_test.is_significant:
            notes.append(
                f"{slope} differs between the runs by more than scatter; its uncertainty is that of their mean, "
                f"{run_test.dof:g} degrees of freedom"
            )
    return notes


def drift_notes(line: LineFit, units: str) -> list[str]:
    """Return a note on each run whose residuals drift with time, or in which time and levels cannot be separated."""
    notes, levels, design = [], line.levels, line.fit.projected
    start_times = np.array([hold.start for hold in levels.holds])
    for number in np.unique(levels.run_index):
        in_run = levels.run_index == number
        time = np.where(in_run, start_times - start_times[in_run].mean(), 0.0)
        unexplained_time = time - design @ np.linalg.lstsq(design, time, rcond=None)[0]
        run_text = f" of run {number + 1}" if len(np.unique(levels.run_index)) > 1 else ""
        if np.std(unexplained_time) < LEAST_UNEXPLAINED_TIME * np.std(time):
            notes.append(f"levels{run_text} were visited in the order of time: a drift cannot be told from the slope")
            continue
        drift_test = partial_f_test(design, line.fit.explained, time[:, np.newaxis])
        drift = (
            float(unexplained_time @ line.fit.residuals)
            / float(unexplained_time @ unexplained_time)
            * float(np.ptp(start_times[in_run]))
        )
        if (
            drift_test is None
            or drift_test.p_value > DRIFT_P_VALUE
            or abs(drift) < LEAST_NOTED_DRIFT * float(np.ptp(line.fit.explained))
        ):
            continue
        notes.append(
            f"levels{run_text} drift by {drift:+.2g} {units} from first to last: the zero of a sensor or of the"
            " current, or what warms; the intervals hold it as scatter"
        )
    return notes


def setpoint_groups(levels: HoldMeans) -> npt.NDArray[np.int64]:
    """Return a number for each hold, the same for repeats of one setpoint from one side, shape (holds,)."""
    keys = np.column_stack([np.round(levels.setpoint, 9), levels.direction])
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)


def paths_of(runs: Sequence[Run]) -> str:
    """Return the paths of the runs, shortened to one line, to open a message."""
    return listed((run.path for run in runs), most=2)


def setup_notes(runs: Sequence[Run], setups: Sequence[str], why: str) -> list[str]:
    """Return a note on each run whose mechanical setup is not one of those that the experiment needs.

    `why` is the part of the note that says what another setup does to the results.
    """
    unexpected = [run for run in runs if run.mechanical and run.mechanical not in setups]
    return [f"{run.path}: setup is '{run.mechanical}', {' or '.join(setups)} was expected: {why}" for run in unexpected]


def _largest_departure(fit: LeastSquaresFit, levels: HoldMeans) -> str:
    """Return a text that names the level whose mean departs most from the fit, and by how much."""
    groups = setpoint_groups(levels)
    means = np.bincount(groups, fit.residuals) / np.bincount(groups)
    worst_group = int(np.argmax(np.abs(means)))
    index = int(np.flatnonzero(groups == worst_group)[0])
    side = {1: " rising", -1: " falling", 0: ""}[int(levels.direction[index])]
    return f"{levels.setpoint[index]:g} {levels.holds[index].unit}{side} by {means[worst_group]:+.2g}"
