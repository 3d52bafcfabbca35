"""The mechanics behind drives that need no wire: two rotors on one shaft, held currents and speeds, tick by tick.

What a tick leaves in the windings is noted and heats them afterwards: no reading of this bench depends on it.
"""

import math
from array import array

from tests.monte_carlo.plants import ROLES, Truth

TICK_S = 0.01
PEAK_A = 45.0  # true current of a drive at the most
POSITION_GAIN, SERVO_SPEED = 38.0, 40.0  # 1/s, rad/s
ROUNDING_RAD_S = 1e-9  # below which a rotor stands, or friction would change sides with the last digit
CONSUMER_S = 0.2  # that a drive goes on for without its host


class Stage:
    """The far end of one drive: its mode, its demand, and when it last heard from its host."""

    def __init__(self, factor: float, torque_constant: float) -> None:
        self.factor, self.torque_constant = factor, torque_constant
        self.mode, self.demand = "off", 0.0
        self.fed = -math.inf
        self.starved = self.frozen = False
        self.current = 0.0  # true [A]

    def wanted(self, angle: float) -> float:
        """Velocity that it regulates to [rad/s]."""
        if self.mode == "angle":
            return min(max(POSITION_GAIN * (self.demand - angle), -SERVO_SPEED), SERVO_SPEED)
        return self.demand

    def look(self, now: float) -> None:
        """Stop where the host has been silent for too long."""
        if self.mode != "off" and not self.frozen and now - self.fed > CONSUMER_S - 1e-9:
            self.mode, self.starved = "off", True


class Rotors:
    """Both actuators in one set-up."""

    def __init__(self, truth: Truth, setup: str) -> None:
        self.stages = {r: Stage(truth.factors[r], truth.actuators[r].torque_constant) for r in ROLES}
        self.time, self.velocity, self.angle, self.torque = 0.0, 0.0, truth.angle, 0.0
        self._ticks = 0
        test, load = (truth.actuators[role] for role in ROLES)
        self._inertia, self._coulomb, self._damping = test.rotor_inertia, test.coulomb_friction, test.viscous_damping
        self._own = self._inertia, self._coulomb, self._damping
        self._coupled, self._locked = setup == "coupled", setup == "locked"
        if self._coupled:
            self._inertia += load.rotor_inertia
            self._coulomb += load.coulomb_friction
            self._damping += load.viscous_damping
        self.currents = array("d"), array("d")  # true, of each tick
        self.velocities = array("d")

    def advance(self, to: float) -> None:
        """Go on by whole ticks."""
        for _ in range(int((to - self.time) / TICK_S + 1e-6)):
            self._tick()

    def _tick(self) -> None:
        test, load = self.stages["test"], self.stages["load"]
        now = self.time
        test.look(now)
        load.look(now)
        velocity = self.velocity
        torque, servo = 0.0, None
        for stage in (test, load):
            if stage.mode == "off":
                stage.current = 0.0
            elif stage.mode == "current":
                stage.current = min(max(stage.demand * stage.factor, -PEAK_A), PEAK_A)
                if self._coupled or stage is test:  # else the load's rotor is not on this shaft
                    torque += stage.torque_constant * stage.current
            else:
                servo = stage
        if self._locked:
            if servo is not None:
                servo.current = 0.0
            after = 0.0
        else:
            friction = self._damping * velocity + math.copysign(self._coulomb, velocity or torque)
            if servo is not None:
                after = servo.wanted(self.angle)
                if after == 0.0 and velocity == 0.0:
                    friction = min(max(torque, -self._coulomb), self._coulomb)  # sticking takes what it can
                elif velocity == 0.0:
                    friction = math.copysign(self._coulomb, after)
                wanted = self._inertia * (after - velocity) / TICK_S + friction - torque
                servo.current = min(max(wanted / servo.torque_constant, -PEAK_A), PEAK_A)
                torque += servo.torque_constant * servo.current
            after = velocity + (torque - friction) * TICK_S / self._inertia
            stuck = velocity == 0.0 and abs(torque) <= self._coulomb
            if stuck or (velocity * after < 0.0 and servo is None) or abs(after) < ROUNDING_RAD_S:
                after = 0.0
        self._sense(test, velocity, after)
        self.currents[0].append(test.current)
        self.currents[1].append(load.current)
        self.velocities.append(velocity)
        self.angle += velocity * TICK_S
        self.velocity = after
        self._ticks += 1
        self.time = self._ticks * TICK_S

    def _sense(self, test: Stage, velocity: float, after: float) -> None:
        """What the shaft's sensor feels."""
        given, (inertia, coulomb, damping) = test.torque_constant * test.current, self._own
        if velocity == 0.0 == after:
            self.torque = math.copysign(max(abs(given) - coulomb, 0.0), given)
        else:
            friction = damping * velocity + math.copysign(coulomb, velocity or after)
            self.torque = given - friction - inertia * (after - velocity) / TICK_S
        if not (self._coupled or self._locked):
            self.torque = 0.0
