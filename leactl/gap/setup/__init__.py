"""Faults of a set-up, searched before any effect: a channel that is dead, reversed, scaled, swapped or out of time.

They are the commonest causes on real benches, and each makes a gap that some effect of a machine would explain as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from leactl.gap.setup.clock_faults import find_clock_fault
from leactl.gap.setup.contract import SetUpFault
from leactl.gap.setup.faulty_samples import (
    find_clipped_channel,
    find_frozen_channel,
    find_repeated_samples,
    find_wrapped_angle,
)
from leactl.gap.setup.mended_picture import mended_picture
from leactl.gap.setup.signs_and_scales import find_scale_fault
from leactl.gap.setup.swapped_channels import find_swap
from leactl.gap.signals.record import Record
from leactl.model.nominal import Model

__all__ = ["SetUpFault", "find_and_mend_faults"]

FaultSearch = Callable[[Sequence[Record], Model], SetUpFault | None]
FAULT_SEARCHES: tuple[FaultSearch, ...] = (
    find_swap,
    find_wrapped_angle,
    find_frozen_channel,
    find_repeated_samples,
    find_clipped_channel,
    find_scale_fault,
    find_clock_fault,
)
LEAST_HELD_OUT_SHARE = 0.3  # smallest share of a channel's squared error on held-out runs that mending a fault removes
MOST_MENDS = 8  # mends of one set-up, so that the search ends


def find_and_mend_faults(
    records: Sequence[Record], model: Model, held_out: int | None = None
) -> tuple[list[SetUpFault], list[Record]]:
    """Return the faults that the records of a case show, and the mended records in the same order.

    Parameters
    ----------
    held_out : number of records at the end that are held out; the share that a mend removes is measured on them. By
        default it is measured on all records.
    """
    faults, mended_records = list[SetUpFault](), list(records)
    mend_count, first_held_out = 0, 0 if held_out is None else len(mended_records) - held_out
    for find_fault in FAULT_SEARCHES:
        logged = mended_records
        while (fault := find_fault(mended_records, model)) is not None:
            remended = [fault.mend(record) for record in mended_records]
            repeats_last = bool(faults) and (faults[-1].name, faults[-1].key) == (fault.name, fault.key)
            logged = logged if repeats_last else mended_records
            picture_and_share = mended_picture(fault.name, logged[first_held_out:], remended[first_held_out:], model)
            shrinks = picture_and_share is not None and picture_and_share[1] >= LEAST_HELD_OUT_SHARE
            if picture_and_share is not None and fault.shrinks and not shrinks:
                break
            if picture_and_share is not None and shrinks:
                fault = replace(fault, picture=picture_and_share[0], share=picture_and_share[1])
            if repeats_last:  # a further mend of the last fault: its first description is the best
                fault = replace(faults.pop(), picture=fault.picture, share=fault.share)
            faults.append(fault)
            mended_records = remended
            mend_count += 1
            if mend_count == MOST_MENDS:
                return faults, mended_records
    return faults, mended_records
