"""Find the samples at which a drive's voltage is at its ceiling, where no current loop follows its reference."""

import numpy as np
import numpy.typing as npt

from leactl.gap.signals.record import Clocked
from leactl.model.nominal import Model
from leactl.model.winding import voltage_ceiling

Array = npt.NDArray[np.float64]
CEILING_SHARE = 0.96  # share of the largest q-axis voltage from which a drive may not hold its current


def at_ceiling(clock: Clocked, model: Model) -> npt.NDArray[np.bool_]:
    """Return the samples at which the voltage, measured or else demanded by the reference, is at or above the ceiling.

    No sample is returned if the voltage or the model's bus voltage is not known.
    """
    bus_voltage, voltage = model.bench.bus_voltage, clock.get("q_axis_voltage")
    if voltage is None:
        voltage = demanded_voltage(clock, model)
    if bus_voltage is None or voltage is None:
        return np.zeros(len(clock.time), np.bool_)
    logged_bus_voltage = clock.get("bus_voltage", "bench")
    # a supply whose voltage sags lowers the ceiling
    supply_voltage = bus_voltage if logged_bus_voltage is None else np.fmin(logged_bus_voltage, bus_voltage)
    return np.asarray(np.abs(voltage) > CEILING_SHARE * voltage_ceiling(1.0, model.winding) * supply_voltage, np.bool_)


def demanded_voltage(clock: Clocked, model: Model) -> Array | None:
    """Return the voltage [V] of the winding at the reference current and the measured speed; None if not known."""
    reference, velocity = clock.get("q_axis_current_reference"), clock.get("velocity")
    constant = model.back_emf_constant or model.torque_constant
    if reference is None or velocity is None or constant is None or model.phase_resistance is None:
        return None
    return model.phase_resistance * reference + constant * velocity
