"""What goes into a run file comes out of it, by this reader and by others."""

import hashlib
import re
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leactl.errors import InputError, MissingChannel, SafetyTrip
from leactl.quantities import UNITS, ChannelSpec
from leactl.runfile.layout import ROOT_ATTRIBUTES, channel_attributes
from leactl.runfile.read.reader import Run
from leactl.runfile.write.writer import RunWriter, new_run_id

from .specimen import LOOP, PROTOCOL, STREAMS, info


def test_a_run_comes_back(complete: Path):
    with Run.open(complete) as run:
        assert (run.status, run.mechanical, run.setup["drive_gain"]) == ("complete", "coupled", 0.98)
        assert run.attributes["simulated"] == 1
        assert run.source("protocol") == PROTOCOL
        assert run.source("model") is None
        torque = run.channel("torque")
        assert torque.values.dtype == np.float64
        assert torque.sampling == "mean"
        assert np.flatnonzero(np.isnan(torque.values)).tolist() == [500]
        assert torque.time[-1] == 0.999
        assert [step.parameters for step in run.steps] == [{"current_A": 2.0, "note": "größer"}, {}]
        assert run.events[0].message == "x" * 2000
        assert [spec.name for spec in run.streams["loop"]] == ["iq", "theta", "a_torque"]


def test_blocks_of_no_stream_or_no_row_are_refused(complete: Path):
    with Run.open(complete) as run:
        stream = next(iter(run.streams))
        with pytest.raises(InputError, match=f"no stream 'nope'; the run has {stream}"):
            run.blocks("nope", 10)
        for rows in (0, -5):
            with pytest.raises(InputError, match=f"blocks of {rows} rows: 1 or more"):
                run.blocks(stream, rows)
        assert [len(block["time"]) for block in run.blocks(stream, run.rows[stream] - 1)] == [run.rows[stream] - 1, 1]


def test_a_closed_run_says_that_it_is_closed(complete: Path):
    with Run.open(complete) as run:
        stream, (spec, *_) = next(iter(run.streams.items()))
    for read in (lambda: run.channel_at(f"{stream}/{spec.name}"), lambda: run.time(stream)):
        with pytest.raises(InputError, match="the run is closed; read its channels inside the `with` block"):
            read()


def test_a_channel_behind_a_multiplexer_has_stamps_of_its_own(tmp_path):
    first = ChannelSpec("ab", "phase_voltage_ab", "test", "daq", scale_std=2e-4)
    with RunWriter(
        tmp_path, info(), {"daq": [first, first._replace(name="bc", quantity="phase_voltage_bc", skew_s=14e-6)]}
    ) as writer:
        writer.append("daq", np.array([0.0, 0.1]), np.ones((2, 2)))
    with Run.open(writer.path) as run:
        assert run.channel("phase_voltage_ab").time.tolist() == [0.0, 0.1]
        assert run.channel("phase_voltage_bc").time.tolist() == [14e-6, 0.1 + 14e-6]
        assert [spec.scale_std for spec in run.streams["daq"]] == [2e-4, 2e-4]
        assert run.time("daq").tolist() == [0.0, 0.1]


@pytest.mark.parametrize(
    ("name", "value"), [("skew", "late"), ("skew", np.nan), ("scale_std", -0.1), ("scale_std", 1e300)]
)
def test_a_skew_or_an_uncertainty_that_is_no_number_is_refused(complete: Path, name, value):
    with h5py.File(complete, "r+") as file:
        file["streams/loop/iq"].attrs[name] = value
    with pytest.raises(
        InputError, match=rf"/streams/loop/iq: {name} is .*; a (finite number|number from 0 to 1) was expected"
    ):
        Run.open(complete)


def test_several_places_must_be_told_apart(complete: Path):
    with Run.open(complete) as run:
        with pytest.raises(InputError, match=r"active_1, inactive_2"):
            run.channel("housing_temperature")
        assert run.channel("housing_temperature", location="inactive_2").location == "inactive_2"
        assert len(run.channels("housing_temperature")) == 2
        with pytest.raises(MissingChannel, match=r"no velocity of load.*torque of test"):
            run.channel("velocity", role="load")
        assert not run.has("velocity")


def test_xarray_opens_a_stream_unchanged(complete: Path):
    with xarray.open_dataset(complete, engine="h5netcdf", group="streams/loop") as loop:
        assert loop["iq"].dims == ("time",)
        assert loop["iq"].attrs["units"] == "A"
        assert loop["theta"].sel(time=0.5).item() == 250.0


def test_the_protocol_text_has_the_checksum_of_its_file(complete: Path):
    with h5py.File(complete) as file:
        assert file["protocol/source"].attrs["sha256"] == hashlib.sha256(PROTOCOL.encode()).hexdigest()
        assert file["streams/loop/iq"].compression == "gzip"
        assert file["streams/loop/iq"].dims[0][0].name == "/streams/loop/time"


finite = st.floats(allow_nan=True, allow_infinity=True, width=64)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    gaps=st.lists(st.integers(1, 10**6), max_size=60),
    values=arrays("f8", (60, 3), elements=finite),
    cuts=st.sets(st.integers(0, 60)),
    texts=st.lists(st.text(max_size=600), max_size=3),
)
def test_any_rows_and_texts_survive(tmp_path_factory: pytest.TempPathFactory, gaps, values, cuts, texts):
    specs = [spec._replace(dtype="f8") for spec in LOOP]
    times = np.cumsum(np.array([0, *gaps])) * 1e-6
    values = values[: len(times)] if len(times) <= 60 else np.vstack([values, values[:1]])
    with RunWriter(tmp_path_factory.mktemp("run"), info(), {"loop": specs}) as writer:
        edges = [0, *sorted(cut for cut in cuts if cut < len(times)), len(times)]
        for start, stop in pairwise(edges):
            writer.append("loop", times[start:stop], values[start:stop])
            for text in texts:
                writer.step(text, 0.0, 1.0, 0.0, {"text": text})
                writer.event(0.0, "info", text, text)
            writer.flush()
    with Run.open(writer.path) as run:
        for index, spec in enumerate(specs):
            channel = run.channel(spec.quantity)
            np.testing.assert_array_equal(channel.time, times)
            np.testing.assert_array_equal(channel.values, values[:, index])
        assert [step.parameters["text"] for step in run.steps] == texts * (len(edges) - 1)


@pytest.mark.parametrize("time", [0.0, -1.0, float("nan"), float("inf")])
def test_time_that_does_not_increase_is_refused(tmp_path: Path, time: float):
    with RunWriter(tmp_path, info(), {"loop": LOOP}) as writer:
        writer.append_row("loop", 0.0, [1, 2, 3])
        with pytest.raises(ValueError, match="does not come after"):
            writer.append_row("loop", time, [1, 2, 3])
        with pytest.raises(ValueError, match="do not increase"):
            writer.append("loop", np.array([1.0, time]), np.zeros((2, 3)))
        with pytest.raises(ValueError, match="1 values for 3 channels"):
            writer.append_row("loop", 1.0, [1])
    with Run.open(writer.path) as run:
        assert run.rows == {"loop": 1}


def test_nothing_is_ever_overwritten(complete: Path):
    before = complete.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        RunWriter(complete.parent, info(), STREAMS)
    assert complete.read_bytes() == before
    complete.rename(complete.with_name(complete.name + ".partial"))
    with pytest.raises(InputError, match="exists already"):
        RunWriter(complete.parent, info(), STREAMS)
    assert len(list(complete.parent.iterdir())) == 1


def test_a_description_that_breaks_the_format_is_refused_in_full(tmp_path: Path):
    wrong = [ChannelSpec("a", "torque", "test", "x", units="Nm"), ChannelSpec("a", "torque", "best", "x", dtype="i4")]
    with pytest.raises(InputError) as caught:
        RunWriter(tmp_path, info("../x"), {"loop": wrong})
    assert len(caught.value.faults) == 6
    assert not list(tmp_path.iterdir())


def test_an_exception_names_its_end(tmp_path: Path):
    with pytest.raises(SafetyTrip), RunWriter(tmp_path, info(), STREAMS) as writer:
        raise SafetyTrip("winding above 120 degC\nsecond line")
    with Run.open(writer.path) as run:
        assert (run.status, run.attributes["status_reason"]) == ("tripped", "winding above 120 degC second line")


def test_run_ids_sort_by_time():
    when = datetime(2026, 11, 20, 10, 15, 30, tzinfo=UTC)
    assert new_run_id("Torque constant", when).startswith("20261120T101530Z-torque-constant-")


def test_every_attribute_of_a_channel_and_of_the_root_is_documented():
    text = (Path(__file__).parents[2] / "docs" / "reference" / "run-format.md").read_text(encoding="utf-8")
    whole = ChannelSpec("a", "torque", "test", "daq", "shaft", "left", "mean", "N*m", "f8", 0.001, 0.002)
    for name in (*channel_attributes(whole), *ROOT_ATTRIBUTES):
        assert f"`{name}`" in text
    for quantity, unit in UNITS.items():
        assert any(quantity.endswith(end) and unit in text for end in re.findall(r"`(\w+)`", text))
