"""A drive that enters its fault state and reports the fault."""

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Draw, Drill, FaultTarget, OfDrive, Undo


def _hexadecimal(value: Any) -> Any:
    if isinstance(value, str) and value.lower().startswith("0x"):
        try:
            return int(value, 16)
        except ValueError:
            return value
    return value


ErrorCode = Annotated[int, BeforeValidator(_hexadecimal), Field(ge=0x1000, le=0xFFFF)]


class DriveFault(OfDrive):
    """The drive takes its power away, enters its fault state and tells why; it stays there until it is reset."""

    example = "{fault: drive_fault, at_s: 2, device: drive_test, code: 0x2340}"

    code: ErrorCode = Field(description="error code (CiA 301), as 0x2340 for a short circuit")

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """A short circuit."""
        return (Drill({"code": 0x2340}, 0.05, "the drive's emergency message"),)

    def begin(self, bench: FaultTarget, draw: Draw) -> Undo:
        """Put the drive into its fault state."""
        bench.far_ends[self.device].fault(self.code)
        return lambda: None
