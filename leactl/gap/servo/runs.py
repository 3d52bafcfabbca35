"""Runs of position servos put side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.gap.record import Clocked, Record
from leactl.gap.rig import drive_of, load_of
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
FEW = 4  # samples
MOVING = 0.1  # of the fast speeds, below which a run begins at rest
SAME_PACE = 0.01  # relative, by which sampling intervals may differ


@dataclass(frozen=True)
class ServoRuns:
    """Runs side by side; (runs, samples) for channels, one value a run for the rest."""

    interval: float
    count: float  # rad, of the encoders
    angle: Array
    speed: Array  # rad/s, at the first sample
    reference: Array
    enabled: Array
    measured: Mask
    gain: Array  # V/rad
    limit: Array  # V
    level: Array  # N*m, of the pendulum held out level
    inertia: Array  # kg*m^2, of the pendulum


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
        row[: len(clock.time)] &= clock.all_valid(("angle", "test"), ("angle_reference", "test"))
    servos = [servo for record in records if (servo := drive_of(record, model)) is not None]
    loads = [load_of(record, model) for record in records]
    return ServoRuns(
        interval,
        max(clock.counts.get(("angle", "test"), 0.0) for clock in clocks),
        angles,
        np.array([starting_speed(one, interval) for one in angles]),
        references,
        enabled,
        measured,
        np.array([servo.gain for servo in servos]),
        np.array([servo.voltage_limit for servo in servos]),
        np.array([load.level_torque for load in loads]),
        np.array([load.inertia for load in loads]),
    )


def side_by_side(records: Sequence[Record], model: Model) -> list[Record]:
    """Those runs of servos that are sampled at the pace that most of them have."""
    paced = [(r, r.fast.interval) for r in records if r.fast is not None and drive_of(r, model) is not None]
    paces = [[r for r, other in paced if abs(other / one - 1.0) <= SAME_PACE] for _, one in paced]
    return max(paces, key=len, default=[])


def starting_speed(angle: Array, interval: float) -> float:
    """Speed at the first sample, by a parabola through a few; none where that is little beside the run's speeds."""
    speed = float(np.polynomial.Polynomial.fit(interval * np.arange(FEW), angle[:FEW], 2).deriv()(0.0))
    fast = float(np.quantile(np.abs(np.diff(angle)), 0.95)) / interval
    return speed if abs(speed) > MOVING * fast else 0.0


def channels(clock: Clocked, length: int) -> tuple[Array, Array, Array]:
    """Angle, reference and whether the drive is enabled, held to a length."""
    enabled = clock.get("drive_enabled")
    on = np.ones(len(clock.time)) if enabled is None else (enabled > 0.5).astype(float)
    found = (clock.values["angle", "test"], clock.values["angle_reference", "test"], on)
    angle, reference, on = (np.pad(values, (0, length - len(values)), mode="edge") for values in found)
    return angle, reference, on
