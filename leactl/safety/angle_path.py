"""Base angle and time from which a drive in angle mode may turn to its next setpoint."""

import math


class AnglePath:
    """Angle [rad] and time [s] of the last setpoint that a drive follows, or of the shaft while it follows none."""

    def __init__(self, measured: float, now: float) -> None:
        self.sent, self.sent_at = measured, now  # of the last exchange
        self._pending: tuple[float, float] | None = None  # setpoint and time for the next exchange
        self._was_engaged = False

    def ask(self, value: float, now: float) -> None:
        """Take a setpoint for the next exchange; the last one before the exchange counts."""
        self._pending = value, now

    def update(self, measured: float, engaged: bool, now: float) -> None:
        """Update after an exchange; until the drive follows its setpoint, the base is the measured angle."""
        if not engaged or math.isnan(self.sent):
            self.sent, self.sent_at = (self.sent if math.isnan(measured) else measured), now
        elif self._was_engaged and self._pending is not None:
            self.sent, self.sent_at = self._pending
        else:
            self.sent_at = now
        self._was_engaged, self._pending = engaged, None
