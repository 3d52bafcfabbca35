"""Two channels that stand in each other's column: neither follows what it should, and both do once exchanged.

A current and its reference say nearly the same. They are told apart by which goes first and which has the noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.hypotheses import ANGLE, CURRENT, REFERENCE, TORQUE, VELOCITY, usual
from leactl.gap.setup.lateness import lateness
from leactl.gap.setup.relations import factors_of
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Key, Record
from leactl.model.nominal import Model

SWAP = "channel_swap"
SWAPPED = (CURRENT, REFERENCE, VELOCITY, ANGLE, TORQUE, ("q_axis_voltage", "test"), ("angle_reference", "test"))
DIRECT = {"velocity test", "current test", "torque", "angle to its reference"}  # relations that hold on any machine
TRIED = 4  # runs
MOST = 0.5  # of the runs with both channels, that show a swap: one mapping makes all of them
CLEANER = 0.1  # of the current's noise, that a reference may have at most
BEFORE = 0.1  # samples, by which nothing answers before it is asked, and errors beyond that
ERRORS = 3.0
SEEN = 0.99


def swapped(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Two channels of all runs that stand for each other."""
    return of_current(records) or of_any(records, model)


def of_any(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """The pair after whose exchange every direct relation holds, none of the two having held before."""
    direct = {record.name: told_directly(record, model) for record in records}
    odd = {run: not all(told) for run, told in direct.items() if told}
    exchanges: list[tuple[int, Key, Key]] = []
    for first, second in combinations(SWAPPED, 2):
        there = [record for record in records if record.name in odd and has(record, first) and has(record, second)]
        both = [record for record in there if odd[record.name]][:TRIED]
        if {first, second} == {CURRENT, REFERENCE} or sum(odd[record.name] for record in there) <= MOST * len(there):
            continue
        exchanged = [with_exchanged(record, first, second) for record in both]
        if all(all_direct(record, model) for record in exchanged):
            before, after = (sum(score(record, model) for record in group) for group in (both, exchanged))
            if after - before >= 2 * len(both):
                exchanges.append((after - before, first, second))
    if not exchanges:
        return None
    _, first, second = max(exchanges)
    return fault_of(first, second, "neither follows what it should, and both do once they are exchanged")


def has(record: Record, key: Key) -> bool:
    """Whether a run has a channel."""
    return record.fast is not None and key in record.fast.values


def told_directly(record: Record, model: Model) -> list[bool]:
    """Of each direct relation of a run, whether it holds by a usual factor."""
    return [one.holds and usual(one) for one in factors_of(record, model) if one.relation in DIRECT]


def all_direct(record: Record, model: Model) -> bool:
    """Whether every direct relation of a run holds, and there is one."""
    direct = told_directly(record, model)
    return bool(direct) and all(direct)


def score(record: Record, model: Model) -> int:
    """Relations of a run that are usual less those that are not."""
    return sum(1 if one.holds and usual(one) else -1 for one in factors_of(record, model))


def of_current(records: Sequence[Record]) -> SetUpFault | None:
    """A current that goes ahead of its reference, which has all the noise."""
    early = [early_of(record) for record in records if has(record, CURRENT) and has(record, REFERENCE)]
    told = [one for one in early if one is not None]
    if not told or not all(told):
        return None
    fault = fault_of(CURRENT, REFERENCE, "the current goes ahead of its reference, and the reference has the noise")
    return replace(fault, shrinks=False)


def early_of(record: Record) -> bool | None:
    """Whether the current of a run goes ahead of its reference and is the cleaner of the two; None if nothing tells."""
    clock = record.fast
    if clock is None:
        return None
    current, reference = clock.values[CURRENT], clock.values[REFERENCE]
    if noise_of(current, 0.0) >= CLEANER * noise_of(reference, 0.0):
        return None
    stretches = lateness(current, reference, clock.all_valid(CURRENT, REFERENCE))
    if not stretches:
        return None
    # a loop slow enough to take that much noise away would be late by more than a stamp may be off
    late, error = stretches.mean()
    return late < -BEFORE if abs(late) > BEFORE + ERRORS * error else None


def fault_of(first: Key, second: Key, evidence: str) -> SetUpFault:
    """Two channels that stand for each other."""
    change = f"exchange the columns of {first[0]} and {second[0]} in the mapping, or their names in the bench file"
    mend = partial(with_exchanged, first=first, second=second)
    return SetUpFault(SWAP, first, SEEN, f"and {second[0]} stand for each other: {evidence}", change, mend)


def with_exchanged(record: Record, first: Key, second: Key) -> Record:
    """A record whose two channels are exchanged."""
    clock = record.fast
    if clock is None or first not in clock.values or second not in clock.values:
        return record
    other = {first: second, second: first}

    def renamed(names: Sequence[Key]) -> Iterator[tuple[Key, Key]]:
        return ((other.get(name, name), name) for name in names)

    return replace(
        record,
        fast=replace(
            clock,
            values={new: clock.values[old] for new, old in renamed(list(clock.values))},
            valid={new: clock.valid[old] for new, old in renamed(list(clock.valid))},
            between={new: clock.between[old] for new, old in renamed(list(clock.between))},
        ),
    )
