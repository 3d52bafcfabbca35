"""Propose a channel for each column of a log; its unit is decided by evidence or left open among likely units.

A unit is decided by the file's own declaration, by the documentation of the program that wrote it, by the column's
header, by the range of its values, or by another column whose unit is known.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Final

import numpy as np
import numpy.typing as npt

from leactl.runfile.importing.column_names import is_time, meaning_of, shaft_of
from leactl.runfile.importing.mapping import PLACEHOLDER
from leactl.runfile.importing.proposal.inferred_units import (
    EPOCHS,
    PAIR_GAIN_TOLERANCE,
    UNIT_GAIN_TOLERANCE,
    UNITS_LIKE_A_GEAR,
    ColumnSeries,
    are_counts,
    equals_setpoint,
    gain_of,
    is_gear,
    is_wide_for_rad,
    unit_pairs_with_gain,
    units_by_range,
    units_of_time,
)
from leactl.runfile.importing.proposal.log_dialects import LogDialect
from leactl.runfile.importing.proposal.survey import Survey, SurveyedTable
from leactl.runfile.importing.sources.source import ListedColumn, ListedTable
from leactl.tables.text_table import unit_of
from leactl.units import SECONDS, converter, known_units

Array = npt.NDArray[np.float64]
LEAVE_OUT: Final = "-"  # a person's answer for a channel or a stream that is not to be imported
# units offered to a person, by the unit of a run file; a person may also type another one
LIKELY_UNITS: Final[dict[str, tuple[str, ...]]] = {
    "rad": ("rad", "deg", "turn", "m"),
    "rad/s": ("rad/s", "deg/s", "rpm", "turn/s", "m/s"),
    "N*m": ("N*m", "mN*m", "N"),
    "A": ("A", "mA"),
    "V": ("V", "mV"),
    "degC": ("degC", "degF", "K"),
    "1": ("1", "%"),
}
COUNTS: Final = "turns a count, 1/4096 where an encoder has 12 bits"  # shown to a person
Answers = Mapping[tuple[str, ...], str]  # by keys of the mapping


@dataclass
class ProposedChannel:
    """A channel of the proposed mapping, as far as it is decided."""

    column: str | int
    quantity: str
    role: str
    units: tuple[str, ...]  # a single unit once it is decided, else the likely units
    why: list[str]  # reasons for quantity, role and units
    scale: float | None = None
    scale_of: str = ""  # description of a scale that a person has to give; empty if none is needed
    sign: int = 1
    location: str = ""
    declared: dict[str, str] = field(default_factory=dict)  # device and sampling, by the file
    is_settled: bool = False  # whether a person has answered or has to answer, so that values decide nothing more
    values: list[Array] = field(default_factory=list)

    def decide(self, units: str, reason: str) -> None:
        """Decide on one unit, with the reason."""
        self.units = (units,)
        self.why.append(reason)


@dataclass
class ProposedStream:
    """A stream of the proposed mapping: the channels of one table."""

    name: str
    table: ListedTable
    time: ListedColumn | None
    time_units: tuple[str, ...]
    time_why: str
    channels: dict[str, ProposedChannel]
    left_out: dict[str | int, str]  # columns that are no channel, and why
    stamps: list[Array]  # of each surveyed joint, in the units of the file
    rate_Hz: float = 0.0  # of samples without stamps; 0 if unknown  # noqa: N815 (a unit keeps its letter)


def streams_of(surveyed: Survey, answers: Answers) -> list[ProposedStream]:
    """Return the proposed streams of a survey, with a person's answers applied."""
    streams: list[ProposedStream] = []
    names = frozenset(name_of(column, table.table) for table in surveyed.tables for column in table.table.columns)
    for table in surveyed.tables:
        stream = stream_of(table, names, {proposed.name for proposed in streams})
        if stream.channels:
            streams.append(stream)
    for stream in streams:
        apply_answers(stream, answers)
    decide_by_numbers(streams)
    streams = [stream for stream in streams if stream.channels]
    add_locations(streams)
    return streams


def stream_of(surveyed: SurveyedTable, names: frozenset[str], used_names: set[str]) -> ProposedStream:
    """Propose the channels of a table by declarations, documentation and names.

    Parameters
    ----------
    surveyed : the table with its values.
    names : names of all columns of the log.
    used_names : names of the streams proposed before.
    """
    table, dialect = surveyed.table, surveyed.dialect
    time, time_units, time_why = time_of(surveyed)
    channels: dict[str, ProposedChannel] = {}
    left_out: dict[str | int, str] = dict(table.left_out)
    for column in table.columns:
        values = [joint_values[column.name] for joint_values in surveyed.columns if column.name in joint_values]
        if time is not None and column.name == time.name:
            continue
        if not any(np.isfinite(joint_values).any() for joint_values in values):
            left_out[column.name] = "holds no number"
            continue
        proposed = channel_of(column, table, dialect, names)
        if isinstance(proposed, str):
            left_out[column.name] = proposed
            continue
        proposed.values = values
        channels[free_name(slug(str(column.name)), channels)] = proposed
    name = free_name(slug((table.records or "loop").replace(f"[{PLACEHOLDER}]", "")), used_names)
    stamps = [joint_values[time.name] for joint_values in surveyed.columns if time.name in joint_values] if time else []
    return ProposedStream(name, table, time, time_units, time_why, channels, left_out, stamps)


def channel_of(
    column: ListedColumn, table: ListedTable, dialect: LogDialect | None, names: frozenset[str]
) -> ProposedChannel | str:
    """Propose a channel for a column, with the declarations of its file, or return why it is not a channel."""
    proposed = column.why_unnamed or channel_by_units(column, table, dialect, names)
    if isinstance(proposed, str):
        return proposed
    if column.role:
        proposed.role = column.role
        proposed.why.append(f"role {column.role} by {column.declared_by}")
    proposed.location = column.location or proposed.location
    facts = {"device": column.device, "sampling": column.sampling}
    proposed.declared = {name: text for name, text in facts.items() if text}
    return proposed


def name_of(column: ListedColumn, table: ListedTable) -> str:
    """Return the name that describes a column: that of its table for an entry's value or a column of a matrix."""
    if isinstance(column.name, int):
        return f"{table.records or ''}[{column.name}]"
    return table.records or column.name if column.name == "value" else column.name


def channel_by_units(
    column: ListedColumn, table: ListedTable, dialect: LogDialect | None, names: frozenset[str]
) -> ProposedChannel | str:
    """Propose a channel by its documentation, its declared units or its name, or return why it is not a channel."""
    name = name_of(column, table)
    if dialect is not None and (documented := dialect.channel(name)):
        if not documented.quantity:
            return f"{dialect.meaning} has it, and it is no channel of a run"
        role = meaning_of(name).role or "test"
        reason = f"{' or '.join(documented.units)} by {dialect.meaning}"
        channel = ProposedChannel(column.name, documented.quantity, role, documented.units, [reason])
        channel.scale, channel.scale_of, channel.sign = documented.scale, documented.scale_of, documented.sign
        channel.location = documented.location
        return channel
    meaning = meaning_of(name, column.units, names)
    quantity = column.quantity or meaning.quantity
    if not quantity:
        return meaning.why_not
    role = meaning.role or "test"
    role_reason = [f"role {role} by its name"] if meaning.role and not column.role else []
    if column.units and converter(column.units, quantity):
        return ProposedChannel(
            column.name, quantity, role, (column.units,), [f"{column.units} by {column.declared_by}", *role_reason]
        )
    if meaning.units and converter(meaning.units, quantity):
        return ProposedChannel(
            column.name, quantity, role, (meaning.units,), [f"{meaning.units} stands in its name", *role_reason]
        )
    likely_units = [units for units in LIKELY_UNITS[known_units(quantity)[0]] if converter(units, quantity)]
    reasons = [f"{quantity} by its name", *([meaning.doubt] if meaning.doubt else []), *role_reason]
    return ProposedChannel(column.name, quantity, role, tuple(likely_units), reasons, is_settled=bool(meaning.doubt))


def time_of(surveyed: SurveyedTable) -> tuple[ListedColumn | None, tuple[str, ...], str]:
    """Return the column of stamps, its possible units, and the reason; None, () and the reason if there is none."""
    table, dialect = surveyed.table, surveyed.dialect
    if table.time is not None:
        return table.time, (table.time.units,), table.time.declared_by
    if dialect is not None and dialect.time is not None:
        return ListedColumn(dialect.time.column), (dialect.time.units,), f"{dialect.time.units} by {dialect.meaning}"
    columns = [
        (column, values)
        for column in table.columns
        if (values := surveyed.columns[0].get(column.name)) is not None
        and is_time(str(column.name))
        and increases(values)
    ]
    for column, _ in columns:
        units = column.units or meaning_of(str(column.name)).units
        if units in SECONDS:
            location_text = f"in {column.declared_by}" if column.units else "in its name"
            return column, (units,), f"{units} stands {location_text}"
    if columns:
        column, values = columns[0]
        if text := unit_of(str(column.name)):
            return column, tuple(EPOCHS), f"its unit is {text}, which is not known"
        likely_units, reason = units_of_time(values)
        return column, tuple(likely_units), reason
    return None, (), "no column that increases has a name for stamps"


def increases(values: Array) -> bool:
    """Return whether a column is finite and increases at more than half of its rows, as stamps do."""
    steps = np.diff(values)
    return len(steps) > 0 and bool(np.isfinite(values).all()) and float((steps > 0).mean()) > 0.5 and steps.sum() > 0


def apply_answers(stream: ProposedStream, answers: Answers) -> None:
    """Apply a person's answers to a stream; channels answered with `LEAVE_OUT` are removed."""
    time_answers = {key: answers.get(("streams", stream.name, "time", key)) for key in ("units", "rate_Hz")}
    if LEAVE_OUT in time_answers.values():
        stream.channels.clear()
        return
    if time_answers["units"]:
        stream.time_units, stream.time_why = (time_answers["units"],), "as answered"
    if time_answers["rate_Hz"]:
        stream.rate_Hz, stream.time_why = float(Fraction(time_answers["rate_Hz"])), "as answered"
    for name, channel in list(stream.channels.items()):
        key = ("streams", stream.name, "channels", name)
        units = answers.get((*key, "units"))
        if LEAVE_OUT in (units, answers.get((*key, "scale"))):
            stream.left_out[channel.column] = "as answered"
            del stream.channels[name]
            continue
        if units:
            channel.decide(units, f"{units} as answered")
            channel.is_settled = True
        if scale := answers.get((*key, "scale")):
            channel.scale, channel.scale_of = float(Fraction(scale)), ""


def decide_by_numbers(streams: list[ProposedStream]) -> None:
    """Decide units by ranges, then by pairs of channels, until no further unit follows."""
    channels = [(stream, channel) for stream in streams for channel in stream.channels.values()]
    for _, channel in channels:
        if channel.values and not channel.is_settled:
            decide_by_range(channel)
    stamped_channels = [
        (stream, channel) for stream, channel in channels if stream.stamps and len(stream.time_units) == 1
    ]
    pairs = [
        (first, second) for first in stamped_channels for second in stamped_channels if are_of_one_shaft(first, second)
    ]
    while True:
        units_before = [channel.units for _, channel in stamped_channels]
        for (stream, channel), (other_stream, other_channel) in pairs:
            if (channel.quantity, other_channel.quantity) == ("velocity", "angle"):
                decide_by_travel(
                    channel, series_of(stream, channel), other_channel, series_of(other_stream, other_channel)
                )
            elif other_channel.quantity == f"{channel.quantity}_reference":
                decide_by_setpoint(
                    channel, series_of(stream, channel), other_channel, series_of(other_stream, other_channel)
                )
            elif (channel.quantity, other_channel.quantity) == ("torque", "angle"):
                decide_by_axis_kind(channel, other_channel)
        if [channel.units for _, channel in stamped_channels] == units_before:
            break
    for _, channel in channels:
        if len(channel.units) > 1 and channel.quantity.startswith("angle") and are_counts(channel.values):
            channel.units, channel.scale_of = ("turn",), COUNTS if channel.scale is None else ""
            channel.why.append("whole numbers, as an encoder counts")
        elif len(channel.units) > 1 and channel.units[0] == "rad" and is_wide_for_rad(np.concatenate(channel.values)):
            channel.units = tuple(dict.fromkeys(("deg", *channel.units)))
            channel.why.append("its range is wide for rad")


def decide_by_range(channel: ProposedChannel) -> None:
    """Decide a unit by range and jumps of the values; if they contradict the name, leave it to a person."""
    units, reason = units_by_range(channel.quantity, np.concatenate(channel.values))
    agrees_with_name = is_same_unit(units, channel.units, channel.quantity)
    if units and agrees_with_name and len(channel.units) > 1:
        channel.decide(units, f"{units} by {reason}")
    elif units and not agrees_with_name and (len(channel.units) > 1 or channel.quantity.startswith("angle")):
        channel.units, channel.is_settled = (units, *channel.units), True
        channel.why.append(f"yet {reason}")


def are_of_one_shaft(
    first: tuple[ProposedStream, ProposedChannel], second: tuple[ProposedStream, ProposedChannel]
) -> bool:
    """Return whether two channels have the same role and, by their names, the same shaft."""
    (first_stream, first_channel), (second_stream, second_channel) = first, second
    if first_channel.role != second_channel.role:
        return False
    if first_stream is second_stream:
        return shaft_of(str(first_channel.column)) == shaft_of(str(second_channel.column))
    first_name, second_name = (f"{stream.table.records or ''}.{channel.column}" for stream, channel in (first, second))
    return shaft_of(first_name) == shaft_of(second_name)


def series_of(stream: ProposedStream, channel: ProposedChannel) -> list[ColumnSeries]:
    """Return the values of a channel with stamps in s, for each surveyed joint."""
    factor = SECONDS.get(stream.time_units[0], 1.0)  # dates are seconds already
    by_joint = zip(stream.stamps, channel.values, strict=False)
    return [ColumnSeries(stamps * factor, values) for stamps, values in by_joint if len(stamps) == len(values)]


def decide_by_travel(
    velocity: ProposedChannel,
    velocity_series: list[ColumnSeries],
    angle: ProposedChannel,
    angle_series: list[ColumnSeries],
) -> None:
    """Decide units by the ratio of a velocity to the rate of change of its angle."""
    if velocity.scale_of or angle.scale_of or velocity.is_settled:
        return
    by_joint = zip(angle_series, velocity_series, strict=False)
    gains = [gain for gain in (gain_of(*angle_and_velocity) for angle_and_velocity in by_joint) if gain]
    if not gains:
        return
    most_precise = min(gains, key=lambda gain: gain.std / abs(gain.value))
    gain = abs(most_precise.value) * (velocity.scale or 1.0) / (angle.scale or 1.0)
    finding = f"{velocity.column} is {gain:.4g} times the change of {angle.column}"
    is_one = abs(gain - 1.0) <= UNIT_GAIN_TOLERANCE
    pairs = unit_pairs_with_gain(gain, UNIT_GAIN_TOLERANCE if is_one else PAIR_GAIN_TOLERANCE)
    fitting_pairs = [
        (angle_unit, velocity_unit)
        for angle_unit, velocity_unit in pairs
        if is_same_unit(angle_unit, angle.units, "angle") and is_same_unit(velocity_unit, velocity.units, "velocity")
    ]
    are_decided = [len(channel.units) == 1 for channel in (angle, velocity)]
    if all(are_decided):
        pairs_of_angle = [pair for pair in pairs if is_same_unit(pair[0], angle.units, "angle")]
        if not fitting_pairs and pairs_of_angle and not is_gear(gain):  # the unit of one channel is wrong
            velocity.units, velocity.is_settled = (pairs_of_angle[0][1], *velocity.units), True
            velocity.why.append(f"yet {finding}, as {pairs_of_angle[0][1]} would be")
        pairs_of_velocity = [pair for pair in pairs if is_same_unit(pair[1], velocity.units, "velocity")]
        if not fitting_pairs and pairs_of_velocity and not is_gear(gain) and not angle.is_settled:
            angle.units, angle.is_settled = (pairs_of_velocity[0][0], *angle.units), True
            angle.why.append(f"yet {finding}, as it would be in {pairs_of_velocity[0][0]}")
        return
    is_unique = len({unit for unit, _ in fitting_pairs}) == 1 and len({unit for _, unit in fitting_pairs}) == 1
    if is_unique and is_one and any(are_decided):
        for channel, units in zip((angle, velocity), fitting_pairs[0], strict=True):
            if len(channel.units) > 1 and not channel.is_settled and units not in UNITS_LIKE_A_GEAR:
                channel.decide(units, f"{units}: {finding}")
    velocity_units = [
        velocity_unit for angle_unit, velocity_unit in pairs if is_same_unit(angle_unit, angle.units, "angle")
    ]
    if not fitting_pairs and are_decided[0]:
        velocity.units = tuple(dict.fromkeys((*velocity_units, *velocity.units)))
    for channel, index in ((angle, 0), (velocity, 1)):
        fitting_units = tuple(pair[index] for pair in fitting_pairs)
        likely_units = [units for units in channel.units if is_same_unit(units, fitting_units, channel.quantity)]
        if len(channel.units) > 1:
            channel.units = (*likely_units, *(units for units in channel.units if units not in likely_units))
            channel.why += [finding] if finding not in channel.why else []


def is_same_unit(units: str, candidates: tuple[str, ...], quantity: str) -> bool:
    """Return whether a unit is equivalent to one of the candidates, for a quantity."""
    return any(converter(units, quantity) == converter(other_units, quantity) for other_units in candidates)


def decide_by_setpoint(
    reading: ProposedChannel,
    reading_series: list[ColumnSeries],
    setpoint: ProposedChannel,
    setpoint_series: list[ColumnSeries],
) -> None:
    """Decide a unit if a reading equals its setpoint in one common unit."""
    decided, undecided = (reading, setpoint) if len(reading.units) == 1 else (setpoint, reading)
    if len(decided.units) != 1 or len(undecided.units) == 1 or decided.units[0] not in undecided.units:
        return
    by_joint = zip(reading_series, setpoint_series, strict=False)
    if any(equals_setpoint(measured, setpoint_values, reading.quantity) for measured, setpoint_values in by_joint):
        undecided.decide(decided.units[0], f"{decided.units[0]}: {reading.column} follows {setpoint.column} one to one")


def decide_by_axis_kind(torque: ProposedChannel, angle: ProposedChannel) -> None:
    """Decide between torque and force if the unit of the angle shows a rotary or a linear axis."""
    conversion = converter(angle.units[0], "angle")
    if set(torque.units) == {"N*m", "N"} and len(angle.units) == 1 and conversion is not None:
        units = "N*m" if conversion.target == "rad" else "N"
        torque.decide(units, f"{units}: {angle.column} is in {angle.units[0]}")


def add_locations(streams: list[ProposedStream]) -> None:
    """Give channels of equal quantity, role and location distinct locations."""
    by_quantity: dict[tuple[str, str, str], list[tuple[str, ProposedChannel]]] = {}
    for stream in streams:
        for name, channel in stream.channels.items():
            key = (channel.quantity, channel.role, channel.location)
            by_quantity.setdefault(key, []).append((f"{stream.name}_{name}" if len(streams) > 1 else name, channel))
    for channels in by_quantity.values():
        if len(channels) > 1:
            for name, channel in channels:
                channel.location = name
                channel.why.append(f"location {name}: others measure the same by their names")


def slug(text: str) -> str:
    """Convert a text to a name that a mapping allows and that YAML reads as text."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")
    return name if name[:1].isalpha() and name.lower() not in ("null", "true", "false") else f"column_{name}".strip("_")


def free_name(name: str, used_names: Mapping[str, object] | set[str]) -> str:
    """Return the name, with a number appended if it is in use or is `time`."""
    names = [name, *(f"{name}_{count}" for count in range(2, len(used_names) + 3))]
    return next(candidate for candidate in names if candidate not in used_names and candidate != "time")
