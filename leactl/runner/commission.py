"""Bring an actuator to where a heated protocol is admitted: short heats, a narrower motor file, the next heat longer.

Each heat is as long as the forecast admits by the motor file so far; all of them together make the next file. Nothing
of the guard changes but the tolerances that it takes from that file.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import yaml

from leactl.analysis.analyze import refuse_altered, refuse_repeated
from leactl.analysis.heating.narrowing import Accuracy, narrowed
from leactl.analysis.quality.gate import channel_doubts
from leactl.errors import InputError
from leactl.model.motor import Motor, load_motor
from leactl.runfile.publish import replacement
from leactl.runfile.read.reader import Run
from leactl.runner import locks
from leactl.runner.dry_run import dry_run
from leactl.runner.outcome import Outcome
from leactl.runner.request import Request
from leactl.runner.thermal_admission import Windings
from leactl.runner.thermal_memory import Recalled
from leactl.safety.thermal.foresight import Forecast

HEATING, COOLING = "heating_s", "cooling_s"  # parameters of the protocol
SHARE = 0.9  # of the time after which the forecast passes the limit
FALLING = 0.8  # of a heat that the forecast does not admit either
SHORTEST_S = 60.0  # of a heat that tells anything
ON = 0.5  # of the largest current, above which a reading counts as heating
LONGER = 3.0  # times the longest heat so far, that the next one may last: a body that warms later shows by then
CONSTANTS = 2.0  # of the housing, for which a short heat cools

Prepare = Callable[[Mapping[str, str]], Request]
"""The request of the protocol with these parameters in place of its own."""
Perform = Callable[[Request, str], Outcome]


@dataclass(frozen=True)
class Heat:
    """One heated run of a commissioning."""

    path: Path
    heating_s: float
    whole: bool  # the protocol as it was asked for


@dataclass
class Commissioned:
    """How far an actuator came."""

    motor: Motor
    file: Path | None  # the narrowed motor file; None where the one of the bench admits the protocol
    heating_s: float  # of the protocol as it was asked for
    forecast: Forecast  # of that protocol, by `motor`
    limit: float  # degC, for the forecast
    load_motor: str  # the bench's motor file of the other actuator
    heats: list[Heat] = field(default_factory=list)
    next_heating_s: float | None = None  # where no run was to be made, what the next one would be
    longest_s: float = math.inf  # that a heat may last by the ones that its file is made of

    @property
    def admitted(self) -> bool:
        """Whether the protocol may be run as asked for: below the limit, and no longer than the file is good for."""
        return self.forecast.passing is None and self.heating_s <= self.longest_s


@dataclass(frozen=True)
class CommissionOptions:
    """How an actuator is commissioned."""

    prepare: Prepare
    perform: Perform
    tell: Callable[[str], None]
    most: int  # runs, the whole protocol and those that are given included
    given: Sequence[Path] = ()  # heated runs of this actuator that are there already
    accuracy: Accuracy = field(default_factory=Accuracy)
    cold: bool = False  # a person says that nothing has heated the actuators before the first run
    dry_run: bool = False  # make no run


def commission(manner: CommissionOptions, file: Path) -> Commissioned:
    """Heat step by step until the protocol is admitted, and run it; the narrowed motor file is written after each heat.

    Raises
    ------
    InputError : a protocol without heats to shorten, no heat that is admitted, or the protocol not admitted at the end.
    AcceptanceFailed : the actuator is outside of the tolerances of its file.
    SafetyTrip, DeviceError, Stopped : of a run; its file and those before stay, and may be given to the next start.
    """
    asked = manner.prepare({})
    _refuse_other(asked)
    _refuse_own(file, asked.bench.motors.values())
    shipped = load_motor(asked.bench.motors["test"])[0]
    judged, told = _judged(asked, shipped, None), list(manner.given)
    if told:
        motor = _narrowed(asked, shipped, told, manner)
        judged = judged if judged.admitted else _written(asked, motor, told, file)
    manner.tell(_state(judged))
    if manner.dry_run:
        request = asked if judged.admitted else _shorter(manner, judged)
        dry_run(_by(request, judged.file))
        judged.next_heating_s = _heating(request)
        return judged
    while not judged.admitted and len(told) < manner.most - 1:
        request = _shorter(manner, judged)
        told.append(_heated(request, judged, manner, len(told)))
        heats = [*judged.heats, Heat(told[-1], _heating(request), whole=False)]
        judged = _written(asked, _narrowed(asked, shipped, told, manner), told, file)
        judged.heats = heats
        manner.tell(_state(judged))
    if not judged.admitted:
        raise InputError(
            f"protocol '{asked.plan.name}' is not admitted after {len(told)} heated runs, with {manner.most} at most:"
            f" {_state(judged)}; lower its current, tell the camera's own accuracy, or allow more --runs"
        )
    judged.heats = [*judged.heats, Heat(_heated(asked, judged, manner, len(told)), _heating(asked), whole=True)]
    return judged


def _heated(request: Request, judged: Commissioned, manner: CommissionOptions, before: int) -> Path:
    """Make one run by the motor file so far.

    Raises
    ------
    SafetyTrip, DeviceError, Stopped : it did not come to its end.
    """
    request = replace(_by(request, judged.file), insert_cooldown=True, cold=manner.cold and not judged.heats)
    outcome = manner.perform(request, f"run {before + 1} of {manner.most} at most: ")
    if outcome.error is not None:
        raise outcome.error
    return outcome.path


def _heating(request: Request) -> float:
    return float(request.plan.parameters[HEATING])


def _refuse_other(request: Request) -> None:
    plan = request.plan
    lacking = [name for name in (HEATING, COOLING) if name not in plan.parameters]
    if plan.analysis != "thermal" or lacking:
        raise InputError(
            f"protocol '{plan.name}': a heated protocol was expected, with `analysis: thermal` and the parameters"
            f" {HEATING} and {COOLING}"
        )
    if not request.actuator:
        raise InputError("--actuator: which one is commissioned was expected; a narrowed motor file is of one alone")


def _refuse_own(file: Path, motors: Iterable[str]) -> None:
    """Refuse to replace a motor file that the bench names: what it tells is what the narrowed one is held against."""
    if file.exists() and any(Path(name).exists() and file.samefile(name) for name in motors):
        raise InputError(f"--file {file}: is the motor file that the bench names; name another one")


def _judged(asked: Request, motor: Motor, file: Path | None) -> Commissioned:
    """What the protocol would do to windings that are cold, by a motor file."""
    request = _by(asked, file)
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, cold=True)
    load = asked.bench.motors.get("load", asked.bench.motors["test"])
    forecast, limit = windings.forecast(request.plan), windings.settings.limit
    return Commissioned(motor, file, _heating(request), forecast, limit, load)


def _by(request: Request, file: Path | None) -> Request:
    """The request on the same bench with another motor file for the actuator under test."""
    if file is None:
        return request
    motors = request.bench.motors | {"test": str(file.resolve())}
    if "load" not in request.bench.motors:
        motors |= {"load": request.bench.motors["test"]}  # which had been taken to be like the other one
    return replace(request, bench=request.bench.model_copy(update={"motors": motors}))


def _shorter(manner: CommissionOptions, judged: Commissioned) -> Request:
    """The protocol with as long a heat as is admitted, and a cooling that tells the housing.

    Raises
    ------
    InputError : no heat that is long enough.
    """
    asked, passing = manner.prepare({}), judged.forecast.passing
    seconds = min(_heating(asked), judged.longest_s)
    if passing is not None:
        row = max(asked.plan.timeline(), key=lambda one: one.duration_s if one.name == "heating" else 0.0)
        seconds = min(seconds, SHARE * (passing.time_s - row.start_s))
    network = judged.motor.thermal
    constant = network.housing_capacitance * (network.housing_ambient_resistance + network.winding_housing_resistance)
    cooling = min(float(asked.plan.parameters[COOLING]), math.ceil(CONSTANTS * constant))
    while seconds >= SHORTEST_S:
        request = manner.prepare({HEATING: f"{math.floor(seconds)}", COOLING: f"{cooling:g}"})
        if _judged(request, judged.motor, judged.file).admitted:
            return request
        seconds *= FALLING
    told = "" if passing is None else f" step '{passing.step}' may take the {passing.role} winding to its limit after"
    told += "" if passing is None else f" {passing.time_s:.0f} s, and"
    raise InputError(
        f"protocol '{asked.plan.name}':{told} no heat of {SHORTEST_S:g} s or more is admitted; lower its current"
    )


def _narrowed(asked: Request, shipped: Motor, told: Sequence[Path], manner: CommissionOptions) -> Motor:
    with ExitStack() as opened:
        runs = [opened.enter_context(Run.open(path)) for path in told]
        _refuse_others(runs, asked)
        refuse_repeated(runs)
        refuse_altered(runs)
        for note in dict.fromkeys(note for run in runs for note in channel_doubts(run)):
            manner.tell(note)
        return narrowed(shipped, runs, manner.accuracy)


def _written(asked: Request, motor: Motor, told: Sequence[Path], file: Path) -> Commissioned:
    """Write the motor file of all heats so far, and judge the protocol by it.

    To the memory of the windings a narrowed file is another motor file, of which it would know nothing. What is known
    of the actuator by the file before holds by this one as well, so it is kept again.
    """
    with nullcontext() if asked.in_process else locks.held(asked.bench, asked.devices):
        known = _known(asked, file)
        _write(file, motor, asked.actuator, told)
        request = _by(asked, file)
        Windings(request.bench, request.devices, request.actuator, request.in_process, recalled=known).keep_as_found()
    found = _judged(asked, load_motor(str(file))[0], file)
    found.longest_s = LONGER * max(_heated_s(path) for path in told)
    return found


def _heated_s(path: Path) -> float:
    """How long a run was heated [s]."""
    with Run.open(path) as run:
        current = run.channel("line_current")
        on = np.abs(current.values) > ON * np.nanmax(np.abs(current.values))
        return float(np.sum(np.diff(current.time)[on[1:] & on[:-1]]))


def _known(asked: Request, file: Path) -> Mapping[str, Recalled]:
    """The lower of the bounds that the memory has by the bench's own motor file and by an earlier narrowed one."""
    requests = [asked, *([_by(asked, file)] if file.exists() else [])]
    several = [Windings(one.bench, one.devices, one.actuator, one.in_process).recalled for one in requests]
    return {role: min((one[role] for one in several), key=lambda one: float(one.nodes[0])) for role in several[0]}


def _refuse_others(runs: Sequence[Run], asked: Request) -> None:
    """Refuse runs of another actuator or of another bench, whose instruments read otherwise, and emulated ones."""
    emulated, faults = asked.bench.emulated is not None, []
    for run in runs:
        if (of := str(run.attributes.get("actuator", ""))) != asked.actuator:
            faults.append(f"{run.path}: of actuator '{of}'; '{asked.actuator}' was expected")
        if (at := str(run.attributes.get("bench", ""))) != asked.bench.name:
            faults.append(f"{run.path}: of bench '{at}'; '{asked.bench.name}' was expected: its supply, its camera")
        if bool(run.attributes.get("simulated")) and not emulated:
            faults.append(f"{run.path}: simulated; a run of the real bench '{asked.bench.name}' was expected")
    if faults:
        raise InputError(faults)


def _write(file: Path, motor: Motor, actuator: str, told: Sequence[Path]) -> None:
    head = [
        f"# Actuator {actuator}, commissioned {datetime.now(UTC):%Y-%m-%d} by `leactl thermal commission` from",
        *(f"#   {path.name}" for path in told),
        "# For this actuator, its mounting and the supply and camera of these runs alone.",
    ]
    body = yaml.safe_dump(motor.model_dump(exclude_none=True, exclude_defaults=True), sort_keys=False)
    with replacement(file) as beside:
        beside.write_text("\n".join([*head, body]), encoding="utf-8")


def _state(judged: Commissioned) -> str:
    by = judged.file.name if judged.file is not None else f"the tolerances of motor '{judged.motor.name}'"
    passing = judged.forecast.passing
    if passing is None:
        told = f"by {by}: at most {judged.forecast.peaks['test']:.1f} degC of {judged.limit:.1f}, admitted"
        return told if judged.admitted else f"{told} for heats of up to {judged.longest_s:.0f} s"
    return f"by {by}: up to {judged.limit:.1f} degC after {passing.time_s:.0f} s in step '{passing.step}', not admitted"
