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
"""Setpoints, of which the first that a run logs is compared: inner setpoints of a cascade are responses."""
MEASURED_INPUTS = ("q_axis_current", "q_axis_voltage", "line_current")
"""Inputs of a run that logs no setpoint, of which the first that it logs is compared."""
FEWEST_SAMPLES = 10  # finite samples of a channel that is compared
NOISE_STDS = 6.0  # standard deviations of both runs' noise that no sample of a long run exceeds by chance
MOST_TOLERANCE_SHARE = 0.05  # largest tolerance, as a share of a command's span
MEASURED_TOLERANCE_SHARE = 0.02  # share of a measured input's range; a setpoint may drive the simulator instead
ROUNDING_SHARE = 1e-5  # share of a command's span, for single precision in a file
COMPARED_OFFSETS = 61  # number of time offsets within the reach at which the other run is compared
LEAST_DURATION_SHARE = 0.98  # shortest simulated run, as a share of the real run's duration


@dataclass(frozen=True)
class Mismatch:
    """First difference of two runs in a command, and how much of the command differs."""

    share: float  # of the real run's samples that differ
    text: str  # message on the simulated run, without its path


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
            if (command := _first_command(run.channels(quantity, role), begin)) is not None:
                commands[quantity, role] = command
                break
    if not commands:
        for quantity in MEASURED_INPUTS:
            if (command := _first_command(run.channels(quantity), begin)) is not None:
                return {(quantity, "test"): command}
    return commands


def _first_command(channels: Sequence[Channel], begin: float) -> RunCommand | None:
    """Return the finite samples of the first channel that has enough; None if no channel has."""
    for channel in channels:
        finite = np.isfinite(channel.values)
        if finite.sum() >= FEWEST_SAMPLES:
            return RunCommand(channel.time[finite] - begin, channel.values[finite], channel.units)
    return None


def mismatch(real: Run, simulated: Run) -> Mismatch | None:
    """Return the first difference between the commands of two runs; None if all are equal.

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
        if (difference := _command_difference(key, real_commands[key], simulated_commands[key], real)) is not None:
            return difference
    return None


def _command_difference(
    key: tuple[str, str], real_command: RunCommand, simulated_command: RunCommand, real_run: Run
) -> Mismatch | None:
    """Return the first difference of one command; None if it is equal within the tolerance."""
    name = f"{key[0]} of {key[1]}"
    if real_command.units != simulated_command.units:
        return Mismatch(1.0, f"{name} is in {simulated_command.units}, {real_run.path} has it in {real_command.units}")
    simulated_duration, real_duration = float(simulated_command.time[-1]), float(real_command.time[-1])
    if simulated_duration < LEAST_DURATION_SHARE * real_duration:
        return Mismatch(
            1.0, f"{name} ends after {simulated_duration:.6g} s; {real_run.path} takes {real_duration:.6g} s"
        )
    tolerance = tolerance_of(real_command.values, simulated_command.values)
    if key[0] in MEASURED_INPUTS:
        tolerance = max(tolerance, MEASURED_TOLERANCE_SHARE * float(np.ptp(real_command.values)))
    reach = MOST_STAMP_DELAY * max(real_command.interval, simulated_command.interval)
    within_duration = real_command.time <= simulated_duration
    is_outside = (
        distance_outside(
            real_command.time[within_duration], real_command.values[within_duration], simulated_command, reach
        )
        > tolerance
    )
    if not is_outside.any():
        return None
    first_outside = int(np.argmax(is_outside))
    time, real_value = float(real_command.time[first_outside]), float(real_command.values[first_outside])
    simulated_value = float(np.interp(time, simulated_command.time, simulated_command.values))
    return Mismatch(
        float(np.mean(is_outside)),
        f"{name} is {simulated_value:.6g} {simulated_command.units} at {time:.6g} s;"
        f" {real_run.path} has {real_value:.6g} {real_command.units} there,"
        f" and the same within {tolerance:.3g} {real_command.units} was expected",
    )


def tolerance_of(real_values: Array, simulated_values: Array) -> float:
    """Return the largest difference between two logs of one command that noise, quantisation and float32 explain."""
    span = float(
        max(
            np.ptp(real_values), np.ptp(simulated_values), np.max(np.abs(real_values)), np.max(np.abs(simulated_values))
        )
    )
    quanta = quantum_of(real_values), quantum_of(simulated_values)
    noise = float(np.hypot(noise_of(real_values, 0.0), noise_of(simulated_values, 0.0)))
    # a command that takes a few levels has steps, and no quantum: rounding is finer than a twentieth of the range
    rounding = 0.5 * sum(quantum for quantum in quanta if quantum < MOST_TOLERANCE_SHARE * span)
    return min(NOISE_STDS * noise + rounding, MOST_TOLERANCE_SHARE * span) + ROUNDING_SHARE * span


def distance_outside(time: Array, values: Array, other: RunCommand, reach: float) -> Array:
    """Return how far values lie outside the range of another command within `reach` [s] of the same time."""
    lowest, highest = np.full(len(time), np.inf), np.full(len(time), -np.inf)
    for offset in np.linspace(-reach, reach, COMPARED_OFFSETS):
        other_values = np.interp(time + offset, other.time, other.values)
        lowest, highest = np.minimum(lowest, other_values), np.maximum(highest, other_values)
    return np.asarray(np.maximum(np.maximum(lowest - values, values - highest), 0.0), np.float64)
