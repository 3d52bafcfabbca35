"""A diagnosis as text, in the order of the questions: what, how far the gap shrinks, where; then calibration, notes."""

import shutil
import sys
import textwrap
from collections.abc import Sequence

from leactl.gap.diagnosis import Cause, Diagnosis, Shrinkage
from leactl.report.gap_simulator import (
    EFFECTS,
    FLOORS,
    PARAMETERS,
    effect_rows,
    floor_rows,
    parameter_rows,
    summary,
)
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
from leactl.report.html import fit
from leactl.report.terminal import SMALLEST, aligned, encodable, encoding_of_stdout

WIDEST = 120  # characters; notes that run wider are hard to read
NO_BREAK = "\u00a0"  # a space at which no line ends
REGIONS = 5  # entries of the part that says where


def print_diagnosis(answer: Diagnosis) -> None:
    """Print the answer as wide as the terminal, 80 columns into a pipe."""
    width = shutil.get_terminal_size((80, 24)).columns
    sys.stdout.write(render(answer, width, encoding_of_stdout()))


def render(answer: Diagnosis, width: int = 80, encoding: str = "utf-8") -> str:
    """The whole answer, for a stream of this width and encoding."""
    width = min(max(width, SMALLEST), WIDEST)
    parts = [
        what(answer, width),
        simulator(answer, width),
        not_explained(answer, width),
        how_far(answer, width),
        where(answer, width),
        calibration(answer, width),
        "\n".join(filled(f"note: {note}", width) for note in answer.notes),
    ]
    return encodable(fit("\n\n".join(filter(None, parts))) + "\n", encoding)


def what(answer: Diagnosis, width: int) -> str:
    """The verdict and the causes."""
    chance = probability(answer.unexplained_probability)
    said = [
        filled(f"verdict: {answer.verdict}. {sentence(answer)}", width),
        filled(f"probability that something unexplained acts: {chance}", width),
    ]
    if answer.causes:
        said += ["", "causes"]
    for cause in answer.causes:
        said += cause_lines(cause, width)
    if closes_nothing(answer):
        said.append(filled(CLOSES_NOTHING, width))
    return "\n".join(said)


def simulator(answer: Diagnosis, width: int) -> str:
    """What a simulator that stands for the model contains, and what it leaves over; empty where none does."""
    nominal = answer.simulator
    if nominal is None:
        return ""
    said = [filled(sentence, width) for sentence in summary(nominal, claims(answer.causes))]
    tables = (
        (PARAMETERS, parameter_rows(nominal)),
        (EFFECTS, effect_rows(nominal)),
        (FLOORS, floor_rows(nominal)),
    )
    return "\n\n".join(["\n".join(said), *(table(headings, rows, width) for headings, rows in tables if rows)])


def not_explained(answer: Diagnosis, width: int) -> str:
    """What the rest depends on, what comes nearest, and what would decide."""
    rest = answer.unexplained
    if rest is None:
        return ""
    said = [filled(f"not explained: {rest_channel(rest)}", width), filled(rest_words(rest), width, 2)]
    said += [filled(f"over {variable_words(seen)}: {picture_words(seen)}", width, 2) for seen in rest.shapes]
    said += [filled(f"near: {refusal_words(near)}", width, 2) for near in rest.nearest]
    if rest.experiment:
        said.append(filled(f"to decide: leactl run {rest.experiment}", width, 2))
    return "\n".join(said)


def cause_lines(cause: Cause, width: int) -> list[str]:
    """One cause with its parameters, its class and the experiment that separates it."""
    said = [f"{probability(cause.probability):>6}  {cause.effect}"]
    long = max((len(p.name) for p in cause.parameters), default=0)
    said += [f"          {p.name:{long}}  {parameter_text(p)}" for p in cause.parameters]
    if cause.picture is not None:
        said.append(filled(f"over {variable_words(cause.picture)}: {picture_words(cause.picture)}", width, 10))
    if cause.indistinguishable_from:
        said.append(filled(f"cannot be told from {listed(cause.indistinguishable_from)}", width, 10))
    if cause.change:
        said.append(filled(f"to mend: {cause.change}", width, 10))
    if cause.separating_experiment:
        said.append(filled(f"to separate: leactl run {cause.separating_experiment}", width, 10))
    return said


def how_far(answer: Diagnosis, width: int) -> str:
    """The channels that have a gap, before and after, and how many have none."""
    if not answer.shrinkage:
        return ""
    shown = largest_first(answer.shrinkage)
    said: list[str] = []
    headings: tuple[str, ...]
    if shown and claims(answer.causes):
        headings = ("gap (RMS)", "nominal", "before", "after", "floor", "", "closed (95 %)")
        said.append(table(headings, [effect_row(item, answer.shrinkage) for item in shown], width, spare=1))
        said.append(filled("before: the calibrated model; after: with the effects; on held-out runs", width))
    else:
        shown = shown or closed_by_calibration(answer.shrinkage)[:REGIONS]
    if shown and not said:
        headings = ("gap (RMS)", "nominal", "calibrated", "floor", "", "over floor")
        said.append(table(headings, [calibration_row(item, answer.shrinkage) for item in shown], width))
    return "\n".join([*said, filled(counted(answer.shrinkage), width)])


def effect_row(item: Shrinkage, among: Sequence[Shrinkage]) -> list[str]:
    """A channel before and after the effects."""
    numbers = (item.nominal_rms, item.calibrated_rms, item.augmented_rms, item.floor_rms)
    return [label(item, among), *map(figure, numbers), bare_units(item.units), closed_text(item)]


def calibration_row(item: Shrinkage, among: Sequence[Shrinkage]) -> list[str]:
    """A channel before and after calibration, where no effect is added."""
    numbers = (item.nominal_rms, item.calibrated_rms, item.floor_rms)
    return [label(item, among), *map(figure, numbers), bare_units(item.units), floors(item)]


def where(answer: Diagnosis, width: int) -> str:
    """The largest gaps and their regions."""
    rows = [
        (
            label(item, answer.where),
            f"{figure(item.calibrated_rms)} {bare_units(item.units)}",
            region_text(item.region, item.share),
        )
        for item in answer.where
        if open_gap(item)
    ]
    if not rows:
        return ""
    said = [table(("where", "calibrated", "region and its share"), rows[:REGIONS], width)]
    if len(rows) > REGIONS:
        said.append(f"and {len(rows) - REGIONS} more with a smaller gap")
    return "\n".join(said)


def calibration(answer: Diagnosis, width: int) -> str:
    """Parameters of the nominal model, fitted again."""
    rows = [
        (item.parameter, f"{item.nominal:.6g}", with_std(item.fitted, item.std), bare_units(item.units), change(item))
        for item in answer.calibration
    ]
    return table(("calibration", "nominal", "fitted ± std", "", "change"), rows, width, spare=1) if rows else ""


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int, spare: int | None = None) -> str:
    """Columns where they fit, first without the one to spare, then with the last cell of long rows on the next line.

    Where that does not fit either, each row's name has a line of its own.
    """
    whole = aligned(headings, rows)
    if widest(whole) <= width:
        return whole
    keep = [k for k in range(len(headings)) if k != spare]
    headings, rows = [headings[k] for k in keep], [[row[k] for k in keep] for row in rows]
    short = aligned([*headings[:-1], ""], [[*row[:-1], ""] for row in rows]).splitlines()
    lasts = [headings[-1], *(row[-1] for row in rows)]
    start = max(map(len, short)) + 2
    if start + len(headings[-1]) <= width and max(map(len, lasts)) + 4 <= width:
        one, two = "{0:{1}}{2}", "{0}\n    {2}"
        joined = (
            (one if start + len(last) <= width else two).format(line, start, last)
            for line, last in zip(short, lasts, strict=True)
        )
        return "\n".join(line.rstrip() for line in joined)
    said = [headings[0]]
    for row in rows:
        pairs = [f"{heading} {cell}".strip() for heading, cell in zip(headings[1:], row[1:], strict=True) if cell]
        whole = ", ".join(pair.replace(" ", NO_BREAK) if len(pair) < width - 8 else pair for pair in pairs)
        said += [f"  {row[0]}", filled(whole, width, 4).replace(NO_BREAK, " ")]
    return "\n".join(said)


def widest(text: str) -> int:
    """Length of the longest line."""
    return max(map(len, text.splitlines()))


def filled(text: str, width: int, indent: int = 0) -> str:
    """Text on as many lines as it needs; long words such as paths stay whole."""
    first, later = " " * indent, " " * (indent + 2)
    return textwrap.fill(
        text, width, initial_indent=first, subsequent_indent=later, break_long_words=False, break_on_hyphens=False
    )
