"""A power supply whose output cannot be switched off."""

from pydantic import Field

from leactl.driver.far_end import FailingSupply
from leactl.emulation.faults.contract import OfPowerSupply


class SupplyStuckOn(OfPowerSupply):
    """The supply's output stays on whatever it is told: a welded relay, a driver stage that has failed."""

    example = "{fault: supply_stuck_on, at_s: 2, device: supply, admits: false}"

    admits: bool = Field(True, description="false: the supply says that its output is off")

    def strike(self, supply: FailingSupply) -> None:
        """Make the output ignore commands to switch off."""
        supply.stuck_on(self.admits)
