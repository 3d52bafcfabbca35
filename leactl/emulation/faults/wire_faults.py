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
        """Return one rehearsal: the controller goes bus-off."""
        return (Drill({}, 0.05, "the bus itself"),)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Disconnect the host from the bus; return a function that connects it again."""
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
        """Return one rehearsal: the cable is unplugged."""
        return (Drill({}, 0.1, "cyclic_age_s"),)

    def misfits(self, planned_bench: PlannedBench) -> dict[str, str]:
        """Return the reason if `bus` is not the name of a serial line or raw socket."""
        line_names = [name for name, bus in planned_bench.file.buses.items() if isinstance(bus, LineBus)]
        reason = f"no serial line or raw socket of the bench; it has {', '.join(line_names) or 'none'}"
        return {} if self.bus in line_names else {"bus": f"'{self.bus}' is {reason}"}

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Unplug the cable; return a function that plugs it in again."""
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
        """Return one rehearsal: frames to the host arrive later than the allowed age of a reading."""
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
        """Return two rehearsals: all frames are lost, or those to the devices alone."""
        return Drill({}, 0.1, "cyclic_age_s"), Drill({"direction": "to_devices"}, 0.1, "cyclic_age_s")

    @property
    def frame_delay(self) -> float | None:
        """None, because a lost frame never arrives."""
        return None
