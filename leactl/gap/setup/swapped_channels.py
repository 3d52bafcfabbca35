"""Find two channels in each other's column: neither follows its relation, and both do once exchanged.

A current and its reference are nearly equal. In a sound run the current is the later and the noisier one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.delays import lateness
from leactl.gap.setup.factor_hypotheses import ANGLE, CURRENT, REFERENCE, TORQUE, VELOCITY, is_usual
from leactl.gap.setup.relations import factors_of
from leactl.gap.signals.noise import noise_of
from leactl.gap.signals.record import Key, Record
from leactl.model.nominal import Model

SWAP = "channel_swap"
SWAPPABLE_CHANNELS = (
    CURRENT,
    REFERENCE,
    VELOCITY,
    ANGLE,
    TORQUE,
    ("q_axis_voltage", "test"),
    ("angle_reference", "test"),
)
DIRECT_RELATIONS = {"velocity test", "current test", "torque", "angle to its reference"}  # hold on any machine
MOST_TRIED_RUNS = 4  # runs that are tried with exchanged channels
LEAST_SWAPPED_SHARE = 0.5  # share of the runs with both channels that show a swap; one mapping makes all runs
MOST_CLEAN_RATIO = 0.1  # noise of the column named current in a swap, over that of the column named reference
LEAST_LEAD_SAMPLES = 0.1  # samples by which a current precedes its reference in a swap
LATENESS_STDS = 3.0  # standard errors by which a lateness must exceed `LEAST_LEAD_SAMPLES` to count
FAULT_PROBABILITY = 0.99  # probability of a swap


def find_swap(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the swap of two channels in all runs, if there is one."""
    return find_current_swap(records) or find_any_swap(records, model)


def find_any_swap(records: Sequence[Record], model: Model) -> SetUpFault | None:
    """Return the swap whose exchange makes every direct relation of the runs hold, if there is one."""
    relations_by_run = {record.name: direct_relations(record, model) for record in records}
    is_unusual_run = {run: not all(relations) for run, relations in relations_by_run.items() if relations}
    exchanges: list[tuple[int, Key, Key]] = []
    for first_key, second_key in combinations(SWAPPABLE_CHANNELS, 2):
        with_both = [
            record
            for record in records
            if record.name in is_unusual_run and has_channel(record, first_key) and has_channel(record, second_key)
        ]
        tried_records = [record for record in with_both if is_unusual_run[record.name]][:MOST_TRIED_RUNS]
        if {first_key, second_key} == {CURRENT, REFERENCE} or sum(
            is_unusual_run[record.name] for record in with_both
        ) <= LEAST_SWAPPED_SHARE * len(with_both):
            continue
        exchanged_records = [with_exchanged(record, first_key, second_key) for record in tried_records]
        if all(all_direct(record, model) for record in exchanged_records):
            score_before, score_after = (
                sum(score(record, model) for record in group) for group in (tried_records, exchanged_records)
            )
            if score_after - score_before >= 2 * len(tried_records):
                exchanges.append((score_after - score_before, first_key, second_key))
    if not exchanges:
        return None
    _, first_key, second_key = max(exchanges)
    return fault_of(first_key, second_key, "neither follows what it should, and both do once they are exchanged")


def has_channel(record: Record, key: Key) -> bool:
    """Return whether a run has a channel."""
    return record.fast is not None and key in record.fast.values


def direct_relations(record: Record, model: Model) -> list[bool]:
    """Return for each direct relation of a run whether it holds with a usual factor."""
    return [
        factor.holds and is_usual(factor) for factor in factors_of(record, model) if factor.relation in DIRECT_RELATIONS
    ]


def all_direct(record: Record, model: Model) -> bool:
    """Return whether a run has a direct relation and all of them hold."""
    direct = direct_relations(record, model)
    return bool(direct) and all(direct)


def score(record: Record, model: Model) -> int:
    """Return the number of usual relations of a run less the number of unusual ones."""
    return sum(1 if factor.holds and is_usual(factor) else -1 for factor in factors_of(record, model))


def find_current_swap(records: Sequence[Record]) -> SetUpFault | None:
    """Return the swap of current and reference if the current precedes its reference, which has all the noise."""
    verdicts = [
        is_early(record) for record in records if has_channel(record, CURRENT) and has_channel(record, REFERENCE)
    ]
    clear_verdicts = [verdict for verdict in verdicts if verdict is not None]
    if not clear_verdicts or not all(clear_verdicts):
        return None
    fault = fault_of(CURRENT, REFERENCE, "the current goes ahead of its reference, and the reference has the noise")
    return replace(fault, shrinks=False)


def is_early(record: Record) -> bool | None:
    """Return whether a run's current precedes its reference; None unless it is far cleaner and its lateness clear."""
    clock = record.fast
    if clock is None:
        return None
    current, reference = clock.values[CURRENT], clock.values[REFERENCE]
    if noise_of(current, 0.0) >= MOST_CLEAN_RATIO * noise_of(reference, 0.0):
        return None
    stretches = lateness(current, reference, clock.all_valid(CURRENT, REFERENCE))
    if not stretches:
        return None
    # a loop slow enough to filter that much noise would be late by more than a stamp can be wrong
    mean_lateness, error = stretches.mean()
    return (
        mean_lateness < -LEAST_LEAD_SAMPLES if abs(mean_lateness) > LEAST_LEAD_SAMPLES + LATENESS_STDS * error else None
    )


def fault_of(first: Key, second: Key, evidence: str) -> SetUpFault:
    """Return the fault of two exchanged channels."""
    change = f"exchange the columns of {first[0]} and {second[0]} in the mapping, or their names in the bench file"
    mend = partial(with_exchanged, first=first, second=second)
    return SetUpFault(SWAP, first, FAULT_PROBABILITY, f"and {second[0]} stand for each other: {evidence}", change, mend)


def with_exchanged(record: Record, first: Key, second: Key) -> Record:
    """Return a record with two channels exchanged."""
    clock = record.fast
    if clock is None or first not in clock.values or second not in clock.values:
        return record
    partner = {first: second, second: first}

    def renamed(keys: Sequence[Key]) -> Iterator[tuple[Key, Key]]:
        return ((partner.get(key, key), key) for key in keys)

    return replace(
        record,
        fast=replace(
            clock,
            values={new_key: clock.values[old_key] for new_key, old_key in renamed(list(clock.values))},
            valid={new_key: clock.valid[old_key] for new_key, old_key in renamed(list(clock.valid))},
            between={new_key: clock.between[old_key] for new_key, old_key in renamed(list(clock.between))},
        ),
    )
