"""Figures of the paper's table that no experiment gives: from the motor file that runs carry, and said to be."""

from collections.abc import Sequence

from leactl import yamlfile
from leactl.errors import InputError
from leactl.model.motor_schema import MotorSheet
from leactl.report.datasheet.figures import plain, pretty
from leactl.report.datasheet.runset import RunSet
from leactl.report.html import Html, joined, table, tag
from leactl.report.motors import KnownFigure, Setting, cell, rows

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
    for text in dict.fromkeys(entry.model for own in sets for entry in own.entries if entry.motor == motor):
        try:
            found.append(yamlfile.parse(text).validate(MotorSheet))
        except InputError:
            continue
    return max(found, key=lambda sheet: len(sheet.model_fields_set), default=None)
