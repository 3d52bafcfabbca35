"""A motor file narrowed to one actuator, by its own heated runs.

What a camera and a supply are off by need not be known for that. A camera that shows a share of every rise makes a
network whose rises are that share of the true ones; it is told as `temperature_rise`, by which the guard stops earlier.
A supply that shows a share of its current makes a network that heats as the true one does at the same reading; the
tolerance of `line_current` is then what a reading changes by from one run to the next, and any other instrument's has
the supply's to bear as well. What is left are the errors of the fit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leactl.analysis.estimate import Result
from leactl.analysis.heating.resistance import REFERENCE
from leactl.analysis.thermal import analyze
from leactl.errors import AcceptanceFailed, InputError, NotIdentifiable
from leactl.model.motor import Motor
from leactl.model.sheet import Thermal, Tolerances
from leactl.runfile.reader import Run

DEVIATIONS = 3.0  # standard errors of a fit that a tolerance spans
FINEST = 0.001  # tolerance, and what tolerances are rounded up to
FIGURES = 6  # of a value that is written
NETWORK = tuple(Thermal.model_fields)
WINDING = ("phase_resistance", "resistance_coefficient")


@dataclass(frozen=True)
class Accuracy:
    """What the instruments of heated runs may be off by, at the most."""

    camera_gain: float = 0.02  # of the rise that it shows; thermal cameras are sold with +-2 K or +-2 %
    camera_offset: float = 2.0  # K, of its zero, and of any rise beside what its zero was when cold
    current_repeats: float = 0.005  # of the supply's reading, from one run to the next


def narrowed(motor: Motor, runs: Sequence[Run], accuracy: Accuracy) -> Motor:
    """The motor file of the actuator that was heated: network and resistance as fitted, tolerances as the fit leaves.

    Parameters
    ----------
    motor : file with the tolerances that hold before, inside which the actuator has to be.
    runs : heated ones of one actuator, as `leactl.analysis.thermal` takes them.

    Raises
    ------
    NotIdentifiable : the runs do not tell all of network and resistance.
    AcceptanceFailed : the actuator is outside of the motor file's tolerances.
    InputError : a motor file without tolerances, or runs that cannot be used.
    """
    if motor.tolerances is None:
        raise InputError(f"motor '{motor.name}': no `tolerances:` to narrow")
    if motor.winding != "wye":
        raise InputError(f"motor '{motor.name}': a {motor.winding}; what two leads heat is known of a wye alone")
    found = analyze(
        runs,
        camera_offset_std=0.5 * accuracy.camera_offset,
        camera_gain_std=0.0,
        voltage_gain_std=0.0,
        current_gain_std=0.0,
    )
    values = {one.name: one.value for one in found.results}
    if untold := [name for name in (*NETWORK, *WINDING) if not math.isfinite(values[name])]:
        raise NotIdentifiable(
            f"{found.runs[-1]}: tells no {', '.join(untold)}; heat and cool for longer: {'; '.join(found.notes)}"
        )
    _refuse_another(motor, motor.tolerances, values, accuracy)
    reading = motor.tolerances.current if motor.tolerances.line_current is None else motor.tolerances.line_current
    tolerances = motor.tolerances.model_copy(
        update=_tolerances(found, values, accuracy)
        | {
            "line_current": accuracy.current_repeats,
            "current": _rounded((1.0 + motor.tolerances.current) / (1.0 - reading) - 1.0),
            "temperature_rise": _rounded(_camera(accuracy, runs) + _unexplained(values, runs)),
        }
    )
    return motor.model_copy(
        update={name: _short(values[name]) for name in WINDING}
        | {
            "reference_temperature": REFERENCE,
            "thermal": Thermal(**{name: _short(values[name]) for name in NETWORK}),
            "tolerances": tolerances,
        }
    )


def _tolerances(found: Result, values: dict[str, float], accuracy: Accuracy) -> dict[str, float]:
    """Of network and resistance; what the camera's zero does to the resistance counts in full, not by its deviation."""
    names, covariance = found.covariances[0].names, np.array(found.covariances[0].values)
    spread = {name: math.sqrt(covariance[k, k]) / values[name] for k, name in enumerate(names)}
    shifted = values["resistance_coefficient"] * accuracy.camera_offset  # of the resistance at one temperature
    by_zero = 0.5 * shifted  # as a standard uncertainty, which the covariance holds

    def by_noise(name: str) -> float:
        return DEVIATIONS * math.sqrt(max(spread[name] ** 2 - by_zero**2, 0.0))

    return {name: _rounded(DEVIATIONS * spread[name]) for name in NETWORK} | {
        "phase_resistance": _rounded(by_noise("line_resistance") + shifted),
        "resistance_coefficient": _rounded(by_noise("resistance_coefficient")),
    }


def _camera(accuracy: Accuracy, runs: Sequence[Run]) -> float:
    """Share of a rise that the camera may be off by: data sheets tell kelvins or a share, whichever is more."""
    return max(accuracy.camera_gain, accuracy.camera_offset / _rise(runs))


def _unexplained(values: dict[str, float], runs: Sequence[Run]) -> float:
    """What two bodies leave of the temperatures beyond noise, as a share of the largest rise."""
    over = values["rmse_over_noise"]
    beyond = 1.0 if not math.isfinite(over) else math.sqrt(max(1.0 - 1.0 / over**2, 0.0))
    return DEVIATIONS * beyond * values["rmse"] / _rise(runs)


def _rise(runs: Sequence[Run]) -> float:
    """The largest rise [K] that a place of the winding showed."""
    readings = [channel.values for run in runs for channel in run.channels("winding_temperature")]
    return max(float(np.nanmax(one) - np.nanmin(one)) for one in readings)


def _refuse_another(motor: Motor, tolerances: Tolerances, values: dict[str, float], accuracy: Accuracy) -> None:
    nominal = motor.thermal.model_dump() | {
        "phase_resistance": motor.resistance(REFERENCE),
        "resistance_coefficient": motor.resistance_coefficient * motor.phase_resistance / motor.resistance(REFERENCE),
    }
    reading = max(tolerances.current, tolerances.line_current or 0.0)
    faults = []
    for name in (*NETWORK, *WINDING):
        within = getattr(tolerances, name) + accuracy.camera_gain + 2.0 * reading
        low, high = (nominal[name] * (1.0 + sign * within) for sign in (-1.0, 1.0))
        if not low <= values[name] <= high:
            faults.append(f"{name} {values[name]:.4g}, {low:.4g} to {high:.4g} was expected")
    if faults:
        raise AcceptanceFailed(
            f"motor '{motor.name}': not the actuator that was heated, or not as it was measured: {'; '.join(faults)}"
        )


def _short(value: float) -> float:
    return float(f"{value:.{FIGURES}g}")


def _rounded(tolerance: float) -> float:
    return max(FINEST, round(math.ceil(tolerance / FINEST) * FINEST, 6))
