"""What an emulated power supply feeds: two leads of the motor to be heated, or the DC link of the drives."""

from leactl.emulation.plant.exact.rig import Rig
from leactl.emulation.plant.stepped.rig import SteppedRig


class HeatedLeads:
    """Two leads of the test actuator, whose resistance rises as they warm; open where the set-up is not `heated`."""

    def __init__(self, rig: Rig | SteppedRig) -> None:
        self._rig = rig

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Be fed with no more than this voltage [V] and current [A]; those that come of it."""
        if self._rig.setup != "heated":
            return voltage, 0.0
        resistance = self._rig.lead_resistance
        flowing = min(current, voltage / resistance)
        self._rig.heater_current = flowing
        return flowing * resistance, flowing


class DcLink:
    """The DC link of both drives; a supply takes nothing back, and sags where the drives ask for more than it gives."""

    def __init__(self, rig: Rig | SteppedRig) -> None:
        self._rig = rig

    def feed(self, voltage: float, current: float) -> tuple[float, float]:
        """Be fed with no more than this voltage [V] and current [A]; those that come of it."""
        power = max(0.0, self._rig.bus_power)
        given = min(voltage, voltage * voltage * current / power) if power > 0.0 else voltage
        self._rig.supply(given)
        return given, min(current, power / given) if given > 0.0 else 0.0
