"""A host whose clock jumps or whose disk is slow."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, Fault, FaultTarget, LastingFault, Positive, Undo


class HostClockJump(Fault):
    """The host's clock jumps while the bench's time goes on: a machine that was suspended, or a clock put back."""

    fault_name = "clock_jump"
    example = "{fault: clock_jump, at_s: 2, jump_s: -1}"
    inactive_when_served = "the clock is that of the run's own process"

    jump_s: Annotated[float, Field(strict=True, ge=-1e6, le=1e6)] = Field(
        description="how far it jumps; negative: back"
    )

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return three rehearsals: jumps of a second forward, a second back, and 0.05 s back."""
        return tuple(Drill({"jump_s": jump}, 0.05, "clock, or a heartbeat's age") for jump in (1.0, -1.0, -0.05))

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Shift the time of the host's clock; nothing has to be undone."""
        bench.host_clock.ahead += self.jump_s
        return lambda: None


class SlowDisk(LastingFault):
    """Every write of the run file waits, by the wall clock: a worn SD card, a network drive, a disk that spins up."""

    fault_name = "slow_disk"
    example = "{fault: slow_disk, at_s: 2, delay_s: 3}"
    inactive_when_served = "the file is that of the run's own process"
    not_drilled = "it does not affect the bench: rows reach the disk later, by the wall clock"

    delay_s: Positive = Field(description="how long a write waits before it begins, in seconds of the wall clock")

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Delay every write of the run file from now on; return a function that ends it."""
        bench.disk_delay_s += self.delay_s

        def end() -> None:
            bench.disk_delay_s -= self.delay_s

        return end
