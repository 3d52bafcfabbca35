"""What a run says of its protocol's parameters and of its instruments, from its first row on and in every copy."""

import json
import math

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError
from leactl.runfile.importing.importer import import_runs
from leactl.runfile.read.reader import Run
from leactl.runfile.verify.conversion import convert
from leactl.runfile.verify.integrity import annotate, recover, verify
from leactl.runfile.write.writer import RunWriter

from .specimen import STREAMS, info

PARAMETERS = {"hold_s": 6, "rate": 0.25, "label": "größer", "levels": [1.0, -2.5, 4.0], "visits": ["up", "down"]}
INSTRUMENTS = {
    "drive_a": {"model": "Gold DC Whistle", "serial": "00123", "firmware": "01.01.16.00"},
    "sensor": {"serial": "0815", "calibrated": "2025-11-01", "calibration_due": "2026-11-01"},
}


def writer(folder, parameters=PARAMETERS, instruments=INSTRUMENTS):
    about = info()
    described = {**vars(about), "parameters": parameters, "instruments": instruments}
    opened = RunWriter(folder, type(about)(**described), STREAMS)
    opened.append("loop", np.arange(3) * 0.1, np.ones((3, 3)))
    return opened


def test_a_channel_whose_name_would_make_a_group_of_the_file_is_refused(tmp_path):
    streams = {"loop": [STREAMS["loop"][0]._replace(name="a/b"), *STREAMS["loop"][1:]]}
    with pytest.raises(InputError, match="streams/loop/a/b: not a usable name"):
        RunWriter(tmp_path, info(), streams)
    assert list(tmp_path.iterdir()) == []


def described(path):
    with Run.open(path) as run:
        return run.parameters, run.instruments


def test_a_run_is_described_from_its_start_and_in_every_copy(tmp_path):
    recording = writer(tmp_path)
    assert described(recording.path) == (PARAMETERS, INSTRUMENTS)
    recording.flush()
    (tmp_path / "killed.h5").write_bytes(recording.path.read_bytes())
    recovered = recover(tmp_path / "killed.h5")
    recording.close("complete")
    for path in (recording.path, recovered):
        assert described(path) == (PARAMETERS, INSTRUMENTS)
        annotate(path, "seen")
        convert(path)
        assert described(path) == (PARAMETERS, INSTRUMENTS)
        assert verify(path) == []


def test_types_are_those_that_other_programs_expect(tmp_path):
    recording = writer(tmp_path)
    recording.close("complete")
    with h5py.File(recording.path) as file:
        assert file["parameters"].attrs["hold_s"].dtype == np.int64
        assert file["parameters"].attrs["levels"].dtype == np.float64
        assert file["parameters"].attrs["label"] == "größer"
        assert file["instruments/sensor"].attrs["calibration_due"] == "2026-11-01"


def test_a_foreign_file_need_not_say(complete):
    with h5py.File(complete, "r+") as file:
        del file["parameters"], file["instruments"]
    assert described(complete) == ({}, {})
    with h5py.File(complete, "r+") as file:
        file["parameters"] = np.arange(3.0)
        file["instruments/drive"] = 1.0
    assert described(complete) == ({}, {})


numbers = st.integers(-(2**70), 2**70) | st.floats(-1e299, 1e299)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=40)
values = numbers | texts | st.lists(numbers, min_size=2, max_size=9) | st.lists(texts, min_size=2, max_size=9)


@settings(max_examples=25)
@given(values=st.dictionaries(st.from_regex(r"[a-z][A-Za-z0-9_]{0,20}", fullmatch=True), values, max_size=5))
def test_every_value_that_a_protocol_takes_comes_back(tmp_path_factory, values):
    recording = writer(tmp_path_factory.mktemp("run"), values)
    recording.close("complete")
    back, _ = described(recording.path)
    assert back.keys() == values.keys()
    for name, value in values.items():
        assert back[name] == pytest.approx(value, rel=1e-15) if not holds_text(value) else back[name] == value


def holds_text(value):
    return isinstance(value, str) or (isinstance(value, list) and isinstance(value[0], str))


MAPPING = """
mechanical: free
run: {protocol: coast-down}
parameters: {hold_s: 6, gain: {field: kp}}
instruments:
  scope: {model: MSO54, serial: "C0123", calibrated: 2026-01-31, calibration_due: 2027-01-31}
streams:
  loop:
    records: entries
    time: {column: t}
    channels: {velocity: {column: w, quantity: velocity}}
"""


def imported(folder, mapping):
    source = folder / "log.json"
    source.write_text(json.dumps({"kp": 2.5, "entries": [{"t": 0.1 * k, "w": math.exp(-k)} for k in range(9)]}))
    (folder / "map.yaml").write_text(mapping)
    return import_runs([str(source)], folder / "map.yaml", folder / "runs")


def test_an_imported_run_says_what_its_mapping_says(tmp_path):
    (path,) = imported(tmp_path, MAPPING)
    parameters, instruments = described(path)
    assert parameters == {"hold_s": 6.0, "gain": 2.5}
    assert instruments["scope"] == {
        "model": "MSO54",
        "serial": "C0123",
        "calibrated": "2026-01-31",
        "calibration_due": "2027-01-31",
    }


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("calibrated: 20260131", "20260131: a date as 2026-01-31 was expected"),
        ("calibrated: 2026-02-30", "'2026-02-30': a date as 2026-01-31 was expected"),
        ("calibrated: 2026-01-31T00:00:00", "a date as 2026-01-31 was expected"),
        ("serial: 0815", '815: a text was expected: put it in quotes, "815"'),
        ("calibrated: 2026-01-31, calibration_due: 2025-01-31", "calibration_due 2025-01-31 is before calibrated"),
        ("calibratd: 2026-01-31", "unknown key; calibrated was expected"),
    ],
)
def test_what_is_no_date_and_no_serial_number_is_refused_where_it_stands(tmp_path, wrong, message):
    mapping = MAPPING.replace(MAPPING[MAPPING.index("model: MSO54") : MAPPING.index("}\nstreams")], wrong)
    with pytest.raises(InputError) as refusal:
        imported(tmp_path, mapping)
    (fault,) = refusal.value.faults
    assert message in fault
    assert fault.startswith(f"{tmp_path / 'map.yaml'}:6:")
