"""Faults of a set-up, looked for before any effect: a channel that is dead, turned, scaled, wrapped or clipped.

They are the commonest causes on real benches, and each makes a gap that some effect of a machine would explain as well.
"""

from collections.abc import Callable, Sequence

from leactl.gap.record import Record
from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.samples import clipped, frozen, repeated, wrapped
from leactl.gap.setup.scaling import misscaled
from leactl.model.nominal import Model

__all__ = ["SetUpFault", "mended"]

Look = Callable[[Sequence[Record], Model], SetUpFault | None]
LOOKS: tuple[Look, ...] = (wrapped, frozen, repeated, clipped, misscaled)
MOST = 8  # faults, beyond which a set-up is not described but made up


def mended(records: Sequence[Record], model: Model) -> tuple[list[SetUpFault], list[Record]]:
    """Faults that the records of a case show, and the records without them, in the same order."""
    faults, kept = list[SetUpFault](), list(records)
    for look in LOOKS:
        while len(faults) < MOST and (fault := look(kept, model)) is not None:
            faults.append(fault)
            kept = [fault.mend(record) for record in kept]
    return faults, kept
