"""Channels that are turned or scaled, a time of another unit or rate, a wrong count of an encoder or of poles.

A factor that an effect or a wrong parameter may have is left to these. One of a fault is beyond what sound machines
show, alike in the runs that have it, and explains nearly all of what a channel is off by.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from leactl.gap.diagnosis import EffectParameter
from leactl.gap.setup.contract import SetUpFault, with_values
from leactl.gap.setup.conventions import CURRENTS, NEAR, UNITS, convention, step_of_time, whole
from leactl.gap.setup.hypotheses import ANGLE, TIME, Spoken, pooled, spoken_for, usual
from leactl.gap.setup.relations import TIGHT, USUAL, Factor, factors_of
from leactl.gap.signals.record import Clocked, Key, Record
from leactl.model.nominal import Model

SIGN, SCALE, COUNTS, POLES, TIME_BASE = "channel_sign", "channel_scale", "encoder_counts", "pole_pairs", "time_base"
BETWEEN = 0.25  # of two whole numbers, an error from which on one of them may be meant
SEEN = 0.99  # probability of what all relations agree on, its class counted together
ODD = 4.0  # squares of standard deviations, that a factor without a convention counts for less
CLEARLY = 0.25  # of how far a factor is from a whole number, that it may be from a unit which is meant
CONSTANTS = {"torque_constant"}  # of the model, that a scaled channel may be taken for
THOUSANDS = ("1000", "1/1000")
ELECTRICAL = {"q_axis_current", "q_axis_current_reference", "q_axis_voltage"}
Factors = Mapping[str, Factor]


def misscaled(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """The channel, or the time, that is turned or scaled most clearly, if one is."""
    told = {record.name: {one.relation: one for one in factors_of(record, model) if one.holds} for record in records}
    told = {run: factors for run, factors in told.items() if factors}
    keys = {key for record in records if record.fast is not None for key in record.fast.values}
    odd = {run: factors for run, factors in told.items() if not all(map(usual, factors.values()))}
    for group in (told, odd):
        spoken = named(spoken_for(pooled(list(group.values())), keys)) if group else []
        # what is off in some runs only is another machine or an effect, unless two channels that say the same disagree
        if spoken and (group is told or (disagreeing(spoken[0]) and usual_convention(spoken[0]))):
            # a run that tells nothing of the factor is taken to have it as well
            sound = {run for run, factors in told.items() if run not in group and shows(factors, spoken[0])}
            return fault_of(spoken, {record.name for record in records} - sound, len(records), model)
    return None


def shows(factors: Factors, spoken: Spoken) -> bool:
    """Whether a run tells a factor that a fault would change."""
    return bool({*spoken.signature.powers, *spoken.signature.turns} & factors.keys())


def named(spoken: Sequence[Spoken]) -> list[Spoken]:
    """Faults that factors speak for, best first; none where a wrong parameter would do as well."""
    if any(one.signature.parameter not in {"", *CONSTANTS} for one in spoken):
        return []
    faults = [one for one in spoken if one.signature.keys]
    return sorted(
        faults, key=lambda one: (one.misfit + (0.0 if usual_convention(one) else ODD), one.signature.keys == (TIME,))
    )


def disagreeing(spoken: Spoken) -> bool:
    """Whether a fault makes two channels disagree that say the same, or turns one."""
    return spoken.sign < 0.0 or any(USUAL[name] <= TIGHT for name in spoken.signature.powers)


def usual_convention(spoken: Spoken) -> bool:
    """Whether a fault's factor is one that its channel is met with."""
    size, [key, *_] = math.exp(spoken.size), spoken.signature.keys
    if key == TIME:
        return bool(step_of_time(size, spoken.error))
    name = convention(size, spoken.error)
    if not spoken.size or (key == ANGLE and whole(size, spoken.error)):
        return True
    return name in CURRENTS if key[0] in ELECTRICAL and name not in THOUSANDS else name in UNITS


def fault_of(spoken: Sequence[Spoken], runs: set[str], of: int, model: Model) -> SetUpFault:
    """What factors speak for as a fault, with its convention, its evidence and the line that undoes it."""
    best, rivals = spoken[0], spoken[1:]
    within = "" if len(runs) == of else f" in {len(runs)} of {of} runs"
    others = [other for other in rivals if other.signature.keys]
    if best.signature.keys == (TIME,):
        fault = time_base(best, within, runs)
    elif best.sign < 0.0 and best.size == 0.0:
        fault = turned(best, within, runs)
    elif best.signature.keys[0] == ANGLE:
        fault = counted(best, within, runs, model)
    else:
        fault = scaled(best, within, runs)
    peers = [name for other in others for name in names_of(other)]
    if others:
        alike = " or ".join(dict.fromkeys(channels_of(other.signature.keys) for other in others))
        fault = replace(fault, change=f"{fault.change}; these runs cannot tell it from {alike}")
    constants = {"torque", "resistance", "inertia", "damping", "friction"} & best.signature.powers.keys()
    if best.size and constants and {"current test", "velocity test", "back_emf"}.isdisjoint(best.signature.powers):
        fault = replace(fault, change=f"{fault.change}; or the model's torque_constant is off by that factor")
    merged = tuple(dict.fromkeys([*fault.peers, *peers]))
    return replace(fault, peers=tuple(name for name in merged if name != fault.name))


def names_of(spoken: Spoken) -> tuple[str, ...]:
    """Faults of the vocabulary that a rival may be."""
    if spoken.signature.keys == (TIME,):
        return (TIME_BASE,)
    if spoken.sign < 0.0 and spoken.size == 0.0:
        return (SIGN,)
    if spoken.signature.keys[0] == ANGLE and not convention(math.exp(spoken.size), spoken.error):
        return (COUNTS, POLES) if may_be_whole(spoken) else (COUNTS,)
    return (SCALE,)


def channels_of(keys: Sequence[Key]) -> str:
    """Channels in words."""
    return " and ".join(
        quantity.replace("_", " ") + ("" if role in ("test", "") else f" of {role}") for quantity, role in keys
    )


def reads(best: Spoken, within: str) -> str:
    """The evidence of a factor."""
    name = convention(best.factor, best.error)
    told = f" ({name})" if best.size and name else ""
    return f"reads {best.factor:.4g}{told} times what the other channels and the model make of it{within}"


def parameters_of(best: Spoken) -> tuple[EffectParameter, ...]:
    """The factor with its error."""
    return (EffectParameter("factor", best.factor, best.error * abs(best.factor), "1"),)


def turned(best: Spoken, within: str, runs: set[str]) -> SetUpFault:
    """A channel, or several that agree with each other, with the other sign."""
    keys = best.signature.keys
    change = (
        f"give {' and '.join(name for name, _ in keys)} `sign: -1` in the mapping, or `invert: true` in the bench file"
    )
    mend = partial(divided, keys=keys, by=-1.0, runs=runs)
    return SetUpFault(SIGN, keys[0], SEEN, reads(best, within), change, mend, parameters_of(best))


def scaled(best: Spoken, within: str, runs: set[str]) -> SetUpFault:
    """A channel, or several that agree with each other, in another unit or convention."""
    keys = best.signature.keys
    names, by = " and ".join(name for name, _ in keys), f"{1.0 / best.factor:.6g}"
    change = f"multiply the `scale` of {names} in the mapping, or in the bench file, by {by}"
    mend = partial(divided, keys=keys, by=best.factor, runs=runs)
    return SetUpFault(SCALE, keys[0], SEEN, reads(best, within), change, mend, parameters_of(best))


def counted(best: Spoken, within: str, runs: set[str], model: Model) -> SetUpFault:
    """An angle of another unit, of another count a turn, or an electrical one."""
    size, fault = math.exp(best.size), scaled(best, within, runs)
    number, unit = whole(size, best.error), convention(size, best.error)
    if unit in UNITS and not (number and off(size, number) < off(size, UNITS[unit])):
        sure = best.error < NEAR and (number is None or off(size, UNITS[unit]) < CLEARLY * off(size, number))
        return replace(fault, peers=() if sure else (POLES, COUNTS))
    if number is None:
        change = (
            f"{fault.change}: a turn has {size:.4g} times the counts that were set, or a gear of that ratio is between"
        )
        return replace(fault, name=COUNTS, change=change, peers=(POLES, SCALE) if may_be_whole(best) else (SCALE,))
    change = f"{fault.change}: {number} pole pairs, a gear of {number}, or counts a turn that are off by {number}"
    known = number == model.pole_pairs
    if number in (2, 4) and not known:  # as edges of two tracks are counted
        return replace(fault, name=COUNTS, change=change, peers=(POLES, SCALE))
    return replace(fault, name=POLES, change=change, peers=() if known else (COUNTS, SCALE))


def may_be_whole(spoken: Spoken) -> bool:
    """Whether a factor equals a whole number, or is not told well enough to say that it does not."""
    larger = math.exp(abs(spoken.size))
    return bool(whole(larger, spoken.error)) or (larger > 1.5 and spoken.error * larger > BETWEEN)


def off(size: float, number: float) -> float:
    """How far a factor, or its inverse, is from a number, as a logarithm."""
    return abs(abs(math.log(size)) - abs(math.log(number)))


def time_base(best: Spoken, within: str, runs: set[str]) -> SetUpFault:
    """Stamps of another unit, or of another rate than the samples'."""
    size = math.exp(best.size)
    step = step_of_time(size, best.error)
    evidence = f"goes {size:.4g} times as fast as the motion it stamps{f' ({step})' if step else ''}{within}"
    unit = {"1000": "`time: units: ms`", "1000000": "`time: units: us`", "60": "`time: units: min`"}.get(step)
    change = f"give {unit} in the mapping" if unit else f"multiply `rate_Hz` of the time in the mapping by {size:.6g}"
    mend = partial(retimed, by=size, runs=runs)
    return SetUpFault(TIME_BASE, TIME, SEEN, evidence, change, mend, parameters_of(best))


def divided(record: Record, keys: Sequence[Key], by: float, runs: set[str]) -> Record:
    """A record whose channels are divided by a factor."""
    for key in keys:
        if record.name in runs and record.fast is not None and key in record.fast.values:
            record = with_values(record, key, record.fast.values[key] / by)
    return record


def retimed(record: Record, by: float, runs: set[str]) -> Record:
    """A record whose stamps are divided by a factor."""
    if record.name not in runs:
        return record

    def quicker(clock: Clocked | None) -> Clocked | None:
        if clock is None:
            return None
        between = {key: (stamps / by, values) for key, (stamps, values) in clock.between.items()}
        return replace(clock, time=clock.time / by, interval=clock.interval / by, between=between)

    return replace(record, fast=quicker(record.fast), slow=quicker(record.slow))
