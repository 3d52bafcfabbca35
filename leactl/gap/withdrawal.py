"""Effects and calibration that make the gap of held-out runs grow are taken back: neither named nor applied."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from leactl.gap.diagnosis import CalibratedParameter, Cause
from leactl.gap.parameters import at_bound, with_calibration, with_effects
from leactl.gap.shrinkage import Shrunk
from leactl.model.nominal import Model

Simulate = Callable[[Model, Model], Shrunk]
"""Compares held-out runs with a calibrated and an augmented model."""


@dataclass(frozen=True)
class Applied:
    """Models that held-out runs do not contradict, and what was taken back on the way."""

    calibrated: Model
    augmented: Model
    shrunk: Shrunk
    effects_withdrawn: tuple[str, ...]
    calibration_withdrawn: bool
    notes: tuple[str, ...]


def apply(
    model: Model,
    alone: Sequence[CalibratedParameter],
    with_causes: Sequence[CalibratedParameter],
    named: Sequence[Cause],
    simulate: Simulate,
    bounded_fit: bool = True,
) -> Applied:
    """Apply calibration and named effects to the model as far as held-out runs bear it.

    Parameters
    ----------
    alone : parameters as they are fitted without any effect.
    with_causes : parameters as they are fitted together with the effects.
    bounded_fit : whether the fit ends at `SMALLEST`; free runs of a servo tell some parameters by their ratio alone.
    """
    notes: list[str] = []
    withdrawn: tuple[str, ...] = ()
    bounded = at_bounds(with_causes if named else alone) if bounded_fit else []
    if named:
        effects = [(cause.effect, {item.name: item.value for item in cause.parameters}) for cause in named]
        calibrated = with_calibration(model, alone)
        augmented = with_effects(with_calibration(model, with_causes), effects)
        shrunk = simulate(calibrated, augmented)
        if not (shrunk.growth.effects_worse or bounded):
            return Applied(calibrated, augmented, shrunk, (), False, ())
        withdrawn = tuple(cause.effect for cause in named)
        reason = (
            f"calibration beside it ends at a bound ({', '.join(bounded)})"
            if bounded
            else "with it the gap of held-out runs grows"
        )
        notes.append(f"not named though it fits: {', '.join(withdrawn)}; {reason}")
        bounded = at_bounds(alone) if bounded_fit else []
    if not bounded:
        calibrated = with_calibration(model, alone)
        shrunk = simulate(calibrated, calibrated)
        if not shrunk.growth.calibration_worse:
            return Applied(calibrated, calibrated, shrunk, withdrawn, False, tuple(notes))
    reason = f"{', '.join(bounded)} ended at a bound" if bounded else "with it the gap of held-out runs grows"
    notes.append(f"calibration is not applied: {reason}; the model stays as it was given")
    return Applied(model, model, simulate(model, model), withdrawn, True, tuple(notes))


def at_bounds(parameters: Sequence[CalibratedParameter]) -> list[str]:
    """Return the names of the parameters whose fit went as far as it may."""
    return [item.parameter for item in parameters if at_bound(item)]
