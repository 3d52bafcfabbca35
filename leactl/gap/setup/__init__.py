"""Faults of a set-up, looked for before any effect: a channel that is dead, turned, scaled, swapped or out of time.

They are the commonest causes on real benches, and each makes a gap that some effect of a machine would explain as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.drifting import out_of_time
from leactl.gap.setup.mending import mended_picture
from leactl.gap.setup.samples import clipped, frozen, repeated, wrapped
from leactl.gap.setup.scaling import misscaled
from leactl.gap.setup.swapping import swapped
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

__all__ = ["SetUpFault", "mended"]

Look = Callable[[Sequence[Record], Model], SetUpFault | None]
LOOKS: tuple[Look, ...] = (swapped, wrapped, frozen, repeated, clipped, misscaled, out_of_time)
GONE = 0.3  # of what a channel is off by on held-out runs, that mending a fault takes at least
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
    rounds, first = 0, 0 if held_out is None else len(kept) - held_out
    for look in LOOKS:
        logged = kept
        while (fault := look(kept, model)) is not None:
            again = [fault.mend(record) for record in kept]
            rest = bool(faults) and (faults[-1].name, faults[-1].key) == (fault.name, fault.key)
            logged = logged if rest else kept
            drawn = mended_picture(fault.name, logged[first:], again[first:], model)
            shrinks = drawn is not None and drawn[1] >= GONE
            if drawn is not None and fault.shrinks and not shrinks:
                break
            if drawn is not None and shrinks:
                fault = replace(fault, picture=drawn[0], share=drawn[1])
            if rest:  # more of the same: what was found first tells it best
                fault = replace(faults.pop(), picture=fault.picture, share=fault.share)
            faults.append(fault)
            kept = again
            rounds += 1
            if rounds == MOST:
                return faults, kept
    return faults, kept
