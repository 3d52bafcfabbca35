"""Random protocols, as text of the product's own language: holds, ramps, sweeps, signals, pulses, motion and pauses."""

import numpy as np

from leactl.protocol.plan import Plan
from tests.protocol.writing import read

RATES_HZ = (20, 25, 50, 100)  # whole numbers of the plant's ticks in a cycle
SHORTEST_S, LONGEST_S = 20.0, 600.0
SETUPS = (*["coupled"] * 6, *["locked"] * 3, "free")  # a free rotor takes no current that could hurt
MOST_CURRENT_A = 29.9  # of a bench limit of 30 A, below which the noise of a reading has to stay
CURRENTS_A = ((1.0, 8.0), (8.0, 14.0), (14.0, MOST_CURRENT_A), (14.0, MOST_CURRENT_A))  # of the largest, by chance
FRICTION_NM, DAMPING_NM_S = 2 * 0.208 * 1.1, 2 * 0.0238 * 1.1  # of both actuators at the most
TORQUE_CONSTANT = 0.49
SPARE_A = 1.5  # of the drive that holds a speed, for accelerations and misread currents


class Protocol:
    """One protocol in the making: a set-up, its largest current and speed, and steps until its time is up."""

    def __init__(self, draw: np.random.Generator, longest_s: float) -> None:
        self._draw = draw
        self.setup = str(draw.choice(SETUPS))
        self.rate = int(draw.choice(RATES_HZ))
        self.duration = float(np.exp(draw.uniform(np.log(SHORTEST_S), np.log(longest_s))))
        self.speed = float(draw.choice([0.0, draw.uniform(0.02, 0.5), draw.uniform(0.5, 8.0), draw.uniform(8.0, 35.0)]))
        within = CURRENTS_A[draw.integers(len(CURRENTS_A))]
        self.current = min(float(draw.uniform(*within)), self._most_current())
        self.held = "angle" if self.setup == "coupled" and draw.random() < 0.2 else "velocity"
        self.steps: list[str] = []

    def _most_current(self) -> float:
        if self.setup != "coupled":
            return MOST_CURRENT_A
        friction = (FRICTION_NM + DAMPING_NM_S * self.speed) / TORQUE_CONSTANT
        return 0.96 * MOST_CURRENT_A - friction - SPARE_A

    def text(self, share: float = 1.0) -> str:
        """The protocol with this share of its current."""
        self.current *= share
        self.steps = []
        modes = {
            "coupled": f"test: current, load: {self.held}",
            "locked": "test: current",
            "free": "test: velocity",
        }[self.setup]
        self.steps.append(f"mode: {{{modes}}}")
        left = self.duration
        while left > 0.5:
            left -= self._step(min(left, float(np.exp(self._draw.uniform(np.log(0.5), np.log(90.0))))))
        if self.setup != "free":
            self.steps.append("set: {role: test, current_A: 0}")
        self.steps.append('mode: {test: "off", load: "off"}')
        head = ["name: trial", f"setup: {self.setup}", f"rate_Hz: {self.rate}", "steps:"]
        return "\n".join([*head, *(f"  - {step}" for step in self.steps)]) + "\n"

    def plan(self) -> Plan:
        """The plan of its text."""
        return read(self.text())

    def _step(self, seconds: float) -> float:
        if self.setup == "free" or (self.setup == "coupled" and self.held == "velocity" and self._draw.random() < 0.2):
            return self._motion(seconds)
        kinds = [self._hold, self._hold, self._ramp, self._sweep, self._wave, self._pulses, self._pause]
        return kinds[self._draw.integers(len(kinds))](seconds)

    def _level(self) -> float:
        share = self._draw.choice([1.0, self._draw.uniform(0.0, 1.0)])
        return round(float(self._draw.choice([-1.0, 1.0]) * share * self.current), 3)

    def _hold(self, seconds: float) -> float:
        self.steps.append(f"hold: {{role: test, current_A: {self._level()}, duration_s: {seconds:.2f}}}")
        return seconds

    def _pause(self, seconds: float) -> float:
        self.steps.append(f"hold: {{role: test, current_A: 0, duration_s: {seconds:.2f}}}")
        return seconds

    def _ramp(self, seconds: float) -> float:
        self.steps.append(f"ramp: {{role: test, to_current_A: {self._level()}, duration_s: {seconds:.2f}}}")
        return seconds

    def _sweep(self, seconds: float) -> float:
        levels = [self._level() for _ in range(self._draw.integers(2, 7))]
        each = max(seconds / len(levels), 0.1)
        self.steps.append(f"sweep: {{role: test, levels_A: {levels}, hold_s: {each:.2f}}}")
        return each * len(levels)

    def _wave(self, seconds: float) -> float:
        amplitude = abs(self._level())
        offset = round(float(self._draw.uniform(-1.0, 1.0)) * (self.current - amplitude), 3)
        fastest = self.rate / 5
        at = f"amplitude_A: {amplitude}, offset_A: {offset}, duration_s: {seconds:.2f}"
        if self._draw.random() < 0.5:
            frequency = float(np.exp(self._draw.uniform(np.log(0.02), np.log(fastest))))
            self.steps.append(f"signal: {{role: test, kind: sine, frequency_Hz: {frequency:.4f}, {at}}}")
        else:
            self.steps.append(f"signal: {{role: test, kind: chirp, from_Hz: 0.05, to_Hz: {fastest:g}, {at}}}")
        return seconds

    def _pulses(self, seconds: float) -> float:
        on, off = (float(np.exp(self._draw.uniform(np.log(0.1), np.log(6.0)))) for _ in range(2))
        times = max(1, int(seconds / (on + off)))
        inner = [
            f"{{hold: {{role: test, current_A: {self._level()}, duration_s: {on:.2f}}}}}",
            f"{{hold: {{role: test, current_A: 0, duration_s: {off:.2f}}}}}",
        ]
        self.steps.append(f"repeat: {{times: {times}, steps: [{', '.join(inner)}]}}")
        return times * (on + off)

    def _motion(self, seconds: float) -> float:
        role = "test" if self.setup == "free" else "load"
        speed = round(float(self._draw.choice([-1.0, 1.0, 0.0, 0.5])) * self.speed, 3)
        if self._draw.random() < 0.25 and self.speed > 0.0:
            frequency = min(1.0, 3.0 / self.speed) * float(self._draw.uniform(0.1, 1.0))
            self.steps.append(
                f"signal: {{role: {role}, kind: sine, amplitude_rad_s: {abs(speed):g}, frequency_Hz: {frequency:.4f},"
                f" duration_s: {seconds:.2f}}}"
            )
            return seconds
        self.steps.append(f"ramp: {{role: {role}, to_velocity_rad_s: {speed}, rate_rad_s2: 30}}")
        self.steps.append(f"hold: {{role: {role}, duration_s: {seconds:.2f}}}")
        return seconds
