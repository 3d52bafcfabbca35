"""Nominal model of a simulator: the model's parameters and effects fitted to the simulated runs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from leactl.errors import InputError
from leactl.gap.diagnose import Case, Channel, Progress, diagnose_mended, mend_faults
from leactl.gap.diagnosis import CalibratedParameter, Cause, DiagnosisResult, SimulatorFloor
from leactl.gap.search.effect_regression import PRIORS, Evidence
from leactl.gap.search.parameters import (
    calibrated_parameters,
    effect_parameters,
    is_at_bound,
    nominal_value,
    with_calibration,
    with_effects,
)
from leactl.gap.servo.answer import judged_by_runs
from leactl.gap.setup import SetUpFault
from leactl.gap.signals.record import Record
from leactl.gap.simulated.simulator_effects import KnownEffect, known_effects
from leactl.gap.verdict.decision import NAMED_PROBABILITY
from leactl.model.nominal import Model

MOST_FITS = 4  # fits from a far start; three reach a parameter that is off by a factor of ten


@dataclass(frozen=True, eq=False)
class NominalOfSimulator:
    """Nominal model from a simulator's runs, with the diagnosis of these runs."""

    start: Model  # start of the fits
    plain: Model  # with fitted parameters, without effects
    model: Model  # with effects
    answer: DiagnosisResult  # of the simulated runs against the plain form
    faults: tuple[SetUpFault, ...]  # of the simulated runs' set-up
    parameters: tuple[CalibratedParameter, ...]  # of the plain form, as the simulated runs have them
    effects: tuple[KnownEffect, ...]  # effects that can be subtracted from equations
    causes: tuple[Cause, ...]  # effects of the model, in the form of an answer
    records: tuple[Record, ...]  # simulated runs that were fitted
    by_free_runs: bool  # whether effects were fitted by simulating a position servo instead of in equations

    @property
    def floors(self) -> tuple[SimulatorFloor, ...]:
        """Residual of the simulator's runs in each channel against the nominal."""
        return tuple(
            SimulatorFloor(
                line.quantity,
                line.role,
                line.mechanical,
                line.units,
                math.sqrt(max(line.augmented_rms**2 - line.floor_rms**2, 0.0)),
                line.floor_rms,
            )
            for line in self.answer.shrinkage
        )

    @property
    def unexplained(self) -> dict[Channel, float]:
        """Residual of the simulator's runs beyond their floor, by channel."""
        return {(line.quantity, line.role, line.mechanical): line.left_rms for line in self.floors}

    def without(self, names: Sequence[str]) -> Model:
        """Return the nominal model without the effects in `names`."""
        remaining = [entry for entry in self.model.effects if entry.effect not in names]
        return self.model.model_copy(update={"effects": remaining})


def nominal_of(
    fitted: Sequence[Record], held_out: Sequence[Record], model: Model, progress: Progress
) -> NominalOfSimulator:
    """Fit a model's parameters to simulated runs, and diagnose their effects as if they were real runs.

    Effects of the model file are dropped: the simulated runs show the simulator's.

    Raises
    ------
    InputError : the runs cannot be checked with the model, or are those of another machine.
    """
    plain = model.model_copy(update={"effects": []})
    faults, mended = mend_faults(Case(plain, list(fitted), list(held_out)))
    by_free_runs = judged_by_runs(plain, mended.fitted)
    start = plain if by_free_runs else near_start(mended.fitted, plain)
    answer = diagnose_mended(replace(mended, model=start), faults, progress)
    augmented: Model = answer.extra["augmented"]
    base = augmented.model_copy(update={"effects": []})
    applied_effects = {entry.effect for entry in augmented.effects}
    causes = tuple(
        cause for cause in answer.causes if cause.effect in applied_effects and cause.probability >= NAMED_PROBABILITY
    )
    applied_forms = () if by_free_runs else answer.extra.get("standing", ())
    candidates = [candidate for candidate in applied_forms if candidate[0] in applied_effects]
    evidence = Evidence(mended.fitted, base, only=candidates)
    fit = evidence.settle(candidates)
    effects = known_effects(evidence, fit, candidates)
    sizes = {effect.name: effect_parameters(evidence, fit, effect.candidate) for effect in effects}
    causes = tuple(replace(cause, parameters=sizes.get(cause.effect, cause.parameters)) for cause in causes)
    entries = [(cause.effect, {item.name: item.value for item in cause.parameters}) for cause in causes]
    nominal_parameters = (replace(item, fitted=item.nominal) for item in calibrated_parameters(evidence, fit))
    return NominalOfSimulator(
        model,
        base,
        with_effects(base, entries),
        answer,
        tuple(faults),
        answer.calibration or tuple(nominal_parameters),
        effects,
        causes,
        tuple(mended.fitted),
        by_free_runs,
    )


def near_start(records: Sequence[Record], model: Model) -> Model:
    """Return the model with parameters fitted, up to `MOST_FITS` times, until no fit moves one by more than its prior.

    The model is unchanged if the first fit moves none. Priors are those of a data sheet: a start farther off would bias
    the fit.

    Raises
    ------
    InputError : a parameter ends at a bound, as one of another machine does.
    """
    given_model = model
    for _ in range(MOST_FITS):
        evidence = Evidence(records, model, only=[])
        if not evidence.stack.rows:
            return given_model
        fitted = [
            item for item in calibrated_parameters(evidence, evidence.settle([])) if not item.not_told_by_these_runs
        ]
        if not any(is_far(item) for item in fitted):
            return model
        model = with_calibration(model, fitted)
    end_values = (
        CalibratedParameter(
            item.parameter, nominal_value(given_model, item.parameter) or 0.0, item.fitted, item.std, item.units
        )
        for item in fitted
    )
    if at_bounds := [item for item in end_values if is_at_bound(item)]:
        values = ", ".join(f"{item.parameter} fits at {item.fitted:.4g} {item.units}" for item in at_bounds)
        raise InputError(f"simulated runs: of another machine than the model {given_model.name}: {values}")
    return model


def is_far(item: CalibratedParameter) -> bool:
    """Return whether a fit moved a parameter by more than its prior."""
    prior = PRIORS.get(item.parameter)
    return prior is not None and item.has_ratio and abs(item.fitted / item.nominal - 1.0) > prior
