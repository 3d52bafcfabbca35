"""Torque pulses to peak current: how the torque falls behind the current as the iron saturates.

    torque = K i / sqrt(1 + p (i/I)^2 + q (i/I)^4) + s d + e sgn(i) + c

for currents up to I. The first term is an odd function of the current, since iron saturates alike in both directions. A
rotor that sticks keeps the torque s from the sensor, with the sign of the side d that a level was reached from
(torque_constant.py): at most its Coulomb friction, and less if the rotor rings before it stops. e is the part that does
not change sign with d. A gain error of sensor or current is a factor on K; that of the current also shifts the bend.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series
from leactl.analysis.experiments.torque_constant import (
    CURRENT,
    SIDES,
    TORQUE,
    convention_notes,
    intercepts_by_hold,
    torque_levels,
)
from leactl.analysis.quality.calibration_uncertainty import calibration_notes, gain_std
from leactl.analysis.quality.sign_checks import refuse_below_zero
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.signals.levels import HoldMeans
from leactl.analysis.statistics.linefit import LineFit, fit_lines, fit_notes, paths_of, setup_notes
from leactl.analysis.statistics.regression import Array, t_quantile
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

RESULTS = {
    "torque_constant": "N*m/A",
    "peak_current": "A",
    "torque_at_peak": "N*m",
    "loss_at_peak": "1",
    "straight_up_to": "A",
    "sticking_torque": "N*m",
}

FEWEST_LEVELS = 5  # magnitudes of current: one more than K, p, q and e need
POWER_OF_BEND = {"second_power": 2, "fourth_power": 4}
LEAST_RADICAND = 0.1  # lower bound of the root's argument during the iterations
CONVERGED_BELOW = 1e-9  # change of p and q from one iteration to the next
MOST_ITERATIONS = 20  # Gauss-Newton; it converges in four
STRAIGHT_LOSS = 0.02  # share of the torque that may be missing in the straight part


@dataclass(frozen=True, eq=False)
class SaturationCurve:
    """The fitted curve of torque over current, and the highest current; `line` is the fit of the last iteration."""

    line: LineFit
    peak: float  # A, highest setpoint of the current

    @property
    def constant(self) -> float:
        """Return the torque constant at small currents [N*m/A]."""
        return self.line.slope("torque_constant")

    def loss(self, current: float) -> tuple[float, Array]:
        """Return the share of the torque that is missing at a current [A], and its derivatives by the coefficients."""
        ratio = current / self.peak
        remaining = remaining_share(ratio, [self.line.slope(name) for name in POWER_OF_BEND])
        weight_of_bend = {name: 0.5 * remaining**3 * ratio**power for name, power in POWER_OF_BEND.items()}
        return 1.0 - remaining, coefficient_weights(self.line, weight_of_bend)


def remaining_share(ratio: Array | float, bends: Sequence[float]) -> Any:
    """Return the share of the torque that saturation leaves; `ratio` is current over peak, `bends` are p and q."""
    radicand = 1.0 + sum(bend * ratio**power for bend, power in zip(bends, POWER_OF_BEND.values(), strict=True))
    return 1.0 / np.sqrt(np.maximum(radicand, LEAST_RADICAND))


def analyze(
    runs: Sequence[Run], *, torque_gain_std: float | None = None, current_gain_std: float | None = None
) -> Result:
    """Fit torque over current up to the peak, for both signs, and estimate the loss by saturation.

    `torque_constant` [N*m/A] at small currents, `peak_current` [A], `torque_at_peak` [N*m] (its
    interval contains all that sticking may hide), `loss_at_peak` (share of the torque missing there), `straight_up_to`
    [A] (where 2 % are missing; without a value if fewer are missing up to the peak), `sticking_torque` [N*m] (half the
    difference of both sides of a level, a lower bound of the Coulomb friction).

    Parameters
    ----------
    runs : of one actuator under one condition, locked, whose steps `hold` its current at five magnitudes or more.
    torque_gain_std, current_gain_std : relative standard uncertainties of the readings' calibration; by default
        those of the channels.

    Raises
    ------
    MissingChannel : a run has no torque or no q-axis current of the test actuator.
    NotIdentifiable : fewer than five magnitudes of current within the sensor's range, or too few points.
    InputError : an uncertainty below zero, or torque and current of opposite senses.
    """
    error_prefix = f"{paths_of(runs)}: torque pulses"
    notes = setup_notes(runs, ("locked", "coupled"), "a shaft that turns takes torque past the sensor")
    torque_std = gain_std(runs, TORQUE, torque_gain_std)
    current_std = gain_std(runs, CURRENT, current_gain_std)
    constant_std = math.hypot(torque_std, current_std)
    usable_levels = torque_levels(runs, error_prefix)
    levels = usable_levels.value
    notes += usable_levels.notes
    current, torque = levels.means[CURRENT], levels.means[TORQUE]
    magnitudes = np.unique(np.round(np.abs(levels.setpoint), 9))
    if len(magnitudes) < FEWEST_LEVELS:
        raise NotIdentifiable(
            f"{error_prefix}: found {len(magnitudes)} magnitudes of current; {FEWEST_LEVELS} or more are needed to tell"
            " a bend from sticking"
        )
    peak = float(magnitudes[-1])
    columns: dict[str, Array] = {}
    if len(np.unique(np.sign(levels.setpoint))) == 2:
        columns["remainder"] = np.sign(levels.setpoint)
    else:
        notes.append("pulses of one sign only: whether the torque is the same both ways is not known")
    if len(np.unique(levels.direction)) == 2:
        columns["sticking_torque"] = levels.direction.astype(np.float64)
    else:
        notes.append("all levels were reached from one side, or no side is stated: sticking friction is not separated")
    try:
        line = fit_curve(current / peak, peak, torque, columns, levels, error_prefix)
    except NotIdentifiable as fault:  # a current in mA, a thousand times its setpoints, is a likely cause
        raise NotIdentifiable("; ".join([str(fault), *unit_notes(runs, [], [TORQUE], [CURRENT])])) from None
    curve = SaturationCurve(line, peak)
    expected_scatter = np.hypot(levels.standard_errors[TORQUE], curve.constant * levels.standard_errors[CURRENT])
    notes += fit_notes(line, expected_scatter, levels.units[TORQUE])
    notes += [f"{run.path}: {note}" for run in runs for note in convention_notes(run, curve.constant)]
    notes += calibration_notes({"torque": torque_std, "current": current_std}, "torques and torque_constant")
    notes.append("a torque sensor that bends is in the loss")

    unit = levels.units[TORQUE]
    constant = line.estimate("torque_constant", "torque_constant", f"{unit}/A", constant_std)
    refuse_below_zero(constant, error_prefix, "torque and current")
    straight_limit = straight_up_to(curve)
    notes += straight_limit.notes
    results = [
        constant,
        Estimate("peak_current", peak, NAN, NAN, NAN, "A"),
        torque_at_peak(curve, unit, constant_std),
        loss_at_peak(curve, current_std),
        straight_limit.value,
    ]
    if "sticking_torque" in line.slopes:
        sticking_weights = -coefficient_weights(line, {"sticking_torque": 1.0})
        results.append(line.fit.estimate("sticking_torque", unit, sticking_weights, torque_std))
        notes.append("sticking_torque is what the rotor kept from the sensor: a lower bound of its Coulomb friction")
    notes[:0] = unit_notes(runs, results[:1], [TORQUE], [CURRENT])
    paths = tuple(str(run.path) for run in runs)
    plot = plot_of(levels, curve)
    return Result("torque-pulses", paths, tuple(results), tuple(notes), (plot,))


def fit_curve(
    ratio: Array, peak: float, torque: Array, other_columns: dict[str, Array], levels: HoldMeans, error_prefix: str
) -> LineFit:
    """Fit the curve to the levels by Gauss-Newton steps until the bends no longer change.

    `ratio` is the current over the peak [A], shape (holds,); `other_columns` are those beside the curve itself.
    """
    constant, bends = 0.0, [0.0] * len(POWER_OF_BEND)
    for _ in range(MOST_ITERATIONS):
        remaining = remaining_share(ratio, bends)
        columns = {"torque_constant": peak * ratio * remaining}
        current_constant = constant or float(columns["torque_constant"] @ torque) / float(
            columns["torque_constant"] @ columns["torque_constant"]
        )
        columns |= {
            name: -0.5 * current_constant * peak * ratio ** (1 + power) * remaining**3
            for name, power in POWER_OF_BEND.items()
        }
        bend_torque = sum(bend * columns[name] for bend, name in zip(bends, POWER_OF_BEND, strict=True))
        line = fit_lines(columns | other_columns, torque + bend_torque, levels, error_prefix)
        previous_bends, bends = bends, [line.slope(name) for name in POWER_OF_BEND]
        constant = line.slope("torque_constant")
        if max(abs(new - old) for new, old in zip(bends, previous_bends, strict=True)) < CONVERGED_BELOW:
            break
    return line


def coefficient_weights(line: LineFit, weight_of_slope: dict[str, float]) -> Array:
    """Return the weights of all coefficients of the fit, shape (coefficients,); zero for slopes that are not named."""
    weight_of_coefficient = np.zeros(len(line.fit.coefficients))
    for name, weight in weight_of_slope.items():
        weight_of_coefficient[line.slopes.index(name)] = weight
    return weight_of_coefficient


def torque_at_peak(curve: SaturationCurve, unit: str, relative_std: float) -> Estimate:
    """Estimate the torque at the peak current; the interval covers all the torque that sticking may hide there.

    It is not known whether e is torque of the current, nor whether e changes with the level as s does. Both errors are
    systematic, so that the interval covers the true value more often than in 95 % of cases.
    """
    fit, (loss, gradient) = curve.line.fit, curve.loss(curve.peak)
    unsaturated = curve.constant * curve.peak
    torque_gradient = (
        coefficient_weights(curve.line, {"torque_constant": curve.peak * (1.0 - loss)}) - unsaturated * gradient
    )
    remainder = curve.line.slope("remainder") if "remainder" in curve.line.slopes else 0.0
    value = unsaturated * (1.0 - loss) + 0.5 * remainder
    hidden_torque = 0.5 * abs(remainder) + abs(trend_of_sticking(curve))
    std = math.sqrt(fit.variance * float(torque_gradient @ fit.unscaled_covariance @ torque_gradient))
    scatter_std = math.hypot(std, relative_std * value)
    half_width = (
        t_quantile(fit.dof * (scatter_std / std) ** 4 if std > 1e-9 * scatter_std else math.inf) * scatter_std
        + hidden_torque
    )
    total_std = math.hypot(scatter_std, hidden_torque / math.sqrt(3.0))
    return Estimate("torque_at_peak", value, total_std, value - half_width, value + half_width, unit)


def trend_of_sticking(curve: SaturationCurve) -> float:
    """Return the change of the sticking torque [N*m] from no current to the peak; zero if it was not fitted."""
    levels = curve.line.levels
    if "sticking_torque" not in curve.line.slopes:
        return 0.0
    ratio = np.abs(levels.setpoint) / curve.peak
    ratio = (ratio - ratio.mean()) * levels.direction
    return float(ratio @ curve.line.fit.residuals) / float(ratio @ ratio)


def loss_at_peak(curve: SaturationCurve, current_std: float) -> Estimate:
    """Estimate the share of the torque that is missing at the peak; a gain error of the current changes it too."""
    fit = curve.line.fit
    value, gradient = curve.loss(curve.peak)
    fit_std = math.sqrt(fit.variance * float(gradient @ fit.unscaled_covariance @ gradient))
    gain_effect = current_std * (curve.loss(1.01 * curve.peak)[0] - curve.loss(0.99 * curve.peak)[0]) / 0.02
    std = math.hypot(fit_std, gain_effect)
    half_width = math.hypot(t_quantile(fit.dof) * fit_std, t_quantile(math.inf) * gain_effect)
    return Estimate("loss_at_peak", value, std, value - half_width, value + half_width, "1")


def straight_up_to(curve: SaturationCurve) -> Noted[Estimate]:
    """Estimate the lowest current at which a share `STRAIGHT_LOSS` of the torque is missing; NaN if above the peak."""
    fit = curve.line.fit
    currents = np.linspace(0.0, curve.peak, 1001)[1:]
    losses, half_widths = np.empty_like(currents), np.empty_like(currents)
    for index, current in enumerate(currents):
        losses[index], gradient = curve.loss(float(current))
        half_widths[index] = t_quantile(fit.dof) * math.sqrt(
            fit.variance * float(gradient @ fit.unscaled_covariance @ gradient)
        )

    def first_current(values: Array) -> float:
        indices_above = np.flatnonzero(values >= STRAIGHT_LOSS)
        return float(currents[indices_above[0]]) if len(indices_above) else math.inf

    value, low, high = first_current(losses), first_current(losses + half_widths), first_current(losses - half_widths)
    if math.isinf(value):
        note = f"up to {curve.peak:g} A less than {STRAIGHT_LOSS:.0%} of the torque are missing: the bend lies above"
        return Noted(Estimate("straight_up_to", NAN, NAN, min(low, curve.peak), math.inf, "A"), (note,))
    slope = (curve.loss(value * 1.01)[0] - curve.loss(value * 0.99)[0]) / (0.02 * value)
    std = float(half_widths[np.searchsorted(currents, value)]) / t_quantile(fit.dof) / abs(slope) if slope else NAN
    return Noted(Estimate("straight_up_to", value, std, low, high, "A"))


def plot_of(levels: HoldMeans, curve: SaturationCurve) -> Plot:
    """Return the plot of the torque that is missing from the line of small currents, both signs on one side."""
    line, sign, current = curve.line, np.sign(levels.setpoint), levels.means[CURRENT]
    points = []
    missing_torque = sign * (curve.constant * current - (levels.means[TORQUE] - intercepts_by_hold(line)))
    for label, direction in {**SIDES, "levels": 0}.items():
        on_side = levels.direction == direction
        if on_side.any():
            points.append(
                Series(label, tuple(np.abs(current[on_side]).tolist()), tuple(missing_torque[on_side].tolist()))
            )
    plotted_currents = np.linspace(0.0, curve.peak, 60)
    fitted_missing = [curve.loss(float(amperes))[0] * curve.constant * float(amperes) for amperes in plotted_currents]
    fitted_series = Series("fit, without sticking", tuple(plotted_currents.tolist()), tuple(fitted_missing))
    return Plot(
        "q-axis current [A]", f"torque missing from K i [{levels.units[TORQUE]}]", tuple(points), (fitted_series,)
    )
