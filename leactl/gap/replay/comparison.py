"""Measured channels with their replays by models, sample by sample, and the channel's noise."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.replay.job import Job
from leactl.gap.signals.derived import fast_signals
from leactl.gap.signals.noise import quantum_of
from leactl.gap.signals.record import Clocked, Key, Mask, Record
from leactl.gap.signals.smoothing import smooth, speeds

Array = npt.NDArray[np.float64]
BLOCK_S = 1.0  # s, block of the fast clock; resampling draws whole blocks
FEWEST_BLOCKS = 20  # number of blocks of a slow clock whose run is long: its blocks are longer, since its errors last
NOISE_LAG = 4  # samples between the values whose differences give the noise
NOISE_STRETCH = 500  # samples of one noise estimate
RELATIVE_RESOLUTION = float(np.finfo(np.float32).eps)  # share of a channel's largest value; smaller noise is none


@dataclass(frozen=True, eq=False)
class Compared:
    """One channel of one run with its replays, at samples that were measured and that every replay determines."""

    run: str
    kind: str
    mechanical: str
    quantity: str
    role: str
    time: Array  # s since the run's start
    index: npt.NDArray[np.intp]  # position of each sample on its clock
    block: npt.NDArray[np.intp]  # number of the block that each sample lies in
    measured: Array
    replayed: tuple[Array, ...]  # one for each model
    disturbed: Array  # replay of the last model with noise added to start and inputs
    noise: float  # standard deviation of the channel's noise and quantisation
    restarts: bool  # whether the replay starts again every second

    def squares(self, model: int) -> Array:
        """Return the squared residual of one model at each sample."""
        return np.asarray((self.measured - self.replayed[model]) ** 2, np.float64)

    def floor_squares(self) -> Array:
        """Return the squared distance of the last model to its own noisy output at each sample.

        A distance beyond the range of the measured channel is that of a replay that ran away; it counts as this range.
        """
        distance = np.minimum(np.abs(self.disturbed - self.replayed[-1]), np.ptp(self.measured))
        return np.asarray(distance**2 + self.noise**2, np.float64)


def compare(record: Record, jobs: Sequence[Job], disturbed: Job) -> list[Compared]:
    """Return every channel that all replays of a run determine, compared with these.

    jobs : replays by models.
    disturbed : replay by the last model with noise added to start and inputs.
    """
    channels = []
    locked_signals = fast_signals(record, jobs[0].plant.model, None) if record.mechanical == "locked" else None
    followed = followed_samples(jobs[0]) if record.fast is not None else None
    for name, clock in (("fast", record.fast), ("slow", record.slow)):
        if clock is None:
            continue
        replays = [getattr(job, name) for job in (*jobs, disturbed)]
        for key in replays[0]:
            values = measured_channel(clock, key)
            if values is not None and all(key in channels_of_replay for channels_of_replay in replays):
                replayed = [channels_of_replay[key] for channels_of_replay in replays]
                restarts_with_motion = key[0] in ("velocity", "torque", "q_axis_voltage")
                restarts = restarts_with_motion and any(job.restarts for job in jobs)
                mask = np.all(np.isfinite(replayed), axis=0)
                if restarts and clock is record.fast and followed is not None:
                    mask &= followed
                if locked_signals is not None and key[0] in ("velocity", "torque"):
                    mask &= locked_signals.unleapt  # after a leap the rotor's sliding is unknown to any replay
                channel = _compared(record, clock, key, values, replayed, mask, restarts)
                channels += [channel] if channel is not None else []
    return channels


def followed_samples(job: Job) -> Mask:
    """Return the samples of a motion between its latest restart and the next long gap in what drives it.

    Nobody knows what drove the rotor in a gap: behind it a replay is of another motion, until it restarts.
    """
    clock, driving = job.clock, ("q_axis_current", "test")
    keys = [driving, ("q_axis_current", "load")] if driving in clock.values else [("q_axis_voltage", "test")]
    followed = np.ones(len(clock.time), bool)
    starts = job.starts if job.starts is not None else np.zeros(0, np.intp)
    for begin, end in clock.long_gaps([*keys, ("angle", "test"), ("velocity", "test")]):
        later_starts = starts[starts >= end]
        followed[begin : int(later_starts[0]) if len(later_starts) else None] = False
    return followed


def measured_channel(clock: Clocked, key: Key) -> Array | None:
    """Return a channel, or the speed from the angle where the run has no velocity."""
    if key == ("velocity", "test") and clock.get("velocity") is None:
        angle = clock.get("angle")
        return smooth(speeds(angle, clock.interval)) if angle is not None else None
    return clock.get(*key)


def _compared(
    record: Record, clock: Clocked, key: Key, values: Array, replayed: list[Array], mask: Mask, restarts: bool
) -> Compared | None:
    """Return a channel with its replays at the samples of a mask that are valid; None for fewer than two samples.

    replayed : replays by the models, then the disturbed replay.
    """
    mask &= clock.all_valid(key if key in clock.values else ("angle", "test"))
    index = np.flatnonzero(mask)
    if len(index) < 2:
        return None
    residuals = [values[index] - values_of_replay[index] for values_of_replay in replayed[:-1]]
    time = clock.since_begin
    block_duration = BLOCK_S if clock is record.fast else max(BLOCK_S, float(time[-1]) / FEWEST_BLOCKS)
    block = (time[index] / block_duration).astype(np.intp)
    noise = max(noise_of_residuals(values[index], residuals), quantum_of(values) / math.sqrt(12.0))
    return Compared(
        run=record.name,
        kind=record.kind,
        mechanical=record.mechanical,
        quantity=key[0],
        role=key[1],
        time=time[index],
        index=index,
        block=block,
        measured=values[index],
        replayed=tuple(values_of_replay[index] for values_of_replay in replayed[:-1]),
        disturbed=replayed[-1][index],
        noise=float(noise),
        restarts=restarts,
    )


def noise_of_residuals(values: Array, residuals: Sequence[Array]) -> float:
    """Return the noise of a channel from the residuals of its replays; zero below the resolution of a float32 log."""
    noise = min(fast_noise(residual) for residual in residuals)
    # the output of a filter dies away to nothing after a motion, in steps that are no noise
    return noise if noise > RELATIVE_RESOLUTION * float(np.max(np.abs(values))) else 0.0


def fast_noise(values: Array) -> float:
    """Return the standard deviation of changes within a few samples, the median over stretches.

    Filters of a channel reach no further than these samples; a model's error in some stretches is no noise.
    """
    changes = np.abs(values[NOISE_LAG:] - values[:-NOISE_LAG])
    if len(changes) == 0:
        return 0.0
    stretches = np.array_split(changes, max(1, len(changes) // NOISE_STRETCH))
    return float(np.median([np.median(stretch) for stretch in stretches]) / (0.6745 * np.sqrt(2.0)))
