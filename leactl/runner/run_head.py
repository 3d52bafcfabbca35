"""The head of a run file: protocol, bench, people and instruments, and the events before the first row."""

from collections.abc import Sequence
from datetime import UTC, datetime

from leactl import __version__
from leactl.bench.bench import Bench
from leactl.bench.provenance import overdue
from leactl.bench.records import devices_with_exports
from leactl.model.motor import load_motor
from leactl.runfile.write.writer import RunInfo, RunWriter
from leactl.runner import state_folder
from leactl.runner.flushing import SparseWriter
from leactl.runner.plan_needs import windings_without_second_sensor
from leactl.runner.progress import Progress
from leactl.runner.request import Request
from leactl.runner.thermal_admission import Windings


def writer_of(request: Request, bench: Bench) -> RunWriter:
    """Create the run file.

    Raises
    ------
    RecordingFailed : the file could not be made.
    """
    arguments = request.directory, info_of(request, bench), bench.streams(), bench.wait_for_disk
    return SparseWriter(*arguments, request.record_every_s) if request.record_every_s else RunWriter(*arguments)


def info_of(request: Request, opened_bench: Bench) -> RunInfo:
    """Return the attributes of a run file."""
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
        seed=request.noise_seed,
        parameters=plan.parameters,
        instruments={name: provenance.facts for name, provenance in opened_bench.provenance.items()},
        sources={"protocol": plan.text, "bench": request.bench_document.text, "model": motor.text},
    )


def introduce(
    request: Request, windings: Windings, writer: RunWriter, bench: Bench, supply_summaries: Sequence[str]
) -> None:
    """Record what is not in the stored YAML texts: campaign, parameters, overdue calibration, seed, warm windings."""
    for name, value in request.part_of.items():
        writer.event(0.0, "info", "campaign", f"{name} = {value}")
    for name, value in request.plan.parameters.items():
        writer.event(0.0, "info", "protocol", f"{name} = {value}")
    channels = [
        *bench.streams().values(),
        *(source.channels for source in devices_with_exports(bench.drivers).values()),
    ]
    measured = {channel.quantity for stream in channels for channel in stream}
    for quantity in request.plan.wants:
        if quantity not in measured:
            text = f"no device measures {quantity}: its record has to come from elsewhere"
            writer.event(0.0, "warning", "protocol", text)
    if request.record_every_s:
        text = f"at most one row of a stream is recorded in {request.record_every_s:g} s"
        writer.event(0.0, "info", "recorder", text)
    for name, text in overdue(request.devices).items():
        writer.event(0.0, "warning", name, text)
    if (seed := request.noise_seed) is not None:
        writer.event(0.0, "info", "emulation", f"seed = {seed}")
    for line in windings_without_second_sensor(request.plan, bench):
        writer.event(0.0, "info", "windings", line)
    for line in supply_summaries:
        writer.event(0.0, "info", "supplies", line)
    for role, recalled in windings.recalled.items():
        writer.event(0.0, "info", "windings", f"{role} winding: {recalled.known}, at most {recalled.nodes[0]:.1f} degC")


def warn_of_bench(request: Request, writer: RunWriter, bench: Bench, progress: Progress) -> None:
    """Record and show the warnings that a person at a real bench should know before it moves."""
    if not request.in_process:  # an emulated winding cannot burn
        progress.warnings += windings_without_second_sensor(request.plan, bench)
    doubts = [(name, provenance.doubt) for name, provenance in bench.provenance.items() if provenance.doubt]
    for name, source in devices_with_exports(bench.drivers).items() if not request.in_process else ():
        if source.exports.absent:
            doubts.append((name, f"there is no folder {source.exports.folder} for its exports yet"))
    for name, text in doubts:
        writer.event(0.0, "warning", name, text)
        progress.warnings.append(f"{name}: {text}")
    state = state_folder.folder_of(request.bench, request.in_process)
    if state.fault:
        text = f"{state.fault}; trip latch and winding memory are this user's alone, in {state.directory}"
        progress.warnings.append(f"{text}; see: leactl doctor")
        writer.event(0.0, "warning", "runner", progress.warnings[-1])
