"""Compare the commands of a simulated run with those of a real one, and find the first difference.

Logs stamp a setpoint at the beginning or the end of its interval, and two clocks may have different rates. So a value
is compared with the range of the other run within a few samples of the same time since the start.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from leactl.gap.search.stamp_fit import MOST_STAMP_DELAY
from leactl.gap.signals.noise import noise_of, quantum_of
from leactl.runfile.read.reader import Channel, Run

Array = npt.NDArray[np.float64]
OUTERMOST_FIRST = ("angle_reference", "velocity_reference", "torque_reference", "q_axis_current_reference")
"""Setpoints, of which the first that a run logs counts: inner setpoints of a cascade are responses of the machine."""
MEASURED_INPUTS = ("q_axis_current", "q_axis_voltage", "line_current")
"""Inputs of a run that logs no setpoint, of which the first that it logs counts."""
FEWEST_SAMPLES = 10  # finite samples of a channel that is compared
NOISE_STDS = 6.0  # standard deviations of both runs' noise that no sample of a long run exceeds by chance
MOST_TOLERANCE_SHARE = 0.05  # of a command's range
MEASURED_TOLERANCE_SHARE = 0.02  # of a measured input's range: the simulator may be driven by the setpoint instead
ROUNDING_SHARE = 1e-5  # of a command's range: single precision in a file
COMPARED_OFFSETS = 61  # number of times within the reach at which the other run is compared
LEAST_DURATION_SHARE = 0.98  # of the real run's duration


@dataclass(frozen=True)
class Mismatch:
    """First difference of two runs in a command."""

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
    """Return commands by (quantity, role): each role's outermost setpoint; if none is logged, a measured input."""
    begin = min((float(run.time(name)[0]) for name in run.streams if run.rows[name]), default=0.0)
    roles = {spec.role for specs in run.streams.values() for spec in specs}
    commands = {}
    for role in sorted(roles):
        for quantity in OUTERMOST_FIRST:
            if (command := _command(run.channels(quantity, role), begin)) is not None:
                commands[quantity, role] = command
                break
    if not commands:
        for quantity in MEASURED_INPUTS:
            if (command := _command(run.channels(quantity), begin)) is not None:
                return {(quantity, "test"): command}
    return commands


def _command(channels: Sequence[Channel], begin: float) -> RunCommand | None:
    for channel in channels:
        finite = np.isfinite(channel.values)
        if finite.sum() >= FEWEST_SAMPLES:
            return RunCommand(channel.time[finite] - begin, channel.values[finite], channel.units)
    return None


def mismatch(real: Run, simulated: Run) -> Mismatch | None:
    """Return the first difference between the commands of two runs; None where all are equal.

    Only commands that both runs log are compared.
    """
    real_commands, simulated_commands = commands_of(real), commands_of(simulated)
    common = [key for key in real_commands if key in simulated_commands]
    if not common:
        names = [
            ", ".join(f"{quantity} of {role}" for quantity, role in commands) or "none"
            for commands in (real_commands, simulated_commands)
        ]
        return Mismatch(1.0, f"logs other commands ({names[1]}) than {real.path} ({names[0]})")
    for key in common:
        if (difference := _difference(key, real_commands[key], simulated_commands[key], real)) is not None:
            return difference
    return None


def _difference(key: tuple[str, str], command: RunCommand, simulated: RunCommand, real: Run) -> Mismatch | None:
    name = f"{key[0]} of {key[1]}"
    if command.units != simulated.units:
        return Mismatch(1.0, f"{name} is in {simulated.units}, {real.path} has it in {command.units}")
    duration, needed = float(simulated.time[-1]), float(command.time[-1])
    if duration < LEAST_DURATION_SHARE * needed:
        return Mismatch(1.0, f"{name} ends after {duration:.6g} s; {real.path} takes {needed:.6g} s")
    tolerance = tolerance_of(command.values, simulated.values)
    if key[0] in MEASURED_INPUTS:
        tolerance = max(tolerance, MEASURED_TOLERANCE_SHARE * float(np.ptp(command.values)))
    reach = MOST_STAMP_DELAY * max(command.interval, simulated.interval)
    inside = command.time <= duration
    beyond = distance_outside(command.time[inside], command.values[inside], simulated, reach) > tolerance
    if not beyond.any():
        return None
    first_beyond = int(np.argmax(beyond))
    time, value = float(command.time[first_beyond]), float(command.values[first_beyond])
    simulated_value = float(np.interp(time, simulated.time, simulated.values))
    return Mismatch(
        float(np.mean(beyond)),
        f"{name} is {simulated_value:.6g} {simulated.units} at {time:.6g} s; {real.path} has {value:.6g}"
        f" {command.units} there, and the same within {tolerance:.3g} {command.units} was expected",
    )


def tolerance_of(ours: Array, theirs: Array) -> float:
    """Return the largest difference allowed between two logs of one command: noise, quantisation, float32 rounding."""
    span = float(max(np.ptp(ours), np.ptp(theirs), np.max(np.abs(ours)), np.max(np.abs(theirs))))
    quanta = quantum_of(ours), quantum_of(theirs)
    noise = float(np.hypot(noise_of(ours, 0.0), noise_of(theirs, 0.0)))
    # a command that takes a few levels has steps, and no quantum: rounding is finer than a twentieth of the range
    rounded = 0.5 * sum(quantum for quantum in quanta if quantum < MOST_TOLERANCE_SHARE * span)
    return min(NOISE_STDS * noise + rounded, MOST_TOLERANCE_SHARE * span) + ROUNDING_SHARE * span


def distance_outside(time: Array, values: Array, other: RunCommand, reach: float) -> Array:
    """Return how far values lie outside the range of another command within `reach` [s] of the same time."""
    low, high = np.full(len(time), np.inf), np.full(len(time), -np.inf)
    for offset in np.linspace(-reach, reach, COMPARED_OFFSETS):
        other_values = np.interp(time + offset, other.time, other.values)
        low, high = np.minimum(low, other_values), np.maximum(high, other_values)
    return np.asarray(np.maximum(np.maximum(low - values, values - high), 0.0), np.float64)
