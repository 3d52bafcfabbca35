"""The driver on its emulated converter: stamps, steps, ranges, losses, and an end that is told."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leactl_plugins.ni_daq import emulator
from leactl_plugins.ni_daq.acquisition import DaqmxError
from leactl_plugins.ni_daq.driver import NiDaq
from leactl_plugins.ni_daq.settings import NiDaqSettings
from pydantic import ValidationError

from leactl.emulation.clock import EmulatedClock
from leactl.errors import DeviceError, InputError, NoAnswer

PAIRS = ("ab", "bc", "ca")
STEP = 10.0 / 32768


class Leads:
    """A bench whose pairs carry given voltages of time."""

    def __init__(self, volts):
        self._volts, self.chance = volts, np.random.default_rng(3)

    def terminals(self, role):
        return self

    def voltages(self, times, pair):
        return np.asarray(self._volts(times, pair), float) * np.ones_like(times)


class Daq:
    """A driver, its converter, and the clock that both keep."""

    def __init__(self, volts=lambda times, pair: 0.0, pairs=PAIRS, **changes):
        inputs = [
            {"name": name, "quantity": f"phase_voltage_{name}", "channel": f"ai{place}"} | changes.pop(name, {})
            for place, name in enumerate(pairs)
        ]
        self.settings = NiDaqSettings(**({"library": "emulated", "inputs": inputs} | changes))
        self.clock = EmulatedClock()
        self.far = NiDaq.far_end(self.settings, "bench", Leads(volts))
        self.clock.follow(self.far.tick)
        self.clock.stop_at(lambda: self.far.due)
        self.driver = NiDaq("daq", "bench", self.settings, self.far, self.clock)

    def run(self, seconds, period=0.002):
        """All samples of a loop of this period, as times and rows."""
        blocks, end = [], self.clock.now() + seconds
        while self.clock.now() < end:
            blocks += self.driver.take()
            self.clock.sleep_until(self.clock.now() + period)
        assert all(len(block.times) == len(block.values) > 0 for block in blocks)
        times = np.concatenate([block.times for block in blocks]) if blocks else np.empty(0)
        values = np.vstack([block.values for block in blocks]) if blocks else np.empty((0, len(self.settings.inputs)))
        assert (np.diff(times) > 0).all()
        return times, values


def test_each_input_is_sampled_at_its_stamp_and_skew():
    daq = Daq(lambda times, pair: 8.0 * np.sin(300.0 * times + pair))
    daq.driver.open()
    times, values = daq.run(0.2)
    channels = daq.driver.streams[0].channels
    assert [channel.skew_s for channel in channels] == pytest.approx([0.0, 14e-6, 28e-6])
    assert len(times) >= 1800
    for place, channel in enumerate(channels):
        true = 8.0 * np.sin(300.0 * (times + channel.skew_s) + place)
        assert np.abs(values[:, place] - true).max() <= 0.5 * STEP + 1e-9


@given(st.floats(0.5, 40000.0), st.integers(1, 3))
@settings(max_examples=30)
def test_no_stamp_is_ahead_of_the_clock_and_none_is_made_up(rate, inputs):
    daq = Daq(pairs=PAIRS[:inputs], rate_Hz=rate)
    daq.driver.open()
    coerced = daq.far.task.rate_Hz
    assert 0 <= coerced / rate - 1.0 <= 0.003
    for _ in range(30):
        for block in daq.driver.take():
            assert block.times[-1] + daq.driver.streams[0].channels[-1].skew_s <= daq.clock.now() + 1e-9
            np.testing.assert_allclose(np.diff(block.times), 1.0 / coerced, rtol=1e-6)
        daq.clock.sleep_until(daq.clock.now() + 0.01)
    assert daq.driver._count <= 0.3 * coerced + 1


def test_a_clock_that_runs_ahead_of_the_bench_is_held_back_and_told():
    daq = Daq()
    daq.driver.open()
    far = daq.far.task

    class Fast:
        """The same acquisition, said to be slower than it is."""

        rate_Hz, convert_Hz, start, read = far.rate_Hz / 1.001, far.convert_Hz, far.start, far.read  # noqa: N815

    daq.driver._task = Fast()
    times, _ = daq.run(3.0)
    assert times[-1] <= daq.clock.now()
    assert len(times) >= 29900
    assert any("has gained" in text for text in daq.driver.notices())


@pytest.mark.parametrize(("range_V", "lost"), [(10.0, 0), (5.0, 1), (1.0, 1)])
def test_what_lies_beyond_the_range_is_nan_and_told(range_V, lost):  # noqa: N803
    daq = Daq(lambda times, pair: 6.0 * np.sin(300.0 * times), bc={"range_V": range_V})
    daq.driver.open()
    _, values = daq.run(0.5)
    told = [text for text in daq.driver.notices() if "beyond" in text]
    missing = np.isnan(values)
    assert not missing[:, [0, 2]].any()
    if not lost:
        assert not missing.any()
        assert not told
        return
    true = 2.0 / math.pi * math.acos(range_V / 6.0)
    assert missing[:, 1].mean() == pytest.approx(true, abs=0.02)
    assert np.nanmax(np.abs(values[:, 1])) < range_V
    assert told == [f"input bc: {missing[:, 1].sum()} samples beyond +-{range_V:g} V are NaN"]


def test_scale_and_sign_of_an_input_and_the_one_error_of_scale():
    daq = Daq(lambda times, pair: 2.0, ab={"scale_per_V": 4.0, "sign": -1}, scale_std_ppm=1000.0)
    daq.driver.open()
    _, values = daq.run(0.1)
    off = values[0] / 2.0 - 1.0
    np.testing.assert_allclose(off, daq.far.scale - 1.0, atol=4 * STEP)
    assert 0.0 < abs(daq.far.scale - 1.0) < 0.005
    assert all(channel.scale_std == pytest.approx(1e-3) for channel in daq.driver.streams[0].channels)


@pytest.fixture
def small_buffer(monkeypatch):
    monkeypatch.setattr(emulator, "BUFFER_S", 0.5)


def test_a_host_that_stalls_loses_samples_and_says_how_many(small_buffer):
    daq = Daq(lambda times, pair: times)
    daq.driver.open()
    before, _ = daq.run(0.1)
    daq.clock.sleep_until(daq.clock.now() + 0.7)
    times, values = daq.run(0.2)
    missing = np.isnan(values).all(axis=1)
    assert missing.sum() == pytest.approx(7000, abs=400)
    assert missing[: missing.sum()].all()  # they come first, and then nothing else is missing
    assert times[0] - before[-1] == pytest.approx(1e-4, rel=1e-6)
    np.testing.assert_allclose(values[~missing][:, 0], times[~missing], atol=STEP)
    assert any(text.startswith(f"{missing.sum()} samples are lost") for text in daq.driver.notices())


def test_the_fourth_overrun_is_a_failure(small_buffer):
    daq = Daq()
    daq.driver.open()
    with pytest.raises(DeviceError, match=r"daq: NI-DAQmx -200279 \(SAMPLES_NO_LONGER_AVAILABLE\)"):
        for _ in range(5):
            daq.run(0.1)
            daq.clock.sleep_until(daq.clock.now() + 0.7)
    assert daq.driver._restarts == 3


def test_a_finite_acquisition_ends_by_itself_and_its_stream_says_so():
    daq = Daq(duration_s=0.25)
    daq.driver.open()
    assert daq.driver.streams[0].ends
    times, _ = daq.run(3.0)
    assert len(times) == 2500
    assert daq.driver.notices()[-1] == "the acquisition of 2500 samples is complete"
    assert not Daq().driver.streams[0].ends


def test_a_device_that_goes_in_mid_run_fails_and_one_that_falls_silent():
    gone = Daq()
    gone.driver.open()
    gone.run(0.1)
    gone.far.unplug()
    with pytest.raises(DeviceError, match=r"-201003 \(DEV_CANNOT_BE_ACCESSED\): the device is gone: check cable"):
        gone.run(0.1)
    assert gone.driver.safe_state(1.0).safe
    gone.driver.close()
    silent = Daq(rate_Hz=0.5)
    silent.driver.open()
    with pytest.raises(NoAnswer, match="no sample for 1"):
        silent.run(3.0)


@pytest.mark.parametrize(
    ("changes", "code"),
    [({"rate_Hz": 90000.0}, -200332), ({"ab": {"channel": "ai32"}}, -200170), ({"ab": {"range_V": 20}}, -200077)],
)
def test_what_the_device_refuses(changes, code):
    daq = Daq(**changes)
    with pytest.raises(DeviceError, match=f"daq: NI-DAQmx {code} "):
        daq.driver.open()


def test_a_device_in_use_is_free_again_after_close():
    daq = Daq()
    daq.driver.open()
    with pytest.raises(DaqmxError, match="-50103"):
        daq.far.acquire(daq.settings, None)
    daq.driver.close()
    daq.driver.close()
    daq.driver.open()


@pytest.mark.parametrize(("library", "port"), [("nidaqmx", True), ("emulated", False)])
def test_neither_library_takes_the_other_s_place(library, port):
    daq = Daq(library=library)
    driver = NiDaq("daq", "bench", daq.settings, daq.far if port else None, daq.clock)
    with pytest.raises(InputError, match=f"library '{library}' on a bench that is"):
        driver.open()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"bc": {"channel": "ai0"}}, "share a channel"),
        ({"bc": {"quantity": "phase_voltage_ab"}}, "share a quantity and role"),
        ({"bc": {"name": "ab"}}, "share a name"),
        ({"duration_s": 80000.0, "rate_Hz": 1e5}, "leave duration_s out"),
        ({"library": "auto"}, "'nidaqmx' or 'emulated'"),
        ({"scale_std_ppm": -1}, "greater than or equal to 0"),
        ({"bc": {"channel": "Dev1/ai0"}}, "match pattern"),
    ],
)
def test_settings_that_are_refused(changes, said):
    with pytest.raises(ValidationError, match=said):
        Daq(**changes)
