"""What an import neither loses, shifts nor invents, of files as loggers, spreadsheets and cut transfers leave them."""

import json
import math

import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.importing.proposal.proposal import propose
from leactl.runfile.importing.proposal.survey import survey
from leactl.runfile.read.reader import Run

COLUMNS = """
mechanical: free
streams:
  loop:
    time: {column: t}
    channels: {q: {column: q, quantity: angle}, w: {column: w, quantity: velocity}}
"""


def imported(folder, name, mapping, out="out"):
    (folder / "map.yaml").write_text(mapping, encoding="utf-8")
    (path,) = import_runs([str(folder / name)], folder / "map.yaml", folder / out)
    return path


def table(rows, more=lambda row: ""):
    lines = [f"{0.01 * k:.2f},{math.sin(0.01 * k):.5f},{math.cos(0.01 * k):.5f}{more(k)}" for k in range(rows)]
    return "\n".join(["t,q,w" + (",note" if more(0) else ""), *lines, ""])


def proposal(folder, name, text):
    (folder / name).write_text(text, encoding="utf-8")
    return propose(survey(folder / name), {("mechanical",): "free"})


def listing(header, rows, *functions):
    return "\n".join([header, *(",".join(f"{function(k):.6f}" for function in functions) for k in range(rows)), ""])


def test_a_quote_without_its_end_swallows_no_rows(tmp_path):
    (tmp_path / "a.csv").write_text(table(1000, lambda k: ',"cage rattles' if k == 300 else ",ok"))
    with pytest.raises(InputError, match="line 302: a quote opens a cell that does not end in its line"):
        imported(tmp_path, "a.csv", COLUMNS)


def test_a_blank_line_of_one_column_is_no_row_that_never_was(tmp_path):
    mapping = "mechanical: free\nstreams: {loop: {time: {rate_Hz: 100}, channels: {q: {column: q, quantity: angle}}}}\n"
    values = [f"{0.01 * k:.4f}" for k in range(100)]
    (tmp_path / "a.csv").write_text("\n".join(["q", *values[:30], "", "", *values[32:], ""]))
    with pytest.raises(InputError, match="line 32: is blank; write a missed sample as nan"):
        imported(tmp_path, "a.csv", mapping)
    (tmp_path / "a.csv").write_text("\n".join(["q", *values[:30], "nan", "nan", *values[32:], "", ""]))
    with Run.open(imported(tmp_path, "a.csv", mapping)) as run:
        assert run.channel("angle").time[-1] == pytest.approx(0.99)


@pytest.mark.parametrize("cut", [1, 3, 6, 7])
def test_a_row_that_is_cut_in_its_last_number_is_left_out_and_told(tmp_path, cut):
    (tmp_path / "a.csv").write_text(table(50)[:-cut])
    with Run.open(imported(tmp_path, "a.csv", COLUMNS)) as run:
        velocity = run.channel("velocity").values
        told = [event.message for event in run.events if "line 51, has no end and is cut: left out" in event.message]
    assert len(velocity) == (50 if cut == 1 else 49)
    assert len(told) == (0 if cut == 1 else 1)
    np.testing.assert_allclose(velocity, np.cos(0.01 * np.arange(len(velocity))), atol=1e-5)


def test_a_column_with_a_word_among_its_numbers_is_listed_with_the_word(tmp_path):
    rows = [f"{0.01 * k:.2f},{0.001 * k:.4f},{'OVL' if k == 50 else f'1.{k:03d}'}" for k in range(300)]
    text = proposal(tmp_path, "a.csv", "\n".join(["t [s],angle [rad],torque [Nm]", *rows, ""])).text
    assert "# torque [Nm]: left out, 'OVL' in line 52 is no number; csv.missing has what marks a missed sample" in text


def test_a_long_serial_number_keeps_all_its_digits(tmp_path):
    lines = table(20, lambda _: ",20260115").replace("note", "serial")
    (tmp_path / "a.csv").write_text(lines)
    with Run.open(imported(tmp_path, "a.csv", COLUMNS + "run: {actuator: {field: serial}}\n")) as run:
        assert run.attributes["actuator"] == "20260115"


def test_a_serial_number_keeps_its_zeros(tmp_path):
    lines = table(20, lambda _: ",00815").replace("note", "serial")
    (tmp_path / "a.csv").write_text(lines)
    with Run.open(imported(tmp_path, "a.csv", COLUMNS + "run: {actuator: {field: serial}}\n")) as run:
        assert run.attributes["actuator"] == "00815"


def test_recordings_of_one_name_are_two_runs(tmp_path):
    ids, names = set(), set()
    for day, rows in (("1", 40), ("2", 50)):
        (tmp_path / day).mkdir()
        (tmp_path / day / "левый.csv").write_text(table(rows))
        path = imported(tmp_path / day, "левый.csv", COLUMNS)
        names.add(path.name)
        with Run.open(path) as run:
            ids.add(run.attributes["run_id"])
    assert len(ids) == 2
    assert names == {"левый.h5"}


def test_instants_of_two_columns_of_a_parquet_file_keep_the_time_between_them(tmp_path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    time = np.arange(0.0, 2.0, 0.01)
    first = 1768472890_000000000 + np.round(time * 1e9).astype("i8")
    columns = {
        "sa": arrow.array(first, arrow.timestamp("ns")),
        "sb": arrow.array((first + 350_000_000) // 1000, arrow.timestamp("us")),
        "q": np.sin(time),
    }
    parquet.write_table(arrow.table(columns), tmp_path / "a.parquet")
    stream = "{{time: {{column: s{0}}}, channels: {{q: {{column: q, quantity: angle, location: {0}}}}}}}"
    streams = f"streams:\n  a: {stream.format('a')}\n  b: {stream.format('b')}\n"
    with Run.open(imported(tmp_path, "a.parquet", f"mechanical: free\n{streams}")) as run:
        starts = {channel.location: channel.time[0] for channel in run.channels("angle")}
    assert starts["b"] - starts["a"] == pytest.approx(0.35, abs=1e-6)


def test_an_element_of_a_field_is_one_of_each_record(tmp_path):
    records = [{"t": 0.01 * k, "q": [math.sin(0.01 * k), 10 * k, k][: 2 if k == 7 else 3]} for k in range(40)]
    (tmp_path / "a.json").write_text(json.dumps({"log": records}))
    mapping = """
mechanical: free
streams: {loop: {records: log, time: {column: t}, channels: {q: {column: "q[2]", quantity: angle}}}}
"""
    with Run.open(imported(tmp_path, "a.json", mapping)) as run:
        angle = run.channel("angle").values
    np.testing.assert_array_equal(angle, [math.nan if k == 7 else k for k in range(40)])
    with pytest.raises(InputError, match="has no 3 in any record"):
        imported(tmp_path, "a.json", mapping.replace("q[2]", "q[3]"), "other")
    assert 'column: "q[1]", quantity: angle' in propose(survey(tmp_path / "a.json"), {}).text


def test_a_message_without_a_value_has_nan_and_one_field_that_none_has_is_told(tmp_path):
    writer_module = pytest.importorskip("mcap.writer")
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = writer_module.Writer(file)
        writer.start()
        channel = writer.register_channel("/drv", "json", writer.register_schema("S", "jsonschema", b"{}"))
        for k in range(50):
            stamp = 1768472890_000000000 + k * 20_000_000
            tree = {"iq": 0.1 * k} | ({} if k == 3 else {"bus": None if k in (0, 9) else 24.0 + k})
            writer.add_message(channel, stamp, json.dumps(tree).encode(), stamp)
        writer.finish()
    mapping = """
mechanical: free
streams: {drv: {records: /drv, time: {column: log_time}, channels: {v: {column: bus, quantity: bus_voltage}}}}
"""
    with Run.open(imported(tmp_path, "a.mcap", mapping)) as run:
        np.testing.assert_array_equal(
            run.channel("bus_voltage").values, [math.nan if k in (0, 3, 9) else 24.0 + k for k in range(50)]
        )
    with pytest.raises(InputError, match="message 0 has no 'volts' in it, which has iq, bus"):
        imported(tmp_path, "a.mcap", mapping.replace("column: bus,", "column: volts,"), "other")


@pytest.mark.parametrize(
    ("header", "step", "start", "units"),
    [
        ("time [min]", 1 / 60, 0.0, "min"),
        ("time_min", 1 / 60, 0.0, "min"),
        ("time [h]", 1 / 360, 0.0, "h"),
        ("time [\u03bcs]", 1000.0, 0.0, "us"),
        ("timestamp", 2000.0, 1.2e9, "UNDECIDED"),  # us since the start of the logger, as large as a date in s
        ("timestamp", 0.01, 1.76e9, "s"),
        ("time [ticks]", 0.01, 0.0, "UNDECIDED"),
    ],
)
def test_the_unit_of_stamps_is_that_of_their_header_and_their_rate(tmp_path, header, step, start, units):
    text = listing(f"{header},winding temp [degC]", 300, lambda k: start + step * k, lambda k: 25 + 0.01 * k)
    assert f'time: {{column: "{header}", units: {units}}}'.replace('"', "") in proposal(
        tmp_path, "a.csv", text
    ).text.replace('"', "")


@pytest.mark.parametrize(
    ("header", "why"),
    [
        ("Current (Arms)", "its unit is that of an r.m.s. or peak value"),
        ("motor current [A rms]", "its unit is that of an r.m.s. or peak value"),
        ("voltage [Vpk]", "its unit is that of an r.m.s. or peak value"),
        ("electrical angle [rad]", "its name says an electrical angle"),
        ("theta_e [rad]", "its name says an electrical angle"),
        ("omega_el [rad/s]", "its name says an electrical speed"),
        ("electrical speed [rpm]", "its name says an electrical speed"),
    ],
)
def test_a_value_of_another_kind_is_left_out_with_the_reason(tmp_path, header, why):
    text = listing(f"t [s],iq [A],{header}", 300, lambda k: 0.01 * k, lambda k: 2.0, lambda k: 2 * math.sin(0.01 * k))
    assert f"# {header}: left out, {why}" in proposal(tmp_path, "a.csv", text).text


@pytest.mark.parametrize(("header", "text"), [("voltage [cV]", "cV"), ("current [dA]", "dA")])
def test_a_unit_that_is_not_known_is_asked_for_whatever_the_range(tmp_path, header, text):
    rows = listing(f"t [s],{header}", 300, lambda k: 0.01 * k, lambda k: 2.3 * math.sin(0.01 * k))
    result = proposal(tmp_path, "a.csv", rows)
    assert f"yet its unit is {text}, which is not known" in result.text
    assert result.questions


@pytest.mark.parametrize("level", [1.0, 6.0, 360.0])
def test_a_step_between_two_levels_is_no_turn(tmp_path, level):
    angle = np.zeros(2000)
    for k in range(1, 2000):
        angle[k] = angle[k - 1] + 0.08 * (level * (k // 200 % 2) - angle[k - 1])
    text = listing(
        "t [s],angle_ref,angle", 2000, lambda k: 0.01 * k, lambda k: level * (k // 200 % 2), lambda k: angle[k]
    )
    result = proposal(tmp_path, "a.csv", text)
    assert "jumps by" not in result.text
    assert any(question.key[-2:] == ("angle_ref", "units") for question in result.questions)


@pytest.mark.parametrize(("period", "units"), [(2 * math.pi, "rad"), (360.0, "deg"), (1.0, "turn")])
@pytest.mark.parametrize("speed", [0.002, 0.15, -0.05])  # turns a sample
def test_a_wrapped_angle_tells_its_unit_by_its_jumps(tmp_path, period, units, speed):
    text = listing("t [s],angle", 2000, lambda k: 0.01 * k, lambda k: (speed * k * period) % period)
    assert f"a turn in {units}" in proposal(tmp_path, "a.csv", text).text
