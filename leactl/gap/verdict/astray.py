"""Whether a replay goes farther astray than a sound machine's: what acts in a few samples hides from every equation.

A gear that plays, or a friction that yields first, acts within a reversal, whose rows no balance counts. Its replay
goes astray all the same. How far a sound machine's does is no property of the noise alone: small errors add up over a
stretch. So it is measured, on sound machines through the same runs.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from leactl.gap.diagnosis import Shrinkage
from leactl.gap.null import sound_runs
from leactl.gap.search.evidence import Evidence
from leactl.gap.search.parameters import calibrated, with_calibration
from leactl.gap.signals.record import Record
from leactl.gap.signals.stamps import stamped
from leactl.gap.verdict.shrinkage import shrinkage
from leactl.gap.verdict.where import REPLAY_MISS

SOUND = 2  # sound machines whose replays are compared; the farther one counts
MOTION = ("velocity", "angle")
Place = tuple[str, str, str]  # quantity, role, set-up


def astray(evidence: Evidence, held_out: Sequence[Record], lines: Sequence[Shrinkage]) -> Mapping[Place, float]:
    """How many times as far as a sound machine's replay that of the last model is off, of motions far beyond noise.

    Empty where none is farther off than a replay of the right model may be by its floor alone, so that only a
    doubtful case costs the simulation.
    """
    far = {place(line): line.augmented_rms / line.floor_rms for line in lines if is_far(line)}
    if not far:
        return {}
    fitted, random = evidence.records, np.random.default_rng(0)
    usual: dict[Place, float] = {}
    for runs in sound_runs([*fitted, *held_out], [evidence.model] * SOUND, random):
        names = {record.name for record in held_out}
        own = Evidence([run for run in runs if run.name not in names], evidence.model, only=[], kept=evidence.kept)
        if not own.stack.rows:
            return {}
        if evidence.null is not None:
            own.compare_with(evidence.null)
        fit = own.settle([])
        tuned, stamps = with_calibration(evidence.model, calibrated(own, fit)), own.stamping(fit)
        tried = [stamped(run, stamps) for run in runs if run.name in names]
        for line in shrinkage(tried, evidence.model, tuned, tuned).shrinkage:
            usual[place(line)] = max(usual.get(place(line), 1.0), line.augmented_rms / line.floor_rms)
    return {where: ratio / usual[where] for where, ratio in far.items() if where in usual}


def is_far(line: Shrinkage) -> bool:
    """Whether a motion is farther off than a replay of the right model may be.

    A locked rotor is left out: where friction holds it, and its shaft's torque with it, hangs on its last swing.
    """
    moves = line.quantity in MOTION and line.mechanical != "locked"
    return moves and line.floor_rms > 0.0 and line.augmented_rms > REPLAY_MISS * line.floor_rms


def place(line: Shrinkage) -> Place:
    """The channel of a line."""
    return line.quantity, line.role, line.mechanical
