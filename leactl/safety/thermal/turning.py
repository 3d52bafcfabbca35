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
    """Heat of one actuator over some time."""

    square: float = 0.0  # A^2 s
    cos: float = 0.0  # of it at twice the electrical angle
    sin: float = 0.0
    speed: float = 0.0  # rad/s, at the most
    most: float = 0.0  # A^2, the largest mean square current from one look to the next
    unseen: float = 0.0  # s, from one look to the next at the longest
    led: float = 0.0  # A^2 s, of it by direct current through two leads

    @property
    def aligned(self) -> float:
        """How far the current stood at one electrical angle."""
        stood = math.hypot(self.cos, self.sin) + LED_ALIGNED * self.led
        return min(1.0, stood / self.square) if self.square > 0.0 else 0.0

    def late(self, duration: float) -> float:
        """How much later than evenly a phase's heat may have come [s], of the seconds that the span lasted."""
        even = self.square / (duration * self.most) if self.most > 0.0 else 1.0
        kept = self.led >= self.square  # two leads give either phase its half throughout: it is as even as the current
        return lateness(duration, even, 1.0 if kept else self.aligned, self.unseen)

    def joined(self, after: "Span") -> "Span":
        """This one and the next."""
        return Span(
            self.square + after.square,
            self.cos + after.cos,
            self.sin + after.sin,
            max(self.speed, after.speed),
            max(self.most, after.most),
            max(self.unseen, after.unseen),
            self.led + after.led,
        )


class Rotor:
    """One actuator's rotor, look by look, and the heat since `span` was taken."""

    __slots__ = ("_angle", "_most_speed", "_poles", "_velocity", "span")

    def __init__(self, pole_pairs: int, most_speed: float) -> None:
        self._poles, self._most_speed = 2.0 * pole_pairs, most_speed
        self._angle = self._velocity = 0.0
        self.span = Span()

    def look(self, angle: float, velocity: float, square: float, since: float, led: float = 0.0) -> None:
        """Put the heat since the last look, `since` s ago, at the electrical angles that the rotor has passed.

        Turning evenly over 2 x rad leaves |sin x / x| of an alignment. A rotor that stood at either look may have stood
        in between: it has turned evenly no further than the slower look tells.

        Parameters
        ----------
        angle, velocity : as measured [rad, rad/s]; NaN where unknown, which counts as standing and at full speed.
        square : heat since `span` was taken [A^2 s].
        led : of the heat since the last look, what came through two leads, wherever the rotor stands [A^2 s].
        """
        span, speed = self.span, abs(velocity)
        if speed != speed:
            speed, velocity = self._most_speed, 0.0
        if speed > span.speed:
            span.speed = speed
        if since > span.unseen:
            span.unseen = since
        before = self._angle
        self._angle = angle = angle if angle == angle else before + velocity * since
        fresh, span.square = square - span.square, square
        if fresh > span.most * since:
            span.most = fresh / since
        fresh -= led
        span.led += led
        evenly = min(abs(velocity), self._velocity) * since
        self._velocity = abs(velocity)
        passed = 0.5 * self._poles * min(abs(angle - before), evenly)
        if passed > 1.0:
            fresh /= passed
        turned = self._poles * angle
        span.cos += fresh * math.cos(turned)
        span.sin += fresh * math.sin(turned)

    def take(self) -> Span:
        """What has been gathered; the next span begins."""
        taken, self.span = self.span, Span()
        return taken
