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
FEWEST_BLOCKS = 20  # blocks of a slow clock: its blocks are longer, since its errors last
NOISE_LAG = 4  # samples between the values whose differences give the noise
NOISE_STRETCH = 500  # samples of one noise estimate
RELATIVE_RESOLUTION = float(np.finfo(np.float32).eps)  # of a channel's largest value; smaller noise counts as none


@dataclass(frozen=True, eq=False)
class Compared:
    """One channel of one run with its replays, at samples that were measured and that every replay determines."""

    run: str
    kind: str
    mechanical: str
    quantity: str
    role: str
    time: Array  # s since the run's start
    index: npt.NDArray[np.intp]  # sample of its clock
    block: npt.NDArray[np.intp]
    measured: Array
    replayed: tuple[Array, ...]  # one for each model
    disturbed: Array  # replay of the last model with noise added to start and inputs
    noise: float  # standard deviation of the channel's noise and quantisation
    restarts: bool  # whether the replay starts again every second

    def squares(self, model: int) -> Array:
        """Return the squared residual of one model at each sample."""
        return np.asarray((self.measured - self.replayed[model]) ** 2, np.float64)

    def floor_squares(self) -> Array:
        """Return the squared distance of the last model to its own noisy output at each sample."""
        return np.asarray((self.disturbed - self.replayed[-1]) ** 2 + self.noise**2, np.float64)


def compare(record: Record, jobs: Sequence[Job], disturbed: Job) -> list[Compared]:
    """Compare every channel that all replays of a run determine."""
    compared = []
    swung = fast_signals(record, jobs[0].plant.model, None) if record.mechanical == "locked" else None
    for name, clock in (("fast", record.fast), ("slow", record.slow)):
        if clock is None:
            continue
        answers = [getattr(job, name) for job in (*jobs, disturbed)]
        for key in answers[0]:
            values = measured_channel(clock, key)
            if values is not None and all(key in answer for answer in answers):
                rows = [answer[key] for answer in answers]
                moved = key[0] in ("velocity", "torque", "q_axis_voltage")
                restarts = moved and any(job.restarts for job in jobs)
                keep = np.all(np.isfinite(rows), axis=0)
                if swung is not None and key[0] in ("velocity", "torque"):
                    keep &= swung.unleapt  # after a leap the rotor's sliding is unknown to any replay
                channel = _compared(record, clock, key, values, rows, keep, restarts)
                compared += [channel] if channel is not None else []
    return compared


def measured_channel(clock: Clocked, key: Key) -> Array | None:
    """Return a channel, or the speed from the angle where the run has no velocity."""
    if key == ("velocity", "test") and clock.get("velocity") is None:
        angle = clock.get("angle")
        return smooth(speeds(angle, clock.interval)) if angle is not None else None
    return clock.get(*key)


def _compared(
    record: Record, clock: Clocked, key: Key, values: Array, rows: list[Array], keep: Mask, restarts: bool
) -> Compared | None:
    keep &= clock.all_valid(key if key in clock.values else ("angle", "test"))
    index = np.flatnonzero(keep)
    if len(index) < 2:
        return None
    residuals = [values[index] - row[index] for row in rows[:-1]]
    time = clock.since_begin
    length = BLOCK_S if clock is record.fast else max(BLOCK_S, float(time[-1]) / FEWEST_BLOCKS)
    block = (time[index] / length).astype(np.intp)
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
        replayed=tuple(row[index] for row in rows[:-1]),
        disturbed=rows[-1][index],
        noise=float(noise),
        restarts=restarts,
    )


def noise_of_residuals(values: Array, residuals: Sequence[Array]) -> float:
    """Return the noise of a channel from the residuals of its replays; zero where no log resolves it from none."""
    noise = min(fast_noise(residual) for residual in residuals)
    # the output of a filter dies away to nothing after a motion, in steps that are no noise
    return noise if noise > RELATIVE_RESOLUTION * float(np.max(np.abs(values))) else 0.0


def fast_noise(values: Array) -> float:
    """Return the standard deviation of changes within a few samples, the median over stretches.

    Filters of a channel reach no further than these samples; a model's error in some stretches is no noise.
    """
    steps = np.abs(values[NOISE_LAG:] - values[:-NOISE_LAG])
    if len(steps) == 0:
        return 0.0
    parts = np.array_split(steps, max(1, len(steps) // NOISE_STRETCH))
    return float(np.median([np.median(part) for part in parts]) / (0.6745 * np.sqrt(2.0)))
