"""Tags of runs: in a file beside them that many write to, while the run files stay as they are to the byte."""

import json
import os
import shutil
import subprocess

import pytest

from leactl.runfile.catalog.run_index import list_runs, update
from leactl.runfile.catalog.tags import NAME
from leactl.runfile.verify.integrity import examine
from tests.cli.terminal import COMMAND, leactl
from tests.cli.test_runs_list import record


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    for number in range(1, 4):
        record(folder, number, "friction", {"hold_s": number}, f"2026-11-1{number}T10:00:00Z")
    return folder


@pytest.fixture
def runs(made, tmp_path):
    return sorted(shutil.copytree(made, tmp_path / "runs").glob("*.h5"))


def tags_of(folder):
    return {run.file[-7:-3]: run.tags for run in list_runs(folder, remark=pytest.fail)}


def test_a_tag_finds_its_runs_and_leaves_their_files_alone(runs):
    folder, before = runs[0].parent, [path.read_bytes() for path in runs]
    update(folder)
    done = leactl("runs", "tag", runs[0], runs[2], "paper")
    assert done.stdout == f"{runs[0]}: paper\n{runs[2]}: paper\n"
    assert leactl("runs", "tag", runs[2], "greased").stdout == f"{runs[2]}: greased, paper\n"
    assert tags_of(folder) == {"0001": ("paper",), "0002": (), "0003": ("greased", "paper")}
    assert [path.read_bytes() for path in runs] == before
    assert examine(runs[0]).findings == []
    completed = leactl("runs", "list", folder, "--where", "'paper' in tags and not like(tags, 'gr*')")
    assert completed.stdout.split()[0] == runs[0].name
    assert completed.stdout.split()[-1] == "tags=paper"
    assert len(completed.stdout.splitlines()) == 1
    answer = json.loads(leactl("runs", "tag", runs[2], "paper", "--remove", "--json").stdout)
    assert answer == {"runs": [{"run": str(runs[2]), "tags": ["greased"]}]}
    assert leactl("runs", "tag", folder, "greased", "--remove").returncode == 0
    assert leactl("runs", "tag", runs[0], "paper", "--remove").stdout == f"{runs[0]}: no tags\n"
    assert json.loads((folder / NAME).read_text())["tags"] == {}


def test_a_tag_stays_with_a_run_that_is_renamed(runs):
    leactl("runs", "tag", runs[0], "paper")
    runs[0].rename(runs[0].with_name("renamed.h5"))
    assert tags_of(runs[0].parent)["amed"] == ("paper",)


@pytest.mark.parametrize("tag", ["", "two words", "-x", "a/b", "ä", "a" * 65, "x.h5", "a\n"])
def test_what_is_no_word_is_refused(runs, tag):
    done = leactl("runs", "tag", runs[0], "--", tag)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert not (runs[0].parent / NAME).exists()


def test_a_forgotten_tag_is_named(runs):
    done = leactl("runs", "tag", *runs)
    assert done.returncode == 2
    assert " is no tag; a word of letters, digits" in done.stderr


def test_nothing_is_tagged_where_one_run_cannot_be_read(runs):
    runs[1].write_text("no run")
    done = leactl("runs", "tag", *runs, "paper")
    assert (done.returncode, done.stderr) == (2, f"leactl: {runs[1]}: not an HDF5 file\n")
    assert not (runs[0].parent / NAME).exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is damaged: Expecting value"),
        ("[" * 100_000, "is damaged: maximum recursion depth"),
        ("[]", "a mapping with keys of format, format_version, tags was expected"),
        ('{"format": "other"}', "format: "),
        ('{"format": "leactl-tags", "format_version": 2, "tags": {}}', "format_version: "),
        ('{"format": "leactl-tags", "format_version": 1, "tags": {"paper": [5]}}', "tags.paper.0: "),
        ('{"format": "leactl-tags", "format_version": 1, "tags": {"two words": []}}', "tags.two words"),
        ('{"format": "leactl-tags", "tag": {}}', "tag: unknown key; tags was expected"),
        ("\xff", "is damaged: "),
    ],
)
def test_a_spoilt_file_of_tags_is_told_and_not_written_over(runs, text, message):
    folder, path = runs[0].parent, runs[0].parent / NAME
    path.write_bytes(text.encode("latin-1"))
    listed = leactl("runs", "list", folder)
    assert listed.returncode == 0
    assert len(listed.stdout.splitlines()) == 3
    assert listed.stderr.startswith(f"leactl: {path}: {message}")
    assert listed.stderr.endswith("; no tags are known\n")
    assert listed.stderr.count("\n") == 1
    done = leactl("runs", "tag", runs[0], "paper")
    assert done.returncode == 2
    assert f"{path}: {message}" in done.stderr
    assert path.read_bytes() == text.encode("latin-1")


def test_a_spoilt_file_of_tags_leaves_those_of_other_folders_as_they_were(runs, tmp_path):
    other = shutil.copytree(runs[0].parent, tmp_path / "z")
    (other / NAME).write_text("[]")
    assert leactl("runs", "tag", runs[0], other / runs[0].name, "paper").returncode == 2
    assert not (runs[0].parent / NAME).exists()
    assert (other / NAME).read_text() == "[]"


def test_a_folder_that_is_reached_by_two_paths_is_written_once(runs, tmp_path):
    (tmp_path / "link").symlink_to(runs[0].parent)
    done = leactl("runs", "tag", runs[0], tmp_path / "link" / runs[1].name, "paper")
    assert done.returncode == 0, done.stderr
    assert tags_of(runs[0].parent) == {"0001": ("paper",), "0002": ("paper",), "0003": ()}


def test_a_pipe_in_the_place_of_the_tags_holds_nobody(runs):
    os.mkfifo(runs[0].parent / NAME)
    assert "a regular file was expected" in leactl("runs", "list", runs[0].parent).stderr


def test_processes_that_tag_at_once_lose_nothing(runs):
    words = [[*COMMAND, "runs", "tag", str(run), tag] for run in runs for tag in ("a", "b")]
    both = [subprocess.Popen(line, stdout=subprocess.DEVNULL) for line in words]
    assert [process.wait() for process in both] == [0] * len(both)
    assert tags_of(runs[0].parent) == {"0001": ("a", "b"), "0002": ("a", "b"), "0003": ("a", "b")}
