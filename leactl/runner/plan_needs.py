"""Check, before a run starts, that a bench has what a plan needs: set-up, limits, drives and channels."""

from leactl.bench.bench import Bench
from leactl.bench.benchfile import BenchFile
from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.protocol.plan import ChannelBounds, Engage, InRange, Plan, Segment, SetSupply, Until, WaitUntil, When
from leactl.runner.channel_limits import ChannelLimits
from leactl.safety.plan_checks import check_setpoints
from leactl.safety.witnesses import lone_sensors


def check_plan_needs(plan: Plan, bench: Bench) -> None:
    """Raise if the bench lacks what the plan needs.

    Raises
    ------
    InputError : the bench has another set-up, no such drive or no such channel, or a setpoint is beyond its limits;
        only the first of these faults.
    """
    check_setup(plan, bench.file)
    _check_roles(plan, bench)
    _check_quantities(plan, bench)
    _check_awaited_channels(plan, bench)
    channel_limits_of(plan, bench)  # raises if the bench measures no channel of a limit


def check_setup(plan: Plan, bench_file: BenchFile) -> None:
    """Raise if the plan needs another set-up than the bench has, or a setpoint beyond its limits.

    Raises
    ------
    InputError : the bench has another set-up, or one line for each setpoint beyond its limits.
    """
    if bench_file.setup is not None and bench_file.setup != plan.setup:
        raise InputError(
            f"protocol '{plan.name}' needs set-up '{plan.setup}'; bench '{bench_file.name}' is '{bench_file.setup}'"
        )
    check_setpoints(bench_file.limits, plan.peaks())


def channel_limits_of(plan: Plan, bench: Bench) -> ChannelLimits:
    """Return the plan's limits on channels.

    Raises
    ------
    InputError : the bench measures no such channel.
    """
    limits = [limit for limit in plan.acceptance if isinstance(limit, ChannelBounds)]
    return ChannelLimits(limits, bench.streams(), bench.file.name)


def windings_without_second_sensor(plan: Plan, bench: Bench) -> list[str]:
    """Return one line for each winding that a plan heats and whose temperature bound depends on one current sensor."""
    heated: dict[str, str] = {}
    for action in plan.actions:
        if isinstance(action, Engage):
            heated |= {role: "q_axis_current" for role, mode in action.modes.items() if mode is not Mode.OFF}
        elif isinstance(action, SetSupply):
            heated |= {role: "line_current" for role, output in action.outputs.items() if output is not None}
    channels = [channel for stream in bench.streams().values() for channel in stream]
    test_first = dict(sorted(heated.items(), reverse=True))  # "test" before "load"
    return lone_sensors(bench.file.interlocks, channels, plan.setup, test_first)


def _check_roles(plan: Plan, bench: Bench) -> None:
    """Raise if the plan moves a drive that the bench does not have."""
    wanted = {role for action in plan.actions if isinstance(action, Engage) for role in action.modes}
    missing = sorted(wanted - bench.drives.keys())
    if missing:
        raise InputError(
            f"protocol '{plan.name}' moves the {' and the '.join(missing)} drive;"
            f" bench '{bench.file.name}' has {', '.join(sorted(bench.drives)) or 'none'}"
        )


def _check_quantities(plan: Plan, bench: Bench) -> None:
    """Raise if no device measures a quantity that the plan needs."""
    measured = {channel.quantity for channels in bench.streams().values() for channel in channels}
    missing = [quantity for quantity in plan.needs if quantity not in measured]
    if missing:
        raise InputError(
            f"protocol '{plan.name}' needs {', '.join(missing)}; no device of bench '{bench.file.name}' measures that"
        )


def _check_awaited_channels(plan: Plan, bench: Bench) -> None:
    """Raise if the plan has a wait, a criterion or a condition on a channel that no device measures."""
    measured = {(channel.quantity, channel.role) for channels in bench.streams().values() for channel in channels}
    awaiting: list[WaitUntil | Until | InRange] = [action for action in plan.actions if isinstance(action, WaitUntil)]
    awaiting += [action.until for action in plan.actions if isinstance(action, Segment) and action.until is not None]
    conditions = [action.condition for action in plan.actions if isinstance(action, When)]
    awaiting += [condition for condition in conditions if isinstance(condition, InRange)]
    awaited = dict.fromkeys((item.quantity, item.role) for item in awaiting)
    if missing := [f"{quantity} of {role}" for quantity, role in awaited if (quantity, role) not in measured]:
        raise InputError(
            f"protocol '{plan.name}' depends on {', '.join(missing)};"
            f" no device of bench '{bench.file.name}' measures that"
        )
