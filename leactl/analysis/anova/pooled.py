"""One estimate or bound over several actuators, and the difference of two estimates, with 95 % intervals."""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.errors import NotIdentifiable


def over_actuators(estimates: Sequence[Estimate]) -> Estimate:
    """The mean of one result over actuators, for actuators of their make: they are a random factor, as in `anova`.

    Scatter between them counts by Student's t. The mean half-width of their own intervals counts in full beside it:
    instruments that they have in common are off for all of them alike. Without uncertainties it is the mean alone.

    Raises
    ------
    NotIdentifiable : no estimate has a value.
    """
    known = [one for one in estimates if math.isfinite(one.value)]
    if not known:
        raise NotIdentifiable(f"{estimates[0].name}: not known of any actuator")
    first, count = known[0], len(known)
    if count == 1:
        return first
    from scipy.stats import t

    values = np.array([one.value for one in known])
    if not all(math.isfinite(one.std) for one in known):  # such as a coefficient of determination
        return Estimate(first.name, float(values.mean()), NAN, NAN, NAN, first.units)
    error = float(values.std(ddof=1)) / math.sqrt(count)
    mean = float(values.mean())
    own = _mean([one.std for one in known])
    half = math.hypot(float(t.ppf(0.975, count - 1)) * error, _mean([(one.high - one.low) / 2.0 for one in known]))
    return Estimate(first.name, mean, math.hypot(error, own), mean - half, mean + half, first.units)


def widest(bounds: Sequence[Estimate]) -> Estimate:
    """Bounds that hold for every actuator, where none has a value; a side that is not known of one is not known."""
    low, high = float(np.min([one.low for one in bounds])), float(np.max([one.high for one in bounds]))
    return Estimate(bounds[0].name, NAN, NAN, low, high, bounds[0].units)


def difference(first: Estimate, second: Estimate) -> Estimate:
    """Second less first, taken as independent; each end of the interval from the ends of both (Zou, Donner 2008)."""
    value = second.value - first.value
    low = value - math.hypot(second.value - second.low, first.high - first.value)
    high = value + math.hypot(second.high - second.value, first.value - first.low)
    return Estimate(first.name, value, math.hypot(first.std, second.std), low, high, first.units)


def _mean(values: Sequence[float]) -> float:
    """Mean of those that are known; 0 where none is."""
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else 0.0
