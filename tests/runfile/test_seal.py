"""The seal: whatever is deleted, added, renamed or changed in a closed run is named, and what may be added is."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.runfile import layout
from leactl.runfile.verify.conversion import convert
from leactl.runfile.verify.integrity import altered, annotate, examine, recover, refuse_altered, verify
from leactl.runfile.write.writer import RunWriter
from tests.cli.terminal import leactl

from .specimen import STREAMS, as_left_by_a_kill, info, unseal


def changed(path, change):
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def without_checksums(file):
    for _, dataset in list(layout.datasets(file)):
        del dataset.attrs["sha256"]


def set_attribute(place, name, value):
    def change(file):
        file[place].attrs[name] = value

    return change


def remove(place):
    return lambda file: file.__delitem__(place)


TAMPERED = {
    "/streams": remove("streams"),
    "/streams/loop/iq": remove("streams/loop/iq"),
    "/steps": remove("steps"),
    "/events": remove("events"),
    "/bench": remove("bench"),
    "/: attributes": set_attribute("/", "condition", "loaded"),
    "/: attributes ": set_attribute("/", "actuator", "another"),
    "/: attributes  ": set_attribute("/", "created", "2026-01-01T00:00:00Z"),
    "/: attributes   ": lambda file: file.attrs.__delitem__("run_id"),
    "/: attributes    ": set_attribute("/", "note", "from elsewhere"),
    "/setup: attributes": set_attribute("setup", "mechanical", "locked"),
    "/streams/loop/iq: attributes": set_attribute("streams/loop/iq", "scale_std", 1e300),
    "/streams/loop/iq: attributes ": set_attribute("streams/loop/iq", "role", "foo"),
    "/streams/loop/more": lambda file: file["streams/loop"].create_dataset("more", data=np.zeros(3)),
    "/extra": lambda file: file.create_group("extra"),
    "/seal: ": remove("seal"),
    "/seal:  ": lambda file: file.attrs.__delitem__("seal"),
    "/seal: holds more": lambda file: file["seal"].create_group("steps"),
    "/seal: holds more ": set_attribute("seal", "by", "me"),
    "/seal: holds more  ": set_attribute("seal/path", "by", "me"),
    "/streams: attributes": set_attribute("streams", "sha256", "0"),
    "/streams: attributes ": set_attribute("streams", "additions", "0"),
}


@pytest.mark.parametrize("place", TAMPERED)
def test_what_was_tampered_with_is_named(complete: Path, place: str):
    assert verify(complete) == []
    findings = altered(changed(complete, TAMPERED[place]))
    assert any(finding.startswith(f"{complete}: {place.rstrip()}") for finding in findings), findings
    with pytest.raises(InputError):
        refuse_altered([complete])
    done = leactl("runs", "verify", complete)
    assert done.returncode == 2
    assert place.rstrip() in done.stderr


def test_twenty_missing_checksums_are_one_line(complete: Path):
    def change(file):
        for place, dataset in list(layout.datasets(file)):
            if place.startswith("/streams"):
                del dataset.attrs["sha256"]

    findings = [finding for finding in altered(changed(complete, change)) if "no checksum" in finding]
    assert len(findings) == 1


def test_a_file_of_other_makers_is_told_to_be_covered_by_nothing(complete: Path):
    def strip(file):
        without_checksums(file)
        unseal(file)

    assert verify(changed(complete, strip)) == []
    assert "no checksums" in examine(complete).summary


def test_a_file_from_before_the_seal_says_what_is_not_covered(complete: Path):
    def strip(file):
        unseal(file)

    assert verify(changed(complete, strip)) == []
    assert "names and attributes are not covered" in examine(complete).summary


def test_notes_and_rewriting_keep_the_seal(complete: Path):
    annotate(complete, "first")
    annotate(complete, "second")
    convert(complete)
    assert examine(complete).summary == "complete; values, names and attributes are as they were closed"


@pytest.mark.parametrize(
    "change",
    [
        remove("notes"),
        set_attribute("notes", "by", "me"),
        remove("notes/author"),
        lambda file: file.attrs.__delitem__("additions"),
    ],
)
def test_an_addition_has_a_seal_of_its_own(complete: Path, change):
    annotate(complete, "a note")
    assert verify(complete) == []
    assert altered(changed(complete, change))


def test_a_recovered_run_is_sealed_anew(tmp_path: Path):
    writer = RunWriter(tmp_path, info(), STREAMS)
    writer.append_row("loop", 0.0, [1, 2, 3])
    writer.flush()
    assert examine(recover(as_left_by_a_kill(writer))).summary.startswith("recovered; values, names and attributes")


def test_folders_and_several_files_are_verified_with_how_each_ended(complete: Path, tmp_path: Path):
    done = leactl("runs", "verify", complete, complete.parent)
    assert done.returncode == 0
    assert done.stdout.count("complete; values, names and attributes are as they were closed") == 2
    changed(complete, set_attribute("/", "status", "tripped"))
    assert leactl("runs", "verify", complete.parent, "--json").returncode == 2


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_any_single_change_of_the_tree_is_noticed(complete: Path, data):
    copy = complete.with_name("copy.h5")
    copy.write_bytes(complete.read_bytes())
    with h5py.File(copy, "r+") as file:
        places = ["/"]
        file.visit(lambda name: places.append(name) if not name.startswith("seal") else None)
        node = file[data.draw(st.sampled_from(places))]
        kinds = ["add"] + (["delete"] if node.name != "/" else []) + (["attribute"] if layout.attributes(node) else [])
        match data.draw(st.sampled_from(kinds)):
            case "delete":
                del file[node.name]
            case "add":
                node.attrs["new"] = data.draw(st.one_of(st.integers(-9, 9), st.text(max_size=5).map(layout.storable)))
            case "attribute":
                name = data.draw(st.sampled_from(sorted(layout.attributes(node))))
                old = node.attrs[name]
                new = data.draw(st.one_of(st.floats(allow_nan=False), st.text(max_size=5).map(layout.storable)))
                if layout.to_python(old) == new:
                    return
                node.attrs[name] = new
    assert verify(copy)
