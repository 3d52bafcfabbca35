"""Records of a heated run: winding and housing temperatures by a camera, heat by a supply, ambient temperature.

Direct current through two leads of a wye heats two of its three phases, the active windings; the third phase, the
inactive windings, carries none. With a third of the capacitance and three times the resistances for each phase, the
mean of the phases, 2/3 active and 1/3 inactive, is the winding of the two-node network (paper, section "Thermal
Dynamics").
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
HOTTEST_CELSIUS = 200.0  # degC; no winding stays above it throughout, and a room is at 290 to 300 K
SWITCHED_ON_SHARE = 0.2  # of the largest current; a current above it counts as switched on
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
    means: bool  # whether each reading is the mean over the interval that ends at its stamp

    @property
    def heat(self) -> Array:
        """Return the electrical power into the winding [W], shape (readings,)."""
        return self.current * self.voltage

    @property
    def on(self) -> Mask:
        """Return the mask of the readings with the current switched on, shape (readings,)."""
        return np.asarray(np.abs(self.current) > SWITCHED_ON_SHARE * np.max(np.abs(self.current)))

    def within(self, readings: slice) -> "SupplyRecord":
        """Return the record of a slice of the readings."""
        return replace(self, time=self.time[readings], current=self.current[readings], voltage=self.voltage[readings])


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
    """Return a mask of the readings with the current switched on, for each record; all False if it only cools."""
    peak_currents = [float(np.max(np.abs(record.supply.current))) for record in records]
    heated_flags = [current > LEAST_HEATING_SHARE * max(peak_currents) for current in peak_currents]
    return [record.supply.on & is_heated for record, is_heated in zip(records, heated_flags, strict=True)]


def heating_records(run: Run) -> Noted[list[HeatingRecord]]:
    """Return the parts of a run in which heat and temperatures are both known; notes say what is left out.

    Raises
    ------
    MissingChannel : no temperatures of winding or housing, or of one of the winding's regions, no line current or no
        line voltage.
    NotIdentifiable : no current flows, a channel has no usable readings, or heat and frames are never recorded together
        for `SHORTEST_RECORD_S`.
    InputError : temperatures that are not in degC, regions that are exchanged, or a resistance that is not above zero.
    """
    supply = supply_of(run)
    camera = run.channels(WINDING)[0] if run.has(WINDING) else run.channel(WINDING)
    winding_means = winding_of(run, camera.time)
    housing_mean = mean_of(run, run.channels(HOUSING) or [run.channel(HOUSING)], camera.time)
    winding, active = winding_means.value
    housing = housing_mean.value
    refuse_exchanged(run, active, housing, "active windings", "housing")
    ambient_readings = ambient_of(run)
    notes = [*supply.notes, *winding_means.notes, *housing_mean.notes, *ambient_readings.notes]
    records = []
    for readings in gapless_parts(supply.value.time):
        part_supply = supply.value.within(readings)
        if not len(part_supply.time):
            continue
        frame_limits = part_supply.time[[0, -1]] + np.array([-LONGEST_LAG_S, LONGEST_LAG_S])
        frames = slice(*np.searchsorted(camera.time, frame_limits).tolist())
        valid_frames = int(np.sum(np.isfinite(winding[frames]) & np.isfinite(housing[frames])))
        if valid_frames < FEWEST_FRAMES or part_supply.time[-1] - part_supply.time[0] < SHORTEST_RECORD_S:
            if valid_frames:
                notes.append(
                    f"{run.path}: left out {part_supply.time[0]:.0f} to {part_supply.time[-1]:.0f} s:"
                    f" {valid_frames} frames of use"
                )
            continue
        ambient = None if ambient_readings.value is None else np.interp(part_supply.time, *ambient_readings.value)
        temperatures = (camera.time[frames], winding[frames], housing[frames], active[frames])
        records.append(HeatingRecord(str(run.path), *temperatures, part_supply, ambient))
    if not records:
        raise NotIdentifiable(
            f"{run.path}: camera and supply never record together for {SHORTEST_RECORD_S:g} s; both are needed"
        )
    return Noted(records, tuple(notes))


def frame_count(run: Run) -> int:
    """Return the number of frames of the winding in a run, missing frames included."""
    return len(run.channels(WINDING)[0].time)


def supply_of(run: Run) -> Noted[SupplyRecord]:
    """Return current and voltage of the leads at the stamps of the voltage; a note counts the missing readings.

    Raises
    ------
    MissingChannel : no line current or no line voltage.
    NotIdentifiable : too few readings, a clipped channel, or no current of `LEAST_CURRENT_A` or more.
    InputError : a resistance that is not above zero.
    """
    current, voltage = run.channel(CURRENT), run.channel(VOLTAGE)
    finite_current, finite_voltage = np.isfinite(current.values), np.isfinite(voltage.values)
    if finite_current.sum() < 2 or finite_voltage.sum() < 2:
        raise NotIdentifiable(f"{run.path}: {CURRENT} or {VOLTAGE} of test has no readings; the heat is not known")
    if voltage.stream == current.stream:
        finite_current = finite_voltage = finite_current & finite_voltage
    for channel in (current, voltage):
        refuse_clipped(run, channel)
    usable = (
        finite_voltage
        & (voltage.time >= current.time[finite_current][0])
        & (voltage.time <= current.time[finite_current][-1])
    )
    missing_count = int(np.sum(~np.isfinite(voltage.values))) + int(np.sum(~np.isfinite(current.values)))
    time = voltage.time[usable]
    supply = SupplyRecord(
        time,
        np.interp(time, current.time[finite_current], current.values[finite_current]),
        voltage.values[usable],
        voltage.sampling == current.sampling == "mean",
    )
    peak_current = float(np.max(np.abs(supply.current), initial=0.0))
    if peak_current < LEAST_CURRENT_A:
        raise NotIdentifiable(f"{run.path}: {CURRENT} of test never exceeds {peak_current:.3g} A: nothing was heated")
    is_on = supply.on
    if float(np.mean(supply.voltage[is_on] * supply.current[is_on])) <= 0.0:
        ohm = float(np.median(supply.voltage[is_on] / supply.current[is_on]))
        raise InputError(
            f"{run.path}: {VOLTAGE} over {CURRENT} of test is {ohm:.3g} ohm; a resistance above zero was expected:"
            " one of the two has its leads swapped"
        )
    note = f"{run.path}: {missing_count} readings of the supply are missing"
    return Noted(supply, (note,) if missing_count else ())


def winding_of(run: Run, time: Array) -> Noted[tuple[Array, Array]]:
    """Return the mean temperature of all phases and that of the active windings [degC] at the camera's stamps.

    Raises
    ------
    MissingChannel : active or inactive windings have no temperature.
    NotIdentifiable : a region has no finite temperature.
    InputError : temperatures that are not in degC, or regions that are exchanged.
    """
    channels = run.channels(WINDING)
    active_channels = [channel for channel in channels if channel.location.startswith("active")]
    inactive_channels = [channel for channel in channels if channel.location.startswith("inactive")]
    if len(channels) == 1 and not active_channels and not inactive_channels:
        note = (
            f"{run.path}: one {WINDING} without a region is taken as the mean of all phases; the resistance goes with"
            " that of the active ones, so its coefficient comes out too high where the supply feeds two leads"
        )
        mean = mean_of(run, channels, time)
        return Noted((mean.value, mean.value), (note, *mean.notes))
    for region, region_channels in (("active", active_channels), ("inactive", inactive_channels)):
        if not region_channels:
            raise MissingChannel(
                f"{run.path}: no {WINDING} of test at a location '{region}_...'; it has"
                f" {listed(channel.location or 'no location' for channel in channels)}. The winding's mean takes"
                " 2/3 active and 1/3 inactive"
            )
    active_mean, inactive_mean = mean_of(run, active_channels, time), mean_of(run, inactive_channels, time)
    refuse_exchanged(run, active_mean.value, inactive_mean.value, "active windings", "inactive ones")
    winding = ACTIVE_SHARE * active_mean.value + (1.0 - ACTIVE_SHARE) * inactive_mean.value
    return Noted((winding, active_mean.value), (*active_mean.notes, *inactive_mean.notes))


def mean_of(run: Run, channels: Sequence[Channel], time: Array) -> Noted[Array]:
    """Return the mean of a region's channels [degC] at the camera's stamps; NaN where one of them has no reading.

    A channel with readings in fewer than half as many frames as the best does not count: a mean over whichever channels
    have a reading would jump with the differences between them. A channel that hangs does not count either, if another
    channel of its region does not hang.
    """
    working = without_hanging(run, channels)
    channels, notes, columns = working.value, [*working.notes], []
    for channel in channels:
        refuse_not_celsius(run, channel)
        unclipped = without_clipped(run, channel)
        notes += unclipped.notes
        same_clock = len(channel.time) == len(time) and np.array_equal(channel.time, time)
        columns.append(unclipped.value.values if same_clock else interpolated_at(time, unclipped.value))
    valid_counts = np.array([np.isfinite(column).sum() for column in columns])
    if not valid_counts.max(initial=0):
        raise NotIdentifiable(f"{run.path}: {channels[0].quantity} of test was never seen at {_names(channels)}")
    is_counted = valid_counts >= LEAST_VALID_SHARE * valid_counts.max()
    if not is_counted.all():
        left_out_locations = [
            channel.location for channel, counted in zip(channels, is_counted, strict=True) if not counted
        ]
        notes.append(f"{run.path}: left out {listed(left_out_locations)}: not seen in most frames")
    if is_counted.sum() == 1 and len(channels[0].location):
        only_location = next(channel.location for channel, counted in zip(channels, is_counted, strict=True) if counted)
        notes.append(
            f"{run.path}: {only_location} alone stands for its region; differences within the region do not show"
        )
    mean = np.mean([column for column, counted in zip(columns, is_counted, strict=True) if counted], axis=0)
    if missing_count := int(np.sum(~np.isfinite(mean))):
        notes.append(f"{run.path}: {_names(channels)}: {missing_count} of {len(mean)} frames missing; left out")
    return Noted(np.asarray(mean, np.float64), tuple(notes))


def without_hanging(run: Run, channels: Sequence[Channel]) -> Noted[list[Channel]]:
    """Return the channels that do not hang; if all of them hang, return all, with NaN for the repeated readings."""
    repeats = [longest_repeat(channel.values) for channel in channels]
    hanging_flags = [
        repeat is not None and bool(reason_for_hanging(run, channel, repeat))
        for channel, repeat in zip(channels, repeats, strict=True)
    ]
    if not any(hanging_flags):
        return Noted(list(channels))
    hanging_names = [
        channel.location or channel.quantity for channel, hangs in zip(channels, hanging_flags, strict=True) if hangs
    ]
    if not all(hanging_flags):
        working_channels = [channel for channel, hangs in zip(channels, hanging_flags, strict=True) if not hangs]
        return Noted(working_channels, (f"{run.path}: left out {listed(hanging_names)}, which hangs",))
    without_repeats = []
    for channel, repeat in zip(channels, repeats, strict=True):
        assert repeat is not None  # all channels hang
        values = channel.values.copy()
        values[repeat.first + 1 : repeat.last + 1] = NAN
        without_repeats.append(replace(channel, values=values))
    return Noted(without_repeats, (f"{run.path}: {listed(hanging_names)} hangs; those frames are left out",))


def ambient_of(run: Run) -> Noted[tuple[Array, Array] | None]:
    """Return stamps [s] and temperatures of the air [degC], shape (readings,) each.

    None if no channel of the air has two finite readings; then a note says what is taken in its place.
    """
    channels = run.channels(AMBIENT, "bench") or run.channels(AMBIENT)
    for channel in channels:
        refuse_not_celsius(run, channel)
    readable_channels = [channel for channel in channels if np.isfinite(channel.values).sum() > 1]
    if not readable_channels:
        note = f"{run.path}: no {AMBIENT}: the air is taken as one temperature throughout, fitted with the network"
        return Noted(None, (note,))
    time = readable_channels[0].time[np.isfinite(readable_channels[0].values)]
    columns = [
        np.interp(time, channel.time[finite], channel.values[finite])
        for channel in readable_channels
        for finite in [np.isfinite(channel.values)]
    ]
    return Noted((time, np.asarray(np.mean(columns, axis=0), np.float64)))


def refuse_exchanged(run: Run, warmer: Array, colder: Array, warmer_name: str, colder_name: str) -> None:
    """Raise InputError if the region that carries the current is colder than the other region.

    Their locations are exchanged then. The mean difference is taken over the tenth of the frames with the largest
    differences: those in which the winding is heated.
    """
    both_finite = np.isfinite(warmer) & np.isfinite(colder)
    difference = (warmer - colder)[both_finite]
    if len(difference) and float(np.mean(difference[np.abs(difference) >= np.quantile(np.abs(difference), 0.9)])) < 0.0:
        raise InputError(
            f"{run.path}: the {colder_name} get {-float(difference.min()):.1f} K warmer than the {warmer_name}, which"
            " carry the current: places of the camera are exchanged"
        )


def refuse_clipped(run: Run, channel: Channel) -> None:
    """Raise NotIdentifiable if a channel of the supply is clipped: the heat beyond its range is not known."""
    range_end = clipping_value(channel)
    if range_end is not None:
        share = float(np.mean(channel.values == range_end))
        raise NotIdentifiable(
            f"{run.path}: {channel.quantity} of {channel.role} is clipped at {range_end:.4g} {channel.units} in"
            f" {share:.0%} of its readings; the heat is not known: give its input a wider range"
        )


def without_clipped(run: Run, channel: Channel) -> Noted[Channel]:
    """Return a camera's channel with NaN for the readings at the end of its range; a note says how many they are."""
    range_end = clipping_value(channel)
    if range_end is None:
        return Noted(channel)
    at_end = channel.values == range_end
    name = channel.location or channel.quantity
    note = f"{run.path}: {name} is clipped at {range_end:.4g} {channel.units} in {at_end.sum()} frames; left out"
    return Noted(replace(channel, values=np.where(at_end, NAN, channel.values)), (note,))


def refuse_not_celsius(run: Run, channel: Channel) -> None:
    """Raise InputError if a temperature can only be in kelvin."""
    lowest = float(np.nanmin(channel.values, initial=np.inf))
    if HOTTEST_CELSIUS < lowest < np.inf:
        location = f" at {channel.location}" if channel.location else ""
        raise InputError(
            f"{run.path}: {channel.quantity} of {channel.role}{location} is never below {lowest:.1f} {channel.units};"
            " degC was expected, these look like kelvin"
        )


def interpolated_at(time: Array, channel: Channel) -> Array:
    """Return values interpolated at other stamps [s].

    NaN outside of the channel's finite readings and between neighbours that are over two sampling intervals apart.
    """
    finite = np.isfinite(channel.values)
    stamps = channel.time[finite]
    if len(stamps) < 2:
        return np.full(len(time), NAN)
    values = np.interp(time, stamps, channel.values[finite], left=NAN, right=NAN)
    next_stamp = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    values[np.diff(stamps)[next_stamp - 1] > 2.0 * float(np.median(np.diff(channel.time)))] = NAN
    return values


def gapless_parts(time: Array) -> list[slice]:
    """Return the slices of a clock [s] between gaps that are too long to interpolate over."""
    steps = np.diff(time)
    longest_gap = max(LONGEST_GAP_S, 3.0 * float(np.median(steps)))
    cuts = [0, *(np.flatnonzero(steps > longest_gap) + 1).tolist(), len(time)]
    return [slice(start, stop) for start, stop in itertools.pairwise(cuts)]


def _names(channels: Sequence[Channel]) -> str:
    """Return the locations of channels, or their quantities without a location, for a message."""
    return listed(channel.location or channel.quantity for channel in channels)
