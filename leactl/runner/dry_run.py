"""What a run would do and take, without opening a device, and which of its devices can be opened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from leactl.bench.provenance import overdue
from leactl.driver.safe_state import make_safe, unconfirmed_devices
from leactl.errors import DeviceError
from leactl.protocol.plan import Plan
from leactl.quantities import ChannelSpec
from leactl.runner import state_folder
from leactl.runner.bench_fit import unwitnessed
from leactl.runner.preparation import (
    admitted,
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
    check(request)
    request.latch.refuse()
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, cold=True)
    ready = admitted(request, windings)
    plan = ready.request.plan
    return Preview(plan, windings.forecast(plan), room_needed(request, ready.bench))


def streams_of(request: Request) -> Mapping[str, tuple[ChannelSpec, ...]]:
    """Return the streams that a run of this request records; no device is opened."""
    return bench_of(request).streams()


def failures(request: Request) -> dict[str, str]:
    """Open each device by itself and let it go; return why it could not be opened, empty where it could.

    Raises
    ------
    DeviceError : another run holds the bench, or a device that was open is not confirmed safe.
    """
    texts: dict[str, str] = {}
    with locks_of(request):
        wiring = wiring_of(request)
        for device in request.devices:
            bench = bench_of(replace(request, devices=[device]), wiring)
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
    check(request)
    with locks_of(request):
        refuse_latched(request)
    windings = Windings(request.bench, request.devices, request.actuator, request.in_process, request.cold)
    ready = admitted(request, windings)
    plan, bench = ready.request.plan, ready.bench
    warnings = [f"{name}: {text}" for name, text in overdue(request.devices).items()]
    if fault := state_folder.place_of(request.bench, request.in_process).fault:
        warnings.append(f"{fault}; see: leactl doctor")
    planned, forecast = room_needed(request, bench), windings.forecast(plan)
    return DryRun(plan, planned, windings, forecast, ready.stays_on, warnings, unwitnessed(plan, bench))
