"""Readings that count: none at the end of a channel's range, and none that repeats an old reading."""

from collections.abc import Sequence
from dataclasses import replace

from leactl.analysis.estimate import NAN, Noted, listed
from leactl.analysis.quality.repeated_readings import mask_repeats
from leactl.analysis.quality.saturation import saturated
from leactl.analysis.signals.levels import CURRENT_HOLDS, Hold, HoldSelector, span
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run


def usable_channel(run: Run, quantity: str, held: HoldSelector = CURRENT_HOLDS, least: int = 2) -> Noted[Channel]:
    """Return a channel of the test actuator with NaN for saturated and repeated readings, and a note on each kind.

    Parameters
    ----------
    held : selects the holds whose readings are judged.
    least : number of distinct setpoints that must lie within the channel's range.

    Raises
    ------
    NotIdentifiable : fewer levels than the `least` lie within the channel's range.
    """
    channel, holds = run.channel(quantity, role="test"), held.holds_of(run)
    unsaturated, ends = within_range(channel, holds)
    saturated_holds = [hold for holds_at_end in ends.values() for hold in holds_at_end]
    notes = []
    for value, holds_at_end in ends.items():
        where = f"{quantity} of test is saturated at {value:g} in {len(holds_at_end)} holds ({listed(holds_at_end)})"
        if len({round(hold.setpoint, 9) for hold in holds if hold not in saturated_holds}) < least:
            needed = "two levels or more" if least > 1 else "one level or more"
            raise NotIdentifiable(f"{run.path}: {where}; {needed} within the sensor's range are needed")
        notes.append(f"{run.path}: {where}, which do not count")
    distinct = without_repeated_readings(unsaturated, holds, str(run.path))
    return Noted(distinct.value, (*notes, *distinct.notes))


def within_range(channel: Channel, holds: Sequence[Hold]) -> tuple[Channel, dict[float, list[Hold]]]:
    """Replace readings of saturated holds by NaN; return the channel and the holds by the value they saturate at."""
    ends: dict[float, list[Hold]] = {}
    for _ in range(2):  # a range has two ends
        value, at_end = saturated(channel, holds)
        if not at_end:
            break
        ends[value] = at_end
        values = channel.values.copy()
        for hold in at_end:
            values[span(channel, hold.start, hold.stop)] = NAN
        channel = replace(channel, values=values)
    return channel, ends


def without_repeated_readings(channel: Channel, holds: Sequence[Hold], place: str) -> Noted[Channel]:
    """Replace repeated readings by NaN; a note opened by `place` says how many lie in the holds."""
    kept, count = mask_repeats(channel, holds)
    what = f"{count} readings of {channel.quantity} came again in place of new ones and count as missed"
    return Noted(kept, (f"{place}: {what}",) if count else ())
