"""A DC link that rises."""

from leactl.emulation.faults.contract import OfSupply


class OverVoltage(OfSupply):
    """The DC link rises: a drive that brakes feeds a supply which takes nothing back, a supply regulates wrongly."""

    example = "{fault: over_voltage, at_s: 2, for_s: 1.5, bus_voltage_V: 75}"

    def misfit_of(self, usual: float) -> str:
        """It must be above."""
        return "" if self.bus_voltage_V > usual else "above"
