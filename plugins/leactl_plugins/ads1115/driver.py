"""ADS1115 in single-shot mode: every conversion is started, its ready bit is polled, and its result is read once.

Single shot makes the age of each reading known and excludes repeated readings; in continuous mode the OS bit is no
ready flag (TI SBAS444, section 9.6.3). Each input is a stream of its own, stamped at the middle of its conversion.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from leactl.driver.clock import Clock
from leactl.driver.contract import Confirmation, Driver, Row, StreamSpec
from leactl.driver.far_end import I2cEmulator, Physics
from leactl.driver.i2c_port import I2cPort
from leactl.errors import DeviceError, NoAnswer
from leactl.quantities import UNITS, ChannelSpec
from leactl_plugins.ads1115.probe import Ads1115Probe
from leactl_plugins.ads1115.settings import (
    COMPARATOR_OFF,
    CONFIG,
    CONVERSION,
    MUX,
    RANGES_V,
    RATES_SPS,
    SINGLE_SHOT,
    START,
    AdcInput,
    Ads1115Settings,
)

CONVERSION_BITS = 0x7FE0  # mask of pins, range, mode and rate; the comparator's bits are ignored, since it is off
POWER_DOWN = 0x8583 & ~START  # the reset value, without starting a conversion
RATE_TOLERANCE = 1.1  # the internal clock is good to 10 %
WAKE_UP_S = 25e-6  # before a conversion
TIMEOUT_FACTOR = 4.0  # longest conversion, over its nominal time
LONGEST_START_S = 0.005  # for the four bytes that start a conversion, over a slow USB adapter
MOST_SLOW_STARTS = 20  # in sequence


class _Converter:
    """Constants of one input that the loop needs, computed once."""

    def __init__(self, device: str, settings: AdcInput, single: bool) -> None:
        self.settings = settings
        self.stream = device if single else f"{device}_{settings.name}"
        code = RANGES_V[settings.range_V]
        self.config = (
            START
            | MUX[settings.pins] << 12
            | code << 9
            | SINGLE_SHOT
            | RATES_SPS.index(settings.rate_sps) << 5
            | COMPARATOR_OFF
        )
        self.conversion_s = 1.0 / settings.rate_sps + WAKE_UP_S
        self.per_count = settings.sign * settings.scale_per_V * settings.range_V / 32768
        self.offset = settings.sign * settings.scale_per_V * settings.offset_V
        self.calibrated = self.offset
        low, high = settings.window_V
        count = settings.range_V / 32768
        self.lowest, self.highest = math.ceil(low / count - 1e-6), math.floor(high / count + 1e-6)
        self.most_tare = settings.scale_per_V * settings.most_tare_V


class Ads1115(Driver):
    """One ADS1115 and the sensors at its inputs."""

    Settings = Ads1115Settings
    transport = "i2c"
    summary = "ADS1115 16-bit converter over I2C (torque sensor, voltages)"
    probe = Ads1115Probe()
    example: ClassVar[Mapping[str, Any]] = {
        "inputs": [
            {
                "name": "torque",
                "quantity": "torque",
                "role": "test",
                "pins": "A0-A1",
                "range_V": 6.144,
                "scale_per_V": 3.0,
            }
        ]
    }

    def __init__(self, name: str, role: str, settings: Ads1115Settings, port: I2cPort, clock: Clock) -> None:
        self.name, self.role, self.settings = name, role, settings
        self._port, self._clock, self._address = port, clock, settings.address
        single = len(settings.inputs) == 1
        self._converters = [_Converter(name, item, single) for item in settings.inputs]
        self._turn = 0
        self._started: float | None = None
        self._slow_starts = 0  # starts in sequence that took too long
        self._opened = False

    def safe_state(self, deadline_s: float) -> Confirmation:
        """Confirm at once: the device only measures."""
        return Confirmation(True, "measures only")

    def open(self) -> None:
        """Configure the converter and read its configuration back.

        Raises
        ------
        DeviceError : nothing acknowledges, or the configuration reads back differently.
        """
        self._port.open()
        self._opened = True
        self._port.write(self._address, CONFIG, POWER_DOWN)
        config = self._port.read(self._address, CONFIG)
        if config & ~START != POWER_DOWN:
            device = f"{self.name}: address 0x{self._address:02X}"
            raise DeviceError(f"{device} holds 0x{config:04X} after 0x{POWER_DOWN:04X} was written; not an ADS1115?")

    def close(self) -> None:
        """Close the bus."""
        if self._opened:
            self._opened = False
            self._port.close()

    @classmethod
    def far_end(cls, settings: Ads1115Settings, role: str, physics: Physics) -> tuple[int, I2cEmulator]:
        """A converter whose pins have the output voltages of sensors for the bench's quantities."""
        from leactl_plugins.ads1115.emulator import Ads1115Emulator

        sensors = {}
        for item in settings.inputs:
            sensors[int(item.pins[1])] = (physics.reading(item.quantity, item.role), item)

        def pins(number: int) -> float:
            if number not in sensors:
                return 0.0
            read, item = sensors[number]
            return read() / (item.sign * item.scale_per_V) + item.offset_V

        return settings.address, Ads1115Emulator(pins)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """One stream for each input."""
        specs = []
        for converter in self._converters:
            item = converter.settings
            channel = ChannelSpec(item.name, item.quantity, item.role, self.name, item.name, item.location)
            specs.append(StreamSpec(converter.stream, (channel,)))
        return tuple(specs)

    def take(self) -> Sequence[Row]:
        """Read a finished conversion and start the next one; never waits.

        Raises
        ------
        NoAnswer : not acknowledged, a conversion that does not end, or starts that take too long one after the other.
        """
        started = self._started
        if started is None:
            self._start()
            return ()
        converter = self._converters[self._turn]
        waited = self._clock.now() - started
        if waited < converter.conversion_s / RATE_TOLERANCE:
            return ()
        config = self._port.read(self._address, CONFIG)
        if not config & START:
            if waited > TIMEOUT_FACTOR * converter.conversion_s:
                raise NoAnswer(f"{self.name}: a conversion has not ended after {waited:.4f} s")
            return ()
        row = self._row(converter, config, self._port.read(self._address, CONVERSION), started)
        self._turn = (self._turn + 1) % len(self._converters)
        self._start()
        return (row,)

    def notices(self) -> list[str]:
        """A line at the 1st, 10th, 100th transfer that succeeded only when repeated."""
        return self._port.notices()

    def tare(self, means: Mapping[str, float]) -> dict[str, float]:
        """Subtract these mean readings (by stream) from now on; returns the new offsets by channel name.

        Raises
        ------
        DeviceError : a zero would move further from the calibrated one than `tare_limit_V`; no zero is changed then.
        """
        converters = [converter for converter in self._converters if converter.stream in means]
        for converter in converters:
            moved = converter.offset + means[converter.stream] - converter.calibrated
            if not abs(moved) <= converter.most_tare:
                item = converter.settings
                raise DeviceError(
                    f"{self.name}: a tare would move the zero of input {item.name} by {moved / item.scale_per_V:+.4g} V"
                    f" ({moved:+.4g} {UNITS[item.quantity]}); tare_limit_V is {item.most_tare_V:g} V: take the load off"
                    " the sensor, or mend offset_V"
                )
        for converter in converters:
            converter.offset += means[converter.stream]
        return {converter.settings.name: converter.offset for converter in converters}

    def _start(self) -> None:
        converter, before = self._converters[self._turn], self._clock.now()
        self._port.write(self._address, CONFIG, converter.config)
        after = self._clock.now()
        took, most = after - before, LONGEST_START_S + converter.conversion_s
        if took <= most:
            self._started, self._slow_starts = after, 0
            return
        # the conversion began at an unknown time; the next call starts another one
        self._started, self._slow_starts = None, self._slow_starts + 1
        if self._slow_starts == MOST_SLOW_STARTS:
            raise NoAnswer(
                f"{self.name}: {MOST_SLOW_STARTS} starts of a conversion one after the other took more than"
                f" {1e3 * most:.3g} ms, the last {1e3 * took:.3g} ms: its readings have no known time; is the"
                " bus slow, or the host busy?"
            )

    def _row(self, converter: _Converter, config: int, raw: int, started: float) -> Row:
        count = raw - 0x10000 if raw & 0x8000 else raw
        stamp = started + converter.conversion_s / 2
        if (config ^ converter.config) & CONVERSION_BITS or not converter.lowest <= count <= converter.highest:
            return Row(converter.stream, stamp, (math.nan,), self._fault(converter, config, count))
        return Row(converter.stream, stamp, (count * converter.per_count - converter.offset,))

    def _fault(self, converter: _Converter, config: int, count: int) -> str:
        item = converter.settings
        if (config ^ converter.config) & CONVERSION_BITS:
            return (
                f"input {item.name} was converted by config 0x{config:04X}, 0x{converter.config:04X} was written; was"
                " the converter reset, or is there another program on the bus?"
            )
        if count in (0x7FFF, -0x8000):
            return f"input {item.name} is saturated at {'+' if count > 0 else '-'}{item.range_V} V"
        low, high = item.window_V
        volts = count * item.range_V / 32768
        return f"input {item.name} at {volts:.4g} V is outside the {low:.4g} to {high:.4g} V that its sensor tells"
