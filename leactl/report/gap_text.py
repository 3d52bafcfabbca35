"""A diagnosis as text: verdict, causes, reduction of the gap, regions with the largest gaps, calibration, notes."""

import sys
import textwrap
from collections.abc import Sequence

from leactl.gap.diagnosis import Cause, DiagnosisResult, Shrinkage
from leactl.report.gap_simulator import simulator_sentences, simulator_tables
from leactl.report.gap_words import (
    CLOSES_NOTHING,
    MENDED_FIRST,
    bare_units,
    calibration_rows,
    channel_label,
    claimed_effects,
    claimed_faults,
    closed_by_calibration,
    closed_count_text,
    closed_text,
    closes_nothing,
    enumerated,
    has_open_gap,
    multiple_of_floor,
    open_gaps_largest_first,
    parameter_text,
    picture_text,
    probability_text,
    refusal_text,
    region_text,
    rest_channel,
    rest_text,
    three_digits,
    variable_text,
    verdict_sentence,
)
from leactl.report.html import without_control_characters
from leactl.report.terminal import SMALLEST_WIDTH, aligned, encodable, encoding_of_stdout, terminal_columns

WIDEST_NOTE = 120  # characters; wider notes are hard to read
NO_BREAK = "\u00a0"  # a space at which no line ends
MOST_REGIONS = 5


def print_diagnosis(diagnosis: DiagnosisResult) -> None:
    """Print the diagnosis in the width of the terminal, or in 80 columns into a pipe."""
    sys.stdout.write(render(diagnosis, terminal_columns(), encoding_of_stdout()))


def render(diagnosis: DiagnosisResult, width: int = 80, encoding: str = "utf-8") -> str:
    """Return the whole diagnosis as text for a stream of this width and encoding."""
    width = min(max(width, SMALLEST_WIDTH), WIDEST_NOTE)
    parts = [
        verdict_part(diagnosis, width),
        simulator_part(diagnosis, width),
        unexplained_part(diagnosis, width),
        shrinkage_part(diagnosis, width),
        region_part(diagnosis, width),
        calibration_part(diagnosis, width),
        "\n".join(filled(f"note: {note}", width) for note in diagnosis.notes),
    ]
    return encodable(without_control_characters("\n\n".join(filter(None, parts))) + "\n", encoding)


def verdict_part(diagnosis: DiagnosisResult, width: int) -> str:
    """Return the verdict and the causes."""
    chance = probability_text(diagnosis.unexplained_probability)
    lines = [
        filled(f"verdict: {diagnosis.verdict}. {verdict_sentence(diagnosis)}", width),
        filled(f"probability that something unexplained acts: {chance}", width),
    ]
    if diagnosis.causes:
        lines += ["", "causes"]
    for cause in diagnosis.causes:
        lines += cause_lines(cause, width)
    if closes_nothing(diagnosis):
        lines.append(filled(CLOSES_NOTHING, width))
    return "\n".join(lines)


def simulator_part(diagnosis: DiagnosisResult, width: int) -> str:
    """Return sentences and tables on a simulator that takes the place of the model; empty without a simulator."""
    simulator = diagnosis.simulator
    if simulator is None:
        return ""
    sentences = [filled(sentence, width) for sentence in simulator_sentences(simulator, claimed_effects(diagnosis))]
    tables = [table(headings, rows, width) for headings, rows in simulator_tables(simulator)]
    return "\n\n".join(["\n".join(sentences), *tables])


def unexplained_part(diagnosis: DiagnosisResult, width: int) -> str:
    """Return the variables that the unexplained residual depends on, the nearest effects, and the deciding experiment.

    The text is empty if nothing is unexplained.
    """
    residual = diagnosis.unexplained
    if residual is None:
        return ""
    lines = [filled(f"not explained: {rest_channel(residual)}", width), filled(rest_text(residual), width, 2)]
    lines += [
        filled(f"over {variable_text(picture)}: {picture_text(picture)}", width, 2) for picture in residual.shapes
    ]
    lines += [filled(f"near: {refusal_text(near)}", width, 2) for near in residual.nearest]
    if residual.experiment:
        lines.append(filled(f"to decide: leactl run {residual.experiment}", width, 2))
    return "\n".join(lines)


def cause_lines(cause: Cause, width: int) -> list[str]:
    """Return one cause with its parameters, the effects that look like it, and the experiment that separates them."""
    lines = [f"{probability_text(cause.probability):>6}  {cause.effect}"]
    name_width = max((len(parameter.name) for parameter in cause.parameters), default=0)
    lines += [f"          {parameter.name:{name_width}}  {parameter_text(parameter)}" for parameter in cause.parameters]
    if cause.picture is not None:
        lines.append(filled(f"over {variable_text(cause.picture)}: {picture_text(cause.picture)}", width, 10))
    if cause.indistinguishable_from:
        lines.append(filled(f"cannot be told from {enumerated(cause.indistinguishable_from)}", width, 10))
    if cause.change:
        lines.append(filled(f"to mend: {cause.change}", width, 10))
    if cause.separating_experiment:
        lines.append(filled(f"to separate: leactl run {cause.separating_experiment}", width, 10))
    return lines


def shrinkage_part(diagnosis: DiagnosisResult, width: int) -> str:
    """Return the channels that have a gap, before and after, and how many have none."""
    if not diagnosis.shrinkage:
        return ""
    shown_channels = open_gaps_largest_first(diagnosis.shrinkage)
    lines: list[str] = []
    headings: tuple[str, ...]
    if shown_channels and claimed_effects(diagnosis):
        headings = ("gap (RMS)", "nominal", "before", "after", "floor", "", "closed (95 %)")
        lines.append(
            table(
                headings,
                [augmented_row(channel, diagnosis.shrinkage) for channel in shown_channels],
                width,
                droppable=1,
            )
        )
        lines.append(filled("before: the calibrated model; after: with the effects; on held-out runs", width))
    else:
        shown_channels = shown_channels or closed_by_calibration(diagnosis.shrinkage)[:MOST_REGIONS]
    if shown_channels and not lines:
        headings = ("gap (RMS)", "nominal", "calibrated", "floor", "", "over floor")
        lines.append(
            table(headings, [calibrated_row(channel, diagnosis.shrinkage) for channel in shown_channels], width)
        )
    lines += [filled(MENDED_FIRST, width)] if claimed_faults(diagnosis) else []
    return "\n".join([*lines, filled(closed_count_text(diagnosis.shrinkage), width)])


def augmented_row(channel: Shrinkage, channels: Sequence[Shrinkage]) -> list[str]:
    """Return a channel's RMS before and after the effects are added."""
    numbers = (channel.nominal_rms, channel.calibrated_rms, channel.augmented_rms, channel.floor_rms)
    return [
        channel_label(channel, channels),
        *map(three_digits, numbers),
        bare_units(channel.units),
        closed_text(channel),
    ]


def calibrated_row(channel: Shrinkage, channels: Sequence[Shrinkage]) -> list[str]:
    """Return a channel's RMS before and after calibration, where no effect is added."""
    numbers = (channel.nominal_rms, channel.calibrated_rms, channel.floor_rms)
    return [
        channel_label(channel, channels),
        *map(three_digits, numbers),
        bare_units(channel.units),
        multiple_of_floor(channel),
    ]


def region_part(diagnosis: DiagnosisResult, width: int) -> str:
    """Return the largest gaps and the region that holds most of each."""
    rows = [
        (
            channel_label(channel, diagnosis.where),
            f"{three_digits(channel.calibrated_rms)} {bare_units(channel.units)}",
            region_text(channel.region, channel.share),
        )
        for channel in diagnosis.where
        if has_open_gap(channel)
    ]
    if not rows:
        return ""
    lines = [table(("where", "calibrated", "region and its share"), rows[:MOST_REGIONS], width)]
    if len(rows) > MOST_REGIONS:
        lines.append(f"and {len(rows) - MOST_REGIONS} more with a smaller gap")
    return "\n".join(lines)


def calibration_part(diagnosis: DiagnosisResult, width: int) -> str:
    """Return the parameters of the nominal model before and after calibration."""
    rows = calibration_rows(diagnosis)
    return table(("calibration", "nominal", "fitted ± std", "", "change"), rows, width, droppable=1) if rows else ""


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int, droppable: int | None = None) -> str:
    """Return rows under headings in aligned columns.

    If they are too wide, the column `droppable` is left out and last cells move to the next line. If that is still too
    wide, each row becomes its name and, below it, a list of headings and cells.
    """
    full_table = aligned(headings, rows)
    if widest(full_table) <= width:
        return full_table
    kept_columns = [column for column in range(len(headings)) if column != droppable]
    headings, rows = (
        [headings[column] for column in kept_columns],
        [[row[column] for column in kept_columns] for row in rows],
    )
    without_last = aligned([*headings[:-1], ""], [[*row[:-1], ""] for row in rows]).splitlines()
    last_cells = [headings[-1], *(row[-1] for row in rows)]
    last_column = max(map(len, without_last)) + 2
    if last_column + len(headings[-1]) <= width and max(map(len, last_cells)) + 4 <= width:
        same_line, next_line = "{0:{1}}{2}", "{0}\n    {2}"
        joined_lines = (
            (same_line if last_column + len(last_cell) <= width else next_line).format(line, last_column, last_cell)
            for line, last_cell in zip(without_last, last_cells, strict=True)
        )
        return "\n".join(line.rstrip() for line in joined_lines)
    lines = [headings[0]]
    for row in rows:
        pairs = [f"{heading} {cell}".strip() for heading, cell in zip(headings[1:], row[1:], strict=True) if cell]
        text = ", ".join(pair.replace(" ", NO_BREAK) if len(pair) < width - 8 else pair for pair in pairs)
        lines += [f"  {row[0]}", filled(text, width, 4).replace(NO_BREAK, " ")]
    return "\n".join(lines)


def widest(text: str) -> int:
    """Return the length of the longest line."""
    return max(map(len, text.splitlines()))


def filled(text: str, width: int, indent: int = 0) -> str:
    """Wrap a text to a width, with `indent` spaces before it; long words such as paths stay whole."""
    return textwrap.fill(
        text,
        width,
        initial_indent=" " * indent,
        subsequent_indent=" " * (indent + 2),
        break_long_words=False,
        break_on_hyphens=False,
    )
