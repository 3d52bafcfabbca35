"""Fit the angle and the weight of the model's load before anything else: no effect of the library stands for them.

A fit takes the weight as known: it gives the torque constant. A wrong weight then looks like a wrong constant, and the
inertia, of which the load's part is known, follows it far off its own value.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from leactl.gap.diagnosis import ZERO_ANGLE, CalibratedParameter
from leactl.gap.equations.mechanical import LOAD_ZERO
from leactl.gap.search.effect_regression import PRIORS, Evidence
from leactl.gap.search.parameters import with_calibration
from leactl.gap.search.regression import Fit
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

WEIGHT = "load.gravity"  # parameter that scales the torque of a mass by a length, and no inertia
WEIGHT_PRIOR = 0.1  # relative error of the torque of a weight
LEAST_ODDS = 9.0  # squared prior widths by which a wrong weight has to be the likelier cause
LEAST_STDS = 3.0  # standard errors from which an angle is off
ROUNDS = 2  # rounds of fitting both


def with_fitted_load(records: Sequence[Record], model: Model) -> tuple[Model, tuple[CalibratedParameter, ...]]:
    """Return the model with the angle and the weight of its load as the runs have them, and those that were off.

    The model is returned as it is where it has no weight, and where a servo's voltage drives it. A pendulum has no
    angle in a model file: it becomes an arm, unless it has an arm of its own.
    """
    if model.load.level_torque == 0.0 or model.drive is not None:
        return model, ()
    fitted: dict[str, CalibratedParameter] = {}
    for _ in range(ROUNDS):
        for step in (weight_off, angle_off):
            item = step(records, model)
            if item is not None:
                model = with_calibration(model, [item])
                nominal = fitted[item.parameter].nominal if item.parameter in fitted else item.nominal
                fitted[item.parameter] = replace(item, nominal=nominal)
    return model, tuple(fitted.values())


def weight_off(records: Sequence[Record], model: Model) -> CalibratedParameter | None:
    """Return the weight with which the other parameters are likelier by far; None where there is none."""
    evidence = Evidence(records, model, only=())
    fit = evidence.settle([])
    changes = relative_changes(evidence, fit)
    if "torque_constant" not in changes or "phase_resistance" in changes:
        return None  # a voltage drives it: its gain stands for the weight
    gravity, factor = model.load.gravity, 1.0 / max(1.0 + changes["torque_constant"], WEIGHT_PRIOR)
    std = evidence.std_of(("calibration", "torque_constant"), fit)
    item = CalibratedParameter(WEIGHT, gravity, gravity * factor, gravity * std, "m/s^2")
    evidence = Evidence(records, with_calibration(model, [item]), only=())
    changes_beside = relative_changes(evidence, evidence.settle([]))
    odds = prior_squares(changes) - prior_squares(changes_beside) - ((factor - 1.0) / WEIGHT_PRIOR) ** 2
    return item if odds > LEAST_ODDS else None


def angle_off(records: Sequence[Record], model: Model) -> CalibratedParameter | None:
    """Return the angle of the load if it is off beyond its error and the model can hold it; else None."""
    if model.load.type == "pendulum" and model.load.arm_mass:
        return None
    evidence = Evidence(records, model, only=())
    fit = evidence.settle([])
    name = ("nuisance", "", LOAD_ZERO)
    change, std = evidence.value_of(name, fit), evidence.std_of(name, fit)
    if not abs(change) > LEAST_STDS * std:
        return None
    angle = -0.5 * math.pi - model.load.hanging_angle
    return CalibratedParameter(ZERO_ANGLE, angle, angle + change, std, "rad")


def relative_changes(evidence: Evidence, fit: Fit) -> dict[str, float]:
    """Return the relative change of each calibrated parameter."""
    names = [evidence.stack.names[column] for column in fit.columns]
    return {name[1]: float(value) for name, value in zip(names, fit.values, strict=True) if name[0] == "calibration"}


def prior_squares(changes: Mapping[str, float]) -> float:
    """Return the sum of the squared changes in prior widths."""
    return sum((change / PRIORS[parameter]) ** 2 for parameter, change in changes.items())
