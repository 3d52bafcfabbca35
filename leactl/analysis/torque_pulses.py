"""Torque pulses to peak current: how the torque falls behind the current as the iron saturates.

    torque = K i (1 - p (i/I)^2 - q (i/I)^4) + s d + e sgn(i) + c

for currents up to I: an odd function of the current, since iron has no sign of its own. s is what a rotor that sticks
keeps from the sensor, by the side d that a level was reached from (torque_constant.py); e is what of it does not turn
with d, since a rotor that a fast ramp stops rings first. A gain error of sensor or current is a factor on K and in no
loss.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Plot, Result, Series
from leactl.analysis.levels import Levels, gather, require_levels
from leactl.analysis.linefit import LineFit, expect_setup, fit_lines, place_of, remarks
from leactl.analysis.readings import usable
from leactl.analysis.regression import Array, t_quantile
from leactl.analysis.signs import refuse_below_zero
from leactl.analysis.torque_constant import CURRENT, SIDES, TORQUE, convention, of_one_kind
from leactl.errors import NotIdentifiable
from leactl.runfile.reader import Run

FEWEST_LEVELS = 5  # magnitudes of current: one more than K, p, q and e need
BENDS = ("third_order", "fifth_order")
STRAIGHT = 0.02  # of the torque: a loss up to which a current counts as within the straight part


@dataclass(frozen=True, eq=False)
class Bent:
    """The fitted curve and its highest current."""

    line: LineFit
    peak: float  # A

    @property
    def constant(self) -> float:
        """Torque constant at small currents [N*m/A]."""
        return self.line.slope("torque_constant")

    def loss(self, current: float) -> tuple[float, Array]:
        """Share of the torque that is missing at a current, and its gradient by the fit's coefficients."""
        ratio = current / self.peak
        powers = dict(zip(BENDS, (ratio**2, ratio**4), strict=True))
        value = -sum(self.line.slope(name) * power for name, power in powers.items()) / self.constant
        gradient = np.zeros(len(self.line.fit.coefficients))
        for index, name in enumerate(self.line.slopes):
            gradient[index] = -powers.get(name, 0.0) / self.constant
        gradient[self.line.slopes.index("torque_constant")] = -value / self.constant
        return value, gradient


def analyze(runs: Sequence[Run]) -> Result:
    """Fit torque over current up to the peak, both signs, and tell how much of it saturation takes there.

    `torque_constant` [N*m/A] at small currents, `peak_current` [A], `torque_at_peak` [N*m] (halfway between both
    sides), `loss_at_peak` (share of the torque missing there), `straight_up_to` [A] (where 2 % are missing; without a
    value, above the peak, where they are not), `sticking_torque` [N*m].

    Parameters
    ----------
    runs : of one actuator under one condition, locked, whose steps `hold` its current at five magnitudes or more.

    Raises
    ------
    MissingChannel : a run has no torque or no q-axis current of the test actuator.
    NotIdentifiable : fewer than five magnitudes of current within the sensor's range, or too few points.
    InputError : torque and current of opposite senses.
    """
    place = f"{place_of(runs)}: torque pulses"
    notes = expect_setup(runs, ("locked", "coupled"), "a shaft that turns takes torque past the sensor")
    levels = of_one_kind(gather(runs, (CURRENT, TORQUE), notes, lambda run, name: usable(run, name, notes)), notes)
    current, torque = levels.value[CURRENT], levels.value[TORQUE]
    require_levels(place, "current", levels.setpoint, current, levels.std[CURRENT])
    magnitudes = np.unique(np.round(np.abs(levels.setpoint), 9))
    if len(magnitudes) < FEWEST_LEVELS:
        raise NotIdentifiable(
            f"{place}: found {len(magnitudes)} magnitudes of current; {FEWEST_LEVELS} or more are needed to tell a bend"
            " from sticking"
        )
    peak = float(magnitudes[-1])
    columns = {"torque_constant": current}
    columns |= {name: current * (current / peak) ** power for name, power in zip(BENDS, (2, 4), strict=True)}
    if len(np.unique(np.sign(levels.setpoint))) == 2:
        columns["remainder"] = np.sign(levels.setpoint)
    else:
        notes.append("pulses of one sign only: whether the torque is the same both ways is not known")
    if len(np.unique(levels.direction)) == 2:
        columns["sticking_torque"] = levels.direction.astype(np.float64)
    else:
        notes.append("all levels were reached from one side or none is said: sticking friction is not told apart")
    line = fit_lines(columns, torque, levels, place)
    bent = Bent(line, peak)
    expected = np.hypot(levels.std[TORQUE], bent.constant * levels.std[CURRENT])
    notes += remarks(line, expected, levels.units[TORQUE])
    notes += [f"{run.path}: {what}" for run in runs for what in convention(run, bent.constant)]
    notes.append("a gain error of torque or current is a factor on top, and in no loss; a sensor that bends is in both")

    unit = levels.units[TORQUE]
    constant = line.estimate("torque_constant", "torque_constant", f"{unit}/A")
    refuse_below_zero(constant, place, "torque and current")
    results = [
        constant,
        Estimate("peak_current", peak, NAN, NAN, NAN, "A"),
        at_peak(bent, unit),
        loss_at_peak(bent),
        straight_up_to(bent, notes),
    ]
    if "sticking_torque" in line.slopes:
        found = line.fit.estimate("sticking_torque", unit, -weights(line, {"sticking_torque": 1.0}))
        results.append(found)
    paths = tuple(str(run.path) for run in runs)
    plot = plot_of(levels, bent)
    return Result("torque-pulses", paths, tuple(results), tuple(notes), (plot,))


def weights(line: LineFit, of: dict[str, float]) -> Array:
    """Weights of the fit's coefficients by the names of its slopes."""
    found = np.zeros(len(line.fit.coefficients))
    for name, weight in of.items():
        found[line.slopes.index(name)] = weight
    return found


def at_peak(bent: Bent, unit: str) -> Estimate:
    """Torque at the peak current, halfway between both sides of it; what of the sticking remains is evenly spread."""
    line, half_way = bent.line, dict.fromkeys(("torque_constant", *BENDS), bent.peak)
    remainder = 0.0
    if "remainder" in line.slopes:
        half_way["remainder"] = 1.0
        remainder = abs(line.slope("remainder"))
    share = weights(line, half_way)
    value = line.fit.combined(share)[0]
    return line.fit.estimate("torque_at_peak", unit, share, remainder / math.sqrt(3.0) / abs(value))


def loss_at_peak(bent: Bent) -> Estimate:
    """Share of the torque that is missing at the peak."""
    fit = bent.line.fit
    value, gradient = bent.loss(bent.peak)
    std = math.sqrt(fit.variance * float(gradient @ fit.unscaled @ gradient))
    half = t_quantile(fit.dof) * std
    return Estimate("loss_at_peak", value, std, value - half, value + half, "1")


def straight_up_to(bent: Bent, notes: list[str]) -> Estimate:
    """The lowest current at which a share of `STRAIGHT` is missing."""
    fit = bent.line.fit
    currents = np.linspace(0.0, bent.peak, 1001)[1:]
    losses, halves = np.empty_like(currents), np.empty_like(currents)
    for index, current in enumerate(currents):
        losses[index], gradient = bent.loss(float(current))
        halves[index] = t_quantile(fit.dof) * math.sqrt(fit.variance * float(gradient @ fit.unscaled @ gradient))

    def first(values: Array) -> float:
        past = np.flatnonzero(values >= STRAIGHT)
        return float(currents[past[0]]) if len(past) else math.inf

    value, low, high = first(losses), first(losses + halves), first(losses - halves)
    if math.isinf(value):
        notes.append(f"up to {bent.peak:g} A less than {STRAIGHT:.0%} of the torque are missing: the bend lies above")
        return Estimate("straight_up_to", NAN, NAN, min(low, bent.peak), math.inf, "A")
    slope = (bent.loss(value * 1.01)[0] - bent.loss(value * 0.99)[0]) / (0.02 * value)
    std = float(halves[np.searchsorted(currents, value)]) / t_quantile(fit.dof) / abs(slope) if slope else NAN
    return Estimate("straight_up_to", value, std, low, high, "A")


def plot_of(levels: Levels, bent: Bent) -> Plot:
    """What the torque lacks of the straight line through small currents, both signs on one side."""
    line, sign, current = bent.line, np.sign(levels.setpoint), levels.value[CURRENT]
    points = []
    intercepts = line.fit.coefficients[len(line.slopes) :][np.searchsorted(np.unique(levels.run), levels.run)]
    lack = sign * (bent.constant * current - (levels.value[TORQUE] - intercepts))
    for label, side in {**SIDES, "levels": 0}.items():
        of_it = levels.direction == side
        if of_it.any():
            points.append(Series(label, tuple(np.abs(current[of_it]).tolist()), tuple(lack[of_it].tolist())))
    drawn = np.linspace(0.0, bent.peak, 60)
    missing = [bent.loss(float(amperes))[0] * bent.constant * float(amperes) for amperes in drawn]
    fitted = Series("fit, without sticking", tuple(drawn.tolist()), tuple(missing))
    return Plot("q-axis current [A]", f"torque missing from K i [{levels.units[TORQUE]}]", tuple(points), (fitted,))
