"""Check a run's streams before they are used: shapes, lengths, units, and strictly increasing stamps."""

import math
from typing import Any

import h5py
import numpy as np

from leactl.quantities import accepted_units
from leactl.runfile import layout
from leactl.yamlfile import shown


def faults_of_streams(streams: Any, unfinished: bool) -> list[str]:
    """Return one line for each fault of the streams, with its HDF5 path.

    The columns of an unfinished file may differ in length.
    """
    faults = []
    for name, group in streams.items():
        hdf5_path = f"/streams/{name}"
        if not isinstance(group, h5py.Group):
            faults.append(f"{hdf5_path}: a dataset where a group was expected")
        elif not isinstance(group.get("time"), h5py.Dataset):
            faults.append(f"{hdf5_path}: has no time")
        else:
            shapes = faults_of_shape(hdf5_path, group)
            faults += shapes or faults_of_columns(hdf5_path, group, unfinished)
    return faults


def faults_of_shape(hdf5_path: str, group: Any) -> list[str]:
    """Return one line for each column that is not a one-dimensional dataset of numbers."""
    faults = []
    for name, column in group.items():
        if not isinstance(column, h5py.Dataset):
            faults.append(f"{hdf5_path}/{name}: a group where a channel was expected")
        elif column.ndim != 1 or column.dtype.kind not in "fiu":
            faults.append(
                f"{hdf5_path}/{name}: shape {column.shape} of {column.dtype}; expected one dimension of numbers"
            )
    return faults


def faults_of_columns(hdf5_path: str, group: Any, unfinished: bool) -> list[str]:
    """Return one line for each fault in lengths, units, numeric attributes and stamps of one stream."""
    faults = []
    for name, column in group.items():
        if name != "time":
            attributes = layout.attributes(column)
            faults += faults_of_units(f"{hdf5_path}/{name}", attributes)
            faults += faults_of_numbers(f"{hdf5_path}/{name}", attributes)
            if len(column) != len(group["time"]) and not unfinished:
                faults.append(f"{hdf5_path}/{name}: {len(column)} values for {len(group['time'])} stamps")
    if not unfinished:
        faults += faults_of_time(f"{hdf5_path}/time", group["time"])
    return faults


def faults_of_units(hdf5_path: str, attributes: dict[str, Any]) -> list[str]:
    """Return a line if the units are not those of the quantity; an unknown quantity may have any units."""
    expected = accepted_units(str(attributes.get("quantity", "")))
    if not expected or attributes.get("units") in expected:
        return []
    return [
        f"{hdf5_path}: {attributes['quantity']} has units {shown(attributes.get('units'))},"
        f" expected {' or '.join(expected)}"
    ]


def faults_of_numbers(hdf5_path: str, attributes: dict[str, Any]) -> list[str]:
    """Return a line for `skew` [s] if it is no finite number, and for `scale_std` if it is no number from 0 to 1."""
    faults = []
    for name, lowest, highest in (("skew", -math.inf, math.inf), ("scale_std", 0.0, 1.0)):
        value = attributes.get(name, 0.0)
        if not (isinstance(value, int | float) and math.isfinite(value) and lowest <= value <= highest):
            expected = "a finite number" if math.isinf(highest) else f"a number from {lowest:g} to {highest:g}"
            faults.append(f"{hdf5_path}: {name} is {shown(value)}; {expected} was expected")
    return faults


def faults_of_time(hdf5_path: str, time: Any) -> list[str]:
    """Return a line with the first row at which the stamps are not finite or do not increase, if there is one."""
    good_rows = increasing_rows(time, len(time))
    if good_rows == len(time):
        return []
    previous_text = f" after {time[good_rows - 1]!s}" if good_rows else ""
    return [f"{hdf5_path}[{good_rows}]: {time[good_rows]!s}{previous_text}; time must be finite and increase strictly"]


def increasing_rows(time: Any, rows: int) -> int:
    """Return the number of leading stamps, out of `rows`, that are finite and strictly increasing."""
    previous = -math.inf
    for start in range(0, rows, layout.BLOCK_ROWS):
        stamps = time[start : min(start + layout.BLOCK_ROWS, rows)]
        is_faulty = ~np.isfinite(stamps)
        is_faulty[1:] |= ~(stamps[1:] > stamps[:-1])
        is_faulty[0] |= ~(stamps[0] > previous)
        if is_faulty.any():
            return start + int(np.argmax(is_faulty))
        previous = stamps[-1]
    return rows


def whole_rows(group: Any) -> int:
    """Return the number of leading rows that all columns of a stream have and whose stamps increase.

    A recording whose writer was killed is cut to these rows.
    """
    shortest = min(len(column) for column in group.values())
    return increasing_rows(group["time"], shortest)


def uneven_tables(file: Any) -> list[str]:
    """Return one line for each table whose columns are missing or differ in length."""
    return [fault for name in layout.TABLES if name in file for fault in faults_of_table(file[name], name)]


def faults_of_table(group: Any, name: str) -> list[str]:
    """Return a line if columns of one table are missing or differ in length; empty otherwise."""
    lengths = {column: len(group[column]) if column in group else None for column in layout.TABLES[name]}
    return [f"/{name}: columns of different lengths: {lengths}"] if len(set(lengths.values())) > 1 else []
