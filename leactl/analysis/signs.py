"""Figures that are above zero of every machine: one that comes out below tells of channels with opposite senses."""

from leactl.analysis.estimate import Estimate
from leactl.errors import InputError

SWAPPED = "a sign is swapped: check `sign` of the drives and of the torque sensor's scale"


def refuse_below_zero(found: Estimate, place: str, channels: str) -> None:
    """Refuse a figure whose whole interval lies below zero, or which has none and is there itself.

    Raises
    ------
    InputError : so; with the channels that contradict each other.
    """
    if found.value < 0.0 and not found.high >= 0.0:
        raise InputError(
            f"{place}: {found.name} comes out at {found.value:.3g} {found.units}, where above zero was expected:"
            f" {channels} contradict each other; {SWAPPED}"
        )
