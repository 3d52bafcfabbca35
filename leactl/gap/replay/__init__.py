"""Replay runs: simulate a model with the inputs of a run, from the state at its first sample."""

from collections.abc import Sequence

from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.drive import compute_current
from leactl.gap.replay.heat import replay_temperatures
from leactl.gap.replay.job import Job
from leactl.gap.replay.mechanics import move
from leactl.gap.replay.readings import write_readings
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

__all__ = ["Job", "plant_of", "replay", "replay_all"]


def replay(record: Record, model: Model) -> Job:
    """Return the replay of one run through one model; `fast` and `slow` of the job hold the readings of its channels.

    Raises
    ------
    InputError : an effect of the model lacks a parameter.
    """
    job = Job(record, plant_of(model))
    replay_all([job])
    return job


def replay_all(jobs: Sequence[Job]) -> None:
    """Replay many runs and benches side by side; the results are written into the jobs."""
    moving = [job for job in jobs if job.record.fast is not None]
    for job in moving:
        compute_current(job)
    replay_temperatures(jobs)
    move(moving)
    for job in moving:
        write_readings(job)
