"""Refusals before a run starts: setpoints beyond the limits, and a loop too slow for its drives."""

from collections.abc import Mapping

from leactl.errors import InputError
from leactl.quantities import UNITS
from leactl.safety.limits import Limits

SIGNS_OF_LIFE = 3  # at least, within the time that a device continues without one: two may be lost


def check_setpoints(limits: Limits, peaks: Mapping[tuple[str, str], float]) -> None:
    """Refuse a plan whose peaks are outside the limits, before anything moves.

    Raises
    ------
    InputError : one line for each setpoint outside of its limits.
    """
    faults = []
    for (role, quantity), peak in peaks.items():
        bounds = limits.of(quantity)
        if bounds is not None and not abs(peak) <= bounds[1]:
            unit = UNITS[quantity]
            faults.append(f"{role} {quantity}: {peak:g} {unit} is above the bench limit of {bounds[1]:g} {unit}")
    if faults:
        raise InputError(faults)


def check_rate(rate_hz: float, silences: Mapping[str, float | None]) -> None:
    """Refuse a loop so slow that a device which needs signs of life of the host would stop between two.

    Parameters
    ----------
    silences : how long each device continues without a sign of life [s]; None where it needs none.

    Raises
    ------
    InputError : one line for each device whose time holds fewer than three cycles.
    """
    faults = []
    for name, silence in silences.items():
        if silence is not None and rate_hz * silence < SIGNS_OF_LIFE * (1 - 1e-9):
            faults.append(
                f"rate_Hz: {rate_hz:g} Hz is too slow for {name}, which stops after {silence:g} s without the host;"
                f" at least {SIGNS_OF_LIFE / silence:.4g} Hz was expected"
            )
    if faults:
        raise InputError(faults)
