"""Read SysId JSON of WPILib (2020 to 2023) and frc-characterization; each test is a `{joint}` and becomes a run.

A test is a list of rows: time [s], voltage [V], position and velocity. The file names the units of position and
velocity, but a person chose them, and they may be wrong: published files name Radians and contain turns.
"""

from pathlib import Path
from typing import Any, Final

from leactl.errors import InputError
from leactl.runfile.importing.mapping import PLACEHOLDER
from leactl.runfile.importing.sources.formats.json import json_tree
from leactl.runfile.importing.sources.source import ListedColumn, ListedTable, SourceRequest
from leactl.runfile.importing.sources.trees import TreeSource

ENDINGS = ()
TESTS: Final = ("slow-forward", "slow-backward", "fast-forward", "fast-backward")
TIME, VOLTAGE, POSITION, VELOCITY = "time_s", "voltage_V", "position", "velocity"
ROWS: Final = {  # columns of a row, by their number: a single mechanism or a drivetrain
    4: (TIME, VOLTAGE, POSITION, VELOCITY),
    9: (TIME, "left_voltage_V", "right_voltage_V", "left_position", "right_position", "left_velocity",
        "right_velocity", "chassis_angle", "chassis_velocity"),
}  # fmt: skip


class SysidSource(TreeSource):
    """Source over the tests of a SysId file."""

    def tables(self) -> list[ListedTable]:
        """Return one table for all tests, with the columns of the first."""
        tests = tuple(self._tree)
        columns = tuple(self._tree[tests[0]])
        listed = [ListedColumn(name) for name in columns if name != TIME]
        return [ListedTable(PLACEHOLDER, tuple(listed), "sysid", ListedColumn(TIME, "s", "SysId"), tests)]


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the first bytes of a `.json` file name a SysId test."""
    return path.suffix.lower() == ".json" and any(f'"{test}"'.encode() in head for test in TESTS)


def open_source(path: Path, request: SourceRequest) -> SysidSource:
    """Open a SysId file.

    Raises
    ------
    InputError : the file is not JSON or has no test, or rows have another length.
    """
    tree = json_tree(path)
    tests = {name: tree[name] for name in TESTS if isinstance(tree, dict) and tree.get(name)}
    if not tests:
        raise InputError(f"{path}: none of {', '.join(TESTS)} has a row")
    return SysidSource(path, {name: columns_of(path, name, rows) for name, rows in tests.items()})


def columns_of(path: Path, name: str, rows: Any) -> dict[str, list[Any]]:
    """Return a test's columns by name.

    Raises
    ------
    InputError : the test is not a list of rows of a known length.
    """
    lengths = {len(row) if isinstance(row, list) else 0 for row in rows} if isinstance(rows, list) else set()
    if len(lengths) != 1 or (width := lengths.pop()) not in ROWS:
        raise InputError(f"{path}: {name}: rows of {' or '.join(map(str, ROWS))} numbers were expected")
    return {column: [row[index] for row in rows] for index, column in enumerate(ROWS[width])}
