"""Diagnosis of a case: calibrate the model, search for effects, judge them, and measure the gap on held-out runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from leactl.effects import library
from leactl.errors import InputError
from leactl.gap.diagnosis import CalibratedParameter, Cause, DiagnosisResult, EffectParameter
from leactl.gap.fitted_load import with_fitted_load
from leactl.gap.null import measure, set_floors, with_simulator_runs, without_imitated_members
from leactl.gap.open_forms import across_open_form, nearest_to_runs
from leactl.gap.planning.separating import separating_experiment
from leactl.gap.replay.long_runs import read_records
from leactl.gap.search import effect_sets
from leactl.gap.search.confirm import HeldOutGain, held_out_gains
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.effect_sets import EffectSet, search
from leactl.gap.search.parameters import (
    calibrated_parameters,
    effect_parameters,
    next_linearisation,
    with_calibration,
    with_effects,
)
from leactl.gap.search.regression import Candidate, Fit, Rows
from leactl.gap.search.ringing import Line, highest_lines
from leactl.gap.search.stamp_fit import MOST_STAMP_DELAY
from leactl.gap.servo import answer as servo_answer
from leactl.gap.servo.effect_sets import fit_effect_sets
from leactl.gap.servo.runs import runs_at_common_rate
from leactl.gap.setup import SetUpFault, find_and_mend_faults
from leactl.gap.setup.conventions import convention
from leactl.gap.setup.signs_and_scales import SCALE
from leactl.gap.signals.record import Record
from leactl.gap.signals.rig import DRIVE_CHANNELS, RIG_ENTRIES, VOLTAGE_KIND, Array
from leactl.gap.signals.setpoints import mark_setpoints, setpoint_notes
from leactl.gap.signals.stamps import stamp_notes, stamped
from leactl.gap.verdict.decision import LISTED_PROBABILITY, NAMED_PROBABILITY, UNKNOWN_PROBABILITY, verdict_of
from leactl.gap.verdict.judge import (
    Judged,
    RunRatios,
    Unexplained,
    is_left_by_form,
    judge,
    unexplained_in_a_run,
    unexplained_in_channels,
    unexplained_in_held_out,
    unrest,
    unrest_of_runs,
)
from leactl.gap.verdict.notes import condition_notes, null_notes, questions, reading_notes
from leactl.gap.verdict.picture import draw_pictures, draw_pictures_of_replays
from leactl.gap.verdict.replay_gap import unexplained_in_replays
from leactl.gap.verdict.separation import RuledOut, nearest_of_classes, without_ruled_out
from leactl.gap.verdict.shrinkage import SquaresRatio, shrinkage, simulate_again, squares_ratio
from leactl.gap.verdict.unknown import describe, nearest_effects
from leactl.gap.verdict.where import profiles, where
from leactl.gap.verdict.withdrawal import Applied, FittedEffects, Refit, apply
from leactl.model.nominal import BenchModel, Model, read_model
from leactl.vocabulary.effect import effect_definition

MOST_UNEXPLAINED_SHARE = (
    0.2  # residual beyond noise over the squares that a set explains, above which no effect is named
)
LEAST_CALIBRATION_GAIN = 25.0  # weighted squares that calibration must gain for the verdict `calibration`
COURSE_POINTS = 64  # points of a voltage course
SAME_COURSE_COSINE = 0.95  # cosine of two voltage courses above which they are the same; a ramp and a step have 0.87
FURTHER_STEPS = 2  # Gauss-Newton steps after the first: most effects multiply parameters that are calibrated
Progress = Callable[[str], None]
ParametersOfSet = tuple[dict[str, tuple[EffectParameter, ...]], tuple[CalibratedParameter, ...]]
Channel = tuple[str, str, str]  # equation, quantity and set-up; of a compared channel quantity, role and set-up


@dataclass
class Case:
    """Runs to fit, runs held out, and the model."""

    model: Model
    fitted: list[Record]
    held_out: list[Record]
    simulated: list[Record] = field(default_factory=list)  # runs of the simulator whose nominal the model is
    unexplained: dict[Channel, float] = field(default_factory=dict)
    """Root mean square of the simulator's residual beyond its own floor, in the channel's units."""
    nominal: Model | None = None  # model that nominal gaps are measured from; `model` where None

    def replayed(self) -> list[Record]:
        """Return the runs to simulate again: the held-out runs, and the fitted runs of kinds without a held-out run."""
        kinds_held_out = {(record.kind, record.mechanical) for record in self.held_out}
        return [
            *self.held_out,
            *(record for record in self.fitted if (record.kind, record.mechanical) not in kinds_held_out),
        ]

    def of_records(self, records: Sequence[Record]) -> "Case":
        """Return the case with other records: the first `len(self.fitted)` are fitted, the following ones held out."""
        count = len(self.fitted)
        return replace(self, fitted=list(records[:count]), held_out=list(records[count:]))


def read_case(runs: Sequence[Path], held_out: Sequence[Path], model: Path) -> Case:
    """Return a case from its run files and model file; without held-out runs, some runs or stretches are held out.

    Raises
    ------
    InputError : there is no run, a file cannot be used, or a run is both fitted and held out; one line for each.
    """
    if not runs:
        raise InputError("no run to diagnose; give one run file or more")
    faults: list[str] = []
    on_both_sides = {path.resolve() for path in runs} & {path.resolve() for path in held_out}
    faults += [f"{path}: is both fitted and held out; a run can be on one side only" for path in sorted(on_both_sides)]
    nominal: Model | None = None
    try:
        nominal = read_model(model)[0]
    except InputError as error:
        faults += error.faults
    read: dict[Path, list[Record]] = {}
    try:
        read = read_records([*runs, *held_out], BenchModel() if nominal is None else nominal.bench)
    except InputError as error:
        faults += error.faults
    if faults or nominal is None:
        raise InputError(faults)
    fitted_records, held_out_records = (
        [record for path in paths for record in read[path]] for paths in (runs, held_out)
    )
    if not held_out_records:
        fitted_records, held_out_records = hold_out_runs(fitted_records)
    return Case(nominal, fitted_records, held_out_records)


def hold_out_runs(records: list[Record]) -> tuple[list[Record], list[Record]]:
    """Return fitted and held-out records: the last run of every kind that occurs twice is held out.

    If no kind occurs twice, stretches of every run are held out.
    """
    paths_by_kind: dict[object, list[Path]] = {}
    courses: list[Array] = []
    first_records: dict[Path, Record] = {}  # of each run; a long run has several records
    for record in records:
        first_records.setdefault(record.path, record)
    for path, record in first_records.items():
        rig = tuple(record.setup.get(name) for name in RIG_ENTRIES)
        paths_by_kind.setdefault((record.kind, record.mechanical, rig, course_index(record, courses)), []).append(path)
    held_out_paths = [paths[-1] for paths in paths_by_kind.values() if len(paths) > 1]
    if held_out_paths:
        return [record for record in records if record.path not in held_out_paths], [
            record for path in held_out_paths for record in records if record.path == path
        ]
    fitted, held_out = zip(*(record.hold_out_stretches() for record in records), strict=True)
    return list(fitted), list(held_out)


def course_index(record: Record, courses: list[Array]) -> int:
    """Return the index in `courses` of the voltage course that a run follows up to scale; -1 if no voltage drives it.

    A course that matches none of `courses` is appended to them. Logs of WPILib give all their tests the same name, and
    a ramp in one direction does not predict a step in the other.
    """
    clock = record.fast
    volts = clock.get("q_axis_voltage") if clock is not None else None
    if clock is None or volts is None or any(clock.get(name) is not None for name in DRIVE_CHANNELS):
        return -1
    course = np.interp(np.linspace(0.0, len(volts) - 1.0, COURSE_POINTS), np.arange(len(volts)), volts)
    course /= max(float(np.linalg.norm(course)), np.finfo(np.float64).tiny)
    matches = [index for index, known_course in enumerate(courses) if float(course @ known_course) > SAME_COURSE_COSINE]
    courses += [] if matches else [course]
    return matches[0] if matches else len(courses) - 1


def diagnose(case: Case, progress: Progress = lambda _: None) -> DiagnosisResult:
    """Return the diagnosis of a case: faults of the set-up are mended first, then the mended runs searched for effects.

    Causes come from the fitted runs alone, the shrinkage of the gap from the held-out runs. Faults of the set-up are
    searched in all runs, since each run may have its own. A fault that is recognised by comparing a channel with the
    model is not named if the mended runs stay unexplained and an effect explains them without that mend: a strong
    spring may look like a factor. Nor is one that `is_refuted`.

    Raises
    ------
    InputError : the runs hold nothing that any equation of the model can be checked with.
    """
    progress("looking for faults of the set-up")
    faults, mended_case = mend_faults(case)
    diagnosis = diagnose_mended(mended_case, faults, progress)
    uncertain_faults = [fault for fault in faults if fault.shrinks]
    if not uncertain_faults or diagnosis.unexplained_probability < UNKNOWN_PROBABILITY:
        return diagnosis
    unmended_diagnosis = diagnose_without_mends(case, faults, uncertain_faults, progress)
    if unmended_diagnosis is None:
        return diagnosis
    names_an_effect = any(
        cause.family != "setup" and cause.probability >= NAMED_PROBABILITY for cause in unmended_diagnosis.causes
    )
    if names_an_effect and unmended_diagnosis.unexplained_probability < UNKNOWN_PROBABILITY:
        reason = "an effect explains the runs without mending it"
        return with_unnamed_faults(unmended_diagnosis, uncertain_faults, reason)
    refuted_faults = [fault for fault in uncertain_faults if is_refuted(fault, diagnosis)]
    if refuted_faults != uncertain_faults:
        unmended_diagnosis = diagnose_without_mends(case, faults, refuted_faults, progress) if refuted_faults else None
    reason = "what is left of its channel once it is mended follows another law"
    return with_unnamed_faults(unmended_diagnosis, refuted_faults, reason) if unmended_diagnosis else diagnosis


def diagnose_without_mends(
    case: Case, faults: Sequence[SetUpFault], dropped_faults: Sequence[SetUpFault], progress: Progress
) -> DiagnosisResult | None:
    """Return the diagnosis without the mends of some faults; None where no equation can be checked then."""
    kept_faults, records = [fault for fault in faults if fault not in dropped_faults], [*case.fitted, *case.held_out]
    for fault in kept_faults:
        records = [fault.mend(record) for record in records]
    try:
        return diagnose_mended(case.of_records(records), kept_faults, progress)
    except InputError:
        return None


def is_refuted(fault: SetUpFault, diagnosis: DiagnosisResult) -> bool:
    """Return whether a scaled channel stays unexplained once it is mended, and no convention has its factor.

    A channel in another unit is exact once it is mended; a dead band of a drive has a mean factor, too.
    """
    rest = diagnosis.unexplained
    factors = [parameter for parameter in fault.parameters if parameter.name == "factor"]
    return (
        fault.name == SCALE
        and rest is not None
        and (rest.quantity, rest.role) == (fault.key[0].removesuffix("_reference"), fault.key[1])
        and not any(convention(factor.value, factor.std / abs(factor.value)) for factor in factors)
    )


def with_unnamed_faults(diagnosis: DiagnosisResult, faults: Sequence[SetUpFault], reason: str) -> DiagnosisResult:
    """Return a diagnosis with a note on each fault that is not named, and the reason."""
    not_named = tuple(f"not named: {fault.name}; {reason}" for fault in faults)
    return replace(diagnosis, notes=(*not_named, *diagnosis.notes))


def mend_faults(case: Case) -> tuple[list[SetUpFault], Case]:
    """Return the faults of the set-up that the runs of a case show, and the case with mended runs."""
    faults, records = find_and_mend_faults([*case.fitted, *case.held_out], case.model, len(case.held_out))
    return faults, case.of_records(records) if faults else case


def diagnose_mended(case: Case, faults: Sequence[SetUpFault], progress: Progress) -> DiagnosisResult:
    """Return the diagnosis of the effects in mended runs, with the faults of the set-up as the first causes.

    Raises
    ------
    InputError : there is no fault, and no equation of the model can be checked with the runs.
    """
    if not faults:
        return diagnose_effects(case, progress)
    try:
        diagnosis = diagnose_effects(case, progress)
    except InputError as error:  # without the channel at fault nothing can be checked: the fault is the answer
        details = {"calibrated": case.model, "augmented": case.model, "traces": (), "profiles": ()}
        diagnosis = DiagnosisResult("none", 0.0, notes=tuple(error.faults), extra=details)
    causes = tuple(fault.as_cause() for fault in faults) + diagnosis.causes
    notes = tuple(fault.note() for fault in faults)
    return replace(diagnosis, verdict="effect", causes=causes, notes=(*notes, *diagnosis.notes))


def diagnose_effects(case: Case, progress: Progress) -> DiagnosisResult:
    """Return the diagnosis of the effects in runs whose channels are what their descriptions say.

    Raises
    ------
    InputError : the runs hold nothing that any equation of the model can be checked with.
    """
    progress("reading equations")
    case = case.of_records(mark_setpoints([*case.fitted, *case.held_out], case.model))
    model_with_load, load_parameters = with_fitted_load(case.fitted, case.model)
    if load_parameters:
        case = replace(case, model=model_with_load, nominal=case.nominal or case.model)
    evidence = Evidence(case.fitted, case.model)
    if not evidence.stack.rows:
        raise InputError(
            "no equation of the model can be checked with these runs: a diagnosis needs the angle and the q-axis"
            " current of a moving run, voltage and current, or temperatures and heat"
        )
    progress("measuring sound machines")
    null = measure(case.fitted, case.model)
    if case.simulated:
        null = with_simulator_runs(null, case.simulated, case.model)
    set_floors(evidence, null)
    progress("searching effects")
    searched = without_imitated_members(evidence, search(evidence))
    progress("trying them on held-out runs")
    servo_runs = servo_answer.judged_by_runs(case.model, case.fitted)
    gains, judgements = judged_on_held_out(case, evidence, searched)
    set_notes: tuple[str, ...] = ()
    if any(judgement.peers for judgement in judgements) and not servo_runs:
        nearest, ruled_out = separate_classes(case, evidence, searched, judgements)
        if nearest is not searched:
            searched = nearest
            gains, judgements = judged_on_held_out(case, evidence, searched)
        judgements = [without_ruled_out(judgement, ruled_out) for judgement in judgements]
        set_notes = tuple(effect.note() for effect in ruled_out)
    in_sound_noise = weighed_by_sound_noise(evidence, searched)
    unrest_by_run, lines = unrest_and_lines(evidence, in_sound_noise)
    unrest_by_channel = unrest(unrest_by_run)
    strongest_sign = unexplained_in_channels(unrest_by_channel, lines)
    causes = causes_of(evidence, searched, judgements)
    calibrated_alone = calibrated_parameters(evidence, evidence.settle([]))
    members = {judgement.finding.effect for judgement in judgements}
    refit: Refit = partial(refit_causes, evidence, searched)
    if servo_runs:
        progress("fitting free runs of the servo")
        free_runs = runs_at_common_rate(case.fitted, case.model)
        fitted_sets = fit_effect_sets(free_runs, case.held_out, case.model, searched.hypothesis)
        calibrated_alone = servo_answer.calibration(case.model, fitted_sets.calibrated, {})
        parameters = servo_answer.calibration(case.model, fitted_sets.augmented, fitted_sets.stds)
        causes = servo_answer.causes(fitted_sets, causes, free_runs, with_calibration(case.model, parameters))
        members |= {effect.effect for effect in fitted_sets.standing}
        calibrated_alone = calibrated_alone if fitted_sets.standing else parameters
        refit = partial(with_servo_calibration, parameters)
        records_left_out = [record for record in case.fitted if record not in free_runs]
        set_notes = servo_answer.rig_note(fitted_sets, case.model.load.type == "pendulum", records_left_out)
    else:
        doubts = doubts_by_residual(evidence, in_sound_noise, causes, strongest_sign, (unrest_by_channel, lines))
        set_notes += tuple(f"not named: {name}; {reason}" for name, reason in doubts.items() if name in members)
        trust = 1.0 - strongest_sign.probability
        causes = tuple(
            replace(cause, probability=cause.probability * trust) if cause.effect in doubts else cause
            for cause in causes
        )
    named_causes = [cause for cause in causes if cause.probability >= NAMED_PROBABILITY and cause.effect in members]
    progress("simulating again")
    lateness = evidence.lateness(searched.fit)
    replayed = [stamped(record, lateness) for record in case.replayed()]
    if servo_runs:
        replayed = servo_answer.with_delayed_references(replayed, case.model, fitted_sets.reference_delay)
    applied = apply(
        case.model,
        calibrated_alone,
        [[cause] for cause in named_causes],
        refit,
        lambda calibrated, augmented: shrinkage(
            replayed, case.nominal or case.model, calibrated, augmented, unexplained=case.unexplained
        ),
        bounded_fit=not servo_runs,
        borne_out_by_equations={effect for (effect, _), gain in gains.items() if gain.least > 0.0 and not servo_runs},
    )
    shrunk = applied.shrunk
    causes = confirmed_causes(causes, applied)
    if servo_runs:
        strongest_sign = unexplained_in_channels(servo_answer.angle_error_ratios(shrunk.shrinkage, replayed), {})
        is_off = strongest_sign.probability >= UNKNOWN_PROBABILITY  # then a withdrawn calibration may tell why
        implausible = servo_answer.implausible_calibration(parameters if is_off else applied.fitted.calibration)
        strongest_sign = implausible if implausible.probability else strongest_sign
    gap_regions = where(replayed, shrunk.channels, applied.fitted.causes)
    notes = condition_notes(case.fitted, case.held_out) + reading_notes([*case.fitted, *case.held_out])
    if {record.path for record in case.held_out} & {record.path for record in case.fitted}:
        notes += ("no kind of run occurs twice: held out are two sixteenths of each run",)
    calibrates = bool(load_parameters) or (
        not applied.first_calibration_withdrawn and calibration_gains(evidence, searched)
    )
    applied_effects = {cause.effect for cause in applied.fitted.causes}
    applied_forms = [candidate for candidate in searched.hypothesis if candidate[0] in applied_effects]
    # what the withdrawn members explained is unexplained again
    if len(applied_forms) < len(searched.hypothesis) and not servo_runs:
        applied_set = weighed_by_sound_noise(evidence, effect_sets.describe(evidence, list(applied_forms)))
        unrest_by_run, lines = unrest_and_lines(evidence, applied_set)
        strongest_sign = max(
            strongest_sign, unexplained_in_channels(unrest(unrest_by_run), lines), key=lambda sign: sign.probability
        )
    if not (applied_forms or servo_runs) and strongest_sign.probability < UNKNOWN_PROBABILITY:
        signs_in_runs = (
            unexplained_in_a_run(unrest_by_run),
            unexplained_in_held_out(evidence, applied_forms, case.held_out),
            unexplained_in_replays(shrunk.shrinkage, replayed, applied.augmented),
        )
        strongest_sign = max(strongest_sign, *signs_in_runs, key=lambda sign: sign.probability)
    alternatives = [rival.candidate for judgement in judgements for rival, _ in judgement.rivals]
    causes = draw_pictures(causes, evidence, applied_forms, alternatives, case.held_out)
    causes = draw_pictures_of_replays(causes, applied.fitted.causes, replayed, shrunk.channels)
    unexplained_notes, unexplained_part = tuple[str, ...](), None
    if strongest_sign.probability >= UNKNOWN_PROBABILITY:
        progress("describing what is left")
        refused_effects = nearest_effects(searched, judgements, applied.refused)
        unexplained_notes = (strongest_sign.note,)
        unexplained_part = describe(evidence, applied_forms, strongest_sign.channel, case.held_out, refused_effects)
    return DiagnosisResult(
        verdict_of(causes, strongest_sign.probability, calibrates),
        strongest_sign.probability,
        gap_regions,
        (*applied.fitted.calibration, *load_parameters),
        causes,
        shrunk.shrinkage,
        tuple(
            dict.fromkeys(
                unexplained_notes
                + set_notes
                + applied.notes
                + notes
                + stamp_notes(lateness, evidence.on_time, MOST_STAMP_DELAY)
                + setpoint_notes(case.fitted)
                + null_notes(evidence, null)
                + shrunk.notes
                + questions(case.model, case.fitted, evidence, servo_runs)
            )
        ),
        unexplained_part,
        {
            "calibrated": applied.calibrated,
            "augmented": applied.augmented,
            "standing": tuple(applied_forms),
            "traces": shrunk.traces,
            "profiles": profiles(replayed, shrunk.channels, gap_regions),
        },
    )


def judged_on_held_out(
    case: Case, evidence: Evidence, searched: EffectSet
) -> tuple[dict[Candidate, HeldOutGain], list[Judged]]:
    """Return the gain of each member of a set on the held-out runs, and the judgement of each member."""
    gains = dict(zip(searched.hypothesis, held_out_gains(evidence, searched.hypothesis, case.held_out), strict=True))
    return gains, judge(
        evidence, searched, {candidate: held_out_gain.gain for candidate, held_out_gain in gains.items()}
    )


def separate_classes(
    case: Case, evidence: Evidence, searched: EffectSet, judgements: Sequence[Judged]
) -> tuple[EffectSet, list[RuledOut]]:
    """Return the set with the effect of each class that fits the held-out runs best, and the effects ruled out."""
    lateness = evidence.lateness(searched.fit)
    replayed = [stamped(record, lateness) for record in case.replayed()]

    @cache
    def model_of(hypothesis: tuple[Candidate, ...]) -> Model:
        """Return the model with a set, fitted once for each set."""
        return model_with(case.model, evidence, hypothesis)

    def compare(first_set: Sequence[Candidate], second_set: Sequence[Candidate]) -> SquaresRatio:
        """Return the squared gap with the second set over that with the first."""
        first_model, second_model = model_of(tuple(first_set)), model_of(tuple(second_set))
        random = np.random.default_rng(0)
        # `squares_ratio` compares the second and the third model
        _, channels = simulate_again(replayed, (first_model, first_model, second_model), random, case.unexplained)
        return squares_ratio(channels, random)

    hypothesis, ruled_out = nearest_of_classes(searched.hypothesis, judgements, compare)
    nearest_set = searched
    if hypothesis != searched.hypothesis:
        nearest_set = effect_sets.describe(evidence, hypothesis)
        if {effect for effect, _ in nearest_set.hypothesis} != {effect for effect, _ in hypothesis}:
            nearest_set, ruled_out = searched, []  # beside the other members the better effect does not enter the set
    evidence.settle(nearest_set.hypothesis)
    return nearest_set, ruled_out


def model_with(model: Model, evidence: Evidence, hypothesis: Sequence[Candidate]) -> Model:
    """Return the model with the effects of a set and its calibration, both fitted to the runs of `evidence`."""
    return model_of_fit(model, *fit_with_further_steps(evidence, hypothesis))


def weighed_by_sound_noise(evidence: Evidence, effect_set: EffectSet) -> EffectSet:
    """Return a set with its squares, taken and left, weighted by a sound machine's noise where that is lower."""
    squares_taken, squares_left = effect_sets.squares_taken_and_left(evidence, effect_set.hypothesis, sound_noise=True)
    return replace(effect_set, squares_taken=squares_taken, squares_left=squares_left)


def unrest_and_lines(evidence: Evidence, effect_set: EffectSet) -> tuple[RunRatios, dict[Channel, Line]]:
    """Return the unrest of each channel by run under a set, and the lines in the spectra of its residuals."""
    searched_rows = [not is_left_by_form(effect_set, index) for index in range(len(evidence.stack.rows))]
    lines = highest_lines(evidence, evidence.settle(effect_set.hypothesis), searched_rows)
    return unrest_of_runs(evidence, effect_set), lines


def doubts_by_residual(
    evidence: Evidence,
    effect_set: EffectSet,
    causes: Sequence[Cause],
    strongest_sign: Unexplained,
    signs_by_channel: tuple[Mapping[Channel, float], Mapping[Channel, Line]],
) -> dict[str, str]:
    """Return the causes that an unexplained residual puts in doubt, by effect, with the reason.

    signs_by_channel : unrest and highest spectral line of each channel.
    """
    effects = [cause.effect for cause in causes]
    if is_outweighed(evidence, effect_set, *signs_by_channel):
        return dict.fromkeys(effects, "too much is left beside what it explains")
    if (
        strongest_sign.probability < UNKNOWN_PROBABILITY
        or strongest_sign.channel is None
        or strongest_sign.channel[0] != "current"
    ):
        return {}
    # a limit alone says what the current is: a residual of the current shows another law
    reason = "a limit of the drive would leave nothing of the current unexplained"
    return dict.fromkeys((effect for effect in effects if library()[effect].limits_current), reason)


def is_outweighed(
    evidence: Evidence, effect_set: EffectSet, unrest_by_channel: Mapping[Channel, float], lines: Mapping[Channel, Line]
) -> bool:
    """Return whether the unexplained residual is so large that what a set explains may be a part of it.

    Two residuals are ignored. The velocity of a motor fed with a voltage is the controller's own estimate, and enters
    no balance. The angle of a locked rotor is undetermined within a play, where friction holds it at any torque: its
    residual may be as large as the play itself.
    """
    equations_ignored = {
        rows.equation
        for rows in evidence.stack.rows
        if rows.equation == "lock"
        or (
            rows.kind == VOLTAGE_KIND
            and rows.equation == "velocity"
            and not holds_column_of(rows, effect_set.hypothesis)
        )
    }
    judged_unrest = {key: ratio for key, ratio in unrest_by_channel.items() if key[0] not in equations_ignored}
    judged_lines = {key: line for key, line in lines.items() if key[0] not in equations_ignored}
    squares_taken, squares_left = (
        sum(
            amount
            for amount, rows in zip(amounts, evidence.stack.rows, strict=True)
            if rows.equation not in equations_ignored
        )
        for amounts in (effect_set.squares_taken, effect_set.squares_left)
    )
    total_gain = sum(member.gain for member in effect_set.members) or 1.0
    allowed_share = (
        sum(allowed_residual_share(member.effect) * member.gain for member in effect_set.members) / total_gain
    )
    return (
        unexplained_in_channels(judged_unrest, judged_lines).probability >= UNKNOWN_PROBABILITY
        and squares_left > allowed_share * squares_taken
    )


def allowed_residual_share(effect: str) -> float:
    """Return the residual an effect may leave, as a share of the squares it explains; more if its columns are loose."""
    explains = library()[effect].explains
    return (1.0 - explains) / explains if explains < effect_sets.LOOSE_SHARE else MOST_UNEXPLAINED_SHARE


def holds_column_of(rows: Rows, hypothesis: Sequence[Candidate]) -> bool:
    """Return whether the rows hold a column of any effect of a set."""
    effect_forms = {(effect, repr(form)) for effect, form in hypothesis}
    return any(name[0] == "effect" and (name[1], name[2]) in effect_forms for name in rows.columns)


def refit_causes(evidence: Evidence, effect_set: EffectSet, causes: Sequence[Cause]) -> FittedEffects:
    """Return the members of a set that some causes name, fitted without the other members."""
    causes_by_effect = {cause.effect: cause for cause in causes}
    hypothesis = [candidate for candidate in effect_set.hypothesis if candidate[0] in causes_by_effect]
    parameters, calibration = fit_with_further_steps(evidence, hypothesis)
    return FittedEffects(
        tuple(replace(causes_by_effect[name], parameters=values) for name, values in parameters.items()), calibration
    )


def fit_with_further_steps(evidence: Evidence, hypothesis: Sequence[Candidate]) -> ParametersOfSet:
    """Return the parameters of each effect by name, and the calibration, after `FURTHER_STEPS` Gauss-Newton steps.

    Where the equations leave a form open, replays of the fitted runs choose it.
    """
    fits = [fit_in_steps(evidence, hypothesis, refines_forms=True)]
    if variants := across_open_form(evidence, hypothesis):
        # refining would bring each moved form back to the best one
        fits += [fit_in_steps(evidence, variant, refines_forms=False) for variant in variants]
        models = [model_of_fit(evidence.model, *fit) for fit in fits]
        return fits[nearest_to_runs(evidence, hypothesis, models)]
    return fits[0]


def fit_in_steps(evidence: Evidence, hypothesis: Sequence[Candidate], refines_forms: bool) -> ParametersOfSet:
    """Return the parameters of each effect by name, and the calibration, after `FURTHER_STEPS` Gauss-Newton steps.

    Each step rebuilds the columns from the calibrated parameters. With a camera that reads two thirds of a rise, heat
    flows are 4 % off after the first fit; with an inertia 15 % off, so is an eccentricity.

    refines_forms : whether each step searches better forms nearby.
    """
    evidence.add(hypothesis)
    fit = evidence.settle(hypothesis)
    parameters = calibrated_parameters(evidence, fit)
    nominal = {item.parameter: item.nominal for item in parameters}
    for _ in range(FURTHER_STEPS):
        hypothesis = [next_linearisation(evidence, fit, candidate) for candidate in hypothesis]
        # the ambient's offset stays at the model's value: its prior is in kelvin around that
        relative_parameters = [item for item in parameters if item.parameter != "ambient_offset"]
        evidence = evidence.on(evidence.records, hypothesis, with_calibration(evidence.model, relative_parameters))
        if refines_forms:
            evidence.settle(hypothesis)  # forms are compared under the noise of this fit
            hypothesis = effect_sets.refine(evidence, hypothesis, shapes=False)
        fit = evidence.settle(hypothesis)
        parameters = tuple(
            replace(item, nominal=nominal[item.parameter]) for item in calibrated_parameters(evidence, fit)
        )
    return {candidate[0]: effect_parameters(evidence, fit, candidate) for candidate in hypothesis}, parameters


def model_of_fit(
    model: Model,
    parameters: Mapping[str, Sequence[EffectParameter]],
    calibration: Sequence[CalibratedParameter],
) -> Model:
    """Return the model with fitted effects, each with its parameters by name, and their calibration."""
    effects = [(effect, {item.name: item.value for item in values}) for effect, values in parameters.items()]
    return with_effects(with_calibration(model, calibration), effects)


def with_servo_calibration(calibration: tuple[CalibratedParameter, ...], causes: Sequence[Cause]) -> FittedEffects:
    """Return some causes with the calibration of a servo's free runs, which are fitted with all effects at once."""
    return FittedEffects(tuple(causes), calibration)


def confirmed_causes(causes: Sequence[Cause], applied: Applied) -> tuple[Cause, ...]:
    """Return the causes that held-out runs confirm, with applied parameters, and their alternatives.

    A cause below the probability to be named stays. An alternative stays if an effect that it resembles was applied.
    """
    applied_causes = {cause.effect: cause for cause in applied.fitted.causes}
    return tuple(
        applied_causes.get(cause.effect, cause)
        for cause in causes
        if cause.effect in applied_causes
        or cause.probability < NAMED_PROBABILITY
        or applied_causes.keys() & set(cause.indistinguishable_from)
    )


def causes_of(evidence: Evidence, effect_set: EffectSet, judgements: Sequence[Judged]) -> tuple[Cause, ...]:
    """Return the members of a set and their rivals as causes, the most probable first."""
    total_gain = sum(judgement.finding.gain for judgement in judgements) or 1.0
    causes: dict[str, Cause] = {}
    for judgement in judgements:
        parameters = effect_parameters(evidence, effect_set.fit, judgement.finding.candidate)
        plan = separating_experiment(judgement.finding.effect, judgement.peers)
        share = judgement.finding.gain / total_gain
        causes[judgement.finding.effect] = Cause(
            judgement.finding.effect,
            judgement.probability,
            share,
            parameters,
            tuple(sorted(judgement.peers)),
            plan,
            effect_definition(judgement.finding.effect).family,
        )
    for judgement in judgements:
        for rival, probability in judgement.rivals:
            if probability < LISTED_PROBABILITY or rival.effect in causes:
                continue
            other_members = [
                candidate for candidate in effect_set.hypothesis if candidate != judgement.finding.candidate
            ]
            parameters = parameters_beside(evidence, other_members, rival.candidate)
            joint_probability = judgement.probability if rival.effect in judgement.peers else probability
            peers = (
                tuple(sorted({judgement.finding.effect, *judgement.peers} - {rival.effect}))
                if joint_probability > probability
                else ()
            )
            family = effect_definition(rival.effect).family
            causes[rival.effect] = Cause(rival.effect, joint_probability, 0.0, parameters, peers, family=family)
    members = {judgement.finding.effect for judgement in judgements}
    effects_on_reading = {
        judgement.finding.effect
        for judgement in judgements
        if acts_on_reading_alone(evidence, judgement.finding.candidate)
    }
    # by probability to a hundredth; of equals, those on more than a reading first, then members, then the larger share
    listed_causes = [cause for cause in causes.values() if cause.probability >= LISTED_PROBABILITY]
    ranks = {
        cause.effect: (
            -round(cause.probability, 2),
            cause.effect in effects_on_reading,
            cause.effect not in members,
            -cause.share,
        )
        for cause in listed_causes
    }
    return tuple(sorted(listed_causes, key=lambda cause: ranks[cause.effect]))


def acts_on_reading_alone(evidence: Evidence, candidate: Candidate) -> bool:
    """Return whether an effect acts on the velocity that a controller estimates, and on no balance of the motor."""
    balances = [rows for rows in evidence.stack.rows if rows.kind == VOLTAGE_KIND and rows.equation != "velocity"]
    return bool(balances) and not any(holds_column_of(rows, [candidate]) for rows in balances)


def parameters_beside(evidence: Evidence, others: list[Candidate], candidate: Candidate) -> tuple[EffectParameter, ...]:
    """Return the parameters of an effect fitted beside other effects."""
    fit: Fit = evidence.normal().fit([*others, candidate])
    return effect_parameters(evidence, fit, candidate)


def calibration_gains(evidence: Evidence, effect_set: EffectSet) -> bool:
    """Return whether calibrating the nominal model lowers the misfit by more than `LEAST_CALIBRATION_GAIN`."""
    normal = evidence.normal()
    nuisance_columns = np.asarray([k for k, name in enumerate(evidence.stack.names) if name[0] == "nuisance"], np.intp)
    return normal.solve(nuisance_columns).misfit - effect_set.fit.misfit > LEAST_CALIBRATION_GAIN
