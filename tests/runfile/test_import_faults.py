"""Import refuses what it cannot be sure of: one line a fault with its place, nothing half written or overwritten."""

import json
import textwrap

import numpy as np
import pytest
from scipy.io import savemat

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs

from ..cli.terminal import leactl
from .test_import import ANGLE, SPEED, TWO_CLOCKS, N, T, mapping, write_csv

PLAIN = """\
mechanical: free
streams:
  loop:
    time: {column: t}
    channels:
      angle: {column: q, quantity: angle}
      speed: {column: w, quantity: velocity}
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "a.csv", {"t": T, "q": ANGLE, "w": SPEED})
    return tmp_path


def refused(folder, text=PLAIN, sources=("a.csv",)):
    with pytest.raises(InputError) as caught:
        import_runs(sources, mapping(folder, text), folder / "out")
    out = folder / "out"
    assert not out.exists() or not list(out.iterdir())
    assert all("\n" not in fault for fault in caught.value.faults)
    return caught.value.faults


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("column: q,", "column: x,", "map.yaml:6:23  streams.loop.channels.angle.column: a.csv has no column 'x'"),
        ("column: q,", "column: 7,", "a.csv has no column 7; it has t, q, w"),
        ("quantity: angle}", "quantity: angel}", "map.yaml:6:36  streams.loop.channels.angle.quantity: 'angel'"),
        ("quantity: angle}", "quantity: angle, units: V}", "units 'V' are none of rad, mrad, deg"),
        ("quantity: angle}", "quantity: angle, gain: 2}", "streams.loop.channels.angle.gain: 2: unknown key"),
        ("quantity: angle}", "quantity: angle, scale: .inf}", "a finite number was expected"),
        ("quantity: angle}", "quantity: angle, scale: '2'}", "a number or a mapping with keys of field"),
        ("quantity: angle}", "quantity: angle, sign: 2}", "sign"),
        ("quantity: angle}", "quantity: angle, scale_std: 0.1}", "map.yaml:6:54  streams.loop.channels.angle.sc"),
        ("quantity: angle}", "quantity: torque, scale_std: 1}", "less than 1 was expected"),
        ("quantity: angle}", "quantity: angle, scale: {field: k}}", "has no column 'k'"),
        ("quantity: angle}", "quantity: angle, scale: {field: w}}", "holds 400 values where one was expected"),
        ("{column: t}", "{}", "give one of column, rate_Hz, step_s; none is given"),
        ("{column: t}", "{column: t, rate_Hz: 5}", "column and rate_Hz is given"),
        ("{column: t}", "{rate_Hz: 0}", "more than 0"),
        ("{column: t}", "{column: time}", "map.yaml:4:20  streams.loop.time.column: a.csv has no column 'time'"),
        ("mechanical: free", "mechanical: loose", "map.yaml:1:13  mechanical"),
        ("mechanical: free", "setup: {load_mass: heavy}", "map.yaml:1:1  mechanical: is required and missing"),
        ("mechanical: free", "mechanical: free\nparts: [{suffix: a, rows: [0, 900]}]", "reaches beyond the recording"),
        ("mechanical: free", "mechanical: free\nparts: [{suffix: a, rows: [9, 9]}]", "9 is not before 9"),
        ("mechanical: free", "mechanical: free\nby_direction: {channel: loop/x, least: 1}", "no channel 'loop/x'"),
        ("mechanical: free", "mechanical: free\nby_direction: {channel: loop/angle, least: 9}", "never travels 9"),
        ("quantity: velocity", "quantity: angle", "same quantity, role and location"),
        ("mechanical: free", "mechanical: free\nformat: mat", "not a MAT file"),
        ("mechanical: free", "mechanical: free\nformat: json", "a.csv:1:1  not JSON"),
        ("mechanical: free", "mechanical: free\ncsv: {delimiter: ';'}", "is csv.delimiter right?"),
        ("mechanical: free", "mechanical: free\ncsv: {encoding: latin-9000}", "csv.encoding: 'latin-9000': the name"),
        ("mechanical: free", "mechanical: free\ncsv: {encoding: ''}", "csv.encoding: '': the name of an encoding"),
        ("mechanical: free", "mechanical: free\ncsv: {thousands: '.'}", "decimal '.' is the thousands mark"),
        ("mechanical: free", "mechanical: free\nrun: {created: yesterday}", "'yesterday' is no ISO 8601 date"),
    ],
)  # fmt: skip
def test_a_fault_of_the_mapping_has_its_line_and_column(folder, old, new, told):
    assert old in PLAIN
    assert any(told in fault for fault in refused(folder, PLAIN.replace(old, new)))


TWICE = "parts: [{suffix: a, rows: [0, 9]}, {suffix: a, rows: [9, 18]}]"
BOTH = "parts: [{suffix: a, rows: [0, 9]}]\nby_direction: {channel: loop/angle, least: 1}"
STEPS = "steps: [{name: a, start_s: 0, stop_s: 1}]\nparts: [{suffix: a, time_s: [0, 1]}]"
LABELS = "steps_by_column: {stream: loop, column: q, names: {1: hold}, parameters: {current_A: loop/x}}"
HOLDS = "steps_by_holds: {channel: loop/x, parameter: v, least_s: 1}"
CLOCK = "clock: {estimate: {channel: speed, against: loop/angle}}\n    time: {"


@pytest.mark.parametrize(
    ("old", "new", "place", "told"),
    [
        ("free", f"free\n{BOTH}", "3:15  by_direction", "stands beside parts"),
        ("free", f"free\n{TWICE}", "2:45  parts[1].suffix", "'a' stands twice"),
        ("free", f"free\n{STEPS}", "2:8  steps", "instants of the whole mean nothing to its parts"),
        ("free", f"free\n{HOLDS}", "2:27  steps_by_holds.channel", "no channel 'loop/x' is mapped; loop/angle"),
        ("free", f"free\n{LABELS}", "2:86  steps_by_column.parameters.current_A", "no channel 'loop/x' is mapped"),
        ("free", f"free\n{LABELS}".replace("loop,", "lop,"), "2:27  steps_by_column.stream", "no stream 'lop'"),
        ("time: {", CLOCK, "4:49  streams.loop.clock.estimate.against", "is a channel of the same stream"),
        ("time: {", CLOCK.replace("speed", "x"), "4:33  streams.loop.clock.estimate.channel", "no channel 'loop/x'"),
        ("velocity}", "angle}", "7:14  streams.loop.channels.speed", "same quantity, role and location as loop/angle"),
        ("speed:", "time:", "7:13  streams.loop.channels.time", "'time' is the name of a stream's stamps"),
    ],
)  # fmt: skip
def test_keys_at_odds_with_others_have_their_own_line_and_column(folder, old, new, place, told):
    assert old in PLAIN
    faults = refused(folder, PLAIN.replace(old, new, 1))
    assert any(f"map.yaml:{place}: {told}" in fault for fault in faults)
    assert not any(":1:1 " in fault for fault in faults)


def spoilt(folder, row, column, cell):
    lines = (folder / "a.csv").read_text().splitlines()
    cells = lines[row].split(",")
    cells[column] = cell
    lines[row] = ",".join(cells)
    (folder / "a.csv").write_text("\n".join(lines))


@pytest.mark.parametrize(
    ("row", "column", "cell", "told"),
    [
        (7, 1, "4,5", "a.csv: line 8: 4 cells where 3 were expected"),
        (7, 1, "oops", "a.csv: line 8, column 'q': 'oops' is not a number; if it marks a missed sample, add"),
        (1, 1, "oops", "a.csv: line 3, column 'q'"),
        (7, 1, "1e400", "a.csv: line 8, column 'q': infinite"),
        (7, 0, "", "a.csv: line 8, column 't': no stamp; 1 rows have none"),
        (7, 0, "0.025", "a.csv: line 8, column 't': stamp 0.025 s stands twice; time.repeated: drop"),
        (7, 0, "0.001", "a.csv: line 8, column 't': stamp 0.001 s goes back from 0.025 s"),
    ],
)  # fmt: skip
def test_a_fault_of_the_data_has_its_row_and_column(folder, row, column, cell, told):
    spoilt(folder, row, column, cell)
    if row == 1:
        told = "column 'q': 'oops' is not a number"
    assert any(told in fault for fault in refused(folder))


def test_one_sign_before_a_number_between_thousands(folder):
    spoilt(folder, 7, 1, "+-5")
    (fault,) = refused(folder, f'{PLAIN}\ncsv: {{thousands: "\'"}}')
    assert "a.csv: line 8, column 'q': '+-5' is not a number" in fault


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("column: t", "column: t, units: ns", "s between samples; are time.units right?"),
        ("column: q, quantity: angle", "column: q, quantity: winding_temperature, units: K", "outside -100 .. 600"),
        ("column: q, quantity: angle", "column: q, quantity: bus_voltage, scale: 1e9", "are units and scale right?"),
        ("column: q, quantity: angle", "column: q, quantity: angle, scale: 1e300", "outside -1e+10 .. 1e+10"),
    ],
)
def test_units_that_are_wrong_by_a_thousand_are_met_at_the_door(folder, old, new, told):
    (fault,) = refused(folder, PLAIN.replace(old, new))
    assert told in fault


@pytest.mark.parametrize(
    ("clock", "told"),
    [
        ("{offset_s: 0}", "after stream 'loop' has ended at 1.995 s; set clock.offset_s or clock.estimate"),
        ("{estimate: {channel: angle, against: loop/angle}}", "correlate by -1.00 at best"),
        ("{estimate: {channel: torque, against: loop/angle, within_s: 2000}}", "another within_s decides"),
        ("{estimate: {channel: angle, against: daq/torque}}", "is a channel of the same stream"),
        ("{estimate: {channel: angle, against: loop/none}}", "no channel 'loop/none' is mapped"),
        ("{}", "give either offset_s or estimate"),
    ],
)
def test_clocks_that_disagree(folder, clock, told):
    daq = {"t": (T + 1000.0).tolist(), "m": np.random.default_rng(1).normal(size=N).tolist(), "q": ANGLE.tolist()}
    (folder / "a.json").write_text(json.dumps({"t": T.tolist(), "q": ANGLE.tolist(), "daq": daq}))
    text = textwrap.dedent(TWO_CLOCKS).format(clock=clock)
    assert any(told in fault for fault in refused(folder, text, ["a.json"]))


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.json", b'{"t": [0, 1], "q": ["a", 2]}', "a.json: 'q' row 0: 'a' is not a number"),
        ("a.json", b'{"t": [0, 1], "q": [{}, 2]}', "a.json: 'q' row 0: a group of nothing is not a number"),
        ("a.json", b'{"t": [0, 1], "q": {"x": 1}}', "'q' holds a group of x where a column of numbers was expected"),
        ("a.json", b'{"t": [0, 1], "q": [1]}', "2 stamps for 1 rows"),
        ("a.json", b'{"t": [0, 1], "q": [null, NaN]}', "column 'q' holds no number at all"),
        ("a.json", b"[1, 2", "a.json:1:6  not JSON"),
        ("a.json", b'{"t": [0, 1], "q": [1, 2], "q": [3, 4]}', "a.json: 'q' stands twice in one object"),
        ("b.csv", "t,q\n0,1\n1,2\n".encode("utf-16"), "it begins as a text in utf-16 does; csv.encoding decides"),
        ("a.json", b"[" * 100_000, "a.json"),
        ("a.json", b"\xff\xfe", "not UTF-8"),
        ("a.json", b"[]", "no record of the file has 'q'; they have nothing"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + b"\0" * 200, "a.mat: not a MAT file that can be read"),
        ("b.csv", b"", "no row of numbers after line 1"),
        ("b.csv", b"t,q\n", "no row of numbers after line 1"),
        ("b.csv", b"t,q\n0,1\n", "1 row; at least 2 were expected"),
        ("b.csv", b"t,q,q\n0,1,2\n1,1,2\n", "the header has 'q' 2 times; give its index"),
        ("b.csv", b"\x89PNG\r\n\x1a\n", "not utf-8-sig at byte 0; its line reads '‰PNG' in cp1252"),
        (
            "b.csv",
            b"\xef\xbb\xbft,q\n" + b"0,1\n" * 9000 + b"0,\xb5\n",
            "not utf-8-sig at byte 36009; its line reads '0,µ' in cp1252 or '0,�' in cp949 or '0,ｵ' in shift_jis"
            " or '0,�' in gbk; csv.encoding decides",
        ),
        ("b.csv", b"t,q\n0,1,2\n1,2,3\n", "line 2: 3 cells where 2 were expected; is a decimal comma taken"),
        ("b.csv", b"t,q,w\n0,1\n1,2\n", "line 2: 2 cells where 3 were expected"),
        ("b.csv", b"t,q\n0,1_5\n1,2\n2,1_5\n", "column 'q': '1_5' is not a number"),
        ("b.csv", b't,q\n0,"' + b"1" * 200_000 + b'"\n', "line 2: field larger than field limit"),
        ("b.xls", b"x", "the ending does not tell its format"),
    ],
)
def test_files_that_are_something_else(folder, name, content, told):
    (folder / name).write_bytes(content)
    text = PLAIN.replace("      speed: {column: w, quantity: velocity}\n", "")
    assert any(told in fault for fault in refused(folder, text, [name]))


def test_a_mat_file_that_was_cut_is_called_truncated(folder):
    savemat("a.mat", {"t": T, "q": ANGLE})
    (folder / "a.mat").write_bytes((folder / "a.mat").read_bytes()[:-100])
    text = PLAIN.replace("      speed: {column: w, quantity: velocity}\n", "")
    assert refused(folder, text, ["a.mat"]) == ["a.mat: truncated: the file ends within a variable; copy it again"]


def test_every_source_is_checked_before_the_first_is_written(folder):
    write_csv(folder / "b.csv", {"t": T, "q": ANGLE})
    write_csv(folder / "c.csv", {"t": T[::-1], "q": ANGLE, "w": SPEED})
    faults = refused(folder, sources=["a.csv", "b.csv", "c.csv"])
    assert len(faults) == 2
    assert "b.csv has no column 'w'" in faults[0]
    assert "c.csv: line 3, column 't'" in faults[1]


def test_nothing_is_overwritten_and_nothing_is_left_over(folder):
    import_runs(["a.csv"], mapping(folder, PLAIN), folder / "out")
    before = (folder / "out" / "a.h5").read_bytes()
    write_csv(folder / "b.csv", {"t": T, "q": ANGLE, "w": SPEED})
    with pytest.raises(InputError, match=r"a\.h5: exists already"):
        import_runs(["b.csv", "a.csv"], mapping(folder, PLAIN), folder / "out")
    assert [path.name for path in (folder / "out").iterdir()] == ["a.h5"]
    assert (folder / "out" / "a.h5").read_bytes() == before


def test_sources_of_one_name(folder):
    (folder / "x").mkdir()
    (folder / "x" / "a.csv").write_bytes((folder / "a.csv").read_bytes())
    assert "a.h5: several sources make this file" in refused(folder, sources=["a.csv", "x/a.csv"])[0]


def test_the_command_answers_in_text_json_and_status(folder):
    mapping(folder, PLAIN)
    done = leactl("runs", "import", folder / "a.csv", "--map", folder / "map.yaml", "--out", folder / "out", "--json")
    assert json.loads(done.stdout) == {"files": [str(folder / "out" / "a.h5")], "written": True, "notes": []}
    for arguments in ([folder / "a.csv"], [folder / "none.csv"], [folder]):
        again = leactl("runs", "import", *arguments, "--map", folder / "map.yaml", "--out", folder / "out")
        assert again.returncode == 2
        assert again.stderr.startswith("leactl: ")
        assert "Traceback" not in again.stderr


def test_a_check_tells_what_would_be_written_and_writes_nothing(folder):
    text = (
        PLAIN + "steps: [{name: hold, start_s: 0.5, stop_s: 1.5, parameters: {current_A: 0.25, direction: rising}}]\n"
    )
    mapping(folder, text + "parameters: {hold_s: 1.0}\nrun: {protocol: friction}\n")
    spoilt(folder, 7, 1, "")
    arguments = ("runs", "import", folder / "a.csv", "--map", folder / "map.yaml", "--out", folder / "out")
    before = sorted(folder.iterdir())
    done = leactl(*arguments, "--check")
    assert (done.returncode, done.stderr) == (0, "")
    said = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert said[0].startswith(f"{folder / 'out' / 'a.h5'}: free, created ")
    assert said[0].endswith("; not written")
    assert "stream loop: 400 rows, 0 .. 1.995 s, every 0.005 s" in said
    assert f"angle test angle {np.delete(ANGLE, 6).min():.6g} .. {ANGLE.max():.6g} rad, 1 missing" in said
    assert said[-2:] == ["1 steps", "hold 0.5 .. 1.5 s current_A 0.25, direction rising"]
    answer = json.loads(leactl(*arguments, "--check", "--json").stdout)
    assert (answer["files"], answer["written"]) == ([str(folder / "out" / "a.h5")], False)
    [run] = answer["runs"]
    assert run["streams"]["loop"]["channels"][0]["missing"] == 1
    assert run["steps"][0]["parameters"] == {"current_A": 0.25, "direction": "rising"}
    assert sorted(folder.iterdir()) == before
    assert leactl(*arguments).returncode == 0
    again = leactl(*arguments, "--check")  # what the import itself would refuse
    assert again.returncode == 2
    assert "a.h5: exists already" in again.stderr


@pytest.mark.parametrize(
    ("digits", "told"),
    [(400, "a.json: 'q' row 1: holds a number beyond any float"), (5000, "a.json: not JSON that can be read: Exceeds")],
)
def test_a_whole_number_beyond_any_float_is_one_line(folder, digits, told):
    (folder / "a.json").write_text(f'{{"t": [0, 1, 2], "q": [0, {"9" * digits}, 1], "w": [0, 1, 2]}}')
    assert any(told in fault for fault in refused(folder, sources=("a.json",)))
