"""What every stream of a run must keep to before anybody computes with it."""

import math
from typing import Any

import h5py
import numpy as np

from leactl.quantities import accepted_units
from leactl.runfile import layout
from leactl.yamlfile import shown


def faults_of_streams(streams: Any, unfinished: bool) -> list[str]:
    """Faults of all streams, each with its place; columns of an unfinished file may end at different rows."""
    faults = []
    for name, group in streams.items():
        place = f"/streams/{name}"
        if not isinstance(group, h5py.Group):
            faults.append(f"{place}: a dataset where a group was expected")
        elif not isinstance(group.get("time"), h5py.Dataset):
            faults.append(f"{place}: has no time")
        else:
            shapes = faults_of_shape(place, group)
            faults += shapes or faults_of_columns(place, group, unfinished)
    return faults


def faults_of_shape(place: str, group: Any) -> list[str]:
    """Columns that are not one row of numbers."""
    faults = []
    for name, column in group.items():
        if not isinstance(column, h5py.Dataset):
            faults.append(f"{place}/{name}: a group where a channel was expected")
        elif column.ndim != 1 or column.dtype.kind not in "fiu":
            faults.append(f"{place}/{name}: shape {column.shape} of {column.dtype}; expected one dimension of numbers")
    return faults


def faults_of_columns(place: str, group: Any, unfinished: bool) -> list[str]:
    """Lengths, units and stamps of one stream."""
    faults = []
    for name, column in group.items():
        if name != "time":
            attributes = layout.attributes(column)
            faults += faults_of_units(f"{place}/{name}", attributes)
            faults += faults_of_numbers(f"{place}/{name}", attributes)
            if len(column) != len(group["time"]) and not unfinished:
                faults.append(f"{place}/{name}: {len(column)} values for {len(group['time'])} stamps")
    if not unfinished:
        faults += faults_of_time(f"{place}/time", group["time"])
    return faults


def faults_of_units(place: str, found: dict[str, Any]) -> list[str]:
    """Units that are not those of the quantity; a quantity outside the vocabulary may have any."""
    expected = accepted_units(str(found.get("quantity", "")))
    if not expected or found.get("units") in expected:
        return []
    return [f"{place}: {found['quantity']} has units {shown(found.get('units'))}, expected {' or '.join(expected)}"]


def faults_of_numbers(place: str, found: dict[str, Any]) -> list[str]:
    """Attributes that are to be numbers and are none: a skew [s], or a share that is not from 0 to 1."""
    faults = []
    for name, least, most in (("skew", -math.inf, math.inf), ("scale_std", 0.0, 1.0)):
        value = found.get(name, 0.0)
        if not (isinstance(value, int | float) and math.isfinite(value) and least <= value <= most):
            expected = "a finite number" if math.isinf(most) else f"a number from {least:g} to {most:g}"
            faults.append(f"{place}: {name} is {shown(value)}; {expected} was expected")
    return faults


def faults_of_time(place: str, time: Any) -> list[str]:
    """Whether the stamps are finite and increase strictly, with the row where they first do not."""
    good = increasing_rows(time, len(time))
    if good == len(time):
        return []
    before = f" after {time[good - 1]!s}" if good else ""
    return [f"{place}[{good}]: {time[good]!s}{before}; time must be finite and increase strictly"]


def increasing_rows(time: Any, rows: int) -> int:
    """How many of so many stamps from the start are finite and increase strictly; read block by block."""
    before = -math.inf
    for start in range(0, rows, layout.BLOCK_ROWS):
        stamps = time[start : min(start + layout.BLOCK_ROWS, rows)]
        wrong = ~np.isfinite(stamps)
        wrong[1:] |= ~(stamps[1:] > stamps[:-1])
        wrong[0] |= ~(stamps[0] > before)
        if wrong.any():
            return start + int(np.argmax(wrong))
        before = stamps[-1]
    return rows


def whole_rows(group: Any) -> int:
    """Rows that every column has and that have a stamp: where a file left by a kill is cut."""
    shortest = min(len(column) for column in group.values())
    return increasing_rows(group["time"], shortest)


def uneven_tables(file: Any) -> list[str]:
    """Tables whose columns are missing or of different lengths."""
    return [fault for name in layout.TABLES if name in file for fault in faults_of_table(file[name], name)]


def faults_of_table(group: Any, name: str) -> list[str]:
    """Whether the columns of one table are all there and of one length."""
    lengths = {column: len(group[column]) if column in group else None for column in layout.TABLES[name]}
    return [f"/{name}: columns of different lengths: {lengths}"] if len(set(lengths.values())) > 1 else []
