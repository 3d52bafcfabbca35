"""Procedure of a bench check: first identities and readings at rest, then, if all are right, a small current."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from leactl.bench.benchfile import BenchFile
from leactl.driver import registry
from leactl.errors import AcceptanceFailed, DeviceError, InputError, LeactlError, Stopped
from leactl.model.motor import Motor
from leactl.protocol import by_hand
from leactl.runfile.read.reader import Run
from leactl.runner.bench_check.at_rest import at_rest, opening_statements
from leactl.runner.bench_check.statement import Statement, wrong
from leactl.runner.bench_check.turning import Turning
from leactl.runner.checked_bench import load_checked
from leactl.runner.drill.emulated import drives
from leactl.runner.dry_run import failures
from leactl.runner.outcome import Outcome
from leactl.runner.request import Request, prepare_by_hand
from leactl.runner.thermal_admission import motors_of
from leactl.safety.thermal.box import Box

READ_S = 0.8  # shorter than a stretch of `stuck_s: 1`: a dead channel is named, and does not trip the bench
STEP_S = 1e-3  # of the forecast of a move: a hundredth of the time constants of actuators, or less
LEAST_SHARE, MOST_SHARE = 0.03, 0.2  # of the continuous current
OVER_FRICTION = 2.0  # current over that which overcomes the friction of the motor files
OF_VELOCITY = 0.5  # of the velocity limit, that a motor of the least friction may reach


@dataclass(frozen=True)
class Move:
    """The currents [A] of a move by role, and how fast [rad/s] and far [rad] they may turn the shaft."""

    currents: Mapping[str, float]
    speed: float
    travel: float

    def __str__(self) -> str:
        each = " and ".join(f"{role} {current:.3g} A" for role, current in self.currents.items())
        far = f"up to {self.speed:.2g} rad/s and {self.travel:.2g} rad"
        return f"one drive after the other swings the shaft, {each}, {far}"

    def check_room(self, run: Run, bench: BenchFile) -> None:
        """Check that limits and interlocks of the angle leave room for the move from where the shaft stands in a run.

        Raises
        ------
        InputError : an angle that the move could carry beyond them.
        """
        for role in self.currents:
            angle = run.channel("angle", role)
            known = angle.values[np.isfinite(angle.values)]
            allowed = [each.window("trip") for each in bench.interlocks.of("angle", role)]
            allowed += [bench.limits.of("angle") or (-math.inf, math.inf)]
            low, high = max(lows for lows, _ in allowed), min(highs for _, highs in allowed)
            if len(known) and not low + self.travel <= known[-1] <= high - self.travel:
                raise InputError(
                    f"--move: {angle.device} stands at {known[-1]:.3g} rad, and the move may turn it by"
                    f" {self.travel:.2g} rad to either side; {low:.3g} to {high:.3g} rad are allowed (limits.angle_rad,"
                    " interlocks.angle): turn the shaft towards the middle by hand, or lower --current"
                )


@dataclass(frozen=True)
class Examined:
    """Statements of a check, and the runs that they are based on."""

    bench: str
    statements: Sequence[Statement]
    outcomes: Sequence[Outcome] = ()
    error: BaseException | None = None  # that ended the check early

    def as_json(self) -> dict[str, Any]:
        """Return the output of `--json`."""
        checks = [each.as_json() for each in self.statements]
        runs = [outcome.as_json() for outcome in self.outcomes]
        return {"bench": self.bench, "checks": checks, "runs": runs}

    def end(self) -> BaseException | None:
        """Return the error that the command ends with, or None."""
        faults = wrong(self.statements)
        if self.error is not None or not faults:
            return self.error
        named = "; ".join(f"{each.device}: {each.about}" for each in faults)
        return AcceptanceFailed(f"{len(faults)} of {len(self.statements)} checks are wrong: {named}")


def reading(bench: str, setup: str, directory: Path, realtime: bool, served: bool, buses: Sequence[str]) -> Request:
    """Return the run that reads every channel with all drives off.

    Raises
    ------
    InputError : as `prepare_by_hand`.
    """
    steps = by_hand.reading_steps(READ_S)
    return prepare_by_hand("check-at-rest", steps, bench, setup, directory, realtime, served, buses, everything=True)


def turning(
    bench: str,
    current: float | None,
    setup: str,
    directory: Path,
    realtime: bool,
    served: bool,
    buses: Sequence[str],
) -> tuple[Request, Move]:
    """Return the run that turns the shaft by one drive after the other, and how far that may go.

    Parameters
    ----------
    current : of each drive [A]; None: twice what the friction of the motor files takes, at least 3 % and at most 20 %
        of the continuous current.

    Raises
    ------
    InputError : as `prepare_by_hand`, a set-up in which no drive turns, or a current that the limits leave no room for.
    """
    file, devices, _document = load_checked(bench)
    setup = setup or file.setup or "coupled"
    if setup not in ("free", "coupled"):
        raise InputError(f"--move: in set-up '{setup}' no drive turns; free or coupled was expected")
    if current is not None and not current > 0.0:
        raise InputError(f"--current {current:g}: a current above 0 A was expected")
    move = _move(file, list(drives(devices).values()), current, setup)
    tare = any(hasattr(registry.load(device.entry.driver), "tare") for device in devices if not device.entry.on_demand)
    steps = by_hand.swinging_steps(move.currents, tare and setup == "coupled")
    return prepare_by_hand("check-swinging", steps, bench, setup, directory, realtime, served, buses), move


def examine(
    reading_run: Request,
    turning_run: tuple[Request, Move] | None,
    perform: Callable[[Request], Outcome],
    agrees: Callable[[], bool],
) -> Examined:
    """Check a bench at rest, and then by turning its shaft if that is asked for, agreed to, and nothing is wrong.

    Parameters
    ----------
    reading_run, turning_run : as `reading` and `turning` return them.
    agrees : asks the person at the bench; called just before the shaft is turned.

    Raises
    ------
    InputError, SafetyTrip, DeviceError, RecordingFailed : as of any run, before it begins.
    """
    name = reading_run.bench.name
    try:
        first = perform(reading_run)
    except DeviceError as error:
        return Examined(name, opening_statements(failures(reading_run)), (), error)
    with Run.open(first.path) as run:
        statements = at_rest(run, reading_run, first.reported)
        examined = Examined(name, statements, (first,), first.error)
        if turning_run is None or examined.end() is not None:
            return examined
        request, move = turning_run
        try:
            move.check_room(run, reading_run.bench)
        except InputError as error:
            return replace(examined, error=error)
    if not agrees():
        return replace(examined, error=Stopped("not confirmed; nothing was moved (--yes confirms without a question)"))
    try:
        second = perform(request)
    except LeactlError as error:
        return replace(examined, error=error)
    with Run.open(second.path) as run:
        statements += Turning(run, request).statements()
    return Examined(name, statements, (first, second), second.error)


def _move(file: BenchFile, roles: Sequence[str], chosen: float | None, setup: str) -> Move:
    """Return the currents of a move, and the most speed and travel of any friction that the motor files allow.

    Raises
    ------
    InputError : no drive, or more speed or travel than the bench's limits allow.
    """
    motors, limits, currents, reached = motors_of(file), file.limits, dict[str, float](), [(0.0, 0.0)]
    for role in roles:
        motor, shaft = motors[role], list(motors.values()) if setup == "coupled" else [motors[role]]
        friction = sum(Box.of(each).coulomb_friction.high for each in shaft) / motor.torque_constant
        rated = motor.continuous_current or limits.current_A
        current = chosen or min(max(OVER_FRICTION * friction, LEAST_SHARE * rated), MOST_SHARE * rated)
        while _swing(motor, shaft, current)[0] > OF_VELOCITY * limits.velocity_rad_s and not chosen:
            current /= 2.0
        currents[role] = float(f"{current:.3g}")
        reached.append(_swing(motor, shaft, currents[role]))
    speeds, travels = zip(*reached, strict=True)  # both drives may turn one shaft the same way
    move = Move(currents, max(speeds), sum(travels) if setup == "coupled" else max(travels))
    if not currents:
        raise InputError(f"--move: bench '{file.name}' has no drive")
    if move.speed > limits.velocity_rad_s:
        raise InputError(f"--move: {move}; the bench's limit is {limits.velocity_rad_s:g} rad/s: lower --current")
    if limits.angle_rad is not None and move.travel > limits.angle_rad:
        raise InputError(f"--move: {move}; the bench's limit is {limits.angle_rad:g} rad: lower --current")
    return move


def _swing(motor: Motor, shaft: Sequence[Motor], current: float) -> tuple[float, float]:
    """Return the highest speed [rad/s] and travel [rad] of a swing by this current [A] and the pause after it.

    The maximum over all friction that the motor files allow: with a little friction a shaft may go farther to one side
    than with none.
    """
    boxes = [Box.of(each) for each in shaft]
    losses = [box.coulomb_friction for box in boxes], [box.viscous_damping for box in boxes]
    levels = (
        np.linspace(sum(bounds.low for bounds in ranges), sum(bounds.high for bounds in ranges), 5) for ranges in losses
    )
    friction, damping = (grid.ravel() for grid in np.meshgrid(*levels))
    inertia = sum(each.rotor_inertia for each in shaft)
    beat = by_hand.swing(np.arange(round(by_hand.SWING_S * by_hand.RATE_HZ)) / by_hand.RATE_HZ)
    cycles = np.append(beat, np.zeros(round(by_hand.REST_S * by_hand.RATE_HZ)))
    speed = angle = fastest = farthest = np.zeros(len(friction))
    for torque in np.repeat(motor.torque_constant * current * cycles, round(1.0 / by_hand.RATE_HZ / STEP_S)):
        pulled = speed + STEP_S / inertia * (torque - damping * speed)
        remaining = np.abs(pulled) - STEP_S / inertia * friction  # friction stops a shaft and never turns it
        speed = np.copysign(np.maximum(remaining, 0.0), pulled)
        angle = angle + STEP_S * speed
        fastest, farthest = np.maximum(fastest, np.abs(speed)), np.maximum(farthest, np.abs(angle))
    return float(fastest.max()), float(farthest.max())
