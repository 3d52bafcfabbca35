"""Damage is found and named, notes leave the data alone, copies never replace anything."""

import shutil
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile.catalog.run_index import list_runs
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import annotate, recover, verify
from leactl.runfile.write.writer import RunWriter

from .specimen import STREAMS, as_left_by_a_kill, info


def test_a_closed_run_has_no_findings(complete: Path):
    assert verify(complete) == []
    with pytest.raises(InputError, match="nothing to recover"):
        recover(complete)


@pytest.mark.parametrize("place", ["streams/loop/iq", "streams/camera/time", "steps/settle"])
def test_a_changed_value_is_found(complete: Path, place: str):
    with h5py.File(complete, "r+") as file:
        file[place][0] += -0.5
    assert any(f"/{place}: checksum mismatch" in finding for finding in verify(complete))
    with pytest.raises(InputError, match="checksum mismatch"):
        annotate(complete, "looks fine")


def test_a_changed_text_is_found(complete: Path):
    with h5py.File(complete, "r+") as file:
        file["protocol/source"][()] = "name: something else\n"
        file["events/message"][0] = "nothing happened"
    assert [finding.split(": ")[1] for finding in verify(complete)] == ["/events/message", "/protocol/source"]


def test_flipped_bytes_are_found_wherever_they_are(complete: Path):
    original = complete.read_bytes()
    with h5py.File(complete) as file:
        chunk = file["streams/loop/theta"].id.get_chunk_info(0)
    damaged = bytearray(original)
    damaged[chunk.byte_offset + chunk.size // 2] ^= 0xFF
    complete.write_bytes(damaged)
    assert any("/streams/loop/theta" in finding for finding in verify(complete))


def test_missing_attributes_and_rows_are_found(complete: Path):
    with h5py.File(complete, "r+") as file:
        del file.attrs["operator"]
        del file["setup"].attrs["mechanical"]
        del file["streams/loop/iq"].attrs["device"]
        file["streams/loop/theta"].resize((990,))
    result = "\n".join(verify(complete))
    for expected in ["/: no attribute 'operator'", "/setup: no attribute 'mechanical'", "iq: no attribute 'device'"]:
        assert expected in result
    assert "/streams/loop/theta: 990 values for 1000 stamps" in result
    with pytest.raises(InputError, match="990 values for 1000 stamps"):
        Run.open(complete)
    with Run.open(recover(complete)) as run:
        assert run.rows == {"loop": 990, "camera": 10}


def test_a_copy_is_never_overwritten(tmp_path: Path):
    writer = RunWriter(tmp_path, info(), STREAMS)
    writer.append_row("loop", 0.0, [1, 2, 3])
    writer.flush()
    killed = as_left_by_a_kill(writer)
    clean = recover(killed)
    assert clean.name == f"{killed.stem}.recovered.h5"
    with pytest.raises(InputError, match="exists already"):
        recover(killed)
    with pytest.raises(InputError, match="still being written"):
        annotate(writer.path, "too early")
    writer.close("stopped", "by hand")


def test_notes_gather_and_leave_the_data_alone(complete: Path):
    with h5py.File(complete) as file:
        before = {place: file[place].attrs["sha256"] for place in ("streams/loop/iq", "events/message")}
    annotate(complete, "bearing squeaked\nfrom 0.3 s", author="Ada")
    annotate(complete, "größer als gedacht")
    assert verify(complete) == []
    with Run.open(complete) as run:
        assert [(note.author, note.text) for note in run.notes] == [
            ("Ada", "bearing squeaked\nfrom 0.3 s"),
            ("", "größer als gedacht"),
        ]
    with h5py.File(complete) as file:
        assert {place: file[place].attrs["sha256"] for place in before} == before
    assert list(complete.parent.iterdir()) == [complete]


def test_what_is_no_run_is_refused_in_one_line(complete: Path, tmp_path: Path):
    text = tmp_path / "text.h5"
    text.write_text("time,torque\n")
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as file:
        file["x"] = 1
    newer = shutil.copy(complete, tmp_path / "newer.h5")
    with h5py.File(newer, "r+") as file:
        file.attrs["format_version"] = 2
    reasons = {text: "not an HDF5 file", foreign: "not a run file", newer: "format_version is 2", tmp_path: "a folder"}
    for path, reason in [*reasons.items(), (tmp_path / "none.h5", "No such file")]:
        with pytest.raises(InputError, match=rf"(?i){path.name}.*{reason}") as caught:
            Run.open(path)
        assert len(caught.value.faults) == 1
    with pytest.raises(InputError):
        list_runs(text)
    faulty = {entry.path: entry.fault for entry in list_runs(tmp_path)}
    assert faulty[complete] == ""
    assert all(faulty[path] for path in (text, foreign, newer))


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.9, 0.999])
def test_a_truncated_file_is_refused(complete: Path, share: float):
    whole = complete.read_bytes()
    complete.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(InputError, match="truncated" if share else "not an HDF5 file"):
        Run.open(complete)
    assert verify(complete)


def test_the_catalogue_lists_what_is_there(complete: Path):
    (complete.parent / "x.h5.partial").touch()
    writer = RunWriter(complete.parent, info("20261121T000000Z-friction-0000"), STREAMS)
    writer.append_row("loop", 7.5, [1, 2, 3])
    writer.flush()
    first, second, third = list_runs(complete.parent)
    assert (first.run_id, first.status, first.duration) == (info().run_id, "complete", 9.0)
    assert (second.status, second.duration) == ("recording", 7.5)
    assert third.fault
    writer.close("failed", "drive fault")


BREAKAGES = {
    "/streams/loop/iq: q_axis_current has units 'mA', expected A": lambda f: f["streams/loop/iq"].attrs.modify(
        "units", "mA"
    ),
    "/streams/loop/time[3]: nan": lambda f: f["streams/loop/time"].__setitem__(3, np.nan),
    "/streams/loop/time[4]: 0.001 after 0.003": lambda f: f["streams/loop/time"].__setitem__(4, 0.001),
    "/streams/extra: has no time": lambda f: f.create_group("streams/extra"),
    "/streams/loop/square: shape (2, 2)": lambda f: f.create_dataset("streams/loop/square", data=np.eye(2)),
    "/streams/loop/away: a link": lambda f: f.__setitem__("streams/loop/away", h5py.ExternalLink("/etc/x.h5", "/x")),
    "/streams/loop/soft: a link": lambda f: f.__setitem__("streams/loop/soft", h5py.SoftLink("/streams/loop/iq")),
    "/streams/loop/raw: its values lie in another file": lambda f: f.create_dataset(
        "streams/loop/raw", (4,), "f4", external=[("/etc/hostname", 0, 16)]
    ),
    "/streams/loop/lzf: filter": lambda f: f.create_dataset("streams/loop/lzf", data=np.ones(4), compression="lzf"),
}


@pytest.mark.parametrize("fault", BREAKAGES)
def test_a_file_that_breaks_the_format_is_refused_at_the_door(complete: Path, fault: str):
    with h5py.File(complete, "r+") as file:
        BREAKAGES[fault](file)
    with pytest.raises(InputError) as caught:
        Run.open(complete)
    assert any(line.startswith(f"{complete}: {fault}") for line in caught.value.faults)


def test_attributes_of_matlab_and_missing_groups_are_tolerated(complete: Path):
    with h5py.File(complete, "r+") as file:
        for group in ("steps", "events", "setup", "protocol", "bench"):
            del file[group]
        file["streams/loop/iq"].attrs["units"] = np.bytes_("A")
        file["streams/loop/iq"].attrs["quantity"] = np.array([b"q_axis_current"])
        file.attrs["format"] = np.bytes_("leactl-run")
        file.attrs["format_version"] = np.array([1.0])
        del file["streams/loop/a_torque"].attrs["quantity"]
    with Run.open(complete) as run:
        assert run.channel("q_axis_current").units == "A"
        assert (run.steps, run.events, run.mechanical, run.source("bench")) == ([], [], "", None)
        assert not run.has("torque")


def test_one_appended_row_costs_microseconds(tmp_path: Path):
    with RunWriter(tmp_path, info(), STREAMS) as writer:
        started = time.perf_counter()
        for row in range(20_000):
            writer.append_row("loop", row * 1e-3, [1.0, 2.0, 3.0])
        assert (time.perf_counter() - started) / 20_000 < 50e-6  # some 2 us on a desk; a 1 kHz loop has 1000


@pytest.mark.parametrize("text", ["", " \n"])
def test_an_empty_note_is_refused(complete: Path, text: str):
    with pytest.raises(InputError, match="the note is empty"):
        annotate(complete, text)
