"""What a fault of a set-up says of itself, and what undoes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from leactl.gap.diagnosis import Cause, EffectParameter, Picture
from leactl.gap.signals.record import SMOOTHED, Key, Record

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SetUpFault:
    """One channel that is not what its description says."""

    name: str  # of the vocabulary's family `setup`
    key: Key
    probability: float
    evidence: str
    change: str  # the line that undoes it where the run was imported or recorded
    mend: Callable[[Record], Record]
    parameters: tuple[EffectParameter, ...] = ()
    peers: tuple[str, ...] = ()  # of the vocabulary, that these runs cannot tell from it
    shrinks: bool = True  # whether mending it has to shrink the gap; else samples are left out, or names exchanged
    share: float | None = None  # of what the channel is off by on held-out runs, that goes once the fault is mended
    picture: Picture | None = None  # of that

    def as_cause(self) -> Cause:
        """The fault among the causes of a diagnosis."""
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
        """The evidence and the change, in one line."""
        quantity, role = self.key
        gone = "" if self.share is None else f"; mended, {100.0 * self.share:.3g} % of what it is off by is gone"
        return f"{self.name}: {quantity}{f' of {role}' if role else ''} {self.evidence}{gone}; {self.change}"


def with_values(record: Record, key: Key, values: Array) -> Record:
    """A record whose channel has other values."""
    clock = record.fast
    if clock is None or key not in clock.values:
        return record
    between = {other: pair for other, pair in clock.between.items() if other != key}
    return replace(record, fast=replace(clock, values=clock.values | {key: values}, between=between))


def left_out(record: Record, key: Key, masks: Mapping[str, Mask]) -> Record:
    """A record without some samples of a channel, masked by the record's name; without it where all of them are."""
    clock, out = record.fast, masks.get(record.name)
    if clock is None or out is None or key not in clock.values:
        return record
    if not out.all():
        around = maximum_filter1d(out, 2 * SMOOTHED + 1)  # noise at an end of a range is cut on one side
        return replace(record, fast=replace(clock, valid=clock.valid | {key: clock.valid[key] & ~around}))
    kept = {other: values for other, values in clock.values.items() if other != key}
    return replace(record, fast=replace(clock, values=kept))
