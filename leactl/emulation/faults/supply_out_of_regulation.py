"""A power supply whose output is below its setting."""

from pydantic import Field

from leactl.driver.far_end import FailingSupply
from leactl.emulation.faults.contract import OfPowerSupply, Share


class SupplyOutOfRegulation(OfPowerSupply):
    """The supply gives a share of what it is set to and says that it does not regulate: an overload, a lost phase."""

    example = "{fault: supply_out_of_regulation, at_s: 2, for_s: 1, device: supply, share: 0.5}"

    share: Share = Field(description="share of the voltage and current that it still gives")

    def strike(self, supply: FailingSupply) -> None:
        """Make the output lose regulation."""
        supply.lose_regulation(self.share)
