"""A host whose clock jumps."""

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, Fault, FaultTarget, Undo


class HostClockJump(Fault):
    """The host's clock jumps while the bench's time goes on: a machine that was suspended, or a clock put back."""

    example = "{fault: clock_jump, at_s: 2, jump_s: -1}"
    where_served = "the clock is that of the run's own process"

    jump_s: Annotated[float, Field(strict=True, ge=-1e6, le=1e6)] = Field(
        description="how far it jumps; negative: back"
    )

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Jumps of a second forward, a second back, and 0.05 s back."""
        return tuple(Drill({"jump_s": jump}, 0.05, "clock, or a heartbeat's age") for jump in (1.0, -1.0, -0.05))

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Shift the time that the host's clock shows."""
        bench.host_clock.ahead += self.jump_s
        return lambda: None
