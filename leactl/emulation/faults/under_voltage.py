"""A DC link that sags."""

from leactl.emulation.faults.contract import OfSupply


class UnderVoltage(OfSupply):
    """The DC link sags: a supply in current limit, a loose terminal, a fuse that has blown."""

    example = "{fault: under_voltage, at_s: 2, for_s: 1.5, bus_voltage_V: 12}"

    def misfit_of(self, usual: float) -> str:
        """It must be below."""
        return "" if self.bus_voltage_V < usual else "below"
