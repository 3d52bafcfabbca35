"""The index of a folder: it says what the files say, opens what has changed alone, and is believed in nothing else."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import h5py
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.runfile.catalog import summaries
from leactl.runfile.catalog.run_index import BATCH_FILES, NAME, YOUNG_NS, digest_of, list_runs, read, update
from leactl.runfile.catalog.selection import ordered
from leactl.runfile.summary import RECORDING, Summary
from tests.cli.terminal import COMMAND, leactl
from tests.cli.test_runs_list import record

LONG_AGO = 1.7e9  # s


def aged(path):
    """A file that was written long ago, and may be trusted to be as it was."""
    os.utime(path, (LONG_AGO, LONG_AGO))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Runs of two protocols, one that is being recorded, one cut off while it was copied, and two that are none."""
    folder = tmp_path_factory.mktemp("made")
    for number in range(1, 5):
        record(folder, number, "friction", {"hold_s": number, "levels_A": [1.0, 2.0]}, f"2026-11-1{number}T10:00:00Z")
    first = record(folder, 5, "coast-down", {"direction": "both"}, "2026-11-20T10:00:00Z", status="stopped")
    with h5py.File(shutil.copy(first, folder / "recorded.h5"), "r+") as file:
        file.attrs["status"] = RECORDING
    (folder / "half.h5").write_bytes(first.read_bytes()[: first.stat().st_size // 2])
    (folder / "none.h5").write_text("no run at all")
    with h5py.File(folder / "foreign.h5", "w") as file:
        file["values"] = [1.0, 2.0]
    (folder / "gone.h5").symlink_to("nowhere.h5")
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """The same, all of it old."""
    copied = shutil.copytree(made, tmp_path / "runs", symlinks=True)
    for path in copied.glob("*.h5"):
        if path.exists():
            aged(path)
    return copied


@pytest.fixture
def opened(monkeypatch):
    """Names of the files that are opened, in their order."""
    names = []
    summary = summaries.summary
    monkeypatch.setattr(summaries, "summary", lambda path: names.append(path.name) or summary(path))
    return names


def scanned(folder):
    """What a list without an index says."""
    paths = [folder / name for name in sorted(path.name for path in folder.iterdir() if path.suffix == ".h5")]
    return [summaries.summary(path) for path in paths]


AGAIN = ["foreign.h5", "gone.h5", "half.h5", "none.h5", "recorded.h5"]  # in which nothing is settled


def test_a_list_by_the_index_is_that_of_the_files(folder, opened):
    plain = list_runs(folder)
    assert plain == scanned(folder)
    assert [run.fault != "" for run in plain].count(True) == 4
    path, catalogue = update(folder)
    assert (path, catalogue.runs, catalogue.read, catalogue.gone) == (folder / NAME, plain, len(plain), 0)
    opened.clear()
    remarks = []
    assert list_runs(folder, remark=remarks.append) == plain
    assert (opened, remarks) == (AGAIN, [])


def test_only_what_is_new_or_changed_is_opened_and_what_is_gone_leaves(folder, opened):
    update(folder)
    runs = sorted(folder.glob("2026*.h5"))
    size, about = runs[0].stat().st_size, runs[0].stat()
    swapped = runs[1].read_bytes()  # of the same length and time as what was there
    assert len(swapped) == size
    runs[0].write_bytes(swapped)
    os.utime(runs[0], ns=(about.st_atime_ns, about.st_mtime_ns))
    runs[2].unlink()
    shutil.copy2(runs[3], folder / "new.h5")
    opened.clear()
    remarks = []
    result = list_runs(folder, remark=remarks.append)
    assert sorted(opened) == sorted([*AGAIN, runs[0].name, "new.h5"])
    assert remarks == [f"{folder / NAME}: was not up to date; 7 runs read, 1 gone"]
    assert result == scanned(folder)
    opened.clear()
    assert list_runs(folder, remark=remarks.append) == result
    assert (opened, len(remarks)) == (AGAIN, 1)


def test_a_run_that_is_young_when_it_is_read_is_read_again(folder, opened):
    run = min(folder.glob("2026*.h5"))
    now = run.with_name("now.h5")
    shutil.copy(run, now)
    ahead = now.stat().st_mtime_ns + YOUNG_NS  # by the clock of another machine
    os.utime(now, ns=(ahead, ahead))
    update(folder)
    opened.clear()
    list_runs(folder)
    assert "now.h5" in opened
    aged(now)
    list_runs(folder)
    opened.clear()
    list_runs(folder)
    assert "now.h5" not in opened


def test_any_program_reads_the_index_and_nothing_waits_for_a_lock(folder):
    path, catalogue = update(folder)
    with closing(sqlite3.connect(path)) as base:
        assert base.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert base.execute("PRAGMA journal_mode").fetchone() == ("delete",)
        result = base.execute("SELECT file, protocol, rows, duration FROM runs WHERE fault = ''").fetchall()
        base.execute("BEGIN EXCLUSIVE")
        assert list_runs(folder) == catalogue.runs
    assert sorted(result) == [
        (run.file, run.protocol, run.rows, run.duration) for run in catalogue.runs if not run.fault
    ]
    assert sorted(item.name for item in folder.iterdir() if item.name.startswith(".")) == [NAME]


@pytest.fixture(scope="module")
def spoilt(made, tmp_path_factory):
    """A folder with the bytes of its index, and what the list is to say."""
    copied = shutil.copytree(made, tmp_path_factory.mktemp("spoilt") / "runs", symlinks=True)
    for path in copied.glob("2026*.h5"):
        aged(path)
    path, catalogue = update(copied)
    return copied, path.read_bytes(), catalogue.runs


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_no_spoilt_index_changes_an_answer(spoilt, data):
    folder, whole, runs = spoilt
    at = data.draw(st.integers(0, len(whole) - 1))
    how = data.draw(st.sampled_from(["flip", "cut", "zeros", "text"]))
    if how == "flip":
        bad = whole[:at] + bytes([whole[at] ^ data.draw(st.integers(1, 255))]) + whole[at + 1 :]
    elif how == "cut":
        bad = whole[:at]
    elif how == "zeros":
        bad = whole[:at] + bytes(len(whole) - at)
    else:
        bad = whole.replace(b"friction", b"fraction", at % 8 + 1)
    (folder / NAME).write_bytes(bad)
    remarks = []
    assert list_runs(folder, remark=remarks.append) == runs
    # the rest of a page that holds nothing may be anything
    assert remarks or bad == whole or set(read(folder / NAME, folder)) == {run.file for run in runs}
    assert list_runs(folder, remark=pytest.fail) == runs


def changed(folder, *statements):
    with closing(sqlite3.connect(folder / NAME)) as base:
        for statement in statements:
            base.execute(statement)
        base.commit()


@pytest.mark.parametrize(
    ("statements", "why"),
    [
        (["PRAGMA user_version = 7"], "is of version 7, this program's is 1"),
        (["ALTER TABLE runs ADD COLUMN more TEXT"], "has other columns than this program's"),
        (["CREATE VIEW more AS SELECT * FROM runs"], "has other columns than this program's"),
        (["PRAGMA application_id = 5"], "is no index of runs"),
        (["UPDATE runs SET status = 'complete'"], "is damaged"),
        (["DELETE FROM digest"], "is damaged"),
        (["UPDATE digest SET sha256 = ''"], "is damaged"),
        (["UPDATE digest SET sha256 = 5"], "is damaged"),
    ],
)
def test_an_index_of_another_make_is_told_and_made_anew(folder, statements, why):
    update(folder)
    changed(folder, *statements)
    remarks = []
    assert list_runs(folder, remark=remarks.append) == scanned(folder)
    assert remarks == [f"{folder / NAME}: {why}; made anew from the files"]
    assert list_runs(folder, remark=pytest.fail) == scanned(folder)


@pytest.mark.parametrize(
    "statement",
    [
        f"UPDATE runs SET parameters = '{'[' * 100_000}'",
        "UPDATE runs SET parameters = NULL",
        "UPDATE runs SET parameters = '5', created = x'ff', duration = 'long', rows = 'many'",
        "UPDATE runs SET file = x'ff', fault = 5",
        "UPDATE runs SET file = NULL",
        "UPDATE runs SET status = CAST(x'ff' AS TEXT)",
        "UPDATE runs SET protocol = 'another', size = size + 1",
    ],
)
def test_an_index_that_was_made_to_mislead_is_believed_in_nothing(folder, statement):
    update(folder)
    changed(folder, statement)
    path = folder / NAME
    with closing(sqlite3.connect(path)) as base:
        ((digest,),) = base.execute("SELECT sha256 FROM digest").fetchall()
    data = path.read_bytes()
    path.write_bytes(data.replace(digest.encode(), digest_of(data, digest).encode()))
    assert list_runs(folder) == scanned(folder)
    assert list_runs(folder, remark=pytest.fail) == scanned(folder)


def test_an_index_of_zeros_and_a_pipe_in_its_place_are_made_anew(folder):
    for spoil in (lambda path: path.write_bytes(b""), os.mkfifo):
        (folder / NAME).unlink(missing_ok=True)
        spoil(folder / NAME)
        remarks = []
        assert list_runs(folder, remark=remarks.append) == scanned(folder)
        assert len(remarks) == 1
        assert (folder / NAME).is_file()


def test_what_sqlite_cannot_hold_is_listed_all_the_same(folder, opened):
    run = min(folder.glob("2026*.h5"))
    odd = Path(os.fsdecode(bytes(folder) + b"/\xff\xfe.h5"))
    shutil.copy(run, odd)
    seeded = folder / "seeded.h5"
    with h5py.File(shutil.copy(run, seeded), "r+") as file:
        file.attrs["seed"] = 2**64 - 1
        file.attrs.create("operator", b"\xff\xfe", dtype=h5py.string_dtype("utf-8"))
        file.attrs["actuator"] = "0" * 64
    aged(odd)
    aged(seeded)
    _, catalogue = update(folder)
    assert catalogue.runs == scanned(folder)
    assert {odd.name, seeded.name} <= {run.file for run in catalogue.runs}
    opened.clear()
    assert list_runs(folder, remark=lambda _: None) == catalogue.runs
    assert {odd.name, seeded.name} <= set(opened)


def test_a_folder_that_takes_no_index_is_refused_before_anything_is_read(folder, opened):
    (folder / NAME).mkdir()
    (folder / NAME / "full").touch()  # in whose place no file can be put, whoever asks
    with pytest.raises(InputError, match=r"cannot be written: .*; --index FILE puts the index elsewhere"):
        update(folder)
    assert opened == []
    remarks = []
    assert list_runs(folder, remark=remarks.append) == scanned(folder)
    assert "this list is from the files" in remarks[-1]
    elsewhere = folder.parent / "index.sqlite"
    assert update(folder, elsewhere)[0] == elsewhere
    assert list_runs(folder, elsewhere, pytest.fail) == scanned(folder)


def test_an_index_takes_the_place_of_no_other_file(folder, tmp_path):
    thesis = tmp_path / "thesis.docx"
    thesis.write_text("years of work")
    for path in (thesis, tmp_path):
        with pytest.raises(InputError, match="is no index of runs and is not replaced"):
            update(folder, path)
        with pytest.raises(InputError, match="is no index of runs and is not replaced"):
            list_runs(folder, path)
    assert thesis.read_text() == "years of work"
    with pytest.raises(InputError, match=r"no such index; leactl runs index .* --index .* makes it"):
        list_runs(folder, tmp_path / "none.sqlite")
    with pytest.raises(InputError, match="cannot be read: No such file or directory"):
        update(tmp_path / "nowhere")


def test_a_list_of_many_files_names_the_index(folder, monkeypatch):
    monkeypatch.setattr("leactl.runfile.catalog.run_index.MANY_FILES", 10)
    remarks = []
    list_runs(folder, remark=remarks.append)
    assert remarks == [f"10 files opened; leactl runs index {folder} makes the next list quick"]


def test_a_stop_keeps_what_was_read(folder, opened, monkeypatch):
    run = min(folder.glob("2026*.h5"))
    for number in range(2 * BATCH_FILES):
        aged(shutil.copy(run, folder / f"more-{number:03}.h5"))

    def stop(line):
        raise KeyboardInterrupt

    monkeypatch.setattr("leactl.runfile.catalog.run_index.PROGRESS_INTERVAL", BATCH_FILES)
    with pytest.raises(KeyboardInterrupt):
        update(folder, tell=stop)
    assert len(opened) == len(read(folder / NAME, folder)) == BATCH_FILES
    every = {path.name for path in folder.glob("*.h5")}
    update(folder)
    assert sorted(opened[BATCH_FILES:]) == sorted(every - ({*opened[:BATCH_FILES]} - {*AGAIN}))
    assert list_runs(folder, remark=pytest.fail) == scanned(folder)


def test_processes_that_write_at_once_leave_a_whole_index(folder):
    run = min(folder.glob("2026*.h5"))
    for number in range(2 * BATCH_FILES):
        aged(shutil.copy(run, folder / f"more-{number:03}.h5"))
    words = [[*COMMAND, "runs", "index", str(folder)], [*COMMAND, "runs", "list", str(folder), "--json"]] * 2
    both = [subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) for line in words]
    answers = [process.communicate()[0] for process in both]
    assert [process.returncode for process in both] == [0] * 4
    expected = [json.loads(json.dumps(run.as_json())) for run in ordered(scanned(folder), "file")]
    assert [json.loads(answers[place])["runs"] for place in (1, 3)] == [expected] * 2
    assert set(read(folder / NAME, folder)) == {run["file"] for run in expected}
    assert sorted(item.name for item in folder.iterdir() if item.name.startswith(".")) == [NAME]


def test_the_command_tells_what_it_did(folder):
    done = leactl("runs", "index", folder, "--processes", 2)
    first, *faulty = done.stdout.splitlines()
    assert first == f"{folder / NAME}: 10 files, 10 read, 0 gone, 4 unreadable"
    assert [line.split()[0] for line in faulty] == ["foreign.h5", "gone.h5", "half.h5", "none.h5"]
    assert all("unreadable: " in line for line in faulty)
    max(folder.glob("2026*.h5")).unlink()
    answer = json.loads(leactl("runs", "index", folder, "--json").stdout)
    assert {name: answer[name] for name in ("files", "read", "gone")} == {"files": 9, "read": 5, "gone": 1}
    assert [item["file"] for item in answer["unreadable"]] == ["foreign.h5", "gone.h5", "half.h5", "none.h5"]


def test_several_processes_make_the_same_index(folder, tmp_path):
    run = min(folder.glob("2026*.h5"))
    for number in range(2 * BATCH_FILES):
        aged(shutil.copy(run, folder / f"more-{number:03}.h5"))
    for processes in (1, 2):
        done = leactl("runs", "index", folder, "--index", tmp_path / f"{processes}.sqlite", "--processes", processes)
        assert done.returncode == 0
    one, two = (read(tmp_path / f"{processes}.sqlite", folder) for processes in (1, 2))
    assert one == two
    assert len(one) == len(scanned(folder))


def test_a_list_with_an_index_imports_no_hdf5(tmp_path):
    record(tmp_path, 1, "friction", {"hold_s": 1}, "2026-11-11T10:00:00Z")
    aged(next(tmp_path.glob("*.h5")))
    update(tmp_path)
    script = (
        "import sys; from pathlib import Path; from leactl.runfile.catalog.run_index import list_runs;"
        "from leactl.runfile.catalog.selection import selection_of; from leactl.report.run_list import run_list;"
        "runs = list_runs(Path(sys.argv[1])); selection_of(runs, where=['hold_s == 1']); run_list(runs, runs, ());"
        "print(len(runs), [name for name in ('h5py', 'numpy', 'scipy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, check=True)
    assert done.stdout == "1 []\n"


values = st.none() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()


@given(st.text(), st.integers(0), st.dictionaries(st.text(), values | st.lists(values)), st.floats(0, 1e300))
def test_a_summary_comes_back_as_it_was_or_is_left_out(tmp_path_factory, text, number, parameters, seconds):
    from leactl.runfile.catalog.run_index import Catalogue, FileStamp, IndexedRun, save

    folder = Path("runs")
    run = Summary(folder, "a.h5", 5, text, text, seed=number, duration=seconds, parameters=parameters)
    rows = {
        "a.h5": IndexedRun(FileStamp(5, 1, 2, 3), run),
        "b.h5": IndexedRun(FileStamp(5, 1, 2, 3), run._replace(file="b.h5")),
    }
    path = tmp_path_factory.getbasetemp() / "index.sqlite"
    save(Catalogue(folder, rows), path)
    assert read(path, folder) in (rows, {})
    assert read(path, folder) == rows or number >= 2**63
