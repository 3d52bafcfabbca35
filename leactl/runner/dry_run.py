"""Preview a run without opening a device, and find out which devices of a bench can be opened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from leactl.bench.provenance import overdue
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.errors import DeviceError
from leactl.protocol.plan import Plan
from leactl.quantities import ChannelSpec
from leactl.runner import state_folder
from leactl.runner.plan_needs import windings_without_second_sensor
from leactl.runner.preparation import (
    admit,
    bench_of,
    check,
    locks_of,
    refuse_latched,
    room_needed,
    wiring_of,
)
from leactl.runner.request import Request
from leactl.runner.thermal_admission import Windings
from leactl.safety.thermal.foresight import Forecast


@dataclass(frozen=True)
class Preview:
    """Duration, temperatures and file size of a run that begins with its windings at ambient."""

    plan: Plan  # with the waits for cooling that it is to insert
    forecast: Forecast
    planned_bytes: float

    @property
    def duration_s(self) -> float:
        """Least duration by the bench's clock [s]."""
        return self.plan.duration_s


def preview(request: Request) -> Preview:
    """Check a request as `execute` does before it opens a device, but with windings at ambient; nothing is touched.

    No lock is taken: another run may use the bench now, because the previewed run begins later.

    Raises
    ------
    InputError, SafetyTrip, DeviceError : as `execute`.
    """
    check(request)
    request.latch.refuse()
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, cold=True)
    admitted = admit(request, windings)
    plan = admitted.request.plan
    return Preview(plan, windings.forecast(plan), room_needed(request, admitted.bench))


def streams_of(request: Request) -> Mapping[str, tuple[ChannelSpec, ...]]:
    """Return the streams that a run of this request records; no device is opened."""
    return bench_of(request).streams()


def opening_failures(request: Request) -> dict[str, str]:
    """Open each device alone, make it safe and close it; return, by name, why it could not be opened.

    The text is empty for a device that was opened.

    Raises
    ------
    DeviceError : another run holds the bench, or a device that was open is not confirmed safe.
    """
    reasons: dict[str, str] = {}
    with locks_of(request):
        wiring = wiring_of(request)
        for device in request.devices:
            bench = bench_of(replace(request, devices=[device]), wiring)
            try:
                bench.open()
            except DeviceError as error:
                reasons[device.name] = str(error)
                continue
            reasons[device.name] = ""
            try:
                doubt = unconfirmed_devices(make_safe(list(bench.drivers.values())))
            finally:
                bench.close()
            if doubt:
                raise DeviceError(doubt)
    return reasons


@dataclass(frozen=True)
class DryRun:
    """Plan, file size, temperatures and warnings of a run that would begin now."""

    plan: Plan  # with the waits for cooling that it is to insert
    planned_bytes: float
    windings: Windings
    forecast: Forecast
    left_on: Sequence[str]  # for each supply that the plan switches on, the consequence if nobody switches it off
    warnings: Sequence[str]
    one_sensor: Sequence[str]  # one line for each heated winding whose bound rests on one sensor


def dry_run(request: Request) -> DryRun:
    """Check a request as `execute` would now, before it opens a device; the bench's locks are held for a moment only.

    Raises
    ------
    InputError, SafetyTrip, DeviceError : as `execute`.
    """
    check(request)
    with locks_of(request):
        refuse_latched(request)
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, request.cold)
    admitted = admit(request, windings)
    plan, bench = admitted.request.plan, admitted.bench
    warnings = [f"{name}: {text}" for name, text in overdue(request.devices).items()]
    if fault := state_folder.folder_of(request.bench, request.in_process).fault:
        warnings.append(f"{fault}; see: leactl doctor")
    planned_size, forecast = room_needed(request, bench), windings.forecast(plan)
    one_sensor_texts = windings_without_second_sensor(plan, bench)
    return DryRun(plan, planned_size, windings, forecast, admitted.supply_summaries, warnings, one_sensor_texts)
