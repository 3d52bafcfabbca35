"""Find two channels in each other's column: neither follows its relation, and both do once exchanged.

A current and its reference are nearly equal. In a sound run the current is the later and the noisier one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.delays import lateness
from leactl.gap.setup.hypotheses import ANGLE, CURRENT, REFERENCE, TORQUE, VELOCITY, usual
from leactl.gap.setup.relations import factors_of
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Key, Record
from leactl.model.nominal import Model

SWAP = "channel_swap"
SWAPPED = (CURRENT, REFERENCE, VELOCITY, ANGLE, TORQUE, ("q_axis_voltage", "test"), ("angle_reference", "test"))
DIRECT = {"velocity test", "current test", "torque", "angle to its reference"}  # relations that hold on any machine
TRIED = 4  # most runs tried with exchanged channels
MOST = 0.5  # smallest share of the runs with both channels that show a swap: one mapping makes all of them
CLEANER = 0.1  # largest noise of a reference, as a share of the current's
BEFORE = 0.1  # samples by which a current has to precede its reference to be early,
ERRORS = 3.0  # plus so many standard errors for a lateness to be known
SEEN = 0.99  # probability of such a fault


def swapped(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the swap of two channels in all runs, if there is one."""
    return of_current(records) or of_any(records, model)


def of_any(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the swap after whose exchange every direct relation holds that did not hold before."""
    direct = {record.name: told_directly(record, model) for record in records}
    odd = {run: not all(relations) for run, relations in direct.items() if relations}
    exchanges: list[tuple[int, Key, Key]] = []
    for first_key, second_key in combinations(SWAPPED, 2):
        with_both = [
            record for record in records if record.name in odd and has(record, first_key) and has(record, second_key)
        ]
        tried = [record for record in with_both if odd[record.name]][:TRIED]
        if {first_key, second_key} == {CURRENT, REFERENCE} or sum(
            odd[record.name] for record in with_both
        ) <= MOST * len(with_both):
            continue
        exchanged = [with_exchanged(record, first_key, second_key) for record in tried]
        if all(all_direct(record, model) for record in exchanged):
            score_before, score_after = (sum(score(record, model) for record in group) for group in (tried, exchanged))
            if score_after - score_before >= 2 * len(tried):
                exchanges.append((score_after - score_before, first_key, second_key))
    if not exchanges:
        return None
    _, first_key, second_key = max(exchanges)
    return fault_of(first_key, second_key, "neither follows what it should, and both do once they are exchanged")


def has(record: Record, key: Key) -> bool:
    """Return whether a run has a channel."""
    return record.fast is not None and key in record.fast.values


def told_directly(record: Record, model: Model) -> list[bool]:
    """Return for each direct relation of a run whether it holds with a usual factor."""
    return [factor.holds and usual(factor) for factor in factors_of(record, model) if factor.relation in DIRECT]


def all_direct(record: Record, model: Model) -> bool:
    """Return whether a run has a direct relation and all of them hold."""
    direct = told_directly(record, model)
    return bool(direct) and all(direct)


def score(record: Record, model: Model) -> int:
    """Return the number of usual relations of a run less the number of unusual ones."""
    return sum(1 if factor.holds and usual(factor) else -1 for factor in factors_of(record, model))


def of_current(records: Sequence[Record]) -> SetUpFault | None:
    """Return the swap of current and reference if the current precedes its reference, which has all the noise."""
    early = [early_of(record) for record in records if has(record, CURRENT) and has(record, REFERENCE)]
    known = [early_run for early_run in early if early_run is not None]
    if not known or not all(known):
        return None
    fault = fault_of(CURRENT, REFERENCE, "the current goes ahead of its reference, and the reference has the noise")
    return replace(fault, shrinks=False)


def early_of(record: Record) -> bool | None:
    """Return whether a run's current precedes its reference; None unless it is far cleaner and its lateness clear."""
    clock = record.fast
    if clock is None:
        return None
    current, reference = clock.values[CURRENT], clock.values[REFERENCE]
    if noise_of(current, 0.0) >= CLEANER * noise_of(reference, 0.0):
        return None
    stretches = lateness(current, reference, clock.all_valid(CURRENT, REFERENCE))
    if not stretches:
        return None
    # a loop slow enough to filter that much noise would be late by more than a stamp can be wrong
    late, error = stretches.mean()
    return late < -BEFORE if abs(late) > BEFORE + ERRORS * error else None


def fault_of(first: Key, second: Key, evidence: str) -> SetUpFault:
    """Return the fault of two exchanged channels."""
    change = f"exchange the columns of {first[0]} and {second[0]} in the mapping, or their names in the bench file"
    mend = partial(with_exchanged, first=first, second=second)
    return SetUpFault(SWAP, first, SEEN, f"and {second[0]} stand for each other: {evidence}", change, mend)


def with_exchanged(record: Record, first: Key, second: Key) -> Record:
    """Return a record with two channels exchanged."""
    clock = record.fast
    if clock is None or first not in clock.values or second not in clock.values:
        return record
    exchanged = {first: second, second: first}

    def renamed(names: Sequence[Key]) -> Iterator[tuple[Key, Key]]:
        return ((exchanged.get(name, name), name) for name in names)

    return replace(
        record,
        fast=replace(
            clock,
            values={new_key: clock.values[old_key] for new_key, old_key in renamed(list(clock.values))},
            valid={new_key: clock.valid[old_key] for new_key, old_key in renamed(list(clock.valid))},
            between={new_key: clock.between[old_key] for new_key, old_key in renamed(list(clock.between))},
        ),
    )
