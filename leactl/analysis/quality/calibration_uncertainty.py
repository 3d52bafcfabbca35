"""What instruments multiply their readings by: its relative standard uncertainty, as told or as the channel has it."""

import math
from collections.abc import Iterable, Mapping, Sequence

from leactl.errors import InputError
from leactl.runfile.reader import Run


def gain_std(runs: Sequence[Run], quantity: str, told: float | None) -> float:
    """That of a quantity of the test actuator; its channel's own unless told.

    Raises
    ------
    InputError : one below zero.
    """
    if told is None:
        return max((channel.scale_std for run in runs for channel in run.channels(quantity, role="test")), default=0.0)
    if not (math.isfinite(told) and told >= 0.0):
        name = f"{quantity.rpartition('_')[2]}_gain_std"
        raise InputError(f"{name} {told:g}: a relative standard uncertainty of zero or more was expected")
    return told


def calibration_notes(stds: Mapping[str, float], where: str) -> list[str]:
    """What a reader must know of factors on results, by whose they are; one of 0 is not known."""
    told = {of: std for of, std in stds.items() if std}
    silent = [of for of in stds if of not in told]
    found = []
    if told:
        whole = math.hypot(*told.values())
        found.append(f"{_factor(told)} on {where}; its {whole:.2g} is in their uncertainty")
    if silent:
        found.append(f"{_factor(silent)} on {where}, on top of their uncertainty")
    return found


def _factor(of: Iterable[str]) -> str:
    return f"an error in the calibration of {' or '.join(of)} is a factor"
