"""How the heat of a winding is shared among its phases, and when it comes, while its rotor stands, crawls or turns.

A rotor that crawls heats one phase after the other: a short step sees a single one of them, half an electrical turn all
three alike. A span is heat from one moment to a later one, to be looked at as a single step.
"""

import math
from dataclasses import dataclass

from leactl.safety.thermal.bound import lateness

LED_ALIGNED = 0.5  # of heat that two phases take in halves, which leaves (1 + 0.5) / 3 to each


@dataclass(slots=True)
class Span:
    """Heat of one actuator over some time, with its moments about the span's beginning."""

    duration: float = 0.0  # s
    square: float = 0.0  # A^2 s
    cos: float = 0.0  # of it at twice the electrical angle
    sin: float = 0.0
    led: float = 0.0  # A^2 s, of a direct current through two leads
    square_moment: float = 0.0  # A^2 s^2, and so on
    cos_moment: float = 0.0
    sin_moment: float = 0.0
    led_moment: float = 0.0
    speed: float = 0.0  # rad/s, at the most
    unseen: float = 0.0  # s, from one look to the next at the longest

    @property
    def aligned(self) -> float:
        """How far the current stood at one electrical angle."""
        stood = math.hypot(self.cos, self.sin) + LED_ALIGNED * self.led
        return min(1.0, stood / self.square) if self.square > 0.0 else 0.0

    def late(self, decay: float) -> float:
        """How much later than evenly a phase's heat may have come [s]; see `lateness`."""
        if not self.square > 0.0:
            return 0.0
        half = 0.5 * self.duration
        whole = self.square_moment - half * self.square
        turning = math.hypot(self.cos_moment - half * self.cos, self.sin_moment - half * self.sin)
        behind = max(0.0, whole) + turning + LED_ALIGNED * abs(self.led_moment - half * self.led)
        return lateness(behind / (self.square * (1.0 + self.aligned)), self.duration, self.unseen, decay)

    def joined(self, after: "Span") -> "Span":
        """This one and the next."""
        before = self.duration
        return Span(
            before + after.duration,
            self.square + after.square,
            self.cos + after.cos,
            self.sin + after.sin,
            self.led + after.led,
            self.square_moment + after.square_moment + before * after.square,
            self.cos_moment + after.cos_moment + before * after.cos,
            self.sin_moment + after.sin_moment + before * after.sin,
            self.led_moment + after.led_moment + before * after.led,
            max(self.speed, after.speed),
            max(self.unseen, after.unseen),
        )


class Rotor:
    """One actuator's rotor, look by look, and the heat since `span` was taken."""

    __slots__ = ("_angle", "_most_speed", "_poles", "_velocity", "span")

    def __init__(self, pole_pairs: int, most_speed: float) -> None:
        self._poles, self._most_speed = 2.0 * pole_pairs, most_speed
        self._angle = self._velocity = 0.0
        self.span = Span()

    def look(self, angle: float, velocity: float, square: float, since: float, led: float) -> None:
        """Put the heat since the last look, `since` s ago, at the electrical angles that the rotor has passed.

        Turning evenly over 2 x rad leaves |sin x / x| of an alignment. A rotor that stood at either look may have stood
        in between: it has turned evenly no further than the slower look tells.

        Parameters
        ----------
        angle, velocity : as measured [rad, rad/s]; NaN where unknown, which counts as standing and at full speed.
        square : heat since `span` was taken [A^2 s].
        led : what of it has come by a direct current through two leads since the last look [A^2 s].
        """
        span, speed = self.span, abs(velocity)
        when = span.duration + 0.5 * since
        span.duration += since
        if speed != speed:
            speed, velocity = self._most_speed, 0.0
        if speed > span.speed:
            span.speed = speed
        if since > span.unseen:
            span.unseen = since
        before = self._angle
        self._angle = angle = angle if angle == angle else before + velocity * since
        fresh, span.square = square - span.square, square
        span.square_moment += fresh * when
        span.led += led
        span.led_moment += led * when
        fresh -= led
        evenly = min(abs(velocity), self._velocity) * since
        self._velocity = abs(velocity)
        passed = 0.5 * self._poles * min(abs(angle - before), evenly)
        if passed > 1.0:
            fresh /= passed
        turned = self._poles * angle
        cos, sin = fresh * math.cos(turned), fresh * math.sin(turned)
        span.cos += cos
        span.sin += sin
        span.cos_moment += cos * when
        span.sin_moment += sin * when

    def take(self) -> Span:
        """What has been gathered; the next span begins."""
        taken, self.span = self.span, Span()
        return taken
