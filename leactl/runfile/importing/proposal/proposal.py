"""Propose a mapping from a log alone (`--map auto`): each channel with its evidence, and the questions that remain.

If nothing decides a value, the proposal has `UNDECIDED`, which no import accepts, and a question.
"""

import math
import re
from collections.abc import Iterator
from fractions import Fraction
from typing import Final, NamedTuple

from leactl.errors import InputError
from leactl.quantities import SETUPS
from leactl.runfile.importing.proposal.channel_units import (
    LEAVE_OUT,
    Answers,
    ProposedChannel,
    ProposedStream,
    streams_of,
)
from leactl.runfile.importing.proposal.survey import Survey
from leactl.units import SECONDS, known_units

UNDECIDED: Final = "UNDECIDED"


class OpenQuestion(NamedTuple):
    """A value of the mapping that the evidence does not decide."""

    key: tuple[str, ...]  # in the mapping
    text: str
    choices: tuple[str, ...]  # the likeliest first; empty: a number is asked for
    quantity: str = ""  # any unit of this quantity is an answer

    @property
    def may_be_left_out(self) -> bool:
        """Whether the channel or stream of the question may be left out of the import."""
        return self.key[0] == "streams"


class Proposal(NamedTuple):
    """A mapping file, as far as it is decided, and the open questions."""

    text: str  # of the mapping file
    questions: list[OpenQuestion]


def propose(surveyed: Survey, answers: Answers) -> Proposal:
    """Propose a mapping of a surveyed source, with a person's answers so far.

    Raises
    ------
    InputError : no column's name tells a quantity, or every channel was left out.
    """
    streams = streams_of(surveyed, answers)
    if not streams and LEAVE_OUT in answers.values():
        raise InputError(f"{surveyed.path}: every channel was left out")
    if not streams:
        columns_of_tables = [column for table in surveyed.tables for column in table.table.columns]
        columns = ", ".join(
            f"{column.name}" + (f" ({column.why_unnamed})" * bool(column.why_unnamed)) for column in columns_of_tables
        )
        raise InputError(one_line(f"{surveyed.path}: no name says what a column measures: {columns}; write a mapping"))
    return Proposal(mapping_text(surveyed, streams, answers), questions_of(streams, answers))


def questions_of(streams: list[ProposedStream], answers: Answers) -> list[OpenQuestion]:
    """Return the open questions, in the order of the mapping."""
    questions = []
    if ("mechanical",) not in answers:
        questions.append(OpenQuestion(("mechanical",), "mechanics of the rig: no log says", SETUPS))
    for stream in streams:
        key: tuple[str, ...] = ("streams", stream.name, "time")
        if stream.time is None and not stream.rate_Hz:
            text = f"stream {stream.name}: {stream.time_why}; samples a second"
            questions.append(OpenQuestion((*key, "rate_Hz"), text, ()))
        elif len(stream.time_units) != 1 and stream.time is not None:
            text = f"stream {stream.name}, stamps {stream.time.name!r}: {stream.time_why}"
            questions.append(OpenQuestion((*key, "units"), one_line(text), stream.time_units or tuple(SECONDS)))
        for name, channel in stream.channels.items():
            key = ("streams", stream.name, "channels", name)
            channel_text = f"stream {stream.name}, {channel.column!r} ({channel.quantity})"
            if len(channel.units) != 1:
                text = one_line(f"{channel_text}: {'; '.join(channel.why)}")
                questions.append(OpenQuestion((*key, "units"), text, channel.units, channel.quantity))
            if channel.scale_of:
                questions.append(
                    OpenQuestion((*key, "scale"), one_line(f"{channel_text}: scale is {channel.scale_of}"), ())
                )
    return questions


def accepted_answer(question: OpenQuestion, text: str) -> str | None:
    """Convert a typed answer (a choice, its number from 1, a unit, a scale, or `-`) to a value; None if invalid."""
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
    accepted = known_units(question.quantity) if question.quantity else question.choices
    return text if text in accepted else None


def mapping_text(surveyed: Survey, streams: list[ProposedStream], answers: Answers) -> str:
    """Return the text of the mapping file, with the evidence as a comment above each channel."""
    lines = [
        f"# Proposed from {one_line(surveyed.path.name)}; every line is to be read before it is used.",
        f"format: {surveyed.format}",
    ]
    form = surveyed.csv.model_dump(exclude_defaults=True)
    if form:
        settings = (f"{key}: {value if isinstance(value, int) else quoted(value)}" for key, value in form.items())
        lines.append(f"csv: {{{', '.join(settings)}}}")
    if run := [f"{name}: {stated(value)}" for table in surveyed.tables for name, value in table.table.run]:
        lines.append(f"run: {{{', '.join(run)}}}  # as the file declares")
    lines.append(f"mechanical: {answers.get(('mechanical',), UNDECIDED)}  # {', '.join(SETUPS)}")
    if any(stream.table.joints for stream in streams):
        lines.append("joints: all  # or some of " + ", ".join(streams_joints(streams)))
    lines.append("streams:")
    for stream in streams:
        lines += [f"  {stream.name}:"]
        if stream.table.records:
            lines.append(f"    records: {quoted(stream.table.records)}")
        lines.append(f"    time: {{{time_keys(stream)}}}  # {one_line(stream.time_why)}")
        lines.append("    channels:")
        for name, channel in stream.channels.items():
            lines.append(f"      # {one_line('; '.join(channel.why))}")
            lines.append(f"      {name}: {{{', '.join(keys_of(channel))}}}{alternatives(channel)}")
        for column, reason in stream.left_out.items():
            lines.append(f"      # {one_line(str(column))}: left out, {one_line(reason)}")
    return "\n".join(lines) + "\n"


def time_keys(stream: ProposedStream) -> str:
    """Return the keys of `time` of a stream, as YAML."""
    if stream.time is None:
        return f"rate_Hz: {stream.rate_Hz!r}" if stream.rate_Hz else f"rate_Hz: {UNDECIDED}"
    units = stream.time_units[0] if len(stream.time_units) == 1 else UNDECIDED
    return f"column: {yaml_value(stream.time.name)}, units: {units}"


def keys_of(channel: ProposedChannel) -> Iterator[str]:
    """Yield the keys of a channel, as YAML."""
    yield f"column: {yaml_value(channel.column)}"
    yield f"quantity: {channel.quantity}"
    if channel.role != "test":
        yield f"role: {channel.role}"
    yield f"units: {yaml_value(channel.units[0]) if len(channel.units) == 1 else UNDECIDED}"
    if channel.scale_of:
        yield f"scale: {UNDECIDED}"
    elif channel.scale is not None:
        yield f"scale: {channel.scale!r}"
    if channel.sign != 1:
        yield f"sign: {channel.sign}"
    if channel.location:
        yield f"location: {yaml_value(channel.location)}"
    for name, text in channel.declared.items():
        yield f"{name}: {yaml_value(text)}"


def alternatives(channel: ProposedChannel) -> str:
    """Return a comment with the possible units and the meaning of the scale; empty if both are decided."""
    choices = [" or ".join(channel.units)] if len(channel.units) != 1 else []
    choices += [f"scale: {channel.scale_of}"] if channel.scale_of else []
    return f"  # {'; '.join(choices)}" if choices else ""


def streams_joints(streams: list[ProposedStream]) -> list[str]:
    """Return all joints of the streams' tables."""
    return list(dict.fromkeys(one_line(joint) for stream in streams for joint in stream.table.joints))


def stated(value: str | bool) -> str:
    """Return a root attribute of a run as YAML."""
    return str(value).lower() if isinstance(value, bool) else quoted(value)


def yaml_value(value: str | int) -> str:
    """Return a value written for YAML's flow style, quoted if needed."""
    if isinstance(value, int) or re.fullmatch(r"[A-Za-z_/][A-Za-z0-9_./-]*", value):
        is_word = isinstance(value, str) and value.lower() in ("null", "true", "false")  # which YAML takes for no text
        return quoted(str(value)) if is_word else str(value)
    return quoted(value)


def quoted(text: str) -> str:
    """Return a text in double quotes, with quotes, backslashes and unprintable characters escaped."""
    escaped = (
        character if character.isprintable() and character not in '"\\' else f"\\U{ord(character):08x}"
        for character in text
    )
    return f'"{"".join(escaped)}"'


def one_line(text: str) -> str:
    """Return a text with unprintable characters replaced by blanks, so that it stays on its line."""
    return "".join(character if character.isprintable() else " " for character in text)
