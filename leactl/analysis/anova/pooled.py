"""One estimate or bound over several actuators, and the difference of two estimates, with 95 % intervals."""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.errors import NotIdentifiable


def over_actuators(estimates: Sequence[Estimate]) -> Estimate:
    """Estimate the mean of one result over actuators of one make; actuators are a random factor, as in `anova`.

    The interval combines the scatter between actuators, by Student's t, with the mean half-width of the actuators'
    intervals. The latter counts in full, since common instruments have the same error for all actuators. If an estimate
    has no uncertainty, the result is the mean without an interval.

    Raises
    ------
    NotIdentifiable : no estimate has a value.
    """
    finite_estimates = [estimate for estimate in estimates if math.isfinite(estimate.value)]
    if not finite_estimates:
        raise NotIdentifiable(f"{estimates[0].name}: not known of any actuator")
    first_estimate, count = finite_estimates[0], len(finite_estimates)
    if count == 1:
        return first_estimate
    from scipy.stats import t

    values = np.array([estimate.value for estimate in finite_estimates])
    if not all(math.isfinite(estimate.std) for estimate in finite_estimates):  # such as a coefficient of determination
        return Estimate(first_estimate.name, float(values.mean()), NAN, NAN, NAN, first_estimate.units)
    standard_error = float(values.std(ddof=1)) / math.sqrt(count)
    mean = float(values.mean())
    mean_std = _mean([estimate.std for estimate in finite_estimates])
    half_width = math.hypot(
        float(t.ppf(0.975, count - 1)) * standard_error,
        _mean([(estimate.high - estimate.low) / 2.0 for estimate in finite_estimates]),
    )
    return Estimate(
        first_estimate.name,
        mean,
        math.hypot(standard_error, mean_std),
        mean - half_width,
        mean + half_width,
        first_estimate.units,
    )


def widest(bounds: Sequence[Estimate]) -> Estimate:
    """Return the interval that contains the bounds of all actuators; an end that is NaN for one actuator is NaN."""
    low, high = float(np.min([bound.low for bound in bounds])), float(np.max([bound.high for bound in bounds]))
    return Estimate(bounds[0].name, NAN, NAN, low, high, bounds[0].units)


def difference(first: Estimate, second: Estimate) -> Estimate:
    """Return second minus first for independent estimates, with the interval of Zou and Donner (2008)."""
    value = second.value - first.value
    low = value - math.hypot(second.value - second.low, first.high - first.value)
    high = value + math.hypot(second.high - second.value, first.value - first.low)
    return Estimate(first.name, value, math.hypot(first.std, second.std), low, high, first.units)


def _mean(values: Sequence[float]) -> float:
    """Return the mean of the finite values; 0 if none is finite."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.mean(finite)) if finite else 0.0
