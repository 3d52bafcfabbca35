"""A mapping proposed from a log alone (`--map auto`): what each column is, with the evidence, and what is not decided.

A unit is decided by what the file declares of it, by the documentation of the program that wrote it, by the column's
header, by its range, or by another column whose unit is known. Where none of these decides, the proposal has
`UNDECIDED` in its place, which no import accepts, and a question.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from leactl.errors import InputError
from leactl.quantities import SETUPS
from leactl.runfile.importing_dialects import LogDialect, csv_forms, dialect_of
from leactl.runfile.importing_evidence import (
    CLOSE,
    TIGHT,
    Series,
    are_counts,
    follows,
    gain_of,
    is_gear,
    is_wide_for_rad,
    pairs_of,
    units_by_range,
    units_of_time,
)
from leactl.runfile.importing_formats import format_of, open_source
from leactl.runfile.importing_joints import PLACEHOLDER
from leactl.runfile.importing_mapping import CsvForm
from leactl.runfile.importing_sources import Lacking, Listed, SourceRequest, Tabulated, WantedColumn
from leactl.runfile.importing_words import is_time, meaning_of, shaft_of
from leactl.units import SECONDS, converter, known_units

Array = npt.NDArray[np.float64]
UNDECIDED: Final = "UNDECIDED"
LEAVE_OUT: Final = "-"  # what a person answers of a channel or a stream that is not to be imported
LIKELY: Final[dict[str, tuple[str, ...]]] = {  # by the unit of a run file, what is asked for; others can be written
    "rad": ("rad", "deg", "turn", "m"),
    "rad/s": ("rad/s", "deg/s", "rpm", "turn/s", "m/s"),
    "N*m": ("N*m", "mN*m", "N"),
    "A": ("A", "mA"),
    "V": ("V", "mV"),
    "degC": ("degC", "degF", "K"),
    "1": ("1", "%"),
}
COUNTS: Final = "turns a count, 1/4096 where an encoder has 12 bits"
MOST_JOINTS: Final = 4  # whose numbers are looked at
Answers = Mapping[tuple[str, ...], str]


class OpenQuestion(NamedTuple):
    """What the evidence does not decide."""

    key: tuple[str, ...]  # in the mapping
    text: str
    choices: tuple[str, ...]  # the likeliest first; empty where a number is asked for
    quantity: str = ""  # any of whose units is an answer

    @property
    def may_be_left_out(self) -> bool:
        """Whether a channel or a stream can do without an answer, by not being imported."""
        return self.key[0] == "streams"


class Proposal(NamedTuple):
    """A mapping as far as it is decided."""

    text: str  # of the mapping file
    questions: list[OpenQuestion]


@dataclass
class SeenTable:
    """A table with its numbers, of each joint that was looked at."""

    table: Tabulated
    dialect: LogDialect | None
    columns: list[dict[str | int, Array]]


@dataclass
class Survey:
    """Everything that a source has."""

    path: Path
    format: str
    csv: CsvForm
    tables: list[SeenTable]


@dataclass
class Proposed:
    """One channel, as far as it is decided."""

    column: str | int
    quantity: str
    role: str
    units: tuple[str, ...]  # one where it is decided
    why: list[str]
    scale: float | None = None
    scale_of: str = ""
    sign: int = 1
    location: str = ""
    is_settled: bool = False  # by a person, or for a person to settle: numbers decide nothing more
    values: list[Array] = field(default_factory=list)

    def decide(self, units: str, why: str) -> None:
        """Take one unit."""
        self.units = (units,)
        self.why.append(why)


@dataclass
class ProposedStream:
    """The channels of one table."""

    name: str
    table: Tabulated
    time: Listed | None
    time_units: tuple[str, ...]
    time_why: str
    channels: dict[str, Proposed]
    left_out: dict[str | int, str]  # columns that are no channel, and why
    stamps: list[Array]  # of each joint that was looked at, as they are written
    rate_Hz: float = 0.0  # of samples without stamps, where it is known  # noqa: N815 (a unit keeps its letter)


def survey(path: Path) -> Survey:
    """Read every column of numbers of a source.

    Raises
    ------
    InputError : unreadable, or without a column of numbers.
    """
    name = format_of(path)
    form, tables = tables_of(path, name)
    wanted = [
        WantedColumn(*filled(column.name, table.records, joint))
        for table in tables
        for joint in joints_seen(table)
        for column in ((*table.columns, table.time) if table.time else table.columns)
    ]
    source = open_source(path, name, SourceRequest(wanted, csv=form))
    seen = []
    for table in tables:
        by_joint: list[dict[str | int, Array]] = []
        for joint in joints_seen(table):
            by_joint.append({})
            for column in (*table.columns, *([table.time] if table.time else [])):
                try:
                    values = source.column(*filled(column.name, table.records, joint))
                except Lacking:
                    continue  # of this joint, or nowhere a number
                if not isinstance(values, list):
                    by_joint[-1][column.name] = values
        seen.append(SeenTable(table, dialect_of(table), by_joint))
    return Survey(path, name, form, seen)


def tables_of(path: Path, name: str) -> tuple[CsvForm, list[Tabulated]]:
    """The tables of a source, and how it is written where it is text: the form under which most columns are numbers."""
    best: tuple[CsvForm, list[Tabulated]] = CsvForm(), []
    faults: list[str] = []
    for form in csv_forms() if name == "csv" else [CsvForm()]:
        try:
            tables = open_source(path, name, SourceRequest(None, csv=form)).tables()
        except InputError as fault:
            faults += fault.faults
            continue
        if sum(len(table.columns) for table in tables) > sum(len(table.columns) for table in best[1]):
            best = form, tables
    if not any(table.columns for table in best[1]):
        raise InputError(faults[:1] or f"{path}: no table of numbers that a mapping could take")
    return best


def joints_seen(table: Tabulated) -> tuple[str, ...]:
    """Joints whose numbers are looked at; one without a name where a table has none."""
    return table.joints[:MOST_JOINTS] or ("",)


def filled(column: str | int, records: str | None, joint: str) -> tuple[str | int, str | None]:
    """A column with a joint's name in place of `{joint}`."""
    name = column.replace(PLACEHOLDER, joint) if isinstance(column, str) else column
    return name, records.replace(PLACEHOLDER, joint) if records else None


def propose(seen: Survey, answers: Answers) -> Proposal:
    """A mapping of a source, with what a person has answered and what is still to be asked."""
    streams = streams_of(seen, answers)
    if not streams and LEAVE_OUT in answers.values():
        raise InputError(f"{seen.path}: every channel was left out")
    if not streams:
        columns = ", ".join(str(column.name) for table in seen.tables for column in table.table.columns)
        raise InputError(comment(f"{seen.path}: no name says what a column measures: {columns}; write a mapping"))
    return Proposal(mapping_text(seen, streams, answers), questions_of(streams, answers))


def streams_of(seen: Survey, answers: Answers) -> list[ProposedStream]:
    """The streams of a proposal, with what a person has answered."""
    streams: list[ProposedStream] = []
    for table in seen.tables:
        stream = stream_of(table, {each.name for each in streams})
        if stream.channels:
            streams.append(stream)
    for stream in streams:
        answered(stream, answers)
    decide_by_numbers(streams)
    streams = [stream for stream in streams if stream.channels]
    set_apart(streams)
    return streams


def stream_of(seen: SeenTable, taken: set[str]) -> ProposedStream:
    """The channels of a table by what is declared, documented or written in their names."""
    table, dialect = seen.table, seen.dialect
    time, time_units, time_why = time_of(seen)
    channels: dict[str, Proposed] = {}
    left_out: dict[str | int, str] = {}
    for column in table.columns:
        values = [each[column.name] for each in seen.columns if column.name in each]
        if time is not None and column.name == time.name:
            continue
        if not any(np.isfinite(each).any() for each in values):
            left_out[column.name] = "holds no number"
            continue
        proposed = channel_of(column, table, dialect)
        if isinstance(proposed, str):
            left_out[column.name] = proposed
            continue
        proposed.values = values
        channels[free(slug(str(column.name)), channels)] = proposed
    name = free(slug((table.records or "loop").replace(f"[{PLACEHOLDER}]", "")), taken)
    stamps = [each[time.name] for each in seen.columns if time.name in each] if time else []
    return ProposedStream(name, table, time, time_units, time_why, channels, left_out, stamps)


def channel_of(column: Listed, table: Tabulated, dialect: LogDialect | None) -> Proposed | str:
    """What a column is, or why it is no channel."""
    name = str(column.name)
    if isinstance(column.name, int):
        name = f"{table.records or ''}[{column.name}]"
    if dialect is not None and (known := dialect.channel(name)):
        if not known.quantity:
            return f"{dialect.meaning} has it, and it is no channel of a run"
        role = meaning_of(name).role or "test"
        why = f"{' or '.join(known.units)} by {dialect.meaning}"
        channel = Proposed(column.name, known.quantity, role, known.units, [why])
        channel.scale, channel.scale_of, channel.sign = known.scale, known.scale_of, known.sign
        channel.location = known.location
        return channel
    said = meaning_of(f"{table.records or ''}.{name}" if name == "value" else name)
    quantity = column.quantity or said.quantity
    if not quantity:
        return said.why_not
    role = said.role or "test"
    if column.units and converter(column.units, quantity):
        return Proposed(column.name, quantity, role, (column.units,), [f"{column.units} by {column.declared_by}"])
    if said.units:
        return Proposed(column.name, quantity, role, (said.units,), [f"{said.units} stands in its name"])
    likely = [units for units in LIKELY[known_units(quantity)[0]] if converter(units, quantity)]
    return Proposed(column.name, quantity, role, tuple(likely), [f"{quantity} by its name"])


def time_of(seen: SeenTable) -> tuple[Listed | None, tuple[str, ...], str]:
    """The column of stamps, the units that it may be in, and why."""
    table, dialect = seen.table, seen.dialect
    if table.time is not None:
        return table.time, (table.time.units,), table.time.declared_by
    if dialect is not None and dialect.time is not None:
        return Listed(dialect.time.column), (dialect.time.units,), f"{dialect.time.units} by {dialect.meaning}"
    for column in table.columns:
        values = seen.columns[0].get(column.name)
        if values is None or not is_time(str(column.name)) or not increases(values):
            continue
        said = column.units or meaning_of(str(column.name)).units
        if said in SECONDS:
            return column, (said,), f"{said} stands {'in its name' if not column.units else 'in ' + column.declared_by}"
        likely, why = units_of_time(values)
        return column, tuple(likely), why
    return None, (), "no column of stamps by its name"


def increases(values: Array) -> bool:
    """Whether a column goes up nearly everywhere, as stamps do."""
    steps = np.diff(values)
    return len(steps) > 0 and bool(np.isfinite(values).all()) and float((steps > 0).mean()) > 0.5 and steps.sum() > 0


def answered(stream: ProposedStream, answers: Answers) -> None:
    """Put what a person has said in its place."""
    of_time = {key: answers.get(("streams", stream.name, "time", key)) for key in ("units", "rate_Hz")}
    if LEAVE_OUT in of_time.values():
        stream.channels.clear()
        return
    if of_time["units"]:
        stream.time_units, stream.time_why = (of_time["units"],), "as answered"
    if of_time["rate_Hz"]:
        stream.rate_Hz, stream.time_why = float(Fraction(of_time["rate_Hz"])), "as answered"
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
    """Decide units by ranges, then by what goes with what, until nothing more follows."""
    everything = [(stream, channel) for stream in streams for channel in stream.channels.values()]
    for _, channel in everything:
        if len(channel.units) > 1 and channel.values:
            units, why = units_by_range(channel.quantity, np.concatenate(channel.values))
            if units in channel.units:
                channel.decide(units, f"{units} by {why}")
    timed = [(stream, channel) for stream, channel in everything if stream.stamps and len(stream.time_units) == 1]
    pairs = [(one, other) for one in timed for other in timed if belong(one, other)]
    while True:
        before = [channel.units for _, channel in timed]
        for (stream, channel), (other_stream, other) in pairs:
            if (channel.quantity, other.quantity) == ("velocity", "angle"):
                decide_by_travel(channel, series_of(stream, channel), other, series_of(other_stream, other))
            elif other.quantity == f"{channel.quantity}_reference":
                decide_by_setpoint(channel, series_of(stream, channel), other, series_of(other_stream, other))
            elif (channel.quantity, other.quantity) == ("torque", "angle"):
                decide_by_kind(channel, other)
        if [channel.units for _, channel in timed] == before:
            break
    for _, channel in everything:
        if len(channel.units) > 1 and channel.quantity.startswith("angle") and are_counts(channel.values):
            channel.units, channel.scale_of = ("turn",), COUNTS if channel.scale is None else ""
            channel.why.append("whole numbers, as an encoder counts")
        elif len(channel.units) > 1 and channel.units[0] == "rad" and is_wide_for_rad(np.concatenate(channel.values)):
            channel.units = tuple(dict.fromkeys(("deg", *channel.units)))
            channel.why.append("its range is wide for rad")


def belong(one: tuple[ProposedStream, Proposed], other: tuple[ProposedStream, Proposed]) -> bool:
    """Whether two channels are of one shaft, as far as their names say."""
    if one[1].role != other[1].role:
        return False
    if one[0] is other[0]:
        return shaft_of(str(one[1].column)) == shaft_of(str(other[1].column))
    names = [f"{stream.table.records or ''}.{channel.column}" for stream, channel in (one, other)]
    return shaft_of(names[0]) == shaft_of(names[1])


def series_of(stream: ProposedStream, channel: Proposed) -> list[Series]:
    """A channel over its stamps, of each joint that was looked at."""
    factor = SECONDS[stream.time_units[0]]
    by_joint = zip(stream.stamps, channel.values, strict=False)
    return [Series(stamps * factor, values) for stamps, values in by_joint if len(stamps) == len(values)]


def decide_by_travel(
    velocity: Proposed, velocity_series: list[Series], angle: Proposed, angle_series: list[Series]
) -> None:
    """Decide by the factor between a velocity and the change of its angle."""
    if velocity.scale_of or angle.scale_of or velocity.is_settled:
        return
    by_joint = zip(angle_series, velocity_series, strict=False)
    known = [gain for gain in (gain_of(of_angle, of_velocity) for of_angle, of_velocity in by_joint) if gain]
    if not known:
        return
    best = min(known, key=lambda gain: gain.std / abs(gain.value))
    gain = abs(best.value) * (velocity.scale or 1.0) / (angle.scale or 1.0)
    told = f"{velocity.column} is {gain:.4g} times the change of {angle.column}"
    is_one = abs(gain - 1.0) <= CLOSE
    pairs = pairs_of(gain, CLOSE if is_one else TIGHT)
    fitting = [pair for pair in pairs if same(pair[0], angle.units) and same(pair[1], velocity.units)]
    decided = [len(channel.units) == 1 for channel in (angle, velocity)]
    if all(decided):
        others = [pair for pair in pairs if same(pair[0], angle.units)]
        if not fitting and others and not is_gear(gain):  # what one of both is said to be in is wrong
            velocity.units, velocity.is_settled = (others[0][1], *velocity.units), True
            velocity.why.append(f"yet {told}, as {others[0][1]} would be")
        return
    alone = len({pair[0] for pair in fitting}) == 1 and len({pair[1] for pair in fitting}) == 1
    if alone and ((any(decided) and is_one) or not is_gear(gain)):
        for channel, units in zip((angle, velocity), fitting[0], strict=True):
            if len(channel.units) > 1:
                channel.decide(units, f"{units}: {told}")
        return
    if not fitting and decided[0]:
        velocity.units = tuple(
            dict.fromkeys((*(pair[1] for pair in pairs if same(pair[0], angle.units)), *velocity.units))
        )
    for channel, at in ((angle, 0), (velocity, 1)):
        likely = [units for units in channel.units if any(same(pair[at], (units,)) for pair in fitting)]
        if len(channel.units) > 1:
            channel.units = (*likely, *(units for units in channel.units if units not in likely))
            channel.why += [told] if told not in channel.why else []


def same(units: str, among: tuple[str, ...]) -> bool:
    """Whether a unit is one of these, by whatever name."""
    meant = [converter(units, kind) for kind in ("angle", "velocity")]
    return any(meant == [converter(each, kind) for kind in ("angle", "velocity")] for each in among)


def decide_by_setpoint(
    reading: Proposed, reading_series: list[Series], setpoint: Proposed, setpoint_series: list[Series]
) -> None:
    """Decide by a setpoint that the reading follows one to one."""
    known, asked = (reading, setpoint) if len(reading.units) == 1 else (setpoint, reading)
    if len(known.units) != 1 or len(asked.units) == 1 or known.units[0] not in asked.units:
        return
    by_joint = zip(reading_series, setpoint_series, strict=False)
    if any(follows(measured, wanted, reading.quantity) for measured, wanted in by_joint):
        asked.decide(known.units[0], f"{known.units[0]}: {reading.column} follows {setpoint.column} one to one")


def decide_by_kind(torque: Proposed, angle: Proposed) -> None:
    """Decide between torque and force where the axis is known to be one or the other."""
    conversion = converter(angle.units[0], "angle")
    if set(torque.units) == {"N*m", "N"} and len(angle.units) == 1 and conversion is not None:
        units = "N*m" if conversion.target == "rad" else "N"
        torque.decide(units, f"{units}: {angle.column} is in {angle.units[0]}")


def set_apart(streams: list[ProposedStream]) -> None:
    """Give channels of one quantity and role a location each, unless they have one."""
    alike: dict[tuple[str, str, str], list[tuple[str, Proposed]]] = {}
    for stream in streams:
        for name, channel in stream.channels.items():
            key = (channel.quantity, channel.role, channel.location)
            alike.setdefault(key, []).append((f"{stream.name}_{name}" if len(streams) > 1 else name, channel))
    for several in alike.values():
        if len(several) > 1:
            for name, channel in several:
                channel.location = name
                channel.why.append(f"location {name}: others measure the same by their names")


def questions_of(streams: list[ProposedStream], answers: Answers) -> list[OpenQuestion]:
    """What is not decided, in the order of the mapping."""
    found = []
    if ("mechanical",) not in answers:
        found.append(OpenQuestion(("mechanical",), "mechanics of the rig: no log says", SETUPS))
    for stream in streams:
        key: tuple[str, ...] = ("streams", stream.name, "time")
        if stream.time is None and not stream.rate_Hz:
            text = f"stream {stream.name}: {stream.time_why}; samples a second"
            found.append(OpenQuestion((*key, "rate_Hz"), text, ()))
        elif len(stream.time_units) != 1 and stream.time is not None:
            text = f"stream {stream.name}, stamps {stream.time.name!r}: {stream.time_why}"
            found.append(OpenQuestion((*key, "units"), comment(text), stream.time_units or tuple(SECONDS)))
        for name, channel in stream.channels.items():
            key = ("streams", stream.name, "channels", name)
            about = f"stream {stream.name}, {channel.column!r} ({channel.quantity})"
            if len(channel.units) != 1:
                text = comment(f"{about}: {'; '.join(channel.why)}")
                found.append(OpenQuestion((*key, "units"), text, channel.units, channel.quantity))
            if channel.scale_of:
                found.append(OpenQuestion((*key, "scale"), comment(f"{about}: scale is {channel.scale_of}"), ()))
    return found


def accepted(question: OpenQuestion, text: str) -> str | None:
    """An answer as the mapping has it; None where it is none: a choice, its number from 1, a unit, a scale, or `-`."""
    text = text.strip()
    if text == LEAVE_OUT and question.may_be_left_out:
        return text
    if not question.choices:
        try:
            scale = float(Fraction(text))  # 1/4096 as well
        except (ValueError, ZeroDivisionError, OverflowError):
            return None
        return text if 0.0 < scale < math.inf else None
    if text.isdigit() and 1 <= int(text) <= len(question.choices):
        return question.choices[int(text) - 1]
    known = known_units(question.quantity) if question.quantity else question.choices
    return text if text in known else None


def mapping_text(seen: Survey, streams: list[ProposedStream], answers: Answers) -> str:
    """The proposal as a mapping file, each channel under its evidence."""
    lines = [
        f"# Proposed from {comment(seen.path.name)}; every line is to be read before it is used.",
        f"format: {seen.format}",
    ]
    form = seen.csv.model_dump(exclude_defaults=True)
    if form:
        lines.append(f"csv: {{{', '.join(f'{key}: {quoted(str(value))}' for key, value in form.items())}}}")
    lines.append(f"mechanical: {answers.get(('mechanical',), UNDECIDED)}  # {', '.join(SETUPS)}")
    if any(stream.table.joints for stream in streams):
        lines.append("joints: all  # or some of " + ", ".join(streams_joints(streams)))
    lines.append("streams:")
    for stream in streams:
        lines += [f"  {stream.name}:"]
        if stream.table.records:
            lines.append(f"    records: {quoted(stream.table.records)}")
        lines.append(f"    time: {{{time_keys(stream)}}}  # {comment(stream.time_why)}")
        lines.append("    channels:")
        for name, channel in stream.channels.items():
            lines.append(f"      # {comment('; '.join(channel.why))}")
            lines.append(f"      {name}: {{{', '.join(keys_of(channel))}}}{alternatives(channel)}")
        for left, why in stream.left_out.items():
            lines.append(f"      # {comment(str(left))}: left out, {comment(why)}")
    return "\n".join(lines) + "\n"


def time_keys(stream: ProposedStream) -> str:
    """The keys of a stream's stamps in a mapping."""
    if stream.time is None:
        return f"rate_Hz: {stream.rate_Hz!r}" if stream.rate_Hz else f"rate_Hz: {UNDECIDED}"
    units = stream.time_units[0] if len(stream.time_units) == 1 else UNDECIDED
    return f"column: {plain(stream.time.name)}, units: {units}"


def keys_of(channel: Proposed) -> Iterator[str]:
    """The keys of a channel in a mapping."""
    yield f"column: {plain(channel.column)}"
    yield f"quantity: {channel.quantity}"
    if channel.role != "test":
        yield f"role: {channel.role}"
    yield f"units: {plain(channel.units[0]) if len(channel.units) == 1 else UNDECIDED}"
    if channel.scale_of:
        yield f"scale: {UNDECIDED}"
    elif channel.scale is not None:
        yield f"scale: {channel.scale!r}"
    if channel.sign != 1:
        yield f"sign: {channel.sign}"
    if channel.location:
        yield f"location: {channel.location}"


def alternatives(channel: Proposed) -> str:
    """What a person chooses from, as a comment."""
    told = [" or ".join(channel.units)] if len(channel.units) != 1 else []
    told += [f"scale: {channel.scale_of}"] if channel.scale_of else []
    return f"  # {'; '.join(told)}" if told else ""


def streams_joints(streams: list[ProposedStream]) -> list[str]:
    """Every joint that is listed."""
    return list(dict.fromkeys(comment(joint) for stream in streams for joint in stream.table.joints))


def plain(value: str | int) -> str:
    """A value as YAML takes it inside braces."""
    if isinstance(value, int) or re.fullmatch(r"[A-Za-z_/][A-Za-z0-9_./-]*", value):
        is_word = isinstance(value, str) and value.lower() in ("null", "true", "false")  # which YAML takes for no text
        return quoted(str(value)) if is_word else str(value)
    return quoted(value)


def quoted(text: str) -> str:
    """A text in quotes, with whatever could end them or their line written out."""
    return "".join(['"', *(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in text), '"'])


def comment(text: str) -> str:
    """A text that stays on its line."""
    return "".join(character if character.isprintable() else " " for character in text)


def slug(text: str) -> str:
    """A text as a name of a mapping."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_") or "column"


def free(name: str, taken: Mapping[str, object] | set[str]) -> str:
    """A name that is not taken; `time` is that of the stamps."""
    names = [name, *(f"{name}_{count}" for count in range(2, len(taken) + 3))]
    return next(each for each in names if each not in taken and each != "time")
