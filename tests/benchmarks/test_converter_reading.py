"""One reading of the ADS1115 beside the bare smbus2 calls that it makes."""

import pytest
import smbus2.smbus2 as smbus2
from leactl_plugins.ads1115.driver import Ads1115
from leactl_plugins.ads1115.settings import Ads1115Settings

from leactl.driver.i2c_port import I2cPort
from tests.benchmarks.rounds import compare

LIMIT = 2.5
READINGS = 3000
IDLE, COUNT = 0x8000, 0x1234  # what the converter answers: the config written, not busy, and its reading
BLOCK = 8  # I2C_SMBUS_I2C_BLOCK_DATA, whose first byte is a length
held = {0: COUNT}  # registers


def answer(descriptor, request, message=None):
    """Stands for the kernel: fills in what a converter would send, most significant byte first."""
    if request == smbus2.I2C_SMBUS and message.read_write == smbus2.I2C_SMBUS_WRITE:
        high, low = message.data.contents.block[0:2]
        held[message.command] = high << 8 | low | IDLE
    if request == smbus2.I2C_SMBUS and message.read_write == smbus2.I2C_SMBUS_READ:
        value = held[message.command]
        at = 1 if message.size == BLOCK else 0
        block = message.data.contents.block
        block[at], block[at + 1] = value >> 8, value & 0xFF


class SteppingClock:
    """Ten milliseconds pass whenever somebody looks: a conversion is always over."""

    def __init__(self):
        self._time = 0.0

    def now(self):
        self._time += 0.01
        return self._time


class Listening(smbus2.SMBus):
    """Notes the calls that one reading makes."""

    def __init__(self):
        super().__init__()
        self.calls = None

    def __getattribute__(self, name):
        result = super().__getattribute__(name)
        if name.startswith(("read_", "write_")) and self.calls is not None:
            return lambda *values: (self.calls.append((name, values)), result(*values))[1]
        return result


def converter(bus):
    item = {"name": "torque", "quantity": "torque", "role": "test", "pins": "A0-A1", "range_V": 6.144}
    settings = Ads1115Settings(inputs=[{**item, "scale_per_V": 3.0}])
    driver = Ads1115("torque_sensor", "bench", settings, I2cPort(lambda: bus), SteppingClock())
    driver.open()
    return driver


def test_a_reading_costs_little_beside_the_calls_it_makes(monkeypatch, figure):
    monkeypatch.setattr(smbus2, "ioctl", answer)
    listening = Listening()
    driver = converter(listening)
    driver.take()
    listening.calls = []
    (row,) = driver.take()
    assert row.values == pytest.approx((COUNT * 3.0 * 6.144 / 32768,))
    calls = listening.calls
    assert len(calls) == 3

    driver = converter(smbus2.SMBus())
    bare = smbus2.SMBus()
    bound = [(getattr(bare, name), values) for name, values in calls]

    def readings():
        for _ in range(READINGS):
            driver.take()

    def bare_calls():
        for _ in range(READINGS):
            for call, values in bound:
                call(*values)

    result = compare(readings, bare_calls, each=READINGS)
    figure(f"reading of the ADS1115: {result:us} of its three bare smbus2 calls; limit {LIMIT}")
    assert result.ratio <= LIMIT
