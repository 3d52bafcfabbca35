"""Judge every measured channel of a run by its demand, its noise and its neighbours before an analysis reads it.

A channel that contradicts its demand throughout is condemned: whoever reads it is refused with the reason, and where
nothing reads it the reason is a note. What hangs for a part of the record, or lacks readings, is a note. No criterion
has a unit or a rate, so that a machine of any size is judged alike.
"""

from collections.abc import Iterator

import numpy as np

from leactl.analysis.quality.following import following
from leactl.analysis.quality.hanging import RepeatedReading, hangs, longest_repeat, stands_while_other_moves
from leactl.analysis.quality.saturation import clipped
from leactl.analysis.quality.sign_checks import SWAPPED
from leactl.analysis.quality.wrong_units import LIMITS, beyond_limits
from leactl.analysis.signals.levels import HoldSelector, span
from leactl.runfile.reader import Array, Channel, Run

DEMANDS = {
    "q_axis_current": "q_axis_current_reference",
    "velocity": "velocity_reference",
    "angle": "angle_reference",
}
HELD = {"q_axis_current": "current_A", "velocity": "velocity_rad_s"}  # the same in the parameters of a hold
TOGETHER = {  # where one moves far, the other does not stand
    "line_voltage": "line_current",
    "line_current": "line_voltage",
    "phase_voltage_ab": "phase_voltage_bc",
    "phase_voltage_bc": "phase_voltage_ca",
    "phase_voltage_ca": "phase_voltage_ab",
}
LOOP = ("phase_voltage_ab", "phase_voltage_bc", "phase_voltage_ca")
UNBALANCED = 0.3  # of a voltage between leads: gains of a data acquisition are a few percent apart
FEWEST_VOLTAGES = 20  # readings of all three
DRIVING = ("velocity", "angle")  # that a drive follows by a current of its own choice
AT_REST = ("q_axis_current", "velocity", "angle")  # which repeat their reading while a drive is off or a shaft stands
NEVER_NEGATIVE = ("bus_voltage",)
HEATED = ("winding_temperature", "housing_temperature")  # whose places warm and cool together
SUPPLIED = ("line_current", "line_voltage")
NEVER_ZERO = ("bus_voltage", "winding_temperature", "housing_temperature", "ambient_temperature", "drive_temperature")
STANDS = 0.25  # of a record, that a voltage across a winding that warms does not stay the same for
WARMEST_ROOM = 60.0  # degC, as 0 degC the other end of where people and instruments work
NOT_MEASURED = ("drive_enabled",)
MISSING = 0.01  # of a channel's readings, above which a note says so
NEARLY_ALL = 0.99  # of a channel's readings, that no analysis can do without
APART = 0.5  # of the larger, between the path of an angle and the integral of its velocity: a filter's lag is less
PLAIN = 0.2  # of the farthest way in a part: below, the zero of a tachometer may be what turns
FEWEST_APART = 3  # parts in which they are apart
PARTS = 64  # of a record, in each of which path and integral are compared
CLEAR = 10.0  # counts of the encoder: below, the shaft may stand
SURE = 5.0  # standard deviations of what a velocity's noise adds up to in a part: a chance of 1e-6 a part


def channel_doubts(run: Run) -> list[str]:
    """Notes on the channels of a run that cannot be believed; those that contradict their demand are condemned."""
    notes = beyond_limits([run], [name for name in LIMITS if run.channels(name)])
    notes += [note for role in ("test", "load") for note in contradicting_motion(run, role)]
    notes += [note for role in ("test", "load") for note in contradicting_voltages(run, role)]
    for stream, specs in run.streams.items():
        for spec in specs:
            if spec.quantity.endswith("_reference") or spec.quantity in NOT_MEASURED or not spec.quantity:
                continue
            channel = run.channel_at(f"{stream}/{spec.name}")
            if not np.isfinite(channel.values).any():
                continue
            notes += notes_on_channel(run, f"{stream}/{spec.name}", channel)
    return notes


def notes_on_channel(run: Run, name: str, channel: Channel) -> Iterator[str]:
    """What is wrong with one channel, a note each."""
    opening = f"{run.path}: {label_of(channel)}"
    row = longest_repeat(channel.values)
    hint = hanging(run, channel, row) if row is not None else ""
    reason = contradiction(run, channel)
    if not reason and hint and channel.quantity in DEMANDS and row is not None:
        reason = hint if row.length > NEARLY_ALL * np.isfinite(channel.values).sum() else ""
    if not reason and channel.quantity == "line_current" and row is not None and row.value:
        reason = hint  # the heat is not known
    if reason:
        run.condemned[name] = f"{opening} {reason}"
        yield run.condemned[name]
        return
    if hint or (hint := standing(run, channel, row)):
        yield f"{opening} {hint}"
    demand = demand_of(run, channel)
    found = following(demand, channel.values, from_zero=channel.quantity != "angle") if demand is not None else None
    if found is not None and found.fault == "unit":
        yield f"{opening} is {found.gain:.3g} times its demand: check its units"
    between = np.flatnonzero(np.isfinite(channel.values))
    lacking = float(np.mean(~np.isfinite(channel.values[between[0] : between[-1] + 1])))
    if lacking > MISSING:
        yield f"{opening}: {lacking:.1%} of its readings are missing"


def label_of(channel: Channel) -> str:
    """Quantity, role and device of a channel, and where it was measured if that is known."""
    where = f" at {channel.location}" if channel.location else ""
    return f"{channel.quantity} of {channel.role}{where} ({channel.device or 'device not known'})"


def contradiction(run: Run, channel: Channel) -> str:
    """Why a channel cannot be a measurement at all; empty where it may."""
    demand = demand_of(run, channel)
    if demand is not None:
        found = following(demand, channel.values, from_zero=channel.quantity != "angle")
        fault = found.fault if found is not None else ""
        at = most_wanted(demand)
        asked = f"{demand[at]:.4g} {channel.units} were demanded at {channel.time[at]:.3g} s{step_at(run, channel, at)}"
        reads = f"{channel.values[at]:.4g}"
        if fault == "opposite":
            return f"has the opposite sign of its demand: it reads {reads} where {asked}; {SWAPPED}"
        if fault == "dead":
            return f"does not follow its demand: it reads {reads} where {asked}; is its sensor connected?"
    if channel.quantity in HEATED and len(others := neighbours(run, channel, region_of(channel))) > 1:
        found = following(np.median(others, axis=0), channel.values, from_zero=False)
        if found is not None and found.fault == "opposite":
            return f"falls where the {len(others)} other places of its region rise: its sign is turned"
    if channel.quantity in NEVER_ZERO and not np.any(np.nan_to_num(channel.values)):
        return f"reads exactly 0 {channel.units} throughout; is its sensor connected?"
    if channel.quantity in NEVER_NEGATIVE and float(np.nanmedian(channel.values)) < 0.0:
        most = float(np.nanmin(channel.values))
        return f"reads down to {most:.4g} {channel.units}, above zero was expected: its leads are swapped"
    return ""


def hanging(run: Run, channel: Channel, row: RepeatedReading) -> str:
    """Where a channel repeats one reading that it should not; empty where it may."""
    if channel.quantity in (*HEATED, *SUPPLIED) and leaves_its_range(channel, row):
        return ""  # the analysis says so, and does without those readings
    moved = any(stands_while_other_moves(row, other) for other in companions(run, channel))
    resting = channel.quantity in AT_REST and row.value == 0.0
    if not moved and (resting or channel.quantity == "angle" or not hangs(channel.values, row)):
        return ""
    begin, end = float(channel.time[row.first]), float(channel.time[row.last])
    what = "although what moves with it did" if moved else "although its noise shows elsewhere"
    return (
        f"hangs: exactly {row.value:.6g} {channel.units} in {row.length} readings from {begin:.4g} to {end:.4g} s"
        f"{step_at(run, channel, row.first)}, {what}"
    )


def standing(run: Run, channel: Channel, row: RepeatedReading | None) -> str:
    """What else is to be told of a reading that stays as it is, or that no laboratory has; empty for most."""
    lasts = row is not None and row.value != 0.0 and row.length > STANDS * len(channel.values)
    if row is not None and lasts and channel.quantity == "line_voltage":
        begin, end = float(channel.time[row.first]), float(channel.time[row.last])
        return (
            f"stays at exactly {row.value:.6g} {channel.units} from {begin:.4g} to {end:.4g} s"
            f"{step_at(run, channel, row.first)}: it hangs, or the winding no longer warms"
        )
    if channel.quantity == "ambient_temperature":
        least = float(np.nanmedian(channel.values))
        if not 0.0 <= least <= WARMEST_ROOM:
            return f"reads {least:.1f} {channel.units}: are its sign and its unit right?"
        if row is not None and row.length == np.isfinite(channel.values).sum() > FEWEST_APART:
            return f"reads exactly {row.value:.6g} {channel.units} throughout: does it measure?"
    return ""


def leaves_its_range(channel: Channel, row: RepeatedReading) -> bool:
    """Whether a row is the end of a sensor's range, to which readings come and from which they go again."""
    return clipped(channel) == row.value and row.last < int(np.flatnonzero(np.isfinite(channel.values))[-1])


def demand_of(run: Run, channel: Channel, quantity: str = "") -> Array | None:
    """The demand of a channel, or of another quantity of the same drive, at its own readings; None without one.

    Where a run has no channel of it, the settled parts of its holds tell.
    """
    quantity = quantity or channel.quantity
    reference = beside(run, channel, DEMANDS.get(quantity))
    if reference is not None or quantity not in HELD:
        return reference
    demand = np.full(len(channel.time), np.nan)
    for hold in HoldSelector(HELD[quantity], "", channel.role).levels(run):
        demand[span(channel, hold.start, hold.stop)] = hold.setpoint
    return demand if np.isfinite(demand).any() else None


def companions(run: Run, channel: Channel) -> Iterator[Array]:
    """What a channel cannot stand beside while it moves: its demand, its partner, the motion that a current drives."""
    others = [demand_of(run, channel), beside(run, channel, TOGETHER.get(channel.quantity))]
    if channel.quantity in HEATED:
        others += neighbours(run, channel)
    if channel.quantity == "q_axis_current":
        others += [demand_of(run, channel, quantity) for quantity in DRIVING]
    yield from (other for other in others if other is not None)


def neighbours(run: Run, channel: Channel, region: str | None = None) -> list[Array]:
    """The same quantity at other places of the same actuator, or of a region of it, where they have the same stamps.

    A place that is condemned tells nothing of the others.
    """
    names = [f"{channel.stream}/{spec.name}" for spec in run.streams[channel.stream]]
    alike = [(channel.quantity, channel.role) == (spec.quantity, spec.role) for spec in run.streams[channel.stream]]
    places = [run.channel_at(name) for name, one in zip(names, alike, strict=True) if one and name not in run.condemned]
    return [
        other.values
        for other in places
        if other.location != channel.location and np.isfinite(other.values).any()
        if region in (None, region_of(other))
    ]


def region_of(channel: Channel) -> str:
    """The part of an actuator that a place is in: `active` of `active_2`; one part may cool while another warms."""
    return channel.location.partition("_")[0]


def beside(run: Run, channel: Channel, quantity: str | None) -> Array | None:
    """The one other channel of this quantity and the same role, where it has the same stamps."""
    others = run.channels(quantity, channel.role) if quantity else []
    if len(others) != 1 or others[0].stream != channel.stream or not np.isfinite(others[0].values).any():
        return None
    return others[0].values


def most_wanted(demand: Array) -> int:
    """The middle of the readings whose demand is largest: settled, where it is held."""
    size = np.abs(np.nan_to_num(demand))
    at = np.flatnonzero(size == size.max())
    return int(at[len(at) // 2])


def step_at(run: Run, channel: Channel, at: int) -> str:
    """The step of a run in which a reading was taken, in words."""
    time = float(channel.time[at])
    name = next((step.name for step in run.steps if step.start <= time < step.stop), "")
    return f" (step '{name}')" if name else ""


def contradicting_motion(run: Run, role: str) -> Iterator[str]:
    """A note where the path of an angle and the integral of the velocity do not agree that the shaft turned."""
    angles, velocities = run.channels("angle", role), run.channels("velocity", role)
    if len(angles) != 1 or len(velocities) != 1 or angles[0].stream != velocities[0].stream:
        return
    angle, velocity = angles[0], velocities[0]
    good = np.isfinite(angle.values) & np.isfinite(velocity.values)
    time, turned, speed = angle.time[good], angle.values[good], velocity.values[good]
    if len(time) < 2 * PARTS:
        return
    pace = np.diff(time)
    gone = np.concatenate([[0.0], np.cumsum(0.5 * pace * (speed[1:] + speed[:-1]))])
    cuts = np.linspace(0, len(time) - 1, PARTS + 1).astype(int)
    path, integral = np.diff(turned[cuts]), np.diff(gone[cuts])
    # what the speed does between two readings, its noise included, may be missed by the integral
    wander = np.diff(speed) * pace
    missed = np.diff(np.concatenate([[0.0], np.cumsum(np.abs(wander))])[cuts])
    # and what noise adds up to: in a part of few readings their differences alone may be small by chance
    scatter = np.diff(np.concatenate([[0.0], np.cumsum(0.5 * wander**2)])[cuts])
    missed += SURE * np.sqrt(np.maximum(scatter, np.median(scatter)))
    steps = np.abs(np.diff(turned))
    resolution = float(np.min(steps[steps > 0.0], initial=np.inf))
    clear = missed + CLEAR * (resolution if np.isfinite(resolution) else 0.0)
    larger = np.maximum(np.abs(path), np.abs(integral))
    apart = (larger > PLAIN * larger.max()) & (np.abs(path - integral) > np.maximum(APART * larger, clear))
    if apart.sum() >= FEWEST_APART:
        path, integral = path[apart], integral[apart]
        begin, end = (float(time[cuts[at]]) for at in (np.flatnonzero(apart)[0], np.flatnonzero(apart)[-1] + 1))
        yield (
            f"{run.path}: {label_of(angle)} and {label_of(velocity)} contradict each other: the angle goes"
            f" {float(np.abs(path).sum()):.4g} {angle.units} where the velocity adds up to"
            f" {float(np.abs(integral).sum()):.4g}, from {begin:.4g} to {end:.4g} s; one of them hangs, or is in"
            " another unit or sense"
        )


def contradicting_voltages(run: Run, role: str) -> Iterator[str]:
    """A note where the three voltages between the leads do not add up to zero, as around any loop (Kirchhoff)."""
    found = [channel for name in LOOP for channel in run.channels(name, role)]
    if [channel.quantity for channel in found] != list(LOOP) or len({channel.stream for channel in found}) > 1:
        return
    voltages = np.array([channel.values for channel in found])
    voltages = voltages[:, np.isfinite(voltages).all(axis=0)]
    if voltages.shape[1] < FEWEST_VOLTAGES:
        return
    sizes = np.sqrt(np.mean(voltages**2, axis=1))
    left = voltages.sum(axis=0)
    if not float(np.sqrt(np.mean(left**2))) > UNBALANCED * float(np.median(sizes)):
        return
    turned = np.sqrt(np.mean((left - 2.0 * voltages) ** 2, axis=1))  # of the sum, were the sign of one the other
    at = int(np.argmin(turned))
    told = f"{run.path}: {', '.join(label_of(channel) for channel in found)} do not add up to zero"
    if turned[at] < UNBALANCED * sizes[at]:
        yield f"{told}: the leads of {found[at].quantity} are swapped"
    else:
        yield f"{told}: one of them is not connected, or reads in another unit"
