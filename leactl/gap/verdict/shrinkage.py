"""Measure how far the gap shrinks on held-out runs: residuals of replays before and after, against the floor."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import LEAST_GAP_FLOORS, Shrinkage
from leactl.gap.replay import replay_all
from leactl.gap.replay.bearing import fitted_give
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.comparison import Compared, compare
from leactl.gap.replay.job import Job
from leactl.gap.search.confirm import RESAMPLES, TAIL_PROBABILITY
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model
from leactl.quantities import UNITS

Array = npt.NDArray[np.float64]
LEAST_LOG_GAP = math.log(LEAST_GAP_FLOORS)
EQUAL_SQUARES_RATIO = 1.001  # ratio of a channel's squared gaps up to which two models follow it equally well
FEWEST_BLOCKS = 8  # blocks of a channel; with fewer, resampling does not determine the ends of an interval
TRACE_POINTS = 1500  # largest number of points of a drawn trace
SLOW_SAMPLING_S = 0.05  # s between samples from which a thinned-out trace shows the whole run; a faster one would alias


@dataclass(frozen=True, eq=False)
class Trace:
    """One channel of one run over time; of a fast channel the stretch with the largest residual."""

    run: str
    quantity: str
    role: str
    mechanical: str
    units: str
    time: Array  # s
    measured: Array
    nominal: Array  # replay by the nominal model; the following likewise
    calibrated: Array
    augmented: Array


@dataclass(frozen=True)
class Growth:
    """Growth of the gap of all channels from one model to another; negative where the gap shrinks.

    Each value is the sum over channels of the logarithm of the gap's ratio, with the lower end of its 95 % interval. A
    gap is counted in floors, at least `LEAST_GAP_FLOORS`.
    """

    by_calibration: tuple[float, float]  # from the nominal model to the calibrated one
    by_effects: tuple[float, float]  # to the augmented model, from the better of the two others
    closed: bool | None  # whether effects shrink some channel's gap beyond chance; None if no channel has enough blocks
    closed_alike: bool | None  # whether they do so both over all its blocks together and block by block

    @property
    def effects_worse(self) -> bool:
        """Whether the effects make the gap grow beyond chance."""
        return self.by_effects[1] > 0.0


class SquaresRatio(NamedTuple):
    """Squared gap with one model over that with another, and the ends of its 95 % interval."""

    value: float
    low: float
    high: float
    worst_miss: float  # floors, largest gap of the nearer model on a channel on which the two differ


@dataclass(frozen=True, eq=False)
class Shrunk:
    """Shrinkage of every channel, traces, and the compared channels behind them."""

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
    """Return the shrinkage of the gap from replays of held-out runs with three models.

    The floor is the gap of the augmented model to its own output with the channels' noise, quantisation, and the noise
    of its start and inputs added. Intervals come from resampling blocks of one second (a twentieth of the run for
    temperatures).

    Parameters
    ----------
    unexplained : by quantity, role and set-up: root mean square of a simulator's residual beyond its own floor, in the
        channel's units; it is added to the floor in quadrature.

    Raises
    ------
    InputError : an effect of a model lacks a parameter.
    """
    random = np.random.default_rng(seed)
    jobs, channels = simulate_again(records, (nominal, calibrated, augmented), random, unexplained)
    groups = group_channels(channels)
    return Shrunk(
        tuple(_shrinkage_of(group, random) for group in groups),
        tuple(_trace(group) for group in groups),
        tuple(channels),
        _notes(jobs, channels),
        _growth(groups, random),
    )


def simulate_again(
    records: Sequence[Record],
    models: tuple[Model, Model, Model],
    random: np.random.Generator,
    unexplained: Mapping[tuple[str, str, str], float] | None = None,
) -> tuple[list[Job], list[Compared]]:
    """Return the replays of runs with three models, and each channel of each run compared with its replays.

    The parameters are those of `shrinkage`; the floor is that of the last model.
    """
    plants = [plant_of(model) for model in models]
    give = fitted_give(records, models[-1])
    for plant in plants:
        plant.give = give
    jobs_of_records = []
    for record in records:
        replays: list[Job] = []
        for index, plant in enumerate(plants):
            # a model that adds nothing to the one before it is not simulated twice
            replays.append(replays[-1] if index and models[index] == models[index - 1] else Job(record, plant))
        jobs_of_records.append((record, replays, Job(record, replays[-1].plant, random)))
    jobs = [
        job
        for _, replays, noisy_replay in jobs_of_records
        for job in (*{id(job): job for job in replays}.values(), noisy_replay)
    ]
    replay_all(jobs)
    channels = [
        channel
        for record, replays, noisy_replay in jobs_of_records
        for channel in compare(record, replays, noisy_replay)
    ]
    if unexplained:
        channels = [
            replace(
                channel,
                noise=math.hypot(
                    channel.noise, unexplained.get((channel.quantity, channel.role, channel.mechanical), 0.0)
                ),
            )
            for channel in channels
        ]
    return jobs, channels


def group_channels(channels: Sequence[Compared]) -> list[list[Compared]]:
    """Return compared channels in groups by quantity, role and set-up."""
    groups: dict[tuple[str, str, str], list[Compared]] = {}
    for channel in channels:
        groups.setdefault((channel.quantity, channel.role, channel.mechanical), []).append(channel)
    return list(groups.values())


def squares_ratio(channels: Sequence[Compared], random: np.random.Generator) -> SquaresRatio:
    """Return the ratio of squared gaps of the third to the second model, with an interval from resampled blocks.

    The squares of all channels are added in units of their floors, each at least `LEAST_GAP_FLOORS` squared; a channel
    without a floor does not count. NaN where no channel counts, and where a channel on which the two models differ has
    fewer than `FEWEST_BLOCKS` blocks.
    """
    undecided = SquaresRatio(math.nan, math.nan, math.nan, math.nan)
    observed, resampled, differing_squares = np.zeros(2), np.zeros((RESAMPLES, 2)), list[Array]()
    for counts, sums in map(_blocks, group_channels(channels)):
        floor = sums[:, 3].sum() / counts.sum()
        if floor <= 0.0:
            continue
        drawn_blocks = random.integers(0, len(counts), (RESAMPLES, len(counts)))
        means = sums[drawn_blocks].sum(axis=1) / counts[drawn_blocks].sum(axis=1)[:, None]
        squares = np.maximum(sums.sum(axis=0) / counts.sum() / floor, LEAST_GAP_FLOORS**2)[1:3]
        if squares.max() > EQUAL_SQUARES_RATIO * squares.min():
            if len(counts) < FEWEST_BLOCKS:
                return undecided
            differing_squares.append(squares)
        observed += squares
        resampled += np.maximum(means / floor, LEAST_GAP_FLOORS**2)[:, 1:3]
    if not observed.all():
        return undecided
    low, high = np.quantile(resampled[:, 1] / resampled[:, 0], (TAIL_PROBABILITY, 1.0 - TAIL_PROBABILITY))
    nearer_model = int(np.argmin(observed))
    worst_miss = math.sqrt(max((squares[nearer_model] for squares in differing_squares), default=0.0))
    return SquaresRatio(float(observed[1] / observed[0]), float(low), float(high), worst_miss)


def _growth(groups: Sequence[list[Compared]], random: np.random.Generator) -> Growth:
    """Return the growth of the gap from resampled blocks of every channel."""
    log_gaps, resampled = np.zeros(3), np.zeros((RESAMPLES, 3))
    channels = [_blocks(group) for group in groups]
    for counts, sums in channels:
        drawn_blocks = random.integers(0, len(counts), (RESAMPLES, len(counts)))
        log_gaps += np.maximum(_log_gaps(sums.sum(axis=0)), LEAST_LOG_GAP)
        resampled += np.maximum(_log_gaps(sums[drawn_blocks].sum(axis=1)), LEAST_LOG_GAP)
    nearer_model = 1 if log_gaps[1] < log_gaps[0] else 0
    model_pairs = ((0, 1), (nearer_model, 2))
    by_calibration, by_effects = (
        (
            float(log_gaps[to_model] - log_gaps[from_model]),
            float(np.quantile(resampled[:, to_model] - resampled[:, from_model], TAIL_PROBABILITY)),
        )
        for from_model, to_model in model_pairs
    )
    return Growth(by_calibration, by_effects, *closes_gap(channels, random))


def closes_gap(
    channels: Sequence[tuple[Array, Array]], random: np.random.Generator
) -> tuple[bool, bool] | tuple[None, None]:
    """Return whether effects shrink the gap of some channel by either of two tests, and whether by both.

    The gap is compared with that of the better model without effects. One test takes all blocks together, where the
    largest gaps count most; the other takes the ratio of each block. None where no channel has `FEWEST_BLOCKS` blocks.

    channels : samples (blocks,) and sums of squares (blocks, 4: three models and the floor) of each channel.
    """
    channels_with_blocks = [(counts, sums) for counts, sums in channels if len(counts) >= FEWEST_BLOCKS]
    falls_of_channels = []
    for counts, sums in channels_with_blocks:
        log_gaps, log_gaps_of_blocks = _log_gaps(sums.sum(axis=0)), _log_gaps(sums)
        nearer_model = int(np.argmin(log_gaps[:2]))
        if log_gaps[nearer_model] > max(log_gaps[2], LEAST_LOG_GAP):
            drawn_blocks = random.integers(0, len(counts), (RESAMPLES, len(counts)))
            resampled = _log_gaps(sums[drawn_blocks].sum(axis=1))
            falls_by_block = (counts * (log_gaps_of_blocks[:, nearer_model] - log_gaps_of_blocks[:, 2]))[
                drawn_blocks
            ].sum(axis=1)
            falls_of_channels.append((resampled[:, nearer_model] - resampled[:, 2], falls_by_block))
    if not channels_with_blocks:
        return None, None
    # Bonferroni: one of many channels shrinks by chance
    tail_probability = TAIL_PROBABILITY / max(2 * len(falls_of_channels), 1)
    passes = [
        [float(np.quantile(falls_of_gap, tail_probability)) > 0.0 for falls_of_gap in pair]
        for pair in falls_of_channels
    ]
    return any(map(any, passes)), any(map(all, passes))


def _log_gaps(sums: Array) -> Array:
    """Return the logarithms of the gaps of three models in floors; the last column of the sums is the floor's."""
    tiny = np.finfo(np.float64).tiny
    logs = np.log(np.maximum(sums, tiny))
    return np.asarray(0.5 * (logs[..., :3] - logs[..., 3:]), np.float64)


def _shrinkage_of(compared_runs: list[Compared], random: np.random.Generator) -> Shrinkage:
    """Return the shrinkage of one channel's gap, with the interval of its closed share from resampled blocks."""
    channel = compared_runs[0]
    counts, sums = _blocks(compared_runs)
    nominal, calibrated, augmented, floor = (float(rms) for rms in np.sqrt(sums.sum(axis=0) / counts.sum()))
    closed_share = closed_low = closed_high = None
    if calibrated > LEAST_GAP_FLOORS * floor:
        closed_share = (calibrated - augmented) / (calibrated - floor)
        drawn_blocks = random.integers(0, len(counts), (RESAMPLES, len(counts)))
        resampled_gaps = np.sqrt(sums[drawn_blocks].sum(axis=1) / counts[drawn_blocks].sum(axis=1)[:, None])
        closed_low, closed_high = closed_interval(resampled_gaps)
    units = UNITS[channel.quantity]
    return Shrinkage(
        channel.quantity,
        channel.role,
        channel.mechanical,
        units,
        nominal,
        calibrated,
        augmented,
        floor,
        closed_share,
        closed_low,
        closed_high,
    )


def closed_interval(resampled_gaps: Array) -> tuple[float, float] | tuple[None, None]:
    """Return the interval of the closed share of the gap; None where chance may leave no gap to close.

    resampled_gaps : shape (resamples, 4), gaps of the three models and the floor.
    """
    is_open = resampled_gaps[:, 1] > resampled_gaps[:, 3]
    if np.mean(~is_open) > TAIL_PROBABILITY:
        return None, None
    open_gaps = resampled_gaps[is_open]
    shares = (open_gaps[:, 1] - open_gaps[:, 2]) / (open_gaps[:, 1] - open_gaps[:, 3])
    low, high = np.quantile(shares, (TAIL_PROBABILITY, 1.0 - TAIL_PROBABILITY))
    return float(low), float(high)


def _blocks(compared_runs: list[Compared]) -> tuple[Array, Array]:
    """Return the number of samples of each block, and its sums of squares: of the three models and the floor.

    Shapes are (blocks,) and (blocks, 4).
    """
    counts, sums = [], []
    for channel in compared_runs:
        block_count = int(channel.block[-1]) + 1
        samples_of_blocks = np.bincount(channel.block, minlength=block_count).astype(float)
        squares_by_column = [*(channel.squares(model) for model in range(3)), channel.floor_squares()]
        sums_of_blocks = np.stack(
            [
                np.bincount(channel.block, weights=squares_of_samples, minlength=block_count)
                for squares_of_samples in squares_by_column
            ],
            axis=1,
        )
        counts.append(samples_of_blocks[samples_of_blocks > 0])
        sums.append(sums_of_blocks[samples_of_blocks > 0])
    return np.concatenate(counts), np.concatenate(sums)


def _trace(compared_runs: list[Compared]) -> Trace:
    """Return the trace of the run in which the calibrated model has the largest gap."""
    worst = max(compared_runs, key=lambda channel: float(np.mean(channel.squares(1))))
    window = _trace_window(worst)
    return Trace(
        worst.run,
        worst.quantity,
        worst.role,
        worst.mechanical,
        UNITS[worst.quantity],
        worst.time[window],
        worst.measured[window],
        *(replayed[window] for replayed in worst.replayed),
    )


def _trace_window(channel: Compared) -> slice:
    """Return the samples to draw: all, every n-th of a slow channel, or the stretch with the largest residual."""
    if len(channel.time) <= TRACE_POINTS:
        return slice(None)
    if float(np.median(np.diff(channel.time))) >= SLOW_SAMPLING_S:
        return slice(None, None, -(-len(channel.time) // TRACE_POINTS))
    sums = np.concatenate([[0.0], np.cumsum(channel.squares(1))])
    start = int(np.argmax(sums[TRACE_POINTS:] - sums[:-TRACE_POINTS]))
    return slice(start, start + TRACE_POINTS)


def _notes(jobs: Sequence[Job], channels: Sequence[Compared]) -> tuple[str, ...]:
    """Return the notes of replays: their own, on samples at the voltage ceiling, and on restarts; each once."""
    notes = [note for job in jobs for note in job.notes]
    run_of = {job.record.name: job.record.run for job in jobs}
    ceiling_samples: dict[str, dict[str, int]] = {}
    for job in jobs:
        if job.at_ceiling:
            ceiling_samples.setdefault(job.record.path.name, {})[job.record.name] = job.at_ceiling
    for file, counts in ceiling_samples.items():
        total = sum(counts.values())
        notes.append(f"{file}: {total} samples at the voltage ceiling; the measured current drives the replay there")
    restarted_runs = sorted({run_of[channel.run] for channel in channels if channel.restarts})
    if restarted_runs:
        runs = ", ".join(restarted_runs)
        notes.append(f"the replay of {runs} starts again every second from the measured state: an angle is an integral")
    return tuple(dict.fromkeys(notes))
