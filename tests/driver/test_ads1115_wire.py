"""The ADS1115 driver against the converter's far end: registers, waits, saturation, zero."""

import errno
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from leactl_plugins.ads1115.driver import Ads1115
from leactl_plugins.ads1115.emulator import Ads1115Emulator
from leactl_plugins.ads1115.settings import Ads1115Settings
from pydantic import ValidationError

from leactl.driver.i2c_port import I2cPort
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires import EmulatedI2cBus
from leactl.errors import DeviceError, NoAnswer

TORQUE = {"name": "torque", "quantity": "torque", "role": "test", "pins": "A0-A1", "scale_per_V": 3.0}


class TapedBus(EmulatedI2cBus):
    def __init__(self, clock):
        super().__init__(clock)
        self.tape = []
        self.error = None

    def read_i2c_block_data(self, i2c_addr, register, length, force=None):
        if self.error:
            raise OSError(self.error, "injected")
        answer = super().read_i2c_block_data(i2c_addr, register, length, force)
        self.tape.append(("read", i2c_addr, register, answer))
        return answer

    def write_i2c_block_data(self, i2c_addr, register, data, force=None):
        if self.error:
            raise OSError(self.error, "injected")
        self.tape.append(("write", i2c_addr, register, list(data)))
        super().write_i2c_block_data(i2c_addr, register, data, force)


class AdcBench:
    def __init__(self, *inputs, address=0x48, **emulation):
        self.clock = EmulatedClock()
        self.bus = TapedBus(self.clock)
        self.volts = [0.0, 0.0, 0.0, 0.0]
        self.far = Ads1115Emulator(lambda pin: self.volts[pin], **emulation)
        self.bus.devices[0x48] = self.far
        self.port = I2cPort(lambda: self.bus, "i2c-1")
        settings = Ads1115Settings(address=address, inputs=inputs or (TORQUE,))
        self.adc = Ads1115("torque_sensor", "bench", settings, self.port, self.clock)

    def rows(self, count, period=0.001):
        found = []
        for _ in range(100_000):
            found += self.adc.take()
            if len(found) >= count:
                return found
            self.clock.sleep_until(self.clock.now() + period)
        raise AssertionError("no rows")


@pytest.fixture
def bench():
    bench = AdcBench()
    bench.adc.open()
    bench.bus.tape.clear()
    return bench


def test_one_reading_is_start_poll_read_most_significant_byte_first(bench):
    bench.volts[:2] = 1.0, -0.5
    (row,) = bench.rows(1, period=0.002)
    assert bench.bus.tape == [
        ("write", 0x48, 1, [0x83, 0xE3]),
        ("read", 0x48, 1, [0x83, 0xE3]),
        ("read", 0x48, 0, [0x2E, 0xE0]),
        ("write", 0x48, 1, [0x83, 0xE3]),
    ]
    assert row.values == (pytest.approx(4.5),)


def test_the_stamp_is_the_middle_of_the_conversion_not_the_time_of_reading(bench):
    start = bench.clock.now()
    (row,) = bench.rows(1, period=0.050)
    assert row.time - start == pytest.approx((1 / 860 + 25e-6) / 2)


def test_a_slow_converter_is_waited_for_and_nothing_is_read_twice():
    bench = AdcBench(clock_error=-0.10)
    bench.adc.open()
    level = [0.0]
    bench.far._pins = lambda pin: level[0] if pin == 0 else 0.0
    seen = []
    for step in range(400):
        level[0] = step * 1e-3
        seen += [round(row.values[0] / 3.0 * 1e3) for row in bench.adc.take()]
        bench.clock.sleep_until(bench.clock.now() + 0.0005)
    assert len(seen) > 100
    assert seen == sorted(set(seen))


@pytest.mark.parametrize(("volts", "sign"), [(4.2, "+"), (-4.2, "-")])
def test_saturation_is_a_fault_not_a_value(bench, volts, sign):
    bench.volts[0] = volts
    (row,) = bench.rows(1)
    assert math.isnan(row.values[0])
    assert row.fault == f"input torque is saturated at {sign}4.096 V"


@given(
    volts=st.floats(-0.25, 0.25),
    pins=st.sampled_from(["A0-A1", "A0-A3", "A1-A3", "A2-A3", "A0", "A1", "A2", "A3"]),
    range_v=st.sampled_from([6.144, 4.096, 2.048, 1.024, 0.512, 0.256]),
    rate=st.sampled_from([8, 16, 32, 64, 128, 250, 475, 860]),
    sign=st.sampled_from([-1, 1]),
    offset=st.floats(-1, 1),
)
def test_every_input_range_and_rate_reads_within_half_a_count(volts, pins, range_v, rate, sign, offset):
    bench = AdcBench({**TORQUE, "pins": pins, "range_V": range_v, "rate_sps": rate, "sign": sign, "offset_V": offset})
    bench.adc.open()
    bench.volts[int(pins[1])] = volts
    (row,) = bench.rows(1)
    count = range_v / 32768
    if volts <= range_v - 1.5 * count:
        assert row.values[0] == pytest.approx(sign * 3.0 * (volts - offset), abs=3.0 * count * 0.5001)


def test_tare_makes_the_present_torque_zero(bench):
    bench.volts[0] = 0.1
    readings = [row.values[0] for row in bench.rows(8)]
    assert bench.adc.tare({"torque_sensor": sum(readings) / 8}) == {"torque": pytest.approx(0.3, abs=2e-4)}
    assert bench.rows(2)[-1].values[0] == pytest.approx(0.0, abs=1e-6)


def test_several_inputs_take_turns_each_with_its_own_stream():
    voltage = {"name": "line", "quantity": "line_voltage", "role": "test", "pins": "A2", "scale_per_V": 1.0}
    bench = AdcBench(TORQUE, voltage)
    bench.adc.open()
    bench.volts[:3] = 0.5, 0.0, 2.0
    rows = bench.rows(4)
    assert [row.stream for row in rows] == ["torque_sensor_torque", "torque_sensor_line"] * 2
    assert [round(row.values[0], 3) for row in rows] == [1.5, 2.0, 1.5, 2.0]


@pytest.mark.parametrize(
    ("code", "kind", "words"),
    [
        (errno.EREMOTEIO, NoAnswer, "0x48: not acknowledged"),
        (errno.ENXIO, NoAnswer, "not acknowledged"),
        (errno.ETIMEDOUT, NoAnswer, "timed out"),
        (errno.EBUSY, DeviceError, "kernel driver"),
        (errno.EIO, DeviceError, "injected"),
    ],
)
def test_errors_of_the_bus_are_named(bench, code, kind, words):
    bench.bus.error = code
    with pytest.raises(kind, match=words):
        bench.adc.take()


def test_an_absent_converter_is_named():
    bench = AdcBench(address=0x49)
    with pytest.raises(NoAnswer, match="0x49"):
        bench.adc.open()


def test_a_conversion_that_never_ends_is_no_answer(bench):
    bench.far._finish = lambda now: None
    with pytest.raises(NoAnswer, match="has not ended"):
        bench.rows(1)


def test_settings_are_checked():
    for change in ({"pins": "A1-A0"}, {"range_V": 5.0}, {"quantity": "torqe"}, {"rate_sps": 900}, {"scale_per_V": 0}):
        with pytest.raises(ValidationError):
            Ads1115Settings(inputs=({**TORQUE, **change},))
