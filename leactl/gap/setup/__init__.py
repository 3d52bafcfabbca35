"""Faults of a set-up, looked for before any effect: a channel that is dead, turned, scaled, swapped or out of time.

They are the commonest causes on real benches, and each makes a gap that some effect of a machine would explain as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from leactl.gap.record import Record
from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.drifting import out_of_time
from leactl.gap.setup.mending import mended_picture
from leactl.gap.setup.samples import clipped, frozen, repeated, wrapped
from leactl.gap.setup.scaling import misscaled
from leactl.gap.setup.swapping import swapped
from leactl.model.nominal import Model

__all__ = ["SetUpFault", "mended"]

Look = Callable[[Sequence[Record], Model], SetUpFault | None]
LOOKS: tuple[Look, ...] = (swapped, wrapped, frozen, repeated, clipped, misscaled, out_of_time)
MOST = 8  # faults, beyond which a set-up is not described but made up


def mended(
    records: Sequence[Record], model: Model, held_out: int | None = None
) -> tuple[list[SetUpFault], list[Record]]:
    """Faults that the records of a case show, and the records without them, in the same order.

    Parameters
    ----------
    held_out : so many of the last records are held out: they show how far a fault opens the gap; all by default.
    """
    faults, kept = list[SetUpFault](), list(records)
    first = 0 if held_out is None else len(kept) - held_out
    for look in LOOKS:
        while len(faults) < MOST and (fault := look(kept, model)) is not None:
            again = [fault.mend(record) for record in kept]
            if (drawn := mended_picture(fault.name, kept[first:], again[first:], model)) is not None:
                fault = replace(fault, picture=drawn[0], share=drawn[1])
            faults.append(fault)
            kept = again
    return faults, kept
