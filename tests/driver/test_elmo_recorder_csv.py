"""The drive's recordings as files whose bytes stand here: signals, units, conventions, and what is refused."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.elmo_recorder_csv.driver import ElmoRecorderCsv
from leactl_plugins.elmo_recorder_csv.emulator import RecorderEmulator
from leactl_plugins.elmo_recorder_csv.settings import ElmoRecorderCsvSettings
from pydantic import ValidationError

from leactl.errors import InputError

SIGNALS = {
    "current": {"column": "Active Current", "quantity": "q_axis_current"},
    "velocity": {"column": "Velocity", "quantity": "velocity"},
}
FILE = "Time [ms],Active Current [A],Velocity [cnt/sec]\n0,1.0,40000\n1,2.0,20000\n2,-1.5,-40000\n"


def recorder(**given):
    given = {"signals": SIGNALS, "time_column": "Time", "counts_per_turn": 40000} | given
    return ElmoRecorderCsv("recorder", "test", ElmoRecorderCsvSettings(**given), None, None)


def read(tmp_path, text, **given):
    path = tmp_path / "recording.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return recorder(**given).read_files([path])


def test_amperes_become_the_q_axis_and_counts_become_angle(tmp_path):
    record = read(tmp_path, FILE)
    np.testing.assert_allclose(record.values[:, 0], math.sqrt(1.5) * np.array([1.0, 2.0, -1.5]))
    np.testing.assert_allclose(record.values[:, 1], 2 * math.pi * np.array([1.0, 0.5, -1.0]))
    np.testing.assert_allclose(record.time, [0.0, 0.001, 0.002])
    assert {spec.location for spec in record.channels} == {"recorder"}
    assert record.began is None
    turned = read(tmp_path, FILE, sign=-1, current_convention="power_invariant")
    np.testing.assert_allclose(turned.values[:, 0], [-1.0, -2.0, 1.5])
    assert turned.values[0, 1] == -2 * math.pi


def test_a_recording_without_stamps_takes_the_interval_that_is_set(tmp_path):
    text = "Active Current [A];Velocity [cnt/sec]\n1,25;40000\n2,5;20000\n"
    record = read(tmp_path, text, time_column=None, interval_s=0.001)
    missed = read(tmp_path, text.replace("\n2,5", "\n;\n2,5"), time_column=None, interval_s=0.001)
    np.testing.assert_allclose(missed.values[:, 0], math.sqrt(1.5) * np.array([1.25, np.nan, 2.5]))
    np.testing.assert_allclose(record.time, [0.0, 0.001])
    np.testing.assert_allclose(record.values[:, 0], math.sqrt(1.5) * np.array([1.25, 2.5]))


@pytest.mark.parametrize(
    ("text", "given", "words"),
    [
        (FILE.replace(" [ms]", ""), {}, "'Time' names no unit of time; time_units decides"),
        (FILE, {"time_units": "s"}, "is in ms; time_units says s"),
        (FILE.replace(" [A]", ""), {}, "names no unit; units of the signal decide"),
        (FILE.replace("[A]", "[V]"), {}, "'V', which does not measure q_axis_current"),
        (
            FILE.replace("[A]", "[mA]"),
            {"signals": SIGNALS | {"current": SIGNALS["current"] | {"units": "A"}}},
            "units say A",
        ),
        (
            FILE.replace("[A]", "[%]"),
            {"signals": SIGNALS | {"current": SIGNALS["current"] | {"units": "A"}}},
            "is in %; units say A",
        ),
        (
            FILE.replace(" [ms]", "").replace("\n1,", "\n1 ms,"),
            {"time_units": "s"},
            "'Time' is in ms; time_units says s",
        ),
        (FILE.replace("\n1,", "\n1 s,"), {}, "'Time \\[ms\\]' holds numbers in ms and s"),
        (
            FILE.replace(" [ms]", "").replace("\n1,", "\n1 s,").replace("\n2,", "\n2 ms,"),
            {},
            "'Time' holds numbers in ms and s",
        ),
        (FILE, {"counts_per_turn": None}, "counts_per_turn is needed"),
        (FILE.replace("Velocity", "Speed"), {}, "no line has the headings 'Velocity'"),
        (FILE.replace("1.0,", ">100,"), {}, "holds '>100'; a number was expected"),
        (
            FILE.replace("1.0,", "1e999,"),
            {},
            "line 2, column 'Active Current .A.': '1e999' is no number with decimal '.'",
        ),
        (FILE.replace("1.0,", "1.0 V,"), {}, "holds numbers in V; A was expected"),
        (FILE.replace("\n2,", "\n1,"), {}, "line 4.*stands twice"),
        (FILE.replace("\n2,", "\n0.5,"), {}, "line 4.*goes back by 0.0005 s"),
        (
            "Time [s];Active Current [A];Velocity [cnt/sec]\n1,000;1,234;1,000\n2,000;1,235;1,000\n",
            {},
            "decimal decides",
        ),
        (b"PK\x03\x04" + bytes(range(256)), {}, "not utf-8 at byte|NUL"),
        ("", {}, "empty"),
    ],
)
def test_what_a_recording_does_not_say_is_refused_with_the_key_that_does(tmp_path, text, given, words):
    with pytest.raises(InputError, match=words) as refused:
        read(tmp_path, text, **given)
    assert all("\n" not in fault and "recording.csv" in fault for fault in refused.value.faults)


def test_uneven_stamps_and_missing_samples_are_told(tmp_path):
    record = read(tmp_path, FILE + "7,,0\n8,1.0,0\n")
    told = "\n".join(record.remarks)
    assert "UNEVEN: 0.001 to 0.005 s apart" in told
    assert "1 gaps, about 4 frames missing" in told
    assert np.isnan(record.values[3, 0])


POSITION = {"angle": {"column": "Position", "quantity": "angle"}}


def positions(tmp_path, *counts, **given):
    rows = "".join(f"{number},{count}\n" for number, count in enumerate(counts))
    record = read(tmp_path, f"Time [ms],Position [cnt]\n{rows}", signals=POSITION, **given)
    return record.values[:, 0] * 40000 / (2 * math.pi), "\n".join(record.remarks)


def test_a_position_that_crosses_the_end_of_its_range_goes_on(tmp_path):
    crossing = 999_999_990, 999_999_998, -999_999_994, -999_999_986, -999_999_994, 999_999_998, 999_999_990
    counts, told = positions(tmp_path, *crossing)
    np.testing.assert_allclose(counts - 1e9, [-10, -2, 6, 14, 6, -2, -10], atol=1e-5)
    assert "Position [cnt] wraps 2 times at the end of -1000000000 to 1000000000 counts, first at " in told
    assert "line 4" in told
    mirrored, _ = positions(tmp_path, *(-count for count in crossing))
    np.testing.assert_allclose(mirrored + 1e9, [10, 2, -6, -14, -6, 2, 10], atol=1e-5)
    turned, _ = positions(tmp_path, *crossing, sign=-1)
    np.testing.assert_allclose(turned, -counts)


def test_a_number_missed_at_the_crossing_does_not_hide_it(tmp_path):
    counts, told = positions(tmp_path, 999_999_990, "NaN", -999_999_990, "NaN", -999_999_980)
    np.testing.assert_allclose(counts - 1e9, [-10, np.nan, 10, np.nan, 20], atol=1e-5)
    assert "wraps 1 times" in told


def test_the_range_of_the_drive_is_a_setting(tmp_path):
    counts, told = positions(tmp_path, 19_990, -19_990, position_range=[-20_000, 20_000])
    np.testing.assert_allclose(counts, [19_990, 20_010])
    assert "at the end of -20000 to 20000 counts" in told
    counts, told = positions(tmp_path, 999_999_990, -999_999_990, position_range=None)
    np.testing.assert_allclose(counts, [999_999_990, -999_999_990])
    assert "wraps" not in told
    counts, told = positions(tmp_path, 5, 900_000_000)
    np.testing.assert_allclose(counts, [5, 900_000_000])
    assert "wraps" not in told
    with pytest.raises(
        InputError, match=r"line 3.*: 1000000001 counts; the drive's position_range ends at -1000000000"
    ):
        positions(tmp_path, 999_999_990, 1_000_000_001)


def test_several_files_are_no_recording(tmp_path):
    with pytest.raises(InputError, match="2 files; a recording is one file"):
        recorder().read_files([tmp_path / "a.csv", tmp_path / "b.csv"])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"time_column": None}, "give either time_column or interval_s"),
        ({"interval_s": 0.001}, "give either time_column or interval_s"),
        ({"signals": {"a": {"column": "x", "quantity": "velocity", "units": "A"}}}, "'A' do not measure velocity"),
        ({"signals": {}}, "signals"),
        ({"position_range": [5, 5]}, r"position_range \[5, 5\] counts: the lowest first"),
    ],
)
def test_wrong_keys_of_the_map_are_refused(given, words):
    with pytest.raises(ValidationError, match=words):
        recorder(**given)


class Turning:
    """A machine whose readings are known at any time."""

    bus_voltage = 29.6

    def __init__(self):
        self.time = 0.0

    def read(self):
        return 3.0 * math.sin(20 * self.time), 5.0 * self.time, 2.5 * self.time**2


@settings(max_examples=15)
@given(
    st.sampled_from([(",", "."), (";", ","), ("\t", "."), ("\t", ","), (";", ".")]),
    st.sampled_from(["amplitude", "rms", "power_invariant"]),
    st.sampled_from([1, -1]),
    st.sampled_from(["utf-8", "utf-16-le", "gbk"]),
)
def test_what_the_emulated_recorder_saves_is_read_back(tmp_path_factory, marks, convention, sign, encoding):
    folder = tmp_path_factory.mktemp("recorder")
    signals = SIGNALS | {"angle": {"column": "Position", "quantity": "angle"}}
    written = {"delimiter": marks[0], "decimal": marks[1], "encoding": encoding}
    source = recorder(signals=signals, current_convention=convention, sign=sign, exports_folder=str(folder), **written)
    source.open()
    machine = Turning()
    far_end = RecorderEmulator(folder, "recorder", source.settings, machine)
    while far_end.due < math.inf:
        machine.time = far_end.due
        far_end.tick(machine.time)
    read_by = recorder(signals=signals, current_convention=convention, sign=sign, encoding=encoding)
    record = read_by.read_files(source.exports.fresh())
    assert len(record.time) == 16384 // 3
    time = 0.5 + record.time
    np.testing.assert_allclose(record.values[:, 0], 3.0 * np.sin(20 * time), atol=2e-6)
    np.testing.assert_allclose(record.values[:, 1], 5.0 * time, atol=1e-6)
    np.testing.assert_allclose(record.values[:, 2], 2.5 * time**2, atol=1e-6)
