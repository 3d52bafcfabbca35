"""Power balance of one actuator at every operating point: electrical, mechanical, copper loss and friction loss.

Electrical power is V i of the q axis. V is measured if the drives report their q-axis voltages. The paper's drives do
not; then V = R i + Kb w, at the winding temperature at which R is stated. Mechanical power is that at the torque
sensor. Kb w i is the power on the rotor; the part of it that does not reach the shaft is lost in friction.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leactl.analysis.efficiency.operating_points import OTHER_ROLE, OperatingPoints
from leactl.analysis.statistics.regression import Array

TORQUE_SIGN = {"test": 1.0, "load": -1.0}  # sign of an actuator's torque: the sensor reads that of the test actuator


@dataclass(frozen=True)
class PowerCalibration:
    """Constants from which powers are computed; `replace` one of them to see its effect."""

    resistance: float  # ohm, of the q axis; NaN if unknown
    back_emf_constant: float  # V*s/rad; NaN if unknown
    by_measured_voltage: bool  # else the voltage follows from resistance and back-EMF constant
    torque_gain: float = 1.0  # by which readings of the torque are multiplied
    current_gain: float = 1.0
    voltage_gain: float = 1.0
    zero: Mapping[int, float] | None = None  # N*m, of the torque sensor, by run


@dataclass(frozen=True, eq=False)
class Balance:
    """Powers of one actuator [W], shape (holds,); electrical and mechanical power are positive where it drives."""

    speed: Array  # rad/s
    current: Array  # A
    voltage: Array  # V
    torque: Array  # N*m, of this actuator onto the shaft
    electrical: Array  # W
    mechanical: Array  # W
    copper: Array  # W, loss
    driving: bool

    @property
    def loss(self) -> Array:
        """Return the electrical minus the mechanical power [W]."""
        return self.electrical - self.mechanical

    @property
    def friction(self) -> Array:
        """Return the loss without the copper loss [W]."""
        return self.loss - self.copper

    @property
    def efficiency(self) -> Array:
        """Return output over input power; negative where a driven actuator takes electrical power too."""
        output, supplied = (self.mechanical, self.electrical) if self.driving else (self.electrical, self.mechanical)
        with np.errstate(divide="ignore", invalid="ignore"):
            return output / supplied


def balance(points: OperatingPoints, role: str, driving: bool, calibration: PowerCalibration) -> Balance:
    """Return the powers of a role's actuator at points at which it drives, or is driven if `driving` is false."""
    speeds = [
        points.value["velocity", speed_role]
        for speed_role in (role, OTHER_ROLE[role])
        if ("velocity", speed_role) in points.value
    ]
    speed = np.where(np.isfinite(speeds[0]), speeds[0], speeds[-1])
    current = calibration.current_gain * points.value["q_axis_current", role]
    torque_zero = np.array([(calibration.zero or {}).get(int(run), 0.0) for run in points.run])
    torque = TORQUE_SIGN[role] * calibration.torque_gain * (points.value["torque", "test"] - torque_zero)
    back_emf = calibration.back_emf_constant * speed
    if calibration.by_measured_voltage:
        voltage = calibration.voltage_gain * points.value["q_axis_voltage", role]
    else:
        voltage = calibration.resistance * current + back_emf
    electrical = voltage * current
    return Balance(speed, current, voltage, torque, electrical, torque * speed, (voltage - back_emf) * current, driving)
