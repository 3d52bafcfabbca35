"""Relative standard uncertainty of an instrument's calibration factor: the given value, or that of the channel."""

import math
from collections.abc import Iterable, Mapping, Sequence

from leactl.errors import InputError
from leactl.runfile.read.reader import Run


def gain_std(runs: Sequence[Run], quantity: str, given: float | None) -> float:
    """Return the relative standard uncertainty of a quantity's calibration: the given one, else the channels' largest.

    Raises
    ------
    InputError : the given uncertainty is below zero or not finite.
    """
    if given is None:
        return max((channel.scale_std for run in runs for channel in run.channels(quantity, role="test")), default=0.0)
    if not (math.isfinite(given) and given >= 0.0):
        name = f"{quantity.rpartition('_')[2]}_gain_std"
        raise InputError(f"{name} {given:g}: a relative standard uncertainty of zero or more was expected")
    return given


def calibration_notes(stds: Mapping[str, float], results: str) -> list[str]:
    """Return notes on instruments whose calibration scales the results; an uncertainty of 0 counts as unknown.

    `stds` are relative standard uncertainties by instrument, `results` names what they scale.
    """
    known = {instrument: std for instrument, std in stds.items() if std}
    unknown = [instrument for instrument in stds if instrument not in known]
    notes = []
    if known:
        combined = math.hypot(*known.values())
        notes.append(f"{_factor(known)} on {results}; its {combined:.2g} is in their uncertainty")
    if unknown:
        notes.append(f"{_factor(unknown)} on {results}, on top of their uncertainty")
    return notes


def _factor(instruments: Iterable[str]) -> str:
    return f"an error in the calibration of {' or '.join(instruments)} is a factor"
