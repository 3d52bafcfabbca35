"""Corner speed: the speed above which the voltage allows less current than the setpoint.

    (R i + Kb w)^2 + (n L w i)^2 = V^2

Divided by Kb^2, this has three unknowns: V / Kb, R / Kb, and the increase of R / Kb with i^2 as each hold's current
warms the winding. n L / Kb is taken from the model. Each repeat has an R of its own, since the winding is warmer than
in the repeat before; so warming does not count as scatter. The corner is that of the mean R of the repeats, with the
winding as warm as a hold at the full current makes it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import NAN, Estimate, Noted
from leactl.analysis.run_model import model_of, positive_number
from leactl.analysis.statistics.regression import Array, LeastSquaresFit, indicator_columns, least_squares, t_quantile
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

NAME, UNIT = "corner_speed", "rad/s"
FEWEST_LIMITED_HOLDS = 4  # beyond the corner: one more than the unknowns of the fit of one repeat
SAME_SPEED_WITHIN = 0.005  # of the fastest hold; neighbouring speeds that differ by less are repeats
REACTANCE_STD = 0.1  # relative standard uncertainty of the model's n L / Kb
LEAST_RADICAND = 1e-9  # of (V / Kb)^2: lower bound of the root's argument during the iterations
MOST_ITERATIONS = 20  # Gauss-Newton; it converges in four
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SpeedHolds:
    """Speeds [rad/s] and currents [A] of holds, and which of them the voltage limited; shape (holds,) each."""

    speed: Array
    current: Array
    setpoint: float  # A, setpoint of the current
    limited: Mask  # the voltage limited the current
    held: Mask  # the current reached its setpoint within noise; holds neither limited nor held lie near the corner
    run: npt.NDArray[np.int64]  # number of the run that each hold belongs to


def corner_speed(runs: Sequence[Run], holds: SpeedHolds, error_prefix: str) -> Noted[Estimate]:
    """Estimate the speed above which the voltage allows less current than the setpoint.

    The value is NaN if too few holds lie beyond the corner, or all of them. The interval is then that between the
    speeds of the neighbouring holds; if all holds lie on one side, it ends at infinity or at zero. Messages of the fit
    begin with `error_prefix`.
    """
    speed, limited = holds.speed, holds.limited
    fastest_held = float(np.max(speed[holds.held], initial=0.0))
    if not limited.any():
        note = f"the current was as asked for up to {fastest_held:.4g} rad/s: the corner lies above"
        return Noted(Estimate(NAME, NAN, NAN, fastest_held, np.inf, UNIT), (note,))
    if limited.all():
        low = float(speed.min())
        note = f"the current fell short at every speed: the corner lies below {low:.4g} rad/s"
        return Noted(Estimate(NAME, NAN, NAN, 0.0, low, UNIT), (note,))
    low, high = sorted((fastest_held, float(speed[limited].min())))
    between_neighbours = Estimate(NAME, NAN, NAN, low, high, UNIT)
    if int(limited.sum()) < FEWEST_LIMITED_HOLDS:
        note = f"{limited.sum()} holds beyond the corner; {FEWEST_LIMITED_HOLDS} or more determine it better"
        return Noted(between_neighbours, (note,))
    reactance = reactance_of(runs)
    try:
        value, scatter_std, dof = fit_corner(holds, reactance.value, error_prefix)
        reactance_error = fit_corner(holds, reactance.value * (1.0 + REACTANCE_STD), error_prefix)[0] - value
    except NotIdentifiable as fault:
        return Noted(between_neighbours, (*reactance.notes, f"{fault}; the corner lies between its neighbours"))
    notes = reactance.notes
    if repeats_of(holds).max() == 0:
        notes += ("each speed was driven once: how far the winding warms from repeat to repeat is not known",)
    std = math.hypot(scatter_std, reactance_error)
    half_width = math.hypot(t_quantile(dof) * scatter_std, t_quantile(math.inf) * reactance_error)
    return Noted(Estimate(NAME, value, std, value - half_width, value + half_width, UNIT), notes)


def reactance_of(runs: Sequence[Run]) -> Noted[float]:
    """Return n L / Kb of the first run's model [1/A]; 0 and a note if the model lacks one of the three."""
    model = model_of(runs[0])
    poles, inductance, back_emf = (
        positive_number(model.get(name)) for name in ("pole_pairs", "phase_inductance", "back_emf_constant")
    )
    reactance = poles * inductance / back_emf
    if math.isfinite(reactance):
        return Noted(reactance)
    note = (
        f"{runs[0].path}: its model lacks pole_pairs, phase_inductance or back_emf_constant: corner_speed is as of no"
        " inductance, and off by some tenths of a percent"
    )
    return Noted(0.0, (note,))


def fit_corner(holds: SpeedHolds, reactance: float, error_prefix: str) -> tuple[float, float, float]:
    """Return the fitted corner speed and its standard error [rad/s], and the degrees of freedom.

    `reactance` is n L / Kb [1/A].

    Raises
    ------
    NotIdentifiable : the speeds do not determine the unknowns.
    """
    speed, current = holds.speed[holds.limited], holds.current[holds.limited]
    repeat_columns = indicator_columns(repeats_of(holds)[holds.limited])
    repeat_offsets = repeat_columns[:, 1:] - repeat_columns[:, :1]  # zero in the mean over repeats
    heat_share = (current / holds.setpoint) ** 2
    start_values = [
        float((speed + current * (speed.max() / holds.setpoint)).mean()),
        0.5 * float(speed.max()) / holds.setpoint,
    ]
    parameters = np.array([*start_values, *np.zeros(1 + repeat_offsets.shape[1])])
    fit: LeastSquaresFit | None = None
    for _ in range(MOST_ITERATIONS):
        root = np.sqrt(
            np.maximum(parameters[0] ** 2 - (reactance * speed * current) ** 2, LEAST_RADICAND * parameters[0] ** 2)
        )
        resistance_columns = np.column_stack([np.ones_like(heat_share), heat_share, repeat_offsets])
        residuals = speed - (root - (resistance_columns @ parameters[1:]) * current)
        design = np.column_stack([parameters[0] / root, -resistance_columns * current[:, np.newaxis]])
        fit = least_squares(design, residuals, design, error_prefix)
        parameters = parameters + fit.coefficients
        if float(np.max(np.abs(fit.coefficients))) < 1e-10 * abs(parameters[0]):
            break
    assert fit is not None
    hot_drop = (parameters[1] + parameters[2]) * holds.setpoint
    impedance_square = 1.0 + (reactance * holds.setpoint) ** 2
    # (w + hot_drop)^2 + (impedance_square - 1) w^2 = (V / Kb)^2
    value = (
        -hot_drop + math.sqrt(max(hot_drop**2 - impedance_square * (hot_drop**2 - parameters[0] ** 2), 0.0))
    ) / impedance_square
    slope = value * impedance_square + hot_drop
    gradient = np.zeros(len(parameters))
    gradient[0] = parameters[0] / slope
    gradient[1:3] = -holds.setpoint * (value + hot_drop) / slope
    return value, fit.combination(gradient)[1], fit.dof


def speed_groups(speed: Array) -> npt.NDArray[np.int64]:
    """Return a group number for each speed, which is the same for repeats, shape (holds,)."""
    order = np.argsort(speed)
    groups = np.empty(len(speed), np.int64)
    groups[order] = np.cumsum(np.concatenate([[0], np.diff(speed[order]) > SAME_SPEED_WITHIN * float(np.max(speed))]))
    return groups


def repeats_of(holds: SpeedHolds) -> npt.NDArray[np.int64]:
    """Return how often the same speed was driven before each hold, shape (holds,)."""
    groups = speed_groups(holds.speed)
    return np.array([int(np.sum(groups[:index] == group)) for index, group in enumerate(groups)])
