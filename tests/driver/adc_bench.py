"""A converter's driver, its far end and the bus between them, with every transfer kept as its bytes on the wire."""

from leactl_plugins.ads1115.driver import Ads1115
from leactl_plugins.ads1115.settings import Ads1115Settings

from leactl.driver.i2c_port import I2cPort

from .transports import I2cInProcess

TORQUE = {"name": "torque", "quantity": "torque", "role": "test", "pins": "A0-A1", "scale_per_V": 3.0}


class Tap:
    """A connection to a bus with a tape, and an error number that a transfer ends with."""

    def __init__(self, wire) -> None:
        self._wire = wire
        self.tape = []
        self.error = None

    def connect(self):
        self._bus = self._wire.connect()
        return self

    def read_word_data(self, address, register):
        if self.error:
            raise OSError(self.error, "injected")
        self._wire.look()
        word = self._bus.read_word_data(address, register)
        self.tape.append(("read", address, register, list(word.to_bytes(2, "little"))))
        return word

    def write_word_data(self, address, register, word):
        if self.error:
            raise OSError(self.error, "injected")
        self.tape.append(("write", address, register, list(word.to_bytes(2, "little"))))
        self._bus.write_word_data(address, register, word)
        self._wire.look()

    def close(self):
        self._bus.close()


class AdcBench:
    """One converter at the host's bus; its far end is at 0x48, whatever address the driver is told."""

    def __init__(self, *inputs, address=0x48, clock_error=0.0, wire=None):
        wire = wire or I2cInProcess()
        self.clock = wire.clock
        self.far = wire.converter(clock_error)
        self.bus = Tap(wire)
        self.port = I2cPort(self.bus.connect, "i2c-1")
        settings = Ads1115Settings(address=address, inputs=inputs or (TORQUE,))
        self.adc = Ads1115("torque_sensor", "bench", settings, self.port, self.clock)

    def rows(self, count, period=0.001):
        results = []
        for _ in range(100_000):
            results += self.adc.take()
            if len(results) >= count:
                return results
            self.clock.sleep_until(self.clock.now() + period)
        raise AssertionError("no rows")
