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
from leactl.report.html import Html, document, joined, table, tag, text
from leactl.report.motors import KnownFigure, Setting, cell, rows
from leactl.report.terminal import figures as paper
from leactl.report.terminal import interval_text, value_text

UNITS = {"_rad_s": "rad/s", "_Nm": "N*m", "_V": "V", "_A": "A", "_W": "W", "_1": "1"}  # of a name's end
NOT_HELD = "-"
BY_FILE = (
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
    compared = " and ".join(one.name for one in sheet.sets) if len(sheet.sets) > 1 else ""
    of = ", ".join(section.title for section in sheet.sections)
    title = f"Datasheet: {of}" + (f", {compared}" if compared else "")
    measured_by = [instruments_table(own, len(sheet.sets) > 1) for own in sheet.sets]
    body = tag(
        "main",
        tag("h1", title),
        *(facts(own, len(sheet.sets) > 1) for own in sheet.sets),
        tag("ul", *(tag("li", note) for note in sheet.notes)) if sheet.notes else Html(""),
        *(motor_section(sheet.sets, section, f"m{k}") for k, section in enumerate(sheet.sections)),
        tag("section", tag("h2", "Instruments"), *measured_by) if any(measured_by) else Html(""),
        tag("section", tag("h2", "Runs"), *(runs_table(own, out, len(sheet.sets) > 1) for own in sheet.sets)),
    )
    return document(title, STYLE, body)


def facts(own: RunSet, named: bool) -> Html:
    """Whose runs these are, and when they were made."""
    days = sorted(entry.about["created"][:10] for entry in own.entries if entry.about.get("created"))
    told = [
        ("runs", str(len(own.entries))),
        *((f"{key}s", ", ".join(values(own, key))) for key in ("actuator", "condition")),
        ("benches", ", ".join(values(own, "bench"))),
        ("recorded", " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""),
    ]
    parts = (part for key, what in told if what for part in (tag("dt", key), tag("dd", what)))
    return joined(([tag("p", tag("strong", own.name))] if named else []) + [tag("dl", *parts, class_="facts")])


def values(own: RunSet, key: str) -> list[str]:
    """What the runs say of themselves, each once."""
    return list(dict.fromkeys(found for entry in own.entries if (found := entry.about.get(key, ""))))


def motor_section(sets: Sequence[RunSet], section: Section, place: str) -> Html:
    """Table and figures of one motor."""
    about = (
        "Value ± standard uncertainty, and the 95 % interval. What these hold, and what they leave out, is in the notes"
        " of each experiment. The LEA in the paper as it is printed there."
    )
    if len(sets) > 1:
        about += " A difference is strong where its interval does not hold zero."
    parts = [tag("h2", section.title), tag("p", about, class_="about"), rows_table(sets, section, place)]
    parts.append(motor_table(sets, section.motors))
    if section.unlisted:
        parts.append(tag("p", f"Not measured besides: {', '.join(map(plain, section.unlisted))}.", class_="about"))
    for experiment in section.rows:
        answers = [
            one
            for own, motor in zip(sets, section.motors, strict=True)
            for one in own.answers
            if (one.motor, one.experiment) == (motor, experiment)
        ]
        if answers:
            parts.append(experiment_section(sets, section, experiment, answers, f"{place}-{experiment}"))
    return tag("section", *parts)


def experiment_section(
    sets: Sequence[RunSet], section: Section, experiment: str, answers: Sequence[GroupResult], place: str
) -> Html:
    """Method, what the conditions do, figures, every result, notes."""
    parts = [tag("h3", heading(experiment)), tag("p", method_of(experiment), class_="method about")]
    notes: list[str] = []
    for own, motor in zip(sets, section.motors, strict=True):
        if (verdict := own.verdicts.get((motor, experiment))) is not None:
            whose = f"{own.name}: " if len(sets) > 1 else ""
            tabled = {row.name for row in section.rows[experiment]}
            parts += sentences([one for one in verdict.found if one.name in tabled], whose, own.entries)
            notes += [f"{whose}not compared over conditions: {line}" for line in by_reason(verdict.refused)]
    parts.append(figures(sets, section.motors, experiment, links))
    parts.append(over_conditions(section.rows[experiment], sets))
    every = [entry for answer in answers for entry in answer.entries]
    for answer in answers:
        notes += [note for note in answer.result.notes if note not in notes]
    said = [tag("li", with_labels(note, every)) for note in notes]
    if said:
        parts.append(tag("details", tag("summary", "Notes"), tag("ul", *said)))
    parts.append(tag("details", tag("summary", "All results"), *map(results_table, answers)))
    parts += [map_of(grid, answer) for answer in answers for grid in answer.result.grids]
    return tag("section", *parts, id=place)


def sentences(found: Sequence[Comparison], whose: str, entries: Sequence[RunEntry]) -> list[Html]:
    """What the data support, and below it what that holds for and what is doubtful; a remark on all results once."""
    of: dict[str, list[str]] = {}
    for one in found:
        for note in one.notes:
            of.setdefault(with_labels(note, entries), []).append(plain(one.name))
    remarks = [note if len(named) == len(found) else f"{', '.join(named)}: {note}" for note, named in of.items()]
    said = [tag("p", f"{whose}{pretty(one.sentence.replace(one.name, plain(one.name)))}") for one in found]
    return said + ([tag("ul", *(tag("li", f"{whose}{pretty(one)}") for one in remarks), class_="about")] if of else [])


def with_labels(note: str, entries: Sequence[RunEntry]) -> str:
    """A note with the short names of runs in place of their paths."""
    for entry in sorted(entries, key=lambda one: -len(str(one.path))):
        note = note.replace(str(entry.path), entry.label)
    return note


def results_table(answer: GroupResult) -> Html:
    """Every result of one actuator under one condition."""
    known = paper(answer.experiment, answer.condition)
    cells = [
        [
            plain(item.name),
            value_text(item),
            interval_text(item),
            "" if item.units == "1" else pretty(item.units),
            known.get(item.name, ""),
        ]
        for item in answer.result.results
    ]
    of = ", ".join(filter(None, (answer.actuator, answer.condition))) or "unnamed"
    head = tag("p", tag("strong", of), ", from ", links(answer.entries))
    headings = ["result", "value ± std", "95 % interval", "units", "LEA in the paper"]
    return joined([head, table(headings, cells)])


def runs_table(own: RunSet, out: Path, named: bool) -> Html:
    """Every file with what came of it; its name leads to it."""
    cells = []
    for entry in own.entries:
        about = entry.about
        name = about.get("run_id") or entry.path.name
        by = ", ".join(filter(None, ("emulated" if entry.simulated else "", about.get("software", ""))))
        cells.append(
            [
                tag("span", entry.label, id=entry.label),
                in_lines(tag("a", name, href=address(entry.path, out)), plain(entry.experiment)),
                *(about.get(key, "") for key in ("actuator", "condition", "mechanical")),
                in_lines(about.get("bench", ""), by),
                in_lines(about.get("created", "").replace("T", " ")[:16], about.get("status", "")),
                tag("span", f"not analysed: {entry.fault}" if entry.fault else "analysed", class_="fault"),
            ]
        )
    headings = ["", "file", "actuator", "condition", "shaft", "bench", "recorded", "result"]
    return joined(([tag("h3", own.name)] if named else []) + [table(headings, cells, "runs")])


def instruments_table(own: RunSet, named: bool) -> Html:
    """Every instrument with its runs; empty where no run tells of any."""
    cells = []
    for one in instruments_of(own):
        known = one.known
        due = known.get("calibration_due", "")
        late = in_lines(tag("strong", due), joined([text("overdue in "), links(one.overdue)])) if one.overdue else due
        told = [known.get(name, "") for name in ("model", "serial", "firmware", "calibrated")]
        cells.append([one.device, *told, late, links(one.entries)])
    headings = ["device", "model", "serial number", "firmware", "calibrated", "due", "runs"]
    if not cells:
        return Html("")
    return joined(([tag("h3", own.name)] if named else []) + [table(headings, cells, "instruments")])


def address(path: Path, out: Path) -> str:
    """A link from the page to a file, relative where both can be moved together."""
    return quote(os.fsencode(os.path.relpath(path.resolve(), out.resolve().parent)))


def motor_table(sets: Sequence[RunSet], motors: Sequence[str]) -> Html:
    """A column for each motor whose file is known; empty where none is."""
    found = [sheet for motor in dict.fromkeys(motors) if (sheet := sheet_of(sets, motor)) is not None]
    if not found:
        return Html("")
    cells = [
        [plain(row.name), *map(cell, row.values), pretty(row.units)]
        for row in rows([KnownFigure(sheet, None, (), Setting()) for sheet in found])
        if row.name in BY_FILE and any(value is not None for value in row.values)
    ]
    head = tag("p", "By the motor file that the runs carry, not measured:", class_="about")
    return joined([head, table(["figure", *(sheet.name for sheet in found), "units"], cells)])


def sheet_of(sets: Sequence[RunSet], motor: str) -> MotorSheet | None:
    """The fullest motor file that runs of this motor carry; None where they carry none."""
    found = []
    for model in dict.fromkeys(entry.model for own in sets for entry in own.entries if entry.motor == motor):
        try:
            found.append(yamlfile.parse(model).validate(MotorSheet))
        except InputError:
            continue
    return max(found, key=lambda sheet: len(sheet.model_fields_set), default=None)


def map_of(grid: Grid, answer: GroupResult) -> Html:
    """One map by its first quantity, the axis with more setpoints downwards; the others are for `analyze --json`."""
    (quantity, rows), axes = next(iter(grid.values.items())), list(grid.axes.items())
    cells = np.array(rows)
    if len(axes[1][1]) > len(axes[0][1]):
        cells, axes = cells.T, axes[::-1]
    (down, setpoints), (across, others) = axes
    headings = [f"{with_unit(down)} \\ {with_unit(across)}", *(f"{one:.4g}" for one in others)]
    body = [[f"{one:.4g}", *map(map_cell, row)] for one, row in zip(setpoints, cells.tolist(), strict=True)]
    whose = ", ".join(filter(None, (plain(grid.name), answer.actuator, answer.condition)))
    title = tag("summary", f"Values at every setpoint: {whose}")
    said = tag("p", f"{with_unit(quantity).capitalize()} at {cells.size} setpoints, from ", links(answer.entries))
    return tag("details", title, said, table(headings, body, "map"))


def with_unit(name: str) -> str:
    """A quantity with its unit, from a name that ends in it."""
    end = next((one for one in UNITS if name.endswith(one)), "")
    return pretty(f"{plain(name.removesuffix(end))} [{UNITS[end]}]") if end else plain(name)


def map_cell(value: float) -> str:
    """Three digits; a dash where the bench did not hold the setpoint."""
    if not math.isfinite(value):
        return NOT_HELD
    return f"{value + 0.0:#.3g}".rstrip(".")  # no negative zero
