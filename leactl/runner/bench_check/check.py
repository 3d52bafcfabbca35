"""Check a bench in two runs: identities and readings at rest, then, if all are right, motion by a small current."""

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
from leactl.runner.bench_check.at_rest import opening_statements, statements_at_rest
from leactl.runner.bench_check.statement import Statement, wrong
from leactl.runner.bench_check.turning import Turning
from leactl.runner.checked_bench import load_checked
from leactl.runner.drill.emulated import drives
from leactl.runner.dry_run import opening_failures
from leactl.runner.outcome import Outcome
from leactl.runner.request import Request, prepare_by_hand
from leactl.runner.thermal_admission import motors_of
from leactl.safety.thermal.box import Box

READ_S = 0.8  # less than `stuck_s: 1`, so that a dead channel is reported before it trips the bench
STEP_S = 1e-3  # of the integration of a move: a hundredth of the time constants of actuators, or less
LEAST_CURRENT_SHARE, MOST_CURRENT_SHARE = 0.03, 0.2  # of the continuous current: bounds of the current of a move
FRICTION_MULTIPLE = 2.0  # of the current that overcomes the friction of the motor files
MOST_SPEED_SHARE = 0.5  # of the velocity limit; a current is halved until the shaft stays below this speed


@dataclass(frozen=True)
class Move:
    """The currents of a move, and how fast and how far they may turn the shaft."""

    currents: Mapping[str, float]  # A, by role
    speed: float  # rad/s
    travel: float  # rad, to either side

    def __str__(self) -> str:
        currents = " and ".join(f"{role} {current:.3g} A" for role, current in self.currents.items())
        reach = f"up to {self.speed:.2g} rad/s and {self.travel:.2g} rad"
        return f"one drive after the other swings the shaft, {currents}, {reach}"

    def check_room(self, run: Run, bench: BenchFile) -> None:
        """Check that the move cannot turn the shaft beyond the limits and interlocks of its angle.

        Parameters
        ----------
        run : a run at rest; the move begins at its last angle.

        Raises
        ------
        InputError : an angle that the move could carry beyond a limit or an interlock.
        """
        for role in self.currents:
            angle = run.channel("angle", role)
            readings = angle.values[np.isfinite(angle.values)]
            windows = [interlock.window("trip") for interlock in bench.interlocks.of("angle", role)]
            windows += [bench.limits.of("angle") or (-math.inf, math.inf)]
            low, high = max(low for low, _ in windows), min(high for _, high in windows)
            if len(readings) and not low + self.travel <= readings[-1] <= high - self.travel:
                raise InputError(
                    f"--move: {angle.device} stands at {readings[-1]:.3g} rad, and the move may turn it by"
                    f" {self.travel:.2g} rad to either side; {low:.3g} to {high:.3g} rad are allowed (limits.angle_rad,"
                    " interlocks.angle): turn the shaft towards the middle by hand, or lower --current"
                )


@dataclass(frozen=True)
class BenchCheck:
    """Result of a check: its statements, and the runs that they are based on."""

    bench: str
    statements: Sequence[Statement]
    outcomes: Sequence[Outcome] = ()
    error: BaseException | None = None  # that ended the check early

    def as_json(self) -> dict[str, Any]:
        """Return the check as the JSON object that `--json` prints."""
        checks = [statement.as_json() for statement in self.statements]
        runs = [outcome.as_json() for outcome in self.outcomes]
        return {"bench": self.bench, "checks": checks, "runs": runs}

    def end(self) -> BaseException | None:
        """Return the error that the command ends with, or None."""
        wrong_statements = wrong(self.statements)
        if self.error is not None or not wrong_statements:
            return self.error
        wrong_texts = "; ".join(f"{statement.device}: {statement.about}" for statement in wrong_statements)
        return AcceptanceFailed(f"{len(wrong_statements)} of {len(self.statements)} checks are wrong: {wrong_texts}")


def request_at_rest(
    bench: str, setup: str, directory: Path, realtime: bool, served: bool, buses: Sequence[str]
) -> Request:
    """Return the request for a run that reads every channel with all drives off.

    Raises
    ------
    InputError : as `prepare_by_hand`.
    """
    steps = by_hand.reading_steps(READ_S)
    return prepare_by_hand("check-at-rest", steps, bench, setup, directory, realtime, served, buses, everything=True)


def request_turning(
    bench: str,
    current: float | None,
    setup: str,
    directory: Path,
    realtime: bool,
    served: bool,
    buses: Sequence[str],
) -> tuple[Request, Move]:
    """Return the request for a run that turns the shaft by one drive after the other, and the move that it makes.

    Parameters
    ----------
    current : of each drive [A]; None: `FRICTION_MULTIPLE` times the current that overcomes the friction of the motor
        files, within `LEAST_CURRENT_SHARE` and `MOST_CURRENT_SHARE` of the continuous current.

    Raises
    ------
    InputError : as `prepare_by_hand`, a set-up in which no drive turns, a current that is not above 0, or a move with
        more speed or travel than the limits of the bench allow.
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


def check_bench(
    reading_run: Request,
    turning_run: tuple[Request, Move] | None,
    perform: Callable[[Request], Outcome],
    agrees: Callable[[], bool],
) -> BenchCheck:
    """Check a bench at rest and then, if nothing is wrong and a person agrees, by turning its shaft.

    Parameters
    ----------
    reading_run, turning_run : as `request_at_rest` and `request_turning` return them; None: the shaft is not turned.
    perform : executes a request.
    agrees : asks the person at the bench; called just before the shaft is turned.

    Raises
    ------
    InputError, SafetyTrip, DeviceError, RecordingFailed : as of any run, before it begins.
    """
    name = reading_run.bench.name
    try:
        at_rest_outcome = perform(reading_run)
    except DeviceError as error:
        return BenchCheck(name, opening_statements(opening_failures(reading_run)), (), error)
    with Run.open(at_rest_outcome.path) as run:
        statements = statements_at_rest(run, reading_run, at_rest_outcome.reported)
        checked = BenchCheck(name, statements, (at_rest_outcome,), at_rest_outcome.error)
        if turning_run is None or checked.end() is not None:
            return checked
        request, move = turning_run
        try:
            move.check_room(run, reading_run.bench)
        except InputError as error:
            return replace(checked, error=error)
    if not agrees():
        return replace(checked, error=Stopped("not confirmed; nothing was moved (--yes confirms without a question)"))
    try:
        turning_outcome = perform(request)
    except LeactlError as error:
        return replace(checked, error=error)
    with Run.open(turning_outcome.path) as run:
        statements += Turning(run, request).statements()
    return BenchCheck(name, statements, (at_rest_outcome, turning_outcome), turning_outcome.error)


def _move(file: BenchFile, roles: Sequence[str], chosen_current: float | None, setup: str) -> Move:
    """Return the currents of a move, with the highest speed and travel within the friction of the motor files.

    Parameters
    ----------
    chosen_current : of each drive [A]; None: see `request_turning`.

    Raises
    ------
    InputError : the bench has no drive, or its limits allow less speed or travel.
    """
    motors, limits, currents, swings = motors_of(file), file.limits, dict[str, float](), [(0.0, 0.0)]
    for role in roles:
        motor, turned_motors = motors[role], list(motors.values()) if setup == "coupled" else [motors[role]]
        friction = (
            sum(Box.of(turned_motor).coulomb_friction.high for turned_motor in turned_motors) / motor.torque_constant
        )
        rated = motor.continuous_current or limits.current_A
        current = chosen_current or min(
            max(FRICTION_MULTIPLE * friction, LEAST_CURRENT_SHARE * rated), MOST_CURRENT_SHARE * rated
        )
        while (
            _swing(motor, turned_motors, current)[0] > MOST_SPEED_SHARE * limits.velocity_rad_s and not chosen_current
        ):
            current /= 2.0
        currents[role] = float(f"{current:.3g}")
        swings.append(_swing(motor, turned_motors, currents[role]))
    speeds, travels = zip(*swings, strict=True)  # both drives may turn one shaft the same way
    move = Move(currents, max(speeds), sum(travels) if setup == "coupled" else max(travels))
    if not currents:
        raise InputError(f"--move: bench '{file.name}' has no drive")
    if move.speed > limits.velocity_rad_s:
        raise InputError(f"--move: {move}; the bench's limit is {limits.velocity_rad_s:g} rad/s: lower --current")
    if limits.angle_rad is not None and move.travel > limits.angle_rad:
        raise InputError(f"--move: {move}; the bench's limit is {limits.angle_rad:g} rad: lower --current")
    return move


def _swing(motor: Motor, turned_motors: Sequence[Motor], current: float) -> tuple[float, float]:
    """Return the highest speed [rad/s] and travel [rad] of one swing of the shaft and the pause after it.

    The maxima are over the ranges of friction in the motor files: with a little friction a shaft may go farther to one
    side than with none.

    Parameters
    ----------
    motor : the motor that drives the swing.
    turned_motors : all motors on the shaft.
    current : amplitude of the swing [A].
    """
    boxes = [Box.of(turned_motor) for turned_motor in turned_motors]
    losses = [box.coulomb_friction for box in boxes], [box.viscous_damping for box in boxes]
    levels = (
        np.linspace(sum(bounds.low for bounds in ranges), sum(bounds.high for bounds in ranges), 5) for ranges in losses
    )
    friction, damping = (grid.ravel() for grid in np.meshgrid(*levels))
    inertia = sum(turned_motor.rotor_inertia for turned_motor in turned_motors)
    waveform = by_hand.swing(np.arange(round(by_hand.SWING_S * by_hand.RATE_HZ)) / by_hand.RATE_HZ)
    torque_shape = np.append(waveform, np.zeros(round(by_hand.REST_S * by_hand.RATE_HZ)))
    speed = angle = fastest = farthest = np.zeros(len(friction))
    for torque in np.repeat(motor.torque_constant * current * torque_shape, round(1.0 / by_hand.RATE_HZ / STEP_S)):
        before_friction = speed + STEP_S / inertia * (torque - damping * speed)
        remaining = np.abs(before_friction) - STEP_S / inertia * friction  # friction stops a shaft and never turns it
        speed = np.copysign(np.maximum(remaining, 0.0), before_friction)
        angle = angle + STEP_S * speed
        fastest, farthest = np.maximum(fastest, np.abs(speed)), np.maximum(farthest, np.abs(angle))
    return float(fastest.max()), float(farthest.max())
