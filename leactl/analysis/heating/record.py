"""A heated run as its analysis takes it: temperatures of three regions by a camera, heat by a supply, the air around.

Direct current through two leads of a wye heats two of its three phases, the active windings; the third, the inactive
ones, carries none. With a third of the capacitance and three times the resistances for each phase, the mean of the
phases, 2/3 active and 1/3 inactive, is the winding of the two-node network (paper, section "Thermal Dynamics").
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from leactl.analysis.estimate import NAN, listed
from leactl.analysis.quality.gate import hanging
from leactl.analysis.quality.hanging import longest_row
from leactl.analysis.quality.saturation import clipped
from leactl.errors import InputError, MissingChannel, NotIdentifiable
from leactl.model.thermal_network import ACTIVE_SHARE
from leactl.runfile.read.reader import Channel, Run

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

WINDING, HOUSING, AMBIENT = "winding_temperature", "housing_temperature", "ambient_temperature"
CURRENT, VOLTAGE = "line_current", "line_voltage"
NOT_CELSIUS = 200.0  # degC, and never below: no winding is left to, and a room is 290 to 300 in kelvin
FLOWS = 0.2  # of the largest current, above which it counts as switched on
LEAST_A = 0.1  # that heats anything worth a fit
SEEN = 0.5  # of the frames of the place seen best, that a place must be seen in to count
LONGEST_LAG_S = 900.0  # of the camera's clock by the supply's
BRIDGED_S = 2.0  # without readings of the supply, that a straight line is drawn over
SHORTEST_S, FEWEST = 60.0, 100  # of a stretch with heat and frames


@dataclass(frozen=True, eq=False)
class Supply:
    """Current and voltage of the two leads on one clock, none missing."""

    time: Array  # s
    current: Array  # A
    voltage: Array  # V
    means: bool  # over the interval that ends at a stamp

    @property
    def heat(self) -> Array:
        """What goes into the winding [W]."""
        return self.current * self.voltage

    @property
    def on(self) -> Mask:
        """Readings with the current switched on."""
        return np.asarray(np.abs(self.current) > FLOWS * np.max(np.abs(self.current)))

    def within(self, part: slice) -> "Supply":
        """A part of it."""
        return replace(self, time=self.time[part], current=self.current[part], voltage=self.voltage[part])


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a run whose heat is known throughout; NaN where the camera missed a frame."""

    place: str
    time: Array  # s, of the camera's clock
    winding: Array  # degC, equivalent
    housing: Array  # degC
    active: Array  # degC
    supply: Supply
    ambient: Array | None  # degC, at the stamps of the supply


def stretches(run: Run, notes: list[str]) -> list[Stretch]:
    """What a run holds, cut where the heat is not known; notes tell what is left out.

    Raises
    ------
    MissingChannel : no temperatures of winding or housing, no line current or no line voltage.
    NotIdentifiable : no current flows, or heat and frames never come together for long enough.
    InputError : temperatures that are not in degC, or a resistance below zero.
    """
    supply = supply_of(run, notes)
    camera = run.channels(WINDING)[0] if run.has(WINDING) else run.channel(WINDING)
    regions = winding_of(run, camera.time, notes)
    housing = mean_of(run, run.channels(HOUSING) or [run.channel(HOUSING)], camera.time, notes)
    winding, active = regions
    refuse_exchanged(run, active, housing, "active windings", "housing")
    air = ambient_of(run, notes)
    found = []
    for part in unbroken(supply.time):
        heat = supply.within(part)
        if not len(heat.time):
            continue
        ends = heat.time[[0, -1]]
        frames = slice(*np.searchsorted(camera.time, ends + np.array([-LONGEST_LAG_S, LONGEST_LAG_S])).tolist())
        seen = int(np.sum(np.isfinite(winding[frames]) & np.isfinite(housing[frames])))
        if seen < FEWEST or heat.time[-1] - heat.time[0] < SHORTEST_S:
            if seen:
                notes.append(f"{run.path}: left out {heat.time[0]:.0f} to {heat.time[-1]:.0f} s: {seen} frames of use")
            continue
        ambient = None if air is None else np.interp(heat.time, *air)
        of_camera = (camera.time[frames], winding[frames], housing[frames], active[frames])
        found.append(Stretch(str(run.path), *of_camera, heat, ambient))
    if not found:
        raise NotIdentifiable(
            f"{run.path}: camera and supply never record together for {SHORTEST_S:g} s; both are needed"
        )
    return found


def frames_of(run: Run) -> int:
    """How many frames of the winding a run has, seen or not."""
    return len(run.channels(WINDING)[0].time)


def supply_of(run: Run, notes: list[str]) -> Supply:
    """Current and voltage of the leads on the voltage's clock; short gaps bridged."""
    current, voltage = run.channel(CURRENT), run.channel(VOLTAGE)
    amperes, volts = np.isfinite(current.values), np.isfinite(voltage.values)
    if amperes.sum() < 2 or volts.sum() < 2:
        raise NotIdentifiable(f"{run.path}: {CURRENT} or {VOLTAGE} of test has no readings; the heat is not known")
    if voltage.stream == current.stream:
        amperes = volts = amperes & volts
    for one in (current, voltage):
        refuse_clipped(run, one)
    good = volts & (voltage.time >= current.time[amperes][0]) & (voltage.time <= current.time[amperes][-1])
    if bridged := int(np.sum(~np.isfinite(voltage.values))) + int(np.sum(~np.isfinite(current.values))):
        notes.append(f"{run.path}: {bridged} readings of the supply are missing")
    time = voltage.time[good]
    found = Supply(
        time,
        np.interp(time, current.time[amperes], current.values[amperes]),
        voltage.values[good],
        voltage.sampling == current.sampling == "mean",
    )
    most = float(np.max(np.abs(found.current), initial=0.0))
    if most < LEAST_A:
        raise NotIdentifiable(f"{run.path}: {CURRENT} of test never exceeds {most:.3g} A: nothing was heated")
    on = found.on
    if float(np.mean(found.voltage[on] * found.current[on])) <= 0.0:
        ohm = float(np.median(found.voltage[on] / found.current[on]))
        raise InputError(
            f"{run.path}: {VOLTAGE} over {CURRENT} of test is {ohm:.3g} ohm; a resistance above zero was expected:"
            " one of the two has its leads swapped"
        )
    return found


def winding_of(run: Run, time: Array, notes: list[str]) -> tuple[Array, Array]:
    """Equivalent temperature of the winding, and that of its active part [degC]."""
    places = run.channels(WINDING)
    active = [one for one in places if one.location.startswith("active")]
    inactive = [one for one in places if one.location.startswith("inactive")]
    if len(places) == 1 and not active and not inactive:
        notes.append(
            f"{run.path}: one {WINDING} without a region is taken as the mean of all phases; the resistance goes with"
            " that of the active ones, so its coefficient comes out too high where the supply feeds two leads"
        )
        whole = mean_of(run, places, time, notes)
        return whole, whole
    for region, found in (("active", active), ("inactive", inactive)):
        if not found:
            raise MissingChannel(
                f"{run.path}: no {WINDING} of test at a location '{region}_...'; it has"
                f" {listed(one.location or 'no location' for one in places)}. The winding's mean takes"
                " 2/3 active and 1/3 inactive"
            )
    hot, cold = mean_of(run, active, time, notes), mean_of(run, inactive, time, notes)
    refuse_exchanged(run, hot, cold, "active windings", "inactive ones")
    return ACTIVE_SHARE * hot + (1.0 - ACTIVE_SHARE) * cold, hot


def mean_of(run: Run, places: Sequence[Channel], time: Array, notes: list[str]) -> Array:
    """Mean over the places of a region [degC] at the camera's stamps; NaN where one of them was not seen.

    A place that is seen in fewer than half as many frames as the best does not count: a mean over whichever places are
    there would jump with what tells them apart. Nor does a place that hangs, where its region has another.
    """
    places, columns = without_hanging(run, places, notes), []
    for one in places:
        refuse_not_celsius(run, one)
        one = within_range(run, one, notes)
        same = len(one.time) == len(time) and np.array_equal(one.time, time)
        columns.append(one.values if same else onto(time, one))
    seen = np.array([np.isfinite(column).sum() for column in columns])
    if not seen.max(initial=0):
        raise NotIdentifiable(f"{run.path}: {places[0].quantity} of test was never seen at {_names(places)}")
    kept = seen >= SEEN * seen.max()
    if not kept.all():
        lost = [one.location for one, keep in zip(places, kept, strict=True) if not keep]
        notes.append(f"{run.path}: left out {listed(lost)}: not seen in most frames")
    if kept.sum() == 1 and len(places[0].location):
        only = next(one.location for one, keep in zip(places, kept, strict=True) if keep)
        notes.append(f"{run.path}: {only} alone stands for its region; differences within the region do not show")
    mean = np.mean([column for column, keep in zip(columns, kept, strict=True) if keep], axis=0)
    if missing := int(np.sum(~np.isfinite(mean))):
        notes.append(f"{run.path}: {_names(places)}: {missing} of {len(mean)} frames missing; left out")
    return np.asarray(mean, np.float64)


def without_hanging(run: Run, places: Sequence[Channel], notes: list[str]) -> list[Channel]:
    """The places that do not hang; where all of them do, what they read before and after."""
    rows = [longest_row(one.values) for one in places]
    hung = [row is not None and bool(hanging(run, one, row)) for one, row in zip(places, rows, strict=True)]
    if not any(hung):
        return list(places)
    lost = [one.location or one.quantity for one, hangs in zip(places, hung, strict=True) if hangs]
    if not all(hung):
        notes.append(f"{run.path}: left out {listed(lost)}, which hangs")
        return [one for one, hangs in zip(places, hung, strict=True) if not hangs]
    notes.append(f"{run.path}: {listed(lost)} hangs; those frames are left out")
    found = []
    for one, row in zip(places, rows, strict=True):
        assert row is not None  # it hangs
        values = one.values.copy()
        values[row.first + 1 : row.last + 1] = NAN
        found.append(replace(one, values=values))
    return found


def ambient_of(run: Run, notes: list[str]) -> tuple[Array, Array] | None:
    """Stamps and values of the air [degC], what was missed left out; None where the run does not have it."""
    channels = run.channels(AMBIENT, "bench") or run.channels(AMBIENT)
    for one in channels:
        refuse_not_celsius(run, one)
    read = [one for one in channels if np.isfinite(one.values).sum() > 1]
    if not read:
        notes.append(
            f"{run.path}: no {AMBIENT}: the air is taken as one temperature throughout, fitted with the network"
        )
        return None
    time = read[0].time[np.isfinite(read[0].values)]
    values = np.mean([np.interp(time, o.time[g := np.isfinite(o.values)], o.values[g]) for o in read], axis=0)
    return time, np.asarray(values, np.float64)


def refuse_exchanged(run: Run, warmer: Array, colder: Array, name: str, other: str) -> None:
    """Refuse regions of which the one that carries the current stays colder than another: places are exchanged.

    Judged at the tenth of the frames in which both lie furthest apart, that is while one of them is heated.
    """
    both = np.isfinite(warmer) & np.isfinite(colder)
    apart = (warmer - colder)[both]
    if len(apart) and float(np.mean(apart[np.abs(apart) >= np.quantile(np.abs(apart), 0.9)])) < 0.0:
        raise InputError(
            f"{run.path}: the {other} get {-float(apart.min()):.1f} K warmer than the {name}, which carry the current:"
            " places of the camera are exchanged"
        )


def refuse_clipped(run: Run, channel: Channel) -> None:
    """Refuse a reading of the supply that stops at a value: what is beyond is heat that nothing tells."""
    end = clipped(channel)
    if end is not None:
        share = float(np.mean(channel.values == end))
        raise NotIdentifiable(
            f"{run.path}: {channel.quantity} of {channel.role} is clipped at {end:.4g} {channel.units} in {share:.0%}"
            " of its readings; the heat is not known: give its input a wider range"
        )


def within_range(run: Run, channel: Channel, notes: list[str]) -> Channel:
    """A place of the camera without the frames in which it stops at a value; a note says how many."""
    end = clipped(channel)
    if end is None:
        return channel
    there = channel.values == end
    where = channel.location or channel.quantity
    notes.append(f"{run.path}: {where} is clipped at {end:.4g} {channel.units} in {there.sum()} frames; left out")
    return replace(channel, values=np.where(there, NAN, channel.values))


def refuse_not_celsius(run: Run, channel: Channel) -> None:
    """Refuse what can only be kelvin under another name."""
    least = float(np.nanmin(channel.values, initial=np.inf))
    if NOT_CELSIUS < least < np.inf:
        where = f" at {channel.location}" if channel.location else ""
        raise InputError(
            f"{run.path}: {channel.quantity} of {channel.role}{where} is never below {least:.1f} {channel.units};"
            " degC was expected, these look like kelvin"
        )


def onto(time: Array, channel: Channel) -> Array:
    """Values at other stamps, straight in between; NaN where the channel has none on either side within two paces."""
    good = np.isfinite(channel.values)
    stamps = channel.time[good]
    if len(stamps) < 2:
        return np.full(len(time), NAN)
    values = np.interp(time, stamps, channel.values[good], left=NAN, right=NAN)
    after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    values[np.diff(stamps)[after - 1] > 2.0 * float(np.median(np.diff(channel.time)))] = NAN
    return values


def unbroken(time: Array) -> list[slice]:
    """Parts of a clock without a gap that is too long to draw a line over."""
    steps = np.diff(time)
    longest = max(BRIDGED_S, 3.0 * float(np.median(steps)))
    cuts = [0, *(np.flatnonzero(steps > longest) + 1).tolist(), len(time)]
    return [slice(a, b) for a, b in itertools.pairwise(cuts)]


def _names(places: Sequence[Channel]) -> str:
    return listed(one.location or one.quantity for one in places)
