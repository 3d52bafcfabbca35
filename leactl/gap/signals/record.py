"""One run as the equations need it: channels on even clocks, masks of valid samples, and notes on missing data.

A sample that is NaN in the file is interpolated for the filters and left out of every row that it touches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.model.thermal_network import ACTIVE_SHARE
from leactl.runfile.read.reader import Channel, Run
from leactl.runfile.verify.integrity import refuse_altered

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Key = tuple[str, str]  # quantity, role
AMBIENT = "ambient_temperature"
WINDING = ("winding_temperature", "test")
FED_LOCATION, UNFED_LOCATION = "active", "inactive"  # locations of the phases that two leads feed, and of the third
SLOW_QUANTITIES = ("winding_temperature", "housing_temperature", AMBIENT)
FEWEST_SAMPLES = 50  # finite samples of a usable channel
NOTED_MISSING_SHARE = 0.2  # missing share of a channel's samples from which a note says so
INTERPOLATION_REACH = 2.5  # intervals of a channel over which values are interpolated
BURST_GAP_SHARE = 0.3  # share of a run's time in gaps from which its stamps come in bursts
FEWEST_BURST_GAPS = 16  # gaps; with fewer, a run pauses or its clock jumps, and its stamps do not come in bursts
INTERVAL_TOLERANCE = 0.1  # relative difference up to which a stretch takes its run's interval: jitter shifts a median
MOST_DURATION_RATIO = 64.0  # longest duration of a run, over the time that its samples take at their interval
UNBRIDGED_SHARE = 0.05  # share of the time of bursts that stays in gaps
LONG_GAP = 8  # samples; a gap of as many or more is not interpolated
SMOOTHING_REACH = 12  # samples on either side of a long gap that smoothing reaches
STRETCHES, HELD_OUT_EVERY = 16, 8  # stretches of a run, of which one in so many is held out


@dataclass
class Clocked:
    """Channels on one even clock."""

    time: Array
    interval: float
    values: dict[Key, Array] = field(default_factory=dict)
    valid: dict[Key, Mask] = field(default_factory=dict)
    means: set[Key] = field(default_factory=set)  # channels that are means over the interval that ends at the stamp
    unstamped: set[Key] = field(default_factory=set)  # channels of which the file does not say what a stamp means
    lateness: dict[str, float] = field(default_factory=dict)  # by equation: samples by which a replay is stamped late
    setpoints_between: bool = False  # whether setpoints change between the stamps, so that an interval has several
    setpoints_held: bool = False  # whether a run of the log shows that setpoints hold over an interval
    units: dict[Key, str] = field(default_factory=dict)
    counts: dict[Key, float] = field(default_factory=dict)  # smallest step of an angle; almost zero if interpolated
    # stamps and values of interpolated channels, as logged
    between: dict[Key, tuple[Array, Array]] = field(default_factory=dict)
    fed: Array | None = None  # degC, temperature of the phases that two leads feed; None where not measured apart
    begin: float | None = None  # first stamp of the whole run, where this is a stretch
    fastest: float = 0.0  # rad/s or m/s, highest speed of the whole run, where this is a stretch
    reference_delay: float = 0.0  # s, by which an angle's reference acts after its stamp
    decimation: int = 1  # samples of the log in one sample of this clock
    # masks of measured samples where `valid` lacks held-out ones, too; empty where they are equal
    measured: dict[Key, Mask] = field(default_factory=dict)
    aside: bool = False  # whether it only gives a stretch its temperatures; the whole run has the thermal equations
    # for a run read in stretches: means over all samples of the drive's clock in the interval after each stamp
    driven: dict[str, Array] = field(default_factory=dict)

    @property
    def since_begin(self) -> Array:
        """Time [s] since the run began."""
        return self.time - (self.time[0] if self.begin is None else self.begin)

    def get(self, quantity: str, role: str = "test") -> Array | None:
        """Return the values of a channel, or None where the run lacks it."""
        return self.values.get((quantity, role))

    def as_measured(self, quantity: str, role: str = "test") -> Array:
        """Return the values of a channel as measured, before interpolation."""
        key = quantity, role
        return self.between[key][1] if key in self.between else self.values[key]

    def samples_without_reference(self, quantity: str) -> Mask:
        """Return the samples in a long gap of a reference, in which the drive was in another mode, or off."""
        key = quantity, "test"
        if key not in self.between:
            return np.zeros(len(self.time), bool)
        stamps, half_interval = self.between[key][0], 0.5 * self.interval
        next_stamp = np.searchsorted(stamps, self.time - half_interval)
        stamp_before, stamp_after = (
            np.concatenate([[-np.inf], stamps])[next_stamp],
            np.concatenate([stamps, [np.inf]])[next_stamp],
        )
        return np.asarray(
            (stamp_after > self.time + half_interval) & (stamp_after - stamp_before > LONG_GAP * self.interval)
        )

    def all_valid(self, *keys: Key) -> Mask:
        """Return the samples at which all these channels were measured."""
        mask = np.ones(len(self.time), bool)
        for key in keys:
            if key in self.valid:
                mask &= self.valid[key]
        return mask

    def long_gaps(self, keys: Sequence[Key]) -> list[tuple[int, int]]:
        """Return begin and end of each long gap of any of these channels; held-out samples are no gap."""
        masks = self.measured or self.valid
        present = np.ones(len(self.time), bool)
        for key in keys:
            present &= masks.get(key, present)
        ends = np.flatnonzero(np.diff(np.concatenate([[1], present.astype(np.intp), [1]]))).reshape(-1, 2)
        return [(begin, end) for begin, end in ends.tolist() if end - begin >= LONG_GAP]


@dataclass
class Record:
    """One run: its fast clock (drive, torque) and its slow one (camera, supply); either may be None."""

    path: Path
    kind: str  # the protocol, else the mechanical set-up
    mechanical: str
    fast: Clocked | None
    slow: Clocked | None
    setup: dict[str, float]
    notes: list[str] = field(default_factory=list)
    condition: str = ""  # condition of the bench; empty where the file names none
    stretch: str = ""  # begin of the stretch in the run, as text; empty for the whole run
    nominal_effects: Callable[[list[Any]], list[Any]] | None = None
    """Subtracts the effects of the nominal model from the equations of this run; None where the nominal has none."""

    @property
    def run(self) -> str:
        """Name of the file without its ending."""
        return self.path.stem

    @property
    def name(self) -> str:
        """Name of the run, with the begin of the stretch."""
        return self.run + self.stretch

    def hold_out_stretches(self) -> tuple["Record", "Record"]:
        """Return the run without the samples of two of sixteen stretches, and the run with only these.

        Only the masks of valid samples differ.
        """
        clocks = [clock for clock in (self.fast, self.slow) if clock is not None and not clock.aside]
        begin, end = min(clock.time[0] for clock in clocks), max(clock.time[-1] for clock in clocks)

        def masked(clock: Clocked | None, is_held_out: bool) -> Clocked | None:
            if clock is None:
                return None
            stretch = ((clock.time - begin) / (end - begin) * STRETCHES).astype(np.intp)
            is_kept = (stretch % HELD_OUT_EVERY == HELD_OUT_EVERY // 2) == is_held_out
            valid = {key: valid & is_kept for key, valid in clock.valid.items()}
            return replace(clock, valid=valid, measured=clock.valid)

        remaining, held_out = (
            replace(self, fast=masked(self.fast, is_held_out), slow=masked(self.slow, is_held_out))
            for is_held_out in (False, True)
        )
        return remaining, held_out


def read_record(path: Path) -> Record:
    """Read one run file.

    Raises
    ------
    InputError : no run file, one that is not as it was closed, or whose channels cannot be used; one line each.
    """
    refuse_altered([path])
    with Run.open(path) as run:
        return record_of(run)


def record_of(run: Run, channels: list[Channel] | None = None, usual_interval: float | None = None) -> Record:
    """Sort the channels of an open run, all of them or some.

    Parameters
    ----------
    usual_interval : s, sampling interval of the whole run, common to its stretches; by default that of the channels.

    Raises
    ------
    InputError : channels that cannot be used, or that the reader condemned; one line each.
    """
    if channels is None:
        quantity_channels = [
            channel
            for specs in run.streams.values()
            for spec in specs
            if spec.quantity
            for channel in run.channels(spec.quantity, spec.role)
        ]
        channels = list({(c.stream, c.quantity, c.role, c.location): c for c in quantity_channels}.values())
    kind = str(run.attributes.get("protocol") or run.mechanical)
    setup = {k: float(v) for k, v in run.setup.items() if isinstance(v, int | float)}
    condition = str(run.attributes.get("condition") or "")
    return replace(build_record(run.path, kind, run.mechanical, channels, setup, usual_interval), condition=condition)


def build_record(
    path: Path,
    kind: str,
    mechanical: str,
    channels: list[Channel],
    setup: dict[str, float],
    usual_interval: float | None = None,
) -> Record:
    """Sort channels onto a fast and a slow clock, the fast one at the run's usual interval [s] if it is given.

    Raises
    ------
    InputError : no channel has enough samples, or a clock jumps by more than can be interpolated.
    """
    notes: list[str] = []
    usable = []
    for channel in with_bench_ambient(channels):
        finite = np.isfinite(channel.values)
        if finite.sum() < FEWEST_SAMPLES:
            if finite.any() or not channel.quantity.endswith(
                "_reference"
            ):  # an empty reference: the drive was in another mode
                notes.append(
                    f"{path.name}: {channel.quantity} of {channel.role} has {int(finite.sum())} samples; left out"
                )
        else:
            usable.append(channel)
            if finite.all() and np.ptp(channel.values) == 0.0 and not may_rest(channel, mechanical):
                notes.append(f"{path.name}: {channel.quantity} of {channel.role} never changes; is the channel alive?")
            evenly = np.ptp(np.diff(np.flatnonzero(finite))) == 0  # a slower channel on the clock of a faster one
            if (
                finite.mean() <= 1.0 - NOTED_MISSING_SHARE
                and not evenly
                and not channel.quantity.endswith("_reference")
            ):
                notes.append(f"{path.name}: a fifth or more of {channel.quantity} of {channel.role} was not measured")
    if not usable:
        raise InputError(
            f"{path}: no channel with {FEWEST_SAMPLES} samples or more; a diagnosis needs a current or an angle"
        )
    fast = [c for c in usable if not is_slow(c.quantity)]
    slow = [c for c in usable if is_slow(c.quantity)]
    clocks = _on_clock(fast, notes, path, usual_interval), _on_clock(slow, notes, path)
    return Record(path, kind, mechanical, *clocks, setup, notes)


def is_slow(quantity: str) -> bool:
    """Return whether a channel belongs on the clock of camera and supply."""
    return quantity in SLOW_QUANTITIES or quantity.startswith("line_")


def with_bench_ambient(channels: list[Channel]) -> list[Channel]:
    """Return the channels with the ambient temperature of the test actuator as the bench's, if the bench has none."""
    if any(channel.quantity == AMBIENT and channel.role == "bench" for channel in channels):
        return channels
    return [
        replace(channel, role="bench") if (channel.quantity, channel.role) == (AMBIENT, "test") else channel
        for channel in channels
    ]


def may_rest(channel: Channel, mechanical: str) -> bool:
    """Return whether a sound channel may be constant over a whole run."""
    if channel.quantity in ("angle", "velocity"):
        return mechanical in ("locked", "heated") or (mechanical == "free" and channel.role == "load")
    return channel.quantity in ("drive_enabled", AMBIENT) or channel.quantity.endswith("_reference")


def _on_clock(
    channels: list[Channel], notes: list[str], path: Path, usual_interval: float | None = None
) -> Clocked | None:
    """Return channels interpolated to one even clock, that of the stream with most channels; None without channels.

    Raises
    ------
    InputError : the clock jumps by more than can be interpolated.
    """
    if not channels:
        return None
    streams: dict[str, list[Channel]] = {}
    for channel in channels:
        streams.setdefault(channel.stream, []).append(channel)
    leading_stamps = max(streams.values(), key=lambda group: (len(group), len(group[0].time)))[0].time
    own_interval = bridging_interval(leading_stamps)
    if leading_stamps[-1] - leading_stamps[0] > MOST_DURATION_RATIO * own_interval * len(leading_stamps):
        raise InputError(f"{path}: {longest_gap_text(leading_stamps)}; what it measures cannot be put on one clock")
    grid, interval, even = even_grid(
        leading_stamps,
        own_interval
        if usual_interval is None or abs(usual_interval - own_interval) > INTERVAL_TOLERANCE * own_interval
        else usual_interval,
    )
    if not even:
        notes.append(f"{path.name}: stamps are uneven; values are taken in between at {1 / interval:.6g} Hz")
    clocked = Clocked(leading_stamps if even else grid, interval)
    channels_by_key: dict[Key, list[Channel]] = {}
    for channel in channels:
        channels_by_key.setdefault((channel.quantity, channel.role), []).append(channel)
    for key, group in channels_by_key.items():
        values, valid = [], []
        for channel in group:
            finite = np.isfinite(channel.values)
            on_leading_stamps = (
                even and len(channel.time) == len(leading_stamps) and np.array_equal(channel.time, leading_stamps)
            )
            if on_leading_stamps and finite.all():
                values.append(channel.values)
                valid.append(finite)
                continue
            stamps = leading_stamps if on_leading_stamps else channel.time
            reach = INTERPOLATION_REACH * max(
                median_interval(channel.time), interval if interval > 1.5 * median_interval(leading_stamps) else 0.0
            )
            values.append(np.interp(clocked.time, stamps[finite], channel.values[finite]))
            if len(group) == 1:
                clocked.between[key] = stamps[finite], channel.values[finite]
            valid.append(finite if on_leading_stamps else near_stamps(clocked.time, channel.time[finite], reach))
        fed = [column for column, channel in zip(values, group, strict=True) if winding_region(channel) == FED_LOCATION]
        unfed = [
            column for column, channel in zip(values, group, strict=True) if winding_region(channel) == UNFED_LOCATION
        ]
        if key == WINDING and fed and unfed:
            clocked.fed = np.mean(fed, axis=0)
            clocked.values[key] = ACTIVE_SHARE * clocked.fed + (1.0 - ACTIVE_SHARE) * np.mean(unfed, axis=0)
        else:
            clocked.values[key] = np.mean(values, axis=0)
        clocked.valid[key] = without_edges(np.all(valid, axis=0))
        clocked.units[key] = group[0].units
        if key[0] == "angle":
            clocked.counts[key] = smallest_step(group[0].values)
        if group[0].sampling == "mean":
            clocked.means.add(key)
        elif not group[0].sampling:
            clocked.unstamped.add(key)
    return clocked


def even_grid(stamps: Array, usual_interval: float) -> tuple[Array, float, bool]:
    """Return evenly spaced times over stamps, their interval [s], and whether the stamps equal them but for jitter."""
    span = stamps[-1] - stamps[0]
    for interval in dict.fromkeys((usual_interval, bridging_interval(stamps))):
        grid = stamps[0] + interval * np.arange(int(span / interval + 1.5))
        if is_even(grid, stamps):
            return grid, interval, True
    if is_even(grid := np.linspace(stamps[0], stamps[-1], len(stamps)), stamps):
        # stamps rounded to a few digits: their mean interval is right where the median is off by a digit
        return grid, float(span / (len(stamps) - 1)), True
    return stamps[0] + usual_interval * np.arange(int(span / usual_interval + 1.5)), usual_interval, False


def without_edges(valid: Mask) -> Mask:
    """Return the valid samples that are not beside a long gap, from which smoothing carries interpolated values."""
    gaps = np.flatnonzero(np.diff(np.concatenate([[1], valid.astype(np.intp), [1]])))
    away_from_gaps = valid.copy()
    for begin, end in gaps.reshape(-1, 2):
        if end - begin >= LONG_GAP:
            away_from_gaps[max(begin - SMOOTHING_REACH, 0) : end + SMOOTHING_REACH] = False
    return away_from_gaps


def winding_region(channel: Channel) -> str:
    """Return the part of a winding that a location lies in, such as `active` for `active_2`."""
    return channel.location.partition("_")[0]


def is_even(grid: Array, stamps: Array) -> bool:
    """Return whether stamps lie on a grid to within 2 % of its interval."""
    return len(grid) == len(stamps) and float(np.max(np.abs(grid - stamps))) < 0.02 * float(grid[1] - grid[0])


def smallest_step(values: Array) -> float:
    """Return the quantisation step of a channel (1 % quantile of its non-zero steps); 0 if it never changes."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0]
    return float(np.quantile(steps, 0.01)) if len(steps) else 0.0


def bridging_interval(stamps: Array) -> float:
    """Return the median interval of stamps [s]; for bursts, one that leaves `UNBRIDGED_SHARE` of the time in gaps."""
    steps = np.diff(stamps)
    usual_step, span = float(np.median(steps)), float(stamps[-1] - stamps[0])
    gaps = steps[steps > INTERPOLATION_REACH * usual_step]
    if len(gaps) < FEWEST_BURST_GAPS or float(gaps.sum()) < BURST_GAP_SHARE * span:
        return usual_step
    sorted_steps = np.sort(steps)
    bridged_time = np.cumsum(sorted_steps)
    return float(
        sorted_steps[np.searchsorted(bridged_time, (1.0 - UNBRIDGED_SHARE) * bridged_time[-1])] / INTERPOLATION_REACH
    )


def longest_gap_text(stamps: Array) -> str:
    """Return a text on the longest gap between stamps."""
    steps = np.diff(stamps)
    longest = int(np.argmax(steps))
    return f"its clock jumps by {steps[longest]:.6g} s after {stamps[longest] - stamps[0]:.6g} s"


def median_interval(time: Array) -> float:
    """Return the median interval of stamps [s]; 0 for a single stamp."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def near_stamps(grid: Array, stamps: Array, reach: float) -> Mask:
    """Return the mask of the grid times with a stamp within `reach` [s] on either side."""
    next_stamp = np.searchsorted(stamps, grid)
    previous_stamp = np.clip(next_stamp - 1, 0, len(stamps) - 1)
    next_stamp = np.clip(next_stamp, 0, len(stamps) - 1)
    return np.asarray((np.abs(stamps[next_stamp] - grid) <= reach) & (np.abs(grid - stamps[previous_stamp]) <= reach))
