"""The nominal that simulated runs stand for: the model's parameters fitted again on them, and the effects they show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from leactl.errors import InputError
from leactl.gap.diagnose import Case, Channel, Progress, diagnose_mended, without_faults
from leactl.gap.diagnosis import CalibratedParameter, Cause, DiagnosisResult, SimulatorFloor
from leactl.gap.search.evidence import PRIORS, Evidence
from leactl.gap.search.parameters import (
    at_bound,
    calibrated,
    effect_parameters,
    nominal_value,
    with_calibration,
    with_effects,
)
from leactl.gap.servo.answer import judged_by_runs
from leactl.gap.setup import SetUpFault
from leactl.gap.signals.record import Record
from leactl.gap.simulated.known import KnownEffect, known_effects
from leactl.gap.verdict.decision import NAMED
from leactl.model.nominal import Model

MOST_FITS = 4  # from a start that is far off; three fits reach a parameter that is off by ten times


@dataclass(frozen=True, eq=False)
class NominalOfSimulator:
    """A simulator's runs as a nominal."""

    start: Model  # that the fits began with
    plain: Model  # with fitted parameters, without effects
    model: Model  # with effects
    answer: DiagnosisResult  # of the simulated runs against the plain form
    faults: tuple[SetUpFault, ...]  # of the simulated runs' set-up
    parameters: tuple[CalibratedParameter, ...]  # of the plain form, as the simulated runs have them
    effects: tuple[KnownEffect, ...]  # that can be taken from equations
    causes: tuple[Cause, ...]  # effects of the model, in the form of an answer
    records: tuple[Record, ...]  # simulated runs that were fitted
    by_free_runs: bool  # of a position servo, whose effects are fitted by simulation and not in equations

    @property
    def floors(self) -> tuple[SimulatorFloor, ...]:
        """What the simulator leaves of each channel against its fitted form."""
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
        """The same by channel."""
        return {(line.quantity, line.role, line.mechanical): line.left_rms for line in self.floors}

    def without(self, names: Sequence[str]) -> Model:
        """The nominal without some of its effects."""
        kept = [entry for entry in self.model.effects if entry.effect not in names]
        return self.model.model_copy(update={"effects": kept})


def nominal_of(
    fitted: Sequence[Record], held_out: Sequence[Record], model: Model, progress: Progress
) -> NominalOfSimulator:
    """Fit a model's own parameters to simulated runs, and look for effects there as in real ones.

    Effects that the model file has are not taken over: the simulated runs show what the simulator does.

    Raises
    ------
    InputError : the runs cannot be checked with the model, or are those of another machine.
    """
    plain = model.model_copy(update={"effects": []})
    faults, mended = without_faults(Case(plain, list(fitted), list(held_out)))
    by_free_runs = judged_by_runs(plain, mended.fitted)
    near = plain if by_free_runs else near_start(mended.fitted, plain)
    answer = diagnose_mended(replace(mended, model=near), faults, progress)
    with_them: Model = answer.extra["augmented"]
    base = with_them.model_copy(update={"effects": []})
    present = {entry.effect for entry in with_them.effects}
    causes = tuple(c for c in answer.causes if c.effect in present and c.probability >= NAMED)
    standing = () if by_free_runs else answer.extra.get("standing", ())
    candidates = [candidate for candidate in standing if candidate[0] in present]
    evidence = Evidence(mended.fitted, base, only=candidates)
    fit = evidence.settle(candidates)
    effects = known_effects(evidence, fit, candidates)
    sizes = {effect.name: effect_parameters(evidence, fit, effect.candidate) for effect in effects}
    causes = tuple(replace(c, parameters=sizes.get(c.effect, c.parameters)) for c in causes)
    entries = [(cause.effect, {item.name: item.value for item in cause.parameters}) for cause in causes]
    kept = (replace(item, fitted=item.nominal) for item in calibrated(evidence, fit))
    return NominalOfSimulator(
        model,
        base,
        with_effects(base, entries),
        answer,
        tuple(faults),
        answer.calibration or tuple(kept),
        effects,
        causes,
        tuple(mended.fitted),
        by_free_runs,
    )


def near_start(records: Sequence[Record], model: Model) -> Model:
    """The model as it was given where the runs are near it, else with parameters fitted until they move no farther.

    Priors are those of a data sheet: a start that is farther off than these would hold the fit back.

    Raises
    ------
    InputError : a parameter ends at a bound: the runs are those of another machine.
    """
    begin = model
    for _ in range(MOST_FITS):
        evidence = Evidence(records, model, only=[])
        if not evidence.stack.rows:
            return begin
        fitted = [item for item in calibrated(evidence, evidence.settle([])) if not item.not_told_by_these_runs]
        if not any(is_far(item) for item in fitted):
            return model
        model = with_calibration(model, fitted)
    ends = (
        CalibratedParameter(i.parameter, nominal_value(begin, i.parameter) or 0.0, i.fitted, i.std, i.units)
        for i in fitted
    )
    if bounded := [item for item in ends if at_bound(item)]:
        values = ", ".join(f"{item.parameter} fits at {item.fitted:.4g} {item.units}" for item in bounded)
        raise InputError(f"simulated runs: of another machine than the model {begin.name}: {values}")
    return model


def is_far(item: CalibratedParameter) -> bool:
    """Whether a fit moved a parameter by more than its prior."""
    prior = PRIORS.get(item.parameter)
    return prior is not None and item.has_ratio and abs(item.fitted / item.nominal - 1.0) > prior
