"""Efficiency over speed and torque: one actuator drives at a speed, the other is driven and opposes with a current.

Paper, section "Efficiency": eta+ = tau w / (V i) of the driving actuator, eta- = V i / (tau w) of the driven actuator,
which is negative where its winding takes more heat than the shaft brings in. As in the paper, the mean is that of the
points of the grid, each counting once; points that the bench did not hold have no value and do not count.
"""

from collections.abc import Sequence

import numpy as np

from leactl.analysis.efficiency.checks import refuse_swapped_signs, with_drift
from leactl.analysis.efficiency.drive_losses import drive_losses
from leactl.analysis.efficiency.known_parameters import GivenParameters, calibration_of, sources_of
from leactl.analysis.efficiency.maps import currents_and_voltages, grid_of, speeds_and_torques
from leactl.analysis.efficiency.means import MapMeans
from leactl.analysis.efficiency.operating_points import gather_grid
from leactl.analysis.estimate import NAN, Estimate, Grid, Result
from leactl.analysis.statistics.linefit import paths_of, setup_notes
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Run

RESULTS = {
    "driving_efficiency": "1",
    "driving_efficiency_spread": "1",
    "driving_efficiency_highest": "1",
    "driving_power_mechanical": "W",
    "driving_power_electrical": "W",
    "driving_loss": "W",
    "driving_loss_copper": "W",
    "driving_loss_friction": "W",
    "driving_negative_share": "1",
    "driven_efficiency": "1",
    "driven_efficiency_spread": "1",
    "driven_efficiency_highest": "1",
    "driven_power_mechanical": "W",
    "driven_power_electrical": "W",
    "driven_loss": "W",
    "driven_loss_copper": "W",
    "driven_loss_friction": "W",
    "driven_negative_share": "1",
    "load_driving_efficiency": "1",
    "load_driving_efficiency_spread": "1",
    "load_driving_efficiency_highest": "1",
    "load_driving_power_mechanical": "W",
    "load_driving_power_electrical": "W",
    "load_driving_loss": "W",
    "load_driving_loss_copper": "W",
    "load_driving_loss_friction": "W",
    "load_driving_negative_share": "1",
    "load_driven_efficiency": "1",
    "load_driven_efficiency_spread": "1",
    "load_driven_efficiency_highest": "1",
    "load_driven_power_mechanical": "W",
    "load_driven_power_electrical": "W",
    "load_driven_loss": "W",
    "load_driven_loss_copper": "W",
    "load_driven_loss_friction": "W",
    "load_driven_negative_share": "1",
    "drives_loss": "W",
}

MEANS = {  # attribute of `Balance` and its unit, by the name of a result after `driving_` or `driven_`
    "loss": ("loss", "W"),
    "loss_copper": ("copper", "W"),
    "loss_friction": ("friction", "W"),
    "power_electrical": ("electrical", "W"),
    "power_mechanical": ("mechanical", "W"),
}


def analyze(
    runs: Sequence[Run],
    *,
    phase_resistance: float | None = None,
    back_emf_constant: float | None = None,
    winding_temperature: float | None = None,
    resistance_std: float | None = None,
    back_emf_constant_std: float | None = None,
    torque_gain_std: float | None = None,
    current_gain_std: float | None = None,
    voltage_gain_std: float | None = None,
) -> Result:
    """Estimate efficiency and losses over the grid, of the driving actuator and of the driven one.

    `driving_efficiency` and `driven_efficiency` (means over the grid), `_spread` (standard deviation over the grid),
    `_highest`, and, in W as means over the grid, `driving_loss`, `_loss_copper`, `_loss_friction`, `_power_electrical`,
    `_power_mechanical`, and the same of `driven`; `driven_negative_share`, the share of points whose efficiency is
    negative. Results of the load actuator begin with `load_`. `drives_loss` [W] where the current of the DC link
    is measured. Grids hold every point.

    Parameters
    ----------
    runs : of one actuator under one condition, coupled, whose steps `hold` a speed of one actuator and a current of the
        other.
    phase_resistance, back_emf_constant : [ohm], [V*s/rad], q axis, in place of those of the runs' model.
    winding_temperature : [degC], at which electrical power is stated; by default that of the model's resistance. Where
        the runs have q-axis voltages, power is measured, unless this temperature is given.
    resistance_std, back_emf_constant_std, torque_gain_std, current_gain_std, voltage_gain_std : relative standard
        uncertainties of resistance, constant and calibrations; by default 0, and for torque that of its channel.

    Raises
    ------
    MissingChannel : a run has no torque, no velocity, or no current of either actuator.
    NotIdentifiable : no step holds a point of a grid, no point was reached, or there are neither voltages nor a
        resistance.
    InputError : an uncertainty below zero, or readings whose signs contradict each other.
    """
    error_prefix = f"{paths_of(runs)}: efficiency"
    notes = setup_notes(runs, ("coupled",), "another machine has to drive or to be driven")
    given_parameters = GivenParameters(phase_resistance, back_emf_constant, winding_temperature)
    relative_stds = {
        "resistance": resistance_std, "back_emf_constant": back_emf_constant_std, "torque_gain": torque_gain_std,
        "current_gain": current_gain_std, "voltage_gain": voltage_gain_std,
    }  # fmt: skip
    grid_points = gather_grid(runs)
    known_parameters = calibration_of(runs, grid_points.value, given_parameters, relative_stds)
    calibration, stds = known_parameters.value
    refuse_swapped_signs(grid_points.value, error_prefix)
    drift_checked = with_drift(grid_points.value, runs, calibration)
    points = drift_checked.value
    notes += [*grid_points.notes, *known_parameters.notes, *drift_checked.notes]
    results: list[Estimate] = []
    grids: list[Grid] = []
    maps: list[MapMeans] = []
    for role, prefix in (("test", ""), ("load", "load_")):
        for driving, mode in ((True, "driving"), (False, "driven")):
            in_map = np.array([(grid_hold.driving == role) == driving for grid_hold in points.holds], np.bool_)
            map_points = points.where(in_map)
            if not map_points.holds or ("q_axis_current", role) not in map_points.value:
                continue
            means = MapMeans(map_points, role, driving, calibration, stds)
            if not means.reached_points:
                notes.append(f"no point was held at which the {role} actuator was {mode}")
                continue
            results += estimates(means, f"{prefix}{mode}")
            grids.append(grid_of(means, f"{prefix}{mode}"))
            maps.append(means)
            notes += means.remarks(f"{role} {mode}")
    if not results:
        raise NotIdentifiable("\n".join([f"{error_prefix}: no point of the grid was held", *notes]))
    link_loss = drive_losses(runs, points, calibration)
    results += link_loss.value
    notes += [*link_loss.notes, sources_of(stds)]
    paths = tuple(str(run.path) for run in runs)
    plots = (speeds_and_torques(maps), currents_and_voltages(maps))
    return Result("efficiency", paths, tuple(results), tuple(notes), plots, grids=tuple(grids))


def estimates(means: MapMeans, name: str) -> list[Estimate]:
    """Return efficiency, powers and losses of one map; `name` opens the names of the results."""
    results = [means.mean("efficiency", f"{name}_efficiency", "1")]
    results += [means.spread(f"{name}_efficiency_spread"), means.highest(f"{name}_efficiency_highest")]
    results += [means.mean(quantity, f"{name}_{suffix}", units) for suffix, (quantity, units) in MEANS.items()]
    if not means.driving:
        efficiency = means.over_map("efficiency")
        share = float(np.mean(efficiency[np.isfinite(efficiency)] < 0.0))
        results.append(Estimate(f"{name}_negative_share", share, NAN, NAN, NAN, "1"))
    return results
