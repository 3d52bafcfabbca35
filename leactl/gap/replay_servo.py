"""Pendulums on position servos, simulated many at once and many parameter sets at once, and fitted by that.

A free run of a servo shows what its balance of torques cannot: where it sticks. Friction is `(f + c |T|) (1 + r
exp(-|w| / v))` over the torque T that the motor puts into the gear; it takes what moves the axis and no more.
Saturation takes a share from that torque that grows with a power of the current, as the effect of that name does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.gap.record import Clocked, Record
from leactl.gap.rig import drive_of, level_torque, load_inertia, load_of
from leactl.model.nominal import EffectEntry, Model

Array = npt.NDArray[np.float64]
Parameters = dict[str, float]
PARTS = 2  # steps a sample
ROUNDS = 25
OUTLIER_RAD = 0.03  # errors beyond count by their size, not their square: a slip at another instant is no other model
DAMPINGS = 10.0 ** np.arange(-2.0, 4.0)  # tried at once, relative to the last that helped
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
}
"""What a fit may move, with a size that its finite differences and its damping go by; all but the zero are positive."""
SHAPES = {"saturation.exponent": 2.0, "stribeck.shape": 1.0}
"""What is taken as it is, with its default."""
BEGINNING = {
    "load_dependent_friction.coefficient": 0.3,
    "saturation.loss": 0.1,
    "stribeck.breakaway_ratio": 0.1,
}
"""Share of its strength that an effect joins a fit with."""
SIGNED = ("load_zero",)
SATURATION_A = 25.0  # current that the loss of the effect is given at
SAME_PACE = 0.01  # relative, by which sampling intervals may differ
LEAST = 1e-3  # of its size, below which a positive one does not go


@dataclass(frozen=True)
class ServoRuns:
    """Runs side by side; (runs, samples) for channels, one value a run for the rest."""

    interval: float
    angle: Array
    reference: Array
    enabled: Array
    measured: npt.NDArray[np.bool_]
    gain: Array  # V/rad
    limit: Array  # V
    level: Array  # N*m, of the pendulum held out level
    inertia: Array  # kg*m^2, of the pendulum

    def picked(self, runs: npt.NDArray[np.bool_]) -> "ServoRuns":
        """Some of the runs."""
        return replace(self, **{name: values[runs] for name, values in vars(self).items() if name != "interval"})


def servo_runs(records: Sequence[Record], model: Model) -> ServoRuns:
    """Put runs of position servos side by side; shorter ones wait at their last reference.

    Raises
    ------
    InputError : a run without a servo, or runs sampled at different rates.
    """
    clocks = [record.fast for record in records if record.fast is not None and drive_of(record, model) is not None]
    if len(clocks) < len(records):
        lacking = next(record for record in records if drive_of(record, model) is None)
        raise InputError(f"{lacking.path}: no position servo: an angle, its reference and a `drive:` were expected")
    longest, interval = max(len(clock.time) for clock in clocks), clocks[0].interval
    if any(abs(clock.interval / interval - 1.0) > SAME_PACE for clock in clocks):
        paces = sorted({f"{clock.interval:.4g}" for clock in clocks})
        raise InputError(f"runs sampled every {', '.join(paces)} s cannot be simulated side by side")
    angles, references, enabled = (np.stack(c) for c in zip(*(channels(k, longest) for k in clocks), strict=True))
    measured = np.stack([np.arange(longest) < len(clock.time) for clock in clocks])
    for row, clock in zip(measured, clocks, strict=True):
        row[: len(clock.time)] &= clock.all_valid(("angle", "test"))
    servos = [servo for record in records if (servo := drive_of(record, model)) is not None]
    loads = [load_of(record, model) for record in records]
    return ServoRuns(
        interval,
        angles,
        references,
        enabled,
        measured,
        np.array([servo.gain for servo in servos]),
        np.array([servo.voltage_limit for servo in servos]),
        np.array([level_torque(load) for load in loads]),
        np.array([load_inertia(load) for load in loads]),
    )


def channels(clock: Clocked, length: int) -> tuple[Array, Array, Array]:
    """Angle, reference and whether the drive is enabled, held to a length."""
    enabled = clock.get("drive_enabled")
    on = np.ones(len(clock.time)) if enabled is None else (enabled > 0.5).astype(float)
    found = (clock.values["angle", "test"], clock.values["angle_reference", "test"], on)
    angle, reference, on = (np.pad(values, (0, length - len(values)), mode="edge") for values in found)
    return angle, reference, on


def replay(runs: ServoRuns, sets: Mapping[str, Array]) -> Array:
    """Angles (sets, runs, samples) from the first measured one on; `sets` has one value a set for each parameter."""
    count = len(next(iter(sets.values())))
    p = {name: sets.get(name, np.zeros(count))[:, None] for name in SCALES}
    p |= {name: sets.get(name, np.full(count, value))[:, None] for name, value in SHAPES.items()}
    constant, resistance = p["torque_constant"], p["phase_resistance"]
    inertia = p["rotor_inertia"] + runs.inertia
    fade = 1.0 / np.maximum(p["stribeck.stribeck_velocity"], 1e-6)
    ratio, rub = p["stribeck.breakaway_ratio"], p["load_dependent_friction.coefficient"]
    step, samples = runs.interval / PARTS, runs.angle.shape[1]
    reference = late(runs, p["reference_delay"][:, 0])
    angle = np.repeat(runs.angle[None, :, 0], count, axis=0)
    speed = np.zeros_like(angle)
    out = np.empty((*angle.shape, samples))
    for sample in range(samples):
        out[:, :, sample] = angle
        share = runs.enabled[:, sample]
        wanted = reference[:, :, sample]
        for _ in range(PARTS):
            volts = np.clip(runs.gain * (wanted - angle), -runs.limit, runs.limit)
            current = share * (volts - constant * speed) / resistance
            lost = p["saturation.loss"] * (np.abs(current) / SATURATION_A) ** p["saturation.exponent"]
            motor = constant * current * np.maximum(1.0 - lost, 0.0)
            push = motor - runs.level * np.sin(angle + p["load_zero"])
            turning = np.abs(speed)
            friction = (p["coulomb_friction"] + rub * np.abs(motor)) * (
                1.0 + ratio * np.exp(-((turning * fade) ** p["stribeck.shape"]))
            )
            friction += p["viscous_damping"] * turning
            stopping = inertia / step * speed + push
            speed += step / inertia * (push - np.clip(stopping, -friction, friction))
            angle = angle + step * speed
    return out


def late(runs: ServoRuns, delays: Array) -> Array:
    """References (sets, runs, samples) as they arrive."""
    at = np.arange(runs.angle.shape[1]) * runs.interval
    return np.stack([[np.interp(at - delay, at, one) for one in runs.reference] for delay in delays])


def refine(runs: ServoRuns, start: Parameters) -> tuple[Parameters, float]:
    """Fit every parameter of `start` but the shapes to the angles by free simulation, from where it is.

    Levenberg and Marquardt's steps, with several dampings tried at once.

    Returns
    -------
    The parameters, and the sum of squares that they leave, outliers by their size.
    """
    names = [name for name in start if name not in SHAPES]
    shapes = {name: value for name, value in start.items() if name in SHAPES}
    sizes = np.array([SCALES[name] for name in names])
    point = np.array([start[name] for name in names])
    damping = 1e-2

    def errors(points: Array) -> Array:
        held = {name: np.full(len(points), value) for name, value in shapes.items()}
        angles = replay(runs, held | {name: points[:, k] for k, name in enumerate(names)})
        return np.asarray((angles - runs.angle)[:, runs.measured], np.float64)

    error = errors(point[None])[0]
    cost = _cost(error)
    for _ in range(ROUNDS):
        moves = 1e-3 * np.maximum(np.abs(point), 0.1 * sizes)
        tangent = (errors(point + np.diag(moves)) - error) / moves[:, None]
        weighted = tangent / np.sqrt(1.0 + (error / OUTLIER_RAD) ** 2)
        gram, right = weighted @ tangent.T, weighted @ error
        trials = np.stack(
            [point - np.linalg.solve(gram + d * np.diag(np.diag(gram) + 1e-12), right) for d in damping * DAMPINGS]
        )
        trials = _possible(trials, names, sizes)
        tried = errors(trials)
        costs = np.array([_cost(one) for one in tried])
        best = int(np.argmin(costs))
        gained = cost - costs[best]
        if gained <= 0.0:
            break
        point, error, cost, damping = trials[best], tried[best], float(costs[best]), float(damping * DAMPINGS[best])
        if gained < 1e-4 * cost:
            break
    return shapes | dict(zip(names, point.tolist(), strict=True)), cost


def refitted(records: Sequence[Record], model: Model) -> Model:
    """A model of a servo's pendulum with its parameters and those of its effects fitted by free simulation.

    A balance of torques linearises what moves by half where friction and torque constant trade places; a simulation
    does not. Effects that it does not know stay as they are and out of it.
    """
    own = [name for name in SCALES if "." not in name and name not in (*SIGNED, "reference_delay")]
    start = {name: float(getattr(model, name) or 0.0) for name in own}
    runs, added = servo_runs(records, model), [known(entry) for entry in model.effects]
    at_once = {name: value for one in added for name, value in one.items()}
    together = refine(runs, start | at_once)
    # where the model is far off, effects that join one after the other find their way sooner than all together
    step = refine(runs, start)
    for one in added:
        step = refine(runs, step[0] | {name: BEGINNING.get(name, 1.0) * value for name, value in one.items()})
    found, _ = min((together, step), key=lambda result: result[1])
    document = model.model_dump()
    document |= {name: found[name] for name in own} | {"back_emf_constant": found["torque_constant"]}
    for entry in document["effects"]:
        effect = entry["effect"]
        entry["parameters"] = {n: found.get(f"{effect}.{n}", v) for n, v in entry["parameters"].items()}
    return Model.model_validate(document)


def known(entry: EffectEntry) -> Parameters:
    """What the simulation knows of an effect, by its full name."""
    every = {f"{entry.effect}.{name}": value for name, value in entry.parameters.items()}
    return {name: value for name, value in every.items() if name in SCALES or name in SHAPES}


def _possible(points: Array, names: Sequence[str], sizes: Array) -> Array:
    positive = np.array([name not in SIGNED for name in names])
    return np.where(positive, np.maximum(points, LEAST * sizes), points)


def _cost(error: Array) -> float:
    return float(OUTLIER_RAD**2 * np.sum(np.sqrt(1.0 + (error / OUTLIER_RAD) ** 2) - 1.0))


def mean_absolute_errors(runs: ServoRuns, parameters: Parameters) -> Array:
    """Mean absolute angle error of each run, simulated from its first sample."""
    angles = replay(runs, {name: np.array([value]) for name, value in parameters.items()})[0]
    wrong = np.where(runs.measured, np.abs(angles - runs.angle), 0.0)
    return np.asarray(wrong.sum(axis=1) / runs.measured.sum(axis=1), np.float64)
