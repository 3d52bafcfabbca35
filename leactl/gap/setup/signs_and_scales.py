"""Find channels of wrong scale or sign, a time base of another unit or rate, and wrong counts or pole pairs.

A factor that an effect or a wrong parameter may have is no fault. That of a fault is larger than on sound machines, is
equal in the runs that have it, and explains nearly all of a channel's error.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from leactl.gap.diagnosis import EffectParameter
from leactl.gap.setup.contract import SetUpFault, with_values
from leactl.gap.setup.conventions import (
    CONVENTION_TOLERANCE,
    CURRENT_FACTORS,
    FACTORS,
    UNIT_FACTORS,
    convention,
    time_unit,
    whole_number,
)
from leactl.gap.setup.factor_hypotheses import ANGLE, TIME, FaultHypothesis, fault_hypotheses, is_usual, pool_factors
from leactl.gap.setup.relations import FACTOR_STDS, TIGHT_STD, Factor, factors_of
from leactl.gap.signals.record import Clocked, Key, Record
from leactl.model.nominal import Model

SIGN, SCALE, COUNTS, POLES, TIME_BASE = "channel_sign", "channel_scale", "encoder_counts", "pole_pairs", "time_base"
LEAST_AMBIGUOUS_ERROR = 0.25  # error of a factor from which it may be a whole number
FAULT_PROBABILITY = 0.99  # probability that a fault acts that all relations agree on, or one of its peers
UNCONVENTIONAL_COST = 4.0  # squared standard deviations added to the misfit of a factor that is no convention
MOST_EXACT_STDS = 3.0  # largest distance of a fitted factor from an exact one that it agrees with, standard errors
MOST_UNIT_DISTANCE_RATIO = 0.25  # distance of a factor from a certain unit, over that from a whole number
SCALING_PARAMETERS = {"torque_constant"}  # model parameters whose error looks like a scaled channel
THOUSAND_FACTORS = ("1000", "1/1000")  # factors of units that electrical channels may have, too
ELECTRICAL_QUANTITIES = {"q_axis_current", "q_axis_current_reference", "q_axis_voltage"}
Factors = Mapping[str, Factor]


def find_scale_fault(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the clearest fault of scale, sign or time base, if there is one."""
    factors_by_run = {
        record.name: {factor.relation: factor for factor in factors_of(record, model) if factor.holds}
        for record in records
    }
    factors_by_run = {run: factors for run, factors in factors_by_run.items() if factors}
    keys = {key for record in records if record.fast is not None for key in record.fast.values}
    unusual_runs = {run: factors for run, factors in factors_by_run.items() if not all(map(is_usual, factors.values()))}
    for group in (factors_by_run, unusual_runs):
        hypotheses = faults_among(fault_hypotheses(pool_factors(list(group.values())), keys)) if group else []
        # an error in some runs only is another machine or an effect, unless two channels of one quantity disagree
        if hypotheses and (
            group is factors_by_run or (is_disagreement(hypotheses[0]) and has_usual_convention(hypotheses[0]))
        ):
            # a run that does not determine the factor is taken to have the fault as well
            sound_runs = {
                run
                for run, factors in factors_by_run.items()
                if run not in group and determines_factor(factors, hypotheses[0])
            }
            return fault_of(hypotheses, {record.name for record in records} - sound_runs, len(records), model)
    return None


def determines_factor(factors: Factors, hypothesis: FaultHypothesis) -> bool:
    """Return whether a run determines a factor that a fault would change."""
    return bool({*hypothesis.signature.powers, *hypothesis.signature.reversed_factors} & factors.keys())


def faults_among(hypotheses: Sequence[FaultHypothesis]) -> list[FaultHypothesis]:
    """Return the faults among the hypotheses, best first; none where a wrong parameter fits as well."""
    if any(fault.signature.parameter not in {"", *SCALING_PARAMETERS} for fault in hypotheses):
        return []
    faults = [fault for fault in hypotheses if fault.signature.keys]
    return sorted(
        faults,
        key=lambda fault: (
            fault.misfit + (0.0 if has_usual_convention(fault) else UNCONVENTIONAL_COST),
            fault.signature.keys == (TIME,),
        ),
    )


def is_disagreement(hypothesis: FaultHypothesis) -> bool:
    """Return whether a fault reverses a sign, or makes two channels of one quantity disagree."""
    return hypothesis.sign < 0.0 or any(FACTOR_STDS[name] <= TIGHT_STD for name in hypothesis.signature.powers)


def has_usual_convention(hypothesis: FaultHypothesis) -> bool:
    """Return whether a fault's factor is a usual convention of its channel."""
    size, [key, *_] = math.exp(hypothesis.size), hypothesis.signature.keys
    if key == TIME:
        return bool(time_unit(size, hypothesis.error))
    name = convention(size, hypothesis.error)
    if not hypothesis.size or (key == ANGLE and whole_number(size, hypothesis.error)):
        return True
    return (
        name in CURRENT_FACTORS
        if key[0] in ELECTRICAL_QUANTITIES and name not in THOUSAND_FACTORS
        else name in UNIT_FACTORS
    )


def fault_of(hypotheses: Sequence[FaultHypothesis], runs: set[str], run_count: int, model: Model) -> SetUpFault:
    """Return the fault of the best hypothesis, with its convention, its evidence and the change that undoes it."""
    best, rivals = hypotheses[0], hypotheses[1:]
    runs_text = "" if len(runs) == run_count else f" in {len(runs)} of {run_count} runs"
    other_channels = [rival for rival in rivals if rival.signature.keys]
    if best.signature.keys == (TIME,):
        fault = time_base_fault(best, runs_text, runs)
    elif best.sign < 0.0 and best.size == 0.0:
        fault = sign_fault(best, runs_text, runs)
    elif best.signature.keys[0] == ANGLE:
        fault = count_fault(best, runs_text, runs, model)
    else:
        fault = scale_fault(best, runs_text, runs)
    peers = [name for rival in other_channels for name in fault_names(rival)]
    if other_channels:
        rivals_text = " or ".join(dict.fromkeys(channels_text(rival.signature.keys) for rival in other_channels))
        fault = replace(fault, change=f"{fault.change}; these runs cannot tell it from {rivals_text}")
    constants = {"torque", "resistance", "inertia", "damping", "friction"} & best.signature.powers.keys()
    if best.size and constants and {"current test", "velocity test", "back_emf"}.isdisjoint(best.signature.powers):
        fault = replace(fault, change=f"{fault.change}; or the model's torque_constant is off by that factor")
    merged = tuple(dict.fromkeys([*fault.peers, *peers]))
    return replace(fault, peers=tuple(name for name in merged if name != fault.name))


def fault_names(hypothesis: FaultHypothesis) -> tuple[str, ...]:
    """Return the names of the faults that a rival may be."""
    if hypothesis.signature.keys == (TIME,):
        return (TIME_BASE,)
    if hypothesis.sign < 0.0 and hypothesis.size == 0.0:
        return (SIGN,)
    if hypothesis.signature.keys[0] == ANGLE and not convention(math.exp(hypothesis.size), hypothesis.error):
        return (COUNTS, POLES) if may_be_whole(hypothesis) else (COUNTS,)
    return (SCALE,)


def channels_text(keys: Sequence[Key]) -> str:
    """Return channels as text."""
    return " and ".join(
        quantity.replace("_", " ") + ("" if role in ("test", "") else f" of {role}") for quantity, role in keys
    )


def factor_text(best: FaultHypothesis, runs_text: str) -> str:
    """Return the evidence of a factor as text."""
    name = convention(best.factor, best.error)
    convention_text = f" ({name})" if best.size and name else ""
    return f"reads {best.factor:.4g}{convention_text} times what the other channels and the model make of it{runs_text}"


def factor_parameters(best: FaultHypothesis) -> tuple[EffectParameter, ...]:
    """Return the factor with its error as a parameter."""
    return (EffectParameter("factor", best.factor, best.error * abs(best.factor), "1"),)


def sign_fault(best: FaultHypothesis, runs_text: str, runs: set[str]) -> SetUpFault:
    """Return the fault of channels with reversed sign."""
    keys = best.signature.keys
    change = (
        f"give {' and '.join(name for name, _ in keys)} `sign: -1` in the mapping, or `invert: true` in the bench file"
    )
    mend = partial(with_divided_channels, keys=keys, factor=-1.0, runs=runs)
    return SetUpFault(
        SIGN, keys[0], FAULT_PROBABILITY, factor_text(best, runs_text), change, mend, factor_parameters(best)
    )


def exact_factor(best: FaultHypothesis, size: float | None) -> float:
    """Return the factor to mend by: the exact one where the fitted one agrees with it, since a fit's error would stay.

    size : the exact absolute factor, if there is one.
    """
    if size is None or abs(best.size - math.log(size)) > MOST_EXACT_STDS * best.error:
        return best.factor
    return best.sign * size


def scale_fault(best: FaultHypothesis, runs_text: str, runs: set[str], size: float | None = None) -> SetUpFault:
    """Return the fault of channels in another unit or convention.

    size : the exact absolute factor; by default that of the convention, if the factor has one.
    """
    keys = best.signature.keys
    factor = exact_factor(best, size or FACTORS.get(convention(math.exp(best.size), best.error)))
    names, multiplier = " and ".join(name for name, _ in keys), f"{1.0 / factor:.6g}"
    change = f"multiply the `scale` of {names} in the mapping, or in the bench file, by {multiplier}"
    mend = partial(with_divided_channels, keys=keys, factor=factor, runs=runs)
    return SetUpFault(
        SCALE, keys[0], FAULT_PROBABILITY, factor_text(best, runs_text), change, mend, factor_parameters(best)
    )


def count_fault(best: FaultHypothesis, runs_text: str, runs: set[str], model: Model) -> SetUpFault:
    """Return the fault of an angle in another unit, with another count a turn, or of an electrical angle."""
    size = math.exp(best.size)
    number, unit = whole_number(size, best.error), convention(size, best.error)
    if unit in UNIT_FACTORS and not (number and log_distance(size, number) < log_distance(size, UNIT_FACTORS[unit])):
        is_certain = best.error < CONVENTION_TOLERANCE and (
            number is None
            or log_distance(size, UNIT_FACTORS[unit]) < MOST_UNIT_DISTANCE_RATIO * log_distance(size, number)
        )
        return replace(scale_fault(best, runs_text, runs), peers=() if is_certain else (POLES, COUNTS))
    whole_size = None if number is None else number if size > 1.0 else 1.0 / number
    fault = scale_fault(best, runs_text, runs, whole_size)
    if number is None:
        change = (
            f"{fault.change}: a turn has {size:.4g} times the counts that were set, or a gear of that ratio is between"
        )
        return replace(fault, name=COUNTS, change=change, peers=(POLES, SCALE) if may_be_whole(best) else (SCALE,))
    change = f"{fault.change}: {number} pole pairs, a gear of {number}, or counts a turn that are off by {number}"
    is_model_value = number == model.pole_pairs
    if number in (2, 4) and not is_model_value:  # the edges of an encoder's two tracks, counted singly or all four
        return replace(fault, name=COUNTS, change=change, peers=(POLES, SCALE))
    return replace(fault, name=POLES, change=change, peers=() if is_model_value else (COUNTS, SCALE))


def may_be_whole(hypothesis: FaultHypothesis) -> bool:
    """Return whether a factor may be a whole number within its error."""
    larger = math.exp(abs(hypothesis.size))
    return bool(whole_number(larger, hypothesis.error)) or (
        larger > 1.5 and hypothesis.error * larger > LEAST_AMBIGUOUS_ERROR
    )


def log_distance(size: float, number: float) -> float:
    """Return the difference of the logarithms of a factor, or its inverse, and a number."""
    return abs(abs(math.log(size)) - abs(math.log(number)))


def time_base_fault(best: FaultHypothesis, runs_text: str, runs: set[str]) -> SetUpFault:
    """Return the fault of stamps in another unit, or at another rate than the samples."""
    size = math.exp(best.size)
    unit_name = time_unit(size, best.error)
    evidence = (
        f"goes {size:.4g} times as fast as the motion it stamps{f' ({unit_name})' if unit_name else ''}{runs_text}"
    )
    unit = {"1000": "`time: units: ms`", "1000000": "`time: units: us`", "60": "`time: units: min`"}.get(unit_name)
    change = f"give {unit} in the mapping" if unit else f"multiply `rate_Hz` of the time in the mapping by {size:.6g}"
    mend = partial(with_scaled_stamps, factor=size, runs=runs)
    return SetUpFault(TIME_BASE, TIME, FAULT_PROBABILITY, evidence, change, mend, factor_parameters(best))


def with_divided_channels(record: Record, keys: Sequence[Key], factor: float, runs: set[str]) -> Record:
    """Return a record with channels divided by a factor; the same record if it is not one of `runs`."""
    for key in keys:
        if record.name in runs and record.fast is not None and key in record.fast.values:
            record = with_values(record, key, record.fast.values[key] / factor)
    return record


def with_scaled_stamps(record: Record, factor: float, runs: set[str]) -> Record:
    """Return a record with stamps and intervals divided by a factor; the same record if it is not one of `runs`."""
    if record.name not in runs:
        return record

    def rescaled(clock: Clocked | None) -> Clocked | None:
        if clock is None:
            return None
        between = {key: (stamps / factor, values) for key, (stamps, values) in clock.between.items()}
        return replace(clock, time=clock.time / factor, interval=clock.interval / factor, between=between)

    return replace(record, fast=rescaled(record.fast), slow=rescaled(record.slow))
