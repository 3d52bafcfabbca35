"""Channels chosen by name and thinned: no peak is lost, no gap is closed, nothing is invented."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leactl.errors import InputError, MissingChannel
from leactl.quantities import ChannelSpec
from leactl.runfile.read.reader import Run
from leactl.runfile.read.traces import channel_names, channel_trace, part_of_run
from leactl.runfile.write.writer import RunWriter

from .specimen import info


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["iq"], ["loop/iq"]),
        (["loop/theta", "theta"], ["loop/theta"]),
        (["torque"], ["loop/a_torque"]),
        (["housing_temperature:test"], ["camera/housing_1", "camera/housing_2"]),
        ([], ["camera/housing_1", "camera/housing_2", "loop/iq", "loop/theta", "loop/a_torque"]),
    ],
)
def test_a_word_is_a_name_or_a_quantity(complete: Path, words: list[str], names: list[str]):
    with Run.open(complete) as run:
        assert sorted(channel_names(run, words)) == sorted(names)


def test_a_word_that_chooses_nothing_is_refused_with_what_there_is(complete: Path):
    with Run.open(complete) as run, pytest.raises(MissingChannel, match=r"'thata'; did you mean 'theta'.*loop/iq"):
        channel_names(run, ["iq", "thata"])


def test_a_part_is_a_step_or_a_time(complete: Path):
    with Run.open(complete) as run:
        assert part_of_run(run, "hold", None, None) == (0.0, 1.0)
        assert part_of_run(run, "hold", 0.6, None) == (0.6, 1.0)
        assert part_of_run(run, "", None, 0.25) == (0.0, 0.25)
        with pytest.raises(InputError, match=r"no step 'lift'; the run has hold"):
            part_of_run(run, "lift", None, None)
        with pytest.raises(InputError, match="--to has to be after --from"):
            part_of_run(run, "", 5.0, 2.0)


def test_every_sample_is_there_where_few_are_asked_for(complete: Path):
    with Run.open(complete) as run:
        torque = channel_trace(run, "loop/a_torque", 0.49, 0.51, 100)
    assert torque.samples_per_bin == 1.0
    assert len(torque.time) == 21
    assert np.flatnonzero(np.isnan(torque.values)).tolist() == [10]
    assert json.loads(json.dumps(torque.as_json(), allow_nan=False))["values"][9:12] == [1.0, None, 1.0]


@settings(max_examples=40)  # each writes and reads a file
@given(
    seed=st.integers(0, 2**32 - 1),
    peak=st.integers(0, 4999),
    gap=st.tuples(st.integers(0, 4000), st.integers(0, 900)),
    bins=st.integers(2, 400),
)
def test_thinning_keeps_every_peak_and_every_gap(tmp_path_factory, seed, peak, gap, bins):
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.5e-3, 1.5e-3, 5000))
    values = random.normal(size=5000)
    values[peak] = 50.0
    values[gap[0] : gap[0] + gap[1]] = np.nan
    with RunWriter(
        tmp_path_factory.mktemp("run"), info(), {"loop": [ChannelSpec("a", "torque", "test", "sensor", dtype="f8")]}
    ) as writer:
        writer.append("loop", time, values[:, np.newaxis])
    with Run.open(writer.path) as run:
        thinned = channel_trace(run, "loop/a", time[0], time[-1], bins)
    finite = np.isfinite(values)
    assert np.nanmax(thinned.values) == values[finite].max()
    assert np.nanmin(thinned.values) == values[finite].min()
    width = (time[-1] - time[0]) / bins
    for centre, value in zip(thinned.time, thinned.values, strict=True):
        inside = finite & (np.abs(time - centre) <= width / 2 * (1 + 1e-9))
        assert np.isnan(value) or value in values[inside]
        assert np.isfinite(value) or not (finite & (np.abs(time - centre) < width / 2 * (1 - 1e-9))).any()
