"""A fault of the set-up, its evidence, and the change of a record that mends it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from leactl.gap.diagnosis import Cause, EffectParameter, Picture
from leactl.gap.signals.record import SMOOTHING_REACH, Key, Record

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SetUpFault:
    """A channel that differs from its description, and the change of a record that mends it."""

    name: str  # of the vocabulary's family `setup`
    key: Key
    probability: float
    evidence: str
    change: str  # advice on what to change in the mapping or the bench file
    mend: Callable[[Record], Record]
    parameters: tuple[EffectParameter, ...] = ()
    peers: tuple[str, ...] = ()  # faults that these runs cannot tell from it
    # whether mending has to shrink the gap; not if it only replaces or leaves out samples, or exchanges two channels
    shrinks: bool = True
    share: float | None = None  # share of the channel's squared error on held-out runs that mending removes
    picture: Picture | None = None  # of the channel's error, as logged and as mended

    def as_cause(self) -> Cause:
        """Return the fault as a cause of a diagnosis."""
        return Cause(
            self.name,
            self.probability,
            self.share or 0.0,
            self.parameters,
            self.peers,
            family="setup",
            change=self.change,
            picture=self.picture,
        )

    def note(self) -> str:
        """Return the evidence and the change in one line."""
        quantity, role = self.key
        mended_share = (
            "" if self.share is None else f"; mended, {100.0 * self.share:.3g} % of what it is off by is gone"
        )
        return f"{self.name}: {quantity}{f' of {role}' if role else ''} {self.evidence}{mended_share}; {self.change}"


def with_values(record: Record, key: Key, values: Array) -> Record:
    """Return a record with new values of a channel; the same record if it lacks the channel."""
    clock = record.fast
    if clock is None or key not in clock.values:
        return record
    between = {channel: pair for channel, pair in clock.between.items() if channel != key}
    return replace(record, fast=replace(clock, values=clock.values | {key: values}, between=between))


def without_samples(record: Record, key: Key, masks: Mapping[str, Mask]) -> Record:
    """Return a record without the masked samples of a channel, or without the channel if all are masked."""
    clock, mask = record.fast, masks.get(record.name)
    if clock is None or mask is None or key not in clock.values:
        return record
    if not mask.all():
        # beside the masked samples of a clipped channel, noise is cut on one side
        widened_mask = maximum_filter1d(mask, 2 * SMOOTHING_REACH + 1)
        return replace(record, fast=replace(clock, valid=clock.valid | {key: clock.valid[key] & ~widened_mask}))
    remaining = {channel: values for channel, values in clock.values.items() if channel != key}
    return replace(record, fast=replace(clock, values=remaining))
