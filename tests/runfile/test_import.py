"""Import of foreign recordings: each format, units, clocks and splits give the run that was recorded."""

import json
import textwrap

import numpy as np
import pytest
from scipy.io import savemat

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.importing.proposal.survey import survey
from leactl.runfile.importing.sources.formats.mat import mat_tree
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import verify
from tests.runfile import mat73

N = 400
T = np.arange(N) * 0.005
ANGLE = 0.3 * np.sin(3.0 * T)
SPEED = 0.9 * np.cos(3.0 * T)
VOLTS = np.cos(2.0 * T)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def mapping(folder, text):
    path = folder / "map.yaml"
    path.write_text(textwrap.dedent(text), encoding="utf-8")
    return path


def write_csv(path, columns, header=True, delimiter=","):
    rows = zip(*columns.values(), strict=True)
    lines = [delimiter.join(columns)] if header else []
    lines += [delimiter.join(x if isinstance(x, str) else repr(float(x)) for x in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def imported(folder, source, text, count=1):
    files = import_runs([str(source)], mapping(folder, text), folder / "out")
    assert len(files) == count
    for file in files:
        assert verify(file) == []
    return files if count > 1 else files[0]


def test_a_stretch_of_empty_cells_is_noted_for_its_channel(folder):
    hole = np.where((T > 0.8) & (T < 1.3), np.nan, VOLTS)
    write_csv(folder / "a.csv", {"t": T, "q": ANGLE, "u": np.where(np.arange(N) % 2, np.nan, VOLTS), "v": hole})
    file = imported(
        folder,
        folder / "a.csv",
        """
        mechanical: free
        streams:
          loop:
            time: {column: t}
            channels:
              q: {column: q, quantity: angle, units: rad}
              u: {column: u, quantity: bus_voltage, units: V}
              v: {column: v, quantity: q_axis_voltage, units: V}
        """,
    )
    with Run.open(file) as run:
        events = [str(event) for event in run.events if "without a sample" in str(event)]
    assert len(events) == 1
    assert "stream loop, channel v: 0.5 s without a sample from 0.8 s" in events[0]


def test_a_csv_with_other_units_signs_and_gains(folder):
    write_csv(folder / "a b.csv", {"t [ms]": T * 1e3, " q": np.degrees(-ANGLE), "u": VOLTS, "T": 20 + 0 * T})
    file = imported(
        folder,
        folder / "a b.csv",
        """
        mechanical: free
        run: {protocol: sweep, actuator: a1, created: "2019-03-01T12:00:00+01:00"}
        setup: {load_mass: 0.5, note: bolted}
        streams:
          loop:
            time: {column: "t [ms]", units: ms}
            channels:
              angle: {column: q, quantity: angle, units: deg, sign: -1}
              force: {column: u, quantity: torque_reference, scale: 35.0, offset: 1.5, units: N}
              cool: {column: 3, quantity: winding_temperature, units: K, offset: 273.15}
        """,
    )
    assert file.name == "a-b.h5"
    with Run.open(file) as run:
        angle, force = run.channel("angle"), run.channel("torque_reference")
        np.testing.assert_allclose(angle.values, ANGLE, atol=1e-12)
        np.testing.assert_allclose(angle.time, T, atol=1e-12)
        np.testing.assert_allclose(force.values, 35.0 * VOLTS + 1.5)
        assert (angle.units, force.units) == ("rad", "N")
        np.testing.assert_allclose(run.channel("winding_temperature").values, 20.0)
        assert run.mechanical == "free"
        assert run.setup["load_mass"] == 0.5
        assert run.setup["note"] == "bolted"
        assert run.attributes["created"] == "2019-03-01T11:00:00Z"
        assert run.attributes["protocol"] == "sweep"
        assert "map.yaml" in run.events[0].message


def test_a_csv_as_germans_write_it(folder):
    text = "Prüfstand 7\nZeit;Weg\ns;mm\n" + "\n".join(f"{t:.3f};{1000 * t:.2f}".replace(".", ",") for t in T)
    (folder / "x.txt").write_bytes(text.encode("cp1252"))
    file = imported(
        folder,
        folder / "x.txt",
        """
        mechanical: free
        csv: {delimiter: ";", decimal: ",", header_line: 2, data_line: 4, encoding: cp1252}
        streams:
          loop:
            time: {column: Zeit}
            channels: {position: {column: Weg, quantity: angle, units: mm}}
        """,
    )
    with Run.open(file) as run:
        np.testing.assert_allclose(run.channel("angle").values, np.round(T, 5), atol=1e-9)
        assert run.channel("angle").units == "m"


@pytest.mark.parametrize("row", ["{t},{q}", "{t},{q},", '{t}, "{q}"'])
def test_a_header_and_its_rows_end_with_a_delimiter_or_without(folder, row):
    lines = ["t,q,", *(row.format(t=t, q=q) for t, q in zip(T.tolist(), ANGLE.tolist(), strict=True))]
    (folder / "a.csv").write_text("\n".join(lines))
    channel = "mechanical: free\nstreams: {loop: {time: {column: t}, channels: {q: {column: q, quantity: angle}}}}"
    with Run.open(imported(folder, folder / "a.csv", channel)) as run:
        np.testing.assert_array_equal(run.channel("angle").values, ANGLE)


@pytest.mark.parametrize(
    ("decimal", "thousands", "written"),
    [
        (".", ",", ","),
        (",", ".", "."),
        (",", " ", " "),
        (",", " ", "\u00a0"),
        (",", " ", "\u202f"),
        (".", "'", "\u2019"),
    ],
)
def test_marks_between_thousands_as_the_mapping_states_them(folder, decimal, thousands, written):
    exact = np.round(3000.0 + 1000.0 * ANGLE, 2)
    marks = str.maketrans({",": written, ".": decimal})
    rows = [f"{t:.3f};{q:,.2f}".translate(marks) for t, q in zip(T, exact, strict=True)]
    (folder / "a.csv").write_text("\n".join(["t;q", *rows]), encoding="utf-8")
    text = f"""
        mechanical: free
        csv: {{delimiter: ";", decimal: "{decimal}", thousands: "{thousands}"}}
        streams: {{loop: {{time: {{column: t}}, channels: {{q: {{column: q, quantity: angle}}}}}}}}
        """
    with Run.open(imported(folder, folder / "a.csv", text)) as run:
        np.testing.assert_array_equal(run.channel("angle").values, exact)


def test_missing_samples_are_nan_and_true_is_one(folder):
    on = ["true" if k % 2 else "False" for k in range(N)]
    angle = ["" if 10 <= k < 20 else "-999" if k == 30 else f"{v}" for k, v in enumerate(ANGLE)]
    write_csv(folder / "a.csv", {"q": angle, "on": on})
    file = imported(
        folder,
        folder / "a.csv",
        """
        mechanical: free
        csv: {missing: ["", "-999"]}
        streams:
          loop:
            time: {rate_Hz: 200}
            channels:
              angle: {column: q, quantity: angle}
              on: {column: on, quantity: drive_enabled}
        """,
    )
    with Run.open(file) as run:
        missing = np.flatnonzero(np.isnan(run.channel("angle").values))
        assert missing.tolist() == [*range(10, 20), 30]
        assert run.channel("drive_enabled").values[:4].tolist() == [0, 1, 0, 1]
        np.testing.assert_allclose(run.time("loop"), T)


RECORDS = """
mechanical: free
run: {protocol: {field: about.trajectory}}
setup:
  drive_gain: {field: about.kp, scale: 0.01}
streams:
  loop:
    records: log.entries
    time: {column: stamp.s}
    channels:
      angle: {column: q, quantity: angle}
      speed: {column: w, quantity: velocity}
"""


def test_json_with_a_list_of_records(folder):
    entries = [{"stamp": {"s": t}, "q": q, "w": w} for t, q, w in zip(T, ANGLE, SPEED, strict=True)]
    del entries[5]["w"]
    entries[6]["w"] = None
    document = {"about": {"kp": 400, "trajectory": "sine"}, "log": {"entries": entries}}
    (folder / "a.json").write_text(json.dumps(document))
    with Run.open(imported(folder, folder / "a.json", RECORDS)) as run:
        np.testing.assert_allclose(run.channel("angle").values, ANGLE)
        assert np.flatnonzero(np.isnan(run.channel("velocity").values)).tolist() == [5, 6]
        assert run.setup["drive_gain"] == 4.0
        assert run.attributes["protocol"] == "sine"


def test_json_with_rows_of_a_table(folder):
    (folder / "a.json").write_text(json.dumps({"rows": np.stack([T, ANGLE], axis=1).tolist()}))
    text = """
        mechanical: free
        streams:
          loop:
            records: rows
            time: {column: 0}
            channels: {angle: {column: 1, quantity: angle}}
        """
    with Run.open(imported(folder, folder / "a.json", text)) as run:
        np.testing.assert_allclose(run.channel("angle").values, ANGLE)


MAT = """
mechanical: free
run: {actuator: {field: rig.name}}
streams:
  loop:
    time: {column: t}
    channels:
      angle: {column: log.q, quantity: angle}
      force: {column: vir, quantity: torque_reference, scale: {field: gtau}}
      speed: {column: "m[1]", quantity: velocity}
"""


MAT_ONE = """
mechanical: free
streams: {loop: {time: {column: t}, channels: {angle: {column: q, quantity: angle}}}}
"""


def test_mat_5_with_structs(folder):
    rig = {"name": "EMPS"}
    content = {"t": T[:, None], "vir": VOLTS[:, None], "gtau": 35.15, "log": {"q": ANGLE}, "rig": rig}
    savemat(folder / "a.mat", content | {"m": np.stack([T, SPEED], axis=0)})
    with Run.open(imported(folder, folder / "a.mat", MAT)) as run:
        np.testing.assert_allclose(run.channel("torque_reference").values, 35.15 * VOLTS)
        np.testing.assert_allclose(run.channel("velocity").values, SPEED)
        assert run.attributes["actuator"] == "EMPS"


MAT_CONTENT = {
    "t": T[:, None],
    "vir": VOLTS.astype("f4")[:, None],
    "gtau": 35.15,
    "log": {"q": ANGLE[:, None], "valid": T > 0.1},
    "rig": {"name": "EMPS", "joints": ["hip", "knee"], "sides": np.array(["left ", "right"])},
    "m": np.stack([T, SPEED], axis=0),
    "trials": [{"omega": SPEED}, {"omega": 2.0 * SPEED}],
    "none": np.empty((0, 0)),
}


def test_mat_7_3_gives_the_run_of_mat_5(folder):
    text = (
        MAT
        + """
      valid: {column: log.valid, quantity: drive_enabled}
      second: {column: "trials[1].omega", quantity: velocity, role: load}
"""
    )
    savemat(folder / "five.mat", MAT_CONTENT)
    mat73.save(folder / "seven.mat", MAT_CONTENT)
    runs = [Run.open(imported(folder, folder / name, text)) for name in ("five.mat", "seven.mat")]
    keys = [("angle", "test"), ("velocity", "test"), ("velocity", "load"), ("torque_reference", "test")]
    for key in [*keys, ("drive_enabled", "test")]:
        five, seven = (run.channel(*key) for run in runs)
        np.testing.assert_array_equal(five.values, seven.values)
        np.testing.assert_array_equal(five.time, seven.time)
    np.testing.assert_allclose(runs[1].channel("angle").values, ANGLE)
    np.testing.assert_allclose(runs[1].channel("velocity", "load").values, 2.0 * SPEED)
    assert [run.attributes["actuator"] for run in runs] == ["EMPS", "EMPS"]
    for run in runs:
        run.close()
    assert mat_tree(folder / "seven.mat")["rig"] == {
        "name": "EMPS",
        "joints": ["hip", "knee"],
        "sides": ["left", "right"],
    }


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (mat73.Object("timeseries"), "'q' holds a MATLAB object (timeseries), which only MATLAB decodes"),
        (mat73.Object("timetable"), "'q' holds a MATLAB object (timetable), which only MATLAB decodes"),
        (mat73.Sparse(), "'q' holds a sparse matrix (save full(...) of it) where a column"),
        (np.exp(1j * T), "'q' holds complex numbers (save real(...) and imag(...) of them)"),
        (np.empty((0, 0)), "column 'q' holds no number at all"),
        ("EMPS", "'q' holds 'EMPS' where a column of numbers was expected"),
        ({"x": T}, "'q' holds a group of x where a column of numbers was expected"),
    ],
)
def test_what_mat_7_3_holds_besides_numbers_is_told(folder, value, words):
    mat73.save(folder / "a.mat", {"t": T, "q": value})
    with pytest.raises(InputError) as refused:
        imported(folder, folder / "a.mat", MAT_ONE)
    assert words in str(refused.value)


def test_a_field_of_an_object_is_refused_with_what_it_is(folder):
    mat73.save(folder / "a.mat", {"t": T, "ts": mat73.Object("timeseries")})
    with pytest.raises(InputError, match="ts has no 'Data'; it is a MATLAB object \\(timeseries\\), which only MATLAB"):
        imported(folder, folder / "a.mat", MAT_ONE.replace("column: q", "column: ts.Data"))


def test_a_file_of_objects_alone_has_no_table_and_says_why(folder):
    mat73.save(folder / "a.mat", {"out": {"logs": mat73.Object("timeseries")}})
    with pytest.raises(InputError, match=r"a.mat: no table of numbers; out.logs holds a MATLAB object \(timeseries\)"):
        survey(folder / "a.mat")


def test_the_variables_of_mat_7_3_are_proposed(folder):
    mat73.save(folder / "a.mat", {"log": {"time_s": T, "q_rad": ANGLE}, "ts": mat73.Object("timeseries")})
    tables = [seen.table for seen in survey(folder / "a.mat").tables]
    assert [(table.records, [column.name for column in table.columns]) for table in tables] == [
        ("log", ["q_rad", "time_s"])
    ]


TWO_CLOCKS = """
mechanical: coupled
streams:
  loop:
    time: {{column: t}}
    channels: {{angle: {{column: q, quantity: angle}}}}
  daq:
    records: daq
    time: {{column: t}}
    clock: {clock}
    channels:
      torque: {{column: m, quantity: torque}}
      angle: {{column: q, quantity: angle, location: second encoder}}
"""


@pytest.mark.parametrize(
    "clock", ["{offset_s: -1000.1}", "{estimate: {channel: angle, against: loop/angle, within_s: 1}}"]
)
def test_two_clocks_are_aligned(folder, clock):
    chirp = 0.3 * np.sin(2.0 * T**3 + T)
    late = 1000.1 if "offset" in clock else 0.1234
    fast = np.arange(0.2, 1.6, 0.001)
    daq = {
        "t": (fast + late).tolist(),
        "m": [0.1] * len(fast),
        "q": (0.3 * np.sin(2.0 * fast**3 + fast) + 0.02).tolist(),
    }
    (folder / "a.json").write_text(json.dumps({"t": T.tolist(), "q": chirp.tolist(), "daq": daq}))
    with Run.open(imported(folder, folder / "a.json", TWO_CLOCKS.format(clock=clock))) as run:
        np.testing.assert_allclose(run.time("loop"), T, atol=1e-9)
        np.testing.assert_allclose(run.time("daq"), fast, atol=1e-9 if "offset" in clock else 1e-3)


SPLIT = """
mechanical: free
{how}
streams:
  loop:
    time: {{column: t}}
    channels: {{angle: {{column: q, quantity: angle}}}}
"""


@pytest.mark.parametrize(
    ("how", "lengths"),
    [
        ("parts: [{suffix: a, rows: [0, 100]}, {suffix: b, rows: [100, 400]}]", {"s-a": 100, "s-b": 300}),
        ("parts: [{suffix: a, time_s: [0, 0.5]}, {suffix: b, time_s: [1.5, 1.995]}]", {"s-a": 100, "s-b": 99}),
        ("by_direction: {channel: loop/angle, least: 1.0}", {"s-forward": 150, "s-reverse": 150, "s-forward-2": 100}),
    ],
)
def test_one_recording_becomes_several_runs(folder, how, lengths):
    sweep = np.interp(np.arange(N), [0, 149, 299, 399], [0, 3, -1, 2]) + 0.01 * np.sin(np.arange(N))
    write_csv(folder / "s.csv", {"t": T + 7, "q": sweep})
    files = imported(folder, folder / "s.csv", SPLIT.format(how=how), count=len(lengths))
    for file in files:
        with Run.open(file) as run:
            assert run.time("loop")[0] == 0.0
            assert run.rows["loop"] == pytest.approx(lengths[file.stem], abs=2)


def test_a_channel_without_a_number_has_no_direction(folder):
    """Its only number is in a row that repeats the stamp before it, and goes with that row."""
    angle = np.full(N, np.nan)
    angle[8] = 1.0
    stamps = T.copy()
    stamps[8] = stamps[7]
    write_csv(folder / "s.csv", {"t": stamps, "q": angle})
    text = SPLIT.format(how="by_direction: {channel: loop/angle, least: 1.0}")
    with pytest.raises(InputError, match="angle"):
        imported(folder, folder / "s.csv", text.replace("column: t", "column: t, repeated: drop"))


def test_stamps_by_the_calendar_and_stamps_that_stand_twice(folder):
    stamps = [f"2024-05-01T10:00:{t:06.3f}Z" for t in T]
    stamps[8] = stamps[7]
    write_csv(folder / "a.csv", {"t": stamps, "q": ANGLE})
    text = SPLIT.format(how="").replace("column: t", "column: t, units: iso8601, repeated: drop")
    with Run.open(imported(folder, folder / "a.csv", text)) as run:
        np.testing.assert_allclose(run.time("loop"), np.delete(T, 8), atol=1e-6)
        np.testing.assert_allclose(run.channel("angle").values, np.delete(ANGLE, 8))


def test_many_sources_by_a_pattern(folder):
    for name in ("a1", "a2", "b1"):
        write_csv(folder / f"{name}.csv", {"t": T, "q": ANGLE})
    files = import_runs(["a*.csv", "b1.csv", "a1.csv"], mapping(folder, SPLIT.format(how="")), folder / "out")
    assert [file.name for file in files] == ["a1.h5", "a2.h5", "b1.h5"]
    assert sorted(p.name for p in (folder / "out").iterdir()) == ["a1.h5", "a2.h5", "b1.h5"]


def test_a_long_recording_is_read_in_seconds(folder):
    rows = 300_000
    with (folder / "a.csv").open("w") as file:
        file.write("t,q,x,y\n")
        file.writelines(f"{k * 0.001:.3f},{(k % 1000) * 1e-3},abc,1\n" for k in range(rows))
    with Run.open(imported(folder, folder / "a.csv", SPLIT.format(how=""))) as run:
        assert run.rows["loop"] == rows


def test_a_source_named_as_no_run_can_be_gives_a_run(folder):
    write_csv(folder / "_a.csv", {"t": T, "q": ANGLE})
    assert imported(folder, folder / "_a.csv", SPLIT.format(how="")).name == "a.h5"
