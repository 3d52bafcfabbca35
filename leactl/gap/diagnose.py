"""The whole diagnosis: calibrate, search, judge, and measure on held-out runs how far the gap shrinks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from leactl.effects import library
from leactl.errors import InputError
from leactl.gap.diagnosis import CalibratedParameter, Cause, DiagnosisResult, EffectParameter
from leactl.gap.null import confirmed_beside_others, measure, set_floors, with_simulator_runs
from leactl.gap.planning.separating import separating_experiment
from leactl.gap.replay.stretches import read_records
from leactl.gap.search import sets
from leactl.gap.search.confirm import HeldOutGain, held_out_gains
from leactl.gap.search.evidence import Evidence
from leactl.gap.search.parameters import about, calibrated, effect_parameters, with_calibration, with_effects
from leactl.gap.search.regression import Candidate, Fit, Rows
from leactl.gap.search.ringing import Line, ringing
from leactl.gap.search.sets import EffectSet, search
from leactl.gap.search.stamp_fit import LATEST
from leactl.gap.servo import answer as servo_answer
from leactl.gap.servo.effect_sets import fit_effect_sets
from leactl.gap.servo.runs import runs_at_common_rate
from leactl.gap.setup import SetUpFault, mended
from leactl.gap.signals.record import Record
from leactl.gap.signals.rig import DRIVES, VOLTAGE, Array
from leactl.gap.signals.setpoints import marked, setpoint_notes
from leactl.gap.signals.stamps import stamp_notes, stamped
from leactl.gap.verdict.decision import LISTED, NAMED, UNKNOWN, verdict_of
from leactl.gap.verdict.judge import (
    Judged,
    RunRatios,
    judge,
    left_by_form,
    unexplained,
    unexplained_in_a_run,
    unlike_fitted,
    unrest,
    unrest_of_runs,
)
from leactl.gap.verdict.notes import beyond_null, gathered, questions, unlike
from leactl.gap.verdict.picture import pictured, pictured_by_replays
from leactl.gap.verdict.separation import RuledOut, nearest_of_classes, without_ruled_out
from leactl.gap.verdict.shrinkage import SquaresRatio, shrinkage, simulated_again, squares_ratio
from leactl.gap.verdict.unknown import describe, nearest_effects
from leactl.gap.verdict.where import profiles, where
from leactl.gap.verdict.withdrawal import Applied, FittedEffects, Refit, apply, at_bounds
from leactl.model.nominal import BenchModel, Model, read_model
from leactl.vocabulary.effect import effect_definition

OUTWEIGHED = 0.2  # of what a set explains, that it may leave beyond noise where something unexplained acts
CALIBRATED = 25.0  # weighted squares a parameter must gain for the verdict to be calibration
COURSE, ALIKE = 64, 0.95  # points of a course, and the cosine from which two are one; a ramp and a step have 0.87
STEPS = 2  # of Gauss and Newton after the first: most effects multiply parameters that are calibrated
RIG = ("drive_gain", "load_mass", "load_length", "load_arm_mass")  # by which runs of a protocol differ in kind
Progress = Callable[[str], None]
Channel = tuple[str, str, str]  # equation or quantity, quantity or role, and mechanical set-up


@dataclass
class Case:
    """Runs to fit, runs held out, and the model."""

    model: Model
    fitted: list[Record]
    held_out: list[Record]
    simulated: list[Record] = field(default_factory=list)  # runs of the simulator whose nominal the model is
    unexplained: dict[Channel, float] = field(default_factory=dict)
    """Root mean square, in the channel's units, that the simulator leaves over its own floor."""
    nominal: Model | None = None  # that gaps are told from; `model` where left out

    def replayed(self) -> list[Record]:
        """Runs that are simulated again: those held out, and of kinds of which none is held out the fitted ones."""
        kinds = {(record.kind, record.mechanical) for record in self.held_out}
        return [*self.held_out, *(r for r in self.fitted if (r.kind, r.mechanical) not in kinds)]

    def of_records(self, records: Sequence[Record]) -> "Case":
        """The same case of other records: as many fitted ones, then those held out."""
        count = len(self.fitted)
        return replace(self, fitted=list(records[:count]), held_out=list(records[count:]))


def read_case(runs: Sequence[Path], held_out: Sequence[Path], model: Path) -> Case:
    """Read everything at the door; all faults are told at once.

    Raises
    ------
    InputError : no run, files that cannot be used, or a run on both sides.
    """
    if not runs:
        raise InputError("no run to diagnose; give one run file or more")
    faults: list[str] = []
    both = {path.resolve() for path in runs} & {path.resolve() for path in held_out}
    faults += [f"{path}: is both fitted and held out; a run can be on one side only" for path in sorted(both)]
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
    fitted, others = ([record for path in paths for record in read[path]] for paths in (runs, held_out))
    if not others:
        fitted, others = split(fitted)
    return Case(nominal, fitted, others)


def split(records: list[Record]) -> tuple[list[Record], list[Record]]:
    """Hold out the last run of every kind that occurs twice; where none does, stretches of every run."""
    kinds: dict[object, list[Path]] = {}
    courses: list[Array] = []
    firsts: dict[Path, Record] = {}  # of a long run its first stretch
    for record in records:
        firsts.setdefault(record.path, record)
    for path, record in firsts.items():
        rig = tuple(record.setup.get(name) for name in RIG)
        kinds.setdefault((record.kind, record.mechanical, rig, alike(record, courses)), []).append(path)
    held = [runs[-1] for runs in kinds.values() if len(runs) > 1]
    if held:
        return [r for r in records if r.path not in held], [r for path in held for r in records if r.path == path]
    kept, taken = zip(*(record.parted() for record in records), strict=True)
    return list(kept), list(taken)


def alike(record: Record, courses: list[Array]) -> int:
    """The first of some courses of a voltage that a run has as well, up to its size; it joins them where it is another.

    A log of WPILib names its tests alike, and a ramp one way does not tell what a step the other way does. Runs that
    no voltage drives are alike.
    """
    clock = record.fast
    volts = clock.get("q_axis_voltage") if clock is not None else None
    if clock is None or volts is None or any(clock.get(name) is not None for name in DRIVES):
        return -1
    course = np.interp(np.linspace(0.0, len(volts) - 1.0, COURSE), np.arange(len(volts)), volts)
    course /= max(float(np.linalg.norm(course)), np.finfo(np.float64).tiny)
    near = [index for index, other in enumerate(courses) if float(course @ other) > ALIKE]
    courses += [] if near else [course]
    return near[0] if near else len(courses) - 1


def diagnose(case: Case, progress: Progress = lambda _: None) -> DiagnosisResult:
    """Answer where, why and how far: faults of the set-up first, then what is left once they are mended.

    Causes come from the fitted runs alone, how far the gap shrinks from the held-out ones. Faults of the set-up are
    looked for in all runs, for each run may have its own. A fault that is seen by what the model makes of a channel is
    not named where the mended runs stay unexplained and an effect explains them without that mend: a strong spring may
    look like a factor.

    Raises
    ------
    InputError : the runs hold nothing that any equation of the model can be checked with.
    """
    progress("looking for faults of the set-up")
    faults, again = without_faults(case)
    answer = diagnose_mended(again, faults, progress)
    doubted = [fault for fault in faults if fault.shrinks]
    if not doubted or answer.unexplained_probability < UNKNOWN:
        return answer
    certain, records = [fault for fault in faults if not fault.shrinks], [*case.fitted, *case.held_out]
    for fault in certain:
        records = [fault.mend(record) for record in records]
    try:
        other = diagnose_mended(case.of_records(records), certain, progress)
    except InputError:
        return answer
    named = any(cause.family != "setup" and cause.probability >= NAMED for cause in other.causes)
    if not named or other.unexplained_probability >= UNKNOWN:
        return answer
    told = tuple(f"not named: {fault.name}; an effect explains the runs without mending it" for fault in doubted)
    return replace(other, notes=(*told, *other.notes))


def without_faults(case: Case) -> tuple[list[SetUpFault], Case]:
    """Faults of the set-up that the runs of a case show, and the case with the runs mended."""
    faults, records = mended([*case.fitted, *case.held_out], case.model, len(case.held_out))
    return faults, case.of_records(records) if faults else case


def diagnose_mended(case: Case, faults: Sequence[SetUpFault], progress: Progress) -> DiagnosisResult:
    """Answer for a case whose runs are mended: the faults that they had are the first causes.

    Raises
    ------
    InputError : no fault is known, and the runs hold nothing that any equation of the model can be checked with.
    """
    if not faults:
        return diagnose_effects(case, progress)
    try:
        of_effects = diagnose_effects(case, progress)
    except InputError as error:  # without the channel at fault nothing can be checked: the fault is the answer
        same = {"calibrated": case.model, "augmented": case.model, "traces": (), "profiles": ()}
        of_effects = DiagnosisResult("none", 0.0, notes=tuple(error.faults), extra=same)
    causes = tuple(fault.as_cause() for fault in faults) + of_effects.causes
    notes = tuple(fault.note() for fault in faults)
    return replace(of_effects, verdict="effect", causes=causes, notes=(*notes, *of_effects.notes))


def diagnose_effects(case: Case, progress: Progress) -> DiagnosisResult:
    """Answer for runs whose channels are what their descriptions say.

    Raises
    ------
    InputError : the runs hold nothing that any equation of the model can be checked with.
    """
    progress("reading equations")
    case = case.of_records(marked([*case.fitted, *case.held_out], case.model))
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
    searched = confirmed_beside_others(evidence, search(evidence))
    progress("trying them on held-out runs")
    by_runs = servo_answer.judged_by_runs(case.model, case.fitted)
    gains, judged = judged_on_held_out(case, evidence, searched)
    told: tuple[str, ...] = ()
    if any(item.peers for item in judged) and not by_runs:
        nearest, ruled_out = separated(case, evidence, searched, judged)
        if nearest is not searched:
            searched = nearest
            gains, judged = judged_on_held_out(case, evidence, searched)
        judged = [without_ruled_out(item, ruled_out) for item in judged]
        told = tuple(effect.note() for effect in ruled_out)
    beside_sound = among_sound_noise(evidence, searched)
    by_run, lines = left_over(evidence, beside_sound)
    restless = unrest(by_run)
    surprise = unexplained(restless, lines)
    causes = causes_of(evidence, searched, judged)
    calibrated_alone = calibrated(evidence, evidence.settle([]))
    members = {item.finding.effect for item in judged}
    refit: Refit = partial(fitted_again, evidence, searched)
    if by_runs:
        progress("fitting free runs of the servo")
        free = runs_at_common_rate(case.fitted, case.model)
        fitted_sets = fit_effect_sets(free, case.held_out, case.model, searched.hypothesis)
        calibrated_alone = servo_answer.calibration(case.model, fitted_sets.calibrated, {})
        parameters = servo_answer.calibration(case.model, fitted_sets.augmented, fitted_sets.stds)
        causes = servo_answer.causes(fitted_sets, causes, free, with_calibration(case.model, parameters))
        members |= {item.effect for item in fitted_sets.standing}
        calibrated_alone = calibrated_alone if fitted_sets.standing else parameters
        refit = partial(fitted_by_sets, parameters)
        left_out = [record for record in case.fitted if record not in free]
        told = servo_answer.rig_note(fitted_sets, case.model.load.type == "pendulum", left_out)
    elif outweighed(evidence, beside_sound, restless, lines):
        told += tuple(f"not named: {item.finding.effect}; too much is left beside what it explains" for item in judged)
        causes = tuple(replace(c, probability=c.probability * (1.0 - surprise.probability)) for c in causes)
    named = [cause for cause in causes if cause.probability >= NAMED and cause.effect in members]
    progress("simulating again")
    stamps = evidence.stamping(searched.fit)
    replayed = [stamped(record, stamps) for record in case.replayed()]
    if by_runs:
        replayed = servo_answer.on_time(replayed, case.model, fitted_sets.late)
    applied = apply(
        case.model,
        calibrated_alone,
        [named] if by_runs and named else [[cause] for cause in named],
        refit,
        lambda tuned, augmented: shrinkage(
            replayed, case.nominal or case.model, tuned, augmented, unexplained=case.unexplained
        ),
        bounded_fit=not by_runs,
        borne_out_by_equations={effect for (effect, _), tried in gains.items() if tried.least > 0.0 and not by_runs},
    )
    shrunk = applied.shrunk
    causes = borne_out(causes, applied)
    if by_runs:
        surprise = unexplained(servo_answer.unfollowed(shrunk.shrinkage, replayed), {})
    located = where(replayed, shrunk.channels, applied.fitted.causes)
    notes = unlike(case.fitted, case.held_out) + gathered([*case.fitted, *case.held_out])
    if {record.path for record in case.held_out} & {record.path for record in case.fitted}:
        notes += ("no kind of run occurs twice: held out are two sixteenths of each run",)
    calibrates = not applied.first_calibration_withdrawn and gained(evidence, searched)
    names = {cause.effect for cause in applied.fitted.causes}
    standing = [candidate for candidate in searched.hypothesis if candidate[0] in names]
    if len(standing) < len(searched.hypothesis) and not by_runs:  # what the others explained is unexplained again
        rest_of_set = among_sound_noise(evidence, sets.describe(evidence, list(standing)))
        by_run, lines = left_over(evidence, rest_of_set)
        surprise = max(surprise, unexplained(unrest(by_run), lines), key=lambda one: one.probability)
    if not (standing or by_runs or at_bounds(calibrated_alone)) and surprise.probability < UNKNOWN:
        off = unexplained_in_a_run(by_run), unlike_fitted(evidence, standing, case.held_out)
        surprise = max(surprise, *off, key=lambda one: one.probability)
    alternatives = [rival.candidate for item in judged for rival, _ in item.rivals]
    causes = pictured(causes, evidence, standing, alternatives, case.held_out)
    causes = pictured_by_replays(causes, applied.fitted.causes, replayed, shrunk.channels)
    left, rest = tuple[str, ...](), None
    if surprise.probability >= UNKNOWN:
        progress("describing what is left")
        near = nearest_effects(searched, judged, applied.refused)
        left = (surprise.note,)
        rest = describe(evidence, standing, surprise.channel, case.held_out, near)
    return DiagnosisResult(
        verdict_of(causes, surprise.probability, calibrates),
        surprise.probability,
        located,
        applied.fitted.calibration,
        causes,
        shrunk.shrinkage,
        tuple(
            dict.fromkeys(
                left
                + told
                + applied.notes
                + notes
                + stamp_notes(stamps, evidence.on_time, LATEST)
                + setpoint_notes(case.fitted)
                + beyond_null(evidence, null)
                + shrunk.notes
                + questions(case.model, case.fitted, evidence, by_runs)
            )
        ),
        rest,
        {
            "calibrated": applied.calibrated,
            "augmented": applied.augmented,
            "standing": tuple(standing),
            "traces": shrunk.traces,
            "profiles": profiles(replayed, shrunk.channels, located),
        },
    )


def judged_on_held_out(
    case: Case, evidence: Evidence, searched: EffectSet
) -> tuple[dict[Candidate, HeldOutGain], list[Judged]]:
    """What each member of a set takes away on held-out runs, and what may be said of it."""
    gains = dict(zip(searched.hypothesis, held_out_gains(evidence, searched.hypothesis, case.held_out), strict=True))
    return gains, judge(evidence, searched, {candidate: tried.gain for candidate, tried in gains.items()})


def separated(
    case: Case, evidence: Evidence, searched: EffectSet, judged: Sequence[Judged]
) -> tuple[EffectSet, list[RuledOut]]:
    """Return the set with the effect of each class that comes nearest to held-out runs, and the effects ruled out."""
    stamps = evidence.stamping(searched.fit)
    replayed = [stamped(record, stamps) for record in case.replayed()]

    @cache
    def model_of(hypothesis: tuple[Candidate, ...]) -> Model:
        return model_with(case.model, evidence, hypothesis)

    def compare(first: Sequence[Candidate], second: Sequence[Candidate]) -> SquaresRatio:
        one, other = model_of(tuple(first)), model_of(tuple(second))
        random = np.random.default_rng(0)
        _, channels = simulated_again(replayed, (one, one, other), random, case.unexplained)  # the first is not read
        return squares_ratio(channels, random)

    hypothesis, ruled_out = nearest_of_classes(searched.hypothesis, judged, compare)
    nearest = searched
    if hypothesis != searched.hypothesis:
        nearest = sets.describe(evidence, hypothesis)
        if {effect for effect, _ in nearest.hypothesis} != {effect for effect, _ in hypothesis}:
            nearest, ruled_out = searched, []  # beside the others the nearer effect has no place after all
    evidence.settle(nearest.hypothesis)
    return nearest, ruled_out


def model_with(model: Model, evidence: Evidence, hypothesis: Sequence[Candidate]) -> Model:
    """Return the model with the effects of a set and the calibration beside them, fitted to the runs of `evidence`."""
    parameters, calibration = fitted_to_the_end(evidence, hypothesis)
    effects = [(effect, {item.name: item.value for item in own}) for effect, own in parameters.items()]
    return with_effects(with_calibration(model, calibration), effects)


def among_sound_noise(evidence: Evidence, result: EffectSet) -> EffectSet:
    """A set with what it takes away and leaves in units of a sound machine's noise, where that is less."""
    taken, left = sets.taken_and_left(evidence, result.hypothesis, sound=True)
    return replace(result, taken=taken, left=left)


def left_over(evidence: Evidence, result: EffectSet) -> tuple[RunRatios, dict[Channel, Line]]:
    """How restless a set leaves each channel of each run, and the lines in the spectra of what it leaves."""
    heard = [not left_by_form(result, index) for index in range(len(evidence.stack.rows))]
    lines = ringing(evidence, evidence.settle(result.hypothesis), heard)
    return unrest_of_runs(evidence, result), lines


def outweighed(
    evidence: Evidence, result: EffectSet, restless: Mapping[Channel, float], lines: Mapping[Channel, Line]
) -> bool:
    """Whether something unexplained leaves so much that what a set of effects explains may be a part of that.

    What the velocity of a motor fed with a voltage leaves over beside its angle says nothing of effects elsewhere: it
    is the controller's own estimate, and no balance takes it. Nor does the angle of a locked rotor: within a play
    friction holds it where no torque tells, so that what is left there may be as large as the play itself.
    """
    aside = {
        rows.equation
        for rows in evidence.stack.rows
        if rows.equation == "lock"
        or (rows.kind == VOLTAGE and rows.equation == "velocity" and not touched(rows, result.hypothesis))
    }
    rest = {key: ratio for key, ratio in restless.items() if key[0] not in aside}
    heard = {key: line for key, line in lines.items() if key[0] not in aside}
    taken, left = (
        sum(one for one, rows in zip(amounts, evidence.stack.rows, strict=True) if rows.equation not in aside)
        for amounts in (result.taken, result.left)
    )
    total = sum(member.gain for member in result.members) or 1.0
    allowed = sum(may_leave(member.effect) * member.gain for member in result.members) / total
    return unexplained(rest, heard).probability >= UNKNOWN and left > allowed * taken


def may_leave(effect: str) -> float:
    """Of the squares that an effect explains, the share that it may leave where its columns are known to be loose."""
    explains = library()[effect].explains
    return (1.0 - explains) / explains if explains < sets.LOOSE else OUTWEIGHED


def touched(rows: Rows, hypothesis: Sequence[Candidate]) -> bool:
    """Whether an effect of a set has a column in some rows."""
    own = {(effect, repr(form)) for effect, form in hypothesis}
    return any(name[0] == "effect" and (name[1], name[2]) in own for name in rows.columns)


def fitted_again(evidence: Evidence, result: EffectSet, causes: Sequence[Cause]) -> FittedEffects:
    """Some members of the set fitted without the others."""
    wanted = {cause.effect: cause for cause in causes}
    hypothesis = [candidate for candidate in result.hypothesis if candidate[0] in wanted]
    parameters, calibration = fitted_to_the_end(evidence, hypothesis)
    return FittedEffects(tuple(replace(wanted[name], parameters=own) for name, own in parameters.items()), calibration)


def fitted_to_the_end(
    evidence: Evidence, hypothesis: Sequence[Candidate]
) -> tuple[dict[str, tuple[EffectParameter, ...]], tuple[CalibratedParameter, ...]]:
    """Parameters of effects by name, and the calibration beside them.

    Columns that go with calibrated parameters are made of these, and fitted again (Gauss and Newton): with a camera
    that reads two thirds of a rise, heat flows are 4 % off at first; with an inertia 15 % off, so is an eccentricity.
    """
    fit = evidence.settle(hypothesis)
    parameters = calibrated(evidence, fit)
    nominal = {item.parameter: item.nominal for item in parameters}
    for _ in range(STEPS):
        hypothesis = [about(evidence, fit, candidate) for candidate in hypothesis]
        # the ambient's offset stays as the model has it: its prior is in kelvin about that
        ratios = [item for item in parameters if item.parameter != "ambient_offset"]
        evidence = evidence.on(evidence.records, hypothesis, with_calibration(evidence.model, ratios))
        evidence.settle(hypothesis)  # forms are compared under the noise that these leave
        hypothesis = sets.refine(evidence, hypothesis, shapes=False)
        fit = evidence.settle(hypothesis)
        parameters = tuple(replace(p, nominal=nominal[p.parameter]) for p in calibrated(evidence, fit))
    return {candidate[0]: effect_parameters(evidence, fit, candidate) for candidate in hypothesis}, parameters


def fitted_by_sets(calibration: tuple[CalibratedParameter, ...], causes: Sequence[Cause]) -> FittedEffects:
    """What free runs of a servo say, which are fitted with all effects at once."""
    return FittedEffects(tuple(causes), calibration)


def borne_out(causes: Sequence[Cause], applied: Applied) -> tuple[Cause, ...]:
    """Causes without those that held-out runs do not bear out nor what stood for these alone; the others as applied."""
    kept = {cause.effect: cause for cause in applied.fitted.causes}
    return tuple(
        kept.get(cause.effect, cause)
        for cause in causes
        if cause.effect in kept or cause.probability < NAMED or kept.keys() & set(cause.indistinguishable_from)
    )


def causes_of(evidence: Evidence, result: EffectSet, judged: Sequence[Judged]) -> tuple[Cause, ...]:
    """Members of the set, then their rivals, by probability."""
    total = sum(item.finding.gain for item in judged) or 1.0
    causes: dict[str, Cause] = {}
    for item in judged:
        parameters = effect_parameters(evidence, result.fit, item.finding.candidate)
        plan = separating_experiment(item.finding.effect, item.peers)
        share = item.finding.gain / total
        causes[item.finding.effect] = Cause(
            item.finding.effect,
            item.probability,
            share,
            parameters,
            tuple(sorted(item.peers)),
            plan,
            effect_definition(item.finding.effect).family,
        )
    for item in judged:
        for rival, probability in item.rivals:
            if probability < LISTED or rival.effect in causes:
                continue
            others = [c for c in result.hypothesis if c != item.finding.candidate]
            parameters = alone(evidence, others, rival.candidate)
            together = item.probability if rival.effect in item.peers else probability
            peers = tuple(sorted({item.finding.effect, *item.peers} - {rival.effect})) if together > probability else ()
            family = effect_definition(rival.effect).family
            causes[rival.effect] = Cause(rival.effect, together, 0.0, parameters, peers, family=family)
    members = {item.finding.effect for item in judged}
    readings = {item.finding.effect for item in judged if of_a_reading(evidence, item.finding.candidate)}
    # what is sure beyond a hundredth ranks by how much of the gap it takes
    told = [cause for cause in causes.values() if cause.probability >= LISTED]
    ranks = {
        c.effect: (-round(c.probability, 2), c.effect in readings, c.effect not in members, -c.share) for c in told
    }
    return tuple(sorted(told, key=lambda c: ranks[c.effect]))


def of_a_reading(evidence: Evidence, candidate: Candidate) -> bool:
    """Whether an effect shows in the velocity that a controller estimates, and not in what moves a fed motor."""
    balances = [rows for rows in evidence.stack.rows if rows.kind == VOLTAGE and rows.equation != "velocity"]
    return bool(balances) and not any(touched(rows, [candidate]) for rows in balances)


def alone(evidence: Evidence, others: list[Candidate], candidate: Candidate) -> tuple[EffectParameter, ...]:
    """Parameters of an effect in the place of another."""
    fit: Fit = evidence.normal().fit([*others, candidate])
    return effect_parameters(evidence, fit, candidate)


def gained(evidence: Evidence, result: EffectSet) -> bool:
    """Whether the parameters of the nominal model explain more by another value than chance does."""
    normal = evidence.normal()
    keep = np.asarray([k for k, n in enumerate(evidence.stack.names) if n[0] == "nuisance"], np.intp)
    return normal.solve(keep).misfit - result.fit.misfit > CALIBRATED
