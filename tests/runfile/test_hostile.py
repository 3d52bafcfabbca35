"""A run file that is none, holds too much or is of other kinds than the layout is refused in one line, unread."""

import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.catalog.run_index import list_runs
from leactl.runfile.hdf5 import opening, tree, value_types
from leactl.runfile.hdf5.chunks import MOST_DEFLATE_RATIO, chunks, unpacked
from leactl.runfile.hdf5.swmr import (
    CHECKSUM_AT,
    FLAGS_AT,
    LENGTH,
    OPEN_FOR_WRITE,
    SWMR_WRITE,
    as_closed,
    checksum,
)
from leactl.runfile.hdf5.text_heaps import HEAD, LONGEST_TEXT_BYTES, longest_text
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.integrity import altered, recover, verify
from leactl.runfile.write.writer import RunWriter
from tests.cli.terminal import leactl
from tests.mutated.child import outcome
from tests.mutated.test_mutated_files import command

from .specimen import STREAMS, info


def changed(path, change):
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def instead(place, make):
    def change(file):
        del file[place]
        make(file)

    return change


def announced(rows):
    storage = {"chunks": (4096,), "maxshape": (None,), "dtype": "f8"}
    return lambda file: file.create_dataset("streams/loop/more", (rows,), **storage)


def nested(file):
    file["streams/again"] = file["streams"]


def crowd(file):
    for number in range(tree.MOST_OBJECTS):
        file.create_group(f"extra/{number}")


HOSTILE = {
    "/streams/loop/more: announces 8000000000000 bytes": announced(10**12),
    "/streams/loop/more: announces 8000000000 bytes": announced(10**9),
    "/streams/loop/iq: 1[0-9]{6} bytes of attributes": lambda file: file["streams/loop/iq"].attrs.create(
        "big", np.zeros(200_000)
    ),
    "/: 1[0-9]{6} bytes of attributes": lambda file: file.attrs.create("big", np.zeros(200_000)),
    "/streams: a dataset where a group": instead("streams", lambda file: file.create_dataset("streams", data=[1.0])),
    "/steps: a dataset where a group": instead("steps", lambda file: file.create_dataset("steps", data=[1.0])),
    "/events/message: one dimension of texts": instead(
        "events/message", lambda file: file.create_dataset("events/message", data=[1.0])
    ),
    "/steps/stop: one dimension of numbers": instead(
        "steps/stop", lambda file: file.create_dataset("steps/stop", data=np.zeros((2, 2)))
    ),
    "/bench/source: one text": instead(
        "bench/source", lambda file: file.create_dataset("bench/source", data=np.zeros(3))
    ),
    "/streams: a link": instead(
        "streams", lambda file: file.__setitem__("streams", h5py.ExternalLink("other.h5", "/streams"))
    ),
    "/streams/loop: a link": instead(
        "streams/loop", lambda file: file.__setitem__("streams/loop", h5py.SoftLink("/streams/camera"))
    ),
    "lies in more than 8 groups": nested,
    "more than 10000 groups and datasets": crowd,
    "/streams/'x{79} ...: a name of 60000 bytes; at most 1024": lambda file: file["streams"].create_group("x" * 60_000),
    "more than 4194304 bytes of names": lambda file: [
        file.create_group(f"{'x' * 1000}/{'x' * 1000}/{number}") for number in range(3000)
    ],
    "/streams/loop: more than 8192 attributes": lambda file: [
        file["streams/loop"].attrs.create(f"more_{number}", number) for number in range(8200)
    ],
    "/: 82[0-9]{2} attributes; at most 8192": lambda file: [
        file.attrs.create(f"more_{number}", number) for number in range(8200)
    ],
    "/extra: chunks of 800000000 bytes": lambda file: file.create_dataset(
        "extra", (1,), "f8", maxshape=(None,), chunks=(10**8,)
    ),
    "/extra: a dataset without values": lambda file: file.create_dataset("extra", data=h5py.Empty("f8")),
    "/extra: values that are neither": lambda file: file.create_dataset("extra", (1,), h5py.ref_dtype),
    "/: attribute 'more' holds neither numbers nor text": lambda file: file.attrs.create(
        "more", [file.ref], dtype=h5py.ref_dtype
    ),
    "/setup: attribute 'more' holds neither": lambda file: file["setup"].attrs.create(
        "more", 0, dtype=h5py.enum_dtype({f"{number}": number for number in range(300)}, "i4")
    ),
}


def low_level(make):
    """An attribute of a type that h5py makes no value of."""

    def change(file):
        h5py.h5a.create(file["setup"].id, b"more", make(), h5py.h5s.create_simple((2,)))

    return change


HOSTILE |= {
    "/setup: attribute 'more' holds complex numbers; real ones or text": low_level(
        lambda: h5py.h5t.py_create(np.dtype("c16"))
    ),
    "/setup: attribute 'more' holds arrays as single values; numbers or text": low_level(
        lambda: h5py.h5t.array_create(h5py.h5t.IEEE_F64LE, (3,))
    ),
    "/setup: attribute 'more' holds bit fields; numbers or text": low_level(h5py.h5t.STD_B8LE.copy),
    "/setup: attribute 'more' holds neither numbers nor text but lists of any length": low_level(
        lambda: h5py.h5t.py_create(h5py.vlen_dtype("f8"), logical=True)
    ),
    "/extra: values that are neither numbers nor text but times": lambda file: h5py.h5d.create(
        file.id, b"extra", h5py.h5t.UNIX_D32LE, h5py.h5s.create_simple((2,))
    ),
}


SELDOM = {"more than 10000 groups and datasets", "more than 4194304 bytes of names"}  # long: other counts are short


@pytest.mark.parametrize(
    "words", [pytest.param(words, marks=[pytest.mark.long] if words in SELDOM else []) for words in HOSTILE]
)
def test_what_no_run_holds_is_refused_by_every_door(complete: Path, words: str):
    changed(complete, HOSTILE[words])
    for door in (Run.open, recover, altered):
        with pytest.raises(InputError, match=words) as caught:
            door(complete)
        assert len(caught.value.faults) == 1
        assert str(caught.value).startswith(f"{complete}: ")
    assert verify(complete) == caught.value.faults
    (listed,) = list_runs(complete.parent)
    assert listed.fault == str(caught.value)


def test_texts_that_another_program_packed_are_read(complete: Path):
    with h5py.File(complete, "r+") as file:
        texts = file["events/message"][:]
        del file["events/message"]
        file["events"].create_dataset("message", data=texts, dtype=layout.TEXT, chunks=(1,), compression="gzip")
    with Run.open(complete) as run:
        assert [event.message.encode() for event in run.events] == list(texts)


def test_packed_references_are_unpacked_as_hdf5_does(tmp_path: Path):
    """The bytes of a chunk after the filters, whatever their order and those that one chunk went without."""
    values = np.arange(64, dtype="<u8").reshape(-1, 2)
    rows = values.copy().view([("a", "<u8"), ("b", "<u8")]).ravel()
    with h5py.File(tmp_path / "x.h5", "w") as file:
        made = file.create_dataset("x", data=rows, chunks=(10,), compression="gzip", shuffle=True, fletcher32=True)
        file.flush()
        given = [unpacked(made.id, chunk, 160, 16) for chunk in chunks(made.id)]
        assert b"".join(given)[: rows.nbytes] == rows.tobytes()
        assert [unpacked(made.id, chunk, 100, 16) for chunk in chunks(made.id)] == [None] * len(given)


def test_the_manual_has_the_numbers_of_the_door():
    text = (Path(__file__).parents[2] / "docs" / "reference" / "run-format.md").read_text(encoding="utf-8")
    said = " ".join(text.partition("## What a reader refuses")[2].partition("\n## ")[0].split())
    times, beside = tree.MOST_UNPACKED
    for words in (
        f"groups deeper than {tree.MOST_LEVELS} in one another or more than {tree.MOST_OBJECTS:,} objects",
        f"a name of more than {tree.LONGEST_NAME:,} bytes or {tree.MOST_PATH_BYTES >> 20} MiB of paths",
        f"more than {tree.MOST_ATTRIBUTES:,} attributes, {tree.MOST_ATTRIBUTE_BYTES >> 20} MiB of them on one object",
        f"or {tree.MOST_ATTRIBUTE_BYTES_OF_FILE >> 20} MiB on all",
        f"enumerations of more than {value_types.MOST_MEMBERS} members",
        f"a text of more than {LONGEST_TEXT_BYTES >> 20} MiB, texts of more than {tree.MOST_TEXT_BYTES >> 20} MiB",
        f"more than {tree.MOST_TEXTS:,} of them, and more than {tree.MOST_ROWS_OF_TABLE:,} rows",
        f"chunks above {tree.LARGEST_CHUNK >> 20} MiB",
        f"more than {tree.MOST_UNWRITTEN_BYTES >> 20} MiB of values that were announced and never written",
        f"deflate packs {MOST_DEFLATE_RATIO} bytes into one",
        f"more than {times} times the size of the file and {beside >> 20} MiB beside",
    ):
        assert words in said, words


def test_a_list_goes_on_beside_what_is_no_file(complete: Path):
    os.mkfifo(complete.with_name("fifo.h5"))
    complete.with_name("zero.h5").symlink_to("/dev/zero")
    complete.with_name("gone.h5").symlink_to("nowhere")
    complete.with_name("folder.h5").mkdir()
    listed = {run.file: run.fault for run in list_runs(complete.parent)}
    assert listed.pop(complete.name) == ""
    assert [listed[name].split(": ")[-1] for name in ("fifo.h5", "zero.h5", "gone.h5")] == [
        "a regular file was expected; this is none",
        "a regular file was expected; this is none",
        "No such file or directory",
    ]
    assert "a folder" in listed["folder.h5"]


@pytest.mark.parametrize("command", [["runs", "verify"], ["runs", "show"], ["runs", "recover"], ["analyze"], ["stats"]])
def test_a_fifo_holds_no_command(tmp_path: Path, command: list[str]):
    os.mkfifo(tmp_path / "run.h5")
    ended = leactl(*command, str(tmp_path / "run.h5"))
    assert ended.returncode == 2
    assert "a regular file was expected" in ended.stderr


@pytest.mark.parametrize("signature", [b"OHDR", b"OCHK", b"EAHD", b"EAIB", b"FRHP", b"BTHD"])
def test_a_byte_spoiled_in_a_recording_that_was_cut_off_holds_no_command(tmp_path: Path, signature: bytes):
    """In SWMR mode HDF5 waits for the writer to mend a checksum, twice as long each time."""
    writer = RunWriter(tmp_path, info(), STREAMS)
    writer.append("loop", np.arange(5000) * 1e-3, np.zeros((5000, 3)))
    writer.flush()
    raw = bytearray(writer.path.read_bytes())
    writer.close("complete")
    cut_off = tmp_path / "cut_off.h5"
    cut_off.write_bytes(raw)
    with Run.open(cut_off) as run:
        assert run.rows["loop"] == 5000
    raw[raw.index(signature) + 12] ^= 0xFF
    cut_off.write_bytes(raw)
    ended = outcome(command("runs", "show", cut_off))
    assert ended.status == 2, ended.said
    assert "checksum" in ended.said


def test_the_checksum_of_a_head_is_that_of_hdf5(complete: Path):
    head = complete.read_bytes()[:LENGTH]
    assert checksum(head[: CHECKSUM_AT.start]) == int.from_bytes(head[CHECKSUM_AT], "little")
    assert as_closed(head, complete.stat().st_size) == head


def unchecked(file):
    file.visititems(lambda _name, item: item.attrs.pop("sha256", None))


def test_brackets_without_end_are_no_parameters(complete: Path):
    def change(file):
        unchecked(file)
        file["steps/parameters"][0] = "[" * 100_000

    changed(complete, change)
    with Run.open(complete) as run, pytest.raises(InputError, match="is not a JSON object") as caught:
        _ = run.steps
    assert len(str(caught.value)) < 400


def test_steps_of_uneven_columns_are_cut_only_where_the_recording_was(complete: Path, tmp_path: Path):
    def change(file):
        unchecked(file)
        del file["steps/stop"]
        file["steps/stop"] = np.zeros(1)

    changed(complete, change)
    with Run.open(complete) as run, pytest.raises(InputError, match="/steps: columns of different lengths"):
        _ = run.steps
    changed(complete, lambda file: file.attrs.__setitem__("status", "recording"))
    with Run.open(complete) as run:
        assert len(run.steps) == 1


def test_a_recording_that_announced_a_block_is_read(tmp_path: Path):
    writer = RunWriter(tmp_path, info(), STREAMS)
    writer.append("loop", np.arange(5000) * 1e-3, np.zeros((5000, 3)))
    writer.flush()
    with Run.open(writer.path) as run:
        assert run.rows["loop"] == 5000
    writer.close("complete")


def test_a_recording_that_grows_while_it_is_opened_is_not_called_damaged(tmp_path: Path, monkeypatch):
    with RunWriter(tmp_path, info(), STREAMS) as writer:
        writer.append("loop", np.arange(5000) * 1e-3, np.zeros((5000, 3)))
        writer.flush()
        looked = []

        def meanwhile(raw):
            if not looked:  # what a slow disk lets happen between the end that HDF5 saw and the headers that it reads
                for at in range(5000, 400_000, 5000):
                    writer.append("loop", np.arange(at, at + 5000) * 1e-3, np.zeros((5000, 3)))
                    writer.flush()
            looked.append(raw)
            return longest_text(raw)

        monkeypatch.setattr(opening, "longest_text", meanwhile)
        with Run.open(writer.path) as run:
            assert run.rows["loop"] == 400_000
        assert len(looked) == 2


def test_a_channel_that_packs_well_is_no_bomb(tmp_path: Path):
    rows = tree.MOST_UNWRITTEN_BYTES // 8 + 1
    with RunWriter(tmp_path, info(), STREAMS) as writer:
        writer.append("loop", np.arange(rows) * 1e-3, np.zeros((rows, 3)))
    assert verify(writer.path) == []


def test_blank_texts_do_not_keep_anybody_busy(complete: Path):
    raw = bytearray(complete.read_bytes())
    at = raw.index(HEAD)
    complete.write_bytes(raw[: at + 64] + bytes(512) + raw[at + 576 :])
    ended = leactl("runs", "verify", complete)
    assert ended.returncode == 2
    assert f"{complete}: damaged: the texts that begin at byte {at} are not whole" in ended.stderr


def test_a_spoiled_head_that_tells_of_a_writer_is_refused(complete: Path):
    raw = bytearray(complete.read_bytes())
    raw[FLAGS_AT] = OPEN_FOR_WRITE | SWMR_WRITE  # the head's checksum is that of a closed file
    complete.write_bytes(raw)
    ended = leactl("runs", "show", complete)
    assert ended.returncode == 2
    assert "checksum" in ended.stderr


def test_thousands_of_attributes_are_weighed_at_once(complete: Path):
    def change(file):
        for number in range(8_000):  # begun anew for each of them, HDF5 takes a minute and more
            file["streams"].attrs[f"more_{number}"] = number

    changed(complete, change)
    ended = leactl("runs", "show", complete)
    assert ended.returncode == 0, ended.stderr


def test_an_attribute_without_a_value_is_none_of_damage(complete: Path):
    changed(complete, lambda file: file.attrs.create("remark", h5py.Empty("f8")))
    with Run.open(complete) as run:
        assert run.attributes["remark"] == ""


def test_numbers_texts_and_truth_values_of_other_makers_are_read(complete: Path):
    values = {"flag": True, "flags": np.array([True, False]), "text": np.bytes_("a"), "number": np.float16(1)}
    changed(complete, lambda file: file["setup"].attrs.update(values))
    with Run.open(complete) as run:
        assert [run.setup[name] for name in values] == [True, [True, False], "a", 1.0]


def test_a_text_that_is_longer_than_its_file_is_not_waited_for(complete: Path):
    with h5py.File(complete) as file:
        at = file["steps/name"].id.get_offset()
    raw = bytearray(complete.read_bytes())
    raw[at : at + 4] = b"\xff\xff\xff\x7f"
    complete.write_bytes(raw)
    findings = verify(complete)
    assert findings == [
        f"{complete}: /steps/name: damaged: announces a text of {2**31 - 1} bytes in a file of {len(raw)}"
    ]
