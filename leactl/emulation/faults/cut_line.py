"""A serial line or a network whose cable is unplugged."""

from collections.abc import Sequence

from pydantic import Field

from leactl.bench.benchfile import BenchFile, LineBus
from leactl.emulation.faults.contract import Draw, Drill, FaultTarget, LastingFault, PlannedBench, Undo


class CutLine(LastingFault):
    """The cable of a serial line or of a raw socket comes off, or breaks: nothing arrives any more, on either side."""

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
