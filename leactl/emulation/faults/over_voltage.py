"""A DC link whose voltage rises."""

from collections.abc import Sequence

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Drill, OfSupply


class OverVoltage(OfSupply):
    """The DC link rises: a drive that brakes feeds a supply which takes nothing back, a supply regulates wrongly."""

    example = "{fault: over_voltage, at_s: 2, for_s: 1.5, bus_voltage_V: 75}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """A voltage a quarter above the limit."""
        return (Drill({"bus_voltage_V": 1.25 * file.limits.bus_voltage_high_V}, 1.1, "limit of bus_voltage_high_V"),)

    def misfit_of(self, usual: float) -> str:
        """Text if the voltage is not above the bench's."""
        return "" if self.bus_voltage_V > usual else "above"
