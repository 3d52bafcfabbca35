"""Checks of a plan before a run starts: setpoints beyond the limits, and a loop too slow for its drives."""

from collections.abc import Collection, Mapping

from leactl.errors import InputError
from leactl.quantities import UNITS
from leactl.safety.limits import Limits

# A device continues for a time without a sign of life; at least this many cycles of the loop, each with a sign of life,
# have to fit into that time, so that two may be lost.
LEAST_RATE_WITH_SUPPLY_HZ = 3.0  # so that a stop and a silent supply are noticed within a third of a second
FEWEST_CYCLES_PER_TIMEOUT = 3


def check_setpoints(limits: Limits, peaks: Mapping[tuple[str, str], float]) -> None:
    """Raise if a setpoint of a plan is beyond the bench's limits; called before anything moves.

    Parameters
    ----------
    peaks : largest magnitude of the setpoint by role and quantity, in the SI unit of the quantity.

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


def check_rate(rate_hz: float, longest_silences_s: Mapping[str, float | None], supplies: Collection[str] = ()) -> None:
    """Raise if the loop is too slow for a device that needs signs of life of the host, or for a supply.

    A request to stop waits for the next cycle, and a supply heats on until then.

    Parameters
    ----------
    longest_silences_s : how long each device continues without a sign of life [s]; None where it needs none.
    supplies : names of the power supplies.

    Raises
    ------
    InputError : one line for each device whose time holds fewer than `FEWEST_CYCLES_PER_TIMEOUT` cycles, and for each
        supply below `LEAST_RATE_WITH_SUPPLY_HZ`.
    """
    faults = [
        f"rate_Hz: {rate_hz:g} Hz is too slow for {name}, a supply: a stop waits for the next cycle; at least"
        f" {LEAST_RATE_WITH_SUPPLY_HZ:g} Hz was expected"
        for name in supplies
        if rate_hz < LEAST_RATE_WITH_SUPPLY_HZ
    ]
    for name, silence in longest_silences_s.items():
        # a rate that is exactly enough may be rounded below
        if silence is not None and rate_hz * silence < FEWEST_CYCLES_PER_TIMEOUT * (1 - 1e-9):
            faults.append(
                f"rate_Hz: {rate_hz:g} Hz is too slow for {name}, which stops after {silence:g} s without the host;"
                f" at least {FEWEST_CYCLES_PER_TIMEOUT / silence:.4g} Hz was expected"
            )
    if faults:
        raise InputError(faults)
