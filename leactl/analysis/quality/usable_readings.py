"""Usable readings of a channel: without readings at the end of its range and without repeats of old readings."""

from collections.abc import Sequence
from dataclasses import replace

from leactl.analysis.estimate import NAN, Noted, listed
from leactl.analysis.quality.repeated_readings import mask_repeats
from leactl.analysis.quality.saturation import find_saturation
from leactl.analysis.signals.levels import CURRENT_HOLDS, Hold, HoldSelector, samples_between
from leactl.errors import NotIdentifiable
from leactl.runfile.read.reader import Channel, Run


def usable_channel(
    run: Run, quantity: str, hold_selector: HoldSelector = CURRENT_HOLDS, fewest_levels: int = 2
) -> Noted[Channel]:
    """Return a channel of the test actuator with NaN for saturated and repeated readings, and a note on each kind.

    Parameters
    ----------
    hold_selector : selects the holds whose readings are judged.
    fewest_levels : number of distinct setpoints that must lie within the channel's range.

    Raises
    ------
    MissingChannel : the run has no such channel.
    NotIdentifiable : a level is saturated, and fewer than `fewest_levels` lie within the channel's range.
    """
    channel, holds = run.channel(quantity, role="test"), hold_selector.holds_of(run)
    unsaturated, holds_by_end = within_range(channel, holds)
    saturated_holds = [hold for holds_at_end in holds_by_end.values() for hold in holds_at_end]
    notes = []
    for value, holds_at_end in holds_by_end.items():
        finding = f"{quantity} of test is saturated at {value:g} in {len(holds_at_end)} holds ({listed(holds_at_end)})"
        if len({round(hold.setpoint, 9) for hold in holds if hold not in saturated_holds}) < fewest_levels:
            needed_levels = "two levels or more" if fewest_levels > 1 else "one level or more"
            raise NotIdentifiable(f"{run.path}: {finding}; {needed_levels} within the sensor's range are needed")
        notes.append(f"{run.path}: {finding}, which do not count")
    without_repeats = without_repeated_readings(unsaturated, holds, str(run.path))
    return Noted(without_repeats.value, (*notes, *without_repeats.notes))


def within_range(channel: Channel, holds: Sequence[Hold]) -> tuple[Channel, dict[float, list[Hold]]]:
    """Return a channel with NaN for readings of saturated holds, and these holds by the value that they reach."""
    holds_by_end: dict[float, list[Hold]] = {}
    for _ in range(2):  # a range has two ends
        value, holds_at_end = find_saturation(channel, holds)
        if not holds_at_end:
            break
        holds_by_end[value] = holds_at_end
        values = channel.values.copy()
        for hold in holds_at_end:
            values[samples_between(channel, hold.start, hold.stop)] = NAN
        channel = replace(channel, values=values)
    return channel, holds_by_end


def without_repeated_readings(channel: Channel, holds: Sequence[Hold], prefix: str) -> Noted[Channel]:
    """Return a channel with NaN for repeated readings; a note that `prefix` opens counts those in the holds."""
    masked, count = mask_repeats(channel, holds)
    note = f"{prefix}: {count} readings of {channel.quantity} came again in place of new ones and count as missed"
    return Noted(masked, (note,) if count else ())
