"""Bus sag: the bus voltage U falls by r v i / U, with the source's resistance r [ohm] and the power v i [W]."""

from collections.abc import Mapping

from leactl.effects.contract import Effect, Form, Signals, Terms
from leactl.effects.plant import Plant
from leactl.model.nominal import Model


class BusSag(Effect):
    """Bus voltage that falls under load."""

    name = "bus_sag"
    one_sided = True

    def terms(self, signals: Signals, form: Form) -> Terms:
        """Return the bus current of the test drive, negative: it lowers the voltage."""
        if signals.bus_voltage is None or signals.voltage is None or signals.current is None:
            return {}
        return {"bus_voltage": {"resistance": -signals.voltage * signals.current / signals.bus_voltage}}

    def parameters(self, form: Form, coefficients: Mapping[str, float], model: Model) -> dict[str, float]:
        """Return the resistance of the source [ohm]."""
        return {"resistance": coefficients["resistance"]}

    def act(self, parameters: Mapping[str, float], plant: Plant) -> None:
        """Add a resistance of the source."""
        plant.bus_resistance += parameters["resistance"]
