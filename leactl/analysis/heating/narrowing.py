"""Tolerances of a motor file narrowed to one actuator by its own heated runs.

The gain errors of camera and supply need not be known. A camera that reads low by a share scales all fitted rises by
that share; `temperature_rise` covers this error, so that the guard stops earlier. A supply's error cancels as long as
the same supply is used: the file holds for its readings in the first run, `line_current` covers the change of its
reading from that run to another, and `current`, the tolerance of any other meter, covers the error of this supply too.
All other tolerances are the error of the fit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Result
from leactl.analysis.experiments.thermal import analyze
from leactl.analysis.heating.resistance import REFERENCE_TEMPERATURE
from leactl.errors import AcceptanceFailed, InputError, NotIdentifiable
from leactl.model.motor import Motor
from leactl.model.motor_schema import Thermal, Tolerances
from leactl.runfile.read.reader import Run

TOLERANCE_STDS = 3.0  # standard deviations of a fit that its tolerance covers
FINEST_TOLERANCE = 0.001  # tolerances are rounded up to multiples of it
SIGNIFICANT_DIGITS = 6  # of a value in the motor file
NETWORK_PARAMETERS = tuple(Thermal.model_fields)
WINDING_PARAMETERS = ("phase_resistance", "resistance_coefficient")


@dataclass(frozen=True)
class Accuracy:
    """Largest errors of the instruments of heated runs."""

    camera_gain: float = 0.02  # of the measured rise; thermal cameras are sold with +-2 K or +-2 %
    camera_offset: float = 2.0  # K, of the camera's zero, and its drift from cold to hot
    current_repeats: float = 0.005  # of the supply's readings, their change from one run to the next


def narrow_tolerances(motor: Motor, runs: Sequence[Run], accuracy: Accuracy) -> Motor:
    """Return the motor file with the fitted parameters of the heated actuator and the tolerances of the fit.

    Parameters
    ----------
    motor : the motor file to narrow; its tolerances must include the actuator.
    runs : heated runs of one actuator, as `leactl.analysis.experiments.thermal` takes them.

    Raises
    ------
    NotIdentifiable : the runs do not determine every parameter of network and resistance.
    AcceptanceFailed : the actuator is outside of the motor file's tolerances.
    InputError : the motor file has no tolerances, its winding is no wye, or the runs cannot be used.
    """
    if motor.tolerances is None:
        raise InputError(f"motor '{motor.name}': no `tolerances:` to narrow")
    if motor.winding != "wye":
        raise InputError(
            f"motor '{motor.name}': a {motor.winding}; how two leads heat it is not modelled, a wye was expected"
        )
    result = analyze(
        runs,
        camera_offset_std=0.5 * accuracy.camera_offset,
        camera_gain_std=0.0,
        voltage_gain_std=0.0,
        current_gain_std=0.0,
        supply_change_std=0.5 * accuracy.current_repeats,
    )
    values = {estimate.name: estimate.value for estimate in result.results}
    if missing := [name for name in (*NETWORK_PARAMETERS, *WINDING_PARAMETERS) if not math.isfinite(values[name])]:
        raise NotIdentifiable(
            f"{result.runs[-1]}: shows no {', '.join(missing)}; heat and cool for longer: {'; '.join(result.notes)}"
        )
    _refuse_outside(motor, motor.tolerances, values, accuracy)
    supply_tolerance = (
        motor.tolerances.current if motor.tolerances.line_current is None else motor.tolerances.line_current
    )
    tolerances = motor.tolerances.model_copy(
        update=_tolerances(result, values, accuracy)
        | {
            "line_current": accuracy.current_repeats,
            # worst case: the other meter reads low and the supply of the runs read high
            "current": _rounded_up((1.0 + motor.tolerances.current) / (1.0 - supply_tolerance) - 1.0),
            "temperature_rise": _rounded_up(_camera_error(accuracy, runs) + _misfit(values, runs)),
        }
    )
    return motor.model_copy(
        update={name: _to_significant_digits(values[name]) for name in WINDING_PARAMETERS}
        | {
            "reference_temperature": REFERENCE_TEMPERATURE,
            "thermal": Thermal(**{name: _to_significant_digits(values[name]) for name in NETWORK_PARAMETERS}),
            "tolerances": tolerances,
        }
    )


def _tolerances(result: Result, values: dict[str, float], accuracy: Accuracy) -> dict[str, float]:
    """Return tolerances of network and resistance, from a fit with half of `camera_offset` as standard uncertainty.

    An offset of the camera shifts the temperature at which the resistance has its value, and does not change its slope
    in ohm/K. So the tolerance of the resistance takes the whole offset in place of its standard uncertainty, and the
    tolerance of the coefficient leaves the offset out.
    """
    names, covariance = result.covariances[0].names, np.array(result.covariances[0].values)
    relative_std = {name: math.sqrt(covariance[index, index]) / values[name] for index, name in enumerate(names)}
    resistance_offset = values["resistance_coefficient"] * accuracy.camera_offset  # relative
    offset_std = 0.5 * resistance_offset

    def without_offset(name: str) -> float:
        return TOLERANCE_STDS * math.sqrt(max(relative_std[name] ** 2 - offset_std**2, 0.0))

    return {name: _rounded_up(TOLERANCE_STDS * relative_std[name]) for name in NETWORK_PARAMETERS} | {
        # the relative tolerance of two phases in series is that of one phase
        "phase_resistance": _rounded_up(without_offset("line_resistance") + resistance_offset),
        "resistance_coefficient": _rounded_up(without_offset("resistance_coefficient")),
    }


def _camera_error(accuracy: Accuracy, runs: Sequence[Run]) -> float:
    """Return the relative error of a rise by the camera: data sheets state kelvins or a share, whichever is larger."""
    return max(accuracy.camera_gain, accuracy.camera_offset / _rise(runs))


def _misfit(values: dict[str, float], runs: Sequence[Run]) -> float:
    """Return the misfit of the network beyond noise, times `TOLERANCE_STDS`, as a share of the largest rise.

    If the noise is not known, all residuals count as misfit.
    """
    over_noise = values["rmse_over_noise"]
    misfit = 1.0 if not math.isfinite(over_noise) else math.sqrt(max(1.0 - 1.0 / over_noise**2, 0.0))
    return TOLERANCE_STDS * misfit * values["rmse"] / _rise(runs)


def _rise(runs: Sequence[Run]) -> float:
    """Return the largest rise [K] of any winding temperature within a run."""
    readings = [channel.values for run in runs for channel in run.channels("winding_temperature")]
    return max(float(np.nanmax(reading) - np.nanmin(reading)) for reading in readings)


def _refuse_outside(motor: Motor, tolerances: Tolerances, values: dict[str, float], accuracy: Accuracy) -> None:
    """Raise AcceptanceFailed if a fitted value is outside of the tolerances, widened by the instruments' errors."""
    nominal = motor.thermal.model_dump() | {
        "phase_resistance": motor.resistance(REFERENCE_TEMPERATURE),
        "resistance_coefficient": motor.resistance_coefficient
        * motor.phase_resistance
        / motor.resistance(REFERENCE_TEMPERATURE),
    }
    current_tolerance = max(tolerances.current, tolerances.line_current or 0.0)
    faults = []
    for name in (*NETWORK_PARAMETERS, *WINDING_PARAMETERS):
        # the heat is current times voltage, and the voltage may have as large an error as the current
        tolerance = getattr(tolerances, name) + accuracy.camera_gain + 2.0 * current_tolerance
        low, high = (nominal[name] * (1.0 + sign * tolerance) for sign in (-1.0, 1.0))
        if not low <= values[name] <= high:
            faults.append(f"{name} {values[name]:.4g}, {low:.4g} to {high:.4g} was expected")
    if faults:
        raise AcceptanceFailed(
            f"motor '{motor.name}': the fitted values are outside of its tolerances: another actuator or mounting was"
            f" heated, or a reading is wrong: {'; '.join(faults)}"
        )


def _to_significant_digits(value: float) -> float:
    """Return a value rounded to `SIGNIFICANT_DIGITS`."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")


def _rounded_up(tolerance: float) -> float:
    """Return a tolerance rounded up to a multiple of `FINEST_TOLERANCE`, at least one multiple."""
    return max(FINEST_TOLERANCE, round(math.ceil(tolerance / FINEST_TOLERANCE) * FINEST_TOLERANCE, 6))
