"""Choose the form of an effect by replays of the fitted runs where the equations leave it open.

A balance of torques leaves out what it cannot resolve, such as a rotor that hardly turns. What friction does there is
extrapolated from the rest, and many pairs of a level and a speed fit about as well. A replay passes through it: whether
a rotor sticks or starts under a current shows in all that follows.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.replay import Job, plant_of, replay_all
from leactl.gap.replay.bearing import fitted_give
from leactl.gap.replay.comparison import compare
from leactl.gap.search.effect_regression import Evidence
from leactl.gap.search.regression import Candidate
from leactl.gap.signals.stamps import stamped
from leactl.model.nominal import Model

FORM_STDS = (-2.0, -1.0, 1.0, 2.0)  # standard deviations from the best form at which others are tried
# standard deviation of a form's number, as a natural logarithm, from which the form is open
LEAST_OPEN_STD = 0.03
MOST_FORM_STD = 0.5  # largest such standard deviation by which forms are moved


def across_open_form(evidence: Evidence, hypothesis: Sequence[Candidate]) -> list[list[Candidate]]:
    """Return variants of a set, in each of which its least certain form is moved; empty if no form is open.

    The form moves along the direction in which it is the least certain, by the `FORM_STDS`. `evidence` notes the spread
    of the form for the moved ones too, which are as uncertain. A form whose spread is infinite is not moved: no run
    shows it.
    """
    largest_std, least_certain, direction = LEAST_OPEN_STD, None, np.zeros(0)
    for index, candidate in enumerate(hypothesis):
        covariance = evidence.form_spread.get(candidate)
        if covariance is None or not np.isfinite(covariance).all():
            continue
        variances, directions = np.linalg.eigh(covariance)  # ascending
        if variances[-1] > largest_std**2:
            largest_std, least_certain, direction = math.sqrt(variances[-1]), index, directions[:, -1]
    if least_certain is None:
        return []
    name, form = hypothesis[least_certain]
    variants = []
    for stds in FORM_STDS:
        factors = np.exp(stds * min(largest_std, MOST_FORM_STD) * direction)
        moved_form = (*(np.asarray(form[: len(factors)]) * factors).tolist(), *form[len(factors) :])
        evidence.form_spread[name, moved_form] = evidence.form_spread[name, form]
        variants.append([*hypothesis[:least_certain], (name, moved_form), *hypothesis[least_certain + 1 :]])
    return variants


def nearest_to_runs(evidence: Evidence, hypothesis: Sequence[Candidate], models: Sequence[Model]) -> int:
    """Return the index of the model whose replays of the fitted runs come nearest to these.

    Each channel of each run counts by the logarithm of its mean square residual, at least its noise. Of models that are
    equally near, the first counts.

    hypothesis : set whose stamps the replays have.
    """
    lateness = evidence.lateness(evidence.settle(hypothesis))
    records = [stamped(record, lateness) for record in evidence.records]
    plants = [plant_of(model) for model in models]
    give = fitted_give(records, models[0])
    for plant in plants:
        plant.give = give
    jobs_of_records = [[Job(record, plant) for plant in plants] for record in records]
    replay_all([job for jobs in jobs_of_records for job in jobs])
    log_squares: npt.NDArray[np.float64] = np.zeros(len(models))
    for record, jobs in zip(records, jobs_of_records, strict=True):
        for channel in compare(record, jobs, disturbed=jobs[0]):
            squares = [float(np.mean(channel.squares(index))) for index in range(len(models))]
            log_squares += np.log(np.maximum(squares, max(channel.noise**2, np.finfo(np.float64).tiny)))
    return int(np.argmin(log_squares))
