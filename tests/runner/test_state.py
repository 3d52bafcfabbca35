"""State of benches on real buses is the machine's: for every user, through no link, and never out of reach unsaid."""

import json
import os
import subprocess
from pathlib import Path

import pytest
import yaml

from leactl.bench import benchfile
from leactl.errors import InputError, SafetyTrip
from leactl.runner import runs_underway, state_folder
from leactl.runner.thermal_admission import Windings
from tests.cli.terminal import COMMAND, leactl, live_run, start
from tests.latches import latch_of, trip_of

ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be another user")


@pytest.fixture
def machine(tmp_path, monkeypatch):
    place = tmp_path / "machine"
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(place))
    return place


@pytest.fixture
def open_machine(monkeypatch):
    """A machine's directory that another user reaches: those of pytest are its owner's alone."""
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        Path(place).chmod(0o755)
        monkeypatch.setenv("LEACTL_MACHINE_STATE", f"{place}/machine")
        monkeypatch.setenv("LEACTL_STATE", f"{place}/nobody's")
        yield Path(place) / "machine"


def as_another_user(call):
    """What a call answers in a process of user 65534, as text; it may import nothing that is not imported by now."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        try:
            os.umask(0o077)
            os.seteuid(65534)
            answer = str(call())
        except BaseException as error:
            answer = repr(error)
        os.write(writer, answer.encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as answered:
        text = answered.read()
    os.waitpid(child, 0)
    return text


def real_latch(bench):
    return latch_of(str(bench), in_process=False)


# -- where -------------------------------------------------------------------------------------------------------------


def test_a_real_bench_is_the_machine_s_whatever_the_user_says(machine, testbed, monkeypatch, tmp_path):
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(machine))
    real_latch(testbed).set("too fast", tmp_path)
    for name in ("LEACTL_STATE", "HOME", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
        with pytest.raises(SafetyTrip, match="too fast"):
            real_latch(testbed).refuse()
    assert [path.name for path in machine.iterdir()] == [f"testbed-{os.getpid()}.trip.json"]
    assert machine.stat().st_mode & 0o7777 == 0o1777


def test_a_served_bench_is_the_machine_s_unless_its_state_is_kept_apart(machine, monkeypatch, tmp_path):
    file, _devices, _document = benchfile.load("emulated")
    assert not state_folder.folder_of(file, in_process=False).shared
    monkeypatch.delenv("LEACTL_STATE")
    assert state_folder.folder_of(file, in_process=False) == state_folder.StateFolder(machine, shared=True)
    assert not state_folder.folder_of(file, in_process=True).shared


def test_windings_of_a_real_bench_are_recalled_by_every_user_the_hottest_of_what_is_known(
    testbed, monkeypatch, tmp_path
):
    monkeypatch.setenv("LEACTL_MACHINE_STATE", "/proc/nowhere")
    file, devices, _document = benchfile.load(str(testbed))
    warm = Windings(file, devices, cold=True)
    warm.guard.node_bounds["test"][:] = 90.0
    warm.keep_as_found()  # in the user's own place, while there is none of the machine
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(tmp_path / "machine"))
    result = Windings(file, devices)
    assert result.recalled["test"].nodes[0] > 80.0
    result.keep_as_found()
    monkeypatch.setenv("LEACTL_STATE", str(tmp_path / "foreign"))
    assert Windings(file, devices).recalled["test"].nodes[0] > 80.0
    assert (tmp_path / "machine" / f"testbed-{os.getpid()}.test.thermal.json").is_file()


@pytest.mark.parametrize("kind", ["absent", "file", "link", "foreign"])
def test_a_directory_that_cannot_be_the_machine_s_is_said_with_what_mends_it(
    machine, kind, testbed, monkeypatch, tmp_path
):
    machine = tmp_path / "none" / "machine" if kind == "absent" else tmp_path / kind
    monkeypatch.setenv("LEACTL_MACHINE_STATE", str(machine))
    if kind == "file":
        machine.write_text("")
    elif kind == "link":
        (tmp_path / "real").mkdir()
        machine.symlink_to(tmp_path / "real")
    elif kind == "foreign":
        machine.mkdir()
        lstat = os.lstat
        monkeypatch.setattr(os, "lstat", lambda path: _of_user_7(lstat(path)) if path == machine else lstat(path))
    place = state_folder.folder_of(benchfile.load(str(testbed))[0], in_process=False)
    assert (place.directory, place.shared) == (tmp_path / "state", False)
    assert place.fault.startswith(f"{machine}: ")
    finding = state_folder.examine()
    assert (finding.fine, finding.mend) == (False, f"sudo install -d -o root -m 1777 {machine}")
    assert f"{tmp_path / 'state'}, this user's alone ({machine}: " in finding.found


def _of_user_7(status):
    fields = list(status)
    fields[4] = 7
    return os.stat_result(fields)


def test_doctor_tells_where_state_is_and_makes_nothing(machine):
    rows = json.loads(leactl("doctor", "--json").stdout)["findings"]
    [row] = [row for row in rows if row["subject"] == "state"]
    assert row["found"].endswith(f"in {machine}, shared by all users")
    assert not machine.exists()
    machine.mkdir(mode=0o755)
    rows = json.loads(leactl("doctor", "--json").stdout)["findings"]
    [row] = [row for row in rows if row["subject"] == "state"]
    assert "not every user can write there" in row["found"]
    assert row["mend"] == f"sudo install -d -o root -m 1777 {machine}"


def test_a_home_that_is_not_there_is_an_input_fault(monkeypatch):
    monkeypatch.delenv("LEACTL_STATE")
    monkeypatch.setenv("XDG_STATE_HOME", "relative")

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(InputError, match="set LEACTL_STATE"):
        state_folder.state_directory()


# -- what lies there ---------------------------------------------------------------------------------------------------


def bent(path, kind):
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "dangling":
        path.symlink_to(path.parent / "nowhere")
    elif kind == "endless":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "large":
        path.write_bytes(b" " * (state_folder.MOST_BYTES + 1))
    elif kind == "deep":
        path.write_text("[" * 50_000)


@pytest.mark.parametrize("kind", ["pipe", "dangling", "endless", "large", "deep", "folder"])
def test_a_latch_that_is_no_plain_file_holds_and_can_be_released(machine, testbed, kind, tmp_path):
    held = real_latch(testbed)
    path = Path(held.paths[0])
    bent(path, kind)
    with pytest.raises(SafetyTrip, match="cannot be read"):
        held.refuse()
    done = leactl("bench", "reset", f"testbed-{os.getpid()}", "--yes")
    assert done.returncode == 0, done.stderr
    assert held.trip() is None
    assert not (path.parent / "nowhere").exists()


@pytest.mark.parametrize("kind", ["pipe", "dangling", "endless", "large", "deep", "folder"])
def test_a_winding_memory_that_is_no_plain_file_counts_as_hot(testbed, kind):
    file, devices, _document = benchfile.load(str(testbed))
    bent(state_folder.folder_of(file, in_process=False).winding_file(f"{file.name}.test"), kind)
    assert Windings(file, devices).recalled["test"].nodes.tolist() == [130.0] * 3


def test_nothing_is_written_through_a_link(machine, testbed, tmp_path):
    target = tmp_path / "precious"
    target.write_text("kept")
    held = real_latch(testbed)
    Path(held.paths[0]).symlink_to(target)
    with pytest.raises(Exception, match="could not be latched"):
        held.set("too fast", tmp_path)
    assert target.read_text() == "kept"
    assert held.trip() is not None  # the link itself holds the bench


def test_files_that_are_no_run_s_stop_no_stop(tmp_path):
    place = state_folder.of_user().runs
    for kind in ("pipe", "dangling", "endless", "folder"):
        bent(place / f"{kind}.run", kind)
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True):
        runs, faults = runs_underway.running()
    assert [run.bench for run in runs] == ["rig"]
    assert len(faults) == 4  # one of them may stand where the file of a run was


# -- several users -----------------------------------------------------------------------------------------------------


@ROOT
def test_a_latch_of_one_user_holds_another_who_may_release_it(open_machine, tmp_path):
    held = real_latch("testbed")
    held.set("root's", tmp_path)

    def released():
        cause = held.trip().cause
        held.release()
        return cause, held.trip()

    assert as_another_user(released) == '("root\'s", None)'
    assert trip_of("testbed") is None
    assert as_another_user(lambda: held.set("theirs", tmp_path)) == "None"
    assert trip_of("testbed").cause == "theirs"


@ROOT
def test_windings_of_one_user_are_kept_on_by_another(open_machine):
    file, devices, _document = benchfile.load("testbed")

    def kept(**how):
        windings = Windings(file, devices, **how)
        windings.keep_as_found()
        return windings.recalled["test"].known

    assert kept(cold=True) == "said to be cold"
    assert as_another_user(kept).startswith("at rest since")
    assert as_another_user(lambda: kept(cold=True)) == "said to be cold"
    assert kept().startswith("at rest since")


@ROOT
def test_every_user_may_stop_what_runs_on_real_buses(open_machine):
    with runs_underway.announced("rig", "rig.yaml", "hold", is_needed=True, folder=state_folder.of_machine()) as run:
        assert as_another_user(lambda: runs_underway.running()[0][0].ask_to_stop()) == "None"
        assert run.stop_cause()


# -- a bench on a real bus ---------------------------------------------------------------------------------------------


@pytest.fixture
def served(tmp_path, monkeypatch, machine):
    """Options that reach a served bench, and its pty."""
    monkeypatch.chdir(tmp_path)
    bench = yaml.safe_load((benchfile.SHIPPED / "emulated.yaml").read_text())
    for role in ("test", "load"):
        bench["devices"][f"drive_{role}"]["settings"] |= {"consumer_heartbeat_ms": 1000, "sdo_timeout_s": 1.0}
    bench["limits"] |= {"age_s": 30, "cyclic_age_s": 30}
    seldom = {"in_a_row": 10_000, "share_percent": 99, "window_s": 600}
    bench["interlocks"] = {"clock": {"jump_s": 10}, "loop_overruns": seldom}
    del bench["buses"]["i2c1"], bench["devices"]["torque_sensor"]
    bench["buses"]["can0"] |= {"interface": "pty", "options": {"sleep_after_open": 0.0}}
    (tmp_path / "sv.yaml").write_text(yaml.safe_dump(bench))
    command = [*COMMAND, "bench", "serve", "sv.yaml", "--setup", "free"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    where = server.stdout.readline().split()
    while server.stdout.readline() != "serving; Ctrl-C ends it\n":
        assert server.poll() is None
    yield where[-1]
    server.kill()
    server.communicate()


def test_another_state_home_or_spelling_leads_to_no_running_bench(tmp_path, served):
    (tmp_path / "by-id").symlink_to(served)
    (tmp_path / "again.yaml").write_text((tmp_path / "sv.yaml").read_text().replace("name: emulated", "name: other"))
    options = ["--served", f"--bus=can0=slcan:{served}", "--setup", "free", "--out", "runs"]
    run = start("bench", "jog", "sv.yaml", *options, "--current", "1", "--for", "60")
    try:
        live_run(tmp_path, run)
        for bench, port, changes in (
            ("sv.yaml", served, {"LEACTL_STATE": str(tmp_path / "stB")}),
            ("sv.yaml", served, {"HOME": str(tmp_path / "home"), "LEACTL_STATE": ""}),
            ("again.yaml", tmp_path / "by-id", {"LEACTL_STATE": str(tmp_path / "stB")}),
        ):
            words = ["--served", f"--bus=can0=slcan:{port}", "--current", "-3", "--setup", "free"]
            done = leactl("bench", "jog", bench, *words, **os.environ | changes)
            assert (done.returncode, done.stdout) == (5, ""), done.stderr
            assert f"bus 'can0' ({served}) is driven by another run, process {run.pid};" in done.stderr
            assert len(done.stderr.splitlines()) == 1
        assert run.poll() is None
        assert leactl("bench", "stop").returncode == 0
    finally:
        run.kill()
        run.communicate()
