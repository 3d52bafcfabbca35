"""A diagnosis as text, in the order of the questions: what, how far the gap shrinks, where; then calibration, notes."""

import shutil
import sys
import textwrap
from collections.abc import Sequence

from leactl.gap.diagnosis import Cause, Diagnosis
from leactl.report.gap_words import (
    bare_units,
    change,
    closed_text,
    figure,
    floors,
    label,
    largest_first,
    listed,
    open_gap,
    parameter_text,
    probability,
    region_text,
    sentence,
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
    return "\n".join(said)


def cause_lines(cause: Cause, width: int) -> list[str]:
    """One cause with its parameters, its class and the experiment that separates it."""
    said = [f"{probability(cause.probability):>6}  {cause.effect}"]
    long = max((len(p.name) for p in cause.parameters), default=0)
    said += [f"          {p.name:{long}}  {parameter_text(p)}" for p in cause.parameters]
    if cause.indistinguishable_from:
        said.append(filled(f"cannot be told from {listed(cause.indistinguishable_from)}", width, 10))
    if cause.separating_experiment:
        said.append(filled(f"to separate: leactl run {cause.separating_experiment}", width, 10))
    return said


def how_far(answer: Diagnosis, width: int) -> str:
    """The channels that have a gap, before and after, and how many have none."""
    if not answer.shrinkage:
        return ""
    shown = largest_first(answer.shrinkage)
    rest = len(answer.shrinkage) - len(shown)
    tail = f"{rest} of {len(answer.shrinkage)} channels are within 1.1 times their floor: no gap to close"
    rows = [
        (
            label(item, answer.shrinkage),
            figure(item.nominal_rms),
            figure(item.calibrated_rms),
            figure(item.augmented_rms),
            figure(item.floor_rms),
            bare_units(item.units),
            closed_text(item),
        )
        for item in shown
    ]
    if not rows:
        return filled(tail, width)
    headings = ("gap (RMS)", "nominal", "before", "after", "floor", "", "closed (95 %)")
    about = "before: the calibrated model; after: with the effects; on held-out runs"
    return "\n".join([table(headings, rows, width, spare=1), filled(about, width), filled(tail, width)])


def where(answer: Diagnosis, width: int) -> str:
    """The largest gaps and their regions."""
    rows = [
        (label(item, answer.where), floors(item), region_text(item.region, item.share))
        for item in answer.where
        if open_gap(item)
    ]
    if not rows:
        return ""
    said = [table(("where", "over floor", "region and its share"), rows[:REGIONS], width)]
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
    """Columns where they fit, first without the one to spare; else each row's name has a line of its own."""
    whole = aligned(headings, rows)
    if widest(whole) <= width:
        return whole
    if spare is not None:
        keep = [k for k in range(len(headings)) if k != spare]
        without = aligned([headings[k] for k in keep], [[row[k] for k in keep] for row in rows])
        if widest(without) <= width:
            return without
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
