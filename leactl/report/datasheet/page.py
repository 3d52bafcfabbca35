"""A datasheet as one HTML file: table, figures, runs; nothing is loaded from anywhere, so it can be mailed and printed.

The same runs in the same places give the same page to the byte.
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import numpy as np

from leactl import yamlfile
from leactl.analysis.analyze import method_of
from leactl.analysis.anova.comparison import Comparison
from leactl.analysis.estimate import Grid
from leactl.errors import InputError
from leactl.model.motor_schema import MotorSheet
from leactl.report.conditions import by_reason
from leactl.report.datasheet.figures import figures, heading, over_conditions, plain, pretty
from leactl.report.datasheet.instruments import instruments_of
from leactl.report.datasheet.runset import GroupResult, RunEntry, RunSet
from leactl.report.datasheet.sheet import Datasheet, Section
from leactl.report.datasheet.style import STYLE
from leactl.report.datasheet.table import in_lines, links, rows_table
from leactl.report.html import Html, document, escaped, joined, table, tag
from leactl.report.motors import ComparedMotor, OperatingConditions, cell, figure_rows
from leactl.report.terminal import interval_text, value_text
from leactl.report.terminal import paper_figures as paper

UNIT_OF_SUFFIX = {"_rad_s": "rad/s", "_Nm": "N*m", "_V": "V", "_A": "A", "_W": "W", "_1": "1"}  # of a name's end
UNHELD_CELL = "-"
MOTOR_FILE_FIGURES = (
    "winding",
    "pole_pairs",
    "mass",
    "outer_diameter",
    "inner_diameter",
    "length",
    "encoder_lines",
    "rotor_inertia",
    "line_to_line_inductance",
)


def page(sheet: Datasheet, out: Path) -> str:
    """The whole datasheet for a file at `out`, from where links to runs begin."""
    compared = " and ".join(run_set.name for run_set in sheet.sets) if len(sheet.sets) > 1 else ""
    motors = ", ".join(section.title for section in sheet.sections)
    title = f"Datasheet: {motors}" + (f", {compared}" if compared else "")
    measured_by = [instruments_table(run_set, len(sheet.sets) > 1) for run_set in sheet.sets]
    body = tag(
        "main",
        tag("h1", title),
        *(run_set_facts(run_set, len(sheet.sets) > 1) for run_set in sheet.sets),
        tag("ul", *(tag("li", note) for note in sheet.notes)) if sheet.notes else Html(""),
        *(motor_section(sheet.sets, section, f"m{k}") for k, section in enumerate(sheet.sections)),
        tag("section", tag("h2", "Instruments"), *measured_by) if any(measured_by) else Html(""),
        tag("section", tag("h2", "Runs"), *(runs_table(run_set, out, len(sheet.sets) > 1) for run_set in sheet.sets)),
    )
    return document(title, STYLE, body)


def run_set_facts(run_set: RunSet, named: bool) -> Html:
    """Whose runs these are, and when they were made."""
    days = sorted(entry.about["created"][:10] for entry in run_set.entries if entry.about.get("created"))
    rows = [
        ("runs", str(len(run_set.entries))),
        *((f"{key}s", ", ".join(distinct_values(run_set, key))) for key in ("actuator", "condition")),
        ("benches", ", ".join(distinct_values(run_set, "bench"))),
        ("recorded", " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""),
    ]
    parts = (part for key, value in rows if value for part in (tag("dt", key), tag("dd", value)))
    return joined(([tag("p", tag("strong", run_set.name))] if named else []) + [tag("dl", *parts, class_="facts")])


def distinct_values(run_set: RunSet, key: str) -> list[str]:
    """What the runs say of themselves, each once."""
    return list(dict.fromkeys(value for entry in run_set.entries if (value := entry.about.get(key, ""))))


def motor_section(sets: Sequence[RunSet], section: Section, anchor: str) -> Html:
    """Table and figures of one motor."""
    about = (
        "Value ± standard uncertainty, and the 95 % interval. What these hold, and what they leave out, is in the notes"
        " of each experiment. The LEA in the paper as it is printed there."
    )
    if len(sets) > 1:
        about += " A difference is strong where its interval does not hold zero."
    parts = [tag("h2", section.title), tag("p", about, class_="about"), rows_table(sets, section, anchor)]
    parts.append(motor_file_table(sets, section.motors))
    if section.unlisted:
        parts.append(tag("p", f"Not measured besides: {', '.join(map(plain, section.unlisted))}.", class_="about"))
    for experiment in section.rows:
        answers = [
            answer
            for run_set, motor in zip(sets, section.motors, strict=True)
            for answer in run_set.answers_of(motor, experiment)
        ]
        if answers:
            parts.append(experiment_section(sets, section, experiment, answers, f"{anchor}-{experiment}"))
    return tag("section", *parts)


def experiment_section(
    sets: Sequence[RunSet], section: Section, experiment: str, answers: Sequence[GroupResult], anchor: str
) -> Html:
    """Method, what the conditions do, figures, every result, notes."""
    parts = [tag("h3", heading(experiment)), tag("p", method_of(experiment), class_="method about")]
    notes: list[str] = []
    for run_set, motor in zip(sets, section.motors, strict=True):
        if (verdict := run_set.verdicts.get((motor, experiment))) is not None:
            whose = f"{run_set.name}: " if len(sets) > 1 else ""
            tabled = {row.name for row in section.rows[experiment]}
            parts += comparison_paragraphs(
                [comparison for comparison in verdict.comparisons if comparison.name in tabled], whose, run_set.entries
            )
            notes += [f"{whose}not compared over conditions: {line}" for line in by_reason(verdict.refused)]
    parts.append(figures(sets, section.motors, experiment, links))
    parts.append(over_conditions(section.rows[experiment], sets))
    entries = [entry for answer in answers for entry in answer.entries]
    for answer in answers:
        notes += [note for note in answer.result.notes if note not in notes]
    note_items = [tag("li", with_labels(note, entries)) for note in notes]
    if note_items:
        parts.append(tag("details", tag("summary", "Notes"), tag("ul", *note_items)))
    parts.append(tag("details", tag("summary", "All results"), *map(results_table, answers)))
    parts += [map_table(grid, answer) for answer in answers for grid in answer.result.grids]
    return tag("section", *parts, id=anchor)


def comparison_paragraphs(comparisons: Sequence[Comparison], whose: str, entries: Sequence[RunEntry]) -> list[Html]:
    """What the data support, and below it what that holds for and what is doubtful; a remark on all results once."""
    results_of_note: dict[str, list[str]] = {}
    for comparison in comparisons:
        for note in comparison.notes:
            results_of_note.setdefault(with_labels(note, entries), []).append(plain(comparison.name))
    remarks = [
        note if len(named) == len(comparisons) else f"{', '.join(named)}: {note}"
        for note, named in results_of_note.items()
    ]
    paragraphs = [
        tag("p", f"{whose}{pretty(comparison.sentence.replace(comparison.name, plain(comparison.name)))}")
        for comparison in comparisons
    ]
    if not remarks:
        return paragraphs
    return [*paragraphs, tag("ul", *(tag("li", f"{whose}{pretty(remark)}") for remark in remarks), class_="about")]


def with_labels(note: str, entries: Sequence[RunEntry]) -> str:
    """A note with the short names of runs in place of their paths."""
    for entry in sorted(entries, key=lambda entry: -len(str(entry.path))):
        note = note.replace(str(entry.path), entry.label)
    return note


def results_table(answer: GroupResult) -> Html:
    """Every result of one actuator under one condition."""
    paper_values = paper(answer.experiment, answer.condition)
    cells = [
        [
            plain(estimate.name),
            value_text(estimate),
            interval_text(estimate),
            "" if estimate.units == "1" else pretty(estimate.units),
            paper_values.get(estimate.name, ""),
        ]
        for estimate in answer.result.results
    ]
    group = ", ".join(filter(None, (answer.actuator, answer.condition))) or "unnamed"
    head = tag("p", tag("strong", group), ", from ", links(answer.entries))
    headings = ["result", "value ± std", "95 % interval", "units", "LEA in the paper"]
    return joined([head, table(headings, cells)])


def runs_table(run_set: RunSet, out: Path, named: bool) -> Html:
    """Every file with what came of it; its name leads to it."""
    cells = []
    for entry in run_set.entries:
        about = entry.about
        name = about.get("run_id") or entry.path.name
        by = ", ".join(filter(None, ("emulated" if entry.simulated else "", about.get("software", ""))))
        cells.append(
            [
                tag("span", entry.label, id=entry.label),
                in_lines(tag("a", name, href=link_target(entry.path, out)), plain(entry.experiment)),
                *(about.get(key, "") for key in ("actuator", "condition", "mechanical")),
                in_lines(about.get("bench", ""), by),
                in_lines(about.get("created", "").replace("T", " ")[:16], about.get("status", "")),
                tag("span", f"not analysed: {entry.fault}" if entry.fault else "analysed", class_="fault"),
            ]
        )
    headings = ["", "file", "actuator", "condition", "shaft", "bench", "recorded", "result"]
    return joined(([tag("h3", run_set.name)] if named else []) + [table(headings, cells, "runs")])


def instruments_table(run_set: RunSet, named: bool) -> Html:
    """Every instrument with its runs; empty where no run tells of any."""
    cells = []
    for use in instruments_of(run_set):
        known = use.known
        due = known.get("calibration_due", "")
        late = (
            in_lines(tag("strong", due), joined([escaped("overdue in "), links(use.overdue)])) if use.overdue else due
        )
        identity = [known.get(name, "") for name in ("model", "serial", "firmware", "calibrated")]
        cells.append([use.device, *identity, late, links(use.entries)])
    headings = ["device", "model", "serial number", "firmware", "calibrated", "due", "runs"]
    if not cells:
        return Html("")
    return joined(([tag("h3", run_set.name)] if named else []) + [table(headings, cells, "instruments")])


def link_target(path: Path, out: Path) -> str:
    """A link from the page to a file, relative where both can be moved together."""
    return quote(os.fsencode(os.path.relpath(path.resolve(), out.resolve().parent)))


def motor_file_table(sets: Sequence[RunSet], motors: Sequence[str]) -> Html:
    """A column for each motor whose file is known; empty where none is."""
    sheets = [sheet for motor in dict.fromkeys(motors) if (sheet := fullest_motor_file(sets, motor)) is not None]
    if not sheets:
        return Html("")
    cells = [
        [plain(row.name), *map(cell, row.values), pretty(row.units)]
        for row in figure_rows([ComparedMotor(sheet, None, (), OperatingConditions()) for sheet in sheets])
        if row.name in MOTOR_FILE_FIGURES and any(value is not None for value in row.values)
    ]
    head = tag("p", "By the motor file that the runs carry, not measured:", class_="about")
    return joined([head, table(["figure", *(sheet.name for sheet in sheets), "units"], cells)])


def fullest_motor_file(sets: Sequence[RunSet], motor: str) -> MotorSheet | None:
    """The fullest motor file that runs of this motor carry; None where they carry none."""
    sheets = []
    for model in dict.fromkeys(entry.model for run_set in sets for entry in run_set.entries if entry.motor == motor):
        try:
            sheets.append(yamlfile.parse(model).validate(MotorSheet))
        except InputError:
            continue
    return max(sheets, key=lambda sheet: len(sheet.model_fields_set), default=None)


def map_table(grid: Grid, answer: GroupResult) -> Html:
    """One map by its first quantity, the axis with more setpoints downwards; the others are for `analyze --json`."""
    (quantity, values_by_row), axes = next(iter(grid.values.items())), list(grid.axes.items())
    cells = np.array(values_by_row)
    if len(axes[1][1]) > len(axes[0][1]):
        cells, axes = cells.T, axes[::-1]
    (down, down_setpoints), (across, across_setpoints) = axes
    headings = [f"{with_unit(down)} \\ {with_unit(across)}", *(f"{setpoint:.4g}" for setpoint in across_setpoints)]
    body = [
        [f"{setpoint:.4g}", *map(map_cell, row)] for setpoint, row in zip(down_setpoints, cells.tolist(), strict=True)
    ]
    whose = ", ".join(filter(None, (plain(grid.name), answer.actuator, answer.condition)))
    title = tag("summary", f"Values at every setpoint: {whose}")
    intro = tag("p", f"{with_unit(quantity).capitalize()} at {cells.size} setpoints, from ", links(answer.entries))
    return tag("details", title, intro, table(headings, body, "map"))


def with_unit(name: str) -> str:
    """A quantity with its unit, from a name that ends in it."""
    suffix = next((ending for ending in UNIT_OF_SUFFIX if name.endswith(ending)), "")
    return pretty(f"{plain(name.removesuffix(suffix))} [{UNIT_OF_SUFFIX[suffix]}]") if suffix else plain(name)


def map_cell(value: float) -> str:
    """Three digits; a dash where the bench did not hold the setpoint."""
    if not math.isfinite(value):
        return UNHELD_CELL
    return f"{value + 0.0:#.3g}".rstrip(".")  # no negative zero
