"""Which effects stay in the dark, and which shipped protocol lights most of them per second of bench time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from leactl.errors import InputError
from leactl.gap.planning.records import planned_record, usual_noise
from leactl.gap.planning.reveal import Sight, evidence_of, sights
from leactl.gap.replay.stretches import read_records
from leactl.gap.signals.record import Record
from leactl.model.nominal import read_model
from leactl.protocol import protocolfile, shipped
from leactl.protocol.plan import Plan


@dataclass(frozen=True)
class AdvisedProtocol:
    """A shipped protocol beside what there is."""

    protocol: str
    duration_s: float
    shows: tuple[str, ...]  # effects that it makes visible at every size worth knowing
    separates: tuple[tuple[str, str], ...]  # pairs that it tells apart

    @property
    def gain(self) -> float:
        """Questions answered per second."""
        return (len(self.shows) + len(self.separates)) / self.duration_s


@dataclass(frozen=True)
class Advice:
    """What there is shows, and what would show more, the most per second first."""

    sights: tuple[Sight, ...]
    experiments: tuple[AdvisedProtocol, ...]
    dark: tuple[str, ...]  # effects that neither what there is nor any one of the protocols shows
    notes: tuple[str, ...]


def read_noise(given: Sequence[str]) -> dict[str, float]:
    """Standard deviations from `quantity=std` as it stands on the command line.

    Raises
    ------
    InputError : no such channel, or no such number; one line each.
    """
    noise, faults = {}, []
    for item in given:
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
    """Judge runs and protocols together, then every shipped protocol beside them.

    Raises
    ------
    InputError : files or names that cannot be used, or nothing to judge.
    """
    model, _ = read_model(model_file)
    spread = usual_noise() | dict(noise)
    given = [record for several in read_records(runs, model.bench).values() for record in several]
    plans = [protocolfile.load(name) for name in protocols]
    known = {plan.name for plan in plans}
    further = [plan for name in shipped.names() if (plan := protocolfile.load(name)).name not in known]
    given += [planned_record(plan, model, spread) for plan in plans]
    notes: list[str] = []
    extra: list[tuple[Plan, Record]] = []
    for plan in further:
        try:
            extra.append((plan, planned_record(plan, model, spread)))
        except InputError as error:
            notes += error.faults
    if not given and not extra:
        raise InputError(["there is nothing to plan with", *notes])
    evidence = evidence_of([*given, *(record for _, record in extra)], model)
    base = [record.run for record in given]
    now = sights(evidence, base)
    experiments = [experiment(plan, now, sights(evidence, [*base, record.run])) for plan, record in extra]
    useful = sorted((e for e in experiments if e.gain > 0.0), key=lambda e: -e.gain)
    shown = {s.effect for s in now if s.seen}.union(*(e.shows for e in useful))
    return Advice(tuple(now), tuple(useful), tuple(s.effect for s in now if s.effect not in shown), tuple(notes))


def experiment(plan: Plan, before: Sequence[Sight], after: Sequence[Sight]) -> AdvisedProtocol:
    """What a protocol adds."""
    shows = tuple(b.effect for a, b in zip(before, after, strict=True) if b.seen and not a.seen)
    old, new = pairs(before), pairs(after)
    # two effects of which one was invisible were not taken for each other, and still are not told apart
    visible = {s.effect for s in after if s.smallest is not None}
    told = tuple(sorted(pair for pair in old - new if set(pair) <= visible))
    return AdvisedProtocol(plan.name, plan.duration_s, shows, told)


def pairs(sights: Sequence[Sight]) -> set[tuple[str, str]]:
    """Pairs of effects that are not told apart."""
    return {(s.effect, other) for s in sights for other in s.alike if s.effect < other}
