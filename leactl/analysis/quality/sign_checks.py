"""Estimates that are above zero of every machine: one that comes out below tells of channels with opposite senses."""

from leactl.analysis.estimate import Estimate
from leactl.errors import InputError

SWAPPED = "a sign is swapped: check `sign` of the drives and of the torque sensor's scale"


def refuse_below_zero(estimate: Estimate, place: str, channels: str) -> None:
    """Raise if the 95 % interval of an estimate is entirely negative, or the value of one without an interval.

    Parameters
    ----------
    place : the run file or files, at the head of the message.
    channels : names of the channels that contradict each other then.

    Raises
    ------
    InputError : the estimate is negative.
    """
    if estimate.value < 0.0 and not estimate.high >= 0.0:
        raise InputError(
            f"{place}: {estimate.name} comes out at {estimate.value:.3g} {estimate.units}, where above zero was"
            f" expected: {channels} contradict each other; {SWAPPED}"
        )
