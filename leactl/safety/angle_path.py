"""Base angle and time from which a drive in angle mode may turn to its next setpoint."""

import math


class AnglePath:
    """Angle [rad] and time [s] of the setpoint that a drive follows, or of the shaft while the drive follows none."""

    def __init__(self, measured_angle: float, now: float) -> None:
        self.base_angle, self.base_time = measured_angle, now  # of the last exchange
        self._pending: tuple[float, float] | None = None  # setpoint and time for the next exchange
        self._was_engaged = False

    def ask(self, setpoint: float, now: float) -> None:
        """Take a setpoint [rad] for the next exchange; the last setpoint before the exchange counts."""
        self._pending = setpoint, now

    def update(self, measured_angle: float, engaged: bool, now: float) -> None:
        """Update after an exchange; until the drive follows its setpoint, the base is the measured angle."""
        if not engaged or math.isnan(self.base_angle):
            self.base_angle, self.base_time = (self.base_angle if math.isnan(measured_angle) else measured_angle), now
        elif self._was_engaged and self._pending is not None:
            self.base_angle, self.base_time = self._pending
        else:
            self.base_time = now
        self._was_engaged, self._pending = engaged, None
