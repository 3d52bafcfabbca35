"""What instruments multiply their readings by: its relative standard uncertainty, as told or as the channel has it."""

import math
from collections.abc import Sequence

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


def doubt(of: str, std: float, where: str) -> str:
    """What a reader must know of a factor on results."""
    if std:
        return f"an error in the calibration of {of} is a factor on {where}; its {std:.2g} is in their uncertainty"
    return f"an error in the calibration of {of} is a factor on {where}, on top of their uncertainty"
