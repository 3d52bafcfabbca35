"""Power of one actuator at every point: electrical and mechanical, and where the difference goes.

Electrical power is V i of the q axis. A run whose drives tell their q-axis voltages has V measured; the paper's have
not, and V = R i + Kb w is that of an actuator at the winding temperature that R is for. Mechanical power is that at the
torque sensor. Kb w i goes to the rotor; what of it does not reach the shaft is lost in friction.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from leactl.analysis.efficiency.operating_points import OTHER_ROLE, OperatingPoints
from leactl.analysis.statistics.regression import Array

SENSE = {"test": 1.0, "load": -1.0}  # of the shaft's torque: the sensor tells what the test actuator puts onto it


@dataclass(frozen=True)
class PowerCalibration:
    """Numbers that turn readings into powers; `replace` one of them to see its effect."""

    resistance: float  # ohm, of the q axis; NaN where not known
    back_emf_constant: float  # V*s/rad; NaN where not known
    by_measured_voltage: bool
    torque_gain: float = 1.0
    current_gain: float = 1.0
    voltage_gain: float = 1.0
    zero: Mapping[int, float] | None = None  # N*m, of the torque sensor, by run


@dataclass(frozen=True, eq=False)
class Balance:
    """Powers of one actuator [W], shape (holds,), electrical and mechanical positive where it drives."""

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
        """Power that goes in and does not come out [W]."""
        return self.electrical - self.mechanical

    @property
    def friction(self) -> Array:
        """Loss that is not in the copper [W]."""
        return self.loss - self.copper

    @property
    def efficiency(self) -> Array:
        """Power out over power in; negative where a driven actuator takes electrical power too."""
        out, taken = (self.mechanical, self.electrical) if self.driving else (self.electrical, self.mechanical)
        with np.errstate(divide="ignore", invalid="ignore"):
            return out / taken


def balance(points: OperatingPoints, role: str, driving: bool, calibration: PowerCalibration) -> Balance:
    """Compute the powers of one role's actuator at points at which it drives, or is driven."""
    speeds = [
        points.value["velocity", speed_role]
        for speed_role in (role, OTHER_ROLE[role])
        if ("velocity", speed_role) in points.value
    ]
    speed = np.where(np.isfinite(speeds[0]), speeds[0], speeds[-1])
    current = calibration.current_gain * points.value["q_axis_current", role]
    zero = np.array([(calibration.zero or {}).get(int(run), 0.0) for run in points.run])
    torque = SENSE[role] * calibration.torque_gain * (points.value["torque", "test"] - zero)
    back_emf = calibration.back_emf_constant * speed
    if calibration.by_measured_voltage:
        voltage = calibration.voltage_gain * points.value["q_axis_voltage", role]
    else:
        voltage = calibration.resistance * current + back_emf
    electrical = voltage * current
    return Balance(speed, current, voltage, torque, electrical, torque * speed, (voltage - back_emf) * current, driving)
