"""The camera's driver over exports whose bytes stand here: what is found, told, and refused by which key."""

import re
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.thermal_csv.settings import ThermalCsvSettings
from pydantic import ValidationError

from leactl.errors import InputError

from .camera import REGIONS, camera, read

PLAIN = """Emissivity: 0.95
Time (s),R1 Avg (°C),R2 Avg (°C)
0.000,25.31,24.90
0.033,25.40,24.91
0.067,25.52,24.93
"""
ROWS = np.array([[25.31, 24.90], [25.40, 24.91], [25.52, 24.93]])


def told(record):
    return "\n".join(record.remarks)


def test_a_plain_export_is_read_and_told(tmp_path):
    record = read(tmp_path, PLAIN)
    np.testing.assert_array_equal(record.values, ROWS)
    np.testing.assert_allclose(record.time, [0.0, 0.033, 0.067])
    assert [spec.location for spec in record.channels] == ["active_1", "housing_1"]
    assert [spec.quantity for spec in record.channels] == ["winding_temperature", "housing_temperature"]
    for words in ("utf-8", "',' between cells", "headings in line 2", "degC", "elapsed time in s", "emissivity 0.95"):
        assert words in told(record)


@pytest.mark.parametrize(
    "raw",
    [
        b"\xef\xbb\xbf" + PLAIN.encode(),
        b"\xff\xfe" + PLAIN.encode("utf-16-le"),
        PLAIN.encode("utf-16-le"),
        b"\xfe\xff" + PLAIN.encode("utf-16-be"),
        PLAIN.replace("\n", "\r\n").encode(),
        PLAIN.replace("°C", "degC").encode("ascii"),
        ("sep=,\n" + PLAIN).encode(),
        PLAIN.replace(",", ";").replace(".", ",").replace("0,95", "0.95").encode(),
        PLAIN.replace(",", "\t").encode(),
        PLAIN.replace("\n", ",,\n").encode(),
        PLAIN.replace("\n0", "\n\n0").encode(),
        PLAIN.replace("25.31,24.90", '"25.31" ,24.90').encode(),
    ],
    ids=[
        "bom",
        "utf16",
        "utf16 no mark",
        "utf16 be",
        "crlf",
        "ascii",
        "sep",
        "comma",
        "tab",
        "trailing",
        "blank",
        "quoted",
    ],
)
def test_the_same_table_in_other_clothes_gives_the_same_values(tmp_path, raw):
    np.testing.assert_array_equal(read(tmp_path, raw).values, ROWS)


def test_what_is_not_utf8_is_shown_in_both_readings_and_the_setting_decides(tmp_path):
    raw = PLAIN.encode("cp1252")
    with pytest.raises(InputError, match=r"cp1252 or .* in gbk; encoding decides") as refused:
        read(tmp_path, raw)
    assert "°C" in str(refused.value)
    np.testing.assert_array_equal(read(tmp_path, raw, encoding="cp1252").values, ROWS)


def test_chinese_headings_in_gbk(tmp_path):
    raw = "时间(s),区域1 平均(℃),区域2 平均(℃)\n0,25.31,24.90\n1,25.40,24.91\n".encode("gbk")
    regions = {
        "a": {"column": "区域1 平均", "quantity": "winding_temperature"},
        "b": {"column": "区域2 平均", "quantity": "housing_temperature"},
    }
    record = read(tmp_path, raw, regions=regions, time={"column": "时间"}, encoding="gbk")
    np.testing.assert_array_equal(record.values, ROWS[:2])


@pytest.mark.parametrize(
    ("unit", "cells", "expected"),
    [("°F", "77.0,212.0", [25.0, 100.0]), ("K", "298.15,373.15", [25.0, 100.0]), ("degC", "25,100", [25.0, 100.0])],
)
def test_units_by_the_heading(tmp_path, unit, cells, expected):
    record = read(tmp_path, f"Time (s),R1 Avg ({unit}),R2 Avg ({unit})\n0,{cells}\n1,{cells}\n")
    np.testing.assert_allclose(record.values[0], expected)


def test_units_in_cells_and_above(tmp_path):
    in_cells = "Time (s),R1 Avg,R2 Avg\n0,77.0 °F,212.0 °F\n1,77.0 °F,--\n"
    np.testing.assert_allclose(read(tmp_path, in_cells).values[0], [25.0, 100.0])
    above = "Unit: K\nTime (s),R1 Avg,R2 Avg\n0,298.15,373.15\n1,298.15,373.15\n"
    np.testing.assert_allclose(read(tmp_path, above).values[0], [25.0, 100.0])


@pytest.mark.parametrize(
    ("text", "given", "words"),
    [
        ("Time (s),R1 Avg,R2 Avg\n0,25,26\n", {}, "unit decides"),
        ("Time (s),R1 Avg (K),R2 Avg (°F)\n0,25,26\n", {}, "several temperature units"),
        (
            "Time (s),R1 Avg (K),R2 Avg (K)\n0,25,26\n",
            {"unit": "degC"},
            "K by heading 'R1 Avg .K.', degC by the setting",
        ),
        (
            "Time (s);R1 Avg (K);R2 Avg (K)\n0;1,234;1,500\n",
            {},
            "'1,234' may be (1234 or 1.234|1.234 or 1234); decimal decides",
        ),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n0,5 V,6\n", {}, "'V' behind a number is no temperature unit"),
        ("Time,R1 Avg (K),R2 Avg (K)\n0,5,6\n", {}, "time.kind and time.units decide"),
        (
            "Time,R1 Avg (K),R2 Avg (K)\n01/02/2026 10:00:00,5,6\n",
            {},
            "2026-02-01.*2026-01-02.*time.date_order decides",
        ),
        ("Time,R1 Avg (K),R2 Avg (K)\n010:15:30:33,5,6\n", {}, "time.colons decides"),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n0,hot,6\n", {}, "line 2, column 'R1 Avg .K.': 'hot' is not a number"),
        (
            "Time (s);R1 Avg (K);R2 Avg (K)\n0;1.234,5;6\n1;1,234.5;6\n",
            {},
            "no combination of decimal and thousands mark reads every",
        ),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n0,5,6\n1,5\n2,5,6\n", {}, "line 3: 2 cells where 3 were expected"),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n0,5,6,7\n1,5,6\n", {}, "4 cells where 3 .*decimal comma"),
        ("Time (s),R1 Avg (K),Other\n0,5,6\n", {}, "no line has the headings 'R2 Avg'; the file has 'Time .s.'"),
        ("Time (s),R1 Avg (K),R1 Avg (K),R2 Avg (K)\n0,5,5,6\n", {}, "'R1 Avg' stands over 2 columns"),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n", {}, "no row below the headings"),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n0,--,6\n1,--,7\n", {}, "no number at all in active_1"),
        ("", {}, "empty"),
        (" \n\n", {}, "nothing but blanks"),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n0,5,6\n1,\x005,7\n", {}, "line 3: NUL in the text; damaged"),
        (b"\xff\xfeT\x00i\x00", {}, "no line has the headings"),
        (b"\xff\xfeT\x00i\x00m", {}, "not utf-16-le at byte 6"),
        ("Time (s),R1 Avg (K),R2 Avg (K)\n0,5,6\n", {"encoding": "utf-16"}, "not utf-16|no line has"),
    ],
)
def test_what_has_two_readings_or_none_is_refused_in_one_line(tmp_path, text, given, words):
    with pytest.raises(InputError, match=words) as refused:
        read(tmp_path, text, **given)
    assert all("\n" not in fault and "export.csv" in fault for fault in refused.value.faults)


def test_the_named_keys_do_decide(tmp_path):
    text = "Time;R1 Avg;R2 Avg\n01/02/2026 10:00:00;1,234;1,500\n01/02/2026 10:00:01;1,235;1,501\n"
    time = {"column": "Time", "date_order": "dmy", "zone": "+00:00"}
    record = read(tmp_path, text, time=time, unit="degC", decimal=".")
    np.testing.assert_array_equal(record.values[0], [1234.0, 1500.0])
    assert record.began == datetime(2026, 2, 1, 10, tzinfo=UTC).timestamp()
    record = read(tmp_path, text, time=time | {"date_order": "mdy"}, unit="degC", decimal=",")
    np.testing.assert_array_equal(record.values[0], [1.234, 1.5])
    assert record.began == datetime(2026, 1, 2, 10, tzinfo=UTC).timestamp()


def test_one_cell_with_one_reading_settles_the_others(tmp_path):
    text = "Time (s);R1 Avg (K);R2 Avg (K)\n0;1,234;300\n1;1,23;301\n"
    np.testing.assert_allclose(read(tmp_path, text).values[0, 0] + 273.15, 1.234)
    beyond = "Time (s);R1 Avg (°C);R2 Avg (°C)\n0;25,312;24,901\n1;25,313;24,902\n"  # 25312 degC is no temperature
    np.testing.assert_allclose(read(tmp_path, beyond).values[0], [25.312, 24.901])


def test_marks_of_range_and_of_nothing_become_nan_and_are_counted(tmp_path):
    head = "Time (s),R1 Avg (°C),R2 Avg (°C)\n"
    record = read(tmp_path, head + "0,>550,25\n1,<-20,\n2,--,NaN\n3,> 550,25\n4,26,25\n")
    assert np.isnan(record.values[:4, 0]).all()
    assert record.values[4, 0] == 26.0
    assert "R1 Avg (°C): 1 missing, >550 1 times, <-20 1 times, > 550 1 times: NaN" in told(record)
    assert "R2 Avg (°C): 2 missing: NaN" in told(record)


MAX = {"a": {"column": "Max", "quantity": "winding_temperature"}}


@pytest.mark.parametrize(
    ("cell", "unit", "words"),
    [
        ("-300.0", "degC", "line 3, column 'Max': -300 degC is not above absolute zero; unit says.*, missing which"),
        ("-273.15", "degC", "line 3, column 'Max': -273.15 degC is not above"),
        ("-5.1", "K", "line 3, column 'Max': -5.1 K is not above"),
        ("0.00", "K", "line 3, column 'Max': 0 K is not above"),
        ("-459.7", "degF", "line 3, column 'Max': -459.7 degF is not above"),
    ],
)
def test_a_temperature_that_cannot_be_is_refused_after_its_unit(tmp_path, cell, unit, words):
    given = {"regions": MAX, "time": {"column": "Time"}, "unit": unit}
    text = f"Time (s),Max\n0,298.1\n1,{cell}\n2,298.3\n"
    with pytest.raises(InputError, match=words):
        read(tmp_path, text, **given)
    assert np.isnan(read(tmp_path, text, **given, missing=[cell]).values[1, 0])
    pixels = {"regions": {"a": {"quantity": "winding_temperature", "rows": [0, 1], "columns": [0, 1]}}, "unit": unit}
    with pytest.raises(InputError, match=r"region a: .* is not above absolute zero"):
        read(tmp_path, f"298.1;298.4\n{cell};298.3\n", **pixels, time={"frame_rate_Hz": 10.0})


@pytest.mark.parametrize(
    ("cells", "unit", "words"),
    [
        (("25.1", "3276.7"), "degC", "line 3, column 'Max': 3277 degC, and 0 more above 200 degC: .* missing decides"),
        (("298.1", "873.15"), "K", "line 3, column 'Max': 600 degC, and 0 more above 200 degC"),
        (
            ("2981", "2982"),
            "K",
            "no temperature is below 2708 degC: are they in another unit, or counts",
        ),
    ],
)
def test_a_temperature_that_no_actuator_has_is_told_after_its_unit(tmp_path, cells, unit, words):
    given = {"regions": MAX, "time": {"column": "Time"}, "unit": unit}
    record = read(tmp_path, f"Time (s),Max\n0,{cells[0]}\n1,{cells[1]}\n", **given)
    assert re.search(words, told(record))


def stamped(*stamps, values=None):
    values = values or range(len(stamps))
    return "Time,R1 Avg (°C),R2 Avg (°C)\n" + "".join(
        f"{stamp},{25 + value},26\n" for stamp, value in zip(stamps, values, strict=True)
    )


@pytest.mark.parametrize(
    ("stamps", "given", "times", "began"),
    [
        (
            ("2026-11-20 10:15:30.100", "2026-11-20 10:15:30.200"),
            {"zone": "Asia/Shanghai"},
            [0, 0.1],
            "2026-11-20T02:15:30.1+00:00",
        ),
        (("2026-11-20T10:15:30+01:00", "2026-11-20T10:15:31+01:00"), {}, [0, 1], "2026-11-20T09:15:30+00:00"),
        (("2026/11/20 10:15:30", "2026/11/20 10:15:31"), {}, [0, 1], None),
        (
            ("20.11.2026 10:15:30,5", "20.11.2026 10:15:31,5"),
            {"zone": "Europe/Berlin"},
            [0, 1],
            "2026-11-20T09:15:30.5+00:00",
        ),
        (
            ("2026年11月20日 下午 1:15:30", "2026年11月20日 下午 1:15:31"),
            {"zone": "+08:00"},
            [0, 1],
            "2026-11-20T05:15:30+00:00",
        ),
        (("11/20/2026 11:59:59 PM", "11/21/2026 12:00:00 AM"), {"zone": "+00:00"}, [0, 1], "2026-11-20T23:59:59+00:00"),
        (
            ("23:59:59.5", "00:00:00.5"),
            {"kind": "wall", "date": "2026-11-20", "zone": "+00:00"},
            [0, 1],
            "2026-11-20T23:59:59.5+00:00",
        ),
        (("00:00:01.5", "00:00:02.5"), {}, [0, 1], None),
        (("59:59.5", "60:00.5"), {"kind": "elapsed"}, [0, 1], None),
        (("25:00:00", "25:00:01"), {}, [0, 1], None),
        (("59:59", "1:00:00"), {}, [0, 1], None),
        (("10:15", "10:16"), {"colons": "hours_minutes"}, [0, 60], None),
        (("10:15", "10:16"), {"colons": "minutes_seconds"}, [0, 1], None),
        (("2026-11-20 10:15", "2026-11-20 10:16"), {"zone": "+00:00"}, [0, 60], "2026-11-20T10:15:00+00:00"),
        (
            ("324:10:15:30.5", "324:10:15:31.5"),
            {"kind": "wall", "year": 2026, "zone": "+00:00"},
            [0, 1],
            "2026-11-20T10:15:30.5+00:00",
        ),
        (("10:15:30:500", "10:15:30:600"), {"colons": "fraction_last"}, [0, 0.1], None),
        (("17", "18", "20"), {"kind": "frame", "frame_rate_Hz": 10.0}, [0, 0.1, 0.3], None),
        (("500", "600"), {"units": "ms"}, [0, 0.1], None),
    ],
)
def test_clocks_of_every_kind(tmp_path, stamps, given, times, began):
    text = stamped(*stamps).replace(",5,2", ".5,2")
    record = read(tmp_path, text, time={"column": "Time"} | given)
    np.testing.assert_allclose(record.time, times, atol=1e-6)
    expected = None if began is None else datetime.fromisoformat(began).timestamp()
    assert record.began == (expected if expected is None else pytest.approx(expected, abs=1e-3))


@pytest.mark.parametrize(
    ("stamps", "given", "words"),
    [
        (("10:00:02", "10:00:01"), {}, "line 3.*goes back by 1 s.*time.backward: leave_out"),
        (("12:59:59", "01:00:00"), {}, "a 12-hour clock without AM/PM"),
        (("2026-10-25 01:59:59", "2026-10-25 03:00:01"), {"zone": "Europe/Berlin"}, "clocks of Europe/Berlin change"),
        (("2026-11-20 10:00:00", "10:00:01"), {}, "some have none"),
        (("13:00:00 PM", "13:00:01 PM"), {}, "hour 13 with PM"),
        (("10:00:00", "10:61:00"), {}, "10:61:0 is no time"),
        (("30.02.2026 10:00:00",), {}, "30/2/2026 is no date"),
        (("10:15", "10:16"), {}, "10:15 is hours and minutes or minutes and seconds; time.colons decides"),
        (("10:15", "10:16"), {"kind": "elapsed"}, "time.colons decides"),
        (("15:30.5", "15:31.0"), {"kind": "wall"}, "15:30 is minutes and seconds, which tell no time of day"),
        (("2026-11-20 15:30.5", "2026-11-20 15:31.0"), {}, "15:30 is minutes and seconds, which tell no time of day"),
        (("10:16", "10:75"), {"colons": "hours_minutes"}, "10:75 is no time"),
        (("2026-11-20T10:15:30+99:99",), {}, r"zone '\+99:99' is not known"),
        (("23:59:59.8", "00:00:00.0", "23:59:59.9", "00:00:00.1"), {"kind": "wall"}, "line 4.*goes back by 0.1 s"),
        (("0", "33 ms", "66 ms"), {"units": "s"}, "elapsed time in ms; time.units says s"),
        (("0", "33 ms", "1 s"), {}, "line 2, column 'Time' holds numbers in ms and s"),
        (("17", "18"), {"kind": "frame"}, "time.frame_rate_Hz is needed"),
        (("17", "18.5"), {"kind": "frame", "frame_rate_Hz": 10.0}, "18.5 is no frame number"),
        (("17", "nan", "18.5"), {"kind": "frame", "frame_rate_Hz": 10.0}, "18.5 is no frame number"),
        (("noon", "midnight"), {}, "'noon' is no date and time"),
        (("17", "18"), {"kind": "wall"}, "a plain number; time.kind says wall"),
        (("10:00:00", ""), {}, "line 3.*'' is no date and time"),
        ((*"0123456789", "9"), {"units": "s"}, "line 12.*stands twice, over different values"),
    ],
)
def test_stamps_that_cannot_be_are_refused_with_their_line(tmp_path, stamps, given, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, stamped(*stamps), time={"column": "Time"} | given)


def test_frames_missing_doubled_frozen_and_gone_back_are_told(tmp_path):
    rows = [(0.0, 1), (0.1, 2), (0.2, 3), (0.2, 3), (0.3, 4), (0.9, 5), (1.0, 5), (0.95, 9), (1.1, 6)]
    text = stamped(*(f"{t:.2f}" for t, _ in rows), values=[v for _, v in rows])
    record = read(tmp_path, text, time={"column": "Time", "units": "s", "backward": "leave_out"})
    np.testing.assert_allclose(record.time, [0, 0.1, 0.2, 0.3, 0.9, 1.0, 1.1])
    assert "1 rows whose stamps go back" in told(record)
    assert "line 9" in told(record)
    assert "1 rows doubled" in told(record)
    assert "1 gaps, about 5 frames missing, the longest 0.6 s, 0.3 s after the first row" in told(record)
    assert "1 rows repeat the one before in every column" in told(record)


def test_a_row_after_one_that_is_left_out_is_told_with_its_own_line(tmp_path):
    text = stamped("0.00", "0.10", "0.05", "0.20", "0.20", values=[1, 2, 9, 3, 4])
    with pytest.raises(InputError, match=r"line 6.*stands twice, over different values"):
        read(tmp_path, text, time={"column": "Time", "units": "s", "backward": "leave_out"})


def test_stamps_coarser_than_frames_are_placed_by_counting_or_refused(tmp_path):
    frames = np.arange(90) / 30 + 10.4
    stamps = [f"10:00:{int(t):02d}" for t in frames]
    with pytest.raises(InputError, match=r"time\.frame_rate_Hz places them"):
        read(tmp_path, stamped(*stamps))
    record = read(tmp_path, stamped(*stamps), time={"column": "Time", "frame_rate_Hz": 30.0})
    assert np.abs(record.time - (frames - frames[0])).max() < 0.06
    assert "share a stamp" in told(record)
    holed = [*stamps[:15], *stamps[60:]]
    with pytest.raises(InputError, match=r"frames are missing|rows a second"):
        read(tmp_path, stamped(*holed), time={"column": "Time", "frame_rate_Hz": 30.0})


def test_a_last_row_cut_short_is_left_out_and_told(tmp_path):
    record = read(tmp_path, PLAIN + "0.100,25.5")
    assert len(record.time) == 3
    assert "the last row, line 6, ends after 2 of 3 cells: left out" in told(record)


def test_a_last_row_without_an_end_may_be_cut_within_its_number(tmp_path):
    record = read(tmp_path, PLAIN + "0.100,25.60,2")
    assert len(record.time) == 3
    assert "the last row, line 6, has no end and may be cut: left out" in told(record)


def test_blocks_and_a_changed_emissivity_are_told(tmp_path):
    head = PLAIN.split("\n")[1]
    again = f"\nEmissivity: 0.80\n{head}\n0.100,25.60,24.95\n"
    record = read(tmp_path, PLAIN + again)
    assert len(record.time) == 4
    assert "2 blocks under the same headings" in told(record)
    assert "emissivity 0.95 CHANGES; from line 7 on it is 0.80" in told(record)
    column = "Time (s),R1 Avg (°C),R2 Avg (°C),Emissivity\n0,25,26,0.95\n1,25,27,0.95\n2,25,28,0.9\n"
    assert "Emissivity 0.95 CHANGES; from line 4 on it is 0.9" in told(read(tmp_path, column))


def test_an_export_in_parts_goes_on_from_file_to_file(tmp_path):
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    first.write_text(stamped("2026-11-20 23:59:58", "2026-11-20 23:59:59"), encoding="utf-8")
    second.write_text(stamped("2026-11-21 00:00:00", "2026-11-21 00:00:01"), encoding="utf-8")
    time = {"column": "Time", "zone": "+00:00"}
    record = camera(time=time).read_files([first, second])
    np.testing.assert_allclose(record.time, [0, 1, 2, 3])
    with pytest.raises(InputError, match=re.escape("a.csv: line 2")):
        camera(time=time).read_files([second, first])


def test_parts_that_tell_their_day_are_on_one_clock_without_a_zone(tmp_path):
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    first.write_text(stamped("2026-11-20 10:00:00", "2026-11-20 10:00:01"), encoding="utf-8")
    second.write_text(stamped("2026-11-21 12:00:00"), encoding="utf-8")
    record = camera(time={"column": "Time"}).read_files([first, second])
    np.testing.assert_allclose(record.time, [0, 1, 93600])
    assert record.began is None


def test_parts_of_one_count_of_frames_go_on_from_file_to_file(tmp_path):
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    first.write_text(stamped("7", "8"), encoding="utf-8")
    second.write_text(stamped("9", "11"), encoding="utf-8")
    time = {"column": "Time", "kind": "frame", "frame_rate_Hz": 10.0}
    np.testing.assert_allclose(camera(time=time).read_files([first, second]).time, [0, 0.1, 0.2, 0.4])


@pytest.mark.parametrize(
    ("lines", "times"),
    [
        (["1,5", ",", "2,6", ",", ",", "3,7", ",", ","], [0, 2, 5]),  # those at the end are Excel's
        (["1,5", "", "2,6"], [0, 1]),  # no row at all
        (["1,5", ",", "R1 Avg (K),R2 Avg (K)", "2,6"], [0, 1]),  # between two blocks
    ],
)
def test_a_row_of_empty_cells_keeps_its_place_where_rows_are_the_clock(tmp_path, lines, times):
    text = "\n".join(["R1 Avg (K),R2 Avg (K)", *lines, ""])
    record = read(tmp_path, text, time={"frame_rate_Hz": 1.0})
    np.testing.assert_allclose(record.time[np.isfinite(record.values).all(axis=1)], times)
    assert np.isnan(record.values).all(axis=1).sum() == max(times) + 1 - len(times)


def test_a_stamp_with_its_half_of_the_day_before_it_is_no_remark(tmp_path):
    text = "Time,R1 Avg (K)\nAM 11:59:59,5\nPM 12:00:00,6\nPM 12:00:01,\n"
    region = {"active_1": REGIONS["active_1"]}
    record = read(tmp_path, text, regions=region)
    np.testing.assert_allclose(record.time, [0, 1, 2])
    np.testing.assert_allclose(record.values[:, 0] + 273.15, [5, 6, np.nan])


def test_a_quote_that_does_not_end_in_its_line_is_refused(tmp_path):
    rows = [f"{k},5,6,x" for k in range(8)]
    rows[2] = '2,5,6,"x'
    with pytest.raises(InputError, match=r"line 4: a quote opens a cell that does not end in its line"):
        read(tmp_path, "\n".join(["Time (s),R1 Avg (K),R2 Avg (K),Spot", *rows, ""]))


@pytest.mark.parametrize("raw", [b"\xef\xbb\xbf", b"\xff\xfe", b"\xef\xbb\xbf\r\n"])
@pytest.mark.parametrize(
    "regions", [REGIONS, {"a": {"quantity": "winding_temperature", "rows": [0, 0], "columns": [0, 0]}}]
)
def test_a_byte_order_mark_alone_is_no_file(tmp_path, raw, regions):
    path = tmp_path / "mark.csv"
    path.write_bytes(raw)
    with pytest.raises(InputError, match="holds nothing but"):
        camera(regions=regions, time={"column": "Time", "frame_rate_Hz": 1.0}).read_files([path])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"time": {}}, "time.column or time.frame_rate_Hz is needed"),
        ({"time": {"column": "T", "zone": "Mars/Olympus"}}, "zone 'Mars/Olympus' is not known"),
        ({"time": {"column": "T", "date": "2026-02-30"}}, "day"),
        ({"regions": {"a": {"quantity": "winding_temperature"}}}, "give either column, or rows and columns"),
        ({"regions": {"a": {"quantity": "torque", "column": "x"}}}, "quantity"),
        ({"decimal": ",", "thousands": ","}, "decimal ',' is the thousands mark"),
        ({"skip_lines": 1}, "skip_lines, index_column and frame_size are of frames"),
        ({"colour": "red"}, "colour"),
        ({"clock": {"offset_s": 1.0}}, "offset_s and offset_within_s go together"),
        ({"clock": {}}, "give one of wall_within_s"),
        (
            {"clock": {"wall_within_s": 1.0, "offset_s": 1.0, "offset_within_s": 1.0}},
            "wall_within_s and offset_s is given",
        ),
    ],
)
def test_wrong_keys_of_the_map_are_refused(settings, words):
    given = {"regions": REGIONS, "time": {"column": "Time"}} | settings
    with pytest.raises(ValidationError, match=words):
        ThermalCsvSettings(**given)


FRAME = "25.0;26.0;27.0\n35.0;36.0;37.0\n"
PIXELS = {
    "hot": {"quantity": "winding_temperature", "rows": [1, 1], "columns": [0, 2], "statistic": "max"},
    "all": {"quantity": "housing_temperature", "rows": [0, 1], "columns": [0, 2]},
}


def test_frames_of_pixels_under_lines_that_tell_their_time(tmp_path):
    text = f"Unit = degC\nTime = 324:10:15:30.500000\n{FRAME}\nTime = 324:10:15:30.600000\n{FRAME.replace('7', '9')}"
    time = {"line": "Time", "kind": "wall", "year": 2026, "zone": "+00:00"}
    record = read(tmp_path, text, regions=PIXELS, time=time)
    np.testing.assert_allclose(record.values, [[37.0, 31.0], [39.0, 31.0 + 4.0 / 6.0]])
    np.testing.assert_allclose(record.time, [0.0, 0.1])
    assert record.began == datetime(2026, 11, 20, 10, 15, 30, 500000, UTC).timestamp()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{FRAME}\n25.0;26.0;27.0\n\n{FRAME}", "line 4: a frame of 1 rows of 3 cells; 2 of 3 were expected"),
        ("25;26\n35;36\n", "region hot goes past the frames of 2 rows, 2 columns"),
        (FRAME.replace("36.0", "x"), "'x' is not a number"),
        ("25,0;26,0;27,0\n35,0;36,0\n", "2 or 3 cells|delimiter decides"),
    ],
)
def test_frames_that_cannot_be_are_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, text, regions=PIXELS, time={"frame_rate_Hz": 10.0, "kind": "frame"}, unit="degC")


@pytest.mark.parametrize("mark", ["NaN", "nan", "N/A", "null", "--"])
def test_a_missed_pixel_at_the_edge_is_a_pixel(tmp_path, mark):
    """A row that begins with one is no remark, and a frame of nothing else keeps its place."""
    masked = f"{mark};26.0;27.0\n{mark};36.0;37.0\n"
    nothing = f"{mark};{mark};{mark}\n" * 2
    right = {"right": {"quantity": "winding_temperature", "rows": [0, 0], "columns": [1, 2]}}
    text = f"{masked}\n{nothing}\n{FRAME}"
    record = read(tmp_path, text, regions=right, time={"frame_rate_Hz": 1.0}, unit="degC")
    np.testing.assert_allclose(record.values[:, 0], [26.5, np.nan, 26.5])
    np.testing.assert_allclose(record.time, [0, 1, 2])


def test_files_of_a_frame_each_come_in_the_order_of_their_numbers(tmp_path):
    source = camera(regions=PIXELS, time={"frame_rate_Hz": 1.0}, unit="degC", exports_folder=str(tmp_path))
    source.open()
    for k in range(1, 13):
        (tmp_path / f"frame{k}.csv").write_text(FRAME.replace("37", str(100 + k)), encoding="utf-8")
    fresh = source.exports.fresh()
    np.testing.assert_allclose(source.read_files(fresh).values[:, 0], np.arange(101, 113))
    with pytest.raises(InputError, match=r"frame10.csv: comes where frame2.csv was expected"):
        source.read_files(sorted(fresh))


def test_a_last_frame_cut_short_is_left_out(tmp_path):
    text = f"{FRAME}\n{FRAME}\n25.0;26.0;27.0\n"
    record = read(tmp_path, text, regions=PIXELS, time={"frame_rate_Hz": 10.0}, unit="degC")
    assert len(record.time) == 2
    assert "cut short: left out" in told(record)


@settings(max_examples=60)
@given(st.binary(max_size=300) | st.text(max_size=200).map(str.encode))
def test_no_bytes_whatever_end_in_anything_but_values_or_one_line_faults(tmp_path_factory, raw):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(b"Time (s),R1 Avg (K),R2 Avg (K)\n0,5,6\n" + raw)
    try:
        record = camera().read_files([path])
    except InputError as refused:
        assert all("any.csv" in fault and "\n" not in fault for fault in refused.faults)
    else:
        assert (np.diff(record.time) > 0).all()
