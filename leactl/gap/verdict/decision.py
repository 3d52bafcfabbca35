"""The verdict of a diagnosis, and the probabilities that decide it."""

from collections.abc import Sequence

from leactl.gap.diagnosis import Cause, Verdict

LISTED = 0.01  # probability from which an effect stands among the causes
NAMED = 0.5  # probability from which an effect counts as named
UNKNOWN = 0.5  # probability that something unexplained acts, from which the verdict is that where no effect is named


def verdict_of(causes: Sequence[Cause], surprise: float, calibrates: bool) -> Verdict:
    """Return the verdict by the causes, the probability of something unexplained, and whether calibration gains."""
    if any(cause.probability >= NAMED for cause in causes):
        return "effect"
    if surprise >= UNKNOWN:
        return "unknown"
    return "calibration" if calibrates else "none"
