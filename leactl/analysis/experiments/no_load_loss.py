"""No-load loss up to full speed: the current that keeps a decoupled rotor turning, by how it grows with speed.

The loss f |w| is that of Coulomb friction and of hysteresis in the iron, b w^2 that of viscous friction and of eddy
currents, c |w|^3 that of air (drag.py). The speed alone does not separate friction from iron: that takes the drag of
the same rotor without its magnets, or in a stator without iron, which is measured in another run and given.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted, Plot, Result, Series
from leactl.analysis.experiments.friction import points_by_direction, torque_constants
from leactl.analysis.experiments.torque_constant import intercepts_by_hold
from leactl.analysis.quality.sign_checks import refuse_below_zero
from leactl.analysis.quality.usable_readings import usable_channel
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.signals.drag import (
    VELOCITY,
    coefficients,
    drag_at,
    fit_drag,
    holds_at_setpoint,
    turned_both_ways,
    weights_at,
)
from leactl.analysis.signals.levels import HoldMeans, HoldSelector, gather_means
from leactl.analysis.statistics.linefit import LineFit, fit_notes, paths_of, setup_notes
from leactl.analysis.statistics.regression import Array, t_quantile
from leactl.errors import InputError
from leactl.runfile.read.reader import Run

RESULTS = {
    "viscous_damping": "N*m*s/rad",
    "coulomb_friction": "N*m",
    "quadratic_drag": "N*m*s^2/rad^2",
    "full_speed": "rad/s",
    "no_load_loss": "W",
    "hysteresis_torque": "N*m",
    "eddy_damping": "N*m*s/rad",
}

CURRENT = "q_axis_current"
VELOCITY_HOLDS = HoldSelector("velocity_rad_s", "rad/s")
# drag coefficient that an iron loss is a part of, by the name of the loss
DRAG_OF_IRON_LOSS = {"hysteresis_torque": "coulomb_friction", "eddy_damping": "viscous_damping"}
LINE_POINTS = 40  # of a fitted line in the figure


@dataclass(frozen=True)
class FrictionAlone:
    """A drag coefficient of the rotor without iron loss, and its standard uncertainty."""

    value: float
    std: float


def analyze(
    runs: Sequence[Run],
    *,
    torque_constant: float | None = None,
    torque_constant_std: float | None = None,
    current_gain_std: float | None = None,
    mechanical_friction: float | None = None,
    mechanical_friction_std: float | None = None,
    mechanical_damping: float | None = None,
    mechanical_damping_std: float | None = None,
) -> Result:
    """Estimate drag over speed and the loss at full speed; with friction alone given, also the losses in the iron.

    `viscous_damping` [N*m*s/rad], `coulomb_friction` [N*m] and `quadratic_drag` [N*m*s^2/rad^2], iron included;
    `full_speed` [rad/s] and `no_load_loss` [W] there; `hysteresis_torque` [N*m] and `eddy_damping` [N*m*s/rad]. Where
    friction alone is not given, the last two have no value, only an interval from zero to all of the drag.

    Parameters
    ----------
    runs : of one actuator under one condition, free, whose steps `hold` its velocity at four speeds or more.
    torque_constant, torque_constant_std : [N*m/A], in place of the one in the runs' model, and its uncertainty.
    current_gain_std : relative, of the current's calibration; see `friction`.
    mechanical_friction, mechanical_damping : [N*m], [N*m*s/rad], f and b of the rotor without iron loss.
    mechanical_friction_std, mechanical_damping_std : their standard uncertainties.

    Raises
    ------
    MissingChannel : a run has no velocity or no q-axis current of the test actuator.
    NotIdentifiable : no torque constant, or fewer than four speeds at which the rotor turned steadily.
    InputError : a given number below zero or not finite, or current and velocity of opposite senses.
    """
    error_prefix = f"{paths_of(runs)}: no-load loss"
    without_iron = {
        "coulomb_friction": known_friction("mechanical_friction", mechanical_friction, mechanical_friction_std),
        "viscous_damping": known_friction("mechanical_damping", mechanical_damping, mechanical_damping_std),
    }
    constants = torque_constants(runs, torque_constant, torque_constant_std, current_gain_std)
    notes = setup_notes(runs, ("free",), "losses of whatever else is on the shaft are counted in")
    hold_means = gather_means(
        runs, (VELOCITY, CURRENT), partial(usable_channel, hold_selector=VELOCITY_HOLDS), VELOCITY_HOLDS
    )
    steady_levels = holds_at_setpoint(runs, hold_means.value, error_prefix)
    levels = steady_levels.value
    notes += [*hold_means.notes, *steady_levels.notes]
    torque = constants.values[levels.run_index] * levels.means[CURRENT]
    line = fit_drag(levels, torque, error_prefix)
    notes += [
        constants.note,
        *fit_notes(line, constants.values[levels.run_index] * levels.standard_errors[CURRENT], "N*m"),
    ]
    if not turned_both_ways(levels):
        notes.append("the rotor turned one way only: a zero error of the current is part of coulomb_friction")
    full_speed = float(np.max(np.abs(levels.setpoint)))
    loss = line.fit.estimate("no_load_loss", "W", full_speed * weights_at(line, full_speed), constants.relative_std)
    refuse_below_zero(loss, error_prefix, "current and velocity")
    results = coefficients(line, constants.relative_std)
    results += [Estimate("full_speed", full_speed, NAN, NAN, NAN, "rad/s"), loss]
    iron_losses = estimate_iron_losses(results, without_iron)
    results += iron_losses.value
    notes += iron_losses.notes
    notes[:0] = unit_notes(runs, results, [CURRENT], [VELOCITY], torque_constant)
    paths = tuple(str(run.path) for run in runs)
    return Result("no-load-loss", paths, tuple(results), tuple(notes), (plot_of(levels, torque, line),))


def known_friction(name: str, value: float | None, std: float | None) -> FrictionAlone | None:
    """Return the given drag coefficient of friction alone; None if it is not given.

    Raises
    ------
    InputError : a number that is negative or not finite, or an uncertainty without a value.
    """
    if value is None and std is None:
        return None
    if value is None:
        raise InputError(f"{name}_std is given without {name}; give both or neither")
    for key, number in ((name, value), (f"{name}_std", std or 0.0)):
        if not (math.isfinite(number) and number >= 0.0):
            raise InputError(f"{key} {number:g}: zero or more was expected")
    return FrictionAlone(value, std or 0.0)


def estimate_iron_losses(drag: Sequence[Estimate], friction: dict[str, FrictionAlone | None]) -> Noted[list[Estimate]]:
    """Estimate hysteresis torque and eddy damping: coefficients of the drag minus those of friction alone.

    If the friction alone is not known, the value is NaN and the interval reaches from zero to all of the drag.
    """
    by_name = {estimate.name: estimate for estimate in drag}
    losses, unknown_losses, notes = [], [], []
    for name, coefficient_name in DRAG_OF_IRON_LOSS.items():
        drag_coefficient, friction_alone = by_name[coefficient_name], friction[coefficient_name]
        if friction_alone is None:
            unknown_losses.append(name)
            losses.append(Estimate(name, NAN, NAN, 0.0, max(drag_coefficient.high, 0.0), drag_coefficient.units))
            continue
        half_width = math.hypot(
            drag_coefficient.high - drag_coefficient.value, t_quantile(math.inf) * friction_alone.std
        )
        value = drag_coefficient.value - friction_alone.value
        std = math.hypot(drag_coefficient.std, friction_alone.std)
        losses.append(Estimate(name, value, std, value - half_width, value + half_width, drag_coefficient.units))
        if value + half_width < 0.0:
            notes.append(f"{name} is below zero: the friction that is given is more than all of the drag")
    if unknown_losses:
        notes.append(
            f"{' and '.join(unknown_losses)}: not identifiable from the speed alone, anything from zero to all of the"
            " drag; give mechanical_friction and mechanical_damping of the rotor without iron loss"
        )
    return Noted(losses, tuple(notes))


def plot_of(levels: HoldMeans, torque: Array, line: LineFit) -> Plot:
    """Return the plot of the loss over speed, by direction, and of the fit as the running sum of its three parts."""
    velocity = levels.means[VELOCITY]
    losses = (torque - intercepts_by_hold(line) if turned_both_ways(levels) else torque) * velocity
    points = points_by_direction(velocity, losses)
    speeds = np.linspace(0.0, float(np.max(np.abs(velocity))), LINE_POINTS)
    friction_loss = weights_at(line, 0.0) @ line.fit.coefficients * speeds
    lines = (
        Series("all", tuple(speeds.tolist()), tuple((drag_at(line.fit, line, speeds) * speeds).tolist())),
        Series("Coulomb, hysteresis", tuple(speeds.tolist()), tuple(friction_loss.tolist())),
        Series(
            "and viscous, eddy currents",
            tuple(speeds.tolist()),
            tuple((friction_loss + line.slope("viscous_damping") * speeds**2).tolist()),
        ),
    )
    return Plot("speed [rad/s]", "no-load loss [W]", points, lines)
