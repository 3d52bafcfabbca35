"""Commission an actuator for a heated protocol: heats of growing length, each followed by a narrower motor file.

Each heat is as long as the forecast by the latest motor file admits; all heats together make the next file. Nothing in
the guard changes except the tolerances, which it takes from that file.
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
from leactl.analysis.heating.narrowing import Accuracy, narrow_tolerances
from leactl.analysis.quality.channel_plausibility import channel_doubts
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
HEATING_TIME_SHARE = 0.9  # a heat may last this share of the time until the forecast passes the limit
SHORTENING_FACTOR = 0.8  # from one heat to the next shorter one, while the forecast does not admit it
SHORTEST_HEAT_S = 60.0  # a shorter heat does not narrow a motor file
HEATING_CURRENT_SHARE = 0.5  # a reading above this share of the largest current counts as heating
MOST_HEAT_GROWTH = 3.0  # longest next heat over the longest so far: a body that warms later shows within it
COOLING_TIME_CONSTANTS = 2.0  # a bench cools for as many time constants of the housing after a short heat

Prepare = Callable[[Mapping[str, str]], Request]
"""Returns the request of the protocol, with these parameters replaced."""
Perform = Callable[[Request, str], Outcome]


@dataclass(frozen=True)
class Heat:
    """One heated run of a commissioning."""

    path: Path
    heating_s: float
    whole: bool  # whether it was the whole protocol


@dataclass
class Commissioned:
    """State of a commissioning: motor file, forecast of the protocol by it, and the heats so far."""

    motor: Motor
    file: Path | None  # the narrowed motor file; None if the bench's motor file admits the protocol
    heating_s: float  # of the whole protocol
    forecast: Forecast  # of that protocol, by `motor`
    limit: float  # degC, for the forecast
    load_motor: str  # the bench's motor file of the other actuator
    heats: list[Heat] = field(default_factory=list)
    next_heating_s: float | None = None  # of the next heat, in a dry run
    longest_s: float = math.inf  # longest heat that the heats behind the motor file allow

    @property
    def admitted(self) -> bool:
        """Whether the whole protocol may be run: below the limit, and with a heat no longer than `longest_s`."""
        return self.forecast.passing is None and self.heating_s <= self.longest_s


@dataclass(frozen=True)
class CommissionOptions:
    """Options of a commissioning."""

    prepare: Prepare
    perform: Perform
    tell: Callable[[str], None]
    most: int  # largest number of runs, including that of the whole protocol and the `given` runs
    given: Sequence[Path] = ()  # earlier heated runs of this actuator
    accuracy: Accuracy = field(default_factory=Accuracy)
    cold: bool = False  # a person says that nothing has heated the actuators before the first run
    dry_run: bool = False  # make no run


def commission(options: CommissionOptions, file: Path) -> Commissioned:
    """Heat step by step until the protocol is admitted, then run it; write the narrowed motor file after each heat.

    Raises
    ------
    InputError : a protocol without heats to shorten, no heat that is admitted, or the protocol not admitted at the end.
    AcceptanceFailed : the actuator is outside of the tolerances of its file.
    SafetyTrip, DeviceError, Stopped : a run ended early; its file and earlier ones remain, for `given` of a later call.
    """
    whole_request = options.prepare({})
    _require_heated_protocol(whole_request)
    _refuse_bench_motor_file(file, whole_request.bench.motors.values())
    shipped = load_motor(whole_request.bench.motors["test"])[0]
    state, paths = _forecast_state(whole_request, shipped, None), list(options.given)
    if paths:
        motor = _narrowed_motor(whole_request, shipped, paths, options)
        state = state if state.admitted else _store_motor(whole_request, motor, paths, file)
    options.tell(_state_text(state))
    if options.dry_run:
        request = whole_request if state.admitted else _shortened_request(options, state)
        dry_run(_with_motor_file(request, state.file))
        state.next_heating_s = _planned_heating_s(request)
        return state
    while not state.admitted and len(paths) < options.most - 1:
        request = _shortened_request(options, state)
        paths.append(_run_heat(request, state, options, len(paths)))
        heats = [*state.heats, Heat(paths[-1], _planned_heating_s(request), whole=False)]
        state = _store_motor(whole_request, _narrowed_motor(whole_request, shipped, paths, options), paths, file)
        state.heats = heats
        options.tell(_state_text(state))
    if not state.admitted:
        raise InputError(
            f"protocol '{whole_request.plan.name}' is not admitted after {len(paths)} heated runs, with {options.most}"
            f" at most: {_state_text(state)}; lower its current, tell the camera's own accuracy, or allow more --runs"
        )
    state.heats = [
        *state.heats,
        Heat(_run_heat(whole_request, state, options, len(paths)), _planned_heating_s(whole_request), whole=True),
    ]
    return state


def _run_heat(request: Request, state: Commissioned, options: CommissionOptions, count: int) -> Path:
    """Make one run by the latest motor file; return the path of its recording.

    Raises
    ------
    SafetyTrip, DeviceError, Stopped : the run ended early.
    """
    request = replace(
        _with_motor_file(request, state.file), insert_cooldown=True, cold=options.cold and not state.heats
    )
    outcome = options.perform(request, f"run {count + 1} of {options.most} at most: ")
    if outcome.error is not None:
        raise outcome.error
    return outcome.path


def _planned_heating_s(request: Request) -> float:
    """Return the duration of the heat in a request [s]."""
    return float(request.plan.parameters[HEATING])


def _require_heated_protocol(request: Request) -> None:
    """Raise InputError for a protocol that is not heated, or a request without an actuator's label."""
    plan = request.plan
    missing_parameters = [name for name in (HEATING, COOLING) if name not in plan.parameters]
    if plan.analysis != "thermal" or missing_parameters:
        raise InputError(
            f"protocol '{plan.name}': a heated protocol was expected, with `analysis: thermal` and the parameters"
            f" {HEATING} and {COOLING}"
        )
    if not request.actuator:
        raise InputError("--actuator: which one is commissioned was expected; a narrowed motor file is of one alone")


def _refuse_bench_motor_file(file: Path, motors: Iterable[str]) -> None:
    """Raise InputError if `file` is a motor file that the bench names, whose tolerances are those to be narrowed.

    motors : names or paths of the bench's motor files.
    """
    if file.exists() and any(Path(name).exists() and file.samefile(name) for name in motors):
        raise InputError(f"--file {file}: is the motor file that the bench names; name another one")


def _forecast_state(whole_request: Request, motor: Motor, file: Path | None) -> Commissioned:
    """Return the forecast of the protocol on cold windings, by a motor file; None is the bench's own file."""
    request = _with_motor_file(whole_request, file)
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, cold=True)
    load_motor_name = whole_request.bench.motors.get("load", whole_request.bench.motors["test"])
    forecast, limit = windings.forecast(request.plan), windings.settings.limit
    return Commissioned(motor, file, _planned_heating_s(request), forecast, limit, load_motor_name)


def _with_motor_file(request: Request, file: Path | None) -> Request:
    """Return the request with another motor file for the actuator under test on the same bench."""
    if file is None:
        return request
    bench = request.bench
    motors = bench.motors | {"test": str(file.resolve())}
    if "load" not in bench.motors:
        motors |= {"load": bench.motors["test"]}  # without an entry, the load has the motor file of `test`
    emulated = bench.emulated
    if emulated is not None:  # the emulated actuator stays the same, whatever motor file describes it
        emulated = emulated.model_copy(update={"motors": {"test": bench.motors["test"], **emulated.motors}})
    return replace(request, bench=bench.model_copy(update={"motors": motors, "emulated": emulated}))


def _shortened_request(options: CommissionOptions, state: Commissioned) -> Request:
    """Return a request with the longest admitted heat, and with a cooling long enough to identify the housing.

    Raises
    ------
    InputError : no heat of `SHORTEST_HEAT_S` or more is admitted.
    """
    whole_request, passing = options.prepare({}), state.forecast.passing
    seconds = min(_planned_heating_s(whole_request), state.longest_s)
    if passing is not None:
        heating = max(whole_request.plan.timeline(), key=lambda row: row.duration_s if row.name == "heating" else 0.0)
        seconds = min(seconds, HEATING_TIME_SHARE * (passing.time_s - heating.start_s))
    network = state.motor.thermal
    constant = network.housing_capacitance * (network.housing_ambient_resistance + network.winding_housing_resistance)
    cooling = min(float(whole_request.plan.parameters[COOLING]), math.ceil(COOLING_TIME_CONSTANTS * constant))
    while seconds >= SHORTEST_HEAT_S:
        request = options.prepare({HEATING: f"{math.floor(seconds)}", COOLING: f"{cooling:g}"})
        if _forecast_state(request, state.motor, state.file).admitted:
            return request
        seconds *= SHORTENING_FACTOR
    reason = "" if passing is None else f" step '{passing.step}' may take the {passing.role} winding to its limit after"
    reason += "" if passing is None else f" {passing.time_s:.0f} s, and"
    raise InputError(
        f"protocol '{whole_request.plan.name}':{reason} no heat of {SHORTEST_HEAT_S:g} s or more is admitted; lower"
        " its current"
    )


def _narrowed_motor(whole_request: Request, shipped: Motor, paths: Sequence[Path], options: CommissionOptions) -> Motor:
    """Return the motor with tolerances narrowed by all heats so far.

    Raises
    ------
    InputError : a run of another actuator or bench, or one that is given twice or was altered.
    AcceptanceFailed : the actuator is outside of the tolerances of its file.
    """
    with ExitStack() as open_runs:
        runs = [open_runs.enter_context(Run.open(path)) for path in paths]
        _refuse_foreign_runs(runs, whole_request)
        refuse_repeated(runs)
        refuse_altered(runs)
        for note in dict.fromkeys(note for run in runs for note in channel_doubts(run)):
            options.tell(note)
        return narrow_tolerances(shipped, runs, options.accuracy)


def _store_motor(whole_request: Request, motor: Motor, paths: Sequence[Path], file: Path) -> Commissioned:
    """Write the motor file of all heats so far, and return the forecast of the protocol by it.

    The memory of the windings knows nothing about a new motor file. The bounds by the previous file hold for the new
    one as well, so they are written again.
    """
    with nullcontext() if whole_request.in_process else locks.held(whole_request.bench, whole_request.devices):
        known_bounds = _known_bounds(whole_request, file)
        _write_motor_file(file, motor, whole_request.actuator, paths)
        request = _with_motor_file(whole_request, file)
        Windings(
            request.bench, request.devices, request.actuator, request.in_process, recalled=known_bounds
        ).keep_as_found()
    state = _forecast_state(whole_request, load_motor(str(file))[0], file)
    state.longest_s = MOST_HEAT_GROWTH * max(_measured_heating_s(path) for path in paths)
    return state


def _measured_heating_s(path: Path) -> float:
    """Return how long a run was heated [s]."""
    with Run.open(path) as run:
        current = run.channel("line_current")
        is_heating = np.abs(current.values) > HEATING_CURRENT_SHARE * np.nanmax(np.abs(current.values))
        return float(np.sum(np.diff(current.time)[is_heating[1:] & is_heating[:-1]]))


def _known_bounds(whole_request: Request, file: Path) -> Mapping[str, Recalled]:
    """Return the lower bounds that the memory has by the bench's own motor file and by an earlier narrowed file."""
    requests = [whole_request, *([_with_motor_file(whole_request, file)] if file.exists() else [])]
    recalled = [
        Windings(request.bench, request.devices, request.actuator, request.in_process).recalled for request in requests
    ]
    return {
        role: min((by_role[role] for by_role in recalled), key=lambda bounds: float(bounds.nodes[0]))
        for role in recalled[0]
    }


def _refuse_foreign_runs(runs: Sequence[Run], whole_request: Request) -> None:
    """Raise InputError for runs of another actuator or another bench, and for simulated runs of a real bench."""
    emulated, faults = whole_request.bench.emulated is not None, []
    for run in runs:
        if (actuator := str(run.attributes.get("actuator", ""))) != whole_request.actuator:
            faults.append(f"{run.path}: of actuator '{actuator}'; '{whole_request.actuator}' was expected")
        if (bench := str(run.attributes.get("bench", ""))) != whole_request.bench.name:
            faults.append(
                f"{run.path}: of bench '{bench}'; '{whole_request.bench.name}' was expected: its supply, its camera"
            )
        if bool(run.attributes.get("simulated")) and not emulated:
            faults.append(f"{run.path}: simulated; a run of the real bench '{whole_request.bench.name}' was expected")
    if faults:
        raise InputError(faults)


def _write_motor_file(file: Path, motor: Motor, actuator: str, paths: Sequence[Path]) -> None:
    """Write a motor file with a header that names the actuator and the runs that narrowed its tolerances."""
    header = [
        f"# Actuator {actuator}, commissioned {datetime.now(UTC):%Y-%m-%d} by `leactl thermal commission` from",
        *(f"#   {path.name}" for path in paths),
        "# For this actuator, its mounting and the supply and camera of these runs alone.",
    ]
    body = yaml.safe_dump(motor.model_dump(exclude_none=True, exclude_defaults=True), sort_keys=False)
    with replacement(file) as temporary:
        temporary.write_text("\n".join([*header, body]), encoding="utf-8")


def _state_text(state: Commissioned) -> str:
    """Return a line on the forecast of the protocol by the latest motor file."""
    source = state.file.name if state.file is not None else f"the tolerances of motor '{state.motor.name}'"
    passing = state.forecast.passing
    if passing is None:
        text = f"by {source}: at most {state.forecast.peaks['test']:.1f} degC of {state.limit:.1f}, admitted"
        return text if state.admitted else f"{text} for heats of up to {state.longest_s:.0f} s"
    return (
        f"by {source}: up to {state.limit:.1f} degC after {passing.time_s:.0f} s in step '{passing.step}', not admitted"
    )
