"""Where a drive's voltage stands at its ceiling: no loop follows a reference there."""

import numpy as np
import numpy.typing as npt

from leactl.gap.signals.record import Clocked
from leactl.model.nominal import Model
from leactl.model.winding import voltage_ceiling

Array = npt.NDArray[np.float64]
CEILING_SHARE = 0.96  # share of the largest q-axis voltage from which a drive may not hold its current


def at_ceiling(clock: Clocked, model: Model) -> npt.NDArray[np.bool_]:
    """Samples at which the voltage, measured or else what the reference asks for, is at the ceiling or beyond."""
    bus, volts = model.bench.bus_voltage, clock.get("q_axis_voltage")
    if volts is None:
        volts = demanded_voltage(clock, model)
    if bus is None or volts is None:
        return np.zeros(len(clock.time), np.bool_)
    logged = clock.get("bus_voltage", "bench")
    there = bus if logged is None else np.fmin(logged, bus)  # a supply that gives way lowers the ceiling
    return np.asarray(np.abs(volts) > CEILING_SHARE * voltage_ceiling(1.0, model.winding) * there, np.bool_)


def demanded_voltage(clock: Clocked, model: Model) -> Array | None:
    """Voltage [V] that the winding takes at the reference current and the measured speed."""
    reference, velocity = clock.get("q_axis_current_reference"), clock.get("velocity")
    constant = model.back_emf_constant or model.torque_constant
    if reference is None or velocity is None or constant is None or model.phase_resistance is None:
        return None
    return model.phase_resistance * reference + constant * velocity
