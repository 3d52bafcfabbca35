"""A disk that is slow to write."""

from pydantic import Field

from leactl.emulation.faults.contract import Draw, FaultTarget, LastingFault, Positive, Undo


class SlowDisk(LastingFault):
    """Every write of the run file waits, by the wall clock: a worn SD card, a network drive, a disk that spins up."""

    example = "{fault: slow_disk, at_s: 2, delay_s: 3}"
    where_served = "the file is that of the run's own process"
    not_drilled = "it does not affect the bench: rows reach the disk later, by the wall clock"

    delay_s: Positive = Field(description="how long a write waits before it begins, in seconds of the wall clock")

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Delay every write of the run file from now on."""
        bench.disk_delay_s += self.delay_s

        def end() -> None:
            bench.disk_delay_s -= self.delay_s

        return end
