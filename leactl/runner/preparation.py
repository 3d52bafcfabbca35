"""Checks before a device is opened: the request fits its bench, and the windings allow the plan."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import NamedTuple

from leactl.bench.bench import Bench, require_channels_for_interlocks
from leactl.bench.wire_trace import bench_with_trace
from leactl.bench.wiring import MachineWiring, Wiring
from leactl.driver.contract import MotionDevice
from leactl.errors import InputError
from leactl.protocol.plan import Plan, SetRecordRate, SetSupply
from leactl.runner import locks
from leactl.runner.latch import refuse_lost_runs
from leactl.runner.plan_needs import check_plan_needs, check_setup
from leactl.runner.request import Request
from leactl.runner.thermal_admission import Windings
from leactl.safety.current_tracking import VoltageNeed
from leactl.safety.disk import check_room, free_bytes, planned_bytes
from leactl.safety.supervisor import Axis, Supervisor
from leactl.safety.witnesses import SENSED_ROLES, TorqueModel


class Admitted(NamedTuple):
    """Request, bench and supervisor of a run, checked; no device is open."""

    request: Request  # with the plan that the windings allow
    bench: Bench
    supervisor: Supervisor
    supply_summaries: Sequence[str]  # the consequence for each, if nobody switches it off


def admit(request: Request, windings: Windings) -> Admitted:
    """Check a request against its bench and its windings; no device is opened.

    Raises
    ------
    InputError : plan and bench do not fit, the disk has no room, a winding may pass its limit, or nothing would end
        a supply's current.
    """
    bench = bench_of(request)
    check_plan_needs(request.plan, bench)
    require_channels_for_interlocks(bench, request.bench_document)
    needed_bytes = room_needed(request, bench)
    check_room(request.bench.interlocks.disk_space, free_bytes(request.directory), needed_bytes)
    request = replace(request, plan=windings.admit(request.plan, request.insert_cooldown))
    supervisor = supervisor_of(request, bench, windings)
    check_supplies(request, supervisor)
    if not switches_supplies(request.plan):
        return Admitted(request, bench, supervisor, ())
    # imports a root finder, which no other run needs
    from leactl.runner.unattended_supply import endings, supplies_left_on

    left_on = supplies_left_on(request.plan, windings, bench)
    supervisor.supplies.endings = endings(request.plan, windings, left_on)
    for supply in left_on:
        windings.may_be_left_on({supply.role: supply.reached})
    return Admitted(request, bench, supervisor, [supply.summary for supply in left_on])


def switches_supplies(plan: Plan) -> bool:
    """Return whether a plan switches any supply."""
    return any(isinstance(action, SetSupply) for action in plan.actions)


def locks_of(request: Request) -> AbstractContextManager[list[int]]:
    """Hold the locks of the bench and its buses until a block is left; a bench emulated in this process needs none."""
    return nullcontext([]) if request.in_process else locks.held(request.bench, request.devices)


def refuse_latched(request: Request) -> None:
    """Raise SafetyTrip for a latched bench; latch it first if a run died without making its devices safe.

    Raises
    ------
    SafetyTrip : the bench is latched, or its latch could not be written.
    """
    if not request.in_process:
        refuse_lost_runs(request.bench.name)
    request.latch.refuse()


def check(request: Request) -> None:
    """Raise InputError for a request that does not fit its bench, before anything is touched.

    Raises
    ------
    InputError : a seed or wall time is asked of a bench that is not emulated here, or the plan needs another set-up.
    """
    bench = request.bench
    if not request.in_process and (request.seed is not None or request.realtime):
        raise InputError(f"bench '{bench.name}' is not emulated here: it takes no seed and always keeps wall time")
    check_setup(request.plan, bench)


def check_supplies(request: Request, supervisor: Supervisor) -> None:
    """Raise InputError for a plan whose supply levels are above those of the bench's supplies.

    Raises
    ------
    InputError : there is no supply at those leads, or its levels are lower.
    """
    name, highest_outputs = request.bench.name, supervisor.supplies.most
    for action in request.plan.actions:
        for role, output in action.outputs.items() if isinstance(action, SetSupply) else ():
            if role not in highest_outputs:
                raise InputError(
                    f"protocol '{request.plan.name}' supplies the leads of {role}; bench '{name}' has no supply there"
                )
            for level, highest, unit in zip(output or (), highest_outputs[role], "VA", strict=False):
                if level > highest:
                    raise InputError(
                        f"protocol '{request.plan.name}' asks {level:g} {unit} of the supply of {role}; it is good for"
                        f" {highest:g} {unit} on bench '{name}'"
                    )


def room_needed(request: Request, bench: Bench) -> float:
    """Return the size that the run file may reach [bytes]."""
    plan = request.plan
    if request.record_every_s:
        rate = 1.0 / request.record_every_s
        return planned_bytes(bench.streams(), rate, rate, plan.duration_s, {})
    rates = [plan.record_Hz, *(action.rate_Hz for action in plan.actions if isinstance(action, SetRecordRate))]
    return planned_bytes(bench.streams(), max(rates), plan.rate_Hz, plan.duration_s, bench.fast_streams)


def bench_of(request: Request, wiring: Wiring | None = None) -> Bench:
    """Return the bench of a request with closed devices; its wires go through the request's trace, if any.

    Benches that are made with one `wiring` share its emulated devices and their clock; None makes a new wiring.
    """
    return bench_with_trace(request.bench, request.devices, wiring or wiring_of(request), request.trace)


def wiring_of(request: Request) -> Wiring:
    """Return the wiring of this machine, or of a bench that is emulated in this process."""
    if not request.in_process:
        return MachineWiring()
    from leactl.emulation.bench.emulated_bench import EmulatedBench

    plan = request.plan
    return EmulatedBench(
        request.bench, request.devices, plan.setup, plan.condition, request.seed, realtime=request.realtime
    )


def supervisor_of(request: Request, bench: Bench, windings: Windings) -> Supervisor:
    """Return the supervisor through which every command of a run goes."""
    axes = {}
    for role, driver in bench.drives.items():
        assert isinstance(driver, MotionDevice)
        axes[role] = Axis(driver, driver)
    sensed_roles = SENSED_ROLES.get(request.plan.setup, ())
    return Supervisor(
        request.bench.limits,
        axes,
        bench.others,
        bench.clock,
        windings.guard,
        request.bench.interlocks,
        torque_models={role: TorqueModel.of(windings.motors[role]) for role in sensed_roles},
        voltage_needs={
            role: VoltageNeed(
                motor.back_emf_constant,
                motor.resistance(request.bench.limits.winding_temperature_degC),
                motor.winding,
            )
            for role, motor in windings.motors.items()
        },
    )
