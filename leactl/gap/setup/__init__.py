"""Faults of a set-up, searched before any effect: a channel that is dead, reversed, scaled, swapped or out of time.

They are the commonest causes on real benches, and each makes a gap that some effect of a machine would explain as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from leactl.gap.setup.clock_faults import out_of_time
from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.faulty_samples import clipped, frozen, repeated, wrapped
from leactl.gap.setup.mending import mended_picture
from leactl.gap.setup.signs_and_scales import misscaled
from leactl.gap.setup.swapped_channels import swapped
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

__all__ = ["SetUpFault", "mended"]

Look = Callable[[Sequence[Record], Model], SetUpFault | None]
LOOKS: tuple[Look, ...] = (swapped, wrapped, frozen, repeated, clipped, misscaled, out_of_time)
GONE = 0.3  # smallest share of a channel's squared error on held-out runs that mending a fault removes
MOST = 8  # most mends of one set-up


def mended(
    records: Sequence[Record], model: Model, held_out: int | None = None
) -> tuple[list[SetUpFault], list[Record]]:
    """Return the faults that the records of a case show, and the mended records in the same order.

    Parameters
    ----------
    held_out : number of held-out records, the last ones, on which the gap of a fault is measured; all by default.
    """
    faults, mended_records = list[SetUpFault](), list(records)
    rounds, first_held_out = 0, 0 if held_out is None else len(mended_records) - held_out
    for look in LOOKS:
        logged = mended_records
        while (fault := look(mended_records, model)) is not None:
            remended = [fault.mend(record) for record in mended_records]
            repeats_last = bool(faults) and (faults[-1].name, faults[-1].key) == (fault.name, fault.key)
            logged = logged if repeats_last else mended_records
            picture_and_share = mended_picture(fault.name, logged[first_held_out:], remended[first_held_out:], model)
            shrinks = picture_and_share is not None and picture_and_share[1] >= GONE
            if picture_and_share is not None and fault.shrinks and not shrinks:
                break
            if picture_and_share is not None and shrinks:
                fault = replace(fault, picture=picture_and_share[0], share=picture_and_share[1])
            if repeats_last:  # more of the last fault: its first description is the best
                fault = replace(faults.pop(), picture=fault.picture, share=fault.share)
            faults.append(fault)
            mended_records = remended
            rounds += 1
            if rounds == MOST:
                return faults, mended_records
    return faults, mended_records
