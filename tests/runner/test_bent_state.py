"""What a person, another program or a broken disk may leave where state is kept: nothing is followed or waited for.

Whatever cannot be read is latched and hot; `bench stop` stops what it can read and then complains; `bench reset` clears
all that can latch. One table of bent files over latch, winding memory, file of a run and lock of a folder.
"""

import json
import os
import socket
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from leactl.bench import benchfile
from leactl.errors import DeviceError, InputError, SafetyTrip
from leactl.model.motor import load_motor
from leactl.runner import lock_holders, locks, runs_underway, state_folder
from leactl.runner.boot_time import ClockReadings
from leactl.runner.thermal_memory import Memory
from tests.cli.terminal import leactl
from tests.latches import latch_of

LIMIT = 130.0
NOW = ClockReadings(1.7e9, "this boot", 5000.0)


def sparse(path):
    path.touch()
    os.truncate(path, 1 << 30)


def listening(path):
    with socket.socket(socket.AF_UNIX) as made:
        here = Path.cwd()
        os.chdir(path.parent)  # a socket's address is short
        try:
            made.bind(path.name)
        finally:
            os.chdir(here)


def full_folder(path):
    (path / "deeper").mkdir(parents=True)
    (path / "deeper" / "file").write_text("kept")


def link_to(target, text=None):
    def make(path):
        there = path.parent / target
        if text is not None:
            there.write_text(text)
        path.symlink_to(there)

    return make


def link_to_a_pipe(path):
    os.mkfifo(path.parent / "far pipe")
    path.symlink_to("far pipe")


def ring(path):
    path.symlink_to("one")
    (path.parent / "one").symlink_to("another")
    (path.parent / "another").symlink_to(path.name)


BENT = {
    "pipe": os.mkfifo,
    "socket": listening,
    "link to zeros without end": link_to("/dev/zero"),
    "dangling link": link_to("nowhere"),
    "link to itself": lambda path: path.symlink_to(path.name),
    "link to a folder": link_to("/proc"),
    "link to a good file": link_to("good", "{}\n"),
    "empty folder": Path.mkdir,
    "full folder": full_folder,
    "empty": Path.touch,
    "a gigabyte of holes": sparse,
    "deep JSON": lambda path: path.write_text("[" * 50_000),
    "deep JSON in a line": lambda path: path.write_text("--" + "[" * 50_000 + "\n"),
    "cut short": lambda path: path.write_text('{"bench": "testb'),
    "a list": lambda path: path.write_text("[1, 2, 3]\n"),
    "a number": lambda path: path.write_text("7\n"),
    "null": lambda path: path.write_text("null\n"),
    "noise": lambda path: path.write_bytes(bytes(range(256)) * 8),
    "NaN": lambda path: path.write_text('{"time": NaN, "nodes_degC": [NaN, 1e999, -1e999]}\n'),
    "link to a pipe": link_to_a_pipe,
    "link to a full device": link_to("/dev/full"),
    "link to a process's memory": link_to("/proc/self/mem"),
    "links in a ring": ring,
    "zeros, as after a loss of power": lambda path: path.write_bytes(bytes(4096)),
    "spaces": lambda path: path.write_bytes(b" " * 4096),
    "a byte": lambda path: path.write_bytes(b"{"),
    "a line break": lambda path: path.write_bytes(b"\n"),
    "one byte too many": lambda path: path.write_bytes(b"{}" + b" " * (state_folder.MOST_BYTES - 1)),
    "UTF-16": lambda path: path.write_bytes('{"bench": "testbed"}\n'.encode("utf-16")),
    "a byte order mark": lambda path: path.write_bytes(b'\xef\xbb\xbf{"bench": "testbed"}\n'),
    "no UTF-8": lambda path: path.write_bytes(b'{"bench": "\xff\xfe\x80"}\n'),
    "half a character": lambda path: path.write_text('{"bench": "\\ud800", "cause": "\\udfff", "time": "\\ud800"}\n'),
    "a number of 5000 digits": lambda path: path.write_text('{"time": ' + "9" * 5000 + "}\n"),
    "two objects": lambda path: path.write_text("{} {}\n"),
    "a text": lambda path: path.write_text('"released"\n'),
    "true": lambda path: path.write_text("true\n"),
    "keys of nothing": lambda path: path.write_text('{"": null, "released": "true", "cause": {}, "time": []}\n'),
}


@pytest.fixture(params=BENT, ids=[name.replace(" ", "-") for name in BENT])
def bend(request):
    def bent(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        BENT[request.param](path)
        return request.param

    return bent


@pytest.fixture
def held(testbed):
    return latch_of(str(testbed), in_process=False)


def test_a_bent_latch_holds_and_a_reset_clears_it(held, bend, tmp_path):
    path = Path(held.paths[0])
    bend(path)
    with pytest.raises(SafetyTrip, match=r"unknown, .* cannot be read"):
        held.refuse()
    done = leactl("bench", "reset", held.bench, "--yes")
    assert (done.returncode, done.stdout) == (0, f"{held.bench}: released\n"), done.stderr
    held.refuse()
    held.set("too fast", tmp_path)
    with pytest.raises(SafetyTrip, match="too fast"):
        held.refuse()


def test_a_bent_winding_memory_is_hot_and_a_new_one_goes_nowhere_else(bend, tmp_path):
    memory = Memory(
        "rig.test", load_motor("lea")[0], LIMIT, 25.0, state_folder.StateFolder(tmp_path / "state", shared=False)
    )
    bend(memory.path)
    before = sorted(tmp_path.rglob("*"))
    result = memory.recall(NOW)
    assert result.nodes.tolist() == [LIMIT] * 3
    assert result.known.startswith("counts as hot: ")
    with suppress(OSError):  # a file that can be written is mended by the next run
        memory.keep(np.full(3, 40.0), NOW, running=False)
        assert memory.recall(NOW).nodes[0] < LIMIT
    assert sorted(tmp_path.rglob("*")) == before
    good = memory.path.parent / "good"
    assert not good.exists() or good.read_text() == "{}\n"


def test_a_bent_file_beside_that_of_a_run_keeps_nobody_from_stopping_it(bend):
    runs = state_folder.of_user().runs
    kind = bend(runs / "other.1.abcd.run")
    regular = (runs / "other.1.abcd.run").is_file() and not (runs / "other.1.abcd.run").is_symlink()
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True) as run:
        answers = []
        asking = threading.Thread(target=lambda: answers.append(leactl("bench", "stop", "--wait", "0", "--json")))
        asking.start()
        asking.join(60.0)
        assert run.stop_cause(), kind
    [done] = answers
    assert done.returncode == 5
    assert done.stdout.count('"bench": "rig"') == 1
    assert ("other.1.abcd.run: cannot be read" in done.stderr) is not regular, done.stderr
    assert "internal" not in done.stderr


def test_a_bent_lock_of_a_folder_is_refused_or_held(bend, tmp_path):
    path = tmp_path / "campaign" / ".lock"
    kind = bend(path)
    if path.is_file() and not path.is_symlink():
        with (
            locks.locked(path, "taken"),
            pytest.raises(DeviceError, match="taken"),
            locks.locked(path, "taken"),
        ):
            raise AssertionError
        return
    with pytest.raises(InputError, match="no lock can be kept here"), locks.locked(path, "taken"):
        raise AssertionError(kind)


# -- directories -----------------------------------------------------------------------------------------------------

DIRECTORIES = ("pipe", "dangling link", "link to itself", "link to zeros without end", "empty", "noise")


@pytest.mark.parametrize("kind", DIRECTORIES)
def test_where_the_user_s_runs_are_bent_those_of_the_machine_are_stopped(tmp_path, monkeypatch, kind):
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(tmp_path / "machine"))
    bent = state_folder.of_user().runs
    bent.parent.mkdir(parents=True, exist_ok=True)
    BENT[kind](bent)
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True, folder=state_folder.of_machine()) as run:
        done = leactl("bench", "stop", "--wait", "0")
        assert run.stop_cause()
    assert done.returncode == 5
    assert f"{bent}: a directory of runs was expected" in done.stderr


@pytest.mark.parametrize("kind", DIRECTORIES)
def test_where_the_machine_s_directory_is_bent_a_latch_is_kept_and_found_elsewhere(
    testbed, tmp_path, monkeypatch, kind
):
    bent = tmp_path / "bent"
    BENT[kind](bent)
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(bent))
    held = latch_of(str(testbed), in_process=False)
    assert held.paths[0].startswith(str(tmp_path / "state"))
    with suppress(SafetyTrip):  # where what is bent may have held a latch
        held.refuse()
    held.set("too fast", tmp_path)
    with pytest.raises(SafetyTrip):
        held.refuse()


@pytest.mark.parametrize(
    ("variable", "words"),
    [
        ("LEACTL_STATE", ["run", "friction", "--dry-run"]),  # which keeps nothing in the machine's
        ("LEACTL_STATE", ["bench", "stop"]),
        ("LEACTL_STATE", ["bench", "reset", "testbed"]),
        ("LEACTL_MACHINE_STATE", ["bench", "stop"]),
        ("LEACTL_MACHINE_STATE", ["bench", "reset", "testbed"]),
    ],
)
def test_a_relative_directory_of_state_is_refused(tmp_path, monkeypatch, variable, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    monkeypatch.setenv(variable, "here")
    done = leactl(*words)
    assert done.returncode == (5 if words[1] == "stop" else 2), done.stderr
    assert f"{variable} is here: an absolute path was expected" in done.stderr
    assert not (tmp_path / "here").exists()


@pytest.mark.parametrize("xdg", ["relative/state", "./state", ".", ""])
def test_a_relative_xdg_directory_is_that_of_the_home(tmp_path, monkeypatch, xdg):
    monkeypatch.delenv("LEACTL_STATE")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", xdg)
    assert state_folder.state_directory() == tmp_path / ".local" / "state" / "leactl"


def test_without_a_home_the_machine_s_runs_are_stopped_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(tmp_path / "machine"))
    monkeypatch.delenv("LEACTL_STATE")
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True, folder=state_folder.of_machine()):
        runs, faults = runs_underway.running()
    assert [run.bench for run in runs] == ["rig"]
    assert faults == ["there is no home directory for leactl's state; set LEACTL_STATE to a directory"]


# -- in a run --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["removed", "moved", "replaced", "bent", "folder removed"])
def test_a_run_whose_file_goes_is_found_again(how):
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True) as run:
        run.renew()
        [path] = state_folder.of_user().runs.glob("*.run")
        run.tell(run="here.h5")
        if how == "moved":
            path.rename(path.with_suffix(".old"))
        else:
            path.unlink()
        if how == "replaced":
            path.write_text('--{"bench": "other"}\n')
        elif how == "bent":
            os.mkfifo(path)
        elif how == "folder removed":
            path.parent.rmdir()
        run.renew()
        [found], faults = runs_underway.running()
        assert (found.bench, found.facts()["run"], faults) == ("rig", "here.h5", [])
        found.ask_to_stop()
        assert run.stop_cause()
        found.close()
    assert not list(state_folder.of_user().runs.glob("*.run"))


def test_a_bench_that_is_held_without_a_file_is_said_to_be(testbed, holder):
    name = benchfile.load(str(testbed))[0].name
    assert lock_holders.holder(lock_holders.lock_of(f"bench-{name}"))[0] == holder.pid
    for word in (name, str(testbed)):
        done = leactl("bench", "stop", word)
        assert done.returncode == 5
        assert f"bench '{name}' is driven by process {holder.pid}, whose file cannot be found" in done.stderr
        assert f"kill {holder.pid}" in done.stderr


# -- clocks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "bent",
    [
        {"time": "yesterday"},
        {"time": None},
        {"time": 1e400},
        {"time": float("nan")},
        {"since_boot_s": -1.0},
        {"since_boot_s": 5000.1},  # of the same boot, and to come
        {"since_boot_s": float("nan")},
        {"since_boot_s": "5"},
        {"since_boot_s": []},
        {"boot": 7},
        {"boot": None},
        {"running": 0},
        {"running": "false"},
        {"running": None},
        {"running": []},
        {"time": True},
        {"time": [1.7e9]},
        {"time": {}},
        {"time": 10**400},
        {"since_boot_s": True},
        {"since_boot_s": None},
        {"since_boot_s": {}},
        {"since_boot_s": 1e400},
        {"since_boot_s": -1e400},
        {"since_boot_s": 10**400},
        {"boot": ["this boot"]},
        {"boot": {"this boot": 1}},
        {"boot": True},
    ],
    ids=str,
)
def test_a_bent_clock_in_a_memory_is_hot(tmp_path, bent):
    memory = Memory("rig.test", load_motor("lea")[0], LIMIT, 25.0, state_folder.StateFolder(tmp_path, shared=False))
    memory.keep(np.full(3, 40.0), NOW, running=False)
    assert memory.recall(NOW).nodes[0] < 41.0
    kept = json.loads(memory.path.read_text()) | bent
    memory.path.write_text(json.dumps(kept))
    assert memory.recall(NOW).nodes.tolist() == [LIMIT] * 3


# -- what a memory tells of a winding ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "bent",
    [
        {"nodes_degC": None},
        {"nodes_degC": 40.0},
        {"nodes_degC": "40 40 40"},
        {"nodes_degC": {"0": 40.0, "1": 40.0, "2": 40.0}},
        {"nodes_degC": []},
        {"nodes_degC": [40.0]},
        {"nodes_degC": [40.0, 40.0]},
        {"nodes_degC": [40.0, 40.0, 40.0, 40.0]},
        {"nodes_degC": [[40.0, 40.0, 40.0]]},
        {"nodes_degC": [40.0, 40.0, None]},
        {"nodes_degC": [40.0, 40.0, "40"]},
        {"nodes_degC": [40.0, 40.0, True]},
        {"nodes_degC": [float("nan"), 40.0, 40.0]},
        {"nodes_degC": [40.0, float("nan"), 40.0]},
        {"nodes_degC": [40.0, 40.0, float("nan")]},
        {"nodes_degC": [float("inf"), 40.0, 40.0]},
        {"nodes_degC": [float("-inf"), 40.0, 40.0]},
        {"nodes_degC": [-300.0, 40.0, 40.0]},
        {"nodes_degC": [40.0, 40.0, 1e6]},
        {"nodes_degC": [10**400, 40.0, 40.0]},
        {"format": None},
        {"format": "leactl"},
        {"format": ["leactl-thermal"]},
        {"format_version": 2},
        {"format_version": 4},
        {"format_version": "3"},
        {"format_version": None},
        {"actuator": "rig.load"},
        {"actuator": None},
        {"actuator": ["rig.test"]},
        {"motor_sha256": ""},
        {"motor_sha256": None},
        {"motor_sha256": "0" * 64},
    ],
    ids=str,
)
def test_a_bent_memory_of_a_winding_is_hot(tmp_path, bent):
    memory = Memory("rig.test", load_motor("lea")[0], LIMIT, 25.0, state_folder.StateFolder(tmp_path, shared=False))
    memory.keep(np.full(3, 40.0), NOW, running=False)
    kept = json.loads(memory.path.read_text()) | bent
    memory.path.write_text(json.dumps(kept))
    result = memory.recall(NOW)
    assert result.nodes.tolist() == [LIMIT] * 3
    assert result.known.startswith("counts as hot: ")


@pytest.mark.parametrize(
    "left_out",
    [
        "format",
        "format_version",
        "actuator",
        "motor_sha256",
        "time",
        "boot",
        "since_boot_s",
        "running",
        "nodes_degC",
        "left_on_degC",
    ],
)
def test_a_memory_that_lacks_a_key_is_hot(tmp_path, left_out):
    memory = Memory("rig.test", load_motor("lea")[0], LIMIT, 25.0, state_folder.StateFolder(tmp_path, shared=False))
    memory.keep(np.full(3, 40.0), NOW, running=False)
    kept = json.loads(memory.path.read_text())
    del kept[left_out]
    memory.path.write_text(json.dumps(kept))
    assert memory.recall(NOW).nodes.tolist() == [LIMIT] * 3


# -- what a terminal is told of bent texts -----------------------------------------------------------------------------

TEXTS = {
    "escapes": "\x1b]0;mine\x07\x1b[2J",
    "a return": "all is well\r",
    "lines": "all is well\nbench 'rig': released",
    "half a character": "\ud800",
    "turned writing": "\u202etset",
    "nothing": "\0",
    "a thousand": "x" * 1000,
}


@pytest.mark.parametrize("key", ["cause", "time", "run", "bench"])
@pytest.mark.parametrize("text", TEXTS.values(), ids=list(TEXTS))
def test_a_bent_text_in_a_latch_holds_and_moves_no_terminal(held, testbed, key, text):
    trip = {"bench": "testbed", "cause": "too fast", "time": "2026-01-01T00:00:00+00:00", "run": "a.h5"} | {key: text}
    path = Path(held.paths[0])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(trip) + "\n")
    with pytest.raises(SafetyTrip):
        held.refuse()
    asked = leactl("bench", "reset", held.bench)
    refused = leactl("run", "friction", "--bench", str(testbed), "--dry-run")
    assert refused.returncode == 3, refused.stderr
    for done in (asked, refused):
        assert "\nbench 'rig'" not in done.stdout + done.stderr
        assert not {*"\x1b\x07\0\r\u202e"} & {*done.stdout, *done.stderr}
        assert "Traceback" not in done.stderr
        assert "internal" not in done.stderr
    assert leactl("bench", "reset", held.bench, "--yes").returncode == 0
    held.refuse()


@pytest.mark.parametrize("key", ["bench", "file", "protocol", "process", "status", "reason", "run"])
@pytest.mark.parametrize("text", [*TEXTS.values(), ["a list"], None], ids=[*TEXTS, "a list", "null"])
def test_a_bent_text_in_a_run_s_file_is_stopped_and_moves_no_terminal(key, text):
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True) as run:
        run.tell(**{key: text})
        done = leactl("bench", "stop", "--wait", "0")
        assert run.stop_cause()
    assert done.returncode == 5
    assert "\nbench 'rig': released" not in done.stdout + done.stderr
    assert not {*"\x1b\x07\0\r\u202e"} & {*done.stdout, *done.stderr}
    assert "Traceback" not in done.stderr
    assert "internal" not in done.stderr


@pytest.fixture(autouse=True)
def own_state(tmp_path, monkeypatch):
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "state"))
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(tmp_path / "machine"))
