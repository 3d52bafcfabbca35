"""The `interlocks:` block of a bench file: from which value a reading warns and trips, for how long, and how fast.

The `limits:` block is required and trips at once. Interlocks are narrower than limits, or check what a limit cannot.
Interlocks on the loop, the clock and the disk that a file leaves out have finite defaults.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import AfterValidator, ConfigDict, Discriminator, Field, Tag, model_validator

from leactl.quantities import UNITS, ChannelSpec
from leactl.safety.limits import COLDEST_DEGC, HOTTEST_DEGC, MOST_TRIP_DELAY_S, Age, Limits, Positive, trips_by
from leactl.yamlblock import Block

QUANTITIES_NEEDING_TRIP = ("drive_temperature", "housing_temperature")  # no limit of the bench covers them
UNIT_KEYS = {"A": "A", "V": "V", "rad": "rad", "rad/s": "rad_s", "N*m": "Nm", "degC": "degC"}
KEYS_WITH_UNIT = ("warn", "trip", "warn_low", "warn_high", "trip_low", "trip_high", "rate")
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Duration = Annotated[
    float,
    Field(strict=True, ge=0, allow_inf_nan=False, json_schema_extra={"maximum": MOST_TRIP_DELAY_S}),
    AfterValidator(trips_by(MOST_TRIP_DELAY_S)),
]
LONGEST_STUCK_S = 86_400.0  # s, a day: a room's temperature in steps of 1 degC repeats for hours
Stuck = Annotated[
    Positive, AfterValidator(trips_by(LONGEST_STUCK_S)), Field(json_schema_extra={"maximum": LONGEST_STUCK_S})
]
# between two readings, well below the period of any loop: a limit of rate above the range over this time never trips
SHORTEST_INTERVAL_S = 1e-4
LARGEST_RATE = 1e7  # per second, of a quantity without a limit: a thousand of any unit in `SHORTEST_INTERVAL_S`
LARGEST_FLOOR = 0.05  # share of limits.current_A, ten times the default; a drive that is off may read eight floors
BlockPath = tuple[str | int, ...]
T = TypeVar("T")


def _key(unit: str, name: str) -> str:
    """Return the key of a bench file that holds a field of an entry, with its unit if it has one."""
    if name not in KEYS_WITH_UNIT:
        return name
    return f"{name}_{unit}_per_s" if name == "rate" else f"{name}_{unit}"


class QuantityLimits(Block):
    """Values from which one quantity warns and trips, for one role or for all; magnitudes, or `_low` and `_high`."""

    unit: ClassVar[str] = ""
    lowest_factor: ClassVar[float] = -1.0  # lowest value over a magnitude `warn` or `trip`

    role: Literal["test", "load", "bench"] | None = None
    warn: Finite | None = None
    trip: Finite | None = None
    warn_low: Finite | None = None
    warn_high: Finite | None = None
    trip_low: Finite | None = None
    trip_high: Finite | None = None
    for_s: Duration = 0.0  # how long a value has to be beyond `trip` before it trips
    rate: Positive | None = None  # largest change per second between one reading and the next
    stuck_s: Stuck | None = None  # how long exactly the same value may repeat while other channels change
    age_s: Age | None = None  # largest age, in place of that of the limits

    def window(self, kind: Literal["warn", "trip"]) -> tuple[float, float]:
        """Return the lowest and highest value that does not warn, or not trip; infinite if the file states none."""
        single: float | None = getattr(self, kind)
        if single is not None:
            return self.lowest_factor * single, single
        low: float | None = getattr(self, f"{kind}_low")
        high: float | None = getattr(self, f"{kind}_high")
        return (-math.inf if low is None else low), (math.inf if high is None else high)

    @model_validator(mode="before")
    @classmethod
    def _with_units(cls, data: Any) -> Any:
        for name in (*KEYS_WITH_UNIT, "for", "stuck", "age") if isinstance(data, dict) else ():
            if name in data:
                expected = _key(cls.unit, name) if name in KEYS_WITH_UNIT else f"{name}_s"
                raise ValueError(f"{name} carries no unit; {expected} was expected")
        return data

    @model_validator(mode="after")
    def _in_order(self) -> "QuantityLimits":
        for kind in ("warn", "trip"):
            single_key = _key(self.unit, kind)
            if getattr(self, kind) is not None:
                if getattr(self, f"{kind}_low") is not None or getattr(self, f"{kind}_high") is not None:
                    raise ValueError(f"{single_key} stands beside a low or a high one; one of the two was expected")
                if self.lowest_factor < 0 and not getattr(self, kind) > 0:
                    raise ValueError(f"{single_key} {getattr(self, kind):g} is a magnitude; more than 0 was expected")
        (warn_low, warn_high), (trip_low, trip_high) = self.window("warn"), self.window("trip")
        for low, high, kind in ((warn_low, warn_high, "warn"), (trip_low, trip_high, "trip")):
            if low >= high:
                raise ValueError(f"{_key(self.unit, kind + '_low')} {low:g} is not below its high one, {high:g}")
        for name, warn, trip, beyond in (
            ("_high" if self.warn is None else "", warn_high, trip_high, warn_high > trip_high),
            ("_low" if self.warn is None else "", warn_low, trip_low, warn_low < trip_low),
        ):
            if beyond and math.isfinite(warn):
                raise ValueError(
                    f"{_key(self.unit, 'warn' + name)} {warn:g} is beyond the trip of {trip:g}; it would never warn"
                )
        if self.for_s and math.isinf(trip_low) and math.isinf(trip_high):
            raise ValueError(f"for_s {self.for_s:g} s is how long beyond a trip; {_key(self.unit, 'trip')} is missing")
        if not self.model_fields_set - {"role"}:
            raise ValueError(f"says nothing; {_key(self.unit, 'trip')} or another value was expected")
        return self


def _keys_in(unit: str) -> ConfigDict:
    return ConfigDict(alias_generator=lambda name: _key(unit, name))


class InAmperes(QuantityLimits):
    """Interlock on a current [A]."""

    model_config = _keys_in("A")
    unit = "A"


class InVolts(QuantityLimits):
    """Interlock on a voltage [V]."""

    model_config = _keys_in("V")
    unit = "V"


class InRadians(QuantityLimits):
    """Interlock on an angle [rad]."""

    model_config = _keys_in("rad")
    unit = "rad"


class InRadiansPerSecond(QuantityLimits):
    """Interlock on a velocity [rad/s]."""

    model_config = _keys_in("rad_s")
    unit = "rad_s"


class InNewtonMetres(QuantityLimits):
    """Interlock on a torque [N*m]."""

    model_config = _keys_in("Nm")
    unit = "Nm"


class InDegrees(QuantityLimits):
    """Interlock on a temperature [degC]: `warn` and `trip` alone mean the hot side; values in kelvin are refused."""

    model_config = _keys_in("degC")
    unit = "degC"
    lowest_factor = -math.inf

    @model_validator(mode="after")
    def _in_celsius(self) -> "InDegrees":
        for name in KEYS_WITH_UNIT[:-1]:
            value: float | None = getattr(self, name)
            if value is not None and not COLDEST_DEGC <= value <= HOTTEST_DEGC:
                raise ValueError(
                    f"{name}_degC {value:g} is no temperature of a bench; {COLDEST_DEGC:g} to {HOTTEST_DEGC:g} degC was"
                    " expected (degC, not K)"
                )
        return self


def _entries_tag(value: Any) -> str:
    return "[several]" if isinstance(value, list | tuple) else "[one]"


Entries = Annotated[
    Annotated[T, Tag("[one]")] | Annotated[tuple[T, ...], Tag("[several]")],
    Discriminator(_entries_tag),
]


Share = Annotated[float, Field(strict=True, ge=0, le=50)]


class TorqueDisagreement(Block):
    """Largest difference between the torque sensor and Kt i less friction and inertia, coupled or locked.

    `tolerance_Nm` covers errors that do not grow with the torque, such as the sensor's zero and cogging;
    `share_percent` covers those that do: the sensor's gain, the torque constant and the reading of the current.
    """

    tolerance_Nm: Positive  # noqa: N815 (a unit keeps its letter)
    share_percent: Share = 5.0
    for_s: Annotated[float, Field(strict=True, gt=0, le=60, allow_inf_nan=False)] = 0.1


class VoltageDisagreement(Block):
    """Largest difference between a drive's q-axis voltage and R i plus back-EMF, beyond the tolerances of R.

    The tolerances of R include its temperature. `tolerance_V` covers errors that do not grow with the voltage, such as
    dead time; `share_percent` covers those that do.
    """

    tolerance_V: Positive  # noqa: N815 (a unit keeps its letter)
    share_percent: Share = 5.0
    for_s: Annotated[float, Field(strict=True, gt=0, le=60, allow_inf_nan=False)] = 0.2


class VelocityDisagreement(Block):
    """Largest difference between a velocity and the rate of the angle, both averaged over `for_s` and longer."""

    tolerance_rad_s: Positive
    share_percent: Share = 20.0  # of the speed: filters lag behind what swings
    for_s: Annotated[float, Field(strict=True, gt=0, le=60, allow_inf_nan=False)] = 0.5


class CurrentDisagreement(Block):
    """Largest difference between a drive's q-axis current and the current it is commanded, and for how long.

    This check is always on. `floor_A` is the least difference that counts while a drive follows a current. Eight times
    that count while it is off, because nothing regulates the zero error of its reading away.
    """

    share_percent: Annotated[float, Field(strict=True, gt=0, le=100)] = 50.0  # conventions differ by 22 %
    floor_A: Positive | None = None  # noqa: N815 (a unit keeps its letter)  None: 0.5 % of limits.current_A
    for_s: Annotated[float, Field(strict=True, gt=0, le=60)] = 0.25  # a current loop settles within milliseconds


class Supply(Block):
    """Voltage of the DC link that the supply regulates to, and how far and how long it may depart from that."""

    expected_V: Positive  # noqa: N815
    band_V: Positive  # noqa: N815
    for_s: Duration = 0.0

    @model_validator(mode="after")
    def _band_shows(self) -> Self:
        if not self.expected_V - self.band_V < self.expected_V + self.band_V < math.inf:
            raise ValueError(f"band_V {self.band_V:g} is no band about expected_V {self.expected_V:g}")
        return self


class LoopOverruns(Block):
    """Largest number in a row, or share of a window, of cycles that end more than one period late."""

    in_a_row: Annotated[int, Field(strict=True, ge=1, le=10_000)] = 20
    share_percent: Annotated[float, Field(strict=True, gt=0, lt=100)] = 20.0
    window_s: Annotated[float, Field(strict=True, gt=0, le=600)] = 2.0


class ClockJump(Block):
    """Longest step of the bench's clock between two cycles, at least five cycles; a step back always trips."""

    jump_s: Annotated[float, Field(strict=True, gt=0, le=10)] = 0.25


class DiskSpace(Block):
    """Least free space on the disk of the run file, in addition to what the planned run takes."""

    trip_MB: Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)] = 100.0  # noqa: N815
    warn_MB: Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)] | None = None  # noqa: N815 (None: five times the trip)

    @property
    def warn_bytes(self) -> float:
        """Free space in bytes below which the run warns."""
        return 1e6 * (5 * self.trip_MB if self.warn_MB is None else self.warn_MB)

    @model_validator(mode="after")
    def _warns_first(self) -> "DiskSpace":
        if self.warn_MB is not None and self.warn_MB < self.trip_MB:
            raise ValueError(f"warn_MB {self.warn_MB:g} is beyond the trip of {self.trip_MB:g}; it would never warn")
        return self


class Interlocks(Block):
    """The `interlocks:` block: entries for each quantity, and the checks of loop, clock, disk and supply."""

    q_axis_current: Entries[InAmperes] = ()
    d_axis_current: Entries[InAmperes] = ()
    line_current: Entries[InAmperes] = ()
    bus_current: Entries[InAmperes] = ()
    q_axis_voltage: Entries[InVolts] = ()
    d_axis_voltage: Entries[InVolts] = ()
    line_voltage: Entries[InVolts] = ()
    bus_voltage: Entries[InVolts] = ()
    velocity: Entries[InRadiansPerSecond] = ()
    angle: Entries[InRadians] = ()
    torque: Entries[InNewtonMetres] = ()
    drive_temperature: Entries[InDegrees] = ()
    housing_temperature: Entries[InDegrees] = ()
    winding_temperature: Entries[InDegrees] = ()
    ambient_temperature: Entries[InDegrees] = ()
    torque_disagreement: TorqueDisagreement | None = None
    voltage_disagreement: VoltageDisagreement | None = None
    velocity_disagreement: VelocityDisagreement | None = None
    current_disagreement: CurrentDisagreement = CurrentDisagreement()
    supply: Supply | None = None
    loop_overruns: LoopOverruns = LoopOverruns()
    clock: ClockJump = ClockJump()
    disk_space: DiskSpace = DiskSpace()

    def entries(self) -> Iterator[tuple[str, QuantityLimits, BlockPath]]:
        """Yield each entry with its quantity and its path in the block."""
        for quantity in UNITS:
            entries_of_quantity: QuantityLimits | tuple[QuantityLimits, ...] = getattr(self, quantity, ())
            if isinstance(entries_of_quantity, QuantityLimits):
                yield quantity, entries_of_quantity, (quantity,)
            else:
                yield from ((quantity, entry, (quantity, number)) for number, entry in enumerate(entries_of_quantity))
        if self.supply is not None:
            expected, band = self.supply.expected_V, self.supply.band_V
            window = {"trip_low_V": expected - band, "trip_high_V": expected + band, "for_s": self.supply.for_s}
            yield "bus_voltage", InVolts.model_validate(window), ("supply",)

    def of(self, quantity: str, role: str) -> list[QuantityLimits]:
        """Return the entries that apply to a channel of this quantity and role."""
        return [entry for name, entry, _ in self.entries() if name == quantity and entry.role in (None, role)]

    def beyond(self, limits: Limits) -> list[tuple[BlockPath, str]]:
        """Return faults of trips that a limit of the bench precedes, or that never happen, each with its path."""
        faults = [*self._unreachable_rates(limits), *self._unreachable_differences(limits)]
        for quantity, entry, block_path in self.entries():
            bounds = limits.of(quantity)
            low, high = entry.window("trip")
            for value, is_beyond in ((high, bounds and high > bounds[1]), (low, bounds and low < bounds[0])):
                if bounds is not None and is_beyond and math.isfinite(value):
                    unit = UNITS[quantity]
                    message = (
                        f"a trip at {value:g} {unit} is beyond the limits of {bounds[0]:g} to {bounds[1]:g} {unit}"
                    )
                    faults.append((block_path, f"{message}, which trip first; lower it, or raise the limit"))
                    break
        return faults

    def _unreachable_rates(self, limits: Limits) -> Iterator[tuple[BlockPath, str]]:
        """Yield faults of rates that no reading within the limits can exceed, each with its path in the block."""
        for quantity, entry, block_path in self.entries():
            low, high = limits.of(quantity) or (-math.inf, math.inf)
            highest_rate = min((high - low) / SHORTEST_INTERVAL_S, LARGEST_RATE)
            if entry.rate is not None and entry.rate > highest_rate:
                key, unit = _key(entry.unit, "rate"), UNITS[quantity]
                yield (
                    block_path,
                    f"{key} {entry.rate:g} would never trip; {highest_rate:g} {unit} per second or less was expected",
                )

    def _unreachable_differences(self, limits: Limits) -> Iterator[tuple[BlockPath, str]]:
        """Yield faults of differences that no readings within the limits can reach, each with its path."""
        largest_differences = (
            ("current_disagreement", "floor_A", LARGEST_FLOOR * limits.current_A, "5 % of limits.current_A"),
            ("torque_disagreement", "tolerance_Nm", limits.torque_Nm, "limits.torque_Nm"),
            ("voltage_disagreement", "tolerance_V", limits.bus_voltage_high_V, "limits.bus_voltage_high_V"),
            ("velocity_disagreement", "tolerance_rad_s", limits.velocity_rad_s, "limits.velocity_rad_s"),
        )
        for check, key, largest, source in largest_differences:
            value = getattr(getattr(self, check), key, None)
            if value is not None and value > largest:
                yield (check, key), f"{value:g} would never trip; {largest:g} ({source}) or less was expected"

    def blind(self, channels: Sequence[ChannelSpec]) -> list[tuple[BlockPath, str]]:
        """Return faults of entries without a channel and of temperatures without a trip, each with its path."""
        measured = {(channel.quantity, channel.role) for channel in channels}
        quantities = {quantity for quantity, _role in measured}
        faults: list[tuple[BlockPath, str]] = []
        for quantity, entry, block_path in self.entries():
            if (quantity, entry.role) not in measured and not (entry.role is None and quantity in quantities):
                of_role = f" of role '{entry.role}'" if entry.role else ""
                faults.append((block_path, f"no device measures a {quantity}{of_role}; it would never trip"))
        if self.torque_disagreement and not {("torque", "test"), ("q_axis_current", "test")} <= measured:
            message = "no device measures both torque and q_axis_current of role 'test'; it would never trip"
            faults.append((("torque_disagreement",), message))
        if self.voltage_disagreement and "q_axis_voltage" not in quantities:
            faults.append((("voltage_disagreement",), "no device measures a q_axis_voltage; it would never trip"))
        if self.velocity_disagreement and not {"velocity", "angle"} <= quantities:
            message = "no device measures both velocity and angle; it would never trip"
            faults.append((("velocity_disagreement",), message))
        for channel in channels:
            entries = self.of(channel.quantity, channel.role)
            if channel.quantity in QUANTITIES_NEEDING_TRIP and not any(
                math.isfinite(e.window("trip")[1]) for e in entries
            ):
                message = (
                    f"{channel.device} measures it of role '{channel.role}', and no trip_degC says how hot it may be"
                )
                faults.append(((channel.quantity,), message))
        return faults

    def shown(self) -> dict[str, Any]:
        """Return the block with its defaults, by the keys of the bench file."""
        block: dict[str, Any] = self.model_dump(by_alias=True, exclude_none=True)
        return {name: value for name, value in block.items() if value not in ((), [])}
