"""Fitted coefficients as parameters of a model: what calibration makes of the nominal model, and its uncertainty."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.effects import library
from leactl.gap.diagnosis import CalibratedParameter, EffectParameter
from leactl.gap.search.evidence import PRIORS, Evidence
from leactl.gap.search.regression import Candidate, Fit, disagreement
from leactl.gap.search.stamp_fit import LATE_STD
from leactl.model.nominal import MOST_OFFSET, EffectEntry, Model, as_mapping
from leactl.vocabulary.effect import effect_definition

Array = npt.NDArray[np.float64]
RECIPROCAL = (
    "thermal.winding_ambient_resistance",
    "thermal.winding_housing_resistance",
    "thermal.housing_ambient_resistance",
    "bench.shaft_stiffness",
)
"""Parameters whose reciprocal is what the equations are linear in."""
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
"""Relative error of a parameter that the discretised equations leave, beside noise."""
SMALLEST = 0.05  # of a parameter's nominal value, or one over that of a reciprocal: no fit goes beyond
LEAST_MODEL_ERROR = 5e-5
UNSHOWN = 0.01  # change by which a parameter is tried of which no run shows how far it may change
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


def calibrated(evidence: Evidence, fit: Fit) -> tuple[CalibratedParameter, ...]:
    """The nominal model's parameters as a fit has them."""
    parameters = []
    normal = evidence.normal()
    for index, place in enumerate(fit.columns):
        name = evidence.stack.names[place]
        if name[0] != "calibration":
            continue
        parameter, change = name[1], float(fit.values[index])
        if evidence.tells_nothing_of(parameter):
            parameters += kept_as_nominal(evidence.model, parameter)
            continue
        std = math.sqrt(max(float(fit.covariance[index, index]), 0.0)) * disagreement(normal, fit, index)
        bias = 0.0
        if evidence.null is not None:  # acceleration that is smoothed against noise makes every inertia smaller
            bias, std = evidence.null.bias(parameter), math.hypot(std, evidence.null.doubt(parameter))
        nominal = nominal_value(evidence.model, parameter)
        if nominal is None:
            continue
        if parameter == "ambient_offset":
            offset = float(np.clip(nominal + change - bias, -MOST_OFFSET, MOST_OFFSET))
            parameters.append(CalibratedParameter(parameter, nominal, offset, std, UNITS[parameter]))
            continue
        std = math.hypot(std, MODEL_ERROR.get(parameter, LEAST_MODEL_ERROR))
        fitted, off = factor_of(parameter, change), factor_of(parameter, bias)
        factor, slope = fitted / off, (fitted**2 if parameter in RECIPROCAL else 1.0) / off
        units = UNITS.get(parameter, "")
        parameters.append(CalibratedParameter(parameter, nominal, nominal * factor, nominal * std * slope, units))
        if parameter == "torque_constant" and evidence.model.back_emf_constant is not None:
            constant = evidence.model.back_emf_constant
            other = "back_emf_constant"
            parameters.append(CalibratedParameter(other, constant, constant * factor, constant * std, UNITS[other]))
    return tuple(parameters)


def factor_of(parameter: str, change: float) -> float:
    """What a relative change that a fit found multiplies a parameter by."""
    return 1.0 / max(1.0 - change, SMALLEST) if parameter in RECIPROCAL else max(1.0 + change, SMALLEST)


def kept_as_nominal(model: Model, parameter: str) -> list[CalibratedParameter]:
    """A parameter that no run tells, as the model has it, with the error that is usual; a back-EMF constant with it."""
    names = [parameter, *(["back_emf_constant"] if parameter == "torque_constant" else [])]
    values = [(name, nominal_value(model, name)) for name in names]
    return [
        CalibratedParameter(name, value, value, PRIORS[parameter] * abs(value), UNITS.get(name, ""), True)
        for name, value in values
        if value is not None and parameter != "ambient_offset"
    ]


def at_bound(item: CalibratedParameter) -> bool:
    """Whether a fit went as far as it may: the data want more than this parameter can give.

    A feedforward is a fit itself, whose kS and kA may hold all that it left out: no share of these is a bound.
    """
    if item.parameter == "ambient_offset":
        return abs(item.fitted) >= MOST_OFFSET
    if item.parameter in ("feedforward.kS", "feedforward.kA") or not item.nominal:
        return False
    factor = item.fitted / item.nominal
    return not SMALLEST * (1.0 + 1e-9) < factor < (1.0 - 1e-9) / SMALLEST


def nominal_value(model: Model, parameter: str) -> float | None:
    """A parameter of the model by its dotted name; the load's start from the test actuator's."""
    if parameter.startswith("load.") and getattr(model.load, parameter.removeprefix("load."), None) is None:
        parameter = parameter.removeprefix("load.")
    at: Any = model
    for part in parameter.split("."):
        at = getattr(at, part, None)
        if at is None:
            return None
    return float(at)


def with_calibration(model: Model, parameters: Sequence[CalibratedParameter]) -> Model:
    """The model with fitted parameters."""
    document = as_mapping(model)
    for item in parameters:
        at = document
        *path, last = item.parameter.split(".")
        for part in path:
            at = at.setdefault(part, {})
        at[last] = item.fitted
    return Model.model_validate(document)


def with_effects(model: Model, effects: Sequence[tuple[str, Mapping[str, float]]]) -> Model:
    """The model with effects added to those it has."""
    added = [EffectEntry(effect=name, parameters=dict(values)) for name, values in effects]
    return model.model_copy(update={"effects": [*model.effects, *added]})


def fitted_over_nominal(evidence: Evidence, fit: Fit, candidate: Candidate) -> float:
    """Ratio of fitted to nominal friction, or what else an effect is a share of, in the rows that show the effect.

    Each of several parameters is weighted by the product of its column with the sum of all their columns.
    """
    stack, parameters = evidence.stack, library()[candidate[0]].relative_to
    shown = evidence.columns(candidate)
    changes = {place: float(value) for place, value in zip(fit.columns.tolist(), fit.values, strict=True)}
    bases = [stack.place[name] for p in parameters if (name := ("calibration", p)) in stack.place]
    nominal = fitted = 0.0
    for gram, local, weight in zip(stack.grams, stack.local, evidence.weights, strict=True):
        own = [place for place in bases if place in local]
        if not own or not np.isin(shown, local).any():
            continue
        at = [1 + int(np.flatnonzero(local == place)[0]) for place in own]
        power = weight * gram[np.ix_(at, at)].sum(axis=1)
        nominal += float(power.sum())
        fitted += float(power @ [1.0 + changes.get(place, 0.0) for place in own])
    return fitted / nominal if nominal > 0.0 and fitted > 0.0 else 1.0


def about(evidence: Evidence, fit: Fit, candidate: Candidate) -> Candidate:
    """An effect in the form about which its columns are made next, once it was fitted."""
    name, form = candidate
    values = dict(zip(fit.columns.tolist(), fit.values.tolist(), strict=True))
    coefficients = {evidence.coefficient(place): values[place] for place in evidence.columns(candidate)}
    return name, library()[name].about(form, coefficients)


def effect_parameters(evidence: Evidence, fit: Fit, candidate: Candidate) -> tuple[EffectParameter, ...]:
    """Parameters of one effect of a fitted hypothesis, with standard errors by linear propagation.

    Shares of a parameter of the model are told of its fitted value: a model file holds both. The error of a size holds
    what sound machines show of the effect beside noise. Errors of coefficients and of what the effect is not linear in,
    such as a frequency, are taken for independent of each other; runs that lie further apart about the effect than
    their noise says widen both.
    """
    name, form = candidate
    places = [int(np.flatnonzero(fit.columns == place)[0]) for place in evidence.columns(candidate)]
    names = [evidence.coefficient(place) for place in evidence.columns(candidate)]
    normal = evidence.normal()
    apart = max((disagreement(normal, fit, place) for place in places), default=1.0) ** 2
    values, spread = fit.values[places], apart * fit.covariance[np.ix_(places, places)]
    effect, model = library()[name], evidence.model
    size = effect.size(form, dict(zip(names, values.tolist(), strict=True)), model)
    if size > 0.0:
        spread = spread + (evidence.floor(candidate) / size) ** 2 * np.outer(values, values)
    fitted = fitted_over_nominal(evidence, fit, candidate)
    values, spread = values / fitted, spread / fitted**2

    def with_form(numbers: Sequence[float], coefficients: Array) -> dict[str, float]:
        return effect.parameters(tuple(numbers), dict(zip(names, coefficients.tolist(), strict=True)), model)

    def at(logs: Array) -> dict[str, float]:
        return with_form([*(form[: len(logs)] * np.exp(logs)), *form[len(logs) :]], values)

    here, units = with_form(form, values), effect_definition(name).parameters
    variances = propagated(here, lambda change: with_form(form, values + change), spread)
    refined = evidence.form_spread.get(candidate)
    if refined is not None:
        free = apart * refined
        far = np.diag(free) > math.log(SMALLEST) ** 2  # no run shows a number that may be off by that
        free[far, far] = math.inf
        of_form = propagated(here, at, free)
        variances = {key: variances[key] + of_form[key] for key in here}
    late = stamps_late(evidence, candidate)
    return tuple(
        EffectParameter(
            key,
            value,
            math.hypot(math.sqrt(variances[key]), late if units[key].units == "s" else 0.0),
            model.units_of(units[key].units),
        )
        for key, value in here.items()
    )


def propagated(here: Mapping[str, float], at: Callable[[Array], dict[str, float]], spread: Array) -> dict[str, float]:
    """Variance of each parameter, to first order; infinite where it goes with a change that no run shows.

    at : gives the parameters after a change.
    spread : covariance of the changes.
    """
    steps = np.sqrt(np.maximum(np.diag(spread), 0.0))
    shown = np.isfinite(spread).all(axis=1)
    slopes = {key: np.zeros(len(spread)) for key in here}
    for k, step in enumerate(np.where(shown, steps, UNSHOWN)):
        if step > 0.0:
            there = at(step * np.eye(len(spread))[k])
            for key in here:
                slopes[key][k] = (there[key] - here[key]) / step
    finite = spread[np.ix_(shown, shown)]
    return {
        key: math.inf if slope[~shown].any() else max(float(slope[shown] @ finite @ slope[shown]), 0.0)
        for key, slope in slopes.items()
    }


def stamps_late(evidence: Evidence, candidate: Candidate) -> float:
    """Standard deviation [s] of what stamps that no file explains add to an effect's delay; zero where they are told.

    Below what they may add no delay is named; above, how much of it is theirs no run tells.
    """
    effect, form = candidate
    late = [
        LATE_STD * rows.signals.interval
        for rows in evidence.stack.rows
        if rows.equation in evidence.on_time and any(name[1:3] == (effect, repr(form)) for name in rows.columns)
    ]
    return max(late, default=0.0)
