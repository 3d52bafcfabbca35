"""A drive that keeps working but sends no heartbeat."""

from collections.abc import Sequence
from typing import Any

from pydantic import Field

from leactl.bench.benchfile import BenchFile, CanBus
from leactl.driver.far_end import CanEmulator, Frame, Living
from leactl.emulation.faults.contract import Draw, Drill, FaultTarget, LastingFault, OfDevice, PlannedBench, Undo


class HeartbeatLoss(OfDevice, LastingFault):
    """The drive's heartbeat stays away while it hears, obeys and moves: a transmitter or a task of it that has died."""

    example = "{fault: heartbeat_loss, at_s: 2, device: drive_test, answers: true}"

    answers: bool = Field(False, description="true: every other frame of the drive stays away as well")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """The heartbeat alone, and all frames that the drive sends."""
        return Drill({}, 0.5, "the drive's heartbeat"), Drill({"answers": True}, 0.1, "cyclic_age_s")

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Reason if the device is not on a CAN bus or sends no heartbeat."""
        bus = planned_bench.file.buses.get(planned_bench.devices[self.device].entry.bus or "")
        if not isinstance(bus, CanBus):
            return {"device": f"'{self.device}' is not on a CAN bus"}
        return {} if isinstance(far_end, Living) else {"device": f"'{self.device}' sends no heartbeat"}

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Drop the heartbeats, or with `answers` all frames of the drive."""
        drive = bench.far_ends[self.device]

        def passes(frame: Frame, source: CanEmulator | None) -> float | None:
            is_dropped = source is drive and (
                self.answers or (isinstance(source, Living) and source.is_sign_of_life(frame))
            )
            return None if is_dropped else 0.0

        return bench.wires[bench.bus_of[self.device]].disturb(passes)
