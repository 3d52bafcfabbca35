"""Lines through level means, and what a reader must know of them: lack of fit, unexplained scatter, runs that differ.

Every hold is one point at the same weight. The standard error comes from the scatter of the points about the fit, not
from the noise within a hold: friction that sticks differently each time, drift and temperature move a level as a whole,
and a standard error of the mean, autocorrelation or not, knows nothing of what was constant during that hold. What
noise does explain is only compared with the scatter. Runs are pooled: they share slopes, and each has its own
intercept, since a sensor's zero moves between runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import listed
from leactl.analysis.levels import Levels
from leactl.analysis.regression import (
    Array,
    Departure,
    Fit,
    departure,
    excess_over,
    judged_by_levels,
    least_squares,
    one_column_each,
)
from leactl.runfile.reader import Run


@dataclass(frozen=True, eq=False)
class LineFit:
    """A fit whose coefficients are slopes by name, then one intercept a run."""

    fit: Fit
    slopes: tuple[str, ...]

    def weights(self, slope: str) -> Array:
        """Weights that pick one slope."""
        return np.array([float(name == slope) for name in self.slopes] + [0.0] * self._intercepts)

    @property
    def mean_intercept(self) -> Array:
        """Weights of the intercept, averaged over the runs."""
        return np.array([0.0] * len(self.slopes) + [1.0 / self._intercepts] * self._intercepts)

    @property
    def _intercepts(self) -> int:
        return len(self.fit.coefficients) - len(self.slopes)


def fit_lines(columns: dict[str, Array], response: Array, levels: Levels, place: str) -> LineFit:
    """Fit response = sum(slope * column) + intercept of the run, judged by level means where those depart from it.

    Raises
    ------
    NotIdentifiable : columns that the levels do not tell apart, or no degree of freedom left.
    """
    fit = least_squares(design_of(columns, levels), response, place)
    return LineFit(judged_by_levels(fit, lack_of_fit(columns, response, levels, fit)), tuple(columns))


def remarks(
    columns: dict[str, Array], response: Array, levels: Levels, expected: Array, units: str, place: str
) -> list[str]:
    """What the reader of a fit must know; `expected` are the standard errors of the points by noise alone."""
    design = design_of(columns, levels)
    fit = least_squares(design, response, place)
    notes = []
    if ratio := excess_over(fit, expected):
        notes.append(
            f"levels scatter about the fit {ratio:.1f} times as much as the noise within them explains: "
            "something other than noise moves them, such as sticking friction"
        )
    found = lack_of_fit(columns, response, levels, fit)
    if found is not None and found.clear:
        notes.append(
            "level means depart from the fit by more than their repeats scatter "
            f"(most: {_furthest(fit, levels)} {units}); uncertainties are those of the level means, "
            f"{found.dof:g} degrees of freedom"
        )
    first = next(iter(columns.values()))
    runs = departure(design, response, one_column_each(levels.run) * first[:, np.newaxis])
    if len(np.unique(levels.run)) > 1 and runs is not None and runs.clear:
        notes.append("slopes differ between the runs by more than scatter; the intervals do not cover that difference")
    return notes


def lack_of_fit(columns: dict[str, Array], response: Array, levels: Levels, fit: Fit) -> Departure | None:
    """How far the means of levels lie from the fit, against the scatter of their repeats.

    Repeats of a level differ a little in the regressor too. Each is moved along the fit to the level's mean, so that
    the fit is one of level means and has their degrees of freedom.
    """
    cells = cells_of(levels)
    count = np.bincount(cells)
    together = {name: (np.bincount(cells, column) / count)[cells] for name, column in columns.items()}
    design = design_of(together, levels)
    moved = response - (design_of(columns, levels) - design) @ fit.coefficients
    return departure(design, moved, one_column_each(cells))


def design_of(columns: dict[str, Array], levels: Levels) -> Array:
    """Columns of the regressors, then one of ones for each run."""
    return np.column_stack([*columns.values(), one_column_each(levels.run)])


def cells_of(levels: Levels) -> npt.NDArray[np.int64]:
    """A number for each hold, the same for repeats of one setpoint from one side, in whichever run."""
    keys = np.column_stack([np.round(levels.setpoint, 9), levels.direction])
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)


def place_of(runs: Sequence[Run]) -> str:
    """The runs, as messages begin."""
    return listed((run.path for run in runs), most=2)


def expect_setup(runs: Sequence[Run], setups: Sequence[str], why: str) -> list[str]:
    """A note for each run whose shaft was not connected as the experiment takes it to be."""
    odd = [run for run in runs if run.mechanical and run.mechanical not in setups]
    return [f"{run.path}: setup is '{run.mechanical}', {' or '.join(setups)} was expected: {why}" for run in odd]


def _furthest(fit: Fit, levels: Levels) -> str:
    cells = cells_of(levels)
    means = np.bincount(cells, fit.residuals) / np.bincount(cells)
    worst = int(np.argmax(np.abs(means)))
    index = int(np.flatnonzero(cells == worst)[0])
    side = {1: " rising", -1: " falling", 0: ""}[int(levels.direction[index])]
    return f"{levels.setpoint[index]:g} A{side} by {means[worst]:+.2g}"
