"""A leg with a weight that hangs on a spring or on the motor itself, stepped on its own; a controller moves it.

Nothing of leactl simulates here. A proportional and derivative controller follows waves, steps or a slow sine, and
carries the weight; current, angle and velocity are logged.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leactl.gap.diagnose import Case
from leactl.gap.signals.record import build_record
from leactl.model.nominal import Model
from leactl.runfile.read.reader import Channel

RATE = 1000.0  # Hz
PARTS = 10  # steps in a sample
SECONDS = 12.0
GRAVITY = 9.80665  # m/s^2
LOOP, FILTER = 200.0, 120.0  # Hz, of the current loop and of the velocity reading
BANDWIDTH, DAMPING_RATIO = 1.5, 0.7  # Hz and 1, of the controller
STOP, STOP_DAMPING = 2e3, 10.0  # N*m/rad and N*m*s/rad, of a stop
COUNT = 2.0 * math.pi / 65536  # rad
KINDS = ("multisine", "steps", "ramp")


@dataclass(frozen=True)
class Leg:
    """A motor, and a point mass that it carries."""

    constant: float  # N*m/A
    rotor: float  # kg*m^2
    mass: float  # kg
    length: float  # m
    damping: float = 0.08  # N*m*s/rad
    friction: float = 0.25  # N*m
    swing: float = 0.0  # Hz, of the mass on its spring while the motor stands; 0 where it is rigid
    swing_damping: float = 0.05  # of critical
    play: float = 0.0  # rad, width over which the spring does not act; its flanks push and do not pull
    heavier: float = 1.0  # torque of the weight over that of its mass and length, by which the inertia goes
    zero: float = 0.0  # rad, angle at which the mass would read zero if it hung straight down there
    stop: float = math.inf  # rad, angle at which the motor meets a hard stop on either side

    @property
    def load(self):
        """Inertia of the mass [kg*m^2]."""
        return self.mass * self.length**2

    @property
    def level(self):
        """Torque of the mass while it is level [N*m]."""
        return self.heavier * self.mass * GRAVITY * self.length

    @property
    def share(self):
        """Share of the whole inertia that the spring carries."""
        return self.load / (self.load + self.rotor)

    def model(self, off=(0.0, 0.0, 0.0, 0.0)):
        """Its model file, off by shares of the constant, the rotor, the damping and the friction; it is rigid."""
        return Model(
            name="leg",
            torque_constant=self.constant * (1.0 + off[0]),
            back_emf_constant=self.constant * (1.0 + off[0]),
            rotor_inertia=self.rotor * (1.0 + off[1]),
            viscous_damping=self.damping * (1.0 + off[2]),
            coulomb_friction=self.friction * (1.0 + off[3]),
            bench={"current_loop_bandwidth": LOOP, "velocity_filter_bandwidth": FILTER},
            load={"type": "pendulum", "mass": self.mass, "length": self.length},
        )


def drawn_leg(random, swing=0.0):
    low, high = (0.75, 0.02, 1.1, 0.24), (1.05, 0.04, 2.0, 0.33)
    return Leg(*random.uniform(low, high).tolist(), swing=swing)


def case(leg, random):
    """Six runs of the leg, one of each kind held out, and its model file, which is off by what is usual."""
    runs = [recorded(leg, kind, again, random) for again in "ab" for kind in KINDS]
    return Case(leg.model((0.015, 0.1, 0.2, 0.2) * random.uniform(-1.0, 1.0, 4)), runs[:3], runs[3:])


def recorded(leg, kind, again, random):
    """One run as a file has it."""
    current, angle, velocity, asked = moved(leg, reference(kind, random))
    count = len(current)
    noise = 2e-3 * random.standard_normal((2, count))
    values = {
        ("q_axis_current", "A", "mean"): current + noise[0],
        ("q_axis_current_reference", "A", "instant"): asked,
        ("velocity", "rad/s", "instant"): velocity + noise[1],
        ("angle", "rad", "instant"): np.round(angle / COUNT) * COUNT,
    }
    stamps = (np.arange(count) + 1) / RATE
    channels = [
        Channel(stamps, column, quantity, "test", units, "drive", "", "", sampling, "loop")
        for (quantity, units, sampling), column in values.items()
    ]
    return build_record(Path(f"{kind}-{again}.h5"), kind, "free", channels, {})


def reference(kind, random):
    """Angle [rad] that the controller follows."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    if kind == "multisine":
        return 0.25 * sum(np.sin(2.0 * np.pi * (f * time + random.random())) for f in (0.4, 0.9, 1.7, 2.9))
    if kind == "ramp":
        return 0.9 * np.sin(4.0 * np.pi * time / SECONDS)
    steps = random.uniform(-0.7, 0.7, 10)
    return steps[np.minimum((time / SECONDS * len(steps)).astype(int), len(steps) - 1)]


def moved(leg, wanted):
    """Current over each sample [A]; angle [rad], filtered velocity [rad/s] and current reference [A] at its end."""
    step, whole = 1.0 / RATE / PARTS, leg.rotor + leg.load
    follows, filters = (-math.expm1(-2.0 * math.pi * band * step) for band in (LOOP, FILTER))
    omega = 2.0 * math.pi * BANDWIDTH
    pull, brake = whole * omega**2 / leg.constant, 2.0 * DAMPING_RATIO * whole * omega / leg.constant
    swing = 2.0 * math.pi * leg.swing
    stiffness, spring_damping = leg.load * swing**2, 2.0 * leg.swing_damping * leg.load * swing
    moving = leg.rotor if leg.swing else whole
    held = leg.friction * step / moving
    angle = speed = load_angle = load_speed = flowing = read = 0.0
    rows = []
    for value in wanted.tolist():
        asked = pull * (value - angle) - brake * read + leg.level * math.sin(angle) / leg.constant
        carried = 0.0
        for _ in range(PARTS):
            flowing += follows * (asked - flowing)
            carried += flowing
            if leg.swing:
                twist = angle - load_angle
                beyond = twist - min(max(twist, -0.5 * leg.play), 0.5 * leg.play)
                spring = stiffness * beyond + spring_damping * (speed - load_speed)
                spring = spring if not leg.play or spring * beyond > 0.0 else 0.0
                load_speed += (spring - leg.level * math.sin(load_angle - leg.zero)) * step / leg.load
                load_angle += load_speed * step
            else:
                spring = leg.level * math.sin(angle - leg.zero)
            into = abs(angle) - leg.stop
            bump = math.copysign(STOP * into + STOP_DAMPING * abs(speed), angle) if into > 0.0 else 0.0
            ahead = speed + (leg.constant * flowing - leg.damping * speed - spring - bump) * step / moving
            speed = ahead - min(max(ahead, -held), held)
            angle += speed * step
            read += filters * (speed - read)
        rows.append((carried / PARTS, angle, read, asked))
    return np.array(rows).T
