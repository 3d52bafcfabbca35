"""Power balance of one actuator at every operating point: electrical, mechanical, copper loss and friction loss.

Electrical power is V i of the q axis. V is measured where the drives report their q-axis voltages; the paper's drives
do not, and there V = R i + Kb w, at the winding temperature that R holds for. Mechanical power is that at the torque
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
    """Constants that powers are computed with; `replace` one of them to see its effect."""

    resistance: float  # ohm, of the q axis; NaN if unknown
    back_emf_constant: float  # V*s/rad; NaN if unknown
    by_measured_voltage: bool
    torque_gain: float = 1.0
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
    electrical: Array
    mechanical: Array
    copper: Array
    driving: bool

    @property
    def loss(self) -> Array:
        """Return the electrical less the mechanical power [W]."""
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
    """Compute the powers of a role's actuator at points at which it drives, or is driven where `driving` is false."""
    speeds = [
        points.value["velocity", speed_role]
        for speed_role in (role, OTHER_ROLE[role])
        if ("velocity", speed_role) in points.value
    ]
    speed = np.where(np.isfinite(speeds[0]), speeds[0], speeds[-1])
    current = calibration.current_gain * points.value["q_axis_current", role]
    zero = np.array([(calibration.zero or {}).get(int(run), 0.0) for run in points.run])
    torque = TORQUE_SIGN[role] * calibration.torque_gain * (points.value["torque", "test"] - zero)
    back_emf = calibration.back_emf_constant * speed
    if calibration.by_measured_voltage:
        voltage = calibration.voltage_gain * points.value["q_axis_voltage", role]
    else:
        voltage = calibration.resistance * current + back_emf
    electrical = voltage * current
    return Balance(speed, current, voltage, torque, electrical, torque * speed, (voltage - back_emf) * current, driving)
