"""Adafruit's driver of the ADS1115 at the emulated one: it reads what is at the pins, in every range, rate and pair."""

import pytest

from leactl.driver.i2c_port import swap_bytes
from leactl.emulation.clock import EmulatedClock
from leactl.emulation.wires.buses import EmulatedI2cBus
from tests.driver.failing import FailingConverter

ads1115 = pytest.importorskip("adafruit_ads1x15.ads1115", reason="needs the extra 'foreign'")
analog_in = pytest.importorskip("adafruit_ads1x15.analog_in", reason="needs the extra 'foreign'")

FULL_SCALE_V = {2 / 3: 6.144, 1: 4.096, 2: 2.048, 4: 1.024, 8: 0.512, 16: 0.256}
RATES = (8, 16, 32, 64, 128, 250, 475, 860)
TRANSFER_S = 1e-4
VOLTS = (0.2, -0.1, 0.05, 0.13)


class Bus:
    """CircuitPython's I2C, byte by byte, at an emulated bus whose time passes with every transfer."""

    def __init__(self):
        self.clock = EmulatedClock()
        self.bus = EmulatedI2cBus(self.clock)
        self._pointer = 0

    def try_lock(self):
        """The bus has one user."""
        return True

    def unlock(self):
        """See `try_lock`."""

    def writeto(self, address, buffer, *, start=0, end=None):
        """The first byte is the register that is meant; two more are its value."""
        self._pass_time()
        sent = bytes(buffer[start:end])
        if not sent:  # a probe: is anything at this address?
            self.bus.read_word_data(address, self._pointer)
            return
        self._pointer = sent[0]
        if len(sent) > 1:
            self.bus.write_word_data(address, self._pointer, int.from_bytes(sent[1:3], "little"))

    def readfrom_into(self, address, buffer, *, start=0, end=None):
        """The value of the register that was meant last, its high byte first."""
        self._pass_time()
        word = swap_bytes(self.bus.read_word_data(address, self._pointer)).to_bytes(2, "big")
        buffer[start:end] = word

    def writeto_then_readfrom(self, address, out, into, *, out_start=0, out_end=None, in_start=0, in_end=None):
        """Both, without a stop between them."""
        self.writeto(address, out, start=out_start, end=out_end)
        self.readfrom_into(address, into, start=in_start, end=in_end)

    def _pass_time(self):
        self.clock.sleep_until(self.clock.now() + TRANSFER_S)


@pytest.fixture
def bus():
    """A bus with a converter at its usual address, whose pins are at `VOLTS`."""
    bus = Bus()
    converter = FailingConverter()
    converter.apply(*VOLTS)
    bus.bus.devices[0x48] = converter
    return bus


@pytest.mark.parametrize("gain", FULL_SCALE_V)
def test_every_pin_and_pair_in_every_range(bus, gain):
    adc = ads1115.ADS1115(bus, gain=gain, data_rate=860)
    least = FULL_SCALE_V[gain] / 32768
    for pins in ((0,), (1,), (2,), (3,), (0, 1), (0, 3), (1, 3), (2, 3)):
        true = VOLTS[pins[0]] - (VOLTS[pins[1]] if len(pins) == 2 else 0.0)
        read = analog_in.AnalogIn(adc, *pins).voltage
        # Adafruit divides by 32767 where the data sheet has 32768 counts to the full scale
        expected = max(-FULL_SCALE_V[gain], min(FULL_SCALE_V[gain], true))
        assert read == pytest.approx(expected, abs=1.01 * least), pins


@pytest.mark.parametrize("rate", RATES)
def test_a_conversion_takes_as_long_as_its_rate_says(bus, rate):
    adc = ads1115.ADS1115(bus, data_rate=rate)
    began = bus.clock.now()
    adc.read(0)
    assert 1 / rate <= bus.clock.now() - began <= 1 / rate + 10 * TRANSFER_S


def test_the_thresholds_that_the_data_sheet_has_after_a_reset(bus):
    adc = ads1115.ADS1115(bus)
    assert (adc.comparator_low_threshold, adc.comparator_high_threshold) == (-32768, 32767)
