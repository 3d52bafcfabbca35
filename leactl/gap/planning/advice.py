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
    """Parse standard deviations from entries `quantity=std` of the command line.

    Raises
    ------
    InputError : no such channel, or no such number; one line each.
    """
    noise, faults = {}, []
    for item in entries:
        name, _, text = item.partition("=")
        try:
            noise[name] = float(text)
        except ValueError:
            noise[name] = -1.0
        if name not in usual_noise():
            faults.append(f"--noise {item}: one of {', '.join(usual_noise())} was expected")
        elif not 0.0 <= noise[name] < math.inf:
            faults.append(f"--noise {item}: quantity=std was expected, a number of zero or more")
    if faults:
        raise InputError(faults)
    return noise


def advise(model_file: Path, runs: Sequence[Path], protocols: Sequence[str], noise: Mapping[str, float]) -> Advice:
    """Judge runs and protocols together, then every shipped protocol in addition to them.

    Raises
    ------
    InputError : files or names that cannot be used, or nothing to judge.
    """
    model, _ = read_model(model_file)
    spread = usual_noise() | dict(noise)
    records = [record for several in read_records(runs, model.bench).values() for record in several]
    plans = [protocolfile.load(name) for name in protocols]
    known = {plan.name for plan in plans}
    further = [plan for name in shipped.names() if (plan := protocolfile.load(name)).name not in known]
    records += [planned_record(plan, model, spread) for plan in plans]
    notes: list[str] = []
    planned: list[tuple[Plan, Record]] = []
    for plan in further:
        try:
            planned.append((plan, planned_record(plan, model, spread)))
        except InputError as error:
            notes += error.faults
    if not records and not planned:
        raise InputError(["there is nothing to plan with", *notes])
    evidence = evidence_of([*records, *(record for _, record in planned)], model)
    base = [record.run for record in records]
    present_sights = sights(evidence, base)
    experiments = [experiment(plan, present_sights, sights(evidence, [*base, record.run])) for plan, record in planned]
    useful = sorted((e for e in experiments if e.gain > 0.0), key=lambda e: -e.gain)
    shown_effects = {s.effect for s in present_sights if s.seen}.union(*(e.shows for e in useful))
    return Advice(
        tuple(present_sights),
        tuple(useful),
        tuple(s.effect for s in present_sights if s.effect not in shown_effects),
        tuple(notes),
    )


def experiment(plan: Plan, before: Sequence[Sight], after: Sequence[Sight]) -> AdvisedProtocol:
    """Return the effects and pairs that a protocol shows in addition."""
    shows = tuple(b.effect for a, b in zip(before, after, strict=True) if b.seen and not a.seen)
    pairs_before, pairs_after = pairs(before), pairs(after)
    # two effects of which one is invisible are not separated
    visible = {s.effect for s in after if s.smallest is not None}
    separated = tuple(sorted(pair for pair in pairs_before - pairs_after if set(pair) <= visible))
    return AdvisedProtocol(plan.name, plan.duration_s, shows, separated)


def pairs(sights: Sequence[Sight]) -> set[tuple[str, str]]:
    """Return the pairs of effects that are not separated."""
    return {(s.effect, other) for s in sights for other in s.alike if s.effect < other}
