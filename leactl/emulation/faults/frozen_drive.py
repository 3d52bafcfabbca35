"""A drive whose firmware hangs."""

from collections.abc import Sequence

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, FaultTarget, LastingFault, OfDrive, Undo


class FrozenDrive(OfDrive, LastingFault):
    """The drive's processor hangs while its power stage goes on with the last demand: deaf, dumb and energised."""

    example = "{fault: frozen_drive, at_s: 2, device: drive_test}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Each drive."""
        return (Drill({}, 0.1, "cyclic_age_s", stays_on=True),)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Freeze the drive."""
        far_end = bench.far_ends[self.device]
        far_end.freeze(True)
        return lambda: far_end.freeze(False)
