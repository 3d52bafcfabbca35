"""What a sound machine of this kind leaves over, measured on the case: the model itself through the case's own runs.

Each run is simulated again without any effect, in one piece, kept near its measured motion by a torque that its
current then carries, so that the simulated run is one that the model explains exactly. Its channels get the noise and
rounding that the measured ones show, and pass through the same regression. What is found there is no effect: its size
is the floor of each effect, what it leaves over that of each equation, how far it moves a parameter that one's error.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from leactl.effects import library
from leactl.effects.shapes import delayed
from leactl.gap.diagnosis import CalibratedParameter
from leactl.gap.replay import replay_all
from leactl.gap.replay.bearing import TRIED
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.drive import over_samples
from leactl.gap.replay.job import Job
from leactl.gap.replay.readings import angle, current, velocity
from leactl.gap.search.evidence import MOST_MOVED, PINNED, PRIORS, Evidence, Null, error_of
from leactl.gap.search.parameters import (
    UNITS,
    calibrated,
    effect_parameters,
    nominal_value,
    with_calibration,
    with_effects,
)
from leactl.gap.search.regression import Candidate, Fit
from leactl.gap.search.ringing import ringing
from leactl.gap.search.sets import (
    ENTRY,
    EffectSet,
    FurtherEffect,
    by_themselves,
    describe,
    exchange,
    finding,
    refine,
    sizes_by_chance,
    standard_errors,
)
from leactl.gap.signals.derived import moved_by_a_servo
from leactl.gap.signals.noise import coloured, quantum_of
from leactl.gap.signals.record import WINDING, Clocked, Key, Record
from leactl.gap.signals.rig import fed_by_voltage
from leactl.gap.signals.smoothing import BASE, smooth
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
NULLS = 3  # sound machines
ALIKE = 2.0  # standard errors of a mean over them, above which they show an effect alike
TORQUE_CONSTANT = "torque_constant"
FARTHEST_STAMP = 1.0  # samples, by which a stamp that no file explains may be off
SLOW_WIDTH = 8.0  # samples, smoothing of temperatures that drive a simulation


def measure(
    records: Sequence[Record],
    model: Model,
    machines: int = NULLS,
    only: Sequence[Candidate] | None = None,
    seed: int = 0,
) -> Null:
    """Simulate the runs of a case as sound machines would make them, and look for effects there.

    only : forms of effects to look for, all if not given.

    A voltage or a torque sensor determines the torque constant. Where one is logged and too noisy to do so, the
    constant and all torques are biased towards zero together: then the machines are simulated again, with constants on
    either side of the model's, and fits hold the model's. Where none is logged, `Evidence` holds the constant in all
    fits.
    """
    random = np.random.default_rng(seed)
    machines_runs = sound_runs(records, [model] * machines, random)
    moved, kept = unidentifiable_torque_constant(machines_runs, model)
    if kept:
        machines_runs = sound_runs(records, machines_off(model, TORQUE_CONSTANT, machines), random)
    shown = NullValues()
    for runs in machines_runs:
        shown.add_machine(Evidence(runs, model, only, kept))
    return shown.null(shown.parameters() | moved, kept)


def unidentifiable_torque_constant(
    machines_runs: Sequence[Sequence[Record]], model: Model
) -> tuple[dict[str, tuple[float, float]], tuple[str, ...]]:
    """Where runs cannot tell the torque constant: mean and scatter of its relative change, and its name; else empty.

    No effect is looked for: its columns take most of the time of a null, and a calibration needs none of them.
    """
    calibrations = NullValues()
    for runs in machines_runs:
        evidence = Evidence(runs, model, only=())
        if evidence.tells_nothing_of(TORQUE_CONSTANT):  # nothing should tell it
            return {}, ()
        if evidence.stack.rows:
            calibrations.add_calibration(evidence)
    if TORQUE_CONSTANT not in calibrations.unidentifiable():
        return {}, ()
    return {TORQUE_CONSTANT: calibrations.parameters()[TORQUE_CONSTANT]}, (TORQUE_CONSTANT,)


def with_simulator_runs(null: Null, records: Sequence[Record], model: Model) -> Null:
    """The null with what runs of another simulator of the same machine show in it, whose nominal the model is.

    The variance that they leave over counts where it is larger, not its ratio to their noise: a simulator may write
    none. The size of each effect there is combined with its floor in quadrature, but for waves over the angle: their
    one floor stands for all orders, and a simulator's own wave of one order says nothing of another.
    """
    shown = NullValues()
    shown.add_machine(Evidence(records, model, kept=null.kept))
    own = shown.null(null.moved, null.kept)
    left = {key: max(value, own.left.get(key, 0.0)) for key, value in null.left.items()}
    floors = {
        effect: np.hypot(sizes, own.floors[effect]).tolist()
        if len(own.floors.get(effect, ())) == len(sizes) and not library()[effect].periodic
        else list(sizes)
        for effect, sizes in null.floors.items()
    }
    loud = {key[0] for key, value in own.left.items() if value > null.left.get(key, math.inf)}
    lines = {
        channel: max(height, own.lines.get(channel, 0.0)) if channel[0] in loud else height
        for channel, height in null.lines.items()
    }
    return replace(null, left=left, floors=floors, lines=lines)


def set_floors(evidence: Evidence, null: Null) -> None:
    """Take what sound machines show in the runs of a case as its floors.

    Where the runs give a form of a shaped effect a smaller standard error than the sound machines' runs do (their drive
    followed where the real one stood at a limit), its floor is multiplied by the ratio of the two; the size that they
    show in common stays.
    """
    evidence.compare_with(null)
    for effect, items in by_themselves(evidence).items():
        if not library()[effect].shaped or (sizes := null.floors.get(effect)) is None:
            continue
        pairs = zip(sizes, standard_errors(effect, items), null.errors[effect], strict=True)
        scaled = [size * min(own / theirs, 1.0) if theirs < math.inf else size for size, own, theirs in pairs]
        evidence.by_form[effect] = evidence.floors_of(effect, scaled)


@dataclass
class NullValues:
    """What sound machines show, one value for each of them."""

    unrest: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    left: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    white: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    sizes: dict[str, list[list[float]]] = field(default_factory=dict)  # of each effect in each of its forms
    errors: dict[str, list[list[float]]] = field(default_factory=dict)  # and their standard errors
    fits: dict[str, list[list[FurtherEffect | None]]] = field(default_factory=dict)  # behind both, but periodic
    lines: dict[tuple[str, str, str], list[float]] = field(default_factory=dict)
    moved: dict[str, list[float]] = field(default_factory=dict)
    priors: dict[str, float] = field(default_factory=dict)

    def add_calibration(self, evidence: Evidence) -> Fit:
        """Take in how far a fit without effects moves the parameters of one machine."""
        fit = evidence.settle([])
        self.priors = evidence.priors
        for place, value in zip(fit.columns, fit.values, strict=True):
            name = evidence.stack.names[place]
            if name[0] == "calibration":
                self.moved.setdefault(name[1], []).append(float(value))
        return fit

    def add_machine(self, evidence: Evidence) -> None:
        """Take in one machine; nothing of it is kept but these values, for its columns take much memory."""
        if not evidence.stack.rows:
            return
        fit = self.add_calibration(evidence)
        for key, value in evidence.unrest().items():
            self.unrest.setdefault(key, []).append(value)
        for key, value in evidence.left().items():
            self.left.setdefault(key, []).append(value)
        for key, value in evidence.white().items():
            self.white.setdefault(key, []).append(value)
        for effect, items in by_themselves(evidence).items():
            if not library()[effect].periodic:
                self.fits.setdefault(effect, []).append(items)
            if sizes := sizes_by_chance(effect, items):
                self.sizes.setdefault(effect, []).append(sizes)
                self.errors.setdefault(effect, []).append(standard_errors(effect, items))
        for channel, line in ringing(evidence, fit, [True] * len(evidence.stack.rows)).items():
            self.lines.setdefault(channel, []).append(line.height)

    def null(self, moved: Mapping[str, tuple[float, float]], kept: Sequence[str]) -> Null:
        """All machines together.

        moved : of each parameter, mean and scatter of its relative change.
        kept : parameters that no fit may move.
        """
        return Null(
            {key: float(np.mean(values)) for key, values in self.unrest.items()},
            {key: float(np.mean(values)) for key, values in self.left.items()},
            {key: float(np.mean(values)) for key, values in self.white.items()},
            {effect: np.sqrt(np.mean(np.square(sizes), axis=0)).tolist() for effect, sizes in self.sizes.items()},
            {effect: shown_alike(self.fits.get(effect, ())) for effect in self.sizes},
            {effect: np.mean(errors, axis=0).tolist() for effect, errors in self.errors.items()},
            {channel: float(np.mean(heights)) for channel, heights in self.lines.items()},
            moved,
            (*kept, *self.unidentifiable()),
            tuple(kept),
        )

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Mean and scatter of what fits make of the model's own parameters, as relative changes."""
        return {name: (float(np.mean(values)), float(np.std(values))) for name, values in self.moved.items()}

    def unidentifiable(self) -> tuple[str, ...]:
        """Parameters that sound machines move, each its own way; the scale of torques where they do alike, too.

        One that every fit holds is none of them: what its narrow prior lets it move says nothing.
        """
        return tuple(
            name
            for name, by in self.parameters().items()
            if self.priors.get(name) != PINNED
            and (math.hypot(*by) if name == TORQUE_CONSTANT else error_of(*by))
            > MOST_MOVED * self.priors.get(name, math.inf)
        )


def shown_alike(machines: Sequence[Sequence[FurtherEffect | None]]) -> list[float]:
    """Size that sound machines give an effect in common, form by form; empty where there is one machine or none.

    machines : of each machine, the effect fitted by itself in each of its forms; None where its runs do not show one.

    It is the length of the mean of their signed sizes, less noise. Zero where noise explains it, or where a machine
    does not show the form. Accelerations that are noise alone, as by a coarse encoder, look in every machine like a
    part of the inertia that hangs loose.
    """

    def of_form(shown: Sequence[FurtherEffect | None]) -> float:
        items = [item for item in shown if item is not None]
        if len(items) < len(shown):
            return 0.0
        mean = np.mean([item.directed for item in items], axis=0)
        noise = float(np.mean([item.directed_variance for item in items])) / len(items)
        square = float(mean @ mean)
        return math.sqrt(square - noise) if square > ALIKE**2 * noise else 0.0

    return [of_form(shown) for shown in zip(*machines, strict=True)] if len(machines) > 1 else []


def confirmed_beside_others(evidence: Evidence, result: EffectSet, seed: int = 0) -> EffectSet:
    """Drop the members of a set that also show in a machine which has only the other members.

    What equations miss of a large effect (its course within a sample, where friction turns back under it) may look like
    a smaller one. For each member such a machine is fitted and simulated through the same runs, and the member is
    fitted there. The size found is combined, in quadrature, with the member's floor and standard error. The member with
    the largest gain is not tested.
    """
    random = np.random.default_rng(seed)
    hypothesis = list(result.hypothesis)
    for item in sorted(result.members, key=lambda item: item.gain)[:-1]:
        others = [candidate for candidate in hypothesis if candidate != item.candidate]
        if item.size <= ENTRY * math.hypot(item.std, item.floor, size_beside(evidence, others, item, random)):
            hypothesis = others
    if hypothesis == result.hypothesis:
        return result
    return describe(evidence, refine(evidence, exchange(evidence, hypothesis)))


def size_beside(
    evidence: Evidence, others: Sequence[Candidate], item: FurtherEffect, random: np.random.Generator
) -> float:
    """Size of an effect, beyond noise, in a machine that has only the others; zero where it cannot be simulated."""
    # beside the whole set: without the effect its likeness in the model, as a stiffness of a shaft's, takes its place
    own = calibrated(evidence, evidence.settle([*others, item.candidate]))
    fit = evidence.settle(others)
    acting = [(c[0], {p.name: p.value for p in effect_parameters(evidence, fit, c)}) for c in others]
    machine = with_effects(with_calibration(evidence.model, own), acting)
    (runs,) = sound_runs(evidence.records, [machine], random)
    again = Evidence(runs, evidence.model, only=[*others, item.candidate], kept=evidence.kept)
    if not again.stack.rows:
        return 0.0
    again.settle([*others, item.candidate])
    shown = finding(again, again.normal(), again.stack.columns_of(others), item.candidate, free=True)
    return math.sqrt(max(shown.size**2 - shown.std**2, 0.0)) if shown is not None else 0.0


def machines_off(model: Model, parameter: str, count: int) -> list[Model]:
    """Machines whose parameter is off the model's, by what is usual as a root mean square.

    One over the value is spread symmetrically about the model's, with the prior as its root mean square, so that an
    error common to all machines comes from the fits. Of an odd number one machine is the model; a single one is off.
    """
    nominal = nominal_value(model, parameter)
    if nominal is None:
        return [model] * count
    by = PRIORS[parameter] * math.sqrt(count / max(2 * (count // 2), 1))
    steps = [by, -by] * (count // 2) + ([0.0] if count > 1 else [by]) * (count % 2)
    units = UNITS.get(parameter, "")
    return [
        with_calibration(model, [CalibratedParameter(parameter, nominal, nominal / (1.0 + step), 0.0, units)])
        for step in steps
    ]


def sound_runs(records: Sequence[Record], machines: Sequence[Model], random: np.random.Generator) -> list[list[Record]]:
    """The runs of a case as some sound machines would have made them; a run that cannot be simulated is left out."""
    sets: list[list[Job]] = []
    for machine in machines:
        plant = plant_of(machine)
        plant.give = float(random.choice(TRIED))  # no model file says it
        sets.append([Job(driven(record), plant, tracked=True) for record in records])
    replay_all([job for own in sets for job in own])
    for own in sets:
        logged(own, random)
    return [
        [again for job, record in zip(own, records, strict=True) if (again := recorded(job, record, random))]
        for own in sets
    ]


def logged(jobs: Sequence[Job], random: np.random.Generator) -> None:
    """Let one log stamp the runs of a machine in its own way, as far as its files do not say how they are stamped."""
    current_late, reference_late, velocity_late = random.uniform(-FARTHEST_STAMP, FARTHEST_STAMP, 3)
    straight = bool(random.integers(2))  # whether a reference goes on a straight line to its next value
    for job in jobs:
        unstamped = job.record.fast.unstamped if job.record.fast is not None else set()
        if job.current is not None and job.current_mean is not None and ("q_axis_current", "test") in unstamped:
            late = float(current_late + reference_late) * job.parts
            job.current, job.current_mean = (
                delayed(
                    uniform_filter1d(values, job.parts, origin=(job.parts - 1) // 2) if straight else values, late, 1.0
                )
                for values in (job.current, job.current_mean)
            )
        if job.current is None and job.angle is not None and ("q_axis_voltage", "test") in unstamped:
            # of a voltage and the motion that it makes, only how they stand to each other shows
            job.angle = delayed(job.angle, -float(current_late + reference_late) * job.parts, 1.0)
        if job.velocity is not None and ("velocity", "test") in job.fast and ("velocity", "test") in unstamped:
            job.velocity = delayed(job.velocity, float(velocity_late) * job.parts, 1.0)
            job.fast["velocity", "test"] = velocity(job)


def driven(record: Record) -> Record:
    """A run whose measured inputs are without noise: rotors would creep under noise, which then counts twice."""
    fast, slow = record.fast, record.slow
    if fast is not None:
        drives = "q_axis_current" if ("q_axis_current", "test") in fast.values else "q_axis_voltage"
        fast = replace(fast, values=evened(fast.values, drives, BASE))
    if slow is not None:
        fed = smooth(slow.fed, SLOW_WIDTH) if slow.fed is not None else None
        slow = replace(slow, values=evened(slow.values, "_temperature", SLOW_WIDTH), fed=fed)
    return replace(record, fast=fast, slow=slow)


def evened(values: Mapping[Key, Array], ending: str, width: float) -> dict[Key, Array]:
    """Channels, smoothed where their quantity ends so."""
    return {key: smooth(column, width) if key[0].endswith(ending) else column for key, column in values.items()}


def recorded(job: Job, record: Record, random: np.random.Generator) -> Record | None:
    """A simulated run with the channels, noise and rounding of the measured one; None where nothing was simulated."""
    if not job.fast and not job.slow:
        return None
    fast, slow = record.fast, record.slow
    if fast is not None:
        fast = replace(fast, values=read_again(fast, fast_channels(job), random))
    if slow is not None:
        fed = slow.fed
        if fed is not None and WINDING in job.slow and job.record.slow is not None and job.record.slow.fed is not None:
            simulated = job.record.slow.fed + job.slow[WINDING] - job.record.slow.values[WINDING]
            fed = with_noise(simulated, fed, random)
        slow = replace(slow, values=read_again(slow, job.slow, random), fed=fed)
    return replace(record, fast=fast, slow=slow, notes=[])


def fast_channels(job: Job) -> dict[Key, Array]:
    """Channels of the fast clock that a simulated run makes anew, without noise."""
    channels, values = dict(job.fast), job.clock.values
    if job.angle is not None:
        channels["angle", "test"] = angle(job)
    if (flowing := current(job)) is not None:
        channels["q_axis_current", "test"] = flowing
    if (load := values.get(("q_axis_current", "load"))) is not None:
        channels["q_axis_current", "load"] = load  # flows as it was measured
    if job.pull is not None:
        for key, more in asked_for(job, job.pull).items():
            if key in values:
                channels[key] = values[key] + more
    return channels


def asked_for(job: Job, pull: Array) -> dict[Key, Array]:
    """What the references of a run ask for beyond the measured ones, so that its drive makes the torque that tracks."""
    constant = job.plant.model.torque_constant or 1.0
    total = (len(job.clock.time) - 1) * job.parts + 1
    if (fed := fed_by_voltage(job.record, job.plant.model)) is not None:
        over = over_samples(0.5 * (pull[1:total] + pull[: total - 1]), job.parts)
        return {("q_axis_voltage", "test"): over / fed.gain}
    if job.current is None:
        told = "torque_reference" if ("torque_reference", "test") in job.clock.values else "torque"
        return {(told, "test"): over_samples(0.5 * (pull[1:total] + pull[: total - 1]), job.parts)}
    more = unled(followed_to(pull[: total : job.parts] / constant, job), job)
    return {("q_axis_current_reference", "test"): more}


def followed_to(ends: Array, job: Job) -> Array:
    """What a current loop must follow over each interval, so that it stands at a given current at its end."""
    bandwidth = job.plant.model.bench.current_loop_bandwidth
    decay = float(np.exp(-2.0 * np.pi * bandwidth * job.clock.interval)) if bandwidth else 0.0
    return (ends - decay * np.concatenate([ends[:1], ends[:-1]])) / (1.0 - decay)


def unled(followed: Array, job: Job) -> Array:
    """The reference whose lead makes a loop follow a given one."""
    bench, interval = job.plant.model.bench, job.clock.interval
    if not bench.setpoint_lead or moved_by_a_servo(job.clock):
        return followed
    decay = float(np.exp(-interval / bench.setpoint_lead_time))
    share = bench.setpoint_lead * (bench.setpoint_lead_time / interval) * (1.0 - decay)
    kept, taken = decay + (1.0 - decay) * share / (1.0 + share), (1.0 - decay) / (1.0 + share)
    caught = lfilter([0.0, taken], [1.0, -kept], followed - followed[0]) + followed[0]
    return np.asarray((followed + share * caught) / (1.0 + share), np.float64)


def read_again(clock: Clocked, simulated: Mapping[Key, Array], random: np.random.Generator) -> dict[Key, Array]:
    """Channels of a clock: those that were simulated with the noise of the measured ones, the others as they are."""
    references = {key for key in simulated if key[0].endswith("_reference")}
    return {
        key: values
        if key not in simulated
        else np.where(np.isfinite(simulated[key]), simulated[key], values)
        if key in references
        else as_measured(clock, key, simulated[key], random)
        for key, values in clock.values.items()
    }


def as_measured(clock: Clocked, key: Key, simulated: Array, random: np.random.Generator) -> Array:
    """A simulated channel of a clock with noise and rounding, at the channel's own stamps where it has such."""
    values = clock.values[key]
    if key not in clock.between:
        return with_noise(simulated, values, random)
    stamps, own = clock.between[key]
    whole = np.where(np.isfinite(simulated), simulated, values)
    return np.interp(clock.time, stamps, with_noise(np.interp(stamps, clock.time, whole), own, random))


def with_noise(simulated: Array, measured: Array, random: np.random.Generator) -> Array:
    """A simulated channel with noise of the measured one's size and colour, rounded as it is."""
    whole = np.where(np.isfinite(simulated), simulated, measured)
    quantum = quantum_of(measured) or quantum_of(np.diff(measured))  # what moves fast takes every level but once
    noisy = whole + coloured(measured, quantum, random)
    return np.asarray(np.round(noisy / quantum) * quantum if quantum > 0.0 else noisy, np.float64)
