"""Readings that are followed: which row is new, which value is missing, and which device is named as silent."""

import math

import numpy as np
import pytest

from leactl.errors import MissingChannel
from leactl.quantities import ChannelSpec
from leactl.report.follow import ReadingSampler
from leactl.runner.progress import Progress

STREAMS = {
    "loop": (
        ChannelSpec("iq_ref", "q_axis_current_reference", "test", "drive"),
        ChannelSpec("iq", "q_axis_current", "test", "drive"),
        ChannelSpec("vbus", "bus_voltage", "test", "drive"),
    ),
    "load_supply": (ChannelSpec("vbus", "bus_voltage", "load", "load_drive"),),
    "camera": (ChannelSpec("housing", "housing_temperature", "test", "camera"),),
}


@pytest.fixture
def progress():
    return Progress("read", 0.0, STREAMS)


def test_channels_have_names_of_their_own_and_setpoints_are_left_out():
    assert ReadingSampler("mine", STREAMS, []).names == ("iq", "loop/vbus", "load_supply/vbus", "housing")
    assert ReadingSampler("mine", STREAMS, ["iq_ref", "bus_voltage:load"]).names == ("iq_ref", "vbus")


def test_a_word_that_chooses_no_channel_is_refused():
    with pytest.raises(
        MissingChannel, match=r"^no channel 'housin'; did you mean 'housing'; bench 'mine' has loop/iq_ref, "
    ):
        ReadingSampler("mine", STREAMS, ["housin"])


def test_a_row_counts_once_and_what_did_not_come_is_nan(progress):
    sampler, camera = ReadingSampler("mine", STREAMS, ["iq", "housing"]), [31.5]
    assert np.isnan(sampler.sample(progress).values).all()
    progress.values, progress.device_values, progress.time_s = [0.0, 1.5, 30.0], {"camera": camera}, 1.0
    rows = sampler.sample(progress)
    assert (rows.time.tolist(), rows.values.tolist(), rows.units) == ([1.0], [[1.5, 31.5]], ("A", "degC"))
    progress.values, progress.device_values, progress.time_s = [0.0, math.nan, 30.0], {"camera": camera}, 2.0
    assert np.isnan(sampler.sample(progress).values).all()
    progress.device_values = {"camera": [31.5]}  # a reading that is equal to the one before
    np.testing.assert_array_equal(sampler.sample(progress).values, [[math.nan, 31.5]])


def test_a_silent_device_is_named_once(progress):
    sampler = ReadingSampler("mine", STREAMS, ["iq", "housing"])
    warnings = []
    for second in range(20):
        progress.time_s, progress.values = float(second), [0.0, 1.5, 30.0]
        sampler.sample(progress)
        warnings += [(second, text) for text in sampler.newly_silent(progress.time_s, 1.0)]
    assert warnings == [(5, "camera: no reading for 5 s; its columns are nan until one comes")]


def test_a_device_is_given_the_time_between_two_looks(progress):
    sampler = ReadingSampler("mine", STREAMS, ["housing"])
    assert list(sampler.newly_silent(59.0, 60.0)) == []
    assert len(list(sampler.newly_silent(60.0, 60.0))) == 1
