"""Drives that enter their fault state, hang, or fall silent."""

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from leactl.bench.benchfile import BenchFile, CanBus
from leactl.driver.far_end import CanEmulator, Frame, Living
from leactl.emulation.faults.contract import (
    Draw,
    Drill,
    FaultTarget,
    LastingFault,
    OfDevice,
    OfDrive,
    PlannedBench,
    Undo,
)


def _hexadecimal(value: Any) -> Any:
    """Return the number of a hexadecimal text; pydantic checks any other value."""
    if isinstance(value, str) and value.lower().startswith("0x"):
        try:
            return int(value, 16)
        except ValueError:
            return value
    return value


ErrorCode = Annotated[int, BeforeValidator(_hexadecimal), Field(ge=0x1000, le=0xFFFF)]


class DriveFault(OfDrive):
    """The drive takes its power away, enters its fault state and tells why; it stays there until it is reset."""

    fault_name = "drive_fault"
    example = "{fault: drive_fault, at_s: 2, device: drive_test, code: 0x2340}"

    code: ErrorCode = Field(description="error code (CiA 301), as 0x2340 for a short circuit")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return one rehearsal: a short circuit."""
        return (Drill({"code": 0x2340}, 0.05, "the drive's emergency message"),)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Put the drive into its fault state, which a reset ends."""
        bench.far_ends[self.device].fault(self.code)
        return lambda: None


class FrozenDrive(OfDrive, LastingFault):
    """The drive's processor hangs while its power stage goes on with the last demand: deaf, dumb and energised."""

    fault_name = "frozen_drive"
    example = "{fault: frozen_drive, at_s: 2, device: drive_test}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return one rehearsal: the drive freezes."""
        return (Drill({}, 0.1, "cyclic_age_s", stays_on=True),)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Freeze the drive; return a function that unfreezes it."""
        far_end = bench.far_ends[self.device]
        far_end.freeze(True)
        return lambda: far_end.freeze(False)


class HeartbeatLoss(OfDevice, LastingFault):
    """The drive's heartbeat stays away while it hears, obeys and moves: a transmitter or a task of it that has died."""

    fault_name = "heartbeat_loss"
    example = "{fault: heartbeat_loss, at_s: 2, device: drive_test, answers: true}"

    answers: bool = Field(False, description="true: every other frame of the drive stays away as well")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return two rehearsals: the heartbeat stays away, or all frames that the drive sends."""
        return Drill({}, 0.5, "the drive's heartbeat"), Drill({"answers": True}, 0.1, "cyclic_age_s")

    def misfits_of(self, planned_bench: PlannedBench, far_end: Any, quantities: set[str]) -> dict[str, str]:
        """Return the reason if the device is not on a CAN bus or sends no heartbeat."""
        bus = planned_bench.file.buses.get(planned_bench.devices[self.device].entry.bus or "")
        if not isinstance(bus, CanBus):
            return {"device": f"'{self.device}' is not on a CAN bus"}
        return {} if isinstance(far_end, Living) else {"device": f"'{self.device}' sends no heartbeat"}

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Drop the heartbeats, or with `answers` all frames of the drive; return a function that ends it."""
        drive = bench.far_ends[self.device]

        def delay_of_frame(frame: Frame, source: CanEmulator | None) -> float | None:
            is_dropped = source is drive and (
                self.answers or (isinstance(source, Living) and source.is_sign_of_life(frame))
            )
            return None if is_dropped else 0.0

        return bench.wires[bench.bus_of[self.device]].disturb(delay_of_frame)
