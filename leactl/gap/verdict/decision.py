"""The verdict of a diagnosis, and the probabilities that decide it."""

from collections.abc import Sequence

from leactl.gap.diagnosis import Cause, Verdict

LISTED_PROBABILITY = 0.01  # probability from which an effect stands among the causes
NAMED_PROBABILITY = 0.5  # probability from which an effect counts as named
UNKNOWN_PROBABILITY = 0.5  # probability of something unexplained from which the verdict is `unknown` if none is named


def verdict_of(causes: Sequence[Cause], unexplained_probability: float, parameters_differ: bool) -> Verdict:
    """Return the verdict of a diagnosis.

    It is `effect` if a cause is named, else `unknown` if something unexplained is probable, else `calibration` if
    parameters differ, else `none`.

    Parameters
    ----------
    parameters_differ : whether the runs are explained better by parameters other than the nominal ones.
    """
    if any(cause.probability >= NAMED_PROBABILITY for cause in causes):
        return "effect"
    if unexplained_probability >= UNKNOWN_PROBABILITY:
        return "unknown"
    return "calibration" if parameters_differ else "none"
