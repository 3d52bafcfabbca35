"""Position servos simulated on their own: a drawn hobby or robot servo, and its logs with position, goal and duty.

Nothing of leactl simulates here: a profile that moves an inner set-point, a controller that counts its encoder, a
voltage-driven motor behind a gear with friction, a pendulum or nothing on it, stepped by Euler.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from leactl.gap.diagnose import Case
from leactl.gap.signals.record import build_record
from leactl.model.nominal import Model
from leactl.runfile.read.reader import Channel

COUNT = 2.0 * np.pi / 4096
FINEST = 40  # parts of the time constant of the lightest servo, that a step lasts
KINDS = ("steps", "sines", "chirp")


@dataclass(frozen=True)
class Servo:
    """A servo and what hangs on it, in SI units; the model file is off it by what is usual."""

    supply: float  # V
    constant: float  # N*m/A
    resistance: float
    inertia: float  # kg*m^2, of rotor and gear
    damping: float
    friction: float
    gain: float  # V/rad
    rate_gain: float  # V*s/rad, on the rate of the error
    mass: float
    length: float
    swing: float  # rad, of its goals
    interval: float
    seconds: float
    gravity: float = 9.80665
    # what the model lacks
    speed: float = np.inf  # rad/s, that the profile allows
    acceleration: float = np.inf
    band: float = 0.0  # rad, of error without an output
    tires: float = 0.0  # share of its torque that it loses from a run's start to its end
    smoothed: float = 0.0  # s, time constant with which the set-point goes to its goal
    bursts: float = 0.0  # of its friction, that rubs more now and then

    @property
    def no_load(self):
        return self.supply / self.constant

    @property
    def stall(self):
        return self.constant * self.supply / self.resistance

    @property
    def response(self):
        """Time constant with which back-EMF slows it down."""
        return (self.inertia + self.mass * self.length**2) * self.no_load / self.stall

    def model(self, random):
        off = 1.0 + np.array([0.08, 0.1, 0.15, 0.3, 0.3]) * random.uniform(-1.0, 1.0, 5)
        load = {"type": "pendulum", "mass": self.mass, "length": self.length, "gravity": self.gravity}
        drive = {"type": "position_servo", "gain": self.gain, "voltage_limit": self.supply}
        return Model(
            name="servo",
            torque_constant=self.constant * off[0],
            back_emf_constant=self.constant * off[0],
            phase_resistance=self.resistance * off[1],
            rotor_inertia=self.inertia * off[2],
            viscous_damping=self.damping * off[3],
            coulomb_friction=self.friction * off[4],
            load=load if self.mass else {"type": "none"},
            drive=drive | ({"damping": self.rate_gain} if self.rate_gain else {}),
        )


def drawn_servo(random, free=None):
    """A servo of 0.3 to 30 N*m and 3 to 12 rad/s that logs at 100 to 200 Hz."""
    supply, no_load = random.choice([5.0, 7.4, 12.0, 24.0]), 10.0 ** random.uniform(0.5, 1.1)
    stall, response = 10.0 ** random.uniform(-0.5, 1.5), random.uniform(0.03, 0.12)
    constant = supply / no_load
    inertia, free = response * stall / no_load, random.random() < 0.4 if free is None else free
    length = 0.0 if free else random.uniform(0.08, 0.2)
    mass = 0.0 if free else min(random.uniform(0.1, 0.3) * stall / 9.80665 / length, 0.7 * inertia / length**2)
    saturates = random.uniform(0.08, 0.4)
    rated = random.random() < 0.3
    return Servo(
        supply,
        constant,
        supply * constant / stall,
        inertia - mass * length**2,
        random.uniform(0.0, 0.1) * stall / no_load,
        random.uniform(0.03, 0.08) * stall,
        supply / saturates,
        random.uniform(0.2, 0.5) * constant if rated else 0.0,
        mass,
        length,
        random.uniform(0.8, 1.4),
        1.0 / float(random.choice([100.0, 125.0, 200.0])),
        20.0,
    )


def limited(servo, random, strong):
    """The servo with a profile; half of them limit the acceleration as well."""
    reaches = servo.no_load * 0.7
    speed = reaches * (random.uniform(0.15, 0.3) if strong else random.uniform(0.4, 0.6))
    ramp = random.uniform(0.08, 0.3) if random.random() < 0.5 else 0.0
    return replace(servo, speed=speed, acceleration=speed / ramp if ramp else np.inf)


def dead(servo, random, strong):
    """The servo with a dead band that its friction's own rest does not hide."""
    rests = servo.friction / servo.stall * servo.supply / servo.gain
    return replace(servo, band=max(rests * (3.0 if strong else 1.2), (12 if strong else 6) * COUNT))


def scaled(servo, torque=1.0, current=1.0, time=1.0):
    """A similar servo: torque, current and time times these."""
    volts = torque / (current * time)
    changed = {
        "supply": servo.supply * volts,
        "constant": servo.constant * torque / current,
        "resistance": servo.resistance * torque / current**2,
        "inertia": servo.inertia * torque * time**2,
        "damping": servo.damping * torque * time,
        "friction": servo.friction * torque,
        "gain": servo.gain * volts,
        "rate_gain": servo.rate_gain * volts * time,
        "mass": servo.mass * torque * time**2,
        "gravity": servo.gravity / time**2,
        "interval": servo.interval * time,
        "seconds": servo.seconds * time,
        "speed": servo.speed / time,
        "acceleration": servo.acceleration / time**2,
        "smoothed": servo.smoothed * time,
    }
    return replace(servo, **changed)


def case(servo, random, volts=True, thin=1, kinds=KINDS, again=2, start=None):
    """Runs of each kind, the last of each held out; `thin` keeps every so many samples."""
    model = servo.model(random)
    names = [(kind, chr(97 + turn)) for turn in range(again) for kind in kinds]
    time = servo.interval * np.arange(round(servo.seconds / servo.interval))
    goals = np.stack([goal(kind, servo, time, random) for kind, _ in names])
    angle, duty = simulated(servo, goals, random, goals[:, 0] if start is None else np.full(len(goals), start))
    kept = slice(None, None, thin)
    records = []
    for (kind, turn), asked, read, pushed in zip(names, goals, angle, duty, strict=True):
        parts = [("angle", read, "rad"), ("angle_reference", asked, "rad")]
        parts += [("q_axis_voltage", servo.supply * np.round(1000 * pushed) / 1000, "V")] if volts else []
        channels = [
            Channel(time[kept], values[kept], name, "test", units, "servo", "", "", "", "loop")
            for name, values, units in parts
        ]
        records.append(build_record(Path(f"{kind}-{turn}.h5"), kind, "free", channels, {}))
    held = len(kinds)
    return Case(model, records[:-held], records[-held:])


def goal(kind, servo, time, random):
    """Goals [rad] that turn the servo both ways; what it would follow goes up to its speed."""
    swing, share = servo.swing, time / servo.seconds
    if kind == "steps":
        levels = swing * random.uniform(-1.0, 1.0, 14)
        return levels[np.minimum((14 * share).astype(int), 13)]
    fast = 0.7 * servo.no_load / swing  # rad/s, with which a sine of this swing is as fast as the servo
    if kind == "sines":
        turns = fast * np.array([0.1, 0.27, 0.6])
        waves = [np.sin(turn * time + random.uniform(0.0, 6.28)) for turn in turns]
        return swing * (0.5 * waves[0] + 0.3 * waves[1] + 0.25 * waves[2])
    low, high = 0.05 * fast, random.uniform(0.9, 1.2) * fast
    phase = low * servo.seconds / np.log(high / low) * (high / low) ** share
    return swing * random.uniform(0.6, 0.9) * np.sin(phase - phase[0])


def simulated(servo, goals, random, start):
    """Angle [rad] by the encoder and the share of the supply at every sample, a row a run."""
    parts = max(4, int(np.ceil(FINEST * servo.interval / servo.response)))
    step, runs = servo.interval / parts, len(goals)
    inertia, level = servo.inertia + servo.mass * servo.length**2, servo.mass * servo.gravity * servo.length
    angle, speed, point, pace = start.copy(), np.zeros(runs), start.copy(), np.zeros(runs)
    followed, duty, rub, left = point.copy(), np.zeros(runs), servo.friction, 0
    angles, duties = np.empty_like(goals), np.empty_like(goals)
    earlier = goals[:, 0].copy()
    for sample, asked in enumerate(goals.T):
        angles[:, sample], duties[:, sample] = angle, duty
        if servo.bursts:
            left -= 1
            if left <= 0 and random.random() < 0.8 * servo.interval / (10 * servo.response):
                left = int(6 * servo.response / servo.interval)
            rub = servo.friction * (1.0 + servo.bursts * (left > 0))
        hasty, earlier = (asked - earlier) / servo.interval, asked
        for _ in range(parts):
            point, pace = profiled(servo, asked, point, pace, step)
            if not np.isfinite(servo.speed):
                pace = hasty
            followed = point if not servo.smoothed else followed + step / servo.smoothed * (point - followed)
            error = np.round((followed - angle) / COUNT) * COUNT
            error = np.where(np.abs(error) < servo.band, 0.0, error)
            duty = np.clip((servo.gain * error + servo.rate_gain * (pace - speed)) / servo.supply, -1.0, 1.0)
            motor = servo.constant * (servo.supply * duty - servo.constant * speed) / servo.resistance
            motor = motor * (1.0 - servo.tires * sample / goals.shape[1])
            push = motor - level * np.sin(angle) - servo.damping * speed
            stop = push + inertia / step * speed
            speed = np.where(np.abs(stop) <= rub, 0.0, speed + step / inertia * (push - np.sign(stop) * rub))
            angle = angle + step * speed
    return np.round(angles / COUNT) * COUNT, duties


def profiled(servo, asked, point, pace, step):
    """One step of a trapezoidal profile: full acceleration until what is left is what braking takes."""
    if not np.isfinite(servo.speed):
        return asked, np.zeros_like(point)
    left = asked - point
    if not np.isfinite(servo.acceleration):
        moved = np.clip(left, -servo.speed * step, servo.speed * step)
        return point + moved, moved / step
    stops = pace**2 / (2.0 * servo.acceleration)
    braking = (pace * left > 0.0) & (np.abs(left) <= stops)
    onward = np.where(braking, -np.sign(left), np.sign(left)) * servo.acceleration
    pace = np.clip(pace + onward * step, -servo.speed, servo.speed)
    near = (np.abs(left) < servo.acceleration * step**2 * 2) & (np.abs(pace) < 2 * servo.acceleration * step)
    return np.where(near, asked, point + pace * step), np.where(near, 0.0, pace)
