"""Exports of many cameras' programs are read right, or refused with the setting that helps; no damage is misread."""

import re
from pathlib import Path

import leactl_plugins.thermal_csv
import numpy as np
import pytest

from leactl.errors import InputError

from .camera import read
from .camera_exports import EXPORTS

PAGE = Path(leactl_plugins.thermal_csv.__file__).with_name("README.md")
every_export = pytest.mark.parametrize("export", EXPORTS, ids=lambda export: export.name)


@every_export
def test_an_export_is_read_right_with_its_settings(tmp_path, export):
    record = export.read(tmp_path)
    np.testing.assert_allclose(record.values, export.values, atol=1e-9)
    np.testing.assert_allclose(record.time, export.step_s * np.arange(len(export.values)), atol=1e-6)


@pytest.mark.parametrize(
    ("export", "setting"),
    [pytest.param(export, name, id=f"{export.name}-{name}") for export in EXPORTS for name in export.settings],
)
def test_without_a_setting_an_export_is_refused_by_its_name_or_read_right(tmp_path, export, setting):
    try:
        record = export.read(tmp_path, without=[setting])
    except InputError as refused:
        assert setting in str(refused)
    else:
        np.testing.assert_allclose(record.values, export.values[: len(record.values)], atol=1e-9)
        assert len(record.values) == len(export.values) or any(setting in remark for remark in record.remarks)


@every_export
def test_nothing_told_gives_the_same_values_or_a_refusal(tmp_path, export):
    try:
        record = export.read(tmp_path, without=[*export.settings])
    except InputError as refused:
        assert any(name in str(refused) for name in export.settings)
    else:
        np.testing.assert_allclose(record.values, export.values, atol=1e-9)


def test_the_page_lists_every_export_and_no_other():
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    table = rows[rows.index("| maker | program | layout | encoding | settings | source |") + 1 :]
    assert table == [export.row() for export in EXPORTS]
    assert len(EXPORTS) >= 15
    assert len({export.maker for export in EXPORTS}) >= 8


FRAME = "20.11;21.12;22.13\n23.14;24.15;25.16\n26.17;27.18;28.19\n"
CORNER = {"corner": {"quantity": "winding_temperature", "rows": [0, 0], "columns": [0, 0]}}


@pytest.mark.parametrize(
    ("text", "words", "settings", "value"),
    [
        ("2026-11-20;10:15\n" + FRAME, "2 or 3 cells.*skip_lines", {"skip_lines": 1}, 20.11),
        ("1;2;3\n" + FRAME, "line 1: counts its columns.*skip_lines", {"skip_lines": 1}, 20.11),
        (
            "Image 1;20.11;21.12\n;23.14;24.15\n;26.17;27.18\n",
            "line 1: a word and as many cells as a row has; index_column",
            {"index_column": True},
            20.11,
        ),
        (
            ";20.11;21.12\n;23.14;24.15\n",
            "the first cell of every row is empty; index_column",
            {"index_column": True},
            20.11,
        ),
        ("7;20.11\n8;23.14\n9;26.17\n", "the first cells count the rows; index_column", {"index_column": True}, 20.11),
        ("7;20.11\n8;23.14\n9;26.17\n", "the first cells count the rows; index_column", {"index_column": False}, 7.0),
        ("20,11,21,12\n23,14,24,15\n", "'20,11' is one number or two; decimal decides", {"decimal": ","}, 20.11),
        ("20,11,21,12\n23,14,24,15\n", "'20,11' is one number or two; decimal decides", {"decimal": "."}, 20.0),
    ],
)
def test_cells_that_may_be_no_pixels_are_refused_until_a_setting_says_what_they_are(
    tmp_path, text, words, settings, value
):
    given = {"regions": CORNER, "time": {"frame_rate_Hz": 1.0}, "unit": "degC"}
    with pytest.raises(InputError, match=words):
        read(tmp_path, text, **given)
    assert read(tmp_path, text, **given, **settings).values[0, 0] == value


AXES = {  # of four rows or columns
    "whole numbers as decimals": ("0.0", "1.0", "2.0", "3.0"),
    "every other pixel": ("0", "2", "4", "6"),
    "downwards": ("3", "2", "1", "0"),
    "mm": ("0.0", "0.5", "1.0", "1.5"),
    "mm, rounded": ("0.33", "0.67", "1.00", "1.33"),
    "about the middle": ("-1.5", "-0.5", "0.5", "1.5"),
}
SLOPE = [[f"{20 + row + 0.25 * column:.2f}" for column in range(4)] for row in range(4)]


def rows_of(*rows):
    return "".join(";".join(row) + "\n" for row in rows)


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
def test_an_axis_is_no_row_and_no_column_of_pixels(tmp_path, axis):
    given = {"regions": CORNER, "time": {"frame_rate_Hz": 1.0}, "unit": "degC", "delimiter": ";", "decimal": "."}
    beside = rows_of(*([place, *row] for place, row in zip(axis, SLOPE, strict=True)))
    with pytest.raises(InputError, match=r"line 1: the first cells rise or fall evenly.*; index_column says"):
        read(tmp_path, beside, **given)
    assert read(tmp_path, beside, **given, index_column=True).values[0, 0] == 20.0
    above = rows_of(axis, *SLOPE)
    with pytest.raises(InputError, match=r"line 1: rises or falls evenly.*; skip_lines"):
        read(tmp_path, above, **given)
    assert read(tmp_path, above, **given, skip_lines=1).values[0, 0] == 20.0
    assert read(tmp_path, above, **given, frame_size=[5, 4]).values[0, 0] == float(axis[0])
    both = rows_of(["", *axis], *([place, *row] for place, row in zip(axis, SLOPE, strict=True)))
    with pytest.raises(InputError, match="line 1: rises or falls evenly"):
        read(tmp_path, both, **given)


def test_pixels_that_rise_evenly_both_ways_are_pixels(tmp_path):
    given = {"regions": CORNER, "time": {"frame_rate_Hz": 1.0}, "unit": "degC", "delimiter": ";"}
    assert read(tmp_path, rows_of(*SLOPE), **given).values[0, 0] == 20.0


@pytest.mark.parametrize(
    ("text", "settings", "words"),
    [
        ("width;3\nheight;4\n" + FRAME, {}, "3 rows of 3 cells; 4 of 3 were expected"),
        ("3,4\n" + FRAME.replace(";", ","), {}, "2 or 3 cells"),
        (FRAME, {"frame_size": [4, 3]}, "3 rows of 3 cells; 4 of 3 were expected"),
        (FRAME + FRAME[:18], {"frame_size": [3, 3]}, "4 rows of 3 cells; 3 of 3 were expected"),
        ("0;20.11\n1;23.14\n3;26.17\n", {"index_column": True}, "line 3: '3' is not the next number of a row"),
        ("0.0;20.11\n0.5;23.14\n1.5;26.17\n", {"index_column": True}, "line 3: '1.5' is not the next number of a row"),
        ("1;20.11\n3;23.14\n", {"index_column": True}, "line 2: '3' is not the next number of a row"),
        ('"20.11;21.12\n23.14;24.15\n', {}, "line 1: unexpected end of data"),
    ],
)
def test_frames_that_lost_a_row_or_a_cell_are_refused(tmp_path, text, settings, words):
    given = {
        "regions": CORNER,
        "time": {"frame_rate_Hz": 1.0},
        "unit": "degC",
        "delimiter": "," if "," in text else ";",
    }
    with pytest.raises(InputError, match=words):
        read(tmp_path, text, **given, **settings)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FRAME, "nothing states the size of the frames.*frame_size does"),
        (FRAME.replace("20.11", "2011"), "'2011' may have lost its decimal mark"),
        (FRAME.replace("20.11", "2.0e3"), "'2.0e3' has an exponent"),
        (FRAME + "Data\n", "line 4: text below the last frame: 'Data'"),
        (
            "Time: 1\n" + FRAME + "Time: 2\nNote: x\n" + FRAME,
            "the lines above line 2 are not those of the other frames",
        ),
        (FRAME.replace(".", "9."), "no temperature is below 209.1 degC: are they in kelvin, or counts\\? unit decides"),
    ],
)
def test_what_may_be_wrong_with_frames_is_told(tmp_path, text, words):
    record = read(tmp_path, text, regions=CORNER, time={"frame_rate_Hz": 1.0}, unit="degC")
    assert re.search(words, "\n".join(record.remarks))


def test_a_stamp_above_frames_keeps_its_fraction_behind_a_comma_that_is_the_delimiter(tmp_path):
    text = "".join(f"Time = 10:15:30,{part}\n{FRAME.replace(';', ',')}" for part in ("25", "75"))
    record = read(tmp_path, text, regions=CORNER, time={"line": "Time"}, unit="degC", frame_size=[3, 3])
    np.testing.assert_allclose(record.time, [0.0, 0.5])


def test_a_quote_within_a_cell_of_a_series_is_told(tmp_path):
    text = 'Time (s),R1 Avg (°C),R2 Avg (°C)\n"0,0","25,3","26,1"\n"0,5","25,"26,2"\n'
    record = read(tmp_path, text, regions={"active_1": {"column": "R1 Avg", "quantity": "winding_temperature"}})
    assert any("line 3: a quote stands in a cell" in remark for remark in record.remarks)
