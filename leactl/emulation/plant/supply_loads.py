"""Loads at an emulated power supply: two leads of the motor, which are heated, or the DC link of the drives."""

from leactl.emulation.plant.exact.rig import Rig
from leactl.emulation.plant.stepped.rig import SteppedRig


class HeatedLeads:
    """Two leads of the test actuator, whose resistance rises as they warm; open unless the set-up is `heated`."""

    def __init__(self, rig: Rig | SteppedRig) -> None:
        self._rig = rig

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Apply limits of voltage [V] and current [A]; return the voltage and current that result."""
        if self._rig.setup != "heated":
            return voltage, 0.0
        resistance = self._rig.lead_resistance
        lead_current = min(current, voltage / resistance)
        self._rig.heater_current = lead_current
        return lead_current * resistance, lead_current


class DcLink:
    """DC link of both drives; a supply takes no power back, and sags if the drives need more than it gives."""

    def __init__(self, rig: Rig | SteppedRig) -> None:
        self._rig = rig

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Apply limits of voltage [V] and current [A]; return the voltage and current that result."""
        power = max(0.0, self._rig.bus_power)
        link_voltage = min(voltage, voltage * voltage * current / power) if power > 0.0 else voltage
        self._rig.supply(link_voltage)
        return link_voltage, min(current, power / link_voltage) if link_voltage > 0.0 else 0.0
