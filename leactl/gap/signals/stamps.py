"""Stamps of a log that does not say what they mean: each is known to within one sample.

Two such channels of one equation differ by up to two samples, an input may be held where the model interpolates it, and
one channel may be a mean where the other is an instant. Weighted neighbouring samples of one channel describe all of
these.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from leactl.gap.signals.record import Clocked, Key, Record

Array = npt.NDArray[np.float64]
TAPS = np.array([-3, -2, -1, 1, 2, 3])  # samples, shifts of the neighbours that stand for unknown stamps
TAP_PRIOR = 0.5  # prior standard deviation of a neighbour's weight
BETWEEN_SAMPLES = "reference_sampling_s"  # nuisance: when a drive's own servo moves its reference inside an interval


def stamp_columns(equation: str, clock: Clocked, keys: Sequence[Key], column: Array) -> dict[str, tuple[Array, float]]:
    """Return the nuisances for unknown stamps in an equation: columns of neighbouring samples, and priors."""
    if not any(key in clock.unstamped for key in keys):
        return {}
    return {
        tap_name(equation, shift): (neighbour(column, shift / clock.decimation) - column, TAP_PRIOR)
        for shift in TAPS.tolist()
    }


def tap_name(equation: str, shift: int) -> str:
    """Return the name of the nuisance that weights the sample `shift` later."""
    return f"{equation}_stamp{shift:+d}"


def neighbour(values: Array, shift: float) -> Array:
    """Return the values `shift` samples later, linear between samples, constant beyond the ends."""
    samples = np.arange(len(values))
    return np.asarray(np.interp(samples + shift, samples, values), np.float64)


def restamped(values: Array, lateness: float, parts: int = 1) -> Array:
    """Return values as a log stamps them that is late by some samples; `parts` values make a sample.

    The fitted weights of neighbouring samples hold more than a delay. They are fitted to smoothed channels, which do
    not determine what the weights do to quick changes: applied to an unsmoothed replay, they would magnify these.
    """
    return neighbour(values, -lateness * parts) if lateness else values


def lateness_of(weights: Array) -> float:
    """Return the samples by which one side of an equation is later than the other."""
    return -float(TAPS @ weights)


def stamped(record: Record, lateness: Mapping[str, float]) -> Record:
    """Return a run whose replay is late by some samples, by equation; the same run if its stamps are known."""
    if record.fast is None or not record.fast.unstamped:
        return record
    return replace(record, fast=replace(record.fast, lateness=dict(lateness)))


def stamp_notes(lateness: Mapping[str, float], overdue: Sequence[str], latest: float) -> tuple[str, ...]:
    """Return notes on the delay between the sides of each equation in samples; none where stamps are known.

    overdue : equations whose delay exceeds `latest`, the most samples that stamps alone explain.
    """
    if not lateness:
        return ()
    lateness_text = ", ".join(f"{name} {samples:+.2f}" for name, samples in lateness.items() if name not in overdue)
    lateness_clause = f"; samples by which one side of an equation is late: {lateness_text}" if lateness_text else ""
    excuse = f"up to {latest:g} samples of its delay may be theirs all the same"
    return (
        "the files do not say what their stamps mean (no `sampling`): up to one sample of each channel is"
        f" calibrated{lateness_clause}",
        *(f"one side of {name} is later than stamps can be; {excuse}" for name in overdue),
    )
