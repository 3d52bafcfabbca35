"""A gap that held-out runs leave in replays without any effect, against that of a sound machine.

Equations are judged row by row, leave out rows that they cannot read, and calibrate what no model file holds. What no
equation reads, such as a stop at the end of a motion, shows in a replay alone.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leactl.gap.diagnosis import MOST_REPLAY_MISS, Shrinkage
from leactl.gap.null import sound_runs
from leactl.gap.signals.record import Record
from leactl.gap.verdict.judge import Unexplained, unexplained_probability
from leactl.gap.verdict.shrinkage import shrinkage
from leactl.model.nominal import Model

MOTION = ("angle", "velocity", "torque")
"""Channels that tell how the machine moves; those of the drive depend on bandwidths, which only equations calibrate."""


def unexplained_in_replays(gaps: Sequence[Shrinkage], records: Sequence[Record], model: Model) -> Unexplained:
    """Return the sign of something unexplained in the motion that a model without effects leaves in held-out runs.

    A gap counts in floors, or in what a sound machine leaves in the same replays if that is more. The sound machine is
    simulated only where a gap exceeds `MOST_REPLAY_MISS` floors. No equation goes with the sign, since none shows it.

    Parameters
    ----------
    gaps : gaps of the held-out runs.
    records : held-out runs.
    model : model of the replays.
    """
    nothing = Unexplained(0.0, "")
    wide_gaps = [gap for gap in gaps if gap.quantity in MOTION and gap.augmented_rms > MOST_REPLAY_MISS * gap.floor_rms]
    if not wide_gaps:
        return nothing
    sound_floors = floors_of_sound_machine(records, model)
    ratios = {
        gap: gap.augmented_rms / floor
        for gap in wide_gaps
        if (floor := max(gap.floor_rms, sound_floors.get((gap.quantity, gap.role, gap.mechanical), 0.0))) > 0.0
    }
    if not ratios:
        return nothing
    widest_gap, ratio = max(ratios.items(), key=lambda item: item[1])
    note = (
        f"unexplained: simulated again, {widest_gap.quantity} of held-out runs, {widest_gap.mechanical}, is"
        f" {ratio:.3g} times as far off as a sound machine's"
    )
    return Unexplained(unexplained_probability(ratio**2, MOST_REPLAY_MISS**2), note)


def floors_of_sound_machine(records: Sequence[Record], model: Model) -> dict[tuple[str, str, str], float]:
    """Return what a model leaves in replays of runs that it has made itself, by quantity, role and set-up."""
    # the meaning of stamps is calibrated by now, so that no machine draws another one
    stamped_records = [
        record if record.fast is None else replace(record, fast=replace(record.fast, unstamped=set()))
        for record in records
    ]
    (runs,) = sound_runs(stamped_records, [model], np.random.default_rng(0))
    return {
        (gap.quantity, gap.role, gap.mechanical): gap.augmented_rms
        for gap in shrinkage(runs, model, model, model).shrinkage
    }
