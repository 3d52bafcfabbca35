"""Fit the angle and the weight of the model's load before anything else, as no effect can stand for an error in them.

The fits after this one take the weight as known: the weight sets the torque constant. A wrong weight then looks like a
wrong constant, and the rotor's inertia, fitted beside the load's known part, is far off its own value.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from leactl.gap.diagnosis import ZERO_ANGLE, CalibratedParameter
from leactl.gap.equations.mechanical import LOAD_ZERO
from leactl.gap.search.effect_regression import PRIORS, Evidence
from leactl.gap.search.parameters import factor_of, with_calibration
from leactl.gap.search.regression import Column
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

TORQUE_CONSTANT = ("calibration", "torque_constant")
WEIGHT = "load.gravity"  # parameter that scales the torque of a mass by a length, and no inertia
WEIGHT_PRIOR = 0.1  # relative error of the torque of a weight
LEAST_ODDS = 9.0  # least drop in summed squared prior widths for which a fitted weight replaces the model's
LEAST_STDS = 3.0  # standard errors from which an angle is off
ROUNDS = 2  # rounds of fitting both


def with_fitted_load(records: Sequence[Record], model: Model) -> tuple[Model, tuple[CalibratedParameter, ...]]:
    """Return the model with the angle and the weight of its load as the runs have them, and those that were off.

    The model is returned as it is where it has no weight, and where a servo's voltage drives it. A pendulum has no
    angle in a model file: it becomes an arm, unless it has an `arm_mass`, which no arm has.
    """
    if model.load.level_torque == 0.0 or model.drive is not None:
        return model, ()
    fitted: dict[str, CalibratedParameter] = {}
    searches = (partial(weight_off, nominal=model), angle_off)
    for _ in range(ROUNDS):
        for search in searches:
            if (item := search(records, model)) is None:
                continue
            model = with_calibration(model, [item])
            first = fitted.get(item.parameter, item)  # later rounds start from what it has found
            fitted[item.parameter] = replace(item, nominal=first.nominal)
    return model, tuple(fitted.values())


def weight_off(records: Sequence[Record], model: Model, nominal: Model) -> CalibratedParameter | None:
    """Return a weight with which the other parameters of the model are far likelier; None where there is none.

    It is the weight that leaves the torque constant at its nominal value. The change of the weight itself counts from
    the nominal model's weight, whatever `model` already has.
    """
    fitted = fitted_without_effects(records, model)
    if TORQUE_CONSTANT not in fitted or ("calibration", "phase_resistance") in fitted:
        return None  # a voltage drives it: its gain and the weight are one column
    constant = fitted[TORQUE_CONSTANT]
    gravity, factor = model.load.gravity, 1.0 / factor_of(TORQUE_CONSTANT[1], constant.value)
    weight = CalibratedParameter(WEIGHT, gravity, gravity * factor, gravity * factor**2 * constant.std, "m/s^2")
    model_beside = with_calibration(model, [weight])
    fitted_beside = fitted_without_effects(records, model_beside)
    kept, beside = (
        prior_squares(coefficients) + ((used.load.gravity / nominal.load.gravity - 1.0) / WEIGHT_PRIOR) ** 2
        for coefficients, used in ((fitted, model), (fitted_beside, model_beside))
    )
    return weight if kept - beside > LEAST_ODDS else None


def angle_off(records: Sequence[Record], model: Model) -> CalibratedParameter | None:
    """Return the angle of the load where it is off beyond its error and the model can hold it; else None."""
    if model.load.type == "pendulum" and model.load.arm_mass:
        return None
    offset = fitted_without_effects(records, model).get(("nuisance", "", LOAD_ZERO))
    if offset is None or abs(offset.value) <= LEAST_STDS * offset.std:
        return None
    angle = -0.5 * math.pi - model.load.hanging_angle
    return CalibratedParameter(ZERO_ANGLE, angle, angle + offset.value, offset.std, "rad")


class Coefficient(NamedTuple):
    """A fitted coefficient: the relative change of a parameter, or a nuisance in its own unit."""

    value: float
    std: float  # standard error by noise


def fitted_without_effects(records: Sequence[Record], model: Model) -> dict[Column, Coefficient]:
    """Return the coefficients of a fit of the model alone, by column."""
    evidence = Evidence(records, model, only=())
    fit = evidence.settle([])
    stds = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return {
        evidence.stack.names[column]: Coefficient(float(value), float(std))
        for column, value, std in zip(fit.columns, fit.values, stds, strict=True)
    }


def prior_squares(fitted: Mapping[Column, Coefficient]) -> float:
    """Return the sum of the squared changes of the model's parameters in prior widths."""
    return sum((fitted[name].value / PRIORS[name[1]]) ** 2 for name in fitted if name[0] == "calibration")
