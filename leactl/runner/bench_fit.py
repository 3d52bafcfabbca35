"""Checks that a bench fits a plan, before anything is touched; used by runs and by plans of runs."""

from leactl.bench.bench import Bench
from leactl.bench.benchfile import BenchFile
from leactl.driver.contract import Mode
from leactl.errors import InputError
from leactl.protocol.plan import ChannelBounds, Engage, InRange, Plan, Segment, SetSupply, Until, WaitUntil, When
from leactl.runner.channel_limits import ChannelLimits
from leactl.safety.plan_checks import check_setpoints
from leactl.safety.witnesses import lone_sensors


def check_fit(plan: Plan, bench: Bench) -> None:
    """Refuse a plan whose set-up, setpoints, drives or channels are not the bench's.

    Raises
    ------
    InputError : the first misfit.
    """
    check_setup(plan, bench.file)
    _check_roles(plan, bench)
    _check_needs(plan, bench)
    _check_awaited_channels(plan, bench)
    limits_of(plan, bench)  # raises if the bench measures no channel of a limit


def check_setup(plan: Plan, file: BenchFile) -> None:
    """Refuse another set-up than the bench is built for, and setpoints beyond its limits."""
    if file.setup is not None and file.setup != plan.setup:
        raise InputError(f"protocol '{plan.name}' needs set-up '{plan.setup}'; bench '{file.name}' is '{file.setup}'")
    check_setpoints(file.limits, plan.peaks())


def limits_of(plan: Plan, bench: Bench) -> ChannelLimits:
    """Return the plan's limits on channels.

    Raises
    ------
    InputError : the bench measures no such channel.
    """
    limits = [limit for limit in plan.acceptance if isinstance(limit, ChannelBounds)]
    return ChannelLimits(limits, bench.streams(), bench.file.name)


def unwitnessed(plan: Plan, bench: Bench) -> list[str]:
    """Return one line for each winding that a plan heats and whose bound rests on one sensor."""
    heated: dict[str, str] = {}
    for action in plan.actions:
        if isinstance(action, Engage):
            heated |= {role: "q_axis_current" for role, mode in action.modes.items() if mode is not Mode.OFF}
        elif isinstance(action, SetSupply):
            heated |= {role: "line_current" for role, output in action.outputs.items() if output is not None}
    channels = [channel for stream in bench.streams().values() for channel in stream]
    test_first = dict(sorted(heated.items(), reverse=True))
    return lone_sensors(bench.file.interlocks, channels, plan.setup, test_first)


def _check_roles(plan: Plan, bench: Bench) -> None:
    wanted = {role for action in plan.actions if isinstance(action, Engage) for role in action.modes}
    missing = sorted(wanted - bench.drives.keys())
    if missing:
        raise InputError(
            f"protocol '{plan.name}' moves the {' and the '.join(missing)} drive;"
            f" bench '{bench.file.name}' has {', '.join(sorted(bench.drives)) or 'none'}"
        )


def _check_needs(plan: Plan, bench: Bench) -> None:
    measured = {channel.quantity for channels in bench.streams().values() for channel in channels}
    missing = [quantity for quantity in plan.needs if quantity not in measured]
    if missing:
        raise InputError(
            f"protocol '{plan.name}' needs {', '.join(missing)}; no device of bench '{bench.file.name}' measures that"
        )


def _check_awaited_channels(plan: Plan, bench: Bench) -> None:
    """Refuse a plan with a wait, a criterion or a condition on a channel that no device measures."""
    measured = {(channel.quantity, channel.role) for channels in bench.streams().values() for channel in channels}
    readers: list[WaitUntil | Until | InRange] = [action for action in plan.actions if isinstance(action, WaitUntil)]
    readers += [action.until for action in plan.actions if isinstance(action, Segment) and action.until is not None]
    conditions = [action.condition for action in plan.actions if isinstance(action, When)]
    readers += [condition for condition in conditions if isinstance(condition, InRange)]
    awaited = dict.fromkeys((reader.quantity, reader.role) for reader in readers)
    if missing := [f"{quantity} of {role}" for quantity, role in awaited if (quantity, role) not in measured]:
        raise InputError(
            f"protocol '{plan.name}' waits for {', '.join(missing)};"
            f" no device of bench '{bench.file.name}' measures that"
        )
