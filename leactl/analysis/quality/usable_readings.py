"""Readings that count: none at the end of a channel's range, and none that came again in place of a new one."""

from collections.abc import Sequence
from dataclasses import replace

from leactl.analysis.estimate import NAN, listed
from leactl.analysis.quality.repeated_readings import without_repeats
from leactl.analysis.quality.saturation import saturated
from leactl.analysis.signals.levels import CURRENT_HELD, Held, Hold, span
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run


def usable(run: Run, quantity: str, notes: list[str], held: Held = CURRENT_HELD, least: int = 2) -> Channel:
    """A channel of the test actuator with the readings that do not count as missed; the notes say which.

    Raises
    ------
    NotIdentifiable : fewer levels than the `least` lie within the channel's range.
    """
    channel, holds = run.channel(quantity, role="test"), held.levels(run)
    found, ends = within_range(channel, holds)
    reached = [hold for at_it in ends.values() for hold in at_it]
    for value, at_it in ends.items():
        where = f"{quantity} of test is saturated at {value:g} in {len(at_it)} holds ({listed(at_it)})"
        if len({round(hold.setpoint, 9) for hold in holds if hold not in reached}) < least:
            needed = "two levels or more" if least > 1 else "one level or more"
            raise NotIdentifiable(f"{run.path}: {where}; {needed} within the sensor's range are needed")
        notes.append(f"{run.path}: {where}, which do not count")
    return fresh(found, holds, notes, str(run.path))


def within_range(channel: Channel, holds: Sequence[Hold]) -> tuple[Channel, dict[float, list[Hold]]]:
    """The channel with holds at an end of its range as missed, and which these are by the value it stops at."""
    ends: dict[float, list[Hold]] = {}
    for _ in range(2):  # a range has two ends
        value, reached = saturated(channel, holds)
        if not reached:
            break
        ends[value] = reached
        values = channel.values.copy()
        for hold in reached:
            values[span(channel, hold.start, hold.stop)] = NAN
        channel = replace(channel, values=values)
    return channel, ends


def fresh(channel: Channel, holds: Sequence[Hold], notes: list[str], place: str) -> Channel:
    """The channel with readings that came again as missed; a note says how many those are in the holds."""
    found, count = without_repeats(channel, holds)
    if count:
        what = f"{count} readings of {channel.quantity} came again in place of new ones and count as missed"
        notes.append(f"{place}: {what}")
    return found
