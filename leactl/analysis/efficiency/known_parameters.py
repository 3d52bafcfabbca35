"""Parameters of actuators and instruments for the power balance: from the runs' model, or given by the caller."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.efficiency.operating_points import OTHER_ROLE, OperatingPoints
from leactl.analysis.efficiency.power_balance import PowerCalibration
from leactl.analysis.estimate import Noted
from leactl.analysis.run_model import model_of
from leactl.errors import InputError, NotIdentifiable
from leactl.model.winding import resistance_ratio
from leactl.runfile.read.reader import Run


@dataclass(frozen=True)
class GivenParameters:
    """Parameters of the actuators that the caller gives; each replaces that of the model."""

    phase_resistance: float | None = None  # ohm
    back_emf_constant: float | None = None  # V*s/rad
    winding_temperature: float | None = None  # degC


def calibration_of(
    runs: Sequence[Run], points: OperatingPoints, given: GivenParameters, relative_stds: Mapping[str, float | None]
) -> Noted[tuple[PowerCalibration, dict[str, float]]]:
    """Return the constants of the power balance, and the standard uncertainties of those that have one.

    Parameters
    ----------
    given : values that replace those of the runs' model.
    relative_stds : relative standard uncertainty of each constant by its name; None if the caller gave none.

    Raises
    ------
    InputError : a number is out of range, or the runs' models differ.
    NotIdentifiable : no voltage was measured, and resistance or back-EMF constant is not known.
    """
    stds = {name: std or 0.0 for name, std in relative_stds.items()}
    for name, std in stds.items():
        if not (math.isfinite(std) and std >= 0.0):
            raise InputError(f"{name}_std {std:g}: a relative standard uncertainty of zero or more was expected")
    if relative_stds["torque_gain"] is None:
        stds["torque_gain"] = max(run.channel("torque", role="test").scale_std for run in runs)
    back_emf_constant = _given_or_modelled(runs, "back_emf_constant", given.back_emf_constant)
    resistance = _given_or_modelled(runs, "phase_resistance", given.phase_resistance)
    is_voltage_measured = all(
        ("q_axis_voltage", role) in points.value for role in OTHER_ROLE if ("q_axis_current", role) in points.value
    )
    if is_voltage_measured and given.winding_temperature is None:
        notes = []
        if math.isnan(back_emf_constant):
            notes.append("no back-EMF constant is known: losses are not parted into copper and friction")
        notes.append("electrical power is measured voltage times current, at the temperature that the winding had")
        return Noted(
            (PowerCalibration(resistance, back_emf_constant, True), _absolute(stds, resistance, back_emf_constant)),
            tuple(notes),
        )
    if math.isnan(resistance) or math.isnan(back_emf_constant):
        raise NotIdentifiable(
            f"{runs[0].path}: no q-axis voltage was measured, and the run's model lacks phase_resistance or"
            " back_emf_constant; give --set phase_resistance= and --set back_emf_constant="
        )
    reference_temperature = _given_or_modelled(runs, "reference_temperature", None)
    temperature, coefficient = given.winding_temperature, _given_or_modelled(runs, "resistance_coefficient", None)
    warm_resistance = resistance
    if temperature is not None:
        if not (math.isfinite(coefficient) and math.isfinite(reference_temperature) and -50.0 <= temperature <= 400.0):
            raise InputError(
                f"winding_temperature {temperature:g} degC: -50 to 400 degC and a model with resistance_coefficient and"
                " reference_temperature were expected"
            )
        warm_resistance = resistance * resistance_ratio(temperature, coefficient, reference_temperature)
    elif math.isfinite(reference_temperature):
        temperature = reference_temperature
    at_temperature = f" at {temperature:g} degC" if temperature is not None else ""
    note = (
        f"no measured voltage: electrical power is that of windings of {warm_resistance:.4g} ohm{at_temperature} and a"
        f" back-EMF constant of {back_emf_constant:g} V*s/rad, as the paper has it; warmer ones take more"
        " (--set winding_temperature=)"
    )
    return Noted(
        (
            PowerCalibration(warm_resistance, back_emf_constant, False),
            _absolute(stds, warm_resistance, back_emf_constant),
        ),
        (note,),
    )


def sources_of(stds: Mapping[str, float]) -> str:
    """Return a note that names the uncertainties that the intervals include."""
    included = [name.replace("_", " ") for name, std in stds.items() if std > 0.0]
    if included:
        return (
            "the intervals include scatter, the torque sensor's zero and the given uncertainty of"
            f" {', '.join(included)}"
        )
    return (
        "the intervals include scatter and the torque sensor's zero; they include errors of resistance, constants and"
        " calibrations if their uncertainties are given (--set resistance_std=,"
        " back_emf_constant_std=, torque_gain_std=, current_gain_std=, voltage_gain_std=)"
    )


def _absolute(stds: dict[str, float], resistance: float, back_emf_constant: float) -> dict[str, float]:
    """Return absolute standard uncertainties from relative ones, without zeros; the nominal value of a gain is one."""
    nominal_values = {"resistance": resistance, "back_emf_constant": back_emf_constant}
    return {name: std * nominal_values.get(name, 1.0) for name, std in stds.items() if std > 0.0}


def _given_or_modelled(runs: Sequence[Run], name: str, given_value: float | None) -> float:
    """Return the given value of a parameter, else that of the runs' models; NaN if neither has it.

    Raises
    ------
    InputError : the given value is not positive, or the models of the runs differ.
    """
    if given_value is not None:
        if not (math.isfinite(given_value) and given_value > 0.0):
            raise InputError(f"{name} {given_value:g}: a positive number was expected")
        return given_value
    values = [model_of(run).get(name) for run in runs]
    numbers = {
        float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan for value in values
    }
    if len(numbers) > 1 and not all(np.isnan(list(numbers))):
        raise InputError(
            f"{runs[0].path}: the runs' models differ in {name} ({', '.join(map(str, values))}); tell which"
        )
    return numbers.pop()
