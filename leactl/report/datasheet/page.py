"""A datasheet as one HTML file: table, figures, runs. The page loads nothing, so that it can be mailed and printed.

The same runs at the same paths give the same page to the byte.
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from leactl import yamlfile
from leactl.analysis.analyze import method_of
from leactl.analysis.anova.comparison import Comparison
from leactl.analysis.estimate import Grid
from leactl.errors import InputError
from leactl.model.motor_schema import MotorSheet
from leactl.report.conditions import merged_by_reason
from leactl.report.datasheet.figures import figures, heading, over_conditions, plain, pretty
from leactl.report.datasheet.instruments import InstrumentUse, instruments_of
from leactl.report.datasheet.runset import GroupResult, RunEntry, RunSet
from leactl.report.datasheet.sheet import Datasheet, Section
from leactl.report.datasheet.table import columns, groups
from leactl.report.html import render
from leactl.report.motor_comparison import ComparedMotor, OperatingConditions, cell, figure_rows
from leactl.report.terminal import interval_text, value_text
from leactl.report.terminal import paper_figures as paper

UNIT_OF_SUFFIX = {"_rad_s": "rad/s", "_Nm": "N*m", "_V": "V", "_A": "A", "_W": "W", "_1": "1"}  # of names in maps
UNHELD_CELL = "-"  # of a setpoint that the bench did not hold
MOTOR_FILE_FIGURES = (  # that the table of motor files shows
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
    """Return the datasheet as an HTML page; its links to runs are relative to the file `out`."""
    set_names = " and ".join(run_set.name for run_set in sheet.sets) if len(sheet.sets) > 1 else ""
    motors = ", ".join(section.title for section in sheet.sections)
    title = f"Datasheet: {motors}" + (f", {set_names}" if set_names else "")
    return render(
        "datasheet.html",
        title=title,
        several=len(sheet.sets) > 1,
        sets=[
            {"name": run_set.name, "facts": facts(run_set), "runs": [run_row(entry, out) for entry in run_set.entries]}
            for run_set in sheet.sets
        ],
        notes=sheet.notes,
        columns=columns(sheet.sets),
        sections=[section_content(sheet.sets, section, f"m{k}") for k, section in enumerate(sheet.sections)],
        instruments=[
            (run_set.name, [instrument_row(use) for use in uses])
            for run_set in sheet.sets
            if (uses := instruments_of(run_set))
        ],
    )


def facts(run_set: RunSet) -> list[tuple[str, str]]:
    """Return names and values of facts on a set: number of runs, actuators, conditions, benches, days of recording."""
    days = sorted(entry.about["created"][:10] for entry in run_set.entries if entry.about.get("created"))
    rows = [
        ("runs", str(len(run_set.entries))),
        *((f"{key}s", ", ".join(distinct_values(run_set, key))) for key in ("actuator", "condition")),
        ("benches", ", ".join(distinct_values(run_set, "bench"))),
        ("recorded", " to ".join(dict.fromkeys([days[0], days[-1]])) if days else ""),
    ]
    return [(key, value) for key, value in rows if value]


def distinct_values(run_set: RunSet, key: str) -> list[str]:
    """Return the distinct values of an attribute of the runs, such as `actuator`, without empty ones."""
    return list(dict.fromkeys(value for entry in run_set.entries if (value := entry.about.get(key, ""))))


def section_content(sets: Sequence[RunSet], section: Section, anchor: str) -> dict[str, Any]:
    """Return the table and the experiments of one motor, or of two that are compared.

    Parameters
    ----------
    anchor : first part of the ids that links inside the page go to.
    """
    experiments = []
    for experiment in section.rows:
        results = [
            group
            for run_set, motor in zip(sets, section.motors, strict=True)
            for group in run_set.results_of(motor, experiment)
        ]
        if results:
            experiments.append(experiment_content(sets, section, experiment, results, f"{anchor}-{experiment}"))
    return {
        "title": section.title,
        "groups": groups(sets, section, anchor),
        "motor_files": motor_file_table(sets, section.motors),
        "unlisted": ", ".join(map(plain, section.unlisted)),
        "experiments": experiments,
    }


def experiment_content(
    sets: Sequence[RunSet], section: Section, experiment: str, results: Sequence[GroupResult], anchor: str
) -> dict[str, Any]:
    """Return method, comparison of conditions, figures, notes and all results of one experiment."""
    comparisons = []
    notes: list[str] = []
    for run_set, motor in zip(sets, section.motors, strict=True):
        if (verdict := run_set.verdicts.get((motor, experiment))) is not None:
            prefix = f"{run_set.name}: " if len(sets) > 1 else ""
            names_in_table = {row.name for row in section.rows[experiment]}
            shown_comparisons = [comparison for comparison in verdict.comparisons if comparison.name in names_in_table]
            comparisons.append(comparison_content(shown_comparisons, prefix, run_set.entries))
            notes += [f"{prefix}not compared over conditions: {line}" for line in merged_by_reason(verdict.refused)]
    entries = [entry for group in results for entry in group.entries]
    for group in results:
        notes += [note for note in group.result.notes if note not in notes]
    return {
        "anchor": anchor,
        "title": heading(experiment),
        "method": method_of(experiment),
        "comparisons": comparisons,
        "figures": figures(sets, section.motors, experiment),
        "over_conditions": over_conditions(section.rows[experiment], sets),
        "notes": [with_labels(note, entries) for note in notes],
        "results": [results_table(group) for group in results],
        "maps": [map_table(grid, group) for group in results for grid in group.result.grids],
    }


def comparison_content(
    comparisons: Sequence[Comparison], prefix: str, entries: Sequence[RunEntry]
) -> dict[str, list[str]]:
    """Return a sentence for each compared result, and the remarks; a remark on all results is written once.

    Parameters
    ----------
    prefix : text before each sentence and remark, which names the set of runs where there are two.
    """
    results_of_note: dict[str, list[str]] = {}
    for comparison in comparisons:
        for note in comparison.notes:
            results_of_note.setdefault(with_labels(note, entries), []).append(plain(comparison.name))
    remarks = [
        note if len(result_names) == len(comparisons) else f"{', '.join(result_names)}: {note}"
        for note, result_names in results_of_note.items()
    ]
    sentences = [comparison.sentence.replace(comparison.name, plain(comparison.name)) for comparison in comparisons]
    return {
        "sentences": [f"{prefix}{pretty(sentence)}" for sentence in sentences],
        "remarks": [f"{prefix}{pretty(remark)}" for remark in remarks],
    }


def with_labels(note: str, entries: Sequence[RunEntry]) -> str:
    """Return a note with the labels of runs in place of their paths."""
    for entry in sorted(entries, key=lambda entry: -len(str(entry.path))):
        note = note.replace(str(entry.path), entry.label)
    return note


def results_table(group_result: GroupResult) -> dict[str, Any]:
    """Return every result of one actuator under one condition, with the paper's values."""
    paper_values = paper(group_result.experiment, group_result.condition)
    rows = [
        [
            plain(estimate.name),
            value_text(estimate),
            interval_text(estimate),
            "" if estimate.units == "1" else pretty(estimate.units),
            paper_values.get(estimate.name, ""),
        ]
        for estimate in group_result.result.results
    ]
    group = ", ".join(filter(None, (group_result.actuator, group_result.condition))) or "unnamed"
    return {"group": group, "entries": group_result.entries, "rows": rows}


def run_row(entry: RunEntry, out: Path) -> dict[str, Any]:
    """Return the row of a run file: link, facts, and why it was not analysed; a list has lines below each other."""
    about = entry.about
    recorder = ", ".join(filter(None, ("emulated" if entry.simulated else "", about.get("software", ""))))
    return {
        "label": entry.label,
        "name": about.get("run_id") or entry.path.name,
        "target": link_target(entry.path, out),
        "experiment": plain(entry.experiment),
        "facts": [about.get(key, "") for key in ("actuator", "condition", "mechanical")],
        "bench": [about.get("bench", ""), recorder],
        "recorded": [about.get("created", "").replace("T", " ")[:16], about.get("status", "")],
        "fault": entry.fault,
    }


def instrument_row(use: InstrumentUse) -> dict[str, Any]:
    """Return the row of an instrument: its facts, its runs, and the runs after its calibration was due."""
    return {
        "device": use.device,
        "facts": [use.known_facts.get(name, "") for name in ("model", "serial", "firmware", "calibrated")],
        "due": use.known_facts.get("calibration_due", ""),
        "overdue": use.overdue,
        "entries": use.entries,
    }


def link_target(path: Path, out: Path) -> str:
    """Return the URL of a file relative to the page `out`, so that both can be moved together."""
    return quote(os.fsencode(os.path.relpath(path.resolve(), out.resolve().parent)))


def motor_file_table(sets: Sequence[RunSet], motors: Sequence[str]) -> dict[str, Any] | None:
    """Return a table of motor-file figures, a column for each motor; None if no run carries a motor file."""
    sheets = [sheet for motor in dict.fromkeys(motors) if (sheet := fullest_motor_file(sets, motor)) is not None]
    if not sheets:
        return None
    rows = [
        [plain(row.name), *map(cell, row.values), pretty(row.units)]
        for row in figure_rows([ComparedMotor(sheet, None, (), OperatingConditions()) for sheet in sheets])
        if row.name in MOTOR_FILE_FIGURES and any(value is not None for value in row.values)
    ]
    return {"motors": [sheet.name for sheet in sheets], "rows": rows}


def fullest_motor_file(sets: Sequence[RunSet], motor: str) -> MotorSheet | None:
    """Return, of the motor files that runs of this motor carry, the one with most keys; None if no run carries one."""
    sheets = []
    for model in dict.fromkeys(entry.model for run_set in sets for entry in run_set.entries if entry.motor == motor):
        try:
            sheets.append(yamlfile.parse(model).validate(MotorSheet))
        except InputError:
            continue
    return max(sheets, key=lambda sheet: len(sheet.model_fields_set), default=None)


def map_table(grid: Grid, group_result: GroupResult) -> dict[str, Any]:
    """Return the table of the first quantity of a map over its two axes; the axis with more setpoints goes down."""
    (quantity, values_by_row), axes = next(iter(grid.values.items())), list(grid.axes.items())
    cells = np.array(values_by_row)
    if len(axes[1][1]) > len(axes[0][1]):
        cells, axes = cells.T, axes[::-1]
    (down, down_setpoints), (across, across_setpoints) = axes
    headings = [f"{with_unit(down)} \\ {with_unit(across)}", *(f"{setpoint:.4g}" for setpoint in across_setpoints)]
    rows = [
        [f"{setpoint:.4g}", *map(map_cell, row)] for setpoint, row in zip(down_setpoints, cells.tolist(), strict=True)
    ]
    title = ", ".join(filter(None, (plain(grid.name), group_result.actuator, group_result.condition)))
    return {
        "whose": title,
        "quantity": with_unit(quantity).capitalize(),
        "setpoints": cells.size,
        "entries": group_result.entries,
        "headings": headings,
        "rows": rows,
    }


def with_unit(name: str) -> str:
    """Return a quantity with the unit that the suffix of its name gives: `speed_rad_s` as `speed [rad/s]`."""
    suffix = next((ending for ending in UNIT_OF_SUFFIX if name.endswith(ending)), "")
    return pretty(f"{plain(name.removesuffix(suffix))} [{UNIT_OF_SUFFIX[suffix]}]") if suffix else plain(name)


def map_cell(value: float) -> str:
    """Return a value with three significant digits; UNHELD_CELL for NaN, where the bench did not hold the setpoint."""
    if not math.isfinite(value):
        return UNHELD_CELL
    return f"{value + 0.0:#.3g}".rstrip(".")  # no negative zero
