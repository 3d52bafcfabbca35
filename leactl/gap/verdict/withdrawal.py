"""Effects and calibration that held-out runs do not bear out are taken back: neither named nor applied."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

from leactl.gap.diagnosis import CalibratedParameter, Cause, Near
from leactl.gap.search.parameters import at_bound, with_calibration, with_effects
from leactl.gap.verdict.shrinkage import NEAR_FLOOR, Shrunk
from leactl.model.nominal import Model

GAP_GROWS = "with it the gap of held-out runs grows"
GROWN = 1.001  # of a squared distance to held-out runs, up to which it is the same: replays differ by as much
Simulate = Callable[[Model, Model], Shrunk]
"""Compares held-out runs with a calibrated and an augmented model."""


class FittedEffects(NamedTuple):
    """Effects, and the calibration fitted together with them."""

    causes: tuple[Cause, ...]
    calibration: tuple[CalibratedParameter, ...]


Refit = Callable[[Sequence[Cause]], FittedEffects]
"""Fits some of the effects that were named, without the others."""


class HeldOutTrial(NamedTuple):
    """Effects that are tried on held-out runs."""

    fitted: FittedEffects
    model: Model  # with them
    comparison: Shrunk  # from the model without them
    refused_because: str  # empty where held-out runs bear them out


@dataclass(frozen=True)
class HeldOutTrials:
    """How effects are tried on held-out runs; the fields are those of `apply`."""

    model: Model
    refit: Refit
    simulate: Simulate
    bounded_fit: bool
    borne_out_by_equations: Collection[str]

    def beside(self, kept: FittedEffects, before: Model, stage: Sequence[Cause]) -> HeldOutTrial:
        """Try effects beside those that are kept; `before` is the model with these alone.

        Where the calibration that is fitted beside the effects lets a gap grow elsewhere, the kept one may serve.
        """
        fitted = self.refit([*kept.causes, *stage])
        by_equations = all(cause.effect in self.borne_out_by_equations for cause in stage)
        trial = self._of(fitted, before, bool(kept.causes), by_equations)
        if trial.refused_because == GAP_GROWS:
            trial = self._of(fitted._replace(calibration=kept.calibration), before, bool(kept.causes), by_equations)
        return trial

    def is_needed(self, stage: Sequence[Cause], whole: HeldOutTrial) -> bool:
        """Whether effects close a gap beside all others of a trial."""
        dropped = {cause.effect for cause in stage}
        without = self.refit([cause for cause in whole.fitted.causes if cause.effect not in dropped])
        comparison = self.simulate(with_fitted(self.model, without), whole.model)
        return not refusal(comparison, [], beside_others=True, by_equations=False)

    def _of(self, fitted: FittedEffects, before: Model, beside_others: bool, by_equations: bool) -> HeldOutTrial:
        after = with_fitted(self.model, fitted)
        comparison = self.simulate(before, after)
        bounds = at_bounds(fitted.calibration) if self.bounded_fit else []
        return HeldOutTrial(fitted, after, comparison, refusal(comparison, bounds, beside_others, by_equations))


@dataclass(frozen=True)
class Applied:
    """Models that held-out runs do not contradict, and what was taken back on the way."""

    calibrated: Model
    augmented: Model
    fitted: FittedEffects  # what the augmented model has
    shrunk: Shrunk
    first_calibration_withdrawn: bool  # whether the calibration that was fitted without effects is not applied
    notes: tuple[str, ...]
    refused: tuple[Near, ...]  # effects that were named before, and why they are not


def apply(
    model: Model,
    without_effects: Sequence[CalibratedParameter],
    stages: Sequence[Sequence[Cause]],
    refit: Refit,
    simulate: Simulate,
    bounded_fit: bool = True,
    borne_out_by_equations: Collection[str] = (),
) -> Applied:
    """Apply calibration and named effects to the model as far as held-out runs bear them out.

    Parameters
    ----------
    without_effects : parameters as they are fitted without any effect.
    stages : effects that were named, surest first: each stage has to close a gap beside those before it.
    borne_out_by_equations : effects, by name, that shrink beyond chance what the equations leave over in held-out runs.
    bounded_fit : whether a parameter that ends at its bound counts against a trial; not so in the free runs of a servo,
        which tell some parameters by their ratio only.
    """
    trials = HeldOutTrials(model, refit, simulate, bounded_fit, borne_out_by_equations)
    fitted, calibrated = FittedEffects((), tuple(without_effects)), with_calibration(model, without_effects)
    augmented, borne_out = calibrated, list[HeldOutTrial]()
    waiting, accepted, refusals = list(stages), list[Sequence[Cause]](), list[str]()
    while len(refusals) < len(waiting):  # after each acceptance all refused ones are tried again
        index = len(refusals)
        trial = trials.beside(fitted, augmented, waiting[index])
        if trial.refused_because:
            refusals.append(trial.refused_because)
            continue
        borne_out.append(trial)
        fitted, augmented = trial.fitted, trial.model
        accepted.append(waiting.pop(index))
        refusals.clear()
    if len(waiting) > 1:  # each may let the gap grow alone that all of them close together
        trial = trials.beside(fitted, augmented, [cause for stage in waiting for cause in stage])
        if not trial.refused_because and all(trials.is_needed(stage, trial) for stage in waiting):
            borne_out.append(trial)
            fitted, augmented = trial.fitted, trial.model
            accepted += waiting
            waiting, refusals = [], []
    notes = [refusal_note(stage, why) for stage, why in zip(waiting, refusals, strict=True)]
    refused = tuple(Near(cause.effect, why) for stage, why in zip(waiting, refusals, strict=True) for cause in stage)
    if borne_out:
        shrunk = borne_out[0].comparison if len(borne_out) == 1 else simulate(calibrated, augmented)
        withdrawn = calibration_worse(shrunk)
        if withdrawn:  # what is fitted beside the effects is free of them
            reason = "it takes up what the effects do, and the gap grows with it"
            calibrated = with_calibration(model, fitted.calibration)
            shrunk, applied = simulate(calibrated, augmented), "the one beside the effects stands for it"
            if calibration_worse(shrunk):
                calibrated, shrunk, applied = model, simulate(model, augmented), "the model stays as it was given"
            notes.append(f"calibration alone is not applied: {reason}; {applied}")
            if farther_with_effects(shrunk):
                # The effects were accepted beside the old calibration and fail beside this one: drop one stage at a
                # time, try the others again beside this one, and keep what comes nearest to the held-out runs.
                again = partial(
                    apply, model, fitted.calibration, refit=refit, simulate=simulate,
                    bounded_fit=bounded_fit, borne_out_by_equations=borne_out_by_equations,
                )  # fmt: skip
                tried = [(stage, again(stages=all_but(stages, stage))) for stage in accepted]
                dropped, nearest = min(tried, key=lambda pair: squares(pair[1].shrunk, "augmented_rms", NEAR_FLOOR))
                return replace(
                    nearest,
                    notes=(*nearest.notes, notes[-1], refusal_note(dropped, GAP_GROWS)),
                    refused=(*nearest.refused, *(Near(cause.effect, GAP_GROWS) for cause in dropped)),
                )
        return Applied(calibrated, augmented, fitted, shrunk, withdrawn, tuple(notes), refused)
    bounded = at_bounds(without_effects) if bounded_fit else []
    if not bounded:
        shrunk = simulate(calibrated, calibrated)
        if not calibration_worse(shrunk):
            return Applied(calibrated, calibrated, fitted, shrunk, False, tuple(notes), refused)
    reason = f"{', '.join(bounded)} ended at a bound" if bounded else GAP_GROWS
    notes.append(f"calibration is not applied: {reason}; the model stays as it was given")
    return Applied(model, model, FittedEffects((), ()), simulate(model, model), True, tuple(notes), refused)


def with_fitted(model: Model, fitted: FittedEffects) -> Model:
    """The model with a calibration and effects."""
    entries = [(cause.effect, {item.name: item.value for item in cause.parameters}) for cause in fitted.causes]
    return with_effects(with_calibration(model, fitted.calibration), entries)


def all_but(stages: Sequence[Sequence[Cause]], dropped: Sequence[Cause]) -> list[Sequence[Cause]]:
    """The stages without one of them."""
    return [stage for stage in stages if stage is not dropped]


def refusal_note(stage: Sequence[Cause], reason: str) -> str:
    """What an answer says of effects that were refused together."""
    return f"not named though it fits: {', '.join(cause.effect for cause in stage)}; {reason}"


def calibration_worse(shrunk: Shrunk) -> bool:
    """Whether the calibrated model is farther from held-out runs than the nominal one, by ratios or by squares.

    It does not need to be beyond chance: a model that was given stays where nothing is gained.
    """
    nominal, calibrated = (squares(shrunk, name, NEAR_FLOOR) for name in ("nominal_rms", "calibrated_rms"))
    return shrunk.growth.by_calibration[0] > 0.0 or calibrated > nominal


def farther_with_effects(shrunk: Shrunk) -> bool:
    """Whether the augmented model is farther from held-out runs, by squares, than the better one without effects.

    A distance that is not a number counts as farther.
    """
    nominal, calibrated, augmented = (
        squares(shrunk, name, NEAR_FLOOR) for name in ("nominal_rms", "calibrated_rms", "augmented_rms")
    )
    return math.isnan(augmented) or augmented > min(nominal, calibrated)


def squares(shrunk: Shrunk, model: str, least: float = 0.0) -> float:
    """Squared distance of one model from held-out runs, summed over the channels in multiples of their floors."""
    lines = [line for line in shrunk.shrinkage if line.floor_rms > 0.0]
    return sum(max(float(getattr(line, model)) / line.floor_rms, least) ** 2 for line in lines)


def refusal(shrunk: Shrunk, bounded: Sequence[str], beside_others: bool, by_equations: bool) -> str:
    """Why held-out runs do not bear effects out; empty where they do. Beside others an effect has to show in more.

    A replay sums up every small error of its motion, which may hide a small effect, and stands at its floor before one
    that is smaller still. What the equations of held-out runs show beyond chance is borne out where the replay's gap
    does not grow.
    """
    if bounded:
        return f"calibration beside it ends at a bound ({', '.join(bounded)})"
    gap_before, gap_after = (squares(shrunk, name, NEAR_FLOOR) for name in ("calibrated_rms", "augmented_rms"))
    if shrunk.growth.effects_worse or gap_after > GROWN * gap_before:
        return GAP_GROWS
    before, after = squares(shrunk, "calibrated_rms"), squares(shrunk, "augmented_rms")
    by_equations &= shrunk.growth.by_effects[0] <= 0.0 and after <= before
    if shrunk.growth.closed is False and not by_equations:
        return "with it no gap of held-out runs shrinks beyond chance"
    if beside_others and shrunk.growth.closed_alike is False and not by_equations:
        return "beside the others it shrinks the gap of few stretches of held-out runs, or of many by next to nothing"
    # runs too short to tell chance have to show at least that it shrinks
    undecided = shrunk.growth.closed is None and shrunk.growth.by_effects[0] >= 0.0
    return "with it no gap of held-out runs shrinks" if undecided else ""


def at_bounds(parameters: Sequence[CalibratedParameter]) -> list[str]:
    """Return the names of the parameters whose fit went as far as it may."""
    return [item.parameter for item in parameters if at_bound(item)]
