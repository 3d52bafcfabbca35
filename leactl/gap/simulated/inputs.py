"""Whether a simulated run has the commands of a real one, sample by sample, and where it first has not.

Logs stamp a setpoint at the beginning of its interval or at its end, and two clocks need not have one rate. So a value
is held against the range that the other run has within a few samples of the same time since its start.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.search.stamp_fit import LATEST
from leactl.gap.signals.noise import noise_of, quantum_of
from leactl.runfile.read.reader import Channel, Run

Array = npt.NDArray[np.float64]
OUTERMOST_FIRST = ("angle_reference", "velocity_reference", "torque_reference", "q_axis_current_reference")
"""Setpoints; of a cascade of loops the inner ones are answers of the machine."""
MEASURED = ("q_axis_current", "q_axis_voltage", "line_current")
"""Inputs of a run that logs no setpoint, the first that it has."""
FEWEST = 10  # samples, below which a channel says nothing
SURE = 6.0  # standard deviations of both runs' noise, that no sample of a long run goes beyond
WIDEST = 0.05  # of a command's range, that a tolerance may be
REGULATED = 0.02  # of a measured input's range: a simulator is fed with what was asked for, or with what flowed
ROUNDING = 1e-5  # of a command's range: single precision on its way through a file
OFFSETS = 61  # times within the reach, at which the other run is looked at
COVERED = 0.98  # of a real run's time, that a simulated one lasts at least


@dataclass(frozen=True)
class Mismatch:
    """Where two runs first differ in a command."""

    share: float  # of the samples
    text: str


@dataclass(frozen=True)
class RunCommand:
    """One command of a run over the time since the run's start."""

    time: Array
    values: Array
    units: str

    @property
    def interval(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.time)))


def commands_of(run: Run) -> dict[tuple[str, str], RunCommand]:
    """The commands of a run by quantity and role: of each role the outermost setpoint, else what was measured."""
    begin = min((float(run.time(name)[0]) for name in run.streams if run.rows[name]), default=0.0)
    roles = {spec.role for specs in run.streams.values() for spec in specs}
    found = {}
    for role in sorted(roles):
        for quantity in OUTERMOST_FIRST:
            if (command := _command(run.channels(quantity, role), begin)) is not None:
                found[quantity, role] = command
                break
    if not found:
        for quantity in MEASURED:
            if (command := _command(run.channels(quantity), begin)) is not None:
                return {(quantity, "test"): command}
    return found


def _command(channels: Sequence[Channel], begin: float) -> RunCommand | None:
    for channel in channels:
        good = np.isfinite(channel.values)
        if good.sum() >= FEWEST:
            return RunCommand(channel.time[good] - begin, channel.values[good], channel.units)
    return None


def mismatch(real: Run, simulated: Run) -> Mismatch | None:
    """Where a simulated run first has other commands than a real one; None where all are the same.

    Only commands that both runs log are compared.
    """
    ours, theirs = commands_of(real), commands_of(simulated)
    common = [key for key in ours if key in theirs]
    if not common:
        names = [", ".join(f"{quantity} of {role}" for quantity, role in some) or "none" for some in (ours, theirs)]
        return Mismatch(1.0, f"logs other commands ({names[1]}) than {real.path} ({names[0]})")
    for key in common:
        if (found := _difference(key, ours[key], theirs[key], real)) is not None:
            return found
    return None


def _difference(key: tuple[str, str], ours: RunCommand, theirs: RunCommand, real: Run) -> Mismatch | None:
    name = f"{key[0]} of {key[1]}"
    if ours.units != theirs.units:
        return Mismatch(1.0, f"{name} is in {theirs.units}, {real.path} has it in {ours.units}")
    lasts, needed = float(theirs.time[-1]), float(ours.time[-1])
    if lasts < COVERED * needed:
        return Mismatch(1.0, f"{name} ends after {lasts:.6g} s; {real.path} takes {needed:.6g} s")
    tolerance = tolerance_of(ours.values, theirs.values)
    if key[0] in MEASURED:
        tolerance = max(tolerance, REGULATED * float(np.ptp(ours.values)))
    reach = LATEST * max(ours.interval, theirs.interval)
    inside = ours.time <= lasts
    beyond = outside(ours.time[inside], ours.values[inside], theirs, reach) > tolerance
    if not beyond.any():
        return None
    at = int(np.argmax(beyond))
    time, value = float(ours.time[at]), float(ours.values[at])
    other = float(np.interp(time, theirs.time, theirs.values))
    return Mismatch(
        float(np.mean(beyond)),
        f"{name} is {other:.6g} {theirs.units} at {time:.6g} s; {real.path} has {value:.6g} {ours.units} there,"
        f" and the same within {tolerance:.3g} {ours.units} was expected",
    )


def tolerance_of(ours: Array, theirs: Array) -> float:
    """What two logs of one command may differ by: their noise, their steps and single precision."""
    span = float(max(np.ptp(ours), np.ptp(theirs), np.max(np.abs(ours)), np.max(np.abs(theirs))))
    quanta = quantum_of(ours), quantum_of(theirs)
    noise = float(np.hypot(noise_of(ours, 0.0), noise_of(theirs, 0.0)))
    # a command that takes a few levels has steps, and no quantum: rounding is finer than a twentieth of the range
    rounded = 0.5 * sum(quantum for quantum in quanta if quantum < WIDEST * span)
    return min(SURE * noise + rounded, WIDEST * span) + ROUNDING * span


def outside(time: Array, values: Array, other: RunCommand, reach: float) -> Array:
    """How far values lie outside the range that another command has within a reach [s] of the same time."""
    low, high = np.full(len(time), np.inf), np.full(len(time), -np.inf)
    for offset in np.linspace(-reach, reach, OFFSETS):
        seen = np.interp(time + offset, other.time, other.values)
        low, high = np.minimum(low, seen), np.maximum(high, seen)
    return np.asarray(np.maximum(np.maximum(low - values, values - high), 0.0), np.float64)
