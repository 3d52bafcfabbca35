"""Advise the shipped protocol that makes most of the invisible effects visible per second of bench time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from leactl.errors import InputError
from leactl.gap.planning.records import planned_record, usual_noise
from leactl.gap.planning.visible_sizes import Sight, evidence_of, sights
from leactl.gap.replay.long_runs import read_records
from leactl.gap.signals.record import Record
from leactl.model.nominal import read_model
from leactl.protocol import protocolfile, shipped
from leactl.protocol.plan import Plan


@dataclass(frozen=True)
class AdvisedProtocol:
    """A shipped protocol, and what it shows in addition to the given runs and protocols."""

    protocol: str
    duration_s: float
    shows: tuple[str, ...]  # effects that it makes visible at every size worth knowing
    separates: tuple[tuple[str, str], ...]  # pairs of effects that it separates

    @property
    def gain(self) -> float:
        """Effects shown and pairs separated, per second of bench time."""
        return (len(self.shows) + len(self.separates)) / self.duration_s


@dataclass(frozen=True)
class Advice:
    """Effects visible in the given runs and protocols, and further protocols, the largest gain first."""

    sights: tuple[Sight, ...]
    experiments: tuple[AdvisedProtocol, ...]
    dark: tuple[str, ...]  # effects that no given run or protocol, nor any shipped protocol shows
    notes: tuple[str, ...]


def read_noise(entries: Sequence[str]) -> dict[str, float]:
    """Return standard deviations by quantity, from entries `quantity=std` of the command line.

    Raises
    ------
    InputError : an entry names no quantity that has noise, or its number is not zero or more; one line each.
    """
    noise, faults = {}, []
    for entry in entries:
        name, _, text = entry.partition("=")
        try:
            noise[name] = float(text)
        except ValueError:
            noise[name] = -1.0
        if name not in usual_noise():
            faults.append(f"--noise {entry}: one of {', '.join(usual_noise())} was expected")
        elif not 0.0 <= noise[name] < math.inf:
            faults.append(f"--noise {entry}: quantity=std was expected, a number of zero or more")
    if faults:
        raise InputError(faults)
    return noise


def advise(model_file: Path, runs: Sequence[Path], protocols: Sequence[str], noise: Mapping[str, float]) -> Advice:
    """Return what runs and protocols show together, and what every shipped protocol shows in addition.

    Raises
    ------
    InputError : files or names that cannot be used, or no run or protocol to judge.
    """
    model, _ = read_model(model_file)
    noise_by_quantity = usual_noise() | dict(noise)
    records = [record for records_of_run in read_records(runs, model.bench).values() for record in records_of_run]
    plans = [protocolfile.load(name) for name in protocols]
    planned_names = {plan.name for plan in plans}
    further_plans = [plan for name in shipped.names() if (plan := protocolfile.load(name)).name not in planned_names]
    records += [planned_record(plan, model, noise_by_quantity) for plan in plans]
    notes: list[str] = []
    planned: list[tuple[Plan, Record]] = []
    for plan in further_plans:
        try:
            planned.append((plan, planned_record(plan, model, noise_by_quantity)))
        except InputError as error:
            notes += error.faults
    if not records and not planned:
        raise InputError(["there is nothing to plan with", *notes])
    evidence = evidence_of([*records, *(record for _, record in planned)], model)
    given_runs = [record.run for record in records]
    present_sights = sights(evidence, given_runs)
    experiments = [
        experiment(plan, present_sights, sights(evidence, [*given_runs, record.run])) for plan, record in planned
    ]
    useful = sorted((advised for advised in experiments if advised.gain > 0.0), key=lambda advised: -advised.gain)
    shown_effects = {sight.effect for sight in present_sights if sight.seen}.union(
        *(advised.shows for advised in useful)
    )
    return Advice(
        tuple(present_sights),
        tuple(useful),
        tuple(sight.effect for sight in present_sights if sight.effect not in shown_effects),
        tuple(notes),
    )


def experiment(plan: Plan, sights_before: Sequence[Sight], sights_after: Sequence[Sight]) -> AdvisedProtocol:
    """Return the effects that a protocol shows, and the pairs that it separates, in addition to earlier runs."""
    shows = tuple(
        sight_after.effect
        for sight_before, sight_after in zip(sights_before, sights_after, strict=True)
        if sight_after.seen and not sight_before.seen
    )
    pairs_before, pairs_after = pairs(sights_before), pairs(sights_after)
    # two effects of which one is invisible are not separated
    visible = {sight.effect for sight in sights_after if sight.smallest is not None}
    separated = tuple(sorted(pair for pair in pairs_before - pairs_after if set(pair) <= visible))
    return AdvisedProtocol(plan.name, plan.duration_s, shows, separated)


def pairs(sights: Sequence[Sight]) -> set[tuple[str, str]]:
    """Return the pairs of effects that are not separated."""
    return {(sight.effect, other) for sight in sights for other in sight.alike if sight.effect < other}
