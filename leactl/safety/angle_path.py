"""How far a setpoint of angle mode may be from the one before: what the shaft may turn meanwhile."""

import math


class AnglePath:
    """Where the setpoints of angle mode have led so far, so that none is further away than the shaft may turn."""

    def __init__(self, measured: float, now: float) -> None:
        self.sent, self.sent_at = measured, now  # of the last exchange
        self._asked: tuple[float, float] | None = None  # since then
        self._held = False

    def ask(self, value: float, now: float) -> None:
        """A setpoint for the exchange to come; the last one before it counts."""
        self._asked = value, now

    def exchanged(self, measured: float, engaged: bool, now: float) -> None:
        """An exchange has ended: until the drive follows its setpoint, that is wherever the shaft is."""
        if not engaged or math.isnan(self.sent):
            self.sent, self.sent_at = (self.sent if math.isnan(measured) else measured), now
        elif self._held and self._asked is not None:
            self.sent, self.sent_at = self._asked
        else:
            self.sent_at = now
        self._held, self._asked = engaged, None
