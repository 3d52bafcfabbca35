"""Fit an actuator's thermal network and winding resistance to its runs, with the tolerance of each value.

A run with the winding's and the housing's temperature and the heat (line current, or q-axis current) determines the
network; the joint covariance is that of the regression over all runs, priors included.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.gap.diagnosis import CalibratedParameter
from leactl.gap.search.effect_regression import PRIORS, Evidence
from leactl.gap.search.parameters import calibrated_parameters
from leactl.gap.signals.record import AMBIENT, Record, record_of
from leactl.model.motor import Motor
from leactl.model.nominal import Model
from leactl.runfile.read.reader import Run

Array = npt.NDArray[np.float64]
FITTED_PARAMETERS = (
    "phase_resistance",
    "resistance_coefficient",
    "thermal.winding_ambient_resistance",
    "thermal.winding_housing_resistance",
    "thermal.housing_ambient_resistance",
    "thermal.winding_capacitance",
    "thermal.housing_capacitance",
)
TOLERANCE_STDS = 3.0  # standard deviations that a tolerance spans
LEAST_TOLERANCE = 0.01  # relative tolerance, for errors that a fit does not see, such as gradients in the winding
CAMERA_GAIN_ERROR = 0.02  # share of a rise; thermal cameras are sold with +-2 K or +-2 %
MOST_INFORMED_RATIO = 0.5  # standard error over the prior's, below which the runs determine a parameter


@dataclass(frozen=True)
class ThermalFit:
    """Thermal network of an actuator, fitted to runs."""

    parameters: tuple[CalibratedParameter, ...]
    correlation: Array  # correlation matrix of the parameters, in their order
    tolerances: dict[str, float]  # relative, by key of a motor file, of the parameters that the runs determine
    notes: tuple[str, ...] = ()  # made while the runs were read


def missing_channels(run: Run) -> list[str]:
    """Return the quantities that a run lacks for the fit of a thermal network; empty if it has all."""
    has_ambient = run.has(AMBIENT, "bench") or run.has(AMBIENT)
    missing = [] if run.has("winding_temperature") else ["winding_temperature"]
    missing += [] if run.has("housing_temperature") else ["housing_temperature"]
    missing += [] if has_ambient else [AMBIENT]
    has_line_power = run.has("line_current") and run.has("line_voltage")
    if not has_line_power and (run.has("line_current") or not run.has("q_axis_current")):
        missing.append("the heat of the winding: line_current with line_voltage, or q_axis_current")
    return missing


def thermal_fit(runs: Sequence[Run], motor: Motor) -> ThermalFit:
    """Return the fit of an actuator's thermal network to its open runs.

    Raises
    ------
    InputError : the motor has no thermal network, a run lacks a quantity, a channel cannot be used, or temperatures and
        heat have too few samples at the same time.
    """
    faults: list[str] = []
    records: list[Record] = []
    for run in runs:
        if missing := missing_channels(run):
            faults.append(f"{run.path}: has no {', no '.join(missing)}; a thermal network needs it")
            continue
        try:
            records.append(record_of(run))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    model = Model.model_validate(motor.model_dump())
    if model.thermal is None:
        raise InputError(f"motor '{motor.name}' has no thermal network to start from; give it a block thermal")
    evidence = Evidence(records, model, only=[])
    notes = list(dict.fromkeys(note for record in records for note in record.notes))
    if not any(rows.equation == "winding" for rows in evidence.stack.rows):
        files = ", ".join(record.path.name for record in records)
        reason = "; ".join(notes) or "they were seldom read at the same time"
        raise InputError(f"{files}: temperatures and heat never come together for long enough: {reason}")
    fit = evidence.settle([])
    fitted = {
        item.parameter: item for item in calibrated_parameters(evidence, fit) if item.parameter in FITTED_PARAMETERS
    }
    names = [name for name in FITTED_PARAMETERS if name in fitted]
    position_in_fit = {evidence.stack.names[column]: index for index, column in enumerate(fit.columns)}
    positions = np.array([position_in_fit["calibration", name] for name in names])
    covariance = fit.covariance[np.ix_(positions, positions)]
    stds = np.sqrt(np.diag(covariance))
    tolerances = {
        name.removeprefix("thermal."): _rounded(TOLERANCE_STDS * fitted[name].std / fitted[name].fitted)
        for name in names
        if fitted[name].std / fitted[name].fitted < MOST_INFORMED_RATIO * PRIORS[name]
    }
    tolerances["temperature_rise"] = CAMERA_GAIN_ERROR
    correlation = covariance / np.outer(stds, stds)
    return ThermalFit(tuple(fitted[name] for name in names), correlation, tolerances, tuple(notes))


def _rounded(tolerance: float) -> float:
    """Return a tolerance rounded up to a tenth of a percent, at least `LEAST_TOLERANCE`."""
    return max(LEAST_TOLERANCE, math.ceil(tolerance * 1000.0) / 1000.0)
