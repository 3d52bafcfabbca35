"""A CAN controller that is bus-off."""

from collections.abc import Sequence

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, FaultTarget, OfBus, Undo


class BusOff(OfBus):
    """The host's controller has gone bus-off after too many errors: nothing comes in and sending is refused."""

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
