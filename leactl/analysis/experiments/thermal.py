"""Thermal network and winding resistance from a heated record: direct current through two leads, then cooling.

Paper, section "Thermal Dynamics". Cw dTw/dt = Q - (Tw - Ta)/Rwa - (Tw - Th)/Rwh, Ch dTh/dt = (Tw - Th)/Rwh -
(Th - Ta)/Rha with Q the voltage between the leads times the current. Readings of the supply are joined by straight
lines, or hold over the interval if a channel says that they are means, and the network is solved exactly between them.
In the joint covariance, network and resistance share the errors of calibration; noise and drift are separate.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from leactl.analysis.estimate import Covariance, Noted, Result, joined
from leactl.analysis.heating.estimates import (
    FEWEST_TIME_CONSTANTS,
    REPORTED_STDS,
    STEADY_STATE_RESULTS,
    camera_results,
    network_results,
    remarks,
    residual_results,
    resistance_results,
    slow_constants_seen,
    steadiness,
    without_value,
)
from leactl.analysis.heating.fitted_currents import current_capability
from leactl.analysis.heating.network import NetworkFit, Unknowns, fit_network
from leactl.analysis.heating.parameters import NAMES, Instruments, natural_covariance, thermal_parameters, uncertainty
from leactl.analysis.heating.plots import plots_of
from leactl.analysis.heating.record import frame_count, heating_records
from leactl.analysis.heating.resistance import REFERENCE_TEMPERATURE, resistance_line
from leactl.analysis.quality.calibration_uncertainty import gain_std
from leactl.analysis.quality.wrong_units import unit_notes
from leactl.analysis.run_model import model_of, winding_limit_of
from leactl.analysis.statistics.linefit import paths_of, setup_notes
from leactl.errors import InputError
from leactl.model.winding import FRAMES
from leactl.runfile.read.reader import Run

RESULTS = {
    "winding_ambient_resistance": "K/W",
    "winding_housing_resistance": "K/W",
    "housing_ambient_resistance": "K/W",
    "winding_capacitance": "J/K",
    "housing_capacitance": "J/K",
    "parallel_thermal_resistance": "K/W",
    "line_resistance": "ohm",
    "phase_resistance": "ohm",
    "resistance_coefficient": "1/K",
    "resistance_r_squared": "1",
    "rmse": "K",
    "rmse_winding": "K",
    "rmse_housing": "K",
    "rmse_over_noise": "1",
    "change_in_30_min": "K",
    "camera_lag": "s",
    "camera_offset_winding": "K",
    "camera_offset_housing": "K",
    "continuous_current": "A",
    "peak_current_1s": "A",
    "peak_current_2s": "A",
    "peak_current_5s": "A",
    "peak_current_10s": "A",
    "peak_current_20s": "A",
    "peak_current_60s": "A",
    "peak_current_300s": "A",
    "continuous_current_standing": "A",
    "peak_current_1s_standing": "A",
    "peak_current_2s_standing": "A",
    "peak_current_5s_standing": "A",
    "peak_current_10s_standing": "A",
    "peak_current_20s_standing": "A",
    "peak_current_60s_standing": "A",
    "peak_current_300s_standing": "A",
}

MOST_CHANGE_STDS = 3.0  # of the supply's readings from one run to the next
MOST_LEFT_OUT_SHARE = 0.01  # of the fitted frames; a note names a larger share


def analyze(
    runs: Sequence[Run],
    *,
    camera_offset_std: float = 1.0,
    camera_gain_std: float = 0.01,
    voltage_gain_std: float | None = None,
    current_gain_std: float | None = None,
    supply_change_std: float = 0.0,
    camera_lag: float | None = None,
    winding_limit: float | None = None,
    ambient: float = 25.0,
) -> Result:
    """Fit the two-node network and the winding's resistance, and estimate the currents that the actuator can carry.

    Resistances [K/W] and capacitances [J/K] of the network, their combination `parallel_thermal_resistance` Rwa ||
    (Rwh + Rha), resistance at 25 degC and its coefficient, residuals against noise, the change in the last 30 minutes
    of heating, continuous and peak current [A] with all phases alike, and with the rotor standing. A result
    that the record does not determine is NaN, and a note says so.

    Parameters
    ----------
    runs : of one actuator under one condition, with temperatures of active and inactive windings and of the housing.
    camera_offset_std : [K], standard uncertainty of the camera's zero; 1 K is half of the +-2 K of a thermal camera.
    camera_gain_std : relative, of the rise that it shows; 0.01 is half of its +-2 %.
    voltage_gain_std, current_gain_std : relative, of the supply's readings; by default those of the channels.
    supply_change_std : relative, of the change of the supply's readings from one run to the next; by default zero. Else
        network and resistance hold for the supply as it read in the first run.
    camera_lag : [s], by which the camera's clock is behind the supply's; estimated by default.
    winding_limit : [degC], up to which the currents may heat; by default that of the run's model, else the paper's 130.
    ambient : [degC], from which the currents heat.

    Raises
    ------
    MissingChannel : a run lacks the temperatures of winding or housing, line current or line voltage.
    NotIdentifiable : no current flows, or no network of two bodies follows the temperatures.
    InputError : temperatures in kelvin, a resistance below zero, an option out of range, or readings of the supply that
        change from one run to the next by more than `MOST_CHANGE_STDS` of `supply_change_std`.
    """
    error_prefix = f"{paths_of(runs)}: thermal"
    supply_gains = [
        gain_std(runs, name, given_std)
        for name, given_std in (("line_voltage", voltage_gain_std), ("line_current", current_gain_std))
    ]
    instruments = Instruments(camera_offset_std, camera_gain_std, *supply_gains)
    refuse_options(
        {
            **asdict(instruments),
            "supply_change": supply_change_std,
            "camera_lag": camera_lag,
            "ambient": ambient,
            "winding_limit": winding_limit,
        }
    )
    model = model_of(runs[0])
    limit = winding_limit if winding_limit is not None else winding_limit_of(model)
    if limit <= ambient:
        raise InputError(
            f"{error_prefix}: a winding limit of {limit:g} degC is not above the ambient of {ambient:g} degC"
        )
    notes = setup_notes(runs, ("heated",), "friction and iron loss would heat besides")
    phase_to_line_ratio = phase_share(model)
    records = joined(heating_records(run) for run in runs)
    notes += [*phase_to_line_ratio.notes, *records.notes]
    change_std = math.sqrt(2.0) * supply_change_std  # of a product or a ratio of voltage and current
    unknowns = Unknowns(camera_offset_std, camera_lag, change_std, records.value[0].run_path)
    fit = fit_network(records.value, unknowns, error_prefix)
    fitted_frames = sum(len(record.time) for record in fit.records)
    frames_left_out = sum(frame_count(run) for run in runs) - fitted_frames
    if frames_left_out > MOST_LEFT_OUT_SHARE * fitted_frames:
        notes.append(f"left out {frames_left_out} frames at which the supply was not recorded")
    fit_uncertainty = uncertainty(fit)
    line = resistance_line(fit, error_prefix)
    for quantity, changes in (("heat", fit.heat_changes), ("resistance", line.changes)):
        refuse_changes(quantity, changes, change_std, records.value[0].run_path)
    ambients = [float(np.mean(record.ambient)) for record in fit.records if record.ambient is not None]
    widened_instruments = widened_by_offset(instruments, fit)
    instruments = widened_instruments.value
    parameters = thermal_parameters(
        fit, fit_uncertainty, line, instruments, float(np.mean(ambients)) if ambients else REFERENCE_TEMPERATURE
    )

    time_constants = slow_constants_seen(fit)
    estimates = joined(
        [
            network_results(parameters, time_constants),
            resistance_results(parameters, line, phase_to_line_ratio.value),
            residual_results(fit, fit_uncertainty),
            steadiness(fit.records),
            camera_results(fit, fit_uncertainty, camera_offset_std),
        ]
    )
    results = estimates.value
    notes += [*widened_instruments.notes, *estimates.notes]
    notes[:0] = unit_notes(
        runs,
        [estimate for estimate in results if estimate.name == "phase_resistance"],
        ["line_voltage"],
        ["line_current"],
    )
    currents = current_capability(parameters, phase_to_line_ratio.value, limit, ambient)
    if time_constants < FEWEST_TIME_CONSTANTS:
        currents = [without_value(current) if current.name in STEADY_STATE_RESULTS else current for current in currents]
    notes += remarks(parameters, fit.records, instruments)
    notes.append(
        f"currents take the hottest phase from {ambient:g} to {limit:g} degC; friction and iron loss are not in them"
    )
    return Result(
        "thermal",
        tuple(str(run.path) for run in runs),
        (*results, *currents),
        tuple(dict.fromkeys(notes)),
        plots_of(fit, line, currents),
        (Covariance(NAMES, tuple(tuple(row) for row in natural_covariance(parameters).tolist())),),
    )


def widened_by_offset(instruments: Instruments, fit: NetworkFit) -> Noted[Instruments]:
    """Return the instruments with the camera's uncertainties widened to its largest fitted offset.

    Only an offset from the ambient sensor of more than `REPORTED_STDS` standard uncertainties widens them.
    """
    offsets = [
        abs(float(fit.point[parameter_index]))
        for record_number in range(len(fit.records))
        for name in ("offset_winding", "offset_housing")
        if (parameter_index := fit.index_of(record_number, name)) is not None
    ]
    worst_offset = max(offsets, default=0.0)
    if worst_offset <= REPORTED_STDS * instruments.camera_offset:
        return Noted(instruments)
    rise = max(float(np.nanmax(record.winding) - np.nanmin(record.winding)) for record in fit.records)
    camera_gain = math.hypot(instruments.camera_gain, worst_offset / rise)
    note = (
        f"the camera is {worst_offset:.1f} K off the sensor of the air: its uncertainty is taken as that much in place"
        f" of {instruments.camera_offset:g} K, and as {camera_gain:.1%} of the rise"
    )
    return Noted(replace(instruments, camera_offset=worst_offset, camera_gain=camera_gain), (note,))


def refuse_options(options: Mapping[str, float | None]) -> None:
    """Raise InputError if an option is not finite, or an uncertainty is below zero."""
    for name, value in options.items():
        if value is not None and not math.isfinite(value):
            raise InputError(f"{name}: {value} is no number")
        if value is not None and name.endswith(("_offset", "_gain", "_change")) and value < 0.0:
            raise InputError(f"{name}_std: {value:g} is below zero; a standard uncertainty was expected")


def refuse_changes(quantity: str, changes: Mapping[str, float], std: float, first_run: str) -> None:
    """Raise InputError if a change from the first run to another exceeds `MOST_CHANGE_STDS`.

    Parameters
    ----------
    quantity : what voltage and current of the supply determine.
    changes : of the quantity, relative, by the path of the run.
    std : standard deviation of such a change.
    """
    for path, change in changes.items():
        if abs(change) > MOST_CHANGE_STDS * std:
            raise InputError(
                f"{path}: the {quantity} by the supply's readings is {change:+.2%} off that of {first_run}, at most"
                f" {MOST_CHANGE_STDS * std:.2%} was expected: another supply, or another wire to the winding"
            )


def phase_share(model: Mapping[str, Any]) -> Noted[float]:
    """Return the resistance of a phase over that between two leads, by the winding that a model states."""
    winding = model.get("winding")
    if winding not in FRAMES:
        return Noted(FRAMES["wye"].resistance, ("no model states the winding; taken as a wye",))
    if winding == "delta":
        note = (
            "the winding is a delta: all its phases are heated, 2/3 of the heat in one; active windings are those of"
            " that phase, and a mean weighted 2/3 to 1/3 is too hot"
        )
        return Noted(FRAMES["delta"].resistance, (note,))
    return Noted(FRAMES[winding].resistance)
