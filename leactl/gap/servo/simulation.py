"""Free runs of position servos, many parameter sets at once.

A free run of a servo shows what its balance of torques cannot: where it sticks. Friction is
`(f + c |T|) (1 + r exp(-(|w| / v)^n)) (1 + s sgn(w)) (1 + p cos(m q) + u sin(m q)) + b |w| + d w^2` over the torque T
that the motor puts into the gear; it takes what moves the axis and no more. Saturation takes a share from that torque
that grows with a power of the current, dead time a voltage that saturates with it; a dead band gives no output to an
error within it, and a limited reference is followed by way of `profile`. All as the effects of those names do, whose
parameters bear their names here.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from leactl.gap.replay.servo_times import STEPS
from leactl.gap.servo.profile import SLOWNESS, SLUGGISHNESS, SetPoints
from leactl.gap.servo.runs import ServoRuns
from leactl.gap.servo.stretches import Stretches, whole_runs

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Parameters = dict[str, float]
FEWEST_PARTS, MOST_PARTS = 2, 20  # steps a sample
FREE = (
    "torque_constant",
    "phase_resistance",
    "rotor_inertia",
    "viscous_damping",
    "coulomb_friction",
    "load_zero",
    "reference_delay",
    "voltage_delay",
    SLOWNESS,
    SLUGGISHNESS,
    "servo_dead_band.band",
    "saturation.loss",
    "load_dependent_friction.coefficient",
    "stribeck.breakaway_ratio",
    "stribeck.stribeck_velocity",
    "position_dependent_friction.cos",
    "position_dependent_friction.sin",
    "asymmetric_friction.asymmetry",
    "quadratic_drag.coefficient",
    "dead_time.voltage",
    "dead_time.current",
)
"""What a fit may move."""
SHAPES = {
    "saturation.exponent": 2.0,
    "saturation.current": 25.0,
    "stribeck.shape": 1.0,
    "position_dependent_friction.order": 1.0,
}
"""What is taken as it is, with its default."""
SIGNED = (
    "load_zero",
    "voltage_delay",
    "position_dependent_friction.cos",
    "position_dependent_friction.sin",
    "asymmetric_friction.asymmetry",
)
"""What may be negative."""
FINEST = 1e-6  # rad, of an encoder whose counts do not show
EDGE = 1.0  # counts of the encoder, over which a dead band ends


def table(points: Sequence[Mapping[str, float]]) -> dict[str, Array]:
    """Parameter sets as one array a parameter; what a set does not name is absent from it."""
    names = {name for point in points for name in point}
    return {name: np.array([point.get(name, SHAPES.get(name, 0.0)) for point in points]) for name in names}


def replay(runs: ServoRuns, sets: Mapping[str, Array]) -> Array:
    """Angles (sets, runs, samples) from each run's first state on; `sets` has one value a set for each parameter."""
    return simulate(runs, sets, whole_runs(runs), SetPoints(runs))


def simulate(runs: ServoRuns, sets: Mapping[str, Array], stretches: Stretches, points: SetPoints) -> Array:
    """Angles (sets, runs, samples) of stretches of runs that are replayed side by side."""
    count, run = len(next(iter(sets.values()))), stretches.run

    def spread(name: str) -> Array:
        return np.repeat(sets.get(name, np.full(count, SHAPES.get(name, 0.0)))[:, None], len(run), axis=1)

    def of_runs(values: Array) -> Array:
        return np.repeat(values[run][None], count, axis=0)

    constant, resistance, coulomb, damping, zero = (
        spread(name)
        for name in ("torque_constant", "phase_resistance", "coulomb_friction", "viscous_damping", "load_zero")
    )
    parts = parts_of(runs, sets)
    step = runs.interval / parts
    gain, rate_gain, level = (of_runs(values) for values in (runs.gain, runs.rate_gain, runs.level))
    rated = bool(np.any(rate_gain))
    # half of what slows the axis down acts at the end of a step: that follows it with far longer steps
    slowing = 0.5 * constant * (constant + rate_gain) / resistance
    loose = (spread("rotor_inertia") + of_runs(runs.inertia)) / step + 0.5 * damping
    per_speed = loose + slowing
    lose = _loss(*(spread(f"saturation.{name}") for name in ("loss", "exponent", "current")))
    rub = spread("load_dependent_friction.coefficient")
    fade = _fading(*(spread(f"stribeck.{name}") for name in ("breakaway_ratio", "stribeck_velocity", "shape")))
    wave = _wave(*(spread(f"position_dependent_friction.{name}") for name in ("cos", "sin", "order")))
    deaf = _deafness(spread("servo_dead_band.band"), max(EDGE * runs.encoder_resolution, FINEST))
    rubs, hangs = bool(np.any(rub)), runs.hangs
    lopsided, drag = spread("asymmetric_friction.asymmetry"), spread("quadratic_drag.coefficient")
    leans, drags = bool(np.any(lopsided)), bool(np.any(drag))
    dead, knee = spread("dead_time.voltage") / resistance, np.maximum(spread("dead_time.current"), 1e-300)
    dies = bool(np.any(dead))
    high = of_runs(runs.limit)
    low = -high
    begins, ends, profile_index = points.at(sets, count)
    limited, ways = begins is not ends, [(part + 0.5) / parts for part in range(parts)]
    at = np.minimum(stretches.samples, runs.angle.shape[1] - 1)
    # a row a sample, its lanes next to each other
    moves = of_lanes(ends - begins, run, at, profile_index) if limited else None
    begins = of_lanes(begins, run, at, profile_index)
    enabled, switched = runs.enabled[run[:, None], at].T.copy(), bool(np.any(runs.enabled < 1.0))
    angle = np.repeat(stretches.angle[None], count, axis=0)
    speed = np.repeat(stretches.speed[None], count, axis=0)
    push, friction, other, held, asked = (np.zeros_like(angle) for _ in range(5))
    out = np.empty((stretches.length, *angle.shape))
    share = 1.0 / resistance
    emf, hasty, before = constant.copy(), np.zeros_like(angle), begins[0]
    # a few hundred numbers at a time: what counts is how often numpy is called and not how much it does
    for sample in range(stretches.length):
        out[sample] = angle
        wanted = begins[sample]
        if switched:
            share = enabled[sample] / resistance
            per_speed = loose + enabled[sample] * slowing
        if rated:
            arrives = wanted if moves is None else wanted + moves[sample]
            np.subtract(arrives, before, out=hasty)
            hasty *= rate_gain / runs.interval
            before = arrives
        if hangs:
            np.multiply(speed, 0.5 * runs.interval, out=held)
            held += angle
            held += zero
            np.sin(held, out=held)
            held *= level
        for part in range(parts):
            if moves is None:
                np.subtract(wanted, angle, out=push)
            else:
                np.multiply(moves[sample], ways[part], out=asked)
                asked += wanted
                np.subtract(asked, angle, out=push)
            if deaf is not None:
                deaf(push, other)
            push *= gain
            if rated:
                push += hasty
                np.multiply(rate_gain, speed, out=other)
                push -= other
            np.minimum(push, high, out=push)
            np.maximum(push, low, out=push)
            np.multiply(emf, speed, out=other)
            push -= other
            push *= share  # the current
            if dies:
                push -= (enabled[sample] if switched else 1.0) * dead * np.tanh(push / knee)
            if lose is not None:
                lose(push, other)
            push *= constant
            if rubs:
                np.abs(push, out=friction)
                friction *= rub
                friction += coulomb
            else:
                np.copyto(friction, coulomb)
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
            if hangs:
                push -= held
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
    return gathered(out, stretches, runs)


def voltages(runs: ServoRuns, sets: Mapping[str, Array], points: SetPoints) -> Array:
    """Return the controller's voltages (sets, runs, samples) for the measured angles.

    They do not depend on the motor, so their residuals show effects of the drive alone.
    """
    count = len(next(iter(sets.values())))
    begins, _, profile_index = points.at(sets, count, "voltage_delay")
    error = begins[profile_index] - runs.angle
    band = sets.get("servo_dead_band.band", np.zeros(count))[:, None, None]
    deaf = _deafness(band, max(EDGE * runs.encoder_resolution, FINEST))
    if deaf is not None:
        deaf(error, np.empty_like(error))
    volts = runs.gain[:, None] * error
    if np.any(runs.rate_gain):
        reference_rate = np.gradient(begins, runs.interval, axis=2)[profile_index]
        haste = reference_rate - np.gradient(runs.angle, runs.interval, axis=1)
        volts += runs.rate_gain[:, None] * haste
    limit = runs.limit[:, None]
    return np.asarray(np.clip(volts, -limit, limit) * runs.enabled, np.float64)


def of_lanes(values: Array, run: Index, at: Index, profile_index: Index) -> Array:
    """Rearrange values (profiles, runs, samples) by lane, (samples, sets, stretches)."""
    return np.take(np.ascontiguousarray(np.moveaxis(values[:, run[:, None], at], 2, 0)), profile_index, axis=1)


def gathered(values: Array, stretches: Stretches, runs: ServoRuns) -> Array:
    """Scored parts of stretches (samples, sets, stretches), put together to whole runs (sets, runs, samples)."""
    moved = np.moveaxis(values, 0, 2)
    samples = runs.angle.shape[1]
    if stretches.length == samples:
        return moved
    whole = np.empty((moved.shape[0], len(runs.gain), samples))
    for stretch, (run, first, scored_from) in enumerate(
        zip(stretches.run, stretches.first, stretches.scored_from, strict=True)
    ):
        end = min(first + stretches.length, samples)
        whole[:, run, scored_from:end] = moved[:, stretch, scored_from - first : end - first]
    return whole


def parts_of(runs: ServoRuns, sets: Mapping[str, Array]) -> int:
    """Steps a sample that follow how fast the lightest axis answers."""
    constant, resistance = sets["torque_constant"], sets["phase_resistance"]
    lightest = sets["rotor_inertia"] + float(np.min(runs.inertia))
    slowing = constant * (constant + float(np.max(runs.rate_gain))) / (resistance * lightest)
    swinging = np.sqrt(float(np.max(runs.gain)) * constant / (resistance * lightest))
    needed = runs.interval * float(np.quantile(np.maximum(slowing, swinging), 0.5)) / STEPS
    return int(np.clip(np.ceil(needed), FEWEST_PARTS, MOST_PARTS)) if np.isfinite(needed) else FEWEST_PARTS


def _deafness(band: Array, edge: float) -> Callable[[Array, Array], None] | None:
    """Takes from errors those within a band, whose end is an edge wide; None where there is no band."""
    if not np.any(band):
        return None
    begins = np.where(band > 0.0, band / edge - 0.5, -np.inf)

    def deafen(error: Array, other: Array) -> None:
        np.abs(error, out=other)
        other /= edge
        other -= begins
        np.clip(other, 0.0, 1.0, out=other)
        error *= other

    return deafen


def _loss(loss: Array, exponent: Array, full: Array) -> Callable[[Array, Array], None] | None:
    """Takes from currents what saturation takes; None where nothing is lost."""
    if not np.any(loss):
        return None
    bent, squared = bool(np.any(exponent != 1.0)), bool(np.all(exponent == 2.0))

    def lose(current: Array, other: Array) -> None:
        np.abs(current, out=other)
        other /= full
        if squared:
            np.multiply(other, other, out=other)
        elif bent:
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
    per_speed = 1.0 / np.maximum(velocity, 1e-300)
    bent, squared = bool(np.any(shape != 1.0)), bool(np.all(shape == 2.0))

    def fade(speed: Array) -> Array:
        over = speed * per_speed
        if squared:
            np.multiply(over, over, out=over)
        elif bent:
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
