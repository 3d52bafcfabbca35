"""A diagnosis as text, in the order of the questions: what, how far the gap shrinks, where; then calibration, notes."""

import shutil
import sys
import textwrap
from collections.abc import Sequence

from leactl.gap.diagnosis import Cause, Diagnosis, Shrinkage
from leactl.report.gap_simulator import summary, tables
from leactl.report.gap_words import (
    CLOSES_NOTHING,
    bare_units,
    change,
    claims,
    closed_by_calibration,
    closed_text,
    closes_nothing,
    counted,
    figure,
    floors,
    label,
    largest_first,
    listed,
    open_gap,
    parameter_text,
    picture_words,
    probability,
    refusal_words,
    region_text,
    rest_channel,
    rest_words,
    sentence,
    variable_words,
    with_std,
)
from leactl.report.html import without_control_characters
from leactl.report.terminal import SMALLEST, aligned, encodable, encoding_of_stdout

WIDEST = 120  # characters; notes that run wider are hard to read
NO_BREAK = "\u00a0"  # a space at which no line ends
MOST_REGIONS = 5  # entries of the part that says where


def print_diagnosis(answer: Diagnosis) -> None:
    """Print the answer as wide as the terminal, 80 columns into a pipe."""
    width = shutil.get_terminal_size((80, 24)).columns
    sys.stdout.write(render(answer, width, encoding_of_stdout()))


def render(answer: Diagnosis, width: int = 80, encoding: str = "utf-8") -> str:
    """The whole answer, for a stream of this width and encoding."""
    width = min(max(width, SMALLEST), WIDEST)
    parts = [
        verdict_part(answer, width),
        simulator_part(answer, width),
        unexplained_part(answer, width),
        shrinkage_part(answer, width),
        region_part(answer, width),
        calibration_part(answer, width),
        "\n".join(filled(f"note: {note}", width) for note in answer.notes),
    ]
    return encodable(without_control_characters("\n\n".join(filter(None, parts))) + "\n", encoding)


def verdict_part(answer: Diagnosis, width: int) -> str:
    """The verdict and the causes."""
    chance = probability(answer.unexplained_probability)
    lines = [
        filled(f"verdict: {answer.verdict}. {sentence(answer)}", width),
        filled(f"probability that something unexplained acts: {chance}", width),
    ]
    if answer.causes:
        lines += ["", "causes"]
    for cause in answer.causes:
        lines += cause_lines(cause, width)
    if closes_nothing(answer):
        lines.append(filled(CLOSES_NOTHING, width))
    return "\n".join(lines)


def simulator_part(answer: Diagnosis, width: int) -> str:
    """What a simulator that stands for the model contains, and what it leaves over; empty where none does."""
    nominal = answer.simulator
    if nominal is None:
        return ""
    sentences = [filled(sentence, width) for sentence in summary(nominal, claims(answer.causes))]
    return "\n\n".join(
        ["\n".join(sentences), *(table(*headings_and_rows, width) for headings_and_rows in tables(nominal))]
    )


def unexplained_part(answer: Diagnosis, width: int) -> str:
    """What the rest depends on, what comes nearest, and what would decide."""
    rest = answer.unexplained
    if rest is None:
        return ""
    lines = [filled(f"not explained: {rest_channel(rest)}", width), filled(rest_words(rest), width, 2)]
    lines += [filled(f"over {variable_words(picture)}: {picture_words(picture)}", width, 2) for picture in rest.shapes]
    lines += [filled(f"near: {refusal_words(near)}", width, 2) for near in rest.nearest]
    if rest.experiment:
        lines.append(filled(f"to decide: leactl run {rest.experiment}", width, 2))
    return "\n".join(lines)


def cause_lines(cause: Cause, width: int) -> list[str]:
    """One cause with its parameters, its class and the experiment that separates it."""
    lines = [f"{probability(cause.probability):>6}  {cause.effect}"]
    name_width = max((len(parameter.name) for parameter in cause.parameters), default=0)
    lines += [f"          {parameter.name:{name_width}}  {parameter_text(parameter)}" for parameter in cause.parameters]
    if cause.picture is not None:
        lines.append(filled(f"over {variable_words(cause.picture)}: {picture_words(cause.picture)}", width, 10))
    if cause.indistinguishable_from:
        lines.append(filled(f"cannot be told from {listed(cause.indistinguishable_from)}", width, 10))
    if cause.change:
        lines.append(filled(f"to mend: {cause.change}", width, 10))
    if cause.separating_experiment:
        lines.append(filled(f"to separate: leactl run {cause.separating_experiment}", width, 10))
    return lines


def shrinkage_part(answer: Diagnosis, width: int) -> str:
    """The channels that have a gap, before and after, and how many have none."""
    if not answer.shrinkage:
        return ""
    shown = largest_first(answer.shrinkage)
    lines: list[str] = []
    headings: tuple[str, ...]
    if shown and claims(answer.causes):
        headings = ("gap (RMS)", "nominal", "before", "after", "floor", "", "closed (95 %)")
        lines.append(table(headings, [effect_row(channel, answer.shrinkage) for channel in shown], width, droppable=1))
        lines.append(filled("before: the calibrated model; after: with the effects; on held-out runs", width))
    else:
        shown = shown or closed_by_calibration(answer.shrinkage)[:MOST_REGIONS]
    if shown and not lines:
        headings = ("gap (RMS)", "nominal", "calibrated", "floor", "", "over floor")
        lines.append(table(headings, [calibration_row(channel, answer.shrinkage) for channel in shown], width))
    return "\n".join([*lines, filled(counted(answer.shrinkage), width)])


def effect_row(channel: Shrinkage, channels: Sequence[Shrinkage]) -> list[str]:
    """A channel before and after the effects."""
    numbers = (channel.nominal_rms, channel.calibrated_rms, channel.augmented_rms, channel.floor_rms)
    return [label(channel, channels), *map(figure, numbers), bare_units(channel.units), closed_text(channel)]


def calibration_row(channel: Shrinkage, channels: Sequence[Shrinkage]) -> list[str]:
    """A channel before and after calibration, where no effect is added."""
    numbers = (channel.nominal_rms, channel.calibrated_rms, channel.floor_rms)
    return [label(channel, channels), *map(figure, numbers), bare_units(channel.units), floors(channel)]


def region_part(answer: Diagnosis, width: int) -> str:
    """The largest gaps and their regions."""
    rows = [
        (
            label(channel, answer.where),
            f"{figure(channel.calibrated_rms)} {bare_units(channel.units)}",
            region_text(channel.region, channel.share),
        )
        for channel in answer.where
        if open_gap(channel)
    ]
    if not rows:
        return ""
    lines = [table(("where", "calibrated", "region and its share"), rows[:MOST_REGIONS], width)]
    if len(rows) > MOST_REGIONS:
        lines.append(f"and {len(rows) - MOST_REGIONS} more with a smaller gap")
    return "\n".join(lines)


def calibration_part(answer: Diagnosis, width: int) -> str:
    """Parameters of the nominal model, fitted again."""
    rows = [
        (
            parameter.parameter,
            f"{parameter.nominal:.6g}",
            with_std(parameter.fitted, parameter.std),
            bare_units(parameter.units),
            change(parameter),
        )
        for parameter in answer.calibration
    ]
    return table(("calibration", "nominal", "fitted ± std", "", "change"), rows, width, droppable=1) if rows else ""


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int, droppable: int | None = None) -> str:
    """Columns where they fit, first without the one to spare, then with the last cell of long rows on the next line.

    Where that does not fit either, each row's name has a line of its own.
    """
    whole = aligned(headings, rows)
    if widest(whole) <= width:
        return whole
    kept = [k for k in range(len(headings)) if k != droppable]
    headings, rows = [headings[k] for k in kept], [[row[k] for k in kept] for row in rows]
    without_last = aligned([*headings[:-1], ""], [[*row[:-1], ""] for row in rows]).splitlines()
    last_cells = [headings[-1], *(row[-1] for row in rows)]
    start = max(map(len, without_last)) + 2
    if start + len(headings[-1]) <= width and max(map(len, last_cells)) + 4 <= width:
        same_line, next_line = "{0:{1}}{2}", "{0}\n    {2}"
        joined = (
            (same_line if start + len(last) <= width else next_line).format(line, start, last)
            for line, last in zip(without_last, last_cells, strict=True)
        )
        return "\n".join(line.rstrip() for line in joined)
    lines = [headings[0]]
    for row in rows:
        pairs = [f"{heading} {cell}".strip() for heading, cell in zip(headings[1:], row[1:], strict=True) if cell]
        whole = ", ".join(pair.replace(" ", NO_BREAK) if len(pair) < width - 8 else pair for pair in pairs)
        lines += [f"  {row[0]}", filled(whole, width, 4).replace(NO_BREAK, " ")]
    return "\n".join(lines)


def widest(text: str) -> int:
    """Length of the longest line."""
    return max(map(len, text.splitlines()))


def filled(text: str, width: int, indent: int = 0) -> str:
    """Text on as many lines as it needs; long words such as paths stay whole."""
    first, later = " " * indent, " " * (indent + 2)
    return textwrap.fill(
        text, width, initial_indent=first, subsequent_indent=later, break_long_words=False, break_on_hyphens=False
    )
