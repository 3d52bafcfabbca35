"""Calibration of the torque sensor by dead weights on an arm, with an uncertainty budget (GUM, JCGM 100:2008).

The model is reading = S m g l + zero. The torque of the weights is known but for the errors of mass, gravity and arm,
so S is the factor by which the bench's scale is off. The zero may drift along a straight line: all weights of one sense
come before those of the other, so that a drift would else count as a part of S. Each departure from a straight line is
a component of the budget: type A from the scatter of repeats, type B as a rectangle of half the observed width (GUM,
4.3.7). The coverage factor follows Welch and Satterthwaite.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series, listed
from leactl.analysis.experiments.torque_constant import TORQUE
from leactl.analysis.quality.usable_readings import usable_channel
from leactl.analysis.signals.levels import HoldMeans, HoldSelector, gather_means
from leactl.analysis.statistics.intervals import half_width, quantisation_step
from leactl.analysis.statistics.linefit import LineFit, fit_lines, fit_notes, paths_of, setpoint_groups
from leactl.analysis.statistics.regression import Array, t_quantile
from leactl.errors import InputError, NotIdentifiable
from leactl.runfile.read.reader import Run

RESULTS = {
    "sensitivity": "1",
    "zero": "N*m",
    "highest_torque": "N*m",
    "uncertainty_repeatability": "N*m",
    "uncertainty_sensitivity": "N*m",
    "uncertainty_linearity": "N*m",
    "uncertainty_hysteresis": "N*m",
    "uncertainty_resolution": "N*m",
    "uncertainty_zero_drift": "N*m",
    "uncertainty_reference": "N*m",
    "combined_uncertainty": "N*m",
    "coverage_factor": "1",
    "expanded_uncertainty": "N*m",
}

WEIGHT_HOLDS = HoldSelector("weight_Nm", "N*m", "bench")
GRAVITY_OF_HOLDS = 9.80665  # m/s^2, from which the torques of the holds were computed
GRAVITY_HALF_RANGE = 0.026  # m/s^2: 9.780 at the equator to 9.832 at the poles
MASS_STD = 5e-4 / math.sqrt(3.0)  # relative: OIML R 111, class M3
ARM_STD_M = 0.2e-3 / math.sqrt(3.0)  # from a drawing's tolerance of 0.2 mm
FEWEST_WEIGHTS = 3  # distinct torques: one more than a straight line needs
HYSTERESIS_COLUMN = "hysteresis"
FOLLOWING_STANDARD_ERRORS = 10.0  # a sensitivity of fewer does not count as following the weights
MOST_FACTOR_ERROR = 0.005  # difference of the factor from one; a note says how to mend a larger one
MOST_SWING = 0.002  # of the highest torque; a weight swung if the quarters of its hold differ by more


@dataclass(frozen=True)
class ReferenceTorque:
    """The true torque of the weights over the torque that the holds state, and its uncertainty."""

    factor: float  # local gravity over `GRAVITY_OF_HOLDS`
    relative_std: float  # by mass, arm and a given gravity
    half_range: float  # relative half width of the range of a gravity that is not given; 0 for a given gravity

    @property
    def total_std(self) -> float:
        """Return the relative standard uncertainty of the weights' torque."""
        return math.hypot(self.relative_std, self.half_range / math.sqrt(3.0))


@dataclass(frozen=True)
class BudgetComponent:
    """One component of the budget: its standard uncertainty [N*m] at the highest torque, and its degrees of freedom."""

    name: str
    std: float
    dof: float = math.inf  # infinite for type B


def analyze(
    runs: Sequence[Run],
    *,
    gravity: float | None = None,
    gravity_std: float | None = None,
    mass_relative_std: float | None = None,
    arm_std_m: float | None = None,
) -> Result:
    """Estimate the factor and the zero by which the bench's torque is off, and the uncertainty of a measured torque.

    `sensitivity` (reading over torque), `zero` [N*m] halfway through the run, `highest_torque` [N*m] of the weights;
    standard uncertainties there [N*m]: `uncertainty_repeatability`, `_sensitivity`, `_linearity`, `_hysteresis`,
    `_resolution`, `_zero_drift`, `_reference`; `combined_uncertainty` [N*m], `coverage_factor`, `expanded_uncertainty`
    [N*m] at 95 %.

    Parameters
    ----------
    runs : of one sensor, whose steps `hold` weights at three torques or more.
    gravity, gravity_std : [m/s^2] at the place, and its standard uncertainty.
    mass_relative_std : standard uncertainty of the masses over their mass.
    arm_std_m : [m], standard uncertainty of the arm's length.

    Raises
    ------
    MissingChannel : a run has no torque.
    NotIdentifiable : fewer than three torques of weights, no arm length, or a sensor that does not follow the weights.
    InputError : see `reference_of`.
    """
    error_prefix = f"{paths_of(runs)}: torque sensor calibration"
    reference_torque = reference_of(runs, gravity, gravity_std, mass_relative_std, arm_std_m)
    reference = reference_torque.value
    hold_means = gather_means(runs, (TORQUE,), partial(usable_channel, hold_selector=WEIGHT_HOLDS), WEIGHT_HOLDS)
    levels = hold_means.value
    notes = [*reference_torque.notes, *hold_means.notes]
    weights = np.unique(np.round(levels.setpoint, 9))
    if len(weights) < FEWEST_WEIGHTS:
        raise NotIdentifiable(
            f"{error_prefix}: found {len(weights)} torques of weights; {FEWEST_WEIGHTS} or more are needed to see"
            " whether the sensor is straight"
        )
    applied = levels.setpoint * reference.factor
    line = fit_readings(applied, levels, error_prefix)
    factor = line.slope("sensitivity")
    highest_torque = float(np.max(np.abs(applied)))
    notes += fit_notes(line, levels.standard_errors[TORQUE], "N*m")
    factor_std = line.estimate("sensitivity", "sensitivity", "1").std
    if abs(factor) < FOLLOWING_STANDARD_ERRORS * factor_std:
        raise NotIdentifiable(
            f"{error_prefix}: the readings do not follow the weights: {factor:.2g} of {highest_torque:.3g} N*m is seen"
        )
    notes += owner_notes(line, levels, factor, highest_torque)
    reading_components = budget(runs, levels, line, factor_std, highest_torque)
    components = [*reading_components.value, BudgetComponent("reference", highest_torque * reference.total_std)]
    notes += reading_components.notes
    results = [
        sensitivity(line, reference),
        line.fit.estimate("zero", "N*m", line.mean_intercept),
        Estimate("highest_torque", highest_torque, NAN, NAN, NAN, "N*m"),
        *(Estimate(f"uncertainty_{component.name}", component.std, NAN, NAN, NAN, "N*m") for component in components),
        *combined_estimates(components),
    ]
    paths = tuple(str(run.path) for run in runs)
    return Result("torque-sensor-calibration", paths, tuple(results), tuple(notes), (plot_of(levels, line, applied),))


def reference_of(
    runs: Sequence[Run],
    gravity: float | None,
    gravity_std: float | None,
    mass_relative_std: float | None,
    arm_std_m: float | None,
) -> Noted[ReferenceTorque]:
    """Return factor and uncertainty of the weights' torque; a note names the defaults of options that are not given.

    Raises
    ------
    NotIdentifiable : no hold states the length of its arm, or a length is not above zero.
    InputError : a gravity outside 9.7 to 9.9 m/s^2, or a negative uncertainty.
    """
    if gravity is not None and not 9.7 < gravity < 9.9:
        raise InputError(f"gravity {gravity:g}: 9.7 to 9.9 m/s^2 was expected")
    stds = {"gravity_std": gravity_std, "mass_relative_std": mass_relative_std, "arm_std_m": arm_std_m}
    for name, number in stds.items():
        if number is not None and not (math.isfinite(number) and number >= 0.0):
            raise InputError(f"{name} {number:g}: zero or more was expected")
    arms = {float(arm) for run in runs for step in run.steps if (arm := step.parameters.get("arm_m")) is not None}
    if not arms or min(arms) <= 0.0:
        raise NotIdentifiable(f"{paths_of(runs)}: no hold states the arm of its weights (arm_m)")
    is_gravity_unknown = gravity is None and gravity_std is None
    defaults = {
        "gravity_std": GRAVITY_HALF_RANGE / math.sqrt(3.0) if is_gravity_unknown else 0.0,
        "mass_relative_std": MASS_STD,
        "arm_std_m": ARM_STD_M,
    }
    defaults_taken = [
        f"{name} {defaults[name]:.2g}" for name, number in stds.items() if number is None and defaults[name]
    ]
    stds_in_use = {name: defaults[name] if number is None else number for name, number in stds.items()}
    local_gravity = gravity or GRAVITY_OF_HOLDS
    relative_gravity_std = 0.0 if is_gravity_unknown else stds_in_use["gravity_std"] / local_gravity
    relative_std = math.hypot(
        relative_gravity_std, stds_in_use["mass_relative_std"], stds_in_use["arm_std_m"] / min(arms)
    )
    half_range = GRAVITY_HALF_RANGE / local_gravity if is_gravity_unknown else 0.0
    note = f"not given and taken: {listed(defaults_taken)}; gravity {local_gravity:g} m/s^2"
    return Noted(
        ReferenceTorque(local_gravity / GRAVITY_OF_HOLDS, relative_std, half_range), (note,) if defaults_taken else ()
    )


def fit_readings(applied: Array, levels: HoldMeans, error_prefix: str) -> LineFit:
    """Fit the readings over the applied torque [N*m], with drift of the zero and hysteresis if the holds show them.

    Each run has a separate drift. Hysteresis is a loop between rising and falling weights that closes at both ends.
    """
    time = np.array([0.5 * (hold.start + hold.stop) for hold in levels.holds])
    columns = {"sensitivity": applied}
    for number in np.unique(levels.run_index):
        in_run = levels.run_index == number
        middle_time = 0.5 * (time[in_run].min() + time[in_run].max())
        columns[f"drift_{number}"] = np.where(in_run, time - middle_time, 0.0) / max(float(np.ptp(time[in_run])), 1e-9)
    if {1, -1} <= set(levels.direction.tolist()):
        columns[HYSTERESIS_COLUMN] = -np.sign(applied) * levels.direction * loop_shape(applied)
    try:
        return fit_lines(columns, levels.means[TORQUE], levels, error_prefix)
    except NotIdentifiable:
        return fit_lines({"sensitivity": applied}, levels.means[TORQUE], levels, error_prefix)


def loop_shape(applied: Array) -> Array:
    """Return the width of a hysteresis loop over its greatest width, shape (holds,)."""
    share = np.abs(applied) / float(np.max(np.abs(applied)))
    return np.asarray(4.0 * share * (1.0 - share))


def sensitivity(line: LineFit, reference: ReferenceTorque) -> Estimate:
    """Estimate reading over torque; the interval includes the uncertainty of the weights' torque."""
    factor = line.estimate("sensitivity", "sensitivity", "1", reference.relative_std)
    interval_half_width = half_width(
        (factor.high - factor.value) / t_quantile(math.inf), math.inf, reference.half_range * factor.value
    )
    std = math.hypot(factor.std, reference.half_range / math.sqrt(3.0) * factor.value)
    return Estimate(
        factor.name,
        factor.value,
        std,
        factor.value - interval_half_width,
        factor.value + interval_half_width,
        factor.units,
    )


def owner_notes(line: LineFit, levels: HoldMeans, factor: float, highest_torque: float) -> list[str]:
    """Return notes on settings to change and on conditions that limit the calibration."""
    notes = []
    if factor < 0.0:
        notes.append("the reading falls as the torque rises: the sensor's sign is the other one; change `sign`")
    elif abs(factor - 1.0) > MOST_FACTOR_ERROR:
        notes.append(f"the reading is {factor:.4f} times the torque: multiply scale_per_V by {1.0 / factor:.5g}")
    quarters = levels.quarter_means[TORQUE]
    swing = np.nanmax(quarters, axis=1) - np.nanmin(quarters, axis=1)
    is_swinging = swing > MOST_SWING * highest_torque
    if is_swinging.any():
        unsteady = [str(hold) for hold, swings in zip(levels.holds, is_swinging, strict=True) if swings]
        notes.append(
            f"the weight swung or crept in {len(unsteady)} holds ({listed(unsteady)}): wait longer before confirming"
        )
    if len(np.unique(np.sign(levels.setpoint))) < 3 and not (levels.setpoint == 0.0).all():
        notes.append("weights in one sense only: whether the sensor reads alike in the other is not known")
    return notes


def budget(
    runs: Sequence[Run], levels: HoldMeans, line: LineFit, slope_std: float, highest_torque: float
) -> Noted[list[BudgetComponent]]:
    """Return the budget's components that follow from the readings, as standard uncertainties [N*m].

    A component that the runs do not determine is NaN; a note names it, unless it is the drift of the zero.
    """
    notes = []
    factor = abs(line.slope("sensitivity"))
    residuals = line.fit.residuals / factor
    if HYSTERESIS_COLUMN in line.slopes:  # the loop is a component of the budget, so the residuals keep it
        loop = line.fit.projected[:, line.slopes.index(HYSTERESIS_COLUMN)]
        residuals = residuals + line.slope(HYSTERESIS_COLUMN) / factor * loop
    weight_and_run = np.column_stack([setpoint_groups(levels), levels.run_index])
    cell_of_hold = np.unique(weight_and_run, axis=0, return_inverse=True)[1].reshape(-1)
    counts = np.bincount(cell_of_hold)
    deviations = residuals - (np.bincount(cell_of_hold, residuals) / counts)[cell_of_hold]
    dof = float(len(residuals) - len(counts))
    repeatability_std = math.sqrt(float(deviations @ deviations) / dof) if dof else NAN
    if not dof:
        notes.append("no weight was hung twice: repeatability is not known, and not in the combined uncertainty")
    residual_means = {
        direction: {
            value: float(residuals[in_direction & (levels.setpoint == value)].mean())
            for value in levels.setpoint[in_direction]
        }
        for direction in (1, -1)
        if (in_direction := levels.direction == direction).any()
    }
    loop_widths = [
        abs(residual_means[1][value] - residual_means[-1][value])
        for value in residual_means.get(1, {})
        if value in residual_means.get(-1, {})
    ]
    if not loop_widths:
        notes.append("weights were not hung rising and falling: hysteresis is not known, and not in the combined one")
    mean_departures = [abs(float(residuals[levels.setpoint == value].mean())) for value in np.unique(levels.setpoint)]
    zero_readings = levels.means[TORQUE][levels.setpoint == 0.0] / factor
    quantisation_steps = [quantisation_step(run.channel(TORQUE).values) / factor for run in runs]
    components = [
        BudgetComponent("repeatability", repeatability_std, dof or math.inf),
        BudgetComponent("sensitivity", highest_torque * slope_std / factor, line.fit.dof),
        BudgetComponent("linearity", max(mean_departures) / math.sqrt(3.0)),
        BudgetComponent("hysteresis", 0.5 * max(loop_widths) / math.sqrt(3.0) if loop_widths else NAN),
        # resolution of a reading and of its zero
        BudgetComponent("resolution", math.sqrt(2.0) * max(quantisation_steps) / math.sqrt(12.0)),
        BudgetComponent(
            "zero_drift", 0.5 * float(np.ptp(zero_readings)) / math.sqrt(3.0) if len(zero_readings) > 1 else NAN
        ),
    ]
    return Noted(components, tuple(notes))


def combined_estimates(components: Sequence[BudgetComponent]) -> list[Estimate]:
    """Return combined uncertainty, coverage factor and expanded uncertainty of the components that are known."""
    known_components = [component for component in components if math.isfinite(component.std)]
    std = math.sqrt(sum(component.std**2 for component in known_components))
    dof_sum = sum(component.std**4 / component.dof for component in known_components)
    coverage_factor = t_quantile(std**4 / dof_sum if dof_sum > 0.0 else math.inf)
    return [
        Estimate("combined_uncertainty", std, NAN, NAN, NAN, "N*m"),
        Estimate("coverage_factor", coverage_factor, NAN, NAN, NAN, "1"),
        Estimate("expanded_uncertainty", coverage_factor * std, NAN, NAN, NAN, "N*m"),
    ]


def plot_of(levels: HoldMeans, line: LineFit, applied: Array) -> Plot:
    """Return the plot of the readings' residuals over the torque of the weights."""
    points = []
    for label, direction in (("rising", 1), ("falling", -1), ("weights", 0)):
        on_side = levels.direction == direction
        if on_side.any():
            residuals = line.fit.residuals[on_side]
            points.append(Series(label, tuple(applied[on_side].tolist()), tuple(residuals.tolist())))
    torque_range = (float(applied.min()), float(applied.max()))
    return Plot(
        "torque of the weights [N*m]",
        "reading less the line [N*m]",
        tuple(points),
        (Series("line", torque_range, (0.0, 0.0)),),
    )
