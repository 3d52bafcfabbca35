"""Check of estimates that must be positive: a negative value means that two channels have opposite signs."""

from leactl.analysis.estimate import Estimate
from leactl.errors import InputError

SIGN_SWAPPED = "a sign is swapped: check `sign` of the drives and of the torque sensor's scale"


def refuse_below_zero(estimate: Estimate, error_prefix: str, channels: str) -> None:
    """Raise InputError if the 95 % interval of an estimate is entirely negative; without an interval, if its value is.

    Parameters
    ----------
    error_prefix : text that opens the message, such as the run files.
    channels : names of the channels whose signs contradict each other in this case.
    """
    if estimate.value < 0.0 and not estimate.high >= 0.0:
        raise InputError(
            f"{error_prefix}: {estimate.name} comes out at {estimate.value:.3g} {estimate.units}, where above zero was"
            f" expected: {channels} contradict each other; {SIGN_SWAPPED}"
        )
