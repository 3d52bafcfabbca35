"""Stamps of a log that does not say what they mean: each is known to within one sample.

Two such channels of one equation stand up to two samples off each other, an input may be held where the model takes it
for a straight line, and one channel may be a mean where the other is an instant. Neighbouring samples of one, weighted,
cover all of that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.gap.signals.record import Clocked, Key, Record

Array = npt.NDArray[np.float64]
TAPS = np.array([-3, -2, -1, 1, 2, 3])  # samples
TAP_PRIOR = 0.5  # standard deviation of a neighbour's weight
BETWEEN_SAMPLES = "reference_sampling_s"  # nuisance: when a drive's own servo moves its reference inside an interval


def stamp_columns(equation: str, clock: Clocked, keys: Sequence[Key], column: Array) -> dict[str, tuple[Array, float]]:
    """Nuisances of an equation whose channels' stamps are not told: what its column's neighbours add, and priors."""
    if not any(key in clock.unstamped for key in keys):
        return {}
    return {
        tap_name(equation, by): (neighbour(column, by / clock.decimation) - column, TAP_PRIOR) for by in TAPS.tolist()
    }


def tap_name(equation: str, by: int) -> str:
    """Name of the nuisance that weighs the sample so many later."""
    return f"{equation}_stamp{by:+d}"


def neighbour(values: Array, by: float) -> Array:
    """The value so many samples later, on a straight line between two; the last or first one beyond the ends."""
    at = np.arange(len(values))
    return np.asarray(np.interp(at + by, at, values), np.float64)


def restamped(values: Array, weights: Array | None, parts: int = 1) -> Array:
    """Values as a log with such weights of neighbours stamps them; a sample has so many of these values."""
    if weights is None:
        return values
    moved = (
        weight * (neighbour(values, by * parts) - values) for by, weight in zip(TAPS.tolist(), weights, strict=True)
    )
    return np.asarray(values + sum(moved), np.float64)


def lateness(weights: Array) -> float:
    """Samples by which one side of an equation is later than the other."""
    return -float(TAPS @ weights)


def stamped(record: Record, weights: Mapping[str, Array]) -> Record:
    """A run whose replay gets its stamps as the log has them."""
    if record.fast is None or not record.fast.unstamped:
        return record
    return replace(record, fast=replace(record.fast, stamping=dict(weights)))


def stamp_notes(weights: Mapping[str, Array], overdue: Sequence[str], latest: float) -> tuple[str, ...]:
    """Of each equation, by how many samples one side of it is later than the other; nothing where stamps are told.

    overdue : equations in which stamps alone, which may be late by the `latest` samples, cannot be the reason.
    """
    if not weights:
        return ()
    late = ", ".join(f"{name} {lateness(taps):+.2f}" for name, taps in weights.items() if name not in overdue)
    told = f"; samples by which one side of an equation is late: {late}" if late else ""
    theirs = f"up to {latest:g} samples of its delay may be theirs all the same"
    return (
        "the files do not say what their stamps mean (no `sampling`): up to one sample of each channel is"
        f" calibrated{told}",
        *(f"one side of {name} is later than stamps can be; {theirs}" for name in overdue),
    )
