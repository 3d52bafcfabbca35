"""Traces of runs: every byte of every wire, read up to the last whole line, and replayed against the drivers."""

import json
import math
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
from tests.cli.terminal import leactl

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


def replayed(trace, bench):
    file, devices, _ = benchfile.load(str(bench))
    return replay(trace, file, devices)


@pytest.mark.parametrize("kind", ["can", "serial"])
def test_a_run_is_replayed_to_the_last_byte(traced, kind):
    trace, bench = traced(kind)
    found = replayed(trace, bench)
    assert (found.difference, found.raised, found.cut_short) == (None, (), False)
    wires = [line for line in read_trace(trace) if line.kind in "><!"]
    assert found.transfers == len(wires) > 300
    assert {line.owner for line in wires} == {"i2c1", *(["can0"] if kind == "can" else ["line_test", "line_load"])}


def test_a_fault_in_the_field_is_raised_again(traced):
    fault = {"fault": "drive_fault", "at_s": 1.0, "device": "drive_test", "code": 0x2340}
    trace, bench = traced("serial", [fault])
    found = replayed(trace, bench)
    assert found.difference is None
    assert found.raised == ("DeviceFault: drive_test: MF 0xB000 (short circuit)",)


def test_a_driver_that_sends_something_else_is_named_with_the_line(traced, monkeypatch):
    trace, bench = traced("serial")
    monkeypatch.setattr(ElmoSerial, "_demands", lambda *_: ["MF"])
    found = replayed(trace, bench)
    line = trace.read_text().splitlines()[found.difference.line - 1]
    assert f" {found.difference.owner} > " in line
    assert found.difference.came.startswith("'> ")


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
    told = json.loads(leactl("driver", "replay", changed, "--bench", bench, "--json").stdout)
    assert told["difference"]["owner"] == "drive_test"
    fits_the_page("A trace, replayed", told)


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
    found = replayed(trace, bench)
    assert found.difference.came.startswith(f"{method} ended with '[")


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
        found = replayed(cut, bench)
        assert found.difference is None
        assert found.calls > 0


@pytest.mark.parametrize("suffix", ["asc", "blf", "log"])
def test_can_frames_go_to_a_log_of_pythons_where_the_name_says_so(traced, suffix):
    log, bench = traced("can", name=f"run.{suffix}")
    whole, _ = traced("can")
    frames = [line for line in read_trace(whole) if line.owner == "can0" and line.kind in "<>"]
    logged = list(can.LogReader(log))
    assert [message.arbitration_id for message in logged] == [int(line.text[:3], 16) for line in frames]
    beside = read_trace(log.with_suffix(".trace"))
    assert {line.owner for line in beside if line.kind in "<>"} == {"i2c1"}
    with pytest.raises(InputError, match="holds no frame of can0; a trace that can be replayed has a name"):
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
        trace.frame("can0", "<", can.Message(arbitration_id=0x701, is_extended_id=False, is_remote_frame=True, dlc=5))
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
        assert trace.called("drive", "safe_state", lambda: called.append(1) or "safe")() == "safe"
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
