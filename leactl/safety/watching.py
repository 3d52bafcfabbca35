"""Checks of each channel, reading by reading: outside its limits for too long, too fast, or absent.

A reading inside every window costs one comparison: states are updated only from the first reading that leaves a window
until all channels are quiet again.
"""

import math
from collections.abc import Callable, Sequence
from typing import NoReturn

from leactl.driver.contract import SampleBlock
from leactl.quantities import ChannelSpec
from leactl.safety.interlocks import Interlocks, QuantityLimits
from leactl.safety.limits import Limits

UNLIMITED = (-math.inf, math.inf)
REARM_S = 1.0  # time inside the window before a warning is repeated: noise at the threshold is one crossing
KELVIN_AT_ZERO_DEGC = 273.15

Trip = Callable[[str], NoReturn]
Warn = Callable[[str], None]


class Window:
    """A window that a value must not leave for longer than `for_s`, and a narrower one that warns when it is left."""

    def __init__(
        self, word: str, trip: tuple[float, float], warn: tuple[float, float] = UNLIMITED, for_s: float = 0.0
    ) -> None:
        self.word, self.for_s = word, for_s
        self.low, self.high = trip
        self.warn_low, self.warn_high = warn
        self.since = math.nan  # when the value left; NaN while it is inside
        self.warned, self.warned_at = False, -math.inf

    @property
    def quiet(self) -> tuple[float, float]:
        """Lowest and highest value inside both windows."""
        return max(self.low, self.warn_low), min(self.high, self.warn_high)

    def look(self, watch: "Watch", value: float, now: float) -> bool:
        """Judge a number; return True if the window has no state to remember."""
        if not self.low <= value <= self.high:
            if not self.since <= now:
                self.since = now
            if now - self.since >= self.for_s:
                passed, bound = ("fell below", self.low) if value < self.low else ("passed", self.high)
                lasting = f" for {now - self.since:.3g} s" if self.for_s else ""
                watch.trip(
                    f"{watch.label} of {value:.4g} {watch.unit} {passed} the {self.word} of {bound:g} {watch.unit}"
                    f"{lasting}{watch.hint(value)}"
                )
        else:
            self.since = math.nan
        if not self.warn_low <= value <= self.warn_high:
            if not self.warned:
                low = value < self.warn_low
                passed, bound = ("fell below", self.warn_low) if low else ("passed", self.warn_high)
                watch.warn(f"{watch.label} of {value:.4g} {watch.unit} {passed} {bound:g} {watch.unit}, where it warns")
            self.warned, self.warned_at = True, now
        elif self.warned and now - self.warned_at > REARM_S:
            self.warned = False
        return not self.warned and self.since != self.since


class Watch:
    """One channel: its windows, its fastest change, and when it was last a number."""

    def __init__(
        self,
        index: int,
        channel: ChannelSpec,
        limits: Limits,
        entries: Sequence[QuantityLimits],
        trip: Trip,
        warn: Warn,
    ) -> None:
        self.index, self.channel = index, channel
        self.label, self.unit = f"{channel.role} {channel.quantity}", channel.unit
        self.temperature = channel.quantity.endswith("_temperature")
        self.trip, self.warn = trip, warn
        self.windows = [Window("limit", limits.of(channel.quantity) or UNLIMITED)]
        self.windows += [
            Window("interlock", entry.window("trip"), entry.window("warn"), entry.for_s) for entry in entries
        ]
        self.rate = min((entry.rate for entry in entries if entry.rate), default=math.inf)
        self.own_age = min((entry.age_s for entry in entries if entry.age_s), default=math.nan)
        self.age = limits.age_s  # the longest without a number [s]
        self.seen = -math.inf
        self.last, self.last_at = math.nan, -math.inf

    @property
    def quiet(self) -> tuple[float, float]:
        """Lowest and highest value inside all windows."""
        bounds = [window.quiet for window in self.windows]
        return max(low for low, _ in bounds), min(high for _, high in bounds)

    def begin(self, now: float, age: float) -> None:
        """Count the age from now; `age` [s] is allowed unless an interlock of the channel states another."""
        self.seen, self.age = now, (age if math.isnan(self.own_age) else self.own_age)

    def look(self, value: float, now: float) -> bool:
        """Judge a value, of which NaN only adds to the age; return True if all windows are quiet."""
        if value != value:
            if now - self.seen > self.age:
                self.too_old(now)
            return False
        quiet = True
        for window in self.windows:
            quiet = window.look(self, value, now) and quiet
        change, time = value - self.last, now - self.last_at
        if abs(change) > self.rate * time:
            per = f"{self.unit}/s" if "/" not in self.unit else f"({self.unit})/s"
            self.trip(
                f"{self.label} changed by {change:.4g} {self.unit} in {time:.3g} s;"
                f" the interlock's rate is {self.rate:g} {per}"
            )
        self.seen = self.last_at = now
        self.last = value
        return quiet

    def too_old(self, now: float) -> NoReturn:
        """Trip because the last reading is too old."""
        self.trip(f"{self.label}: no reading for {now - self.seen:.3f} s, {self.age:g} s are allowed")

    def hint(self, value: float) -> str:
        """Return a hint for a temperature that would be plausible in kelvin, else an empty string."""
        celsius = value - KELVIN_AT_ZERO_DEGC
        return f" (kelvin? {celsius:.1f} degC would be)" if self.temperature and -40 <= celsius <= 120 else ""


class Panel:
    """The channels of one exchange with a drive, or of one stream of a device, which arrive together."""

    def __init__(
        self, channels: Sequence[ChannelSpec], limits: Limits, interlocks: Interlocks, trip: Trip, warn: Warn
    ) -> None:
        self.watches = [
            Watch(index, channel, limits, interlocks.of(channel.quantity, channel.role), trip, warn)
            for index, channel in enumerate(channels)
            if not channel.quantity.endswith("_reference")  # a reference is a number in its own mode alone
        ]
        self.values: Sequence[float] = ()  # the latest
        self._windows = [
            (watch.index, *watch.quiet, watch.rate if watch.rate < math.inf else None) for watch in self.watches
        ]
        self._rated = [watch.index for watch in self.watches if watch.rate < math.inf]
        self._last = [math.nan] * len(channels)  # of each channel with a rate, its value at the last look
        self._quiet = False
        self.looked = -math.inf

    def begin(self, now: float, age: float) -> None:
        """Count ages from now; see `Watch.begin`."""
        self._quiet, self.looked = False, now
        for watch in self.watches:
            watch.begin(now, age)

    def look(self, values: Sequence[float], now: float) -> None:
        """Judge one value of each channel, in the order of the channels.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        self.values = values
        if self._quiet:
            for index, low, high, rate in self._windows:
                value = values[index]
                if not (low <= value and value <= high):  # a chained comparison takes longer
                    break
                if rate is not None:
                    if not abs(value - self._last[index]) <= rate * (now - self.looked):
                        break
                    self._last[index] = value
            else:
                self.looked = now
                return
        self._look_closely(values, now)

    def _look_closely(self, values: Sequence[float], now: float) -> None:
        if self._quiet:
            self._remember()
        quiet = True
        for watch in self.watches:
            quiet = watch.look(values[watch.index], now) and quiet
        for index in self._rated:
            self._last[index] = values[index]
        self._quiet, self.looked = quiet, now

    def look_through(self, block: SampleBlock) -> None:
        """Judge a block of samples.

        The extremes suffice while all are quiet and no channel has a limit of its rate; else each row is judged.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if self._quiet and not self._rated:
            lowest, highest = block.values.min(axis=0).tolist(), block.values.max(axis=0).tolist()
            if all(low <= lowest[index] and highest[index] <= high for index, low, high, _ in self._windows):
                self.values, self.looked = block.last.values, block.last.time
                return
        for row in block.rows():
            self.look(row.values, row.time)

    def _remember(self) -> None:
        """Bring the state of each watch up to the last look, for quiet looks leave it as it was."""
        for watch in self.watches:
            watch.seen = watch.last_at = self.looked
            watch.last = self._last[watch.index]

    def check_age(self, now: float) -> float:
        """Trip on a channel that is too old or stamped ahead of now; return when the next one may be too old [s].

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if self._quiet:
            self._remember()
        for watch in self.watches:
            if not now - watch.age <= watch.seen:
                watch.too_old(now)
            if watch.seen > now:
                watch.trip(f"{watch.label}: a reading is stamped {watch.seen - now:.3f} s ahead of the bench's clock")
        return min((watch.seen + watch.age for watch in self.watches), default=math.inf)
