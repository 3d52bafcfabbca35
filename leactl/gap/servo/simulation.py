"""Free runs of pendulums on position servos, many parameter sets at once.

A free run of a servo shows what its balance of torques cannot: where it sticks. Friction is
`(f + c |T|) (1 + r exp(-(|w| / v)^n)) (1 + s sgn(w)) (1 + p cos(m q) + u sin(m q)) + b |w| + d w^2` over the torque T
that the motor puts into the gear; it takes what moves the axis and no more. Saturation takes a share from that torque
that grows with a power of the current, dead time a voltage that saturates with it. All as the effects of those names
do, whose parameters bear their names here.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.servo.runs import ServoRuns

Array = npt.NDArray[np.float64]
Parameters = dict[str, float]
FINE = 0.02  # of the time constant with which back-EMF slows an axis down, that a step may last
FEWEST_PARTS, MOST_PARTS = 2, 20  # steps a sample
SCALES: dict[str, float] = {
    "torque_constant": 0.1,
    "phase_resistance": 1.0,
    "rotor_inertia": 1e-4,
    "viscous_damping": 1e-3,
    "coulomb_friction": 1e-3,
    "load_zero": 0.1,  # rad, of where the pendulum hangs straight down
    "reference_delay": 0.01,  # s
    "saturation.loss": 1.0,
    "load_dependent_friction.coefficient": 0.1,
    "stribeck.breakaway_ratio": 0.1,
    "stribeck.stribeck_velocity": 0.1,
    "position_dependent_friction.cos": 0.1,
    "position_dependent_friction.sin": 0.1,
    "asymmetric_friction.asymmetry": 0.1,
    "quadratic_drag.coefficient": 1e-3,
    "dead_time.voltage": 0.1,
    "dead_time.current": 0.1,
}
"""What a fit may move, with a size that its finite differences and its damping go by."""
SHAPES = {
    "saturation.exponent": 2.0,
    "saturation.current": 25.0,
    "stribeck.shape": 1.0,
    "position_dependent_friction.order": 1.0,
}
"""What is taken as it is, with its default."""
SIGNED = (
    "load_zero",
    "position_dependent_friction.cos",
    "position_dependent_friction.sin",
    "asymmetric_friction.asymmetry",
)
"""What may be negative."""
SLOWEST = 1e-6  # rad/s or A, over which friction or a voltage may fade


def table(points: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    """Parameter sets as one array a parameter; what a set does not name is absent from it."""
    names = {name for point in points for name in point}
    return {name: np.array([point.get(name, SHAPES.get(name, 0.0)) for point in points]) for name in names}


def replay(runs: ServoRuns, sets: Mapping[str, Array]) -> Array:
    """Angles (sets, runs, samples) from each run's first state on; `sets` has one value a set for each parameter."""
    count, size = len(next(iter(sets.values()))), len(runs.gain)

    def spread(name: str) -> Array:
        return np.repeat(sets.get(name, np.full(count, SHAPES.get(name, 0.0)))[:, None], size, axis=1)

    constant, resistance, coulomb, damping, zero = (
        spread(name)
        for name in ("torque_constant", "phase_resistance", "coulomb_friction", "viscous_damping", "load_zero")
    )
    parts = parts_of(runs, sets)
    step = runs.interval / parts
    per_speed = (spread("rotor_inertia") + runs.inertia) / step
    lose = _loss(*(spread(f"saturation.{name}") for name in ("loss", "exponent", "current")))
    rub = spread("load_dependent_friction.coefficient")
    fade = _fading(*(spread(f"stribeck.{name}") for name in ("breakaway_ratio", "stribeck_velocity", "shape")))
    wave = _wave(*(spread(f"position_dependent_friction.{name}") for name in ("cos", "sin", "order")))
    rubs = bool(np.any(rub))
    lopsided, drag = spread("asymmetric_friction.asymmetry"), spread("quadratic_drag.coefficient")
    leans, drags = bool(np.any(lopsided)), bool(np.any(drag))
    dead, knee = spread("dead_time.voltage") / resistance, np.maximum(spread("dead_time.current"), SLOWEST)
    dies = bool(np.any(dead))
    reference = np.ascontiguousarray(np.moveaxis(late(runs, spread("reference_delay")[:, 0]), 2, 0))
    enabled = runs.enabled.T.copy()
    gain, level = (np.repeat(values[None], count, axis=0) for values in (runs.gain, runs.level))
    high = np.repeat(runs.limit[None], count, axis=0)
    low = -high
    angle = np.repeat(runs.angle[None, :, 0], count, axis=0)
    speed = np.repeat(runs.speed[None], count, axis=0)
    push, friction, other = (np.zeros_like(angle) for _ in range(3))
    out = np.empty((runs.angle.shape[1], *angle.shape))
    # a few hundred numbers at a time: what counts is how often numpy is called and not how much it does
    for sample, wanted in enumerate(reference):
        out[sample] = angle
        share = enabled[sample] / resistance
        for _ in range(parts):
            np.subtract(wanted, angle, out=push)
            push *= gain
            np.minimum(push, high, out=push)
            np.maximum(push, low, out=push)
            np.multiply(constant, speed, out=other)
            push -= other
            push *= share  # the current
            if dies:
                push -= enabled[sample] * dead * np.tanh(push / knee)
            if lose is not None:
                lose(push, other)
            push *= constant
            np.copyto(friction, coulomb)
            if rubs:
                np.abs(push, out=other)
                other *= rub
                friction += other
            np.abs(speed, out=other)
            if fade is not None:
                friction *= fade(other)
            if wave is not None:
                friction *= wave(angle)
            if leans:
                friction *= 1.0 + lopsided * np.sign(speed)
            if drags:
                friction += drag * other**2
            other *= damping
            friction += other
            np.add(angle, zero, out=other)
            np.sin(other, out=other)
            other *= level
            push -= other
            np.multiply(per_speed, speed, out=other)
            other += push  # the torque that would bring the axis to rest
            np.minimum(other, friction, out=other)
            np.negative(friction, out=friction)
            np.maximum(other, friction, out=other)
            push -= other
            push /= per_speed
            speed += push
            np.multiply(speed, step, out=push)
            angle += push
    return np.moveaxis(out, 0, 2)


def parts_of(runs: ServoRuns, sets: Mapping[str, Array]) -> int:
    """Steps a sample that follow how back-EMF slows the lightest axis down."""
    lightest = sets["rotor_inertia"] + float(np.min(runs.inertia))
    rate = sets["torque_constant"] ** 2 / (sets["phase_resistance"] * lightest)
    needed = runs.interval * float(np.quantile(rate, 0.5)) / FINE
    return int(np.clip(np.ceil(needed), FEWEST_PARTS, MOST_PARTS)) if np.isfinite(needed) else FEWEST_PARTS


def late(runs: ServoRuns, delays: Array) -> Array:
    """References (sets, runs, samples) as they arrive."""
    at = np.arange(runs.angle.shape[1]) * runs.interval
    return np.stack([[np.interp(at - delay, at, one) for one in runs.reference] for delay in delays])


def _loss(loss: Array, exponent: Array, full: Array) -> Callable[[Array, Array], None] | None:
    """Takes from currents what saturation takes; None where nothing is lost."""
    if not np.any(loss):
        return None
    bent = bool(np.any(exponent != 1.0))

    def lose(current: Array, other: Array) -> None:
        np.abs(current, out=other)
        other /= full
        if bent:
            np.power(other, exponent, out=other)
        other *= loss
        np.subtract(1.0, other, out=other)
        np.maximum(other, 0.0, out=other)
        current *= other

    return lose


def _fading(ratio: Array, velocity: Array, shape: Array) -> Callable[[Array], Array] | None:
    """Factor on friction at a speed; None where it is one everywhere."""
    if not np.any(ratio):
        return None
    per_speed, bent = 1.0 / np.maximum(velocity, SLOWEST), bool(np.any(shape != 1.0))

    def fade(speed: Array) -> Array:
        over = speed * per_speed
        if bent:
            np.power(over, shape, out=over)
        np.negative(over, out=over)
        np.exp(over, out=over)
        over *= ratio
        over += 1.0
        return over

    return fade


def _wave(cosine: Array, sine: Array, order: Array) -> Callable[[Array], Array] | None:
    """Factor on friction at an angle; None where it is one everywhere."""
    if not (np.any(cosine) or np.any(sine)):
        return None

    def wave(angle: Array) -> Array:
        turned = order * angle
        return np.asarray(1.0 + cosine * np.cos(turned) + sine * np.sin(turned), np.float64)

    return wave
