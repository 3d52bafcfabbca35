"""Relative standard uncertainty of an instrument's calibration factor: the given value, or that of the channel."""

import math
from collections.abc import Iterable, Mapping, Sequence

from leactl.errors import InputError
from leactl.runfile.read.reader import Run


def gain_std(runs: Sequence[Run], quantity: str, given_std: float | None) -> float:
    """Return the relative standard uncertainty of a quantity's calibration.

    It is the given value, or the largest of the quantity's channels of the test actuator.

    Raises
    ------
    InputError : the given uncertainty is below zero or not finite.
    """
    if given_std is None:
        return max((channel.scale_std for run in runs for channel in run.channels(quantity, role="test")), default=0.0)
    if not (math.isfinite(given_std) and given_std >= 0.0):
        name = f"{quantity.rpartition('_')[2]}_gain_std"
        raise InputError(f"{name} {given_std:g}: a relative standard uncertainty of zero or more was expected")
    return given_std


def calibration_notes(stds: Mapping[str, float], results: str) -> list[str]:
    """Return notes on instruments whose calibration scales the results; an uncertainty of 0 counts as unknown.

    `stds` are relative standard uncertainties by instrument, `results` names the results that they scale.
    """
    known_stds = {instrument: std for instrument, std in stds.items() if std}
    unknown_instruments = [instrument for instrument in stds if instrument not in known_stds]
    notes = []
    if known_stds:
        combined_std = math.hypot(*known_stds.values())
        notes.append(f"{_factor_text(known_stds)} on {results}; its {combined_std:.2g} is in their uncertainty")
    if unknown_instruments:
        notes.append(f"{_factor_text(unknown_instruments)} on {results}, on top of their uncertainty")
    return notes


def _factor_text(instruments: Iterable[str]) -> str:
    """Return the part of a note that names instruments whose calibration is a factor."""
    return f"an error in the calibration of {' or '.join(instruments)} is a factor"
