"""Compare a simulator with real runs: parameters, effects of the simulator, and effects that both show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from leactl.gap.diagnosis import (
    CalibratedParameter,
    DiagnosisResult,
    EffectiveParameter,
    EffectParameter,
    Presence,
    SimulatorEffect,
    SizeInBoth,
)
from leactl.gap.search.effect_regression import PRIORS, Evidence
from leactl.gap.search.effect_sets import ENTRY_HEIGHT, FORM_ERROR
from leactl.gap.search.parameters import effect_parameters, nominal_value
from leactl.gap.search.regression import Candidate
from leactl.gap.setup import SetUpFault
from leactl.gap.signals.record import Record
from leactl.gap.simulated.nominal import NominalOfSimulator
from leactl.gap.simulated.simulator_effects import KnownEffect, known_effects, records_without
from leactl.gap.verdict.decision import NAMED_PROBABILITY, verdict_of

MOST_DIFFERENCE_PRIORS = 3.0  # prior widths by which a parameter of the same machine differs at most
# relative difference of a parameter that counts; inexact forms of effects make smaller differences
LEAST_PARAMETER_DIFFERENCE = 0.02


@dataclass(frozen=True, eq=False)
class SizeInReal:
    """Size of a simulator's effect in the real runs, in the same form."""

    parameters: tuple[EffectParameter, ...]
    differs: bool  # whether the size differs from the simulator's beyond both errors
    shows: bool  # whether the real runs show the effect


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Effects of both sides, fitted to the real runs together."""

    of_simulator: dict[str, SizeInReal]  # by effect of the simulator
    shown_in_both: tuple[str, ...]  # further effects of the real runs that the simulated runs show as much of

    @property
    def differing(self) -> list[str]:
        """Effects of the simulator with a different size in the real runs."""
        return [name for name, size in self.of_simulator.items() if size.differs]

    @property
    def alike(self) -> set[str]:
        """Effects of equal size in both, which are no gap."""
        return {name for name, size in self.of_simulator.items() if not size.differs}.union(self.shown_in_both)


def side_by_side(records: Sequence[Record], nominal: NominalOfSimulator, named: Sequence[Candidate]) -> SideBySide:
    """Fit the simulator's effects to real runs, together with the effects named beyond them, and compare the sizes."""
    simulator_candidates = [effect.candidate for effect in nominal.effects]
    simulator_names = {name for name, _ in simulator_candidates}
    further_candidates = [candidate for candidate in named if candidate[0] not in simulator_names]
    hypothesis = [*simulator_candidates, *further_candidates]
    evidence = Evidence(records, nominal.plain, only=hypothesis)
    if not hypothesis or not evidence.stack.rows:
        return SideBySide({}, ())
    fit = evidence.settle(hypothesis)
    in_real = {effect.name: effect for effect in known_effects(evidence, fit, hypothesis)}
    sizes = {
        effect.name: SizeInReal(
            effect_parameters(evidence, fit, effect.candidate), effect.differs_from(real), real.shows
        )
        for effect in nominal.effects
        if (real := in_real.get(effect.name)) is not None and real.coefficients == effect.coefficients
    }
    in_simulated = effects_in_simulator(nominal, further_candidates)
    shown_in_both = [
        name
        for name, _ in further_candidates
        if name in in_real and name in in_simulated and not outgrows(in_real[name], in_simulated[name])
    ]
    return SideBySide(sizes, tuple(shown_in_both))


def side_by_side_in_free_runs(nominal: NominalOfSimulator, answer_without_effects: DiagnosisResult) -> SideBySide:
    """Compare the simulator's effects with those of a servo's real runs, by the first parameter of each.

    The real runs were diagnosed against the simulator's parameters without its effects.
    """
    real_parameters_of = {
        cause.effect: cause.parameters
        for cause in answer_without_effects.causes
        if cause.probability >= NAMED_PROBABILITY
    }
    sizes = {}
    for cause in nominal.causes:
        simulated_parameters, real_parameters = cause.parameters, real_parameters_of.get(cause.effect, ())
        differs = not real_parameters
        if simulated_parameters and real_parameters:
            tolerance = max(
                ENTRY_HEIGHT * math.hypot(simulated_parameters[0].std, real_parameters[0].std),
                math.sqrt(FORM_ERROR) * abs(simulated_parameters[0].value),
            )
            differs = abs(real_parameters[0].value - simulated_parameters[0].value) > tolerance
        sizes[cause.effect] = SizeInReal(real_parameters, differs, bool(real_parameters))
    return SideBySide(sizes, ())


def effects_in_simulator(nominal: NominalOfSimulator, candidates: Sequence[Candidate]) -> dict[str, KnownEffect]:
    """Fit further forms of effects to the simulated runs, less the simulator's known effects; return them by name."""
    if not candidates:
        return {}
    evidence = Evidence(records_without(nominal.records, nominal.effects), nominal.model, only=candidates)
    effects = known_effects(evidence, evidence.settle(candidates), candidates) if evidence.stack.rows else ()
    return {effect.name: effect for effect in effects}


def outgrows(real: KnownEffect, simulated: KnownEffect) -> bool:
    """Return whether the real runs alone show an effect, or show `ENTRY_HEIGHT` times the simulated runs' size."""
    return not simulated.shows or real.size > ENTRY_HEIGHT * simulated.size


def without_shared_causes(answer: DiagnosisResult, comparison: SideBySide, parameters_differ: bool) -> DiagnosisResult:
    """Return the answer without the causes that the simulator shares, and with the verdict that follows.

    If no cause is named, a parameter or a size of a simulator's effect that differs beyond both errors asks for
    calibration.
    """
    causes = tuple(cause for cause in answer.causes if cause.effect not in comparison.alike)
    verdict = verdict_of(causes, answer.unexplained_probability, parameters_differ or bool(comparison.differing))
    notes = tuple(f"not named: {name}; the simulated runs show as much of it" for name in comparison.shown_in_both)
    return replace(answer, causes=causes, verdict=verdict, notes=(*notes, *answer.notes))


def compared_parameters(
    nominal: NominalOfSimulator, real: Sequence[CalibratedParameter]
) -> tuple[EffectiveParameter, ...]:
    """Return each parameter of the simulator beside its value in the real runs."""
    fitted = {item.parameter: item for item in real}
    return tuple(_parameter(nominal, item, fitted.get(item.parameter)) for item in nominal.parameters)


def _parameter(
    nominal: NominalOfSimulator, simulated: CalibratedParameter, real: CalibratedParameter | None
) -> EffectiveParameter:
    """Return a parameter of both sides, and whether it differs beyond both errors and `LEAST_PARAMETER_DIFFERENCE`."""
    start = nominal_value(nominal.start, simulated.parameter)
    differs = False
    if real is not None and not (real.not_told_by_these_runs or simulated.not_told_by_these_runs):
        tolerance = max(
            ENTRY_HEIGHT * math.hypot(real.std, simulated.std), LEAST_PARAMETER_DIFFERENCE * abs(simulated.fitted)
        )
        differs = abs(real.fitted - simulated.fitted) > tolerance
    return EffectiveParameter(
        simulated.parameter,
        simulated.nominal if start is None else start,
        simulated.fitted,
        simulated.std,
        None if real is None else real.fitted,
        None if real is None else real.std,
        differs,
        simulated.units,
    )


def simulator_effects(
    nominal: NominalOfSimulator, comparison: SideBySide, faults: Sequence[SetUpFault]
) -> tuple[SimulatorEffect, ...]:
    """Return the simulator's faults of the set-up and its effects, and how the real runs have them."""
    real_faults = {(fault.name, fault.key) for fault in faults}
    effects = [
        SimulatorEffect(
            fault.name,
            "alike" if (fault.name, fault.key) in real_faults else "absent",
            _sizes(fault.parameters),
            fault.peers,
        )
        for fault in nominal.faults
    ]
    for cause in nominal.causes:
        size = comparison.of_simulator.get(cause.effect)
        sizes = _sizes(cause.parameters, size.parameters if size is not None else ())
        effects.append(SimulatorEffect(cause.effect, _presence(size), sizes, cause.indistinguishable_from))
    return tuple(effects)


def _presence(size: SizeInReal | None) -> Presence:
    """Return how the real runs have an effect of the simulator; `size` is None if it was not fitted to them."""
    if size is None:
        return "not asked"
    if not size.differs:
        return "alike"
    return "differs" if size.shows else "absent"


def _sizes(simulated: Sequence[EffectParameter], real: Sequence[EffectParameter] = ()) -> tuple[SizeInBoth, ...]:
    real_by_name = {parameter.name: parameter for parameter in real}
    return tuple(_size_in_both(parameter, real_by_name.get(parameter.name)) for parameter in simulated)


def _size_in_both(simulated: EffectParameter, real: EffectParameter | None) -> SizeInBoth:
    real_value, real_std = (None, None) if real is None else (real.value, real.std)
    return SizeInBoth(simulated.name, simulated.value, simulated.std, real_value, real_std, simulated.units)


def shared_faults(nominal: NominalOfSimulator, faults: Sequence[SetUpFault]) -> tuple[str, ...]:
    """Return notes on faults of the set-up that both sides have."""
    simulator_faults = {(fault.name, fault.key) for fault in nominal.faults}
    return tuple(
        f"both sides have it, so it is not named: {fault.note()}"
        for fault in faults
        if (fault.name, fault.key) in simulator_faults
    )


def other_machine_notes(calibration: Sequence[CalibratedParameter]) -> tuple[str, ...]:
    """Return a note if fitted parameters of the real runs differ by more from the simulator's than one machine's do."""
    departures = [
        f"{item.parameter} is {item.fitted / item.nominal:.3g} times the simulator's"
        for item in calibration
        if item.parameter in PRIORS
        and item.has_ratio
        and abs(item.fitted / item.nominal - 1.0) > MOST_DIFFERENCE_PRIORS * PRIORS[item.parameter]
    ]
    return (f"is this the same machine? {', '.join(departures)}",) if departures else ()
