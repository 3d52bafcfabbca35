"""Withdraw effects and calibration that held-out runs do not confirm: they are neither named nor applied."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

from leactl.effects import library
from leactl.gap.diagnosis import LEAST_GAP_FLOORS, MOST_REPLAY_MISS, CalibratedParameter, Cause, Near
from leactl.gap.search.parameters import is_at_bound, with_calibration, with_effects
from leactl.gap.verdict.shrinkage import Shrunk
from leactl.model.nominal import Model

GAP_GROWS = "with it the gap of held-out runs grows"
MOST_EQUAL_RATIO = 1.001  # ratio of squared distances up to which two count as equal: replays vary by as much
# a limit of the drive closes this share of the current's gap or more; laws that resemble it close less
LEAST_LIMIT_SHARE = 0.9
Simulate = Callable[[Model, Model], Shrunk]
"""Compares held-out runs with a calibrated and an augmented model."""


class FittedEffects(NamedTuple):
    """Effects, and the calibration fitted together with them."""

    causes: tuple[Cause, ...]
    calibration: tuple[CalibratedParameter, ...]


Refit = Callable[[Sequence[Cause]], FittedEffects]
"""Fits some of the effects that were named, without the others."""


class HeldOutTrial(NamedTuple):
    """Result of a trial of effects on held-out runs."""

    fitted: FittedEffects
    model: Model  # with the effects
    comparison: Shrunk  # of the model without the effects and with them
    refused_because: str  # empty where held-out runs confirm the effects


@dataclass(frozen=True)
class HeldOutTrials:
    """Trials of effects on held-out runs; the fields are the parameters of `apply`."""

    model: Model
    refit: Refit
    simulate: Simulate
    bounded_fit: bool
    borne_out_by_equations: Collection[str]

    def beside(self, accepted: FittedEffects, model_before: Model, stage: Sequence[Cause]) -> HeldOutTrial:
        """Return the trial of effects in addition to the accepted ones.

        If the gap grows with the calibration fitted beside them, they are tried again with the accepted calibration.

        accepted : effects and calibration accepted so far.
        model_before : model with these alone.
        stage : effects to try together.
        """
        fitted = self.refit([*accepted.causes, *stage])
        equations_bear_out = all(cause.effect in self.borne_out_by_equations for cause in stage)
        limits_current = any(library()[cause.effect].limits_current for cause in stage)
        trial_with = partial(
            self._trial_of,
            model_before=model_before,
            beside_others=bool(accepted.causes),
            equations_bear_out=equations_bear_out,
            limits_current=limits_current,
        )
        trial = trial_with(fitted)
        if trial.refused_because == GAP_GROWS:
            trial = trial_with(fitted._replace(calibration=accepted.calibration))
        return trial

    def is_needed(self, stage: Sequence[Cause], trial_of_all: HeldOutTrial) -> bool:
        """Return whether effects close a gap in addition to all others of a trial."""
        dropped_effects = {cause.effect for cause in stage}
        fitted_without = self.refit(
            [cause for cause in trial_of_all.fitted.causes if cause.effect not in dropped_effects]
        )
        comparison = self.simulate(with_fitted(self.model, fitted_without), trial_of_all.model)
        return not refusal(comparison, [], beside_others=True, equations_bear_out=False)

    def _trial_of(
        self,
        fitted: FittedEffects,
        model_before: Model,
        beside_others: bool,
        equations_bear_out: bool,
        limits_current: bool,
    ) -> HeldOutTrial:
        """Return the trial of some effects with their calibration, against the model before them.

        limits_current : whether one of the effects is a limit of the drive, which `refusal_of_limit` tests in addition.
        """
        model_after = with_fitted(self.model, fitted)
        comparison = self.simulate(model_before, model_after)
        bounds = names_at_bound(fitted.calibration) if self.bounded_fit else []
        reason = refusal(comparison, bounds, beside_others, equations_bear_out)
        if not reason and limits_current:
            reason = refusal_of_limit(comparison)
        return HeldOutTrial(fitted, model_after, comparison, reason)


@dataclass(frozen=True)
class Applied:
    """Models that held-out runs do not contradict, and the effects that were withdrawn."""

    calibrated: Model
    augmented: Model
    fitted: FittedEffects  # effects and calibration of the augmented model
    shrunk: Shrunk
    first_calibration_withdrawn: bool  # whether the calibration fitted without effects is not applied
    notes: tuple[str, ...]
    refused: tuple[Near, ...]  # withdrawn effects, with the reason


def apply(
    model: Model,
    calibration_alone: Sequence[CalibratedParameter],
    stages: Sequence[Sequence[Cause]],
    refit: Refit,
    simulate: Simulate,
    bounded_fit: bool = True,
    borne_out_by_equations: Collection[str] = (),
) -> Applied:
    """Return the models with calibration and named effects, as far as held-out runs confirm them.

    Parameters
    ----------
    calibration_alone : parameters fitted without any effect.
    stages : named effects, most probable first: each stage has to close a gap in addition to the accepted ones.
    refit, simulate : see `Refit` and `Simulate`.
    borne_out_by_equations : names of effects that shrink the equations' residuals in held-out runs beyond chance.
    bounded_fit : whether a parameter at its bound counts against a trial; it does not in the free runs of a servo,
        which determine some parameters by their ratio only.
    """
    trials = HeldOutTrials(model, refit, simulate, bounded_fit, borne_out_by_equations)
    fitted, calibrated = FittedEffects((), tuple(calibration_alone)), with_calibration(model, calibration_alone)
    augmented, confirmed_trials = calibrated, list[HeldOutTrial]()
    pending, accepted, refusals = list(stages), list[Sequence[Cause]](), list[str]()
    while len(refusals) < len(pending):  # after each acceptance all refused ones are tried again
        index = len(refusals)
        trial = trials.beside(fitted, augmented, pending[index])
        if trial.refused_because:
            refusals.append(trial.refused_because)
            continue
        confirmed_trials.append(trial)
        fitted, augmented = trial.fitted, trial.model
        accepted.append(pending.pop(index))
        refusals.clear()
    if len(pending) > 1:  # effects that close a gap together may each enlarge the gap alone
        trial = trials.beside(fitted, augmented, [cause for stage in pending for cause in stage])
        if not trial.refused_because and all(trials.is_needed(stage, trial) for stage in pending):
            confirmed_trials.append(trial)
            fitted, augmented = trial.fitted, trial.model
            accepted += pending
            pending, refusals = [], []
    notes = [refusal_note(stage, reason_refused) for stage, reason_refused in zip(pending, refusals, strict=True)]
    refused = tuple(
        Near(cause.effect, reason_refused)
        for stage, reason_refused in zip(pending, refusals, strict=True)
        for cause in stage
    )
    if confirmed_trials:
        shrunk = confirmed_trials[0].comparison if len(confirmed_trials) == 1 else simulate(calibrated, augmented)
        first_calibration_withdrawn = calibration_worse(shrunk)
        if first_calibration_withdrawn:  # the calibration fitted with the effects does not absorb them
            reason = "it takes up what the effects do, and the gap grows with it"
            calibrated = with_calibration(model, fitted.calibration)
            shrunk, consequence = simulate(calibrated, augmented), "the one beside the effects stands for it"
            if calibration_worse(shrunk):
                calibrated, shrunk, consequence = model, simulate(model, augmented), "the model stays as it was given"
            notes.append(f"calibration alone is not applied: {reason}; {consequence}")
            if farther_with_effects(shrunk):
                # The effects were accepted beside the old calibration and fail beside this one: drop one stage at a
                # time, try the others again beside this one, and keep what comes nearest to the held-out runs.
                apply_again = partial(
                    apply, model, fitted.calibration, refit=refit, simulate=simulate,
                    bounded_fit=bounded_fit, borne_out_by_equations=borne_out_by_equations,
                )  # fmt: skip
                trials_without_stage = [(stage, apply_again(stages=all_but(stages, stage))) for stage in accepted]
                dropped_stage, nearest_applied = min(
                    trials_without_stage, key=lambda pair: squares(pair[1].shrunk, "augmented_rms", LEAST_GAP_FLOORS)
                )
                return replace(
                    nearest_applied,
                    notes=(*nearest_applied.notes, notes[-1], refusal_note(dropped_stage, GAP_GROWS)),
                    refused=(*nearest_applied.refused, *(Near(cause.effect, GAP_GROWS) for cause in dropped_stage)),
                )
        return Applied(calibrated, augmented, fitted, shrunk, first_calibration_withdrawn, tuple(notes), refused)
    parameters_at_bound = names_at_bound(calibration_alone) if bounded_fit else []
    if not parameters_at_bound:
        shrunk = simulate(calibrated, calibrated)
        if not calibration_worse(shrunk):
            return Applied(calibrated, calibrated, fitted, shrunk, False, tuple(notes), refused)
    reason = f"{', '.join(parameters_at_bound)} ended at a bound" if parameters_at_bound else GAP_GROWS
    notes.append(f"calibration is not applied: {reason}; the model stays as it was given")
    return Applied(model, model, FittedEffects((), ()), simulate(model, model), True, tuple(notes), refused)


def with_fitted(model: Model, fitted: FittedEffects) -> Model:
    """Return the model with effects and the calibration fitted together with them."""
    entries = [(cause.effect, {item.name: item.value for item in cause.parameters}) for cause in fitted.causes]
    return with_effects(with_calibration(model, fitted.calibration), entries)


def all_but(stages: Sequence[Sequence[Cause]], dropped: Sequence[Cause]) -> list[Sequence[Cause]]:
    """Return the stages without one of them."""
    return [stage for stage in stages if stage is not dropped]


def refusal_note(stage: Sequence[Cause], reason: str) -> str:
    """Return the note on effects that were refused together."""
    return f"not named though it fits: {', '.join(cause.effect for cause in stage)}; {reason}"


def calibration_worse(shrunk: Shrunk) -> bool:
    """Return whether the calibrated model is farther from held-out runs than the nominal one, by ratios or squares.

    It need not be beyond chance: the given model stays where nothing is gained.
    """
    nominal, calibrated = (squares(shrunk, name, LEAST_GAP_FLOORS) for name in ("nominal_rms", "calibrated_rms"))
    return shrunk.growth.by_calibration[0] > 0.0 or calibrated > nominal


def farther_with_effects(shrunk: Shrunk) -> bool:
    """Return whether the augmented model is farther from held-out runs, by squares, than the better of the others.

    A distance that is not a number counts as farther.
    """
    nominal, calibrated, augmented = (
        squares(shrunk, name, LEAST_GAP_FLOORS) for name in ("nominal_rms", "calibrated_rms", "augmented_rms")
    )
    return math.isnan(augmented) or augmented > min(nominal, calibrated)


def squares(shrunk: Shrunk, field: str, least_floors: float = 0.0) -> float:
    """Return the squared distance of a model from held-out runs, summed over channels in units of their floors.

    field : name of the field of `Shrinkage` that holds the model's distance.
    least_floors : smallest distance of a channel, in floors; a smaller one counts as this.
    """
    channels = [channel for channel in shrunk.shrinkage if channel.floor_rms > 0.0]
    return sum(max(float(getattr(channel, field)) / channel.floor_rms, least_floors) ** 2 for channel in channels)


def refusal(shrunk: Shrunk, at_bound: Sequence[str], beside_others: bool, equations_bear_out: bool) -> str:
    """Return why held-out runs do not confirm effects; empty where they do.

    In addition to other effects, an effect has to pass both tests of `Growth`. A replay accumulates every small error
    of its motion, which may hide a small effect, and a still smaller one is below the replay's floor. An effect that
    the equations of held-out runs show beyond chance is confirmed where the replay's gap does not grow.

    at_bound : parameters whose fit ended at a bound.
    beside_others : whether both models have other effects.
    equations_bear_out : whether the equations of held-out runs show every one of the effects beyond chance.
    """
    if at_bound:
        return f"calibration beside it ends at a bound ({', '.join(at_bound)})"
    gap_before, gap_after = (squares(shrunk, name, LEAST_GAP_FLOORS) for name in ("calibrated_rms", "augmented_rms"))
    if shrunk.growth.effects_worse or math.isnan(gap_after) or gap_after > MOST_EQUAL_RATIO * gap_before:
        return GAP_GROWS
    squares_before, squares_after = squares(shrunk, "calibrated_rms"), squares(shrunk, "augmented_rms")
    equations_bear_out &= shrunk.growth.by_effects[0] <= 0.0 and squares_after <= squares_before
    if shrunk.growth.closed is False and not equations_bear_out:
        return "with it no gap of held-out runs shrinks beyond chance"
    if beside_others and shrunk.growth.closed_alike is False and not equations_bear_out:
        return "beside the others it shrinks the gap of few stretches of held-out runs, or of many by next to nothing"
    # runs too short to judge chance have to show at least that the gap shrinks
    undecided = shrunk.growth.closed is None and not shrunk.growth.by_effects[0] < 0.0
    return "with it no gap of held-out runs shrinks" if undecided else ""


def refusal_of_limit(shrunk: Shrunk) -> str:
    """Return why the drive cannot have been at a limit in held-out runs; empty where it may have been.

    A limit that acts determines the current alone, so that it closes nearly all of the current's gap. A law that
    resembles the limit, such as that of a supply at its voltage limit, closes a part. What closes none of it in any
    set-up is no limit, however small the gap: a current that overshoots resembles one.
    """
    closed_shares = [
        (channel, channel.closed)
        for channel in shrunk.shrinkage
        if channel.quantity == "q_axis_current" and channel.closed is not None and channel.floor_rms > 0.0
    ]
    if closed_shares and all(closed <= 0.0 for _, closed in closed_shares):
        return "it closes nothing of the current's gap"
    for channel, closed in closed_shares:
        if channel.augmented_rms > MOST_REPLAY_MISS * channel.floor_rms and closed < LEAST_LIMIT_SHARE:
            share = f"{100 * max(closed, 0.0):.1f} % of the current's gap, {channel.mechanical}"
            return f"it closes {share}; a limit of the drive closes {100 * LEAST_LIMIT_SHARE:.0f} % or more"
    return ""


def names_at_bound(parameters: Sequence[CalibratedParameter]) -> list[str]:
    """Return the names of the parameters whose fit ended at a bound."""
    return [item.parameter for item in parameters if is_at_bound(item)]
