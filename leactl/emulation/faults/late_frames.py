"""Frames that arrive too late."""

from collections.abc import Sequence

from pydantic import Field

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Drill, OfFrames, Positive


class LateFrames(OfFrames):
    """Frames are held up on their way: an adapter on a busy USB hub, a gateway, a host that reads its socket late."""

    example = "{fault: late_frames, at_s: 2, for_s: 1, bus: can0, delay_s: 0.1, direction: to_host}"

    delay_s: Positive = Field(description="how much later a frame arrives")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Frames to the host that arrive later than a reading may be old."""
        return (Drill({"delay_s": 0.2, "direction": "to_host"}, 0.1, "cyclic_age_s"),)

    @property
    def fate(self) -> float | None:
        """Delay of a frame [s]."""
        return self.delay_s
