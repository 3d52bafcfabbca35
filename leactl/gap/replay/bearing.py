"""How far bearings give before they slide: no model file says it, and a locked rotor's torque shows it.

It lies below what counts as the effect `presliding`, and belongs to the bench, so that all models share one value.
"""

from collections.abc import Sequence

import numpy as np

from leactl.effects.plant import GIVE
from leactl.gap.replay import replay_all
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.job import Job
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

TRIED = (5e-6, 1.5e-5, GIVE)  # rad


def give_of(records: Sequence[Record], model: Model) -> float:
    """The give that fits the torque of locked runs best [rad]; the usual one where there is none."""
    locked = [record for record in records if record.mechanical == "locked" and record.fast is not None]
    plants = [plant_of(model) for _ in TRIED]
    for plant, give in zip(plants, TRIED, strict=True):
        plant.give = give
    jobs = [[Job(record, plant) for record in locked] for plant in plants]
    replay_all([job for own in jobs for job in own])
    left = [[_left(job) for job in own if ("torque", "test") in job.fast] for own in jobs]
    return TRIED[int(np.argmin([sum(own) for own in left]))] if all(left) else GIVE


def _left(job: Job) -> float:
    """Squares left of the torque when gain, zero and drift of its sensor are fitted: they say nothing of sticking."""
    measured, replayed = job.clock.values["torque", "test"], job.fast["torque", "test"]
    good = np.isfinite(measured) & np.isfinite(replayed)
    columns = np.stack([replayed[good], np.ones(int(good.sum())), job.clock.time[good]], axis=1)
    fitted = columns @ np.linalg.lstsq(columns, measured[good], rcond=None)[0]
    return float(np.sum((measured[good] - fitted) ** 2))
