"""A drive whose firmware hangs."""

from typing import TYPE_CHECKING

from leactl.emulation.faults.contract import Draw, LastingFault, OfDrive, Undo

if TYPE_CHECKING:
    from leactl.emulation.emulated_bench import EmulatedBench


class FrozenDrive(OfDrive, LastingFault):
    """The drive's processor hangs while its power stage goes on with the last demand: deaf, dumb and energised."""

    example = "{fault: frozen_drive, at_s: 2, device: drive_test}"

    def begin(self, bench: "EmulatedBench", draw: Draw) -> Undo:
        """Freeze it."""
        far_end = bench.far_ends[self.device]
        far_end.freeze(True)
        return lambda: far_end.freeze(False)
