"""Frames that are lost."""

from collections.abc import Sequence

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Drill, OfFrames


class LostFrames(OfFrames):
    """Frames are lost: a bad termination, a full receive buffer, or, where it is all of them, a cable that is off."""

    example = "{fault: lost_frames, at_s: 2, for_s: 1, bus: can0, share: 0.5}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """All frames, and those to the devices alone."""
        return Drill({}, 0.1, "cyclic_age_s"), Drill({"direction": "to_devices"}, 0.1, "cyclic_age_s")

    @property
    def fate(self) -> float | None:
        """None: a lost frame never arrives."""
        return None
