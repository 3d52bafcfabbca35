"""A DC link whose voltage drops."""

from collections.abc import Sequence

from leactl.bench.benchfile import BenchFile
from leactl.emulation.faults.contract import Drill, OfSupply


class UnderVoltage(OfSupply):
    """The DC link sags: a supply in current limit, a loose terminal, a fuse that has blown."""

    example = "{fault: under_voltage, at_s: 2, for_s: 1.5, bus_voltage_V: 12}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """A voltage a quarter below the limit."""
        return (Drill({"bus_voltage_V": 0.75 * file.limits.bus_voltage_low_V}, 1.1, "limit of bus_voltage_low_V"),)

    def misfit_of(self, usual: float) -> str:
        """Text if the voltage is not below the bench's."""
        return "" if self.bus_voltage_V < usual else "below"
