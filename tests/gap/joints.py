"""Rigid joints simulated on their own: a drawn machine, and its runs as a log has them that may leave much unsaid.

Nothing of leactl simulates here: a current loop, a rotor with friction and a velocity filter, stepped by Euler.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leactl.gap.diagnose import Case
from leactl.gap.signals.record import build_record
from leactl.model.nominal import Model
from leactl.runfile.read.reader import Channel

PARTS = 10  # steps in a sample
SECONDS = 12.0


@dataclass(frozen=True)
class Log:
    """What a log may leave unsaid; a fraction of a sample where nothing else is said."""

    sampling: bool = True  # whether it says what its stamps mean
    held: bool = True  # the reference, until its next value; else on a straight line to it
    before: bool = True  # a row has the reference that was in force before it
    current_late: float = 0.0
    velocity_late: float = 0.0
    filtered_by_samples: bool = False


@dataclass(frozen=True)
class Joint:
    """A machine; the model file is off it by what is usual."""

    rate: float
    constant: float
    inertia: float
    damping: float
    friction: float
    top: float  # A
    loop: float  # Hz
    filter: float  # Hz
    count: float  # rad

    def model(self, random):
        off = 1.0 + np.array([0.06, 0.15, 0.3, 0.3]) * random.uniform(-1.0, 1.0, 4)
        return Model(
            name="joint",
            torque_constant=self.constant * off[0],
            back_emf_constant=self.constant * off[0],
            rotor_inertia=self.inertia * off[1],
            viscous_damping=self.damping * off[2],
            coulomb_friction=self.friction * off[3],
            bench={"current_loop_bandwidth": self.loop, "velocity_filter_bandwidth": self.filter},
        )


@dataclass(frozen=True)
class Effect:
    """What the joint does and its model lacks; nothing where nothing else is said."""

    delay: int = 0  # samples, by which the reference acts late
    slew: float = np.inf  # A/s, that the drive follows its reference with
    dead: float = 0.0  # A, of the reference on either side of zero, which the drive takes for none
    limits: Callable[[float], tuple[float, float]] | None = None  # A, lowest and highest current at a speed
    loss: float = 0.0  # of the torque constant at the highest current, growing with its square
    drag: Callable[[float], float] = lambda speed: 0.0  # N*m, against the motion
    ripple: Callable[[float], float] = lambda angle: 0.0  # of the torque, beside what the constant says


SOUND = Effect()


def drawn_joint(random):
    """A machine with a time constant of 0.1 to 1 s, whose friction takes a tenth of its current."""
    rate, constant, top = random.choice([400.0, 1000.0]), 10.0 ** random.uniform(-1.5, 0.5), random.uniform(1.0, 5.0)
    speed = 10.0 ** random.uniform(0.7, 1.5)
    damping = 0.6 * constant * top / speed
    return Joint(
        rate,
        constant,
        damping * 10.0 ** random.uniform(-1.0, 0.0),
        damping,
        random.uniform(0.05, 0.2) * constant * top,
        top,
        random.uniform(0.15, 0.3) * rate,
        random.uniform(0.12, 0.2) * rate,
        2.0 * np.pi / 2 ** int(random.integers(14, 18)),
    )


def drawn_log(random):
    return Log(
        False,
        bool(random.integers(2)),
        bool(random.integers(2)),
        *random.uniform(0.0, 1.0, 2).tolist(),
        bool(random.integers(2)),
    )


def case(joint, log, random, effect=SOUND):
    """Six runs, one of each kind held out."""
    kinds = ("multisine", "levels", "ramp")
    runs = [(kind, again) for again in "ab" for kind in kinds]
    records = [
        build_record(Path(f"{kind}-{again}.h5"), kind, "free", channels(joint, log, kind, random, effect), {})
        for kind, again in runs
    ]
    return Case(joint.model(random), records[:3], records[3:])


def channels(joint, log, kind, random, effect=SOUND, seconds=SECONDS):
    """A run of the joint as channels of a file."""
    count = round(seconds * joint.rate)
    time = np.arange(count) / joint.rate
    asked = reference(kind, joint.top, time, seconds, random)
    acting = np.concatenate([np.full(effect.delay, asked[0]), asked[: count - effect.delay]])
    current, velocity, reading, angle = simulated(joint, log, acting, effect)
    ends = PARTS * np.arange(1, count + 1) - 1
    flowing = np.concatenate([[0.0], np.cumsum(current)])
    late = np.maximum(ends + 1 - round(PARTS * log.current_late), PARTS)
    results = {
        ("q_axis_current", "A"): (flowing[late] - flowing[late - PARTS]) / PARTS
        + 2e-3 * joint.top * random.standard_normal(count),
        ("q_axis_current_reference", "A"): asked if log.before else np.append(asked[1:], asked[-1]),
        ("velocity", "rad/s"): reading[np.maximum(ends - round(PARTS * log.velocity_late), 0)]
        + 2e-3 * float(np.max(np.abs(velocity))) * random.standard_normal(count),
        ("angle", "rad"): np.round(angle[ends] / joint.count) * joint.count,
    }
    return [
        Channel(
            (np.arange(count) + 1) / joint.rate,
            values,
            quantity,
            "test",
            units,
            "drive",
            "",
            "",
            ("mean" if quantity == "q_axis_current" else "instant") if log.sampling else "",
            "loop",
        )
        for (quantity, units), values in results.items()
    ]


def reference(kind, top, time, seconds, random):
    """Current reference [A] that turns the joint both ways."""
    if kind == "multisine":
        waves = [np.sin(2 * np.pi * (f * time + random.random())) for f in (0.3, 0.7, 1.3, 2.1, 3.7, 6.1)]
        return top * sum(waves) / 3.0
    if kind == "ramp":
        return top * np.sin(2 * np.pi * time / seconds)
    steps = top * random.uniform(0.3, 1.0, 8) * np.array([1, -1, 1, 1, -1, -1, 1, -1])
    return steps[np.minimum((time / seconds * 8).astype(int), 7)]


def simulated(joint, log, asked, effect):
    """Current [A], speed and what the drive's filter makes of it [rad/s], angle [rad], at every step."""
    # Python's own numbers throughout: the same arithmetic as NumPy's, which takes several times as long for one number
    step = float(1.0 / joint.rate / PARTS)
    follows, filters = (-np.expm1(-2.0 * np.pi * np.array([joint.loop, joint.filter]) * step)).tolist()
    by_samples = float(-np.expm1(-2.0 * np.pi * joint.filter / joint.rate))
    constant, inertia, damping, top = map(float, (joint.constant, joint.inertia, joint.damping, joint.top))
    held, fastest, dead = joint.friction * step / inertia, effect.slew * step, effect.dead
    drag, ripple, loss = effect.drag, effect.ripple, effect.loss
    limits = effect.limits
    dragged, whole = drag is not SOUND.drag, loss == SOUND.loss and ripple is SOUND.ripple
    straight, smooth = not log.held, not log.filtered_by_samples
    out = []
    flowing = speed = reading = angle = before = limited = 0.0
    for value in asked.tolist():
        for part in range(PARTS):
            wanted = before + (value - before) * (part + 1) / PARTS if straight else value
            onward = wanted - limited
            limited += onward if -fastest <= onward <= fastest else fastest if onward > 0.0 else -fastest
            driven = limited - min(max(limited, -dead), dead) if dead else limited
            if limits is not None:
                lowest, highest = limits(speed)
                driven = min(max(limited, lowest), highest)
            flowing += follows * (driven - flowing)
            share = 1.0 if whole else 1.0 - loss * (flowing / top) ** 2 + ripple(angle)
            torque = constant * flowing * share - damping * speed - (drag(speed) if dragged else 0.0)
            ahead = speed + torque * step / inertia
            speed = 0.0 if -held <= ahead <= held else ahead - held if ahead > 0.0 else ahead + held
            angle += speed * step
            if smooth:
                reading += filters * (speed - reading)
            elif part == PARTS - 1:
                reading += by_samples * (speed - reading)
            out.append((flowing, speed, reading, angle))
        before = value
    return np.array(out).T
