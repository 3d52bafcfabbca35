"""Turn fitted coefficients into parameters of a model and of effects, with their uncertainties."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.diagnosis import ZERO_ANGLE, CalibratedParameter, EffectParameter
from leactl.gap.search.effect_regression import PRIORS, Evidence
from leactl.gap.search.regression import Candidate, Fit, disagreement
from leactl.gap.search.stamp_fit import STAMP_DELAY_STD
from leactl.model.nominal import LARGEST_AMBIENT_OFFSET, EffectEntry, Model, as_mapping
from leactl.vocabulary.effect import effect_definition

Array = npt.NDArray[np.float64]
RECIPROCAL_PARAMETERS = (
    "thermal.winding_ambient_resistance",
    "thermal.winding_housing_resistance",
    "thermal.housing_ambient_resistance",
    "bench.shaft_stiffness",
)
"""Parameters in whose reciprocal the equations are linear."""
MODEL_ERROR = {
    "phase_resistance": 6e-5,
    "phase_inductance": 7e-3,
    "resistance_coefficient": 6e-4,
    "rotor_inertia": 1.1e-3,
    "bench.shaft_stiffness": 1.4e-2,
    "thermal.winding_ambient_resistance": 2.8e-3,
    "thermal.winding_housing_resistance": 8e-4,
    "thermal.housing_ambient_resistance": 9e-4,
    "thermal.winding_capacitance": 3.6e-3,
    "thermal.housing_capacitance": 8e-4,
}
"""Relative error of a parameter from the discretised equations, in addition to noise."""
LEAST_FITTED_RATIO = 0.05  # ratio of fitted to nominal value; its reciprocal is the largest of a reciprocal parameter
LEAST_MODEL_ERROR = 5e-5  # relative error of a parameter that `MODEL_ERROR` does not name
UNSHOWN_STEP = 0.01  # step of the derivative along a change that no run shows: its variance gives no step
UNITS = {
    "phase_resistance": "ohm",
    "phase_inductance": "H",
    "torque_constant": "N*m/A",
    "back_emf_constant": "V*s/rad",
    "rotor_inertia": "kg*m^2",
    "viscous_damping": "N*m*s/rad",
    "coulomb_friction": "N*m",
    "resistance_coefficient": "1/K",
    "bench.shaft_stiffness": "N*m/rad",
    "load.viscous_damping": "N*m*s/rad",
    "load.coulomb_friction": "N*m",
    "feedforward.kS": "V",
    "feedforward.kV": "V*s/rad",
    "feedforward.kA": "V*s^2/rad",
    "ambient_offset": "K",
    "thermal.winding_ambient_resistance": "K/W",
    "thermal.winding_housing_resistance": "K/W",
    "thermal.housing_ambient_resistance": "K/W",
    "thermal.winding_capacitance": "J/K",
    "thermal.housing_capacitance": "J/K",
}
"""Units of the nominal model's parameters."""


def calibrated_parameters(evidence: Evidence, fit: Fit) -> tuple[CalibratedParameter, ...]:
    """Return the calibrated parameters of the nominal model under a fit; one that no run determines stays nominal."""
    parameters = []
    normal = evidence.normal()
    for index, column in enumerate(fit.columns):
        name = evidence.stack.names[column]
        if name[0] != "calibration":
            continue
        parameter, change = name[1], float(fit.values[index])
        if evidence.tells_nothing_of(parameter):
            parameters += kept_as_nominal(evidence.model, parameter)
            continue
        std = math.sqrt(max(float(fit.covariance[index, index]), 0.0)) * disagreement(normal, fit, index)
        bias = 0.0
        if evidence.null is not None:  # smoothing the acceleration biases every inertia low
            bias, std = evidence.null.bias(parameter), math.hypot(std, evidence.null.doubt(parameter))
        nominal = nominal_value(evidence.model, parameter)
        if nominal is None:
            continue
        if parameter == "ambient_offset":
            offset = float(np.clip(nominal + change - bias, -LARGEST_AMBIENT_OFFSET, LARGEST_AMBIENT_OFFSET))
            parameters.append(CalibratedParameter(parameter, nominal, offset, std, UNITS[parameter]))
            continue
        std = math.hypot(std, MODEL_ERROR.get(parameter, LEAST_MODEL_ERROR))
        fitted_factor, bias_factor = factor_of(parameter, change), factor_of(parameter, bias)
        factor, slope = (
            fitted_factor / bias_factor,
            (fitted_factor**2 if parameter in RECIPROCAL_PARAMETERS else 1.0) / bias_factor,
        )
        units = UNITS.get(parameter, "")
        parameters.append(CalibratedParameter(parameter, nominal, nominal * factor, nominal * std * slope, units))
        if parameter == "torque_constant" and evidence.model.back_emf_constant is not None:
            nominal_emf_constant = evidence.model.back_emf_constant
            emf_parameter = "back_emf_constant"
            parameters.append(
                CalibratedParameter(
                    emf_parameter,
                    nominal_emf_constant,
                    nominal_emf_constant * factor,
                    nominal_emf_constant * std,
                    UNITS[emf_parameter],
                )
            )
    return tuple(parameters)


def factor_of(parameter: str, change: float) -> float:
    """Return the factor on a parameter for a fitted change, by which the reciprocal of a reciprocal parameter falls."""
    return (
        1.0 / max(1.0 - change, LEAST_FITTED_RATIO)
        if parameter in RECIPROCAL_PARAMETERS
        else max(1.0 + change, LEAST_FITTED_RATIO)
    )


def kept_as_nominal(model: Model, parameter: str) -> list[CalibratedParameter]:
    """Return an undetermined parameter at its nominal value, with its prior as error.

    The back-EMF constant comes with the torque constant.
    """
    names = [parameter, *(["back_emf_constant"] if parameter == "torque_constant" else [])]
    values = [(name, nominal_value(model, name)) for name in names]
    return [
        CalibratedParameter(name, value, value, PRIORS[parameter] * abs(value), UNITS.get(name, ""), True)
        for name, value in values
        if value is not None and parameter != "ambient_offset"
    ]


def is_at_bound(item: CalibratedParameter) -> bool:
    """Return whether a fit ended at the bound of a parameter: the data ask for a larger change than is allowed.

    A feedforward is a fit itself, and its kS and kA may contain all that it leaves out: they have no bound.
    """
    if item.parameter == "ambient_offset":
        return abs(item.fitted) >= LARGEST_AMBIENT_OFFSET
    if item.parameter in ("feedforward.kS", "feedforward.kA") or not item.nominal:
        return False
    factor = item.fitted / item.nominal
    return not LEAST_FITTED_RATIO * (1.0 + 1e-9) < factor < (1.0 - 1e-9) / LEAST_FITTED_RATIO


def nominal_value(model: Model, parameter: str) -> float | None:
    """Return a parameter of the model by its dotted name; the load's default to the test actuator's."""
    if parameter.startswith("load.") and getattr(model.load, parameter.removeprefix("load."), None) is None:
        parameter = parameter.removeprefix("load.")
    value: Any = model
    for attribute in parameter.split("."):
        value = getattr(value, attribute, None)
        if value is None:
            return None
    return float(value)


def with_calibration(model: Model, parameters: Sequence[CalibratedParameter]) -> Model:
    """Return the model with fitted parameters."""
    document = as_mapping(model)
    for parameter in parameters:
        section = document
        *path, last_key = parameter.parameter.split(".")
        for key in path:
            section = section.setdefault(key, {})
        section[last_key] = parameter.fitted
        if parameter.parameter == ZERO_ANGLE:
            section["type"] = "arm"  # a pendulum has no such angle
    return Model.model_validate(document)


def with_effects(model: Model, effects: Sequence[tuple[str, Mapping[str, float]]]) -> Model:
    """Return the model with effects added to those it has."""
    added = [EffectEntry(effect=name, parameters=dict(values)) for name, values in effects]
    return model.model_copy(update={"effects": [*model.effects, *added]})


def fitted_over_nominal(evidence: Evidence, fit: Fit, candidate: Candidate) -> float:
    """Return the ratio of fitted to nominal value of the parameters that an effect is a share of, such as friction.

    Only rows that show the effect count. Each of several parameters is weighted by the product of its column with the
    sum of all their columns.
    """
    stack, parameters = evidence.stack, library()[candidate[0]].relative_to
    effect_columns = evidence.columns(candidate)
    changes = {column: float(value) for column, value in zip(fit.columns.tolist(), fit.values, strict=True)}
    base_columns = [stack.position_of[name] for p in parameters if (name := ("calibration", p)) in stack.position_of]
    nominal = fitted = 0.0
    for gram, local, weight in zip(stack.grams, stack.local, evidence.weights, strict=True):
        local_base_columns = [column for column in base_columns if column in local]
        if not local_base_columns or not np.isin(effect_columns, local).any():
            continue
        positions = [1 + int(np.flatnonzero(local == column)[0]) for column in local_base_columns]
        power = weight * gram[np.ix_(positions, positions)].sum(axis=1)
        nominal += float(power.sum())
        fitted += float(power @ [1.0 + changes.get(column, 0.0) for column in local_base_columns])
    return fitted / nominal if nominal > 0.0 and fitted > 0.0 else 1.0


def next_linearisation(evidence: Evidence, fit: Fit, candidate: Candidate) -> Candidate:
    """Return a fitted effect in the form about which its columns are linearised next."""
    name, form = candidate
    value_of_column = dict(zip(fit.columns.tolist(), fit.values.tolist(), strict=True))
    coefficients = {evidence.coefficient(column): value_of_column[column] for column in evidence.columns(candidate)}
    return name, library()[name].about(form, coefficients)


def effect_parameters(evidence: Evidence, fit: Fit, candidate: Candidate) -> tuple[EffectParameter, ...]:
    """Return the parameters of one effect of a fitted hypothesis, with standard errors by linear propagation.

    Shares of a model parameter refer to its fitted value, since a model file holds both. The error of a size includes
    the floor from sound machines in addition to noise. Errors of coefficients and of non-linear parameters, such as a
    frequency, are taken as independent; a disagreement of runs beyond their noise widens both.
    """
    name, form = candidate
    positions = [int(np.flatnonzero(fit.columns == column)[0]) for column in evidence.columns(candidate)]
    names = [evidence.coefficient(column) for column in evidence.columns(candidate)]
    normal = evidence.normal()
    widening = max((disagreement(normal, fit, position) for position in positions), default=1.0) ** 2
    values, covariance = fit.values[positions], widening * fit.covariance[np.ix_(positions, positions)]
    effect, model = library()[name], evidence.model
    size_in_fit = effect.size(form, dict(zip(names, values.tolist(), strict=True)), model)
    if size_in_fit > 0.0:
        covariance = covariance + (evidence.floor(candidate) / size_in_fit) ** 2 * np.outer(values, values)
    fitted_ratio = fitted_over_nominal(evidence, fit, candidate)
    values, covariance = values / fitted_ratio, covariance / fitted_ratio**2

    def with_form(numbers: Sequence[float], coefficients: Array) -> dict[str, float]:
        """Return the parameters for the numbers of a form and its coefficients."""
        return effect.parameters(tuple(numbers), dict(zip(names, coefficients.tolist(), strict=True)), model)

    def with_logs(logs: Array) -> dict[str, float]:
        """Return the parameters with the first numbers of the form scaled by the exponentials of logarithms."""
        return with_form([*(form[: len(logs)] * np.exp(logs)), *form[len(logs) :]], values)

    parameters, units = with_form(form, values), effect_definition(name).parameters
    variances = propagated_variances(parameters, lambda change: with_form(form, values + change), covariance)
    covariance_of_logs = evidence.form_spread.get(candidate)
    if covariance_of_logs is not None:
        form_covariance = widening * covariance_of_logs
        # a standard error of this size, a factor of 20, means that no run shows the number
        undetermined = np.diag(form_covariance) > math.log(LEAST_FITTED_RATIO) ** 2
        form_covariance[undetermined, undetermined] = math.inf
        form_variances = propagated_variances(parameters, with_logs, form_covariance)
        variances = {key: variances[key] + form_variances[key] for key in parameters}
    stamp_error = stamp_delay_std(evidence, candidate)
    return tuple(
        EffectParameter(
            key,
            value,
            math.hypot(math.sqrt(variances[key]), stamp_error if units[key].units == "s" else 0.0),
            model.units_of(units[key].units),
        )
        for key, value in parameters.items()
    )


def propagated_variances(
    parameters: Mapping[str, float], parameters_after: Callable[[Array], dict[str, float]], covariance: Array
) -> dict[str, float]:
    """Return the variance of each parameter to first order; infinite if it depends on a change that no run shows.

    It is also infinite if a change makes the parameter itself infinite.

    parameters_after : returns the parameters after a change.
    covariance : covariance of the changes.
    """
    steps = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    is_finite = np.isfinite(covariance).all(axis=1)
    slopes = {key: np.zeros(len(covariance)) for key in parameters}
    for k, step in enumerate(np.where(is_finite, steps, UNSHOWN_STEP)):
        if step > 0.0:
            changed = parameters_after(step * np.eye(len(covariance))[k])
            for key in parameters:
                slopes[key][k] = (changed[key] - parameters[key]) / step
    finite_covariance = covariance[np.ix_(is_finite, is_finite)]
    return {
        key: math.inf
        if slope[~is_finite].any() or not np.isfinite(slope).all()
        else max(float(slope[is_finite] @ finite_covariance @ slope[is_finite]), 0.0)
        for key, slope in slopes.items()
    }


def stamp_delay_std(evidence: Evidence, candidate: Candidate) -> float:
    """Return the standard deviation [s] that stamps of unknown meaning add to an effect's delay.

    It is zero unless the effect acts in an overdue equation: only a delay beyond what stamps explain is named.
    """
    effect, form = candidate
    errors = [
        STAMP_DELAY_STD * rows.signals.interval
        for rows in evidence.stack.rows
        if rows.equation in evidence.on_time and any(name[1:3] == (effect, repr(form)) for name in rows.columns)
    ]
    return max(errors, default=0.0)
