"""One run as the equations need it: channels on one even clock, temperatures beside them, what is missing told.

A sample that is NaN in the file is bridged for the filters and left out of every row that it touches.
"""

from collections.abc import Callable
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
FED, UNFED = "active", "inactive"  # places of the phases that two leads feed, and of the third
SLOW = ("winding_temperature", "housing_temperature", AMBIENT)
FEWEST = 50  # samples, below which a run says nothing
MANY_MISSING = 0.2  # of a channel's samples, from which on an answer says so
REACH = 2.5  # paces, that values are taken in between over
BURSTS = (
    0.3  # of a run's time without samples, from which on its stamps come in bursts: a hold, then a step to the next
)
PAUSES = 16  # gaps, below which a run pauses or its clock jumps: its stamps do not come in bursts
ALIKE = 0.1  # of its own interval, by which a stretch may go by its run's: jitter moves the middle one of a few hundred
PAUSED = 64.0  # times as long as its samples take, that a run may last
UNBRIDGED = 0.05
LONG, SMOOTHED = 8, 12  # samples: of a gap that no straight line bridges, and to either side that smoothing carries it
STRETCHES, EVERY = 16, 8  # of a run, and which of them are taken out of it


@dataclass
class Clocked:
    """Channels on one even clock."""

    time: Array
    interval: float
    values: dict[Key, Array] = field(default_factory=dict)
    valid: dict[Key, Mask] = field(default_factory=dict)
    means: set[Key] = field(default_factory=set)  # channels that are means over the interval that ends at the stamp
    unstamped: set[Key] = field(default_factory=set)  # channels of which the file does not say what a stamp means
    stamping: dict[str, Array] = field(
        default_factory=dict
    )  # by equation: how its channels' stamps stand to each other
    setpoints_between: bool = False  # whether setpoints change between the stamps, more than one in an interval
    setpoints_held: bool = False  # whether a run of the log shows that they do not
    units: dict[Key, str] = field(default_factory=dict)
    counts: dict[Key, float] = field(default_factory=dict)  # smallest step of an angle, next to none if interpolated
    between: dict[Key, tuple[Array, Array]] = field(default_factory=dict)  # stamps and values of one taken in between
    fed: Array | None = None  # degC, of the phases that two leads feed; None where a winding is not told apart
    begin: float | None = None  # stamp at which the run began, where this is a stretch of it
    fastest: float = 0.0  # rad/s, or m/s, that the whole run reaches, where this is a stretch of it
    decimation: int = 1  # samples of the log that stand for one of this clock
    aside: bool = False  # whether it only says how warm a stretch was, and equations are those of the whole run
    driven: dict[str, Array] = field(
        default_factory=dict
    )  # what all of the drive's clock came to from each stamp on, of a run that is looked at in stretches

    @property
    def since_begin(self) -> Array:
        """Time [s] since the run began."""
        return self.time - (self.time[0] if self.begin is None else self.begin)

    def get(self, quantity: str, role: str = "test") -> Array | None:
        """The values, or None where the run has no such channel."""
        return self.values.get((quantity, role))

    def own(self, quantity: str, role: str = "test") -> Array:
        """The values as they were measured, before any was taken in between."""
        key = quantity, role
        return self.between[key][1] if key in self.between else self.values[key]

    def unasked(self, quantity: str) -> Mask:
        """Samples in a gap of a reference that no straight line bridges: its drive was in another mode, or off."""
        key = quantity, "test"
        if key not in self.between:
            return np.zeros(len(self.time), bool)
        stamps, near = self.between[key][0], 0.5 * self.interval
        at = np.searchsorted(stamps, self.time - near)
        before, after = np.concatenate([[-np.inf], stamps])[at], np.concatenate([stamps, [np.inf]])[at]
        return np.asarray((after > self.time + near) & (after - before > LONG * self.interval))

    def all_valid(self, *keys: Key) -> Mask:
        """Samples at which all these channels were measured."""
        mask = np.ones(len(self.time), bool)
        for key in keys:
            if key in self.valid:
                mask &= self.valid[key]
        return mask


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
    condition: str = ""  # on the bench; empty where the file names none
    stretch: str = ""  # where in the run it begins; empty where it is the whole run
    nominal_effects: Callable[[list[Any]], list[Any]] | None = None
    """Takes from the equations of this run what effects of the nominal do; None where the nominal has none."""

    @property
    def run(self) -> str:
        """The file without its ending."""
        return self.path.stem

    @property
    def name(self) -> str:
        """The run, and which stretch of it."""
        return self.run + self.stretch

    def parted(self) -> tuple["Record", "Record"]:
        """The run without what was measured in two of sixteen stretches, and with nothing but that; inputs stay."""
        clocks = [clock for clock in (self.fast, self.slow) if clock is not None and not clock.aside]
        first, last = min(clock.time[0] for clock in clocks), max(clock.time[-1] for clock in clocks)

        def masked(clock: Clocked | None, out: bool) -> Clocked | None:
            if clock is None:
                return None
            stretch = ((clock.time - first) / (last - first) * STRETCHES).astype(np.intp)
            keep = (stretch % EVERY == EVERY // 2) == out
            return replace(clock, valid={key: valid & keep for key, valid in clock.valid.items()})

        kept, taken = (replace(self, fast=masked(self.fast, out), slow=masked(self.slow, out)) for out in (False, True))
        return kept, taken


def read_record(path: Path) -> Record:
    """Read one run file.

    Raises
    ------
    InputError : no run file, one that is not as it was closed, or whose channels cannot be used; one line each.
    """
    refuse_altered([path])
    with Run.open(path) as run:
        return record_of(run)


def record_of(run: Run, channels: list[Channel] | None = None, usual: float | None = None) -> Record:
    """Sort the channels of an open run, all of them or some.

    Parameters
    ----------
    usual : s, interval of the samples of the whole run, which its stretches have in common; their own if left out.

    Raises
    ------
    InputError : channels that cannot be used, or that were condemned; one line each.
    """
    if channels is None:
        read = [
            channel
            for specs in run.streams.values()
            for spec in specs
            if spec.quantity
            for channel in run.channels(spec.quantity, spec.role)
        ]
        channels = list({(c.stream, c.quantity, c.role, c.location): c for c in read}.values())
    kind = str(run.attributes.get("protocol") or run.mechanical)
    setup = {k: float(v) for k, v in run.setup.items() if isinstance(v, int | float)}
    condition = str(run.attributes.get("condition") or "")
    return replace(build(run.path, kind, run.mechanical, channels, setup, usual), condition=condition)


def build(
    path: Path,
    kind: str,
    mechanical: str,
    channels: list[Channel],
    setup: dict[str, float],
    usual: float | None = None,
) -> Record:
    """Sort channels onto a fast and a slow clock, the fast one at its run's usual interval where that is told."""
    notes: list[str] = []
    usable = []
    for channel in of_the_bench(channels):
        good = np.isfinite(channel.values)
        if good.sum() < FEWEST:
            if good.any() or not channel.quantity.endswith("_reference"):  # else the drive was in another mode
                notes.append(
                    f"{path.name}: {channel.quantity} of {channel.role} has {int(good.sum())} samples; left out"
                )
        else:
            usable.append(channel)
            if good.all() and np.ptp(channel.values) == 0.0 and not may_rest(channel, mechanical):
                notes.append(f"{path.name}: {channel.quantity} of {channel.role} never changes; is the channel alive?")
            evenly = np.ptp(np.diff(np.flatnonzero(good))) == 0  # as a slower channel has them on a faster one's clock
            if good.mean() <= 1.0 - MANY_MISSING and not evenly and not channel.quantity.endswith("_reference"):
                notes.append(f"{path.name}: a fifth or more of {channel.quantity} of {channel.role} was not measured")
    if not usable:
        raise InputError(f"{path}: no channel with {FEWEST} samples or more; a diagnosis needs a current or an angle")
    fast = [c for c in usable if not is_slow(c.quantity)]
    slow = [c for c in usable if is_slow(c.quantity)]
    clocks = _on_clock(fast, notes, path, usual), _on_clock(slow, notes, path)
    return Record(path, kind, mechanical, *clocks, setup, notes)


def is_slow(quantity: str) -> bool:
    """Whether a channel belongs on the clock of camera and supply."""
    return quantity in SLOW or quantity.startswith("line_")


def of_the_bench(channels: list[Channel]) -> list[Channel]:
    """Channels with the air around the bench as the bench's, where it stands under the actuator that a camera sees."""
    if any(channel.quantity == AMBIENT and channel.role == "bench" for channel in channels):
        return channels
    return [
        replace(channel, role="bench") if (channel.quantity, channel.role) == (AMBIENT, "test") else channel
        for channel in channels
    ]


def may_rest(channel: Channel, mechanical: str) -> bool:
    """Whether a channel may well stay the same for a whole run."""
    if channel.quantity in ("angle", "velocity"):
        return mechanical in ("locked", "heated") or (mechanical == "free" and channel.role == "load")
    return channel.quantity in ("drive_enabled", AMBIENT) or channel.quantity.endswith("_reference")


def _on_clock(channels: list[Channel], notes: list[str], path: Path, usual: float | None = None) -> Clocked | None:
    if not channels:
        return None
    streams: dict[str, list[Channel]] = {}
    for channel in channels:
        streams.setdefault(channel.stream, []).append(channel)
    leading = max(streams.values(), key=lambda group: (len(group), len(group[0].time)))[0].time
    own = bridging_interval(leading)
    if leading[-1] - leading[0] > PAUSED * own * len(leading):
        raise InputError(f"{path}: {jump_of(leading)}; what it measures cannot be put on one clock")
    grid, interval, even = grid_of(leading, own if usual is None or abs(usual - own) > ALIKE * own else usual)
    if not even:
        notes.append(f"{path.name}: stamps are uneven; values are taken in between at {1 / interval:.6g} Hz")
    clocked = Clocked(leading if even else grid, interval)
    grouped: dict[Key, list[Channel]] = {}
    for channel in channels:
        grouped.setdefault((channel.quantity, channel.role), []).append(channel)
    for key, group in grouped.items():
        values, valid = [], []
        for channel in group:
            good = np.isfinite(channel.values)
            same = even and len(channel.time) == len(leading) and np.array_equal(channel.time, leading)
            if same and good.all():
                values.append(channel.values)
                valid.append(good)
                continue
            stamps = leading if same else channel.time
            reach = REACH * max(pace(channel.time), interval if interval > 1.5 * pace(leading) else 0.0)
            values.append(np.interp(clocked.time, stamps[good], channel.values[good]))
            if len(group) == 1:
                clocked.between[key] = stamps[good], channel.values[good]
            valid.append(good if same else near(clocked.time, channel.time[good], reach))
        fed = [one for one, channel in zip(values, group, strict=True) if region_of(channel) == FED]
        rest = [one for one, channel in zip(values, group, strict=True) if region_of(channel) == UNFED]
        if key == WINDING and fed and rest:
            clocked.fed = np.mean(fed, axis=0)
            clocked.values[key] = ACTIVE_SHARE * clocked.fed + (1.0 - ACTIVE_SHARE) * np.mean(rest, axis=0)
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


def grid_of(stamps: Array, usual: float) -> tuple[Array, float, bool]:
    """Evenly spaced times over stamps, their interval, and whether the stamps lie on them but for jitter."""
    span = stamps[-1] - stamps[0]
    for interval in dict.fromkeys((usual, bridging_interval(stamps))):
        grid = stamps[0] + interval * np.arange(int(span / interval + 1.5))
        if is_even(grid, stamps):
            return grid, interval, True
    if is_even(grid := np.linspace(stamps[0], stamps[-1], len(stamps)), stamps):
        # stamps rounded to a few digits: their mean pace is right where the middle one is off by a digit
        return grid, float(span / (len(stamps) - 1)), True
    return stamps[0] + usual * np.arange(int(span / usual + 1.5)), usual, False


def without_edges(valid: Mask) -> Mask:
    """Valid samples without those that lie beside a long gap: what bridges it is smoothed into them."""
    gaps = np.flatnonzero(np.diff(np.concatenate([[1], valid.astype(np.intp), [1]])))
    inner = valid.copy()
    for begin, end in gaps.reshape(-1, 2):
        if end - begin >= LONG:
            inner[max(begin - SMOOTHED, 0) : end + SMOOTHED] = False
    return inner


def region_of(channel: Channel) -> str:
    """The part of a winding that a place lies in: `active` of `active_2`."""
    return channel.location.partition("_")[0]


def is_even(grid: Array, stamps: Array) -> bool:
    """Whether stamps lie on a grid but for jitter."""
    return len(grid) == len(stamps) and float(np.max(np.abs(grid - stamps))) < 0.02 * float(grid[1] - grid[0])


def smallest_step(values: Array) -> float:
    """The step that a quantised channel moves by."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0]
    return float(np.quantile(steps, 0.01)) if len(steps) else 0.0


def bridging_interval(stamps: Array) -> float:
    """The pace of stamps; where they come in bursts, one so slow that all but a twentieth of the time is bridged."""
    steps = np.diff(stamps)
    usual, span = float(np.median(steps)), float(stamps[-1] - stamps[0])
    gaps = steps[steps > REACH * usual]
    if len(gaps) < PAUSES or float(gaps.sum()) < BURSTS * span:
        return usual
    ordered = np.sort(steps)
    bridged = np.cumsum(ordered)
    return float(ordered[np.searchsorted(bridged, (1.0 - UNBRIDGED) * bridged[-1])] / REACH)


def jump_of(stamps: Array) -> str:
    """The longest gap between stamps, for a person."""
    steps = np.diff(stamps)
    at = int(np.argmax(steps))
    return f"its clock jumps by {steps[at]:.6g} s after {stamps[at] - stamps[0]:.6g} s"


def pace(time: Array) -> float:
    """The middle interval of stamps; 0 for a single one."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def near(grid: Array, stamps: Array, reach: float) -> Mask:
    """Grid times with a stamp within reach on both sides."""
    after = np.searchsorted(stamps, grid)
    before = np.clip(after - 1, 0, len(stamps) - 1)
    after = np.clip(after, 0, len(stamps) - 1)
    return np.asarray((np.abs(stamps[after] - grid) <= reach) & (np.abs(grid - stamps[before]) <= reach))
