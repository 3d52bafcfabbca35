"""Traces of runs: every byte of every wire, read up to the last whole line, and replayed against the drivers."""

import json
import math
import signal
import time
from contextlib import suppress
from pathlib import Path

import can
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.elmo_can.driver import ElmoCan
from leactl_plugins.elmo_serial.driver import ElmoSerial

from leactl.bench import benchfile
from leactl.bench.wire_replay import ReplayWiring, replay
from leactl.bench.wire_trace import HEAD, KINDS, TracedCan, TraceLine, WireTrace, frame_text, outcome_text, read_trace
from leactl.driver.contract import Row, SampleBlock
from leactl.errors import InputError
from tests.cli.answers import fits_the_page
from tests.cli.terminal import leactl, start

PROTOCOL = """
name: spin
setup: free
rate_Hz: 50
steps:
  - mode: {test: current}
  - hold: {role: test, current_A: 1.0, duration_s: 0.4}
  - mode: {test: "off"}
"""


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """Run the protocol on a bench with a trace, once for each; gives the trace and the bench file."""
    folder = tmp_path_factory.mktemp("traces")
    (folder / "spin.yaml").write_text(PROTOCOL)
    made = {}

    def run(kind, faults=(), name="run.trace"):
        if (kind, len(faults), name) in made:
            return made[kind, len(faults), name]
        data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
        data["name"] = f"traced-{len(made)}"
        data["emulated"]["faults"] = list(faults)
        for role in ("test", "load") if kind == "serial" else ():
            data["buses"][f"line_{role}"] = {"kind": "serial", "baudrate": 115200}
            own = {"driver": "elmo_serial", "bus": f"line_{role}", "settings": {"counts_per_turn": 40000}}
            data["devices"][f"drive_{role}"] |= own
        place = folder / str(len(made))
        place.mkdir()
        (place / "bench.yaml").write_text(yaml.safe_dump(data))
        words = (folder / "spin.yaml", "--bench", place / "bench.yaml", "--out", place, "--trace", place / name)
        done = leactl("run", *words, LEACTL_STATE=str(place / "state"))
        assert done.returncode == (5 if faults else 0), done.stderr
        made[kind, len(faults), name] = place / name, place / "bench.yaml"
        return made[kind, len(faults), name]

    return run


READ = ("read", "--for", "0.3")
FOLLOW = ("read", "--follow", "--every", "0.1", "--for", "0.3")
JOG = ("jog", "--current", "1", "--for", "0.3")
TURN = ("jog", "--angle", "0.05", "--for", "0.2")  # reads the angle in a run of its own first
ASK = ("check", "--devices")
MOVE = ("check", "--move")
BY_HAND = {"read": (READ, 1), "follow": (FOLLOW, 1), "zero": (("zero",), 1), "jog": (JOG, 1), "turn": (TURN, 2)}
BY_HAND |= {"ask": (ASK, 1), "move": (MOVE, 2)}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a bench of its own, where the tests of `leactl bench` write."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    write_bench(lambda _: None)
    return tmp_path


def write_bench(change):
    data = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    change(data)
    Path("bench.yaml").write_text(yaml.safe_dump(data, sort_keys=False))


def by_hand(words, trace):
    """Call a command of `leactl bench` on the bench of this folder, with a trace."""
    return leactl("bench", words[0], "bench.yaml", *words[1:], "--trace", trace)


def replayed(trace, bench):
    file, devices, _ = benchfile.load(str(bench))
    return replay(trace, file, devices)


@pytest.mark.parametrize("kind", ["can", "serial"])
def test_a_run_is_replayed_to_the_last_byte(traced, kind):
    trace, bench = traced(kind)
    result = replayed(trace, bench)
    assert (result.difference, result.raised, result.cut_short) == (None, (), False)
    wires = [line for line in read_trace(trace) if line.kind in "><!"]
    assert result.transfers == len(wires) > 300
    assert {line.owner for line in wires} == {"i2c1", *(["can0"] if kind == "can" else ["line_test", "line_load"])}


def test_a_fault_in_the_field_is_raised_again(traced):
    fault = {"fault": "drive_fault", "at_s": 1.0, "device": "drive_test", "code": 0x2340}
    trace, bench = traced("serial", [fault])
    result = replayed(trace, bench)
    assert result.difference is None
    assert result.raised == ("DeviceFault: drive_test: MF 0xB000 (short circuit)",)


@pytest.mark.parametrize(("words", "runs"), BY_HAND.values(), ids=BY_HAND)
def test_a_trace_of_what_is_done_by_hand_is_replayed_to_the_last_byte(here, words, runs):
    done = by_hand(words, "hand.trace")
    assert done.returncode == 0, done.stderr
    found, lines = replayed(Path("hand.trace"), "bench.yaml"), read_trace(Path("hand.trace"))
    assert (found.difference, found.raised, found.cut_short) == (None, (), False)
    assert found.transfers == len([line for line in lines if line.kind in "><!"]) > 200
    assert found.calls == len([line for line in lines if line.kind == "=" and line.owner != "daq"])  # has no wire
    opened = [line for line in lines if (line.owner, line.text) == ("drive_test", "open []")]
    assert len(opened) == runs == len(list(here.glob("runs/by-hand/*.h5")))
    again = leactl("driver", "replay", "hand.trace", "--bench", "bench.yaml")
    assert (again.returncode, again.stdout.split()[1]) == (0, str(found.calls))


def test_each_run_of_a_trace_is_replayed_on_drivers_of_its_own(here, monkeypatch):
    assert by_hand(TURN, "turn.trace").returncode == 0
    opened, given = [], ElmoCan.open
    monkeypatch.setattr(ElmoCan, "open", lambda self: (opened.append(self), given(self))[1])
    assert replayed(Path("turn.trace"), "bench.yaml").difference is None
    assert [drive.name for drive in opened] == ["drive_test", "drive_load"] * 2
    assert len({id(drive) for drive in opened}) == 4


@pytest.mark.parametrize("suffix", ["asc", "blf", "log"])
def test_times_in_a_log_of_frames_go_on_from_run_to_run(here, suffix):
    assert by_hand(TURN, f"turn.{suffix}").returncode == 0
    assert by_hand(TURN, "whole.trace").returncode == 0
    frames = [line for line in read_trace(Path("whole.trace")) if line.owner == "can0" and line.kind in "<>"]
    with can.LogReader(f"turn.{suffix}") as log:
        logged = list(log)
    assert [message.arbitration_id for message in logged] == [int(line.text[:3], 16) for line in frames]
    times = [message.timestamp for message in logged]
    assert times == sorted(times)
    assert times[-1] - times[0] > frames[-1].time


@pytest.mark.parametrize(("words", "runs"), BY_HAND.values(), ids=BY_HAND)
def test_a_trace_that_cannot_be_written_is_refused_before_a_device_is_opened(here, words, runs):
    (here / "old.trace").write_text("kept")
    faults = {
        "old.trace": "exists already and is never overwritten; choose another name or move it away",
        "absent/new.trace": "cannot be written: No such file or directory",
    }
    for name, fault in faults.items():
        done = by_hand(words, name)
        assert (done.returncode, done.stdout, done.stderr) == (2, "", f"leactl: {name}: {fault}\n")
    assert (here / "old.trace").read_text() == "kept"
    assert not (here / "runs").exists()


@pytest.mark.parametrize("name", ["jog.trace", "jog.asc"])
def test_what_is_refused_leaves_no_trace_in_the_way_of_the_next_attempt(here, name):
    refused = by_hand(("jog", "--current", "31"), name)
    assert refused.returncode == 2
    assert "31 A is above the bench limit of 30 A" in refused.stderr
    assert [path.name for path in here.glob("jog*")] == []
    assert by_hand(JOG, name).returncode == 0


@pytest.mark.parametrize("words", [JOG, MOVE], ids=["jog", "move"])
def test_a_dry_run_by_hand_writes_no_trace(here, words):
    assert by_hand((*words, "--dry-run"), "dry.trace").returncode == 0
    assert not (here / "dry.trace").exists()


@pytest.mark.parametrize("words", [("read", "--follow", "--every", "0.1"), ("jog", "--current", "1", "--for", "60")])
def test_a_trace_by_hand_is_whole_after_ctrl_c(here, words):
    trace = here / "hand.trace"
    process = start("bench", words[0], "bench.yaml", *words[1:], "--realtime", "--trace", str(trace))
    try:
        while process.poll() is None and not (trace.exists() and " end_cycle " in trace.read_text()):
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 4, errors
    closed = [line.owner for line in read_trace(trace) if line.text == "close []"]
    assert closed[:3] == ["drive_test", "drive_load", "torque_sensor"]
    result = replayed(trace, "bench.yaml")
    assert (result.difference, result.cut_short) == (None, False)


def test_a_fault_during_a_jog_is_raised_again(here):
    fault = {"fault": "drive_fault", "at_s": 0.5, "device": "drive_test", "code": 0x2340}
    write_bench(lambda data: data["emulated"].update(faults=[fault]))
    assert by_hand(JOG, "jog.trace").returncode == 5
    result = replayed(Path("jog.trace"), "bench.yaml")
    assert (result.difference, result.cut_short) == (None, False)
    assert [text.split(":")[:2] for text in result.raised] == [["DeviceFault", " drive_test"]]


def test_a_check_traces_each_device_that_it_tries_by_itself(here):
    write_bench(lambda data: data["devices"]["drive_load"].update(serial="another"))
    assert by_hand(ASK, "check.trace").returncode == 5
    opened = [line.owner for line in read_trace(Path("check.trace")) if line.text == "open []"]
    assert opened == ["drive_test", "drive_load", "drive_test", "drive_load", "torque_sensor", "daq"]
    assert replayed(Path("check.trace"), "bench.yaml").difference is None


def test_a_check_of_the_file_alone_has_no_trace(here):
    done = by_hand(("check",), "check.trace")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "leactl: --trace: goes with --devices or --move alone\n"
    assert not (here / "check.trace").exists()


def test_a_trace_is_on_the_disk_once_a_device_is_closed(tmp_path):
    with WireTrace(tmp_path / "run.trace") as trace:
        trace.write("can0", "<", "first")
        trace.trace_calls("drive", "close", lambda: None)()
        assert [line.kind for line in read_trace(tmp_path / "run.trace")] == ["<", "=", "~"]


def test_a_driver_that_sends_something_else_is_named_with_the_line(traced, monkeypatch):
    trace, bench = traced("serial")
    monkeypatch.setattr(ElmoSerial, "_cycle_commands", lambda *_: ["MF"])
    result = replayed(trace, bench)
    line = trace.read_text().splitlines()[result.difference.line - 1]
    assert f" {result.difference.owner} > " in line
    assert result.difference.came.startswith("'> ")


def test_a_reading_that_differs_is_named(traced, tmp_path):
    trace, bench = traced("can")
    text = trace.read_text()
    changed = tmp_path / "changed.trace"
    lines = text.splitlines(keepends=True)
    places = [number for number, line in enumerate(lines) if " can0 < 281 " in line]
    place = places[len(places) // 2]
    before, data = lines[place].rsplit(" ", 1)
    lines[place] = f"{before} {'00' * 7}01\n"
    assert data != lines[place].rsplit(" ", 1)[1]
    changed.write_text("".join(lines))
    done = leactl("driver", "replay", changed, "--bench", bench)
    assert done.returncode == 5
    assert done.stderr.startswith(f"leactl: {changed}:")
    assert "drive_test: end_cycle ended with" in done.stderr
    answer = json.loads(leactl("driver", "replay", changed, "--bench", bench, "--json").stdout)
    assert answer["difference"]["owner"] == "drive_test"
    fits_the_page("A trace, replayed", answer)


@pytest.mark.parametrize(("kind", "came"), [(">", "nothing more was sent"), ("<", "nothing more was read")])
def test_a_transfer_that_the_last_call_of_a_wire_left_out_is_named(traced, tmp_path, kind, came):
    trace, bench = traced("can")
    lines = trace.read_text().splitlines(keepends=True)
    last_end = max(number for number, line in enumerate(lines) if " drive_" in line and " ~ " in line)
    lines.insert(last_end, f"{lines[last_end].split()[0]} can0 {kind} 601 4006100000000000\n")
    changed = tmp_path / "changed.trace"
    changed.write_text("".join(lines))
    difference = replayed(changed, bench).difference
    assert difference == (last_end + 1, "can0", f"'{kind} 601 4006100000000000'", came)


def test_a_transfer_behind_the_last_of_a_wire_is_named(traced, tmp_path):
    trace, bench = traced("can")
    lines = trace.read_text().splitlines(keepends=True)
    last = max(number for number, line in enumerate(lines) if " can0 > " in line)
    changed = tmp_path / "changed.trace"
    changed.write_text("".join(line for n, line in enumerate(lines) if n < last or " can0 " not in line))
    sent = lines[last].split(" ", 3)[3].strip()
    difference = replayed(changed, bench).difference
    assert difference is not None
    assert str(difference) == f"can0: '> {sent}' was sent where the trace has nothing more of this wire"


class Volt(float):
    """A number that is not Python's own, as numpy's are."""


@pytest.mark.parametrize(
    ("result", "text"),
    [
        ([Row("s", 1.5, (Volt(2.0), math.nan), "over range")], '[["s", [2.0, NaN], "over range"]]'),
        ((), "[]"),
        ([SampleBlock("fast", np.arange(2.0), np.ones((2, 1)))], '[["fast", 2, 2946827343]]'),
        (["drive: 2 answers came late"], '["drive: 2 answers came late"]'),
        ({"torque": Volt(0.25)}, '{"torque": 0.25}'),
    ],
)
def test_what_a_call_gave_stands_in_the_trace_without_its_stamp(result, text):
    assert outcome_text(result) == text


@pytest.mark.parametrize("method", ["take", "notices"])
def test_a_row_and_a_notice_that_differ_are_named(traced, monkeypatch, method):
    trace, bench = traced("can")
    given = getattr(ElmoCan, method)

    def wrong(self):
        if method == "notices":
            return [*given(self), "all is well"]
        return [row._replace(values=tuple(2 * value for value in row.values)) for row in given(self)]

    monkeypatch.setattr(ElmoCan, method, wrong)
    result = replayed(trace, bench)
    assert result.difference.came.startswith(f"{method} ended with '[")


def test_a_trace_that_has_no_rows_yet_is_replayed_without_them(traced, tmp_path):
    trace, bench = traced("can")
    lines, method = trace.read_text().splitlines(keepends=True), {}
    for number, line in enumerate(lines[1:], start=1):
        time, owner, kind, text = line.split(" ", 3)
        if kind == "=":
            method[owner] = text.split()[0]
        elif kind == "~" and method[owner] in ("take", "notices", "tare") and text != "[]\n":
            lines[number] = f"{time} {owner} ~ null\n"
    old = tmp_path / "old.trace"
    old.write_text("".join(lines))
    assert old.stat().st_size < trace.stat().st_size
    assert replayed(old, bench).difference is None


def test_a_trace_without_calls_is_no_success(traced, tmp_path):
    trace, bench = traced("can")
    wires = tmp_path / "wires.trace"
    wires.write_text("".join(line for line in trace.read_text().splitlines(True) if line.split()[2] not in "=~"))
    for text in (wires.read_text(), f"{HEAD}\n"):
        wires.write_text(text)
        done = leactl("driver", "replay", wires, "--bench", bench)
        assert done.returncode == 2
        assert "holds no call of a device on a bus" in done.stderr


def test_a_trace_that_was_cut_off_is_replayed_as_far_as_it_goes(traced, tmp_path):
    trace, bench = traced("serial")
    data = trace.read_bytes()
    for share in (0.1, 0.5, 0.9):
        cut = tmp_path / f"{share}.trace"
        cut.write_bytes(data[: int(share * len(data))])
        result = replayed(cut, bench)
        assert result.difference is None
        assert result.calls > 0


@pytest.mark.parametrize("suffix", ["asc", "blf", "log"])
def test_can_frames_go_to_a_log_of_pythons_where_the_name_says_so(traced, suffix):
    log, bench = traced("can", name=f"run.{suffix}")
    whole, _ = traced("can")
    frames = [line for line in read_trace(whole) if line.owner == "can0" and line.kind in "<>"]
    logged = list(can.LogReader(log))
    assert [message.arbitration_id for message in logged] == [int(line.text[:3], 16) for line in frames]
    beside = read_trace(log.with_suffix(".trace"))
    assert {line.owner for line in beside if line.kind in "<>"} == {"i2c1"}
    with pytest.raises(InputError, match="holds no frame of can0: none passed, or --trace was"):
        replayed(log.with_suffix(".trace"), bench)


def test_an_error_of_several_lines_is_one_line_of_the_trace_and_is_read_as_it_was(tmp_path):
    text = "Bus light\nbus heavy \\\\n of C:\\\\new\n"

    class Broken:
        def shutdown(self): ...

        def send(self, message):
            raise can.CanError(text)

    with WireTrace(tmp_path / "run.trace") as trace, suppress(can.CanError):
        TracedCan(Broken(), "can0", trace).send(can.Message(arbitration_id=1))
    (line,) = read_trace(tmp_path / "run.trace")
    assert (line.owner, line.kind, line.text) == ("can0", "!", text)


def test_a_log_of_frames_that_cannot_be_made_leaves_no_trace_in_the_way(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patched, pytest.raises(InputError, match=r"run\.asc: cannot be written: Permission"):
        patched.setattr(can, "Logger", refuse)
        WireTrace(tmp_path / "run.asc")
    assert list(tmp_path.iterdir()) == []
    with WireTrace(tmp_path / "run.asc"):
        pass


def test_a_remote_frame_keeps_its_length_in_a_log_of_frames(tmp_path):
    with WireTrace(tmp_path / "run.asc") as trace:
        message = can.Message(arbitration_id=0x701, is_extended_id=False, is_remote_frame=True, dlc=5)
        trace.write_frame("can0", "<", message)
    with can.LogReader(tmp_path / "run.asc") as log:
        (frame,) = log
    assert (frame.arbitration_id, frame.is_remote_frame, frame.dlc) == (0x701, True, 5)


def test_a_file_that_is_there_is_not_overwritten(traced):
    trace, bench = traced("can")
    before = trace.read_bytes()
    done = leactl("run", "friction", "--bench", bench, "--trace", trace)
    assert (done.returncode, trace.read_bytes()) == (2, before)
    assert "exists already and is never overwritten" in done.stderr


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"t.trace:1  '': '# leactl wire trace 1' was expected"),
        ("nonsense\n", r"t.trace:1  'nonsense': "),
        (
            f"{HEAD}\nsoon can0 > 601\n",
            r"t.trace:2  'soon can0 > 601': seconds, a bus or a device, and one of",
        ),
        (f"{HEAD}\n0.5 can0 ? 601\n", r"t.trace:2  '0.5 can0 \? 601': "),
        (f"{HEAD}\n0.5 drive_test = explode []\n0.5 can0 > 601\n", "no call of a device of this bench"),
        (f"{HEAD}\n0.5 drive_test = open nothing\n0.5 can0 > 601\n", "arguments as a JSON list were expected"),
    ],
)
def test_what_is_no_trace_is_refused_with_its_place(tmp_path, text, message):
    path = tmp_path / "t.trace"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        replayed(path, "emulated")


@given(st.text(st.sampled_from("0.5 \n#>=~!<acnopenx[]1"), max_size=60))
@settings(max_examples=200, deadline=None)
def test_any_text_is_read_or_refused(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("any") / "t.trace"
    path.write_text(f"{HEAD}\n{text}")
    try:
        lines = read_trace(path)
    except InputError:
        return
    assert len(lines) == text.count("\n")
    assert all(math.isfinite(line.time) and line.kind in KINDS for line in lines)


def test_a_trace_on_a_full_disk_stands_in_no_drive_s_way(tmp_path):
    called = []
    # what the full disk did not take is refused once more at its close
    with (
        WireTrace(tmp_path / "run.trace") as trace,
        suppress(OSError),
        Path("/dev/full").open("w", buffering=1) as full,
    ):
        trace._text.close()
        trace._text = full
        assert trace.trace_calls("drive", "safe_state", lambda: called.append(1) or "safe")() == "safe"
        trace.write("drive", "<", "nothing more")
        assert called == [1]
        assert "nothing more was written: [Errno 28]" in trace.fault


@pytest.mark.parametrize("form", [{}, {"is_fd": True}, {"is_fd": True, "bitrate_switch": True}])
@pytest.mark.parametrize(("identifier", "extended"), [(0x101, False), (0x8001, True)])
@pytest.mark.parametrize("data", [b"", b"\xfb", b"\x01\x50" * 6])
def test_the_kind_of_a_frame_is_kept_in_its_line(form, identifier, extended, data):
    frame = can.Message(arbitration_id=identifier, is_extended_id=extended, data=data, **form)
    wiring = ReplayWiring([TraceLine(2, 0.0, "can0", "<", frame_text(frame))], ["can0"])
    wiring.call_ends = 3
    heard = wiring.can("can0", None)().recv(0.0)
    assert heard.equals(frame, timestamp_delta=None, check_direction=False)
