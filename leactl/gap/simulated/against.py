"""Diagnose real runs against a simulator's runs, and the simulator itself against the plain model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from leactl.gap.diagnose import Case, Progress, diagnose_mended, hold_out_runs, mend_faults, read_case
from leactl.gap.diagnosis import DiagnosisResult, SimulatedRun, SimulatorAnswer
from leactl.gap.replay.long_runs import read_records
from leactl.gap.setup import SetUpFault
from leactl.gap.signals.record import Record
from leactl.gap.simulated.comparing import (
    compared_parameters,
    other_machine_notes,
    shared_faults,
    side_by_side,
    side_by_side_in_free_runs,
    simulator_effects,
    without_shared_causes,
)
from leactl.gap.simulated.nominal import NominalOfSimulator, nominal_of
from leactl.gap.simulated.pairing import pair_runs
from leactl.gap.simulated.simulator_effects import records_without


@dataclass
class SimulatedCase:
    """Real runs, and the simulated runs that replace the model."""

    real: Case
    pairs: tuple[SimulatedRun, ...]
    fitted: list[Record]  # of the simulated runs
    held_out: list[Record]  # of the simulated runs
    notes: tuple[str, ...]


def read_simulated_case(
    runs: Sequence[Path], held_out: Sequence[Path], model: Path, simulated: Sequence[Path]
) -> SimulatedCase:
    """Read both sides, and check that every real run has the inputs of its simulated run.

    Raises
    ------
    InputError : files that cannot be used, a real run without a simulated run, or a pair with different inputs.
    """
    case = read_case(runs, held_out, model)
    pairs = pair_runs(list(dict.fromkeys([*runs, *held_out])), list(dict.fromkeys(simulated)))
    kinds = {record.path: record.kind for record in (*case.fitted, *case.held_out)}
    real_by_simulated = {Path(pair.simulated): Path(pair.real) for pair in pairs}
    records_by_path = read_records(list(real_by_simulated), case.model.bench)
    records = [
        replace(record, kind=kinds[real_path])
        for path, real_path in real_by_simulated.items()
        for record in records_by_path[path]
    ]
    unused = [str(path) for path in dict.fromkeys(simulated) if path not in real_by_simulated]
    notes = (f"simulated runs that belong to no real run: {', '.join(unused)}",) if unused else ()
    return SimulatedCase(case, pairs, *hold_out_runs(records), notes)


def diagnose_against(case: SimulatedCase, progress: Progress = lambda _: None) -> DiagnosisResult:
    """Diagnose what real runs have beyond a simulator.

    The simulated runs are diagnosed first, against the model without effects. Their parameters and effects make the
    nominal, and its residual on the simulated runs is added to the floors. An effect that both sides have is not named,
    unless its sizes differ beyond both errors; the real runs are then diagnosed again with a nominal that lacks it.

    Raises
    ------
    InputError : runs that cannot be checked with the model, or simulated runs of another machine.
    """
    nominal = nominal_of(case.fitted, case.held_out, case.real.model, _labelled("simulated runs: ", progress))
    progress = _labelled("real runs: ", progress)
    progress("looking for faults of the set-up")
    faults, mended = mend_faults(replace(case.real, model=nominal.plain))
    simulator_faults = {(fault.name, fault.key) for fault in nominal.faults}
    real_faults = [fault for fault in faults if (fault.name, fault.key) not in simulator_faults]
    answer = _diagnose_beyond(mended, nominal, (), real_faults, progress)
    if nominal.by_free_runs and nominal.causes:
        progress("looking without the simulator's effects")
        answer_without_effects = _diagnose_beyond(
            mended, nominal, [cause.effect for cause in nominal.causes], (), progress
        )
        comparison = side_by_side_in_free_runs(nominal, answer_without_effects)
    else:
        comparison = side_by_side(mended.fitted, nominal, answer.extra.get("standing", ()))
    if differing := comparison.differing:
        progress(f"looking again without the simulator's {', '.join(differing)}")
        answer = _diagnose_beyond(mended, nominal, differing, real_faults, progress)
    parameters = compared_parameters(nominal, answer.calibration)
    answer = without_shared_causes(answer, comparison, any(item.differs for item in parameters))
    notes = (*case.notes, *other_machine_notes(answer.calibration), *shared_faults(nominal, faults))
    simulator = SimulatorAnswer(
        nominal.answer.verdict,
        nominal.answer.unexplained_probability,
        case.pairs,
        parameters,
        simulator_effects(nominal, comparison, faults),
        nominal.floors,
        nominal.answer.notes,
    )
    return replace(answer, notes=(*notes, *answer.notes), simulator=simulator)


def _labelled(label: str, progress: Progress) -> Progress:
    """Return a progress report that puts a label before each step."""
    return lambda step: progress(label + step)


def _diagnose_beyond(
    mended: Case, nominal: NominalOfSimulator, removed: Sequence[str], faults: Sequence[SetUpFault], progress: Progress
) -> DiagnosisResult:
    """Return the diagnosis of real runs against the nominal without the effects in `removed`."""
    effects_in_nominal = [effect for effect in nominal.effects if effect.name not in removed]
    case = Case(
        nominal.without(removed),
        records_without(mended.fitted, effects_in_nominal),
        records_without(mended.held_out, effects_in_nominal),
        records_without(nominal.records, nominal.effects),
        nominal.unexplained,
        nominal.model,
    )
    return diagnose_mended(case, faults, progress)
