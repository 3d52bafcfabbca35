"""Torque pulses to peak current: how the torque falls behind the current as the iron saturates.

    torque = K i / sqrt(1 + p (i/I)^2 + q (i/I)^4) + s d + e sgn(i) + c

for currents up to I: an odd function of the current, since iron has no sign of its own, that bends as knees do. s is
what a rotor that sticks keeps from the sensor, by the side d that a level was reached from (torque_constant.py): no
more than its Coulomb friction, less where it rings before it stops. e is what of it does not turn with d, and no torque
of the current. A gain error of sensor or current is a factor on K; one of the current moves along the bend.
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

FEWEST_LEVELS = 5  # magnitudes of current, one more than K, p, q and e need
POWER_OF_BEND = {"second_power": 2, "fourth_power": 4}
LEAST_RADICAND = 0.1  # lower bound of the root's argument during the iterations
CONVERGED_BELOW = 1e-9
MOST_ITERATIONS = 20  # Gauss-Newton; it converges in four
STRAIGHT_LOSS = 0.02  # of the torque, up to which a current is in the straight part


@dataclass(frozen=True, eq=False)
class SaturationCurve:
    """The fitted curve of torque over current, and the highest current."""

    line: LineFit
    peak: float  # A

    @property
    def constant(self) -> float:
        """Return the torque constant at small currents [N*m/A]."""
        return self.line.slope("torque_constant")

    def loss(self, current: float) -> tuple[float, Array]:
        """Return the share of the torque that is missing at a current [A], and its gradient by the coefficients."""
        ratio = current / self.peak
        kept = remaining_share(ratio, [self.line.slope(name) for name in POWER_OF_BEND])
        weight_of_bend = {name: 0.5 * kept**3 * ratio**power for name, power in POWER_OF_BEND.items()}
        return 1.0 - kept, coefficient_weights(self.line, weight_of_bend)


def remaining_share(ratio: Array | float, bends: Sequence[float]) -> Any:
    """Return the share of the torque that saturation leaves; `ratio` is the current over the peak."""
    under = 1.0 + sum(bend * ratio**power for bend, power in zip(bends, POWER_OF_BEND.values(), strict=True))
    return 1.0 / np.sqrt(np.maximum(under, LEAST_RADICAND))


def analyze(
    runs: Sequence[Run], *, torque_gain_std: float | None = None, current_gain_std: float | None = None
) -> Result:
    """Fit torque over current up to the peak, both signs, and tell how much of it saturation takes there.

    `torque_constant` [N*m/A] at small currents, `peak_current` [A], `torque_at_peak` [N*m] (with all that sticking may
    hide in its interval), `loss_at_peak` (share of the torque missing there), `straight_up_to` [A] (where 2 % are
    missing; without a value, above the peak, where they are not), `sticking_torque` [N*m] (half the way between both
    sides of a level, a lower bound of the Coulomb friction).

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
    both_stds = math.hypot(torque_std, current_std)
    gathered = torque_levels(runs, error_prefix)
    levels = gathered.value
    notes += gathered.notes
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
    except NotIdentifiable as fault:  # as where a current is a thousand times its setpoints
        raise NotIdentifiable("; ".join([str(fault), *unit_notes(runs, [], [TORQUE], [CURRENT])])) from None
    bent = SaturationCurve(line, peak)
    expected = np.hypot(levels.standard_errors[TORQUE], bent.constant * levels.standard_errors[CURRENT])
    notes += fit_notes(line, expected, levels.units[TORQUE])
    notes += [f"{run.path}: {note}" for run in runs for note in convention_notes(run, bent.constant)]
    notes += calibration_notes({"torque": torque_std, "current": current_std}, "torques and torque_constant")
    notes.append("a torque sensor that bends is in the loss")

    unit = levels.units[TORQUE]
    constant = line.estimate("torque_constant", "torque_constant", f"{unit}/A", both_stds)
    refuse_below_zero(constant, error_prefix, "torque and current")
    straight = straight_up_to(bent)
    notes += straight.notes
    results = [
        constant,
        Estimate("peak_current", peak, NAN, NAN, NAN, "A"),
        torque_at_peak(bent, unit, both_stds),
        loss_at_peak(bent, current_std),
        straight.value,
    ]
    if "sticking_torque" in line.slopes:
        sticking = -coefficient_weights(line, {"sticking_torque": 1.0})
        results.append(line.fit.estimate("sticking_torque", unit, sticking, torque_std))
        notes.append("sticking_torque is what the rotor kept from the sensor: a lower bound of its Coulomb friction")
    notes[:0] = unit_notes(runs, results[:1], [TORQUE], [CURRENT])
    paths = tuple(str(run.path) for run in runs)
    plot = plot_of(levels, bent)
    return Result("torque-pulses", paths, tuple(results), tuple(notes), (plot,))


def fit_curve(
    ratio: Array, peak: float, torque: Array, other_columns: dict[str, Array], levels: HoldMeans, error_prefix: str
) -> LineFit:
    """Fit the curve to the levels by Gauss-Newton steps until the bends no longer change."""
    constant, bends = 0.0, [0.0] * len(POWER_OF_BEND)
    for _ in range(MOST_ITERATIONS):
        kept = remaining_share(ratio, bends)
        columns = {"torque_constant": peak * ratio * kept}
        current_constant = constant or float(columns["torque_constant"] @ torque) / float(
            columns["torque_constant"] @ columns["torque_constant"]
        )
        columns |= {
            name: -0.5 * current_constant * peak * ratio ** (1 + power) * kept**3
            for name, power in POWER_OF_BEND.items()
        }
        shift = sum(bend * columns[name] for bend, name in zip(bends, POWER_OF_BEND, strict=True))
        line = fit_lines(columns | other_columns, torque + shift, levels, error_prefix)
        before, bends = bends, [line.slope(name) for name in POWER_OF_BEND]
        constant = line.slope("torque_constant")
        if max(abs(new - old) for new, old in zip(bends, before, strict=True)) < CONVERGED_BELOW:
            break
    return line


def coefficient_weights(line: LineFit, weight_of_slope: dict[str, float]) -> Array:
    """Return weights of all coefficients of the fit, shape (coefficients,), from weights by the names of slopes."""
    weight_of_coefficient = np.zeros(len(line.fit.coefficients))
    for name, weight in weight_of_slope.items():
        weight_of_coefficient[line.slopes.index(name)] = weight
    return weight_of_coefficient


def torque_at_peak(bent: SaturationCurve, unit: str, relative_std: float) -> Estimate:
    """Estimate the torque at the peak current; the interval covers all the torque that sticking may hide there.

    It is not known whether e is torque of the current, nor whether e changes with the level as s does. Neither error
    scatters, so that the interval covers the true value more often than in 95 % of cases.
    """
    fit, (loss, gradient) = bent.line.fit, bent.loss(bent.peak)
    unsaturated = bent.constant * bent.peak
    torque_gradient = (
        coefficient_weights(bent.line, {"torque_constant": bent.peak * (1.0 - loss)}) - unsaturated * gradient
    )
    remainder = bent.line.slope("remainder") if "remainder" in bent.line.slopes else 0.0
    value = unsaturated * (1.0 - loss) + 0.5 * remainder
    hidden = 0.5 * abs(remainder) + abs(trend_of_sticking(bent))
    std = math.sqrt(fit.variance * float(torque_gradient @ fit.unscaled_covariance @ torque_gradient))
    scattered = math.hypot(std, relative_std * value)
    half = t_quantile(fit.dof * (scattered / std) ** 4 if std > 1e-9 * scattered else math.inf) * scattered + hidden
    total_std = math.hypot(scattered, hidden / math.sqrt(3.0))
    return Estimate("torque_at_peak", value, total_std, value - half, value + half, unit)


def trend_of_sticking(bent: SaturationCurve) -> float:
    """Return the change of the sticking torque [N*m] from no current to the peak; zero where it was not fitted."""
    levels = bent.line.levels
    if "sticking_torque" not in bent.line.slopes:
        return 0.0
    ratio = np.abs(levels.setpoint) / bent.peak
    ratio = (ratio - ratio.mean()) * levels.direction
    return float(ratio @ bent.line.fit.residuals) / float(ratio @ ratio)


def loss_at_peak(bent: SaturationCurve, current_std: float) -> Estimate:
    """Estimate the share of the torque that is missing at the peak; a gain error of the current changes it too."""
    fit = bent.line.fit
    value, gradient = bent.loss(bent.peak)
    fit_std = math.sqrt(fit.variance * float(gradient @ fit.unscaled_covariance @ gradient))
    gain_effect = current_std * (bent.loss(1.01 * bent.peak)[0] - bent.loss(0.99 * bent.peak)[0]) / 0.02
    std = math.hypot(fit_std, gain_effect)
    half = math.hypot(t_quantile(fit.dof) * fit_std, t_quantile(math.inf) * gain_effect)
    return Estimate("loss_at_peak", value, std, value - half, value + half, "1")


def straight_up_to(bent: SaturationCurve) -> Noted[Estimate]:
    """Estimate the lowest current at which a share `STRAIGHT_LOSS` of the torque is missing; NaN where none is."""
    fit = bent.line.fit
    currents = np.linspace(0.0, bent.peak, 1001)[1:]
    losses, halves = np.empty_like(currents), np.empty_like(currents)
    for index, current in enumerate(currents):
        losses[index], gradient = bent.loss(float(current))
        halves[index] = t_quantile(fit.dof) * math.sqrt(
            fit.variance * float(gradient @ fit.unscaled_covariance @ gradient)
        )

    def first(values: Array) -> float:
        past = np.flatnonzero(values >= STRAIGHT_LOSS)
        return float(currents[past[0]]) if len(past) else math.inf

    value, low, high = first(losses), first(losses + halves), first(losses - halves)
    if math.isinf(value):
        note = f"up to {bent.peak:g} A less than {STRAIGHT_LOSS:.0%} of the torque are missing: the bend lies above"
        return Noted(Estimate("straight_up_to", NAN, NAN, min(low, bent.peak), math.inf, "A"), (note,))
    slope = (bent.loss(value * 1.01)[0] - bent.loss(value * 0.99)[0]) / (0.02 * value)
    std = float(halves[np.searchsorted(currents, value)]) / t_quantile(fit.dof) / abs(slope) if slope else NAN
    return Noted(Estimate("straight_up_to", value, std, low, high, "A"))


def plot_of(levels: HoldMeans, bent: SaturationCurve) -> Plot:
    """Plot the torque that is missing from the straight line of small currents, both signs on one side."""
    line, sign, current = bent.line, np.sign(levels.setpoint), levels.means[CURRENT]
    points = []
    lack = sign * (bent.constant * current - (levels.means[TORQUE] - intercepts_by_hold(line)))
    for label, side in {**SIDES, "levels": 0}.items():
        on_side = levels.direction == side
        if on_side.any():
            points.append(Series(label, tuple(np.abs(current[on_side]).tolist()), tuple(lack[on_side].tolist())))
    drawn = np.linspace(0.0, bent.peak, 60)
    missing = [bent.loss(float(amperes))[0] * bent.constant * float(amperes) for amperes in drawn]
    fit_curve = Series("fit, without sticking", tuple(drawn.tolist()), tuple(missing))
    return Plot("q-axis current [A]", f"torque missing from K i [{levels.units[TORQUE]}]", tuple(points), (fit_curve,))
