"""Records of a heated run: winding and housing temperatures by a camera, heat by a supply, ambient temperature.

Direct current through two leads of a wye heats two of its three phases, the active windings; the third, the inactive
ones, carries none. With a third of the capacitance and three times the resistances for each phase, the mean of the
phases, 2/3 active and 1/3 inactive, is the winding of the two-node network (paper, section "Thermal Dynamics").
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import NAN, Noted, listed
from leactl.analysis.quality.channel_plausibility import reason_for_hanging
from leactl.analysis.quality.hanging import longest_repeat
from leactl.analysis.quality.saturation import clipping_value
from leactl.errors import InputError, MissingChannel, NotIdentifiable
from leactl.model.thermal_network import ACTIVE_SHARE
from leactl.runfile.read.reader import Channel, Run

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

WINDING, HOUSING, AMBIENT = "winding_temperature", "housing_temperature", "ambient_temperature"
CURRENT, VOLTAGE = "line_current", "line_voltage"
HOTTEST_CELSIUS = 200.0  # degC; no winding stays above it throughout, and a room in kelvin is at 290 to 300
SWITCHED_ON_SHARE = 0.2  # of the largest current, above which it counts as switched on
LEAST_HEATING_SHARE = 0.02  # of the largest current of all records; with less, 4e-4 of the heat, a record only cools
LEAST_CURRENT_A = 0.1  # largest current of a run; less heats too little for a fit
LEAST_VALID_SHARE = 0.5  # of the best location's valid frames; a location with fewer does not count
LONGEST_LAG_S = 900.0  # of the camera's clock behind the supply's
LONGEST_GAP_S = 2.0  # without readings of the supply; longer gaps are not interpolated
SHORTEST_RECORD_S, FEWEST_FRAMES = 60.0, 100  # of a record


@dataclass(frozen=True, eq=False)
class SupplyRecord:
    """Current and voltage of the two leads on one clock, without missing readings."""

    time: Array  # s
    current: Array  # A
    voltage: Array  # V
    means: bool  # each reading is the mean over the interval that ends at its stamp

    @property
    def heat(self) -> Array:
        """Return the electrical power into the winding [W], shape (readings,)."""
        return self.current * self.voltage

    @property
    def on(self) -> Mask:
        """Return which readings have the current switched on, shape (readings,)."""
        return np.asarray(np.abs(self.current) > SWITCHED_ON_SHARE * np.max(np.abs(self.current)))

    def within(self, part: slice) -> "SupplyRecord":
        """Return a part of the readings."""
        return replace(self, time=self.time[part], current=self.current[part], voltage=self.voltage[part])


@dataclass(frozen=True, eq=False)
class HeatingRecord:
    """Temperatures of a part of a run whose heat is known throughout; NaN where the camera missed a frame."""

    run_path: str
    time: Array  # s, of the camera's clock
    winding: Array  # degC, mean of the phases, as the two-node network takes it
    housing: Array  # degC
    active: Array  # degC, of the windings that carry the current
    supply: SupplyRecord
    ambient: Array | None  # degC, at the stamps of the supply


def switched_on_masks(records: Sequence[HeatingRecord]) -> list[Mask]:
    """Return which readings of each record have the current switched on; none in a record that only cools."""
    largest = [float(np.max(np.abs(record.supply.current))) for record in records]
    heated = [current > LEAST_HEATING_SHARE * max(largest) for current in largest]
    return [record.supply.on & is_heated for record, is_heated in zip(records, heated, strict=True)]


def heating_records(run: Run) -> Noted[list[HeatingRecord]]:
    """Return the parts of a run in which heat and temperatures are both known; notes say what is left out.

    Raises
    ------
    MissingChannel : no temperatures of winding or housing, no line current or no line voltage.
    NotIdentifiable : no current flows, or heat and frames are never recorded together for `SHORTEST_RECORD_S`.
    InputError : temperatures that are not in degC, or a resistance below zero.
    """
    supply = supply_of(run)
    camera = run.channels(WINDING)[0] if run.has(WINDING) else run.channel(WINDING)
    winding_means = winding_of(run, camera.time)
    housing_mean = mean_of(run, run.channels(HOUSING) or [run.channel(HOUSING)], camera.time)
    winding, active = winding_means.value
    housing = housing_mean.value
    refuse_exchanged(run, active, housing, "active windings", "housing")
    air = ambient_of(run)
    notes = [*supply.notes, *winding_means.notes, *housing_mean.notes, *air.notes]
    records = []
    for part in gapless_parts(supply.value.time):
        heat = supply.value.within(part)
        if not len(heat.time):
            continue
        start_and_stop = heat.time[[0, -1]] + np.array([-LONGEST_LAG_S, LONGEST_LAG_S])
        frames = slice(*np.searchsorted(camera.time, start_and_stop).tolist())
        valid = int(np.sum(np.isfinite(winding[frames]) & np.isfinite(housing[frames])))
        if valid < FEWEST_FRAMES or heat.time[-1] - heat.time[0] < SHORTEST_RECORD_S:
            if valid:
                notes.append(f"{run.path}: left out {heat.time[0]:.0f} to {heat.time[-1]:.0f} s: {valid} frames of use")
            continue
        ambient = None if air.value is None else np.interp(heat.time, *air.value)
        temperatures = (camera.time[frames], winding[frames], housing[frames], active[frames])
        records.append(HeatingRecord(str(run.path), *temperatures, heat, ambient))
    if not records:
        raise NotIdentifiable(
            f"{run.path}: camera and supply never record together for {SHORTEST_RECORD_S:g} s; both are needed"
        )
    return Noted(records, tuple(notes))


def frame_count(run: Run) -> int:
    """Return the number of frames of the winding in a run, missing ones included."""
    return len(run.channels(WINDING)[0].time)


def supply_of(run: Run) -> Noted[SupplyRecord]:
    """Return current and voltage of the leads at the stamps of the voltage; a note counts the missing readings.

    Raises
    ------
    NotIdentifiable : too few readings, a clipped reading, or no current above `LEAST_CURRENT_A`.
    InputError : a resistance below zero.
    """
    current, voltage = run.channel(CURRENT), run.channel(VOLTAGE)
    amperes, volts = np.isfinite(current.values), np.isfinite(voltage.values)
    if amperes.sum() < 2 or volts.sum() < 2:
        raise NotIdentifiable(f"{run.path}: {CURRENT} or {VOLTAGE} of test has no readings; the heat is not known")
    if voltage.stream == current.stream:
        amperes = volts = amperes & volts
    for channel in (current, voltage):
        refuse_clipped(run, channel)
    good = volts & (voltage.time >= current.time[amperes][0]) & (voltage.time <= current.time[amperes][-1])
    missing = int(np.sum(~np.isfinite(voltage.values))) + int(np.sum(~np.isfinite(current.values)))
    time = voltage.time[good]
    supply = SupplyRecord(
        time,
        np.interp(time, current.time[amperes], current.values[amperes]),
        voltage.values[good],
        voltage.sampling == current.sampling == "mean",
    )
    largest = float(np.max(np.abs(supply.current), initial=0.0))
    if largest < LEAST_CURRENT_A:
        raise NotIdentifiable(f"{run.path}: {CURRENT} of test never exceeds {largest:.3g} A: nothing was heated")
    is_on = supply.on
    if float(np.mean(supply.voltage[is_on] * supply.current[is_on])) <= 0.0:
        ohm = float(np.median(supply.voltage[is_on] / supply.current[is_on]))
        raise InputError(
            f"{run.path}: {VOLTAGE} over {CURRENT} of test is {ohm:.3g} ohm; a resistance above zero was expected:"
            " one of the two has its leads swapped"
        )
    note = f"{run.path}: {missing} readings of the supply are missing"
    return Noted(supply, (note,) if missing else ())


def winding_of(run: Run, time: Array) -> Noted[tuple[Array, Array]]:
    """Return the mean temperature of all phases and that of the active ones [degC] at the camera's stamps."""
    channels = run.channels(WINDING)
    active = [channel for channel in channels if channel.location.startswith("active")]
    inactive = [channel for channel in channels if channel.location.startswith("inactive")]
    if len(channels) == 1 and not active and not inactive:
        note = (
            f"{run.path}: one {WINDING} without a region is taken as the mean of all phases; the resistance goes with"
            " that of the active ones, so its coefficient comes out too high where the supply feeds two leads"
        )
        mean = mean_of(run, channels, time)
        return Noted((mean.value, mean.value), (note, *mean.notes))
    for region, region_channels in (("active", active), ("inactive", inactive)):
        if not region_channels:
            raise MissingChannel(
                f"{run.path}: no {WINDING} of test at a location '{region}_...'; it has"
                f" {listed(channel.location or 'no location' for channel in channels)}. The winding's mean takes"
                " 2/3 active and 1/3 inactive"
            )
    hot, cold = mean_of(run, active, time), mean_of(run, inactive, time)
    refuse_exchanged(run, hot.value, cold.value, "active windings", "inactive ones")
    winding = ACTIVE_SHARE * hot.value + (1.0 - ACTIVE_SHARE) * cold.value
    return Noted((winding, hot.value), (*hot.notes, *cold.notes))


def mean_of(run: Run, channels: Sequence[Channel], time: Array) -> Noted[Array]:
    """Average the channels of a region [degC] at the camera's stamps; NaN where one of them has no reading.

    A channel with readings in fewer than half as many frames as the best does not count: a mean over whichever channels
    have a reading would jump with the differences between them. A channel that hangs does not count either, if another
    channel of its region does not hang.
    """
    moving = without_hanging(run, channels)
    channels, notes, columns = moving.value, [*moving.notes], []
    for channel in channels:
        refuse_not_celsius(run, channel)
        unclipped = without_clipped(run, channel)
        notes += unclipped.notes
        same_clock = len(channel.time) == len(time) and np.array_equal(channel.time, time)
        columns.append(unclipped.value.values if same_clock else interpolated_at(time, unclipped.value))
    valid = np.array([np.isfinite(column).sum() for column in columns])
    if not valid.max(initial=0):
        raise NotIdentifiable(f"{run.path}: {channels[0].quantity} of test was never seen at {_names(channels)}")
    counts = valid >= LEAST_VALID_SHARE * valid.max()
    if not counts.all():
        lost = [channel.location for channel, keep in zip(channels, counts, strict=True) if not keep]
        notes.append(f"{run.path}: left out {listed(lost)}: not seen in most frames")
    if counts.sum() == 1 and len(channels[0].location):
        only = next(channel.location for channel, keep in zip(channels, counts, strict=True) if keep)
        notes.append(f"{run.path}: {only} alone stands for its region; differences within the region do not show")
    mean = np.mean([column for column, keep in zip(columns, counts, strict=True) if keep], axis=0)
    if missing := int(np.sum(~np.isfinite(mean))):
        notes.append(f"{run.path}: {_names(channels)}: {missing} of {len(mean)} frames missing; left out")
    return Noted(np.asarray(mean, np.float64), tuple(notes))


def without_hanging(run: Run, channels: Sequence[Channel]) -> Noted[list[Channel]]:
    """Leave out channels that hang; where all of them hang, replace only the repeated readings by NaN."""
    repeats = [longest_repeat(channel.values) for channel in channels]
    hanging_flags = [
        repeat is not None and bool(reason_for_hanging(run, channel, repeat))
        for channel, repeat in zip(channels, repeats, strict=True)
    ]
    if not any(hanging_flags):
        return Noted(list(channels))
    lost = [
        channel.location or channel.quantity for channel, hangs in zip(channels, hanging_flags, strict=True) if hangs
    ]
    if not all(hanging_flags):
        moving = [channel for channel, hangs in zip(channels, hanging_flags, strict=True) if not hangs]
        return Noted(moving, (f"{run.path}: left out {listed(lost)}, which hangs",))
    without_repeats = []
    for channel, repeat in zip(channels, repeats, strict=True):
        assert repeat is not None  # all channels hang
        values = channel.values.copy()
        values[repeat.first + 1 : repeat.last + 1] = NAN
        without_repeats.append(replace(channel, values=values))
    return Noted(without_repeats, (f"{run.path}: {listed(lost)} hangs; those frames are left out",))


def ambient_of(run: Run) -> Noted[tuple[Array, Array] | None]:
    """Return stamps [s] and temperatures of the air [degC], both of shape (readings,); None where none is recorded."""
    channels = run.channels(AMBIENT, "bench") or run.channels(AMBIENT)
    for channel in channels:
        refuse_not_celsius(run, channel)
    readable = [channel for channel in channels if np.isfinite(channel.values).sum() > 1]
    if not readable:
        note = f"{run.path}: no {AMBIENT}: the air is taken as one temperature throughout, fitted with the network"
        return Noted(None, (note,))
    time = readable[0].time[np.isfinite(readable[0].values)]
    columns = [
        np.interp(time, channel.time[finite], channel.values[finite])
        for channel in readable
        for finite in [np.isfinite(channel.values)]
    ]
    return Noted((time, np.asarray(np.mean(columns, axis=0), np.float64)))


def refuse_exchanged(run: Run, warmer: Array, colder: Array, warmer_name: str, colder_name: str) -> None:
    """Raise if the region that carries the current is colder than the other region: their locations are exchanged.

    The mean difference is taken over the tenth of the frames with the largest differences, when the winding is heated.
    """
    both_finite = np.isfinite(warmer) & np.isfinite(colder)
    difference = (warmer - colder)[both_finite]
    if len(difference) and float(np.mean(difference[np.abs(difference) >= np.quantile(np.abs(difference), 0.9)])) < 0.0:
        raise InputError(
            f"{run.path}: the {colder_name} get {-float(difference.min()):.1f} K warmer than the {warmer_name}, which"
            " carry the current: places of the camera are exchanged"
        )


def refuse_clipped(run: Run, channel: Channel) -> None:
    """Raise if a channel of the supply is clipped: the heat beyond its range is not known."""
    range_end = clipping_value(channel)
    if range_end is not None:
        share = float(np.mean(channel.values == range_end))
        raise NotIdentifiable(
            f"{run.path}: {channel.quantity} of {channel.role} is clipped at {range_end:.4g} {channel.units} in"
            f" {share:.0%} of its readings; the heat is not known: give its input a wider range"
        )


def without_clipped(run: Run, channel: Channel) -> Noted[Channel]:
    """Replace readings at the end of a camera's range by NaN; a note says how many."""
    range_end = clipping_value(channel)
    if range_end is None:
        return Noted(channel)
    at_end = channel.values == range_end
    name = channel.location or channel.quantity
    note = f"{run.path}: {name} is clipped at {range_end:.4g} {channel.units} in {at_end.sum()} frames; left out"
    return Noted(replace(channel, values=np.where(at_end, NAN, channel.values)), (note,))


def refuse_not_celsius(run: Run, channel: Channel) -> None:
    """Raise if a temperature can only be in kelvin."""
    lowest = float(np.nanmin(channel.values, initial=np.inf))
    if HOTTEST_CELSIUS < lowest < np.inf:
        location = f" at {channel.location}" if channel.location else ""
        raise InputError(
            f"{run.path}: {channel.quantity} of {channel.role}{location} is never below {lowest:.1f} {channel.units};"
            " degC was expected, these look like kelvin"
        )


def interpolated_at(time: Array, channel: Channel) -> Array:
    """Interpolate values at other stamps; NaN where the neighbouring readings are over two sampling intervals apart."""
    finite = np.isfinite(channel.values)
    stamps = channel.time[finite]
    if len(stamps) < 2:
        return np.full(len(time), NAN)
    values = np.interp(time, stamps, channel.values[finite], left=NAN, right=NAN)
    next_stamp = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    values[np.diff(stamps)[next_stamp - 1] > 2.0 * float(np.median(np.diff(channel.time)))] = NAN
    return values


def gapless_parts(time: Array) -> list[slice]:
    """Return the parts of a clock between gaps that are too long to interpolate over."""
    steps = np.diff(time)
    longest = max(LONGEST_GAP_S, 3.0 * float(np.median(steps)))
    cuts = [0, *(np.flatnonzero(steps > longest) + 1).tolist(), len(time)]
    return [slice(start, stop) for start, stop in itertools.pairwise(cuts)]


def _names(channels: Sequence[Channel]) -> str:
    return listed(channel.location or channel.quantity for channel in channels)
