"""Any table in any dialect is read back as it was written, or refused; never as another one."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.thermal_csv.emulator import FROM_CELSIUS, matrix, series

from leactl.errors import InputError
from leactl.tables.writing import TableDialect

from .camera import camera

ENCODINGS = [
    ("utf-8", False),
    ("utf-8", True),
    ("utf-16-le", True),
    ("utf-16-le", False),
    ("gbk", False),
    ("cp1252", False),
]
MARKS = st.sampled_from([(".", ""), (",", ""), (".", ","), (",", "."), (".", " "), (",", " "), (".", "'"), (",", "'")])
NAMES = st.lists(
    st.text("ABCabc äöéß;,|中_-0123456789", min_size=1, max_size=12)
    .map(str.strip)
    .filter(lambda n: any(map(str.isalpha, n))),
    min_size=1,
    max_size=4,
    unique=True,
)


@st.composite
def dialects(draw):
    encoding, mark = draw(st.sampled_from(ENCODINGS))
    decimal, thousands = draw(MARKS)
    return TableDialect(
        encoding=encoding,
        byte_order_mark=mark,
        delimiter=draw(st.sampled_from([",", ";", "\t", "|"])),
        decimal=decimal,
        thousands=thousands,
        decimals=draw(st.integers(0, 4)),
        missing=draw(st.sampled_from(["--", "", "NaN", "N/A"])),
        line_end=draw(st.sampled_from(["\r\n", "\n"])),
        sep_line=draw(st.booleans()),
        trailing=draw(st.booleans()),
    )


@st.composite
def tables(draw):
    names = draw(NAMES)
    rows = draw(st.integers(2, 6))
    cell = st.one_of(st.just(math.nan), st.floats(-40, 1500), st.sampled_from([1.234, 1234.0, 25.0, 0.5]))
    values = [draw(st.lists(cell, min_size=rows, max_size=rows)) for _ in names]
    for column in values:
        column[0] = 31.7  # a region that never saw anything is refused
    return names, np.array(values).T


def written(table, dialect, unit):
    names, values = table
    columns = {name: list(values[:, k]) for k, name in enumerate(names)}
    elapsed = TableDialect(decimal=dialect.decimal, decimals=1)
    stamps = [elapsed.number(0.1 * k) for k in range(len(values))]
    return series(stamps, columns, dialect, unit, time_heading="Time [s]")


def as_written(values, dialect, unit):
    """What a table says in its own decimals."""
    return np.vectorize(lambda value: float(f"{FROM_CELSIUS[unit](value):.{dialect.decimals}f}"))(values)


def read_back(path, table, unit, **told):
    regions = {f"r{k}": {"column": name, "quantity": "winding_temperature"} for k, name in enumerate(table[0])}
    record = camera(regions=regions, **told).read_files([path])
    return np.vectorize(FROM_CELSIUS[unit])(record.values)


@settings(max_examples=80)
@given(tables(), dialects(), st.sampled_from(["degC", "degF", "K"]))
def test_nothing_told_gives_the_same_values_or_a_refusal(tmp_path_factory, table, dialect, unit):
    try:
        raw = written(table, dialect, unit)
    except UnicodeEncodeError:
        return
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(raw)
    try:
        result = read_back(path, table, unit)
    except InputError as refused:
        assert all("any.csv" in fault and "\n" not in fault for fault in refused.faults)
    else:
        np.testing.assert_allclose(result, as_written(table[1], dialect, unit), atol=1e-9)


@settings(max_examples=50)
@given(tables(), dialects(), st.sampled_from(["degC", "degF", "K"]))
def test_everything_told_gives_the_same_values(tmp_path_factory, table, dialect, unit):
    try:
        raw = written(table, dialect, unit)
    except UnicodeEncodeError:
        return
    path = tmp_path_factory.getbasetemp() / "told.csv"
    path.write_bytes(raw)
    keys = {"encoding": dialect.encoding, "delimiter": dialect.delimiter, "decimal": dialect.decimal}
    result = read_back(path, table, unit, **keys, thousands=dialect.thousands)
    np.testing.assert_allclose(result, as_written(table[1], dialect, unit), atol=1e-9)


@settings(max_examples=30)
@given(dialects(), st.lists(st.floats(-40, 1500), min_size=12, max_size=12), st.integers(1, 3))
def test_frames_of_pixels_in_any_dialect(tmp_path_factory, dialect, pixels, frames):
    dialect = TableDialect(**(vars(dialect) | {"missing": "NaN"}))
    whole = [[[value + k for value in pixels[row * 4 : row * 4 + 4]] for row in range(3)] for k in range(frames)]
    raw = matrix(whole, [[f"Time = {k}.5"] for k in range(frames)], dialect)
    path = tmp_path_factory.getbasetemp() / "frames.csv"
    path.write_bytes(raw)
    region = {"hot": {"quantity": "winding_temperature", "rows": [0, 2], "columns": [0, 3], "statistic": "max"}}
    try:
        record = camera(regions=region, time={"line": "Time", "units": "s"}, unit="degC").read_files([path])
    except InputError as refused:
        assert all("frames.csv" in fault for fault in refused.faults)
    else:
        highest = as_written(max(pixels) + np.arange(frames), dialect, "degC")
        np.testing.assert_allclose(record.values[:, 0], highest, atol=1e-9)
