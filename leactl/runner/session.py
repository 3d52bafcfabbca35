"""One run from checked inputs to a closed file: opens the bench, runs the loop, and always ends in the same order.

Once there is a run file, the order at the end does not depend on the cause, and nothing that may fail or wait comes
before the safety of people. First the supervisor makes the devices safe (test drive, load drive, the rest). Then a
bench that ended out of order is latched, the view is closed, the file is closed with its status, and the devices are
closed. Without a run file no setpoint has been sent: the devices are made safe and closed. A watchdog process acts if
this fails, until the devices are safe.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import NamedTuple

from leactl.bench.bench import Bench
from leactl.bench.records import attach_exports, with_run_folders
from leactl.driver.contract import Confirmation
from leactl.driver.safe_state import unconfirmed_devices
from leactl.errors import AcceptanceFailed, SafetyTrip
from leactl.protocol.plan import SearchLimit
from leactl.runfile.write.run_info import new_run_id
from leactl.runner import runs_underway
from leactl.runner.channel_limits import ACCEPTANCE, LimitVerdict
from leactl.runner.flushing import InlineFlush, Recording, ThreadedFlush
from leactl.runner.latch import Latch, OpenLatch
from leactl.runner.loop import Loop
from leactl.runner.outcome import Outcome, is_out_of_order, joined, status_of, with_unconfirmed
from leactl.runner.plan_needs import channel_limits_of
from leactl.runner.preparation import admit, check, locks_of, refuse_latched
from leactl.runner.progress import Progress
from leactl.runner.request import Request
from leactl.runner.run_head import introduce, warn_of_bench, writer_of
from leactl.runner.runs_underway import Announcement
from leactl.runner.state_folder import folder_of
from leactl.runner.stop_requests import OperatorInput, OperatorPrompt, RunControl, StopSource, handled_signals
from leactl.runner.thermal_admission import Windings
from leactl.runner.watchdog import NoWatchdog, started_watchdog
from leactl.safety.supervisor import Supervisor

ViewFactory = Callable[[Progress], AbstractContextManager[object]]


@dataclass(frozen=True)
class RunContext:
    """A run on its open bench, with its supervisor, watchdog and latch, the stop and pause requests, and its view."""

    request: Request
    bench: Bench
    windings: Windings
    supervisor: Supervisor
    watchdog: NoWatchdog  # or a `Watchdog`, derived from it, if the run keeps wall time
    latch: Latch | OpenLatch  # set by a trip
    control: RunControl
    watch: ViewFactory
    announcement: Announcement
    supply_summaries: Sequence[str]  # the consequence for each, if nobody switches it off


class SafeEnd(NamedTuple):
    """How a run ended, after every device was asked to be safe."""

    confirmations: Mapping[str, Confirmation]  # by device, also of a device that is not confirmed safe
    error: BaseException | None  # that ended the run early
    out_of_order: bool  # whether the bench has to be latched for the error


def execute(
    request: Request,
    operator: OperatorPrompt,
    watch: ViewFactory,
    stops: Sequence[StopSource] = (),
    pauses: Sequence[Callable[[], bool]] = (),
) -> Outcome:
    """Run a plan on a bench; return the outcome, with the error that ended the run, if any.

    Parameters
    ----------
    operator : asks a person at the bench and waits.
    watch : returns the context in which the run is shown.
    stops : called once a cycle, besides signals and `leactl bench stop`; the first that returns a cause ends the run.
    pauses : each returns whether a pause, or its end, has been asked for since its last call.

    Raises
    ------
    InputError : plan and bench do not fit, or no other process could stop the run; nothing was touched.
    SafetyTrip : the bench is latched; nothing was touched.
    DeviceError : another run holds the bench, or a device could not be opened; the opened ones are safe and closed.
    RecordingFailed : the run file could not be made.
    LeactlError : the latch cannot be opened; nothing was touched.
    """
    check(request)
    run_id = request.run_id or new_run_id(request.plan.name, datetime.now(UTC))
    devices = with_run_folders(request.devices, request.directory, run_id if request.in_process else "")
    request = replace(request, run_id=run_id, devices=devices)
    with locks_of(request) as locks, handled_signals() as stop, ExitStack() as until_end:
        state_folder = folder_of(request.bench, request.in_process)
        refuse_latched(request)
        bench_latch = _opened_latch(request, until_end)
        run_description = request.bench.name, request.bench_document.name, request.plan.name
        with (
            _watchdog_for(request, locks) as watchdog,
            runs_underway.announced(
                *run_description, is_needed=not request.in_process, folder=state_folder
            ) as announcement,
        ):
            windings = Windings(request.bench, request.devices, request.actuator, request.in_process, request.cold)
            request, bench, supervisor, supply_summaries = admit(request, windings)
            for source in (announcement.stop_cause, *stops):
                stop.add_source(source)
            with windings.remembered(before_writing=announcement.renew):
                try:
                    bench.open()
                except BaseException as error:
                    if bench.not_confirmed:  # an earlier program may have left it on
                        watchdog.take_over(bench.not_confirmed)
                        _set_latch(bench_latch, error, request.directory)
                    raise
                try:
                    operator_input = OperatorInput(partial(_toggle_pause, announcement, pauses), announcement.remarks)
                    control = RunControl(stop, operator_input, operator)
                    outcome = _run(
                        RunContext(
                            request,
                            bench,
                            windings,
                            supervisor,
                            watchdog,
                            bench_latch,
                            control,
                            watch,
                            announcement,
                            supply_summaries,
                        )
                    )
                finally:
                    not_closed = bench.close()
            announcement.tell(status=outcome.status, reason=outcome.reason, run=str(outcome.path.resolve()))
    return replace(outcome, notes=[*outcome.notes, *not_closed])


def _opened_latch(request: Request, until_end: ExitStack) -> Latch | OpenLatch:
    """Return the latch, opened before the first move if the run keeps wall time.

    An open latch can be set without a free descriptor or room on the disk.

    Parameters
    ----------
    until_end : closes the latch when the run has ended.

    Raises
    ------
    LeactlError : the latch cannot be opened.
    """
    if not request.keeps_wall_time:
        return request.latch
    latch = OpenLatch(request.latch)
    until_end.callback(latch.close)
    return latch


def _watchdog_for(request: Request, locks: Sequence[int]) -> AbstractContextManager[NoWatchdog]:
    """Return the watchdog of a run that keeps wall time; it cannot reach devices that are emulated in this process."""
    if not request.keeps_wall_time:
        return nullcontext(NoWatchdog())
    return started_watchdog(request.bench, [] if request.in_process else request.devices, locks, request.latch)


def _run(context: RunContext) -> Outcome:
    """Run on an open bench, and make its devices safe in any case."""
    try:
        recording, loop = _prepare_recording(context)
    except BaseException:
        confirmations = context.supervisor.make_safe()
        unconfirmed = unconfirmed_devices(confirmations)
        context.windings.end(confirmed=not unconfirmed)
        if unconfirmed:
            context.watchdog.take_over(unconfirmed)
        context.announcement.tell_safe(confirmations)
        raise
    with _view_of(context.watch, recording.progress):
        error = _run_loop(context, recording, loop)
        end = _make_safe_and_latch(context, error, recording.writer.path)
    return _close_file(context, recording, loop, end)


def _prepare_recording(context: RunContext) -> tuple[Recording, Loop]:
    """Make the run file with what writes to it, and the loop.

    Raises
    ------
    RecordingFailed : the run file could not be made.
    """
    request, bench, plan = context.request, context.bench, context.request.plan
    writer = writer_of(request, bench)
    context.watchdog.tell_recording(writer.path)
    context.announcement.tell(run=str(writer.path.resolve()))
    flush = ThreadedFlush(writer) if request.keeps_wall_time else InlineFlush(writer)
    progress = Progress(f"{plan.name} on {request.bench.name}", plan.duration_s, bench.streams())
    if request.lines is not None:
        request.lines.begin(progress, run=str(writer.path), protocol=plan.name, bench=request.bench.name)
        writer.listeners = {"steps": request.lines.step, "events": request.lines.event}
    recording = Recording(writer, flush, progress, channel_limits_of(plan, bench))
    return recording, Loop(plan, bench, context.supervisor, context.watchdog, context.control, recording)


def _run_loop(context: RunContext, recording: Recording, loop: Loop) -> BaseException | None:
    """Record what is known before the first cycle and run the loop; return what ended it early."""
    request, bench, writer, progress = context.request, context.bench, recording.writer, recording.progress
    try:
        introduce(request, context.windings, writer, bench, context.supply_summaries)
        warn_of_bench(request, writer, bench, progress)
        if context.announcement.fault:
            writer.event(0.0, "warning", "runner", context.announcement.fault)
        loop.run()
    except BaseException as caught:  # noqa: BLE001 (whatever ended the run, the bench is made safe before anything else)
        return caught
    return None


def _make_safe_and_latch(context: RunContext, error: BaseException | None, run_path: Path) -> SafeEnd:
    """Make the devices safe, by the watchdog too if they are not confirmed, and latch a bench that ended out of order.

    Parameters
    ----------
    error : what ended the loop early.
    """
    watchdog = context.watchdog
    watchdog.allow_end()  # it still watches, and bears the longer silence that making safe may take
    confirmations = context.supervisor.make_safe()
    unconfirmed = unconfirmed_devices(confirmations)
    context.windings.end(confirmed=not unconfirmed)
    if unconfirmed:
        watchdog.take_over(unconfirmed)
    else:
        watchdog.dismiss()
    if watchdog.verdict():  # why it stopped the run, if it did; readable after its end
        error = joined(SafetyTrip(watchdog.verdict()), error)
    error = with_unconfirmed(error, confirmations)
    out_of_order = error is not None and (bool(unconfirmed) or is_out_of_order(error))
    if error is not None and out_of_order:
        _set_latch(context.latch, error, run_path)
    context.announcement.tell_safe(confirmations)
    return SafeEnd(confirmations, error, out_of_order)


def _close_file(context: RunContext, recording: Recording, loop: Loop, safe_end: SafeEnd) -> Outcome:
    """Record how the run ended, close its file and return the outcome; what fails here is added to the run's error."""
    bench, writer, flush, progress = context.bench, recording.writer, recording.flush, recording.progress
    error = safe_end.error
    notes = [progress.view_fault] if progress.view_fault else []
    try:
        flush.stop()
    except Exception as failure:  # noqa: BLE001 (the cause of the run's end is reported whatever happens to its file)
        error = joined(error, failure)
    for text in flush.warnings():  # of the last flush, after the last cycle
        writer.event(loop.time, "warning", "recorder", text)
        progress.warnings.append(text)
    for name, confirmation in safe_end.confirmations.items():
        level = "info" if confirmation.safe else "error"
        writer.event(loop.time, level, name, f"safe state: {confirmation.detail}")
    for note in notes:
        writer.event(loop.time, "warning", "view", note)
    verdicts = _record_verdicts(context, recording, loop, error)
    try:
        writer.close(*status_of(error))
        notes += writer.notes()
        notes += attach_exports(bench.drivers, context.request.bench_document, writer.path)
    except Exception as failure:  # noqa: BLE001 (as above)
        if is_out_of_order(failure) and not safe_end.out_of_order:
            _set_latch(context.latch, failure, writer.path)
        error = joined(error, failure)
    status, reason = status_of(error)
    return Outcome(
        path=writer.path,
        status=status,
        reason=reason,
        error=error,
        safe=safe_end.confirmations,
        duration_s=loop.time,
        overruns=loop.overruns,
        notes=[*notes, *(f"warning: {text}" for text in progress.warnings)],
        zeros=loop.zeros,
        verdicts=verdicts,
        reported={name: provenance.reported for name, provenance in bench.provenance.items()},
    )


def _record_verdicts(
    context: RunContext, recording: Recording, loop: Loop, error: BaseException | None
) -> list[LimitVerdict]:
    """Record and return the verdicts on limits; there are none if anything but a limit has ended the run."""
    if error is not None and not isinstance(error, AcceptanceFailed):
        return []
    search_limits = [limit for limit in context.request.plan.acceptance if isinstance(limit, SearchLimit)]
    verdicts = [*recording.limits.verdicts(), *loop.outcomes.verdicts(search_limits)]
    for verdict in verdicts:
        recording.writer.event(loop.time, "info" if verdict.met else "warning", ACCEPTANCE, verdict.summary)
    return verdicts


def _toggle_pause(announcement: Announcement, pauses: Sequence[Callable[[], bool]]) -> bool:
    """Toggle the pause for each key pressed since the last call; return whether the run has to pause.

    `leactl bench pause` and `resume` set the same pause.
    """
    for pressed in pauses:
        if pressed():
            announcement.pause(not announcement.paused)
    return announcement.paused


@contextmanager
def _view_of(watch: ViewFactory, progress: Progress) -> Iterator[None]:
    """Show a run until the block is left; the failure of a view is noted, and is never an error of the run."""
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


def _set_latch(latch: Latch | OpenLatch, error: BaseException, run_path: Path) -> None:
    """Latch the bench with the error that ended a run; a failure to do so is added to that error."""
    try:
        latch.set(status_of(error)[1], run_path)
    except Exception as failure:  # noqa: BLE001 (a trip is reported whatever happens to its latch)
        error.add_note(f"THE BENCH IS NOT LATCHED: {failure}")
