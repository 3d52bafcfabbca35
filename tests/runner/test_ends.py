"""What comes after the bench is safe may fail: a trip is latched and told, whatever file, bus or disk do then."""

import json
import os
import signal
import threading
from pathlib import Path

import pytest
from leactl_plugins.ads1115.driver import Ads1115
from leactl_plugins.elmo_can.driver import ElmoCan

from leactl.driver.contract import Confirmation
from leactl.emulation.wires.buses import EmulatedI2cBus
from leactl.errors import DeviceError, InputError, SafetyTrip
from leactl.runfile.write import writer
from leactl.runfile.write.writer import RecordingFailed
from leactl.runner.flushing import ThreadedFlush
from leactl.runner.thermal_admission import Windings
from leactl.safety.supervisor import Supervisor
from tests.cli.terminal import leactl
from tests.latches import latch_of, trip_of
from tests.runner.conftest import SPIN

TRIPPING = ("current_A=2.5", "hold_s=2")


@pytest.mark.parametrize("place", [EmulatedI2cBus, Ads1115])
def test_a_device_that_fails_to_close_hides_no_trip(spin, monkeypatch, place):
    def fail(_self):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(place, "close", fail, raising=False)
    outcome, bench = spin(sets=TRIPPING)
    assert isinstance(outcome.error, SafetyTrip)
    assert trip_of("emulated").run == str(outcome.path)
    assert bench.wires["can0"].hosts == []
    if place is Ads1115:
        assert outcome.notes == ["torque_sensor: was not closed in order: OSError: [Errno 5] Input/output error"]


def test_a_trip_is_latched_before_the_file_is_closed(spin, monkeypatch):
    latched = []

    def killed(_self, _status, _reason):
        latched.append(trip_of("emulated"))
        raise RuntimeError("killed here")

    monkeypatch.setattr(writer.RunWriter, "close", killed)
    outcome, _bench = spin(sets=TRIPPING)
    assert latched[0].cause == outcome.reason
    assert outcome.status == "tripped"
    assert "killed here" in outcome.error.__notes__


def test_the_latch_is_on_the_disk_when_it_is_said_to_be(tmp_path, monkeypatch):
    forced = []
    monkeypatch.setattr(os, "fsync", lambda place: forced.append(os.fstat(place).st_ino))
    latch_of("emulated").set("too fast", tmp_path)
    path = Path(latch_of("emulated").paths[0])
    assert forced == [path.stat().st_ino, path.parent.stat().st_ino]


def test_a_latch_that_cannot_be_written_is_a_note_and_the_trip_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spin.yaml").write_text(SPIN)
    sets = [word for value in TRIPPING for word in ("--set", value)]
    done = leactl("run", "spin.yaml", *sets, "--json", **os.environ | {"LEACTL_STATE": "/proc/nowhere"})
    assert done.returncode == 3, done.stderr
    assert json.loads(done.stdout)["status"] == "tripped"
    note, cause = done.stderr.splitlines()
    assert note.startswith("leactl: THE BENCH IS NOT LATCHED: /proc/nowhere/emulated@")
    assert cause.startswith("leactl: test velocity of ")


@pytest.mark.parametrize(("broken", "fault"), [(Ads1115, "take"), (ElmoCan, "end_cycle"), (ElmoCan, "begin_cycle")])
def test_a_mistake_in_a_plug_in_ends_a_run_as_its_device_would(spin, monkeypatch, broken, fault):
    whole, calls = getattr(broken, fault), []

    def mistaken(self, *arguments):
        calls.append(self)
        if len(calls) > 40:
            raise IndexError("list index out of range")
        return whole(self, *arguments)

    monkeypatch.setattr(broken, fault, mistaken)
    outcome, _bench = spin()
    assert isinstance(outcome.error, DeviceError)
    assert ": its driver broke: IndexError: list index out of range; LEACTL_TRACE=1 shows where" in outcome.reason
    assert isinstance(outcome.error.__cause__, IndexError)
    assert outcome.reason.startswith(calls[-1].name)
    assert trip_of("emulated") is None, "every device has confirmed that it is safe"


@pytest.mark.parametrize("fault", [MemoryError(), RuntimeError("nobody has foreseen this")])
def test_what_nobody_has_foreseen_latches_the_bench(spin, monkeypatch, fault):
    def failing(_self):
        raise fault

    monkeypatch.setattr("leactl.runner.flushing.InlineFlush.after_cycle", failing)
    outcome, _bench = spin()
    assert outcome.error is fault
    assert trip_of("emulated").cause == (str(fault) or "MemoryError")


# -- the recording -----------------------------------------------------------------------------------------------------


def fail_in_the_thread(monkeypatch, name, fault, wait=lambda: None):
    """Let a function of the writer fail where the flushing thread calls it, which is at once and not in a second."""
    original = getattr(writer, name)

    def failing(*arguments):
        if threading.current_thread().name == "leactl-flush":
            wait()
            raise fault
        return original(*arguments)

    monkeypatch.setattr(writer, name, failing)
    monkeypatch.setattr("leactl.runner.flushing.FLUSH_INTERVAL_S", 0.0)


def test_memory_that_runs_out_while_flushing_fails_the_run(spin, monkeypatch):
    fail_in_the_thread(monkeypatch, "write_rows", MemoryError("no room"))
    outcome, _bench = spin(sets=("hold_s=0.7",), realtime=True)
    assert (outcome.status, type(outcome.error)) == ("failed", RecordingFailed)
    assert "recording failed: MemoryError no room" in outcome.reason


def test_memory_that_runs_out_in_the_last_flush_fails_the_run(spin, monkeypatch):
    stop, stopping = ThreadedFlush.stop, threading.Event()

    def stop_and_tell(flush):
        stopping.set()
        stop(flush)

    monkeypatch.setattr(ThreadedFlush, "stop", stop_and_tell)
    fail_in_the_thread(monkeypatch, "write_rows", MemoryError("no room"), wait=stopping.wait)
    outcome, _bench = spin(sets=("hold_s=0.2",), realtime=True)
    assert (outcome.status, type(outcome.error)) == ("failed", RecordingFailed)
    assert "recording failed: MemoryError no room" in outcome.reason


def test_a_full_disk_is_the_cause_that_everything_after_it_tells(spin, monkeypatch):
    fail_in_the_thread(monkeypatch, "write_rows", OSError(28, "No space left on device"))
    monkeypatch.setattr("leactl.runner.flushing.ThreadedFlush.after_cycle", lambda _self: None)  # the loop is first
    outcome, _bench = spin(sets=("hold_s=0.2",), realtime=True)
    assert outcome.status == "failed"
    assert "No space left on device" in outcome.reason
    assert not hasattr(outcome.error, "__notes__")
    assert "No space left on device" in trip_of("emulated").cause


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/nowhere"])
def test_a_directory_that_cannot_be_made_is_an_input_fault(spin, tmp_path, place):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot create the run file"):
        spin(out=tmp_path / place)


@pytest.mark.parametrize("safe", [False, True])
def test_a_winding_counts_as_after_a_crash_where_a_drive_was_not_confirmed_safe_before_the_run_had_a_file(
    spin, tmp_path, monkeypatch, safe
):
    kept = []

    class KeptWindings(Windings):  # as on a bench of devices
        def __init__(self, bench, devices, actuator, _emulated_here, cold):
            super().__init__(bench, devices, actuator, emulated_here=False, cold=cold)
            kept.append((bench, devices, actuator))

    monkeypatch.setattr("leactl.runner.session.Windings", KeptWindings)
    monkeypatch.setattr(Supervisor, "make_safe", lambda _self: {"drive": Confirmation(safe, "as it answered")})
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot create the run file"):
        spin(out=tmp_path / "file")
    known = Windings(*kept[0], emulated_here=False).recalled["test"].known
    assert ("ended without a word" in known) is not safe, known


# -- signals -----------------------------------------------------------------------------------------------------------


def test_a_signal_that_is_ignored_stays_ignored(spin):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as under nohup
    try:
        outcome, _bench = spin(at=[(0.3, lambda _bench: signal.raise_signal(signal.SIGHUP))])
        assert outcome.status == "complete"
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_that_comes_while_a_stop_source_is_looked_at_is_not_lost(spin):
    coming = [signal.SIGTERM]

    def source():
        if coming:
            signal.raise_signal(coming.pop())
        return ""

    outcome, _bench = spin(stops=[source])
    assert (outcome.status, outcome.reason) == ("stopped", "stopped by SIGTERM")
