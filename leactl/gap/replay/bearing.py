"""Fit the give of bearings, the angle over which friction builds up before they slide, to the torque of locked runs.

The give is smaller than that of the effect `presliding`. No model file contains it; it belongs to the bench, so that
all models of a bench share one value.
"""

from collections.abc import Sequence

import numpy as np

from leactl.effects.plant import BEARING_GIVE
from leactl.gap.replay import replay_all
from leactl.gap.replay.bench_of_model import plant_of
from leactl.gap.replay.job import Job
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

TRIED_GIVES = (5e-6, 1.5e-5, BEARING_GIVE)  # rad, gives that are tried


def fitted_give(records: Sequence[Record], model: Model) -> float:
    """Return the give [rad] that fits the torque of locked runs best; `BEARING_GIVE` if no locked run logs a torque."""
    locked = [record for record in records if record.mechanical == "locked" and record.fast is not None]
    plants = [plant_of(model) for _ in TRIED_GIVES]
    for plant, give in zip(plants, TRIED_GIVES, strict=True):
        plant.give = give
    jobs = [[Job(record, plant) for record in locked] for plant in plants]
    replay_all([job for jobs_of_plant in jobs for job in jobs_of_plant])
    squares = [
        [_torque_squares(job) for job in jobs_of_plant if ("torque", "test") in job.fast] for jobs_of_plant in jobs
    ]
    return (
        TRIED_GIVES[int(np.argmin([sum(squares_of_plant) for squares_of_plant in squares]))]
        if all(squares)
        else BEARING_GIVE
    )


def _torque_squares(job: Job) -> float:
    """Return the squared residual of the torque [N^2*m^2] after a fit of gain, zero and drift of its sensor."""
    measured, replayed = job.clock.values["torque", "test"], job.fast["torque", "test"]
    valid = np.isfinite(measured) & np.isfinite(replayed)
    columns = np.stack([replayed[valid], np.ones(int(valid.sum())), job.clock.time[valid]], axis=1)
    fitted = columns @ np.linalg.lstsq(columns, measured[valid], rcond=None)[0]
    return float(np.sum((measured[valid] - fitted) ** 2))
