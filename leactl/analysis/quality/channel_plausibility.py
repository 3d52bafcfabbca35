"""Judge every measured channel of a run by its demand, its noise and its neighbours before an analysis reads it.

A channel is condemned if it contradicts its demand throughout, has the wrong sign, is zero throughout, or, for a line
current, repeats a reading other than zero for a part of the record. An analysis that reads a condemned channel fails
with the reason; the reason is also a note. A smaller doubt is only a note. No threshold has a unit or depends on the
sampling rate, except the plausible ambient temperatures.
"""

from collections.abc import Iterator

import numpy as np

from leactl.analysis.quality.hanging import RepeatedReading, hangs, longest_repeat, stands_while_companion_moves
from leactl.analysis.quality.saturation import clipping_value
from leactl.analysis.quality.setpoint_tracking import compare_with_demand
from leactl.analysis.quality.sign_checks import SIGN_SWAPPED
from leactl.analysis.quality.wrong_units import LIMIT_KEYS, beyond_limits
from leactl.analysis.signals.levels import HoldSelector, samples_between
from leactl.runfile.read.reader import Array, Channel, Run

DEMANDS = {
    "q_axis_current": "q_axis_current_reference",
    "velocity": "velocity_reference",
    "angle": "angle_reference",
}
HOLD_KEYS = {"q_axis_current": "current_A", "velocity": "velocity_rad_s"}  # parameter of a hold that is the demand
PARTNERS = {  # while one changes much, the other must change too
    "line_voltage": "line_current",
    "line_current": "line_voltage",
    "phase_voltage_ab": "phase_voltage_bc",
    "phase_voltage_bc": "phase_voltage_ca",
    "phase_voltage_ca": "phase_voltage_ab",
}
VOLTAGE_LOOP = ("phase_voltage_ab", "phase_voltage_bc", "phase_voltage_ca")  # add up to zero
MOST_UNBALANCE = 0.3  # rms of the voltages' sum over that of one; gains of a converter are a few percent apart
FEWEST_VOLTAGES = 20  # instants at which all three are read
CONTROLLED_BY_CURRENT = ("velocity", "angle")  # a demand of these changes the current
CONSTANT_AT_REST = ("q_axis_current", "velocity", "angle")  # while the drive is off or the shaft stands
NEVER_NEGATIVE = ("bus_voltage",)
HEATED_QUANTITIES = ("winding_temperature", "housing_temperature")  # all locations of a region warm and cool together
SUPPLY_QUANTITIES = ("line_current", "line_voltage")
NEVER_ZERO = ("bus_voltage", "winding_temperature", "housing_temperature", "ambient_temperature", "drive_temperature")
LONGEST_VOLTAGE_REPEAT = 0.25  # share of a record; the voltage across a warming winding is not equal for so long
WARMEST_ROOM = 60.0  # degC; a plausible room is between 0 degC and this
NOT_MEASURED = ("drive_enabled",)  # states, not readings
MOST_MISSING_SHARE = 0.01  # of a channel's readings; a note names a larger share
CONDEMNING_REPEAT_SHARE = 0.99  # of a channel's readings; a longer repeat condemns the channel
MOST_PATH_DIFFERENCE = 0.5  # of path and integral, over the larger of the two; the lag of a filter causes less
LEAST_TRAVEL = 0.2  # of the largest travel in a part; in less, the zero error of a tachometer may look like motion
FEWEST_CONTRADICTING_PARTS = 3  # parts of the record in which path and integral must disagree
FEWEST_READINGS = 3  # of a channel; more are needed to say that it repeats one reading throughout
MOTION_PARTS = 64  # of a record, in each of which path and integral are compared
COUNTS_OF_MOTION = 10.0  # of the encoder; with less travel, the shaft may stand
NOISE_STDS = 5.0  # of the integrated noise of a velocity in a part; more has a probability of 1e-6


def channel_doubts(run: Run) -> list[str]:
    """Return notes on the doubtful channels of a run; those that cannot be a measurement become condemned."""
    notes = beyond_limits([run], [name for name in LIMIT_KEYS if run.channels(name)])
    notes += [note for role in ("test", "load") for note in motion_contradictions(run, role)]
    notes += [note for role in ("test", "load") for note in voltage_contradictions(run, role)]
    for stream, specs in run.streams.items():
        for channel_spec in specs:
            if (
                channel_spec.quantity.endswith("_reference")
                or channel_spec.quantity in NOT_MEASURED
                or not channel_spec.quantity
            ):
                continue
            channel = run.channel_at(f"{stream}/{channel_spec.name}")
            if not np.isfinite(channel.values).any():
                continue
            notes += notes_on_channel(run, f"{stream}/{channel_spec.name}", channel)
    return notes


def notes_on_channel(run: Run, name: str, channel: Channel) -> Iterator[str]:
    """Yield a note for each fault of one channel, and condemn the channel if it cannot be a measurement."""
    opening = f"{run.path}: {label_of(channel)}"
    repeat = longest_repeat(channel.values)
    hanging_reason = reason_for_hanging(run, channel, repeat) if repeat is not None else ""
    reason = contradiction(run, channel)
    if not reason and hanging_reason and channel.quantity in DEMANDS and repeat is not None:
        reason = hanging_reason if repeat.length > CONDEMNING_REPEAT_SHARE * np.isfinite(channel.values).sum() else ""
    if not reason and channel.quantity == "line_current" and repeat is not None and repeat.value:
        reason = hanging_reason  # without the current, the heat is not known
    if reason:
        run.condemned[name] = f"{opening} {reason}"
        yield run.condemned[name]
        return
    if hanging_reason or (hanging_reason := reason_for_doubt(run, channel, repeat)):
        yield f"{opening} {hanging_reason}"
    demand = demand_of(run, channel)
    tracking = (
        compare_with_demand(demand, channel.values, from_zero=channel.quantity != "angle")
        if demand is not None
        else None
    )
    if tracking is not None and tracking.fault == "unit":
        yield f"{opening} is {tracking.gain:.3g} times its demand: check its units"
    finite_indices = np.flatnonzero(np.isfinite(channel.values))
    missing_share = float(np.mean(~np.isfinite(channel.values[finite_indices[0] : finite_indices[-1] + 1])))
    if missing_share > MOST_MISSING_SHARE:
        yield f"{opening}: {missing_share:.1%} of its readings are missing"


def label_of(channel: Channel) -> str:
    """Return a text with quantity, role and device of a channel, and its location if it has one."""
    location = f" at {channel.location}" if channel.location else ""
    return f"{channel.quantity} of {channel.role}{location} ({channel.device or 'device not known'})"


def contradiction(run: Run, channel: Channel) -> str:
    """Return the reason why a channel cannot be a measurement; empty if it can be one."""
    demand = demand_of(run, channel)
    if demand is not None:
        tracking = compare_with_demand(demand, channel.values, from_zero=channel.quantity != "angle")
        fault = tracking.fault if tracking is not None else ""
        largest_index = index_of_largest(demand)
        time_text = f"{channel.time[largest_index]:.3g} s{step_at(run, channel, largest_index)}"
        demand_text = f"{demand[largest_index]:.4g} {channel.units} were demanded at {time_text}"
        reading_text = f"{channel.values[largest_index]:.4g}"
        if fault == "opposite":
            return f"has the opposite sign of its demand: it reads {reading_text} where {demand_text}; {SIGN_SWAPPED}"
        if fault == "dead":
            return f"does not follow its demand: it reads {reading_text} where {demand_text}; is its sensor connected?"
    if (
        channel.quantity in HEATED_QUANTITIES
        and len(other_locations := neighbours(run, channel, region_of(channel))) > 1
    ):
        tracking = compare_with_demand(np.median(other_locations, axis=0), channel.values, from_zero=False)
        if tracking is not None and tracking.fault == "opposite":
            return f"falls where the {len(other_locations)} other places of its region rise: its sign is turned"
    if channel.quantity in NEVER_ZERO and not np.any(np.nan_to_num(channel.values)):
        return f"reads exactly 0 {channel.units} throughout; is its sensor connected?"
    if channel.quantity in NEVER_NEGATIVE and float(np.nanmedian(channel.values)) < 0.0:
        lowest = float(np.nanmin(channel.values))
        return f"reads down to {lowest:.4g} {channel.units}, above zero was expected: its leads are swapped"
    return ""


def reason_for_hanging(run: Run, channel: Channel, repeat: RepeatedReading) -> str:
    """Return a text on the readings that a channel repeats although it should change; empty if it need not change."""
    if channel.quantity in (*HEATED_QUANTITIES, *SUPPLY_QUANTITIES) and leaves_its_range(channel, repeat):
        return ""  # the analysis reports these readings and leaves them out
    companion_moves = any(stands_while_companion_moves(repeat, companion) for companion in companions(run, channel))
    may_be_at_rest = channel.quantity in CONSTANT_AT_REST and repeat.value == 0.0
    if not companion_moves and (may_be_at_rest or channel.quantity == "angle" or not hangs(channel.values, repeat)):
        return ""
    start, stop = float(channel.time[repeat.first]), float(channel.time[repeat.last])
    evidence = "although what moves with it did" if companion_moves else "although its noise shows elsewhere"
    return (
        f"hangs: exactly {repeat.value:.6g} {channel.units} in {repeat.length} readings from {start:.4g} to {stop:.4g}"
        f" s{step_at(run, channel, repeat.first)}, {evidence}"
    )


def reason_for_doubt(run: Run, channel: Channel, repeat: RepeatedReading | None) -> str:
    """Return the reason to doubt a constant reading or an ambient temperature; empty if there is none."""
    long_repeat = (
        repeat is not None and repeat.value != 0.0 and repeat.length > LONGEST_VOLTAGE_REPEAT * len(channel.values)
    )
    if repeat is not None and long_repeat and channel.quantity == "line_voltage":
        start, stop = float(channel.time[repeat.first]), float(channel.time[repeat.last])
        return (
            f"stays at exactly {repeat.value:.6g} {channel.units} from {start:.4g} to {stop:.4g} s"
            f"{step_at(run, channel, repeat.first)}: it hangs, or the winding no longer warms"
        )
    if channel.quantity == "ambient_temperature":
        median = float(np.nanmedian(channel.values))
        if not 0.0 <= median <= WARMEST_ROOM:
            return f"reads {median:.1f} {channel.units}: are its sign and its unit right?"
        if repeat is not None and repeat.length == np.isfinite(channel.values).sum() > FEWEST_READINGS:
            return f"reads exactly {repeat.value:.6g} {channel.units} throughout: does it measure?"
    return ""


def leaves_its_range(channel: Channel, repeat: RepeatedReading) -> bool:
    """Return whether the repeated reading is the end of the sensor's range, and later readings are within the range."""
    return clipping_value(channel) == repeat.value and repeat.last < int(
        np.flatnonzero(np.isfinite(channel.values))[-1]
    )


def demand_of(run: Run, channel: Channel, quantity: str = "") -> Array | None:
    """Return the demand of a channel at the channel's stamps; None without a demand.

    `quantity` selects the demand of another quantity of the same drive. If a run has no channel of the demand, the
    setpoints of its settled holds are used, and NaN between them.
    """
    quantity = quantity or channel.quantity
    reference = values_in_stream(run, channel, DEMANDS.get(quantity))
    if reference is not None or quantity not in HOLD_KEYS:
        return reference
    demand = np.full(len(channel.time), np.nan)
    for hold in HoldSelector(HOLD_KEYS[quantity], "", channel.role, unstated_role="test").holds_of(run):
        demand[samples_between(channel, hold.start, hold.stop)] = hold.setpoint
    return demand if np.isfinite(demand).any() else None


def companions(run: Run, channel: Channel) -> Iterator[Array]:
    """Yield the values that a channel must change with: its demand, partner and neighbours, and its motion's demand."""
    candidates = [demand_of(run, channel), values_in_stream(run, channel, PARTNERS.get(channel.quantity))]
    if channel.quantity in HEATED_QUANTITIES:
        candidates += neighbours(run, channel)
    if channel.quantity == "q_axis_current":
        candidates += [demand_of(run, channel, quantity) for quantity in CONTROLLED_BY_CURRENT]
    yield from (candidate for candidate in candidates if candidate is not None)


def neighbours(run: Run, channel: Channel, region: str | None = None) -> list[Array]:
    """Return the same quantity at other locations of the actuator, or of one region of it, with the same stamps.

    Condemned channels are left out.
    """
    names = [f"{channel.stream}/{spec.name}" for spec in run.streams[channel.stream]]
    same_quantity = [
        (channel.quantity, channel.role) == (spec.quantity, spec.role) for spec in run.streams[channel.stream]
    ]
    channels = [
        run.channel_at(name)
        for name, is_same in zip(names, same_quantity, strict=True)
        if is_same and name not in run.condemned
    ]
    return [
        neighbour.values
        for neighbour in channels
        if neighbour.location != channel.location and np.isfinite(neighbour.values).any()
        if region in (None, region_of(neighbour))
    ]


def region_of(channel: Channel) -> str:
    """Return the region of an actuator that a channel's location is in: `active` for `active_2`."""
    return channel.location.partition("_")[0]


def values_in_stream(run: Run, channel: Channel, quantity: str | None) -> Array | None:
    """Return the values of another quantity with a channel's role and stamps; None unless one channel has it."""
    channels = run.channels(quantity, channel.role) if quantity else []
    if len(channels) != 1 or channels[0].stream != channel.stream or not np.isfinite(channels[0].values).any():
        return None
    return channels[0].values


def index_of_largest(demand: Array) -> int:
    """Return the middle index among the readings whose demand is largest."""
    magnitude = np.abs(np.nan_to_num(demand))
    largest_indices = np.flatnonzero(magnitude == magnitude.max())
    return int(largest_indices[len(largest_indices) // 2])


def step_at(run: Run, channel: Channel, index: int) -> str:
    """Return a text that names the step in which reading `index` of a channel was taken; empty outside of all steps."""
    time = float(channel.time[index])
    name = next((step.name for step in run.steps if step.start <= time < step.stop), "")
    return f" (step '{name}')" if name else ""


def motion_contradictions(run: Run, role: str) -> Iterator[str]:
    """Yield a note if the path of the angle and the integral of the velocity disagree."""
    angles, velocities = run.channels("angle", role), run.channels("velocity", role)
    if len(angles) != 1 or len(velocities) != 1 or angles[0].stream != velocities[0].stream:
        return
    angle, velocity = angles[0], velocities[0]
    both_finite = np.isfinite(angle.values) & np.isfinite(velocity.values)
    time, readings_of_angle, speed = angle.time[both_finite], angle.values[both_finite], velocity.values[both_finite]
    if len(time) < 2 * MOTION_PARTS:
        return
    intervals = np.diff(time)
    travel = np.concatenate([[0.0], np.cumsum(0.5 * intervals * (speed[1:] + speed[:-1]))])
    cuts = np.linspace(0, len(time) - 1, MOTION_PARTS + 1).astype(int)
    path, integral = np.diff(readings_of_angle[cuts]), np.diff(travel[cuts])
    # the integral may miss changes of the speed between two readings, noise included
    speed_changes = np.diff(speed) * intervals
    uncertainty = np.diff(np.concatenate([[0.0], np.cumsum(np.abs(speed_changes))])[cuts])
    # the integrated noise, at least its median over all parts: in a part of few readings it may be small by chance
    noise_variance = np.diff(np.concatenate([[0.0], np.cumsum(0.5 * speed_changes**2)])[cuts])
    uncertainty += NOISE_STDS * np.sqrt(np.maximum(noise_variance, np.median(noise_variance)))
    steps = np.abs(np.diff(readings_of_angle))
    resolution = float(np.min(steps[steps > 0.0], initial=np.inf))
    threshold = uncertainty + COUNTS_OF_MOTION * (resolution if np.isfinite(resolution) else 0.0)
    larger_travel = np.maximum(np.abs(path), np.abs(integral))
    is_moving = larger_travel > LEAST_TRAVEL * larger_travel.max()
    contradicts = is_moving & (np.abs(path - integral) > np.maximum(MOST_PATH_DIFFERENCE * larger_travel, threshold))
    if contradicts.sum() >= FEWEST_CONTRADICTING_PARTS:
        path, integral = path[contradicts], integral[contradicts]
        parts = np.flatnonzero(contradicts)
        start, stop = float(time[cuts[parts[0]]]), float(time[cuts[parts[-1] + 1]])
        yield (
            f"{run.path}: {label_of(angle)} and {label_of(velocity)} contradict each other: the angle goes"
            f" {float(np.abs(path).sum()):.4g} {angle.units} where the velocity adds up to"
            f" {float(np.abs(integral).sum()):.4g}, from {start:.4g} to {stop:.4g} s; one of them hangs, or is in"
            " another unit or sense"
        )


def voltage_contradictions(run: Run, role: str) -> Iterator[str]:
    """Yield a note if the three voltages between the leads do not add up to zero (Kirchhoff)."""
    channels = [channel for name in VOLTAGE_LOOP for channel in run.channels(name, role)]
    if [channel.quantity for channel in channels] != list(VOLTAGE_LOOP) or len(
        {channel.stream for channel in channels}
    ) > 1:
        return
    voltages = np.array([channel.values for channel in channels])
    voltages = voltages[:, np.isfinite(voltages).all(axis=0)]
    if voltages.shape[1] < FEWEST_VOLTAGES:
        return
    rms_voltages = np.sqrt(np.mean(voltages**2, axis=1))
    voltage_sum = voltages.sum(axis=0)
    if not float(np.sqrt(np.mean(voltage_sum**2))) > MOST_UNBALANCE * float(np.median(rms_voltages)):
        return
    # rms of the sum with the sign of one voltage reversed
    sums_with_sign_changed = np.sqrt(np.mean((voltage_sum - 2.0 * voltages) ** 2, axis=1))
    suspect_index = int(np.argmin(sums_with_sign_changed))
    opening = f"{run.path}: {', '.join(label_of(channel) for channel in channels)} do not add up to zero"
    if sums_with_sign_changed[suspect_index] < MOST_UNBALANCE * rms_voltages[suspect_index]:
        yield f"{opening}: the leads of {channels[suspect_index].quantity} are swapped"
    else:
        yield f"{opening}: one of them is not connected, or reads in another unit"
