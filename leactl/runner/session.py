"""One run from checked inputs to a closed file: opens the bench, runs the loop, and ends in the same order always.

The end does not depend on what caused it, and nothing that may fail or wait comes before what keeps people safe:
devices safe first (by the supervisor: test drive, load drive, the rest), then a trip latched, then the view left, the
file closed with its status, and the devices let go. A watchdog process stands by until the devices are safe.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from leactl import __version__, yamlfile
from leactl.bench.bench import Bench, require_channels_for_interlocks
from leactl.bench.benchfile import BenchFile, CheckedDevice
from leactl.bench.provenance import overdue
from leactl.bench.records import attach_exports, devices_with_exports, with_run_folders
from leactl.bench.wire_trace import CALLS, TracedWiring, WireTrace
from leactl.bench.wiring import MachineWiring, Wiring
from leactl.driver.contract import Confirmation, MotionDevice
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.errors import AcceptanceFailed, DeviceError, InputError, LeactlError, SafetyTrip, Stopped
from leactl.model.motor import load_motor
from leactl.protocol.plan import Plan, SearchLimit, SetRecordRate, SetSupply
from leactl.quantities import ChannelSpec
from leactl.runfile.write.writer import RecordingFailed, RunInfo, RunWriter, new_run_id
from leactl.runner import latch, locks, runs_underway, state_folder
from leactl.runner.bench_fit import check_fit, check_setup, limits_of, unwitnessed
from leactl.runner.channel_limits import ACCEPTANCE, LimitVerdict
from leactl.runner.event_lines import EventLines
from leactl.runner.flushing import InlineFlush, Recording, SparseWriter, ThreadedFlush
from leactl.runner.latch import Latch, Ready
from leactl.runner.loop import Loop
from leactl.runner.progress import Progress
from leactl.runner.runs_underway import Announcement
from leactl.runner.signals import Operator, People, StopSource, Wishes, listening
from leactl.runner.thermal_admission import Windings
from leactl.runner.watchdog import Unwatched, beside
from leactl.safety.current_tracking import VoltageNeed
from leactl.safety.disk import check_room, free_bytes, planned_bytes
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.thermal.foresight import Forecast
from leactl.safety.witnesses import SENSED_ROLES, TorqueModel

Watch = Callable[[Progress], AbstractContextManager[object]]


@dataclass(frozen=True)
class Request:
    """What to run, on what, and where the file goes; everything in it has been checked."""

    plan: Plan
    bench: BenchFile
    devices: Sequence[CheckedDevice]
    bench_document: yamlfile.Document
    directory: Path
    actuator: str = ""
    operator: str = ""
    seed: int | None = None
    realtime: bool = False
    served: bool = False  # the bench is emulated by another process, on real buses
    cold: bool = False  # a person says that nothing has heated the actuators
    insert_cooldown: bool = False  # wait where a winding would otherwise pass its limit
    record_every_s: float = 0.0  # at most one row of a stream is recorded in this time; 0 records every row
    run_id: str = ""  # where it has to be known before the run; else one is made
    part_of: Mapping[str, str] = field(default_factory=dict)  # its campaign, and its place there
    lines: EventLines | None = None  # where the run is told as it goes
    trace: WireTrace | None = None  # where every byte of its wires goes

    @property
    def in_process(self) -> bool:
        """Whether the bench is emulated here."""
        return self.bench.emulated is not None and not self.served

    @property
    def latch(self) -> Latch:
        """What a trip of this bench sets, and what holds it."""
        return latch.of(self.bench, self.bench_document.name, self.in_process)


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    path: Path
    status: str
    reason: str
    error: BaseException | None
    safe: Mapping[str, Confirmation]
    duration_s: float
    overruns: int
    notes: Sequence[str] = ()  # what went wrong beside the run and changes nothing of it
    zeros: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # of each tared channel, before and after
    verdicts: Sequence[LimitVerdict] = ()  # on the limits of channels and searches
    reported: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  # what each device said of itself

    def as_json(self) -> dict[str, Any]:
        """How the run ended, as `--json` tells it."""
        return {
            "run": str(self.path),
            "status": self.status,
            "reason": self.reason,
            "duration_s": round(self.duration_s, 6),
            "safe": {name: {"confirmed": said.safe, "detail": said.detail} for name, said in self.safe.items()},
        }


@dataclass(frozen=True)
class RunContext:
    """A run on its open bench, and all that stands beside it: who guards it, who may end it, who is told of it."""

    request: Request
    bench: Bench
    windings: Windings
    supervisor: Supervisor
    watchdog: Unwatched
    latch: Latch | Ready  # which a trip sets
    people: People
    watch: Watch
    announcement: Announcement


def execute(
    request: Request,
    operator: Operator,
    watch: Watch,
    stops: Sequence[StopSource] = (),
    pauses: Sequence[Callable[[], bool]] = (),
) -> Outcome:
    """Run a plan on a bench; the outcome carries the error that ended it, where there was one.

    Parameters
    ----------
    stops : looked at once a cycle, besides signals and `leactl bench stop`; whatever gives a cause ends the run.
    pauses : each tells whether a pause, or its end, has been asked for since it was called last.

    Raises
    ------
    InputError : plan and bench do not fit, or no other process could stop the run; nothing was touched.
    SafetyTrip : the bench is latched; nothing was touched.
    DeviceError : another run holds the bench, or a device could not be opened; those that were are safe and closed.
    RecordingFailed : the run file could not be made.
    """
    _check(request)
    run_id = request.run_id or new_run_id(request.plan.name, datetime.now(UTC))
    devices = with_run_folders(request.devices, request.directory, run_id if request.in_process else "")
    request = replace(request, run_id=run_id, devices=devices)
    with _alone(request) as locks, listening() as stop, ExitStack() as lasting:
        place = state_folder.place_of(request.bench, request.in_process)
        _refuse_latched(request)
        bench_latch = _held_ready(request, lasting)
        about = request.bench.name, request.bench_document.name, request.plan.name
        with (
            _watched(request, locks) as watchdog,
            runs_underway.announced(*about, needed=not request.in_process, place=place) as announcement,
        ):
            windings = Windings(request.bench, request.devices, request.actuator, request.in_process, request.cold)
            request, bench, supervisor = _ready(request, windings)
            for source in (announcement.asked, *stops):
                stop.heed(source)
            with windings.remembered(announcement.renew):
                bench.open()
                try:
                    wishes = Wishes(partial(_paused, announcement, pauses), announcement.remarks)
                    people = People(stop, wishes, operator)
                    outcome = _run(
                        RunContext(
                            request, bench, windings, supervisor, watchdog, bench_latch, people, watch, announcement
                        )
                    )
                finally:
                    left = bench.close()
            announcement.tell(status=outcome.status, reason=outcome.reason, run=str(outcome.path.resolve()))
    return replace(outcome, notes=[*outcome.notes, *left])


@dataclass(frozen=True)
class Preview:
    """What a run would take, from windings at ambient."""

    plan: Plan  # with the waits for cooling that it is to insert
    forecast: Forecast
    planned_bytes: float

    @property
    def duration_s(self) -> float:
        """Bench time, at the least."""
        return self.plan.duration_s


def preview(request: Request) -> Preview:
    """Refuse what `execute` would refuse before it opens a device, from windings at ambient; nothing is touched.

    Another run may hold the bench: this one comes later.

    Raises
    ------
    InputError, SafetyTrip, DeviceError : as `execute`.
    """
    _check(request)
    request.latch.refuse()
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, cold=True)
    ready, bench, _supervisor = _ready(request, windings)
    return Preview(ready.plan, windings.forecast(ready.plan), _planned_bytes(request, bench))


def streams_of(request: Request) -> Mapping[str, tuple[ChannelSpec, ...]]:
    """Return the streams that a run of this request records; no device is opened."""
    return _bench(request).streams()


def failures(request: Request) -> dict[str, str]:
    """Open each device by itself and let it go; return why it could not be opened, empty where it could.

    Raises
    ------
    DeviceError : another run holds the bench, or a device that was open is not confirmed safe.
    """
    texts: dict[str, str] = {}
    with _alone(request):
        wiring = _wiring(request)
        for device in request.devices:
            bench = Bench(request.bench, [device], wiring)
            try:
                bench.open()
            except DeviceError as error:
                texts[device.name] = str(error)
                continue
            texts[device.name] = ""
            try:
                unsafe = unconfirmed_devices(make_safe(list(bench.drivers.values())))
            finally:
                bench.close()
            if unsafe:
                raise DeviceError(unsafe)
    return texts


@dataclass(frozen=True)
class DryRun:
    """What a run would do that began now."""

    plan: Plan  # with the waits for cooling that it is to insert
    planned_bytes: float
    windings: Windings
    forecast: Forecast
    left_on: Sequence[str]  # what comes of each supply that nobody switches off
    warnings: Sequence[str]
    one_sensor: Sequence[str]  # of each winding whose bound rests on one


def dry_run(request: Request) -> DryRun:
    """Refuse what `execute` would refuse now, before it opens a device; its locks are held for a moment only.

    Raises
    ------
    InputError, SafetyTrip, DeviceError : as `execute`.
    """
    _check(request)
    with _alone(request):
        _refuse_latched(request)
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, request.cold)
    ready, bench, _supervisor = _ready(request, windings)
    stays_on, alone = _left_on(ready.plan, windings, bench), unwitnessed(ready.plan, bench)
    warnings = [f"{name}: {text}" for name, text in overdue(request.devices).items()]
    if fault := state_folder.place_of(request.bench, request.in_process).fault:
        warnings.append(f"{fault}; see: leactl doctor")
    planned, forecast = _planned_bytes(request, bench), windings.forecast(ready.plan)
    return DryRun(ready.plan, planned, windings, forecast, stays_on, warnings, alone)


def _alone(request: Request) -> AbstractContextManager[list[int]]:
    """The locks of the bench and its buses; a bench of this process needs none."""
    return nullcontext([]) if request.in_process else locks.held(request.bench, request.devices)


def _ready(request: Request, windings: Windings) -> tuple[Request, Bench, Supervisor]:
    """The request with the plan that its windings allow, its bench, none of whose devices is open, and supervisor."""
    bench = _bench(request)
    check_fit(request.plan, bench)
    require_channels_for_interlocks(bench, request.bench_document)
    planned = _planned_bytes(request, bench)
    check_room(request.bench.interlocks.disk_space, free_bytes(request.directory), planned)
    request = replace(request, plan=windings.admit(request.plan, request.insert_cooldown))
    supervisor = _supervisor(request, bench, windings)
    _check_supplies(request, supervisor)
    if _switches_on(request.plan):
        from leactl.runner.left_on import endings  # a root finder comes with it, for which no other run waits

        supervisor.supplies.endings = endings(request.plan, windings, bench)
    return request, bench, supervisor


def _left_on(plan: Plan, windings: Windings, bench: Bench) -> list[str]:
    """What comes of each supply that nobody switches off, a line each."""
    if not _switches_on(plan):
        return []
    from leactl.runner.left_on import left_on

    return [one.told for one in left_on(plan, windings, bench)]


def _switches_on(plan: Plan) -> bool:
    return any(isinstance(action, SetSupply) for action in plan.actions)


def _held_ready(request: Request, lasting: ExitStack) -> Latch | Ready:
    """The latch, opened before the first move where a watchdog stands by; a rehearsal's is made if it trips.

    Raises
    ------
    LeactlError : it cannot be opened.
    """
    if not _has_watchdog(request):
        return request.latch
    ready = Ready(request.latch)
    lasting.callback(ready.close)
    return ready


def _has_watchdog(request: Request) -> bool:
    return request.realtime or not request.in_process


def _watched(request: Request, locks: Sequence[int]) -> AbstractContextManager[Unwatched]:
    """The run's watchdog; no other process reaches devices that are emulated in this one."""
    if not _has_watchdog(request):
        return nullcontext(Unwatched())
    return beside(request.bench, [] if request.in_process else request.devices, locks, request.latch)


def _run(context: RunContext) -> Outcome:
    """Run on an open bench, and leave it safe."""
    request, bench, supervisor = context.request, context.bench, context.supervisor
    windings, watchdog, announcement = context.windings, context.watchdog, context.announcement
    plan = request.plan
    try:
        writer = _writer(request, bench)
        watchdog.recording(writer.path)
        announcement.tell(run=str(writer.path.resolve()))
        paced = request.realtime or not request.in_process
        flush = ThreadedFlush(writer) if paced else InlineFlush(writer)
        progress = Progress(f"{plan.name} on {request.bench.name}", plan.duration_s, bench.streams())
        if request.lines is not None:
            request.lines.begin(progress, run=str(writer.path), protocol=plan.name, bench=request.bench.name)
            writer.heard = {"steps": request.lines.step, "events": request.lines.event}
        limits = limits_of(plan, bench)
        recording = Recording(writer, flush, progress, limits)
        loop = Loop(plan, bench, supervisor, watchdog, context.people, recording)
    except BaseException:
        safe = supervisor.make_safe()
        if unsafe := unconfirmed_devices(safe):
            watchdog.take_over(unsafe)
        announcement.tell_safe(safe)
        raise
    with _shown(context.watch, progress):
        error: BaseException | None = None
        try:
            _introduce(request, windings, writer, bench)
            if not request.in_process:  # nothing burns that is emulated here
                progress.warnings += unwitnessed(plan, bench)
            for text in _left_on(plan, windings, bench):
                writer.event(0.0, "info", "supplies", text)
            for name, source in devices_with_exports(bench.drivers).items() if not request.in_process else ():
                if source.exports.absent:
                    progress.warnings.append(f"{name}: there is no folder {source.exports.folder} for its exports yet")
                    writer.event(0.0, "warning", name, progress.warnings[-1])
            place = state_folder.place_of(request.bench, request.in_process)
            if place.fault:
                text = f"{place.fault}; trip latch and winding memory are this user's alone, in {place.directory}"
                progress.warnings.append(f"{text}; see: leactl doctor")
                writer.event(0.0, "warning", "runner", progress.warnings[-1])
            for name, known in bench.provenance.items():
                if known.doubt:
                    progress.warnings.append(f"{name}: {known.doubt}")
                    writer.event(0.0, "warning", name, known.doubt)
            if announcement.fault:
                writer.event(0.0, "warning", "runner", announcement.fault)
            loop.run()
        except BaseException as caught:  # noqa: BLE001 (whatever ended the run, the bench is made safe before anything else)
            error = caught
        watchdog.ending()
        safe = supervisor.make_safe()
        unsafe = unconfirmed_devices(safe)
        windings.end(confirmed=not unsafe)
        if unsafe:
            watchdog.take_over(unsafe)
        else:
            watchdog.dismiss()
        if watchdog.verdict():
            error = _joined(SafetyTrip(watchdog.verdict()), error)
        error = _unconfirmed(error, safe)
        out_of_order = error is not None and (bool(unsafe) or _is_out_of_order(error))
        if error is not None and out_of_order:
            _latch(context.latch, error, writer.path)
        announcement.tell_safe(safe)
    notes = [progress.view_fault] if progress.view_fault else []
    try:
        flush.stop()
    except Exception as failure:  # noqa: BLE001 (what ended the run is told whatever becomes of its file)
        error = _joined(error, failure)
    for text in flush.warnings():  # of the last flush, which no cycle came after
        writer.event(loop.time, "warning", "recorder", text)
        progress.warnings.append(text)
    for name, confirmation in safe.items():
        level = "info" if confirmation.safe else "error"
        writer.event(loop.time, level, name, f"safe state: {confirmation.detail}")
    for note in notes:
        writer.event(loop.time, "warning", "view", note)
    verdicts: list[LimitVerdict] = []
    if error is None or isinstance(error, AcceptanceFailed):
        sought = [limit for limit in plan.acceptance if isinstance(limit, SearchLimit)]
        verdicts = [*limits.verdicts(), *loop.outcomes.verdicts(sought)]
    for verdict in verdicts:
        writer.event(loop.time, "info" if verdict.met else "warning", ACCEPTANCE, verdict.told)
    try:
        writer.close(*_status(error))
        notes += writer.notes()
        notes += attach_exports(bench.drivers, request.bench_document, writer.path)
    except Exception as failure:  # noqa: BLE001 (as above)
        if _is_out_of_order(failure) and not out_of_order:
            _latch(context.latch, failure, writer.path)
        error = _joined(error, failure)
    status, reason = _status(error)
    told = [*notes, *(f"warning: {text}" for text in progress.warnings)]
    reported = {name: known.reported for name, known in bench.provenance.items()}
    ended = Outcome(writer.path, status, reason, error, safe, loop.time, loop.overruns, told, loop.zeros, verdicts)
    return replace(ended, reported=reported)


def _paused(announcement: Announcement, pauses: Sequence[Callable[[], bool]]) -> bool:
    """Whether a pause is wanted: a key at the terminal turns what `leactl bench pause` and `resume` set."""
    for pressed in pauses:
        if pressed():
            announcement.pause(not announcement.paused)
    return announcement.paused


@contextmanager
def _shown(watch: Watch, progress: Progress) -> Iterator[None]:
    """Show a run while the block lasts; a view that fails is noted, and is never the run's error."""
    view = ExitStack()
    try:
        view.enter_context(watch(progress))
    except BaseException as error:  # noqa: BLE001 (nothing in a view is worth a run)
        progress.view_fault = f"the view has failed: {type(error).__name__}: {error}"
    try:
        yield
    finally:
        try:
            view.close()
        except BaseException as error:  # noqa: BLE001 (as above)
            progress.view_fault = f"the view has failed: {type(error).__name__}: {error}"


def _refuse_latched(request: Request) -> None:
    """Refuse a latched bench; one of a run that nothing is left of is latched first: who knows what its devices do.

    Raises
    ------
    SafetyTrip : it is latched.
    LeactlError : the latch could not be written.
    """
    for cause, run in runs_underway.lost(request.bench.name) if not request.in_process else ():
        if request.latch.trip() is None:
            request.latch.set(cause, Path(run))
    request.latch.refuse()


def _is_out_of_order(error: BaseException) -> bool:
    """Whether a run ended by a trip, without room for its rows, or by what nobody has foreseen, as for want of memory.

    A person, a device that says itself whether it is in fault, and a limit of acceptance end it in order.
    """
    return isinstance(error, SafetyTrip | RecordingFailed) or not isinstance(error, LeactlError | KeyboardInterrupt)


def _latch(bench: Latch | Ready, error: BaseException, run: Path) -> None:
    """Latch what ended a run; where that fails it is still what ended it."""
    try:
        bench.set(_status(error)[1], run)
    except Exception as failure:  # noqa: BLE001 (a trip is told whatever becomes of its latch)
        error.add_note(f"THE BENCH IS NOT LATCHED: {failure}")


def _check(request: Request) -> None:
    """Refuse what cannot go well, before anything is touched."""
    bench = request.bench
    if not request.in_process and (request.seed is not None or request.realtime):
        raise InputError(f"bench '{bench.name}' is not emulated here: it takes no seed and always keeps wall time")
    check_setup(request.plan, bench)


def _check_supplies(request: Request, supervisor: Supervisor) -> None:
    name, most = request.bench.name, supervisor.supplies.most
    for action in request.plan.actions:
        for role, output in action.outputs.items() if isinstance(action, SetSupply) else ():
            if role not in most:
                raise InputError(
                    f"protocol '{request.plan.name}' supplies the leads of {role}; bench '{name}' has no supply there"
                )
            for asked, top, unit in zip(output or (), most[role], "VA", strict=False):
                if asked > top:
                    raise InputError(
                        f"protocol '{request.plan.name}' asks {asked:g} {unit} of the supply of {role}; it is good for"
                        f" {top:g} {unit} on bench '{name}'"
                    )


def _planned_bytes(request: Request, bench: Bench) -> float:
    plan = request.plan
    if request.record_every_s:
        rate = 1.0 / request.record_every_s
        return planned_bytes(bench.streams(), rate, rate, plan.duration_s, {})
    rates = [plan.record_Hz, *(action.rate_Hz for action in plan.actions if isinstance(action, SetRecordRate))]
    return planned_bytes(bench.streams(), max(rates), plan.rate_Hz, plan.duration_s, bench.fast_streams)


def _bench(request: Request) -> Bench:
    trace = request.trace
    if trace is None:
        return Bench(request.bench, request.devices, _wiring(request))
    bench = Bench(request.bench, request.devices, TracedWiring(_wiring(request), trace))
    bench.pass_calls_through(trace.called, CALLS)
    return bench


def _wiring(request: Request) -> Wiring:
    if not request.in_process:
        return MachineWiring()
    from leactl.emulation.bench.emulated_bench import EmulatedBench

    plan = request.plan
    return EmulatedBench(
        request.bench, request.devices, plan.setup, plan.condition, request.seed, realtime=request.realtime
    )


def _supervisor(request: Request, bench: Bench, windings: Windings) -> Supervisor:
    axes = {}
    for role, driver in bench.drives.items():
        assert isinstance(driver, MotionDevice)
        axes[role] = Axis(driver, driver)
    sensed = SENSED_ROLES.get(request.plan.setup, ())
    return Supervisor(
        request.bench.limits,
        axes,
        bench.others,
        bench.clock,
        windings.guard,
        request.bench.interlocks,
        torque_models={role: TorqueModel.of(windings.motors[role]) for role in sensed},
        voltage_needs={
            role: VoltageNeed(
                motor.back_emf_constant,
                motor.resistance(request.bench.limits.winding_temperature_degC),
                motor.winding,
            )
            for role, motor in windings.motors.items()
        },
    )


def _writer(request: Request, bench: Bench) -> RunWriter:
    opened = request.directory, _info(request, bench), bench.streams(), bench.wait_for_disk
    return SparseWriter(*opened, request.record_every_s) if request.record_every_s else RunWriter(*opened)


def _info(request: Request, opened: Bench) -> RunInfo:
    plan, bench, now = request.plan, request.bench, datetime.now(UTC)
    motor = load_motor(bench.motors["test"])[1]
    return RunInfo(
        run_id=request.run_id,
        protocol=plan.name,
        bench=bench.name,
        actuator=request.actuator,
        condition=plan.condition,
        operator=request.operator,
        simulated=bench.emulated is not None,
        mechanical=plan.setup,
        software=f"leactl {__version__}",
        created=now.isoformat(timespec="milliseconds"),
        seed=_seed(request),
        parameters=plan.parameters,
        instruments={name: known.facts for name, known in opened.provenance.items()},
        sources={"protocol": plan.text, "bench": request.bench_document.text, "model": motor.text},
    )


def _introduce(request: Request, windings: Windings, writer: RunWriter, bench: Bench) -> None:
    """Note what the stored YAML texts do not tell: campaign, parameters, overdue calibration, seed, warm windings."""
    for name, value in request.part_of.items():
        writer.event(0.0, "info", "campaign", f"{name} = {value}")
    for name, value in request.plan.parameters.items():
        writer.event(0.0, "info", "protocol", f"{name} = {value}")
    channels = [
        *bench.streams().values(),
        *(source.channels for source in devices_with_exports(bench.drivers).values()),
    ]
    measured = {channel.quantity for several in channels for channel in several}
    for quantity in request.plan.wants:
        if quantity not in measured:
            text = f"no device measures {quantity}: its record has to come from elsewhere"
            writer.event(0.0, "warning", "protocol", text)
    if request.record_every_s:
        text = f"at most one row of a stream is recorded in {request.record_every_s:g} s"
        writer.event(0.0, "info", "recorder", text)
    for name, text in overdue(request.devices).items():
        writer.event(0.0, "warning", name, text)
    if (seed := _seed(request)) is not None:
        writer.event(0.0, "info", "emulation", f"seed = {seed}")
    for line in unwitnessed(request.plan, bench):
        writer.event(0.0, "info", "windings", line)
    for role, recalled in windings.recalled.items():
        writer.event(0.0, "info", "windings", f"{role} winding: {recalled.known}, at most {recalled.nodes[0]:.1f} degC")


def _seed(request: Request) -> int | None:
    """What the noise of a bench that is emulated here is drawn from."""
    if not request.in_process or request.bench.emulated is None:
        return None
    return request.bench.emulated.seed if request.seed is None else request.seed


def _unconfirmed(error: BaseException | None, safe: Mapping[str, Confirmation]) -> BaseException | None:
    """A device that could not be confirmed safe is an error of its own, or part of the one there is."""
    text = unconfirmed_devices(safe)
    if not text:
        return error
    if error is None:
        return DeviceError(text)
    error.add_note(text)
    return error


def _joined(error: BaseException | None, further: BaseException | None) -> BaseException | None:
    """What ended the run stays its error; what came after is part of it."""
    if error is None or further is None:
        return error or further
    if str(further) != str(error):
        error.add_note(str(further) or type(further).__name__)
    return error


def _status(error: BaseException | None) -> tuple[str, str]:
    if error is None:
        return "complete", ""
    kind = "tripped" if isinstance(error, SafetyTrip) else "stopped" if isinstance(error, Stopped) else "failed"
    return kind, str(error).splitlines()[0] if str(error) else type(error).__name__
