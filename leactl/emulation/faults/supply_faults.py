"""DC links and power supplies that leave their voltage, or cannot be switched off."""

from collections.abc import Sequence

from pydantic import Field

from leactl.bench.benchfile import BenchFile
from leactl.driver.far_end import FailingSupply
from leactl.emulation.faults.contract import Drill, OfPowerSupply, OfSupply, Share


class OverVoltage(OfSupply):
    """The DC link rises: a drive that brakes feeds a supply which takes nothing back, a supply regulates wrongly."""

    fault_name = "over_voltage"
    example = "{fault: over_voltage, at_s: 2, for_s: 1.5, bus_voltage_V: 75}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return one rehearsal: a voltage a quarter above the limit."""
        return (Drill({"bus_voltage_V": 1.25 * file.limits.bus_voltage_high_V}, 1.1, "limit of bus_voltage_high_V"),)

    def misfit_of(self, nominal_voltage: float) -> str:
        """Return the word `above` if the voltage is not above the bench's nominal one [V]; else an empty text."""
        return "" if self.bus_voltage_V > nominal_voltage else "above"


class UnderVoltage(OfSupply):
    """The DC link sags: a supply in current limit, a loose terminal, a fuse that has blown."""

    fault_name = "under_voltage"
    example = "{fault: under_voltage, at_s: 2, for_s: 1.5, bus_voltage_V: 12}"

    @classmethod
    def drills(cls, file: BenchFile) -> Sequence[Drill]:
        """Return one rehearsal: a voltage a quarter below the limit."""
        return (Drill({"bus_voltage_V": 0.75 * file.limits.bus_voltage_low_V}, 1.1, "limit of bus_voltage_low_V"),)

    def misfit_of(self, nominal_voltage: float) -> str:
        """Return the word `below` if the voltage is not below the bench's nominal one [V]; else an empty text."""
        return "" if self.bus_voltage_V < nominal_voltage else "below"


class SupplyOutOfRegulation(OfPowerSupply):
    """The supply gives a share of what it is set to and says that it does not regulate: an overload, a lost phase."""

    fault_name = "supply_out_of_regulation"
    example = "{fault: supply_out_of_regulation, at_s: 2, for_s: 1, device: supply, share: 0.5}"

    share: Share = Field(description="share of the voltage and current that it still gives")

    def strike(self, supply: FailingSupply) -> None:
        """Make the output lose regulation."""
        supply.lose_regulation(self.share)


class SupplyStuckOn(OfPowerSupply):
    """The supply's output stays on whatever it is told: a welded relay, a driver stage that has failed."""

    fault_name = "supply_stuck_on"
    example = "{fault: supply_stuck_on, at_s: 2, device: supply, admits: false}"

    admits: bool = Field(True, description="false: the supply says that its output is off")

    def strike(self, supply: FailingSupply) -> None:
        """Make the output ignore commands to switch off."""
        supply.stuck_on(self.admits)
