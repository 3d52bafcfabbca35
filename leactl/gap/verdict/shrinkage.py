"""How far the gap shrinks on held-out runs: measured minus simulated again, before and after, against the floor."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import Shrinkage
from leactl.gap.replay import replay_all
from leactl.gap.replay.bearing import give_of
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.compared import Compared, compare
from leactl.gap.replay.job import Job
from leactl.gap.search.confirm import CHANCE, RESAMPLED
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model
from leactl.quantities import UNITS

Array = npt.NDArray[np.float64]
NEAR_FLOOR = 1.1  # floors, below which no gap is left to close
NEAR = math.log(NEAR_FLOOR)
SAME = 1.001  # of a channel's squared gap, up to which two models follow it alike
FEWEST_BLOCKS = 8  # of a channel, below which resampling says little of an interval's ends
TRACE_POINTS = 1500
SLOW = 0.05  # s between samples, from which on a trace shows the whole run: thinned out, a faster channel would alias


@dataclass(frozen=True, eq=False)
class Trace:
    """One channel of one run over time: slow ones whole, of fast ones the stretch where the model is farthest off."""

    run: str
    quantity: str
    role: str
    mechanical: str
    units: str
    time: Array
    measured: Array
    nominal: Array
    calibrated: Array
    augmented: Array


@dataclass(frozen=True)
class Growth:
    """By how much the gap of all channels grows from one model to another; below zero where it shrinks.

    Each is the sum over channels of the logarithm of the gap's ratio, a gap being counted in floors and from
    `NEAR_FLOOR` on, with the lower end of its 95 % interval.
    """

    by_calibration: tuple[float, float]  # from the nominal model to the calibrated one
    by_effects: tuple[float, float]  # to the augmented model, from the better of the two others
    closed: bool | None  # whether effects shrink some channel's gap beyond chance; None where no channel has the blocks
    closed_alike: bool | None  # whether they do so over all its blocks together and block by block as well

    @property
    def effects_worse(self) -> bool:
        """Whether the effects make the gap grow beyond what chance explains."""
        return self.by_effects[1] > 0.0


class SquaresRatio(NamedTuple):
    """Squared gap with one model over that with another, and the ends of its 95 % interval."""

    value: float
    low: float
    high: float
    worst_miss: float  # floors, largest miss of the nearer model on the channels on which the two differ


@dataclass(frozen=True, eq=False)
class Shrunk:
    """The answer: a table, traces, and the channels behind them."""

    shrinkage: tuple[Shrinkage, ...]
    traces: tuple[Trace, ...]
    channels: tuple[Compared, ...]  # models in the order nominal, calibrated, augmented
    notes: tuple[str, ...]
    growth: Growth


def shrinkage(
    records: Sequence[Record],
    nominal: Model,
    calibrated: Model,
    augmented: Model,
    seed: int = 0,
    unexplained: Mapping[tuple[str, str, str], float] | None = None,
) -> Shrunk:
    """Simulate held-out runs again with three models and compare.

    The floor is the augmented model against its own output, the channels' noise, quantisation and the noise of its
    start and inputs added. Intervals come from resampling blocks of one second (a twentieth of the run for
    temperatures).

    Parameters
    ----------
    unexplained : by quantity, role and set-up: root mean square that a simulator leaves over its own floor, in the
        channel's units; it joins the floor.

    Raises
    ------
    InputError : an effect of a model lacks a parameter.
    """
    random = np.random.default_rng(seed)
    jobs, channels = simulated_again(records, (nominal, calibrated, augmented), random, unexplained)
    groups = grouped(channels)
    return Shrunk(
        tuple(_shrunk(group, random) for group in groups),
        tuple(_trace(group) for group in groups),
        tuple(channels),
        _notes(jobs, channels),
        _growth(groups, random),
    )


def simulated_again(
    records: Sequence[Record],
    models: tuple[Model, Model, Model],
    random: np.random.Generator,
    unexplained: Mapping[tuple[str, str, str], float] | None = None,
) -> tuple[list[Job], list[Compared]]:
    """Simulate runs again with three models; return the replays, and each channel of each run beside them.

    The parameters are those of `shrinkage`; the floor is that of the last model.
    """
    plants = [plant_of(model) for model in models]
    give = give_of(records, models[-1])
    for plant in plants:
        plant.give = give
    sets = []
    for record in records:
        own: list[Job] = []
        for index, plant in enumerate(plants):
            # a model that adds nothing to the one before it is not simulated twice
            own.append(own[-1] if index and models[index] == models[index - 1] else Job(record, plant))
        sets.append((record, own, Job(record, own[-1].plant, random)))
    jobs = [job for _, own, noisy in sets for job in (*{id(job): job for job in own}.values(), noisy)]
    replay_all(jobs)
    channels = [one for record, own, noisy in sets for one in compare(record, own, noisy)]
    if unexplained:
        channels = [
            replace(one, noise=math.hypot(one.noise, unexplained.get((one.quantity, one.role, one.mechanical), 0.0)))
            for one in channels
        ]
    return jobs, channels


def grouped(channels: Sequence[Compared]) -> list[list[Compared]]:
    """The runs of each channel."""
    groups: dict[tuple[str, str, str], list[Compared]] = {}
    for one in channels:
        groups.setdefault((one.quantity, one.role, one.mechanical), []).append(one)
    return list(groups.values())


def squares_ratio(channels: Sequence[Compared], random: np.random.Generator) -> SquaresRatio:
    """Squared gap with the last of three models over that with the second one, from blocks that are drawn again.

    The squares of all channels are added up in floors, each from `NEAR_FLOOR` on; a channel without a floor does not
    count. NaN where none does, and where a channel on which the two differ has fewer than `FEWEST_BLOCKS` blocks.
    """
    unknown = SquaresRatio(math.nan, math.nan, math.nan, math.nan)
    observed, again, differing = np.zeros(2), np.zeros((RESAMPLED, 2)), list[Array]()
    for counts, sums in map(_blocks, grouped(channels)):
        floor = sums[:, 3].sum() / counts.sum()
        if floor <= 0.0:
            continue
        picked = random.integers(0, len(counts), (RESAMPLED, len(counts)))
        means = sums[picked].sum(axis=1) / counts[picked].sum(axis=1)[:, None]
        squares = np.maximum(sums.sum(axis=0) / counts.sum() / floor, NEAR_FLOOR**2)[1:3]
        if squares.max() > SAME * squares.min():
            if len(counts) < FEWEST_BLOCKS:
                return unknown
            differing.append(squares)
        observed += squares
        again += np.maximum(means / floor, NEAR_FLOOR**2)[:, 1:3]
    if not observed.all():
        return unknown
    low, high = np.quantile(again[:, 1] / again[:, 0], (CHANCE, 1.0 - CHANCE))
    nearer = int(np.argmin(observed))
    worst_miss = math.sqrt(max((squares[nearer] for squares in differing), default=0.0))
    return SquaresRatio(float(observed[1] / observed[0]), float(low), float(high), worst_miss)


def _growth(groups: Sequence[list[Compared]], random: np.random.Generator) -> Growth:
    """Resample every channel's blocks and add up the logarithms of its gaps, in floors."""
    whole, again = np.zeros(3), np.zeros((RESAMPLED, 3))
    channels = [_blocks(group) for group in groups]
    for counts, sums in channels:
        picked = random.integers(0, len(counts), (RESAMPLED, len(counts)))
        whole += np.maximum(_log_gaps(sums.sum(axis=0)), NEAR)
        again += np.maximum(_log_gaps(sums[picked].sum(axis=1)), NEAR)
    best = 1 if whole[1] < whole[0] else 0
    pairs = ((0, 1), (best, 2))
    first, second = (
        (float(whole[b] - whole[a]), float(np.quantile(again[:, b] - again[:, a], CHANCE))) for a, b in pairs
    )
    return Growth(first, second, *closes(channels, random))


def closes(
    channels: Sequence[tuple[Array, Array]], random: np.random.Generator
) -> tuple[bool, bool] | tuple[None, None]:
    """Whether effects shrink the gap of some channel against the better of the models without them.

    Judged twice: over all blocks together, where the largest gaps count most, and block by block, where each counts
    by its ratio. By either, and by both; None where no channel has the blocks.

    channels : samples (blocks,) and sums of squares (blocks, 4: three models and the floor) of each.
    """
    long = [(counts, sums) for counts, sums in channels if len(counts) >= FEWEST_BLOCKS]
    shrinking = []
    for counts, sums in long:
        observed, gaps = _log_gaps(sums.sum(axis=0)), _log_gaps(sums)
        before = int(np.argmin(observed[:2]))
        if observed[before] > max(observed[2], NEAR):
            picked = random.integers(0, len(counts), (RESAMPLED, len(counts)))
            together = _log_gaps(sums[picked].sum(axis=1))
            by_block = (counts * (gaps[:, before] - gaps[:, 2]))[picked].sum(axis=1)
            shrinking.append((together[:, before] - together[:, 2], by_block))
    if not long:
        return None, None
    # of many that are judged one shrinks by chance: each is asked for as much less of it
    chance = CHANCE / max(2 * len(shrinking), 1)
    passed = [[float(np.quantile(by, chance)) > 0.0 for by in both] for both in shrinking]
    return any(map(any, passed)), any(map(all, passed))


def _log_gaps(sums: Array) -> Array:
    """Logarithms of the gaps of three models, in floors, of sums of squares whose last column is the floor's."""
    tiny = np.finfo(np.float64).tiny
    logs = np.log(np.maximum(sums, tiny))
    return np.asarray(0.5 * (logs[..., :3] - logs[..., 3:]), np.float64)


def _shrunk(group: list[Compared], random: np.random.Generator) -> Shrinkage:
    first = group[0]
    counts, sums = _blocks(group)
    nominal, calibrated, augmented, floor = (float(v) for v in np.sqrt(sums.sum(axis=0) / counts.sum()))
    closed = low = high = None
    if calibrated > NEAR_FLOOR * floor:
        closed = (calibrated - augmented) / (calibrated - floor)
        picked = random.integers(0, len(counts), (RESAMPLED, len(counts)))
        again = np.sqrt(sums[picked].sum(axis=1) / counts[picked].sum(axis=1)[:, None])
        low, high = closed_between(again)
    units = UNITS[first.quantity]
    return Shrinkage(
        first.quantity, first.role, first.mechanical, units, nominal, calibrated, augmented, floor, closed, low, high
    )


def closed_between(again: Array) -> tuple[float, float] | tuple[None, None]:
    """Interval of the share that is closed, from resampled gaps of the three models and the floor, a row each.

    A sample without a gap says nothing of its share; where chance may bring up one, there is no interval.
    """
    open_gap = again[:, 1] > again[:, 3]
    if np.mean(~open_gap) > CHANCE:
        return None, None
    gaps = again[open_gap]
    shares = (gaps[:, 1] - gaps[:, 2]) / (gaps[:, 1] - gaps[:, 3])
    low, high = np.quantile(shares, (CHANCE, 1.0 - CHANCE))
    return float(low), float(high)


def _blocks(group: list[Compared]) -> tuple[Array, Array]:
    """Samples in each block, and sums of squares of the three models and the floor."""
    counts, sums = [], []
    for one in group:
        size = int(one.block[-1]) + 1
        count = np.bincount(one.block, minlength=size).astype(float)
        squares = [*(one.squares(model) for model in range(3)), one.floor_squares()]
        table = np.stack([np.bincount(one.block, weights=s, minlength=size) for s in squares], axis=1)
        counts.append(count[count > 0])
        sums.append(table[count > 0])
    return np.concatenate(counts), np.concatenate(sums)


def _trace(group: list[Compared]) -> Trace:
    """The run in which the calibrated model is farthest off."""
    one = max(group, key=lambda c: float(np.mean(c.squares(1))))
    keep = _shown(one)
    return Trace(
        one.run,
        one.quantity,
        one.role,
        one.mechanical,
        UNITS[one.quantity],
        one.time[keep],
        one.measured[keep],
        *(replayed[keep] for replayed in one.replayed),
    )


def _shown(one: Compared) -> slice:
    if len(one.time) <= TRACE_POINTS:
        return slice(None)
    if float(np.median(np.diff(one.time))) >= SLOW:
        return slice(None, None, -(-len(one.time) // TRACE_POINTS))
    sums = np.concatenate([[0.0], np.cumsum(one.squares(1))])
    start = int(np.argmax(sums[TRACE_POINTS:] - sums[:-TRACE_POINTS]))
    return slice(start, start + TRACE_POINTS)


def _notes(jobs: Sequence[Job], channels: Sequence[Compared]) -> tuple[str, ...]:
    notes = [note for job in jobs for note in job.notes]
    run_of = {job.record.name: job.record.run for job in jobs}
    limited: dict[str, dict[str, int]] = {}
    for job in jobs:
        if job.at_ceiling:
            limited.setdefault(job.record.path.name, {})[job.record.name] = job.at_ceiling
    for file, counts in limited.items():
        total = sum(counts.values())
        notes.append(f"{file}: {total} samples at the voltage ceiling; the measured current drives the replay there")
    again = sorted({run_of[one.run] for one in channels if one.restarts})
    if again:
        runs = ", ".join(again)
        notes.append(f"the replay of {runs} starts again every second from the measured state: an angle is an integral")
    return tuple(dict.fromkeys(notes))
