"""What a fault of a set-up says of itself, and what undoes it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.gap.diagnosis import Cause, EffectParameter
from leactl.gap.record import Key, Record

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SetUpFault:
    """One channel that is not what its description says."""

    name: str  # of the vocabulary's family `setup`
    key: Key
    explained: float  # share of the channel's gap that goes once the fault is mended, or of its samples at fault
    evidence: str
    change: str  # the line that undoes it where the run was imported or recorded
    mend: Callable[[Record], Record]
    parameters: tuple[EffectParameter, ...] = ()
    peers: tuple[str, ...] = ()  # of the vocabulary, that these runs cannot tell from it

    def as_cause(self) -> Cause:
        """The fault among the causes of a diagnosis."""
        return Cause(
            self.name, self.explained, self.explained, self.parameters, self.peers, family="setup", change=self.change
        )

    def note(self) -> str:
        """The evidence and the change, in one line."""
        quantity, role = self.key
        return f"{self.name}: {quantity} of {role} {self.evidence}; {self.change}"


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
        return replace(record, fast=replace(clock, valid=clock.valid | {key: clock.valid[key] & ~out}))
    kept = {other: values for other, values in clock.values.items() if other != key}
    return replace(record, fast=replace(clock, values=kept))
