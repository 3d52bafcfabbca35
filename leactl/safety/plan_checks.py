"""Checks of a plan before a run starts: setpoints beyond the limits, and a loop too slow for its drives."""

from collections.abc import Mapping

from leactl.errors import InputError
from leactl.quantities import UNITS
from leactl.safety.limits import Limits

# A device continues for a time without a sign of life; at least this many cycles of the loop, each with a sign of life,
# have to fit into that time, so that two may be lost.
CYCLES_PER_TIMEOUT = 3


def check_setpoints(limits: Limits, peaks: Mapping[tuple[str, str], float]) -> None:
    """Refuse a plan whose peaks are outside the limits, before anything moves.

    Parameters
    ----------
    peaks : setpoint of the largest magnitude, with its sign, by role and quantity, in the SI unit of the quantity.

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
    InputError : one line for each device whose time holds fewer than `CYCLES_PER_TIMEOUT` cycles.
    """
    faults = []
    for name, silence in silences.items():
        if silence is not None and rate_hz * silence < CYCLES_PER_TIMEOUT * (1 - 1e-9):
            faults.append(
                f"rate_Hz: {rate_hz:g} Hz is too slow for {name}, which stops after {silence:g} s without the host;"
                f" at least {CYCLES_PER_TIMEOUT / silence:.4g} Hz was expected"
            )
    if faults:
        raise InputError(faults)
