"""Buses and cables that fail, and frames that come late or not at all."""

from collections.abc import Sequence

from pydantic import Field

from leactl.bench.benchfile import BenchFile, LineBus
from leactl.emulation.faults.contract import (
    Draw,
    Drill,
    FaultTarget,
    LastingFault,
    OfBus,
    OfFrames,
    PlannedBench,
    Positive,
    Undo,
)


class BusOff(OfBus):
    """The host's controller has gone bus-off after too many errors: nothing comes in and sending is refused."""

    fault_name = "bus_off"
    example = "{fault: bus_off, at_s: 2, bus: can0}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """The controller goes bus-off."""
        return (Drill({}, 0.05, "the bus itself"),)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Disconnect the host from the bus."""
        wire = bench.wires[self.bus]
        wire.off = True

        def end() -> None:
            wire.off = False

        return end


class CutLine(LastingFault):
    """The cable of a serial line or of a raw socket comes off, or breaks: nothing arrives any more, on either side."""

    fault_name = "cut_line"
    example = "{fault: cut_line, at_s: 2, bus: line_test}"

    bus: str = Field(description="name of the serial line or raw socket")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """The cable is unplugged."""
        return (Drill({}, 0.1, "cyclic_age_s"),)

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Reason if `bus` is not the name of a serial line or raw socket."""
        lines = [name for name, bus in planned_bench.file.buses.items() if isinstance(bus, LineBus)]
        reason = f"no serial line or raw socket of the bench; it has {', '.join(lines) or 'none'}"
        return {} if self.bus in lines else {"bus": f"'{self.bus}' is {reason}"}

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Unplug the cable."""
        wire = bench.serial_wires[self.bus]
        wire.cut = True

        def end() -> None:
            wire.cut = False

        return end


class LateFrames(OfFrames):
    """Frames are held up on their way: an adapter on a busy USB hub, a gateway, a host that reads its socket late."""

    fault_name = "late_frames"
    example = "{fault: late_frames, at_s: 2, for_s: 1, bus: can0, delay_s: 0.1, direction: to_host}"

    delay_s: Positive = Field(description="how much later a frame arrives")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Frames to the host that arrive later than a reading may be old."""
        return (Drill({"delay_s": 0.2, "direction": "to_host"}, 0.1, "cyclic_age_s"),)

    @property
    def frame_delay(self) -> float | None:
        """Delay of a frame [s]."""
        return self.delay_s


class LostFrames(OfFrames):
    """Frames are lost: a bad termination, a full receive buffer, or, where it is all of them, a cable that is off."""

    fault_name = "lost_frames"
    example = "{fault: lost_frames, at_s: 2, for_s: 1, bus: can0, share: 0.5}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """All frames, and those to the devices alone."""
        return Drill({}, 0.1, "cyclic_age_s"), Drill({"direction": "to_devices"}, 0.1, "cyclic_age_s")

    @property
    def frame_delay(self) -> float | None:
        """None: a lost frame never arrives."""
        return None
