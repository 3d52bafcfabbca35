"""Convert and check criteria on channels, for waits, holds, trials and conditions."""

import math

from leactl.protocol.plan import FEWEST_WINDOW_SAMPLES, Until
from leactl.protocol.steps import CriterionBlock, ProtocolStep, WaitStep, WhenStep
from leactl.protocol.timeline import Timeline
from leactl.quantities import UNITS


def criterion(
    timeline: Timeline, step: ProtocolStep, keys: tuple[str, str], times: tuple[float, float], *, required: bool = False
) -> Until:
    """Return the criterion of a step, and add its faults to the timeline.

    Parameters
    ----------
    keys : keys of the criterion and of the duration in the step.
    times : duration and settle time of the step [s].
    required : whether the run fails if the criterion is never met.
    """
    criterion_key, duration_key = keys
    duration_s, settle_s = times
    block: CriterionBlock = getattr(step.content, criterion_key)
    low, high = bounds(timeline, step, block, (criterion_key,), "/s" if block.statistic == "slope" else "")
    window_path = criterion_key, "window_s"
    if settle_s + block.window_s > duration_s:
        message = f"settle_s and a window of {block.window_s:g} s are longer than {duration_key}; less was expected"
        timeline.add_fault(step, window_path, message)
    shortest_window_s = FEWEST_WINDOW_SAMPLES / timeline.rate_hz
    if block.window_s < shortest_window_s * (1 - 1e-9):
        message = (
            f"{block.window_s:g} s: at least {FEWEST_WINDOW_SAMPLES} cycles ({shortest_window_s:g} s) were expected"
        )
        timeline.add_fault(step, window_path, message)
    return Until(block.quantity, block.role, block.statistic, block.window_s, low, high, required)


def bounds(
    timeline: Timeline,
    step: ProtocolStep,
    content: WaitStep | CriterionBlock | WhenStep,
    path: tuple[str, ...] = (),
    unit_suffix: str = "",
) -> tuple[float, float]:
    """Return the lowest and highest value that meet a criterion, infinite if open, and add its faults to the timeline.

    Parameters
    ----------
    path : path of keys from the step to the criterion.
    unit_suffix : suffix of the unit, "/s" for a slope.
    """
    unit = UNITS.get(content.quantity or "")
    if unit is None:
        message = f"{content.quantity!r}: one of {', '.join(UNITS)} was expected"
        timeline.add_fault(step, (*path, "quantity"), message)
    elif content.unit != unit + unit_suffix:
        timeline.add_fault(step, (*path, "unit"), f"{content.unit!r}: {content.quantity} is in {unit + unit_suffix}")
    low = -math.inf if content.above is None else content.above
    high = math.inf if content.below is None else content.below
    if math.isinf(low) and math.isinf(high):
        timeline.add_fault(step, (*path, "below"), "below, above or both were expected")
    if low > high:
        message = f"no value is below {high:g} and above {low:g}"
        if path:
            timeline.add_fault(step, (*path, "below"), message)
        else:
            timeline.add_fault_of_either(step, ("below", "above"), message)
    return low, high
