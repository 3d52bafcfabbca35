"""Define the mapping file of an import, which assigns columns of a source to channels of the run.

A column is named by its header, by its index from 0, or by a dotted path (`log.entries.position`, `cells[2].t`). The
values of a channel are `sign * (scale * column + offset)` in `units`, converted to the units of its quantity.
"""
# ruff: noqa: N815 (a unit keeps its letter)

import re
from collections.abc import Iterator
from typing import Annotated, Final, Literal, Self, TypeGuard

from pydantic import Field, StringConstraints, field_validator, model_validator

from leactl.driver.file_records import OffsetEstimate
from leactl.quantities import UNITS
from leactl.runfile.instruments import Instrument
from leactl.tables.columns import CsvForm
from leactl.units import converter, known_units
from leactl.yamlblock import Block
from leactl.yamlfile import Location

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Above = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0)]
Text = Annotated[str, StringConstraints(strict=True, min_length=1)]
Name = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$")]
Joint = Annotated[str, StringConstraints(strict=True, pattern=r"^[^\[\]{}]+$")]
Row = Annotated[int, Field(strict=True, ge=0)]
Column = Text | Row
# units of quantities whose calibration uncertainty analyses use; clocks and encoders count as exact
CALIBRATED_UNITS = ("A", "V", "N*m")
CHANNEL_PATH = r"^[^/]+/[^/]+$"  # stream/channel
PLACEHOLDER: Final = "{joint}"  # in paths: stands for each joint in turn


def as_label(cell: str | float) -> str:
    """Convert a cell to a label: a number in its shortest form, so that `1` and `1.0` agree, other text unchanged."""
    try:
        return f"{float(cell) + 0.0:.15g}"  # 0 for -0
    except ValueError:
        return str(cell)


def is_channel_path(value: float | str) -> TypeGuard[str]:
    """Return whether a parameter of a step names a channel as `stream/channel`."""
    return isinstance(value, str) and re.match(CHANNEL_PATH, value) is not None


class FieldOf(Block):
    """A single value of the source; a number is used as `scale * field + offset`."""

    field: Column
    scale: Number = 1.0
    offset: Number = 0.0


class TimeBase(Block):
    """Source of the stamps: a column, a rate, or a start and a step."""

    column: Column | None = None
    units: Literal["s", "ms", "us", "ns", "min", "h", "iso8601"] = "s"
    rate_Hz: Above | None = None
    start_s: Number = 0.0
    step_s: Above | None = None
    repeated: Literal["refuse", "drop"] = "refuse"  # treatment of a row with the stamp of the row before

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        """Raise ValueError unless exactly one source of stamps is given; `start_s` does not go with a column."""
        given_keys = [key for key in ("column", "rate_Hz", "step_s") if getattr(self, key) is not None]
        if len(given_keys) != 1:
            raise ValueError(f"give one of column, rate_Hz, step_s; {' and '.join(given_keys) or 'none'} is given")
        if self.column is not None and self.start_s:
            raise ValueError("start_s goes with rate_Hz or step_s; use clock.offset_s to shift a column of stamps")
        return self


class StreamClock(Block):
    """Offset of a stream's stamps from the clock of the run: given, or estimated from two channels."""

    offset_s: Number | None = None
    estimate: OffsetEstimate | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        """Raise ValueError unless either an offset or an estimate is given."""
        if (self.offset_s is None) == (self.estimate is None):
            raise ValueError("give either offset_s or estimate")
        return self


class ChannelMapping(Block):
    """One channel: its column, quantity, role, units and calibration."""

    column: Column
    quantity: Text
    role: Literal["test", "load", "bench"] = "test"
    units: Text | None = None  # of the column once scaled; the quantity's own by default
    sign: Literal[1, -1] = 1
    scale: Number | FieldOf = 1.0
    offset: Number | FieldOf = 0.0  # added after scale, before sign
    location: str = ""
    device: str = ""
    long_name: str = ""
    sampling: Literal["instant", "mean"] | None = None  # None: a stamp is known to within one sample
    scale_std: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.0  # relative, of the instrument's calibration

    @field_validator("quantity")
    @classmethod
    def _known_quantity(cls, value: str) -> str:
        """Return the quantity; raise ValueError if it is not in the vocabulary."""
        if value not in UNITS:
            raise ValueError(f"no such quantity; known: {', '.join(UNITS)}")
        return value

    @model_validator(mode="after")
    def _scale_std_is_used(self) -> Self:
        """Raise an error at `scale_std` if no analysis uses it for this quantity."""
        if self.scale_std and UNITS.get(self.quantity) not in CALIBRATED_UNITS:
            raise self.faulty(
                [(("scale_std",), f"counts for {', '.join(CALIBRATED_UNITS)}; nothing reads that of {self.quantity}")]
            )
        return self

    @model_validator(mode="after")
    def _units_fit_quantity(self) -> Self:
        """Raise ValueError if the units do not convert to those of the quantity."""
        if self.units is not None and converter(self.units, self.quantity) is None:
            raise ValueError(f"units {self.units!r} are none of {', '.join(known_units(self.quantity))}")
        return self


class StreamMapping(Block):
    """Channels that share one sampling clock."""

    records: Text | None = None  # path of the list of records, struct or matrix that columns are looked up in
    time: TimeBase
    clock: StreamClock | None = None
    channels: Annotated[dict[Name, ChannelMapping], Field(min_length=1)]


class PartMapping(Block):
    """A part of the source that becomes a run of its own: rows or times from the first to before the last."""

    suffix: Name
    rows: tuple[Row, Row] | None = None  # of every stream: for sources with one stream
    time_s: tuple[Number, Number] | None = None  # on the run's clock

    @model_validator(mode="after")
    def _one_range(self) -> Self:
        """Raise ValueError unless exactly one range is given, and its ends are in order."""
        if (self.rows is None) == (self.time_s is None):
            raise ValueError("give either rows or time_s")
        first, last = self.rows or self.time_s or (0, 0)
        if first >= last:
            raise ValueError(f"{first} is not before {last}")
        return self


class ByDirection(Block):
    """Each sweep in one direction becomes a run: `-forward`, `-reverse`, numbered from the second on."""

    channel: Annotated[str, StringConstraints(strict=True, pattern=CHANNEL_PATH)]
    least: Above  # least travel of a sweep, in the channel's units


class StepAt(Block):
    """A step of the run by its start and stop on the run's clock."""

    name: Name
    start_s: Number
    stop_s: Number
    settle_s: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)] = 0.0  # analyses leave it out
    parameters: dict[Name, Number | str] = {}

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        """Raise ValueError if the step does not stop after its settle time."""
        if not self.start_s + self.settle_s < self.stop_s:
            raise ValueError(f"start_s {self.start_s:g} and settle_s {self.settle_s:g} are not before {self.stop_s:g}")
        return self


class StepsByColumn(Block):
    """Steps by a column of the source: each stretch of rows with one number or label that `names` has."""

    stream: Name
    column: Column
    names: Annotated[dict[Text, Name], Field(min_length=1)]  # name of the step by label
    time: TimeBase | None = None  # stamps of the labels if they have their own; a label holds until the next
    settle_s: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)] = 0.0
    parameters: dict[Name, Number | str] = {}  # a value, or `stream/channel` for the channel's median in the step

    @field_validator("names")
    @classmethod
    def _labels_differ(cls, names: dict[str, str]) -> dict[str, str]:
        """Return the names by label; raise ValueError if two keys are the same label."""
        names_by_label: dict[str, str] = {}
        for text, name in names.items():
            if (label := as_label(text)) in names_by_label:
                raise ValueError(f"label {label} stands twice")
            names_by_label[label] = name
        return names_by_label


class StepsByHolds(Block):
    """Steps named `hold`, one for each stretch in which a channel, preferably a setpoint, keeps its level."""

    channel: Annotated[str, StringConstraints(strict=True, pattern=CHANNEL_PATH)]
    parameter: Name  # name of the level in the step's parameters, such as current_A
    least_s: Above  # least duration of a hold
    settle_s: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)] = 0.0
    parameters: dict[Name, Number | str] = {}

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        """Raise ValueError if the settle time is not shorter than the shortest hold."""
        if not self.settle_s < self.least_s:
            raise ValueError(f"settle_s {self.settle_s:g} leaves nothing of a hold of least_s {self.least_s:g}")
        return self


class RunMapping(Block):
    """Root attributes of the run."""

    protocol: str | FieldOf = ""
    bench: str | FieldOf = ""
    actuator: str | FieldOf = ""
    condition: str | FieldOf = ""
    operator: str | FieldOf = ""
    created: str | FieldOf | None = None  # ISO 8601; the source file's own time by default
    simulated: bool = False


class Mapping(Block):
    """A mapping file."""

    format: Text | None = None  # one of `leactl.runfile.importing.sources.registry`; by the file's ending otherwise
    mechanical: Literal["free", "locked", "coupled", "heated"]
    joints: Literal["all"] | tuple[Joint, ...] = ()  # names that replace `{joint}`, one run each
    run: RunMapping = RunMapping()
    setup: dict[Name, Number | str | FieldOf] = {}
    parameters: dict[Name, Number | str | FieldOf] = {}  # of the protocol
    instruments: dict[Name, Instrument] = {}
    csv: CsvForm = CsvForm()
    streams: Annotated[dict[Name, StreamMapping], Field(min_length=1)]
    parts: tuple[PartMapping, ...] = ()
    by_direction: ByDirection | None = None
    steps: tuple[StepAt, ...] = ()
    steps_by_column: StepsByColumn | None = None
    steps_by_holds: StepsByHolds | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        """Raise an error with the locations of all keys that contradict each other."""
        if faults := [*self._faults_of_parts(), *self._faults_of_steps(), *self._faults_of_channels()]:
            raise self.faulty(faults)
        return self

    def _faults_of_parts(self) -> Iterator[tuple[Location, str]]:
        """Yield location and message of each fault of `parts` and `by_direction`."""
        if self.parts and self.by_direction:
            yield ("by_direction",), "stands beside parts; one of both was expected"
        suffixes = [part.suffix for part in self.parts]
        for index, part in enumerate(self.parts):
            if part.suffix in suffixes[:index]:
                yield ("parts", index, "suffix"), f"{part.suffix!r} stands twice"
            if part.rows and len(self.streams) > 1:
                yield ("parts", index, "rows"), "rows mean nothing to several streams; time_s was expected"

    def _faults_of_steps(self) -> Iterator[tuple[Location, str]]:
        """Yield location and message of each fault of the settings that define steps."""
        given_keys = [name for name in ("steps", "steps_by_column", "steps_by_holds") if getattr(self, name)]
        for name in given_keys[1:]:
            yield (name,), f"stands beside {given_keys[0]}; one way to find steps was expected"
        if self.steps and (self.parts or self.by_direction):
            yield (
                ("steps",),
                "instants of the whole mean nothing to its parts; steps_by_column or _by_holds was expected",
            )
        label_settings = self.steps_by_column
        if label_settings and label_settings.time and label_settings.time.column is None:
            yield ("steps_by_column", "time"), "column was expected: labels that hold until the next have their stamps"
        if label_settings and label_settings.stream not in self.streams:
            stream_names = ", ".join(self.streams)
            yield ("steps_by_column", "stream"), f"no stream {label_settings.stream!r} is mapped; {stream_names} are"

    def _faults_of_channels(self) -> Iterator[tuple[Location, str]]:
        """Yield location and message of each channel that is mapped twice or referred to without being mapped."""
        references: list[tuple[Location, str]] = []
        if self.by_direction:
            references.append((("by_direction", "channel"), self.by_direction.channel))
        if self.steps_by_holds:
            references.append((("steps_by_holds", "channel"), self.steps_by_holds.channel))
        if self.steps_by_column:
            parameters = self.steps_by_column.parameters.items()
            references += [
                (("steps_by_column", "parameters", name), value) for name, value in parameters if is_channel_path(value)
            ]
        for name, stream in self.streams.items():
            if stream.clock and (estimate := stream.clock.estimate):
                keys: Location = ("streams", name, "clock", "estimate")
                references += [
                    ((*keys, "channel"), f"{name}/{estimate.channel}"),
                    ((*keys, "against"), estimate.against),
                ]
                if estimate.against.split("/")[0] == name:
                    yield (*keys, "against"), "is a channel of the same stream"
        mapped: list[str] = []
        paths_by_key: dict[tuple[str, str, str], str] = {}
        for name, stream in self.streams.items():
            for channel, settings in stream.channels.items():
                mapped.append(f"{name}/{channel}")
                keys = ("streams", name, "channels", channel)
                first_path = paths_by_key.setdefault((settings.quantity, settings.role, settings.location), mapped[-1])
                if first_path != mapped[-1]:
                    yield keys, f"same quantity, role and location as {first_path}; give each a location"
                if channel == "time":
                    yield keys, "'time' is the name of a stream's stamps; another was expected"
        for keys, channel in references:
            if channel not in mapped:
                yield keys, f"no channel {channel!r} is mapped; {', '.join(mapped)} are"
