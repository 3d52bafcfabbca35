"""The thermal network and the resistance of an actuator from its runs, and the tolerances that they leave.

A run with the winding's and the housing's temperature and the heat (line current, or q-axis current) tells the network;
the joint covariance is that of the regression over all runs, priors included.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.gap.diagnosis import CalibratedParameter
from leactl.gap.evidence import PRIORS, Evidence
from leactl.gap.parameters import calibrated
from leactl.gap.record import read_record
from leactl.model.motor import Motor
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
FITTED = (
    "phase_resistance",
    "resistance_coefficient",
    "thermal.winding_ambient_resistance",
    "thermal.winding_housing_resistance",
    "thermal.housing_ambient_resistance",
    "thermal.winding_capacitance",
    "thermal.housing_capacitance",
)
DEVIATIONS = 3.0  # that a tolerance spans
LEAST_TOLERANCE = 0.01  # for what a fit does not see: gradients in the winding, the camera's own error
TOLD = 0.5  # of a prior's width, below which the runs have told something


@dataclass(frozen=True)
class ThermalFit:
    """What runs tell of an actuator's thermal network."""

    parameters: tuple[CalibratedParameter, ...]
    correlation: Array  # of the parameters, in their order
    tolerances: dict[str, float]  # as a motor file's block has them; what the runs do not tell is left out


def thermal_fit(runs: Sequence[Path], motor: Motor) -> ThermalFit:
    """Fit the network of one actuator to its runs.

    Raises
    ------
    InputError : a run that cannot be read, or none with the temperatures and the heat of a winding.
    """
    faults: list[str] = []
    records = []
    for path in runs:
        try:
            records.append(read_record(path))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults)
    model = Model.model_validate(motor.model_dump())
    evidence = Evidence(records, model, only=[])
    if not any(rows.equation == "winding" for rows in evidence.stack.rows):
        raise InputError(
            "no run has winding_temperature, housing_temperature and ambient_temperature with the heat of its winding"
            " (line_current, or q_axis_current): a thermal network needs them"
        )
    fit = evidence.settle([])
    found = {item.parameter: item for item in calibrated(evidence, fit) if item.parameter in FITTED}
    names = [name for name in FITTED if name in found]
    places = {evidence.stack.names[place]: index for index, place in enumerate(fit.columns)}
    rows = np.array([places["calibration", name] for name in names])
    covariance = fit.covariance[np.ix_(rows, rows)]
    spread = np.sqrt(np.diag(covariance))
    tolerances = {
        name.removeprefix("thermal."): _rounded(DEVIATIONS * found[name].std / found[name].fitted)
        for name in names
        if found[name].std / found[name].fitted < TOLD * PRIORS[name]
    }
    return ThermalFit(tuple(found[name] for name in names), covariance / np.outer(spread, spread), tolerances)


def _rounded(tolerance: float) -> float:
    return max(LEAST_TOLERANCE, math.ceil(tolerance * 1000.0) / 1000.0)
