"""Runs of position servos put side by side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.gap.record import Clocked, Record
from leactl.gap.rig import drive_of, level_torque, load_inertia, load_of
from leactl.model.nominal import Model

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
SAME_PACE = 0.01  # relative, by which sampling intervals may differ


@dataclass(frozen=True)
class ServoRuns:
    """Runs side by side; (runs, samples) for channels, one value a run for the rest."""

    interval: float
    angle: Array
    reference: Array
    enabled: Array
    measured: Mask
    gain: Array  # V/rad
    limit: Array  # V
    level: Array  # N*m, of the pendulum held out level
    inertia: Array  # kg*m^2, of the pendulum

    def picked(self, runs: Mask) -> "ServoRuns":
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
