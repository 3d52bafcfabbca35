"""ADS1115 in single-shot mode: each conversion is started, its ready bit is polled, and its result is read once.

In this mode, the age of each reading is known and no reading is repeated; in continuous mode, the OS bit is not a ready
flag (TI SBAS444, section 9.6.3). Each input is a stream of its own, stamped at the middle of its conversion.
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

COMPARED_CONFIG_BITS = 0x7FE0  # pins, range, mode and rate; the comparator is off, so that its bits do not matter
POWER_DOWN = 0x8583 & ~START  # the reset value, without starting a conversion
RATE_TOLERANCE = 1.1  # highest rate over the nominal one: the internal clock is accurate to 10 %
WAKE_UP_S = 25e-6  # time before a conversion
TIMEOUT_FACTOR = 4.0  # longest time for a conversion, over its nominal time
LONGEST_START_S = 0.005  # for the four bytes that start a conversion, over a slow USB adapter
MOST_SLOW_STARTS = 20  # in sequence, before the run ends


class _InputConversion:
    """Conversion of one input: constants that the loop needs, and the offset that a tare changes."""

    def __init__(self, device: str, settings: AdcInput, is_only_input: bool) -> None:
        self.settings = settings
        self.stream = device if is_only_input else f"{device}_{settings.name}"
        range_code = RANGES_V[settings.range_V]
        self.config = (
            START
            | MUX[settings.pins] << 12
            | range_code << 9
            | SINGLE_SHOT
            | RATES_SPS.index(settings.rate_sps) << 5
            | COMPARATOR_OFF
        )
        self.conversion_s = 1.0 / settings.rate_sps + WAKE_UP_S  # nominal duration
        self.value_per_count = settings.sign * settings.scale_per_V * settings.range_V / 32768
        self.offset = settings.sign * settings.scale_per_V * settings.offset_V
        self.calibrated_offset = self.offset
        low, high = settings.window_V
        volts_per_count = settings.range_V / 32768
        self.lowest, self.highest = math.ceil(low / volts_per_count - 1e-6), math.floor(high / volts_per_count + 1e-6)
        self.largest_tare = settings.scale_per_V * settings.most_tare_V


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
        is_only_input = len(settings.inputs) == 1
        self._conversions = [_InputConversion(name, adc_input, is_only_input) for adc_input in settings.inputs]
        self._input_index = 0
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
        """Return address and emulator of a converter at whose pins are sensors of the bench's quantities."""
        from leactl_plugins.ads1115.emulator import Ads1115Emulator

        sensors = {}
        for adc_input in settings.inputs:
            sensors[int(adc_input.pins[1])] = (physics.reading(adc_input.quantity, adc_input.role), adc_input)

        def pins(number: int) -> float:
            if number not in sensors:
                return 0.0
            read, adc_input = sensors[number]
            return read() / (adc_input.sign * adc_input.scale_per_V) + adc_input.offset_V

        return settings.address, Ads1115Emulator(pins)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """One stream for each input."""
        specs = []
        for conversion in self._conversions:
            adc_input = conversion.settings
            channel = ChannelSpec(
                adc_input.name, adc_input.quantity, adc_input.role, self.name, adc_input.name, adc_input.location
            )
            specs.append(StreamSpec(conversion.stream, (channel,)))
        return tuple(specs)

    def take(self) -> Sequence[Row]:
        """Read a finished conversion and start the next one; never waits.

        Raises
        ------
        NoAnswer : the converter does not acknowledge, a conversion does not end, or starts in sequence take too long.
        """
        started = self._started
        if started is None:
            self._start()
            return ()
        conversion = self._conversions[self._input_index]
        elapsed = self._clock.now() - started
        if elapsed < conversion.conversion_s / RATE_TOLERANCE:
            return ()
        config = self._port.read(self._address, CONFIG)
        if not config & START:
            if elapsed > TIMEOUT_FACTOR * conversion.conversion_s:
                raise NoAnswer(f"{self.name}: a conversion has not ended after {elapsed:.4f} s")
            return ()
        row = self._row_of(conversion, config, self._port.read(self._address, CONVERSION), started)
        self._input_index = (self._input_index + 1) % len(self._conversions)
        self._start()
        return (row,)

    def notices(self) -> list[str]:
        """Return a line at the 1st, 10th, 100th transfer that succeeded only when repeated."""
        return self._port.notices()

    def tare(self, means: Mapping[str, float]) -> dict[str, float]:
        """Subtract these mean readings (by stream) from now on; return the new offsets by channel name.

        Raises
        ------
        DeviceError : a zero would be further from the calibrated one than `tare_limit_V`; no zero is changed then.
        """
        conversions = [conversion for conversion in self._conversions if conversion.stream in means]
        for conversion in conversions:
            distance = conversion.offset + means[conversion.stream] - conversion.calibrated_offset
            if not abs(distance) <= conversion.largest_tare:
                adc_input = conversion.settings
                raise DeviceError(
                    f"{self.name}: a tare would move the zero of input {adc_input.name} by"
                    f" {distance / adc_input.scale_per_V:+.4g} V ({distance:+.4g} {UNITS[adc_input.quantity]});"
                    f" tare_limit_V is {adc_input.most_tare_V:g} V: take the load off the sensor, or mend offset_V"
                )
        for conversion in conversions:
            conversion.offset += means[conversion.stream]
        return {conversion.settings.name: conversion.offset for conversion in conversions}

    def _start(self) -> None:
        """Start a conversion; raise NoAnswer after too many slow starts in sequence."""
        conversion, begun_at = self._conversions[self._input_index], self._clock.now()
        self._port.write(self._address, CONFIG, conversion.config)
        ended_at = self._clock.now()
        duration, longest_duration = ended_at - begun_at, LONGEST_START_S + conversion.conversion_s
        if duration <= longest_duration:
            self._started, self._slow_starts = ended_at, 0
            return
        # the conversion began at an unknown time; the next call of `take` starts another one
        self._started, self._slow_starts = None, self._slow_starts + 1
        if self._slow_starts == MOST_SLOW_STARTS:
            raise NoAnswer(
                f"{self.name}: {MOST_SLOW_STARTS} starts of a conversion one after the other took more than"
                f" {1e3 * longest_duration:.3g} ms, the last {1e3 * duration:.3g} ms: its readings have no known time;"
                " is the bus slow, or the host busy?"
            )

    def _row_of(self, conversion: _InputConversion, config: int, code: int, started: float) -> Row:
        """Return the row of a conversion: its value, or NaN with the fault that makes it invalid."""
        count = code - 0x10000 if code & 0x8000 else code
        mid_time = started + conversion.conversion_s / 2
        if (config ^ conversion.config) & COMPARED_CONFIG_BITS or not conversion.lowest <= count <= conversion.highest:
            return Row(conversion.stream, mid_time, (math.nan,), self._fault_text(conversion, config, count))
        return Row(conversion.stream, mid_time, (count * conversion.value_per_count - conversion.offset,))

    def _fault_text(self, conversion: _InputConversion, config: int, count: int) -> str:
        """Return why a conversion is invalid."""
        adc_input = conversion.settings
        if (config ^ conversion.config) & COMPARED_CONFIG_BITS:
            return (
                f"input {adc_input.name} was converted by config 0x{config:04X}, 0x{conversion.config:04X} was written;"
                " was the converter reset, or is there another program on the bus?"
            )
        if count in (0x7FFF, -0x8000):
            return f"input {adc_input.name} is saturated at {'+' if count > 0 else '-'}{adc_input.range_V} V"
        low, high = adc_input.window_V
        volts = count * adc_input.range_V / 32768
        return f"input {adc_input.name} at {volts:.4g} V is outside the {low:.4g} to {high:.4g} V that its sensor tells"
