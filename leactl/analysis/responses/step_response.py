"""Step responses of a drive's loops: rise time, overshoot, settling time and steady-state error over trials and levels.

Paper, section "Controller Performance": each metric is the mean over trials and levels. The paper does not print its
band of settling; here it is 2 % of the step about the steady value. Overshoot and rise refer to the steady value too.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from leactl.analysis.estimate import Plot, Result, Series, joined, plot_slice
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.responses.step_curve import mean_step_response
from leactl.analysis.responses.step_metrics import BIN_GROWTH, overshoot, rise_time, settling_time
from leactl.analysis.responses.step_trials import (
    SETTLING_BAND,
    StepTrial,
    drift_notes,
    repeat_notes,
    rounding_limit_of,
    trials_of,
    wrong_size_notes,
)
from leactl.analysis.statistics.jackknife import JackknifedFigure, LevelFigure, jackknife_over_trials, mean_of_levels
from leactl.analysis.statistics.linefit import setup_notes
from leactl.runfile.read.reader import Run

STEP_RESULTS = {
    "rise_time": "s",
    "overshoot": "%",
    "settling_time": "s",
    "steady_state_error": "%",
}
MOST_POINTS = 60  # of a level in the plot
PLOTTED_SETTLING_TIMES = 2.0  # settling times that the plot covers


def step_response(experiment: str, runs: Sequence[Run], reference: str, response: str, key: str, setup: str) -> Result:
    """Estimate the step metrics of the test actuator's `response` to `reference`.

    `rise_time` [s] from 10 to 90 %, `overshoot` [%], `settling_time` [s] to within 2 %, `steady_state_error` [%], the
    part of the step by which the steady value falls short of the reference. A metric that is not known is NaN.

    Raises
    ------
    MissingChannel : a run has no reference or no response of the test actuator.
    NotIdentifiable : a run has no usable step response.
    """
    notes = setup_notes(runs, (setup,), "the response is that of another load")
    usable_trials = joined(trials_of(run, reference, response, key) for run in runs)
    setpoints = sorted({trial.level for trial in usable_trials.value})
    levels = [[trial for trial in usable_trials.value if trial.level == setpoint] for setpoint in setpoints]
    notes += [*usable_trials.notes, *repeat_notes(levels), *drift_notes(levels)]
    units = runs[0].channel(response, role="test").units
    metrics: dict[str, tuple[str, Callable[[Sequence[StepTrial]], LevelFigure]]] = {
        "rise_time": ("s", rise_time),
        "overshoot": ("%", overshoot),
        "settling_time": ("s", settling_time),
    }
    results = []
    for name, (unit, metric) in metrics.items():
        level_values = [_level_value(trials, metric) for trials in levels]
        results.append(mean_of_levels(name, unit, level_values))
        values_text = ", ".join(
            f"{value.figure.value:.4g} {unit} at {trials[0]} {units}"
            for value, trials in zip(level_values, levels, strict=True)
        )
        notes.append(f"{name} by level: {values_text}")
        if not math.isfinite(results[-1].value):
            notes.append(
                f"{name} is not known: noise of the readings goes beyond {SETTLING_BAND:.0%} of the smallest step"
            )
    results.append(mean_of_levels("steady_state_error", "%", [_steady_error(trials) for trials in levels]))
    plot_end = PLOTTED_SETTLING_TIMES * results[2].value if math.isfinite(results[2].value) else math.inf
    notes[:0] = wrong_size_notes(levels, response) or unit_notes(runs, [], [response])
    paths = tuple(str(run.path) for run in runs)
    return Result(experiment, paths, tuple(results), tuple(notes), (_plot(levels, units, plot_end),))


def _level_value(trials: Sequence[StepTrial], metric: Callable[[Sequence[StepTrial]], LevelFigure]) -> JackknifedFigure:
    """Return a metric of one level with its scatter over the trials."""
    return jackknife_over_trials(len(trials), lambda trial_indices: metric([trials[index] for index in trial_indices]))


def _steady_error(trials: Sequence[StepTrial]) -> JackknifedFigure:
    """Return the steady-state error of one level [%] with its scatter over the trials."""
    rounding = 100.0 * max(rounding_limit_of(trial.noise, trial.quantum) for trial in trials)
    return jackknife_over_trials(
        len(trials),
        lambda trial_indices: LevelFigure(
            100.0 * float(np.mean([trials[index].steady_error for index in trial_indices])), per_level=(rounding,)
        ),
    )


def _plot(levels: Sequence[Sequence[StepTrial]], units: str, plot_end: float) -> Plot:
    """Return the plot of each level's mean response up to `plot_end` [s], with the band of settling."""
    points = []
    for trials in levels:
        curve = mean_step_response(trials, BIN_GROWTH)
        plotted_indices = np.flatnonzero(curve.time <= plot_end)
        plotted_indices = plotted_indices[plot_slice(len(plotted_indices), MOST_POINTS)]
        time, value = (1e3 * curve.time[plotted_indices]).tolist(), curve.value[plotted_indices].tolist()
        points.append(Series(f"{trials[0]} {units}", tuple(time), tuple(value)))
    time_range = (0.0, max(series.x[-1] for series in points))
    lines = [
        Series("band of settling", time_range, (1.0 + side, 1.0 + side)) for side in (SETTLING_BAND, -SETTLING_BAND)
    ]
    return Plot("time since the step [ms]", "response [of the step]", tuple(points), tuple(lines))
