"""Checks of each channel, reading by reading: outside its limits for too long, changing too fast, or absent.

While a panel is quiet, with every reading inside every window, a reading is only compared with its range. The states of
windows are updated from the first reading that leaves a window until all channels are quiet again.
"""

import math
from collections.abc import Callable, Sequence
from typing import NoReturn

from leactl.driver.contract import SampleBlock
from leactl.quantities import ChannelSpec
from leactl.safety.interlocks import Interlocks, QuantityLimits
from leactl.safety.limits import Limits

UNLIMITED = (-math.inf, math.inf)
REARM_S = 1.0  # time inside the window before it may warn again: noise at the threshold counts as one crossing
KELVIN_AT_ZERO_DEGC = 273.15

Trip = Callable[[str], NoReturn]
Warn = Callable[[str], None]


class Window:
    """A range that a value must not leave for `for_s` or longer, and a narrower one that warns when it is left."""

    def __init__(
        self, kind: str, trip: tuple[float, float], warn: tuple[float, float] = UNLIMITED, for_s: float = 0.0
    ) -> None:
        self.kind, self.for_s = kind, for_s
        self.low, self.high = trip
        self.warn_low, self.warn_high = warn
        self.left_at = math.nan  # when the value left; NaN while it is inside
        self.has_warned, self.warned_at = False, -math.inf

    @property
    def quiet_range(self) -> tuple[float, float]:
        """Lowest and highest value inside both windows."""
        return max(self.low, self.warn_low), min(self.high, self.warn_high)

    def look(self, watch: "Watch", value: float, now: float) -> bool:
        """Judge a number; return whether the window has no state to remember.

        Raises
        ------
        SafetyTrip : by way of the watch's `trip`.
        """
        if not self.low <= value <= self.high:
            if not self.left_at <= now:
                self.left_at = now
            if now - self.left_at >= self.for_s:
                crossing, bound = ("fell below", self.low) if value < self.low else ("passed", self.high)
                duration = f" for {now - self.left_at:.3g} s" if self.for_s else ""
                watch.trip(
                    f"{watch.label} of {value:.4g} {watch.unit} {crossing} the {self.kind} of {bound:g} {watch.unit}"
                    f"{duration}{watch.hint(value)}"
                )
        else:
            self.left_at = math.nan
        if not self.warn_low <= value <= self.warn_high:
            if not self.has_warned:
                is_low = value < self.warn_low
                crossing, bound = ("fell below", self.warn_low) if is_low else ("passed", self.warn_high)
                watch.warn(
                    f"{watch.label} of {value:.4g} {watch.unit} {crossing} {bound:g} {watch.unit}, where it warns"
                )
            self.has_warned, self.warned_at = True, now
        elif self.has_warned and now - self.warned_at > REARM_S:
            self.has_warned = False
        return not self.has_warned and self.left_at != self.left_at


class Watch:
    """One channel: its windows, its largest rate of change, and when it last was a number."""

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
        self.is_temperature = channel.quantity.endswith("_temperature")
        self.trip, self.warn = trip, warn
        self.windows = [Window("limit", limits.of(channel.quantity) or UNLIMITED)]
        self.windows += [
            Window("interlock", entry.window("trip"), entry.window("warn"), entry.for_s) for entry in entries
        ]
        self.rate = min((entry.rate for entry in entries if entry.rate), default=math.inf)
        self.interlock_age = min((entry.age_s for entry in entries if entry.age_s), default=math.nan)
        self.age = limits.age_s  # the longest without a number [s]
        self.last_number_at = -math.inf
        self.last_value, self.last_at = math.nan, -math.inf

    @property
    def quiet_range(self) -> tuple[float, float]:
        """Lowest and highest value inside all windows."""
        bounds = [window.quiet_range for window in self.windows]
        return max(low for low, _ in bounds), min(high for _, high in bounds)

    def begin(self, now: float, age: float) -> None:
        """Count the age from now; `age` [s] is allowed unless an interlock of the channel states another."""
        self.last_number_at, self.age = now, (age if math.isnan(self.interlock_age) else self.interlock_age)

    def look(self, value: float, now: float) -> bool:
        """Judge a value, where NaN only adds to the age; return whether all windows are quiet.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if value != value:
            if now - self.last_number_at > self.age:
                self.trip_too_old(now)
            return False
        is_quiet = True
        for window in self.windows:
            is_quiet = window.look(self, value, now) and is_quiet
        change, elapsed = value - self.last_value, now - self.last_at
        if abs(change) > self.rate * elapsed:
            per = f"{self.unit}/s" if "/" not in self.unit else f"({self.unit})/s"
            self.trip(
                f"{self.label} changed by {change:.4g} {self.unit} in {elapsed:.3g} s;"
                f" the interlock's rate is {self.rate:g} {per}"
            )
        self.last_number_at = self.last_at = now
        self.last_value = value
        return is_quiet

    def trip_too_old(self, now: float) -> NoReturn:
        """Trip because the last reading is too old."""
        self.trip(f"{self.label}: no reading for {now - self.last_number_at:.3f} s, {self.age:g} s are allowed")

    def hint(self, value: float) -> str:
        """Return a hint for a temperature that would be plausible in kelvin, else an empty string."""
        celsius = value - KELVIN_AT_ZERO_DEGC
        return f" (kelvin? {celsius:.1f} degC would be)" if self.is_temperature and -40 <= celsius <= 120 else ""


class Panel:
    """The channels of one exchange with a drive, or of one stream of a device, which arrive together."""

    def __init__(
        self, channels: Sequence[ChannelSpec], limits: Limits, interlocks: Interlocks, trip: Trip, warn: Warn
    ) -> None:
        self.watches = [
            Watch(index, channel, limits, interlocks.of(channel.quantity, channel.role), trip, warn)
            for index, channel in enumerate(channels)
            if not channel.quantity.endswith("_reference")  # in any other mode than its own a reference is NaN
        ]
        self.values: Sequence[float] = ()  # the latest
        self._windows = [
            (watch.index, *watch.quiet_range, watch.rate if watch.rate < math.inf else None) for watch in self.watches
        ]
        self._indices_with_rate = [watch.index for watch in self.watches if watch.rate < math.inf]
        self._last_values = [math.nan] * len(channels)  # of each channel with a rate, its value at the last look
        self._is_quiet = False
        self.looked_at = -math.inf

    def begin(self, now: float, age: float) -> None:
        """Count ages from now; see `Watch.begin`."""
        self._is_quiet, self.looked_at = False, now
        for watch in self.watches:
            watch.begin(now, age)

    def look(self, values: Sequence[float], now: float) -> None:
        """Judge one value of each channel, in the order of the channels.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        self.values = values
        if self._is_quiet:
            for index, low, high, rate in self._windows:
                value = values[index]
                if not (low <= value and value <= high):  # a chained comparison takes longer
                    break
                if rate is not None:
                    if not abs(value - self._last_values[index]) <= rate * (now - self.looked_at):
                        break
                    self._last_values[index] = value
            else:
                self.looked_at = now
                return
        self._look_closely(values, now)

    def _look_closely(self, values: Sequence[float], now: float) -> None:
        """Have every watch judge its value and update its state."""
        if self._is_quiet:
            self._update_watches()
        is_quiet = True
        for watch in self.watches:
            is_quiet = watch.look(values[watch.index], now) and is_quiet
        for index in self._indices_with_rate:
            self._last_values[index] = values[index]
        self._is_quiet, self.looked_at = is_quiet, now

    def look_through(self, block: SampleBlock) -> None:
        """Judge a block of samples.

        The extremes suffice while all channels are quiet and none has a limit of its rate; else each row is judged.

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if self._is_quiet and not self._indices_with_rate:
            lowest, highest = block.values.min(axis=0).tolist(), block.values.max(axis=0).tolist()
            if all(low <= lowest[index] and highest[index] <= high for index, low, high, _ in self._windows):
                self.values, self.looked_at = block.last.values, block.last.time
                return
        for row in block.rows():
            self.look(row.values, row.time)

    def _update_watches(self) -> None:
        """Bring the state of each watch up to the last look, since looks at quiet values leave it as it was."""
        for watch in self.watches:
            watch.last_number_at = watch.last_at = self.looked_at
            watch.last_value = self._last_values[watch.index]

    def check_age(self, now: float) -> float:
        """Trip on a channel that is too old or stamped ahead of now; return when the next channel may be too old [s].

        Raises
        ------
        SafetyTrip : by way of `trip`.
        """
        if self._is_quiet:
            self._update_watches()
        for watch in self.watches:
            if not now - watch.age <= watch.last_number_at:
                watch.trip_too_old(now)
            if watch.last_number_at > now:
                watch.trip(
                    f"{watch.label}: a reading is stamped {watch.last_number_at - now:.3f} s ahead of the bench's clock"
                )
        return min((watch.last_number_at + watch.age for watch in self.watches), default=math.inf)
