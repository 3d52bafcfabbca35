"""Compute signals: setpoints sampled at the rate of the control loop, each held until the next.

    kind        keys besides role, kind, duration_s, offset_*, settle_s, reference_Hz
    step        from_current_A (or as the mode asks), to_current_A, at_s; no offset
    sine        amplitude_*, frequency_Hz, phase_rad
    chirp       amplitude_*, from_Hz, to_Hz, spacing: linear | log
    multisine   amplitude_*, frequencies_Hz or from_Hz, to_Hz and count; phases: schroeder | random, seed
    noise       std_*, cutoff_Hz, order, seed, fresh: true | false
    csv         path, column; see trajectory.py; no duration and no offset

The amplitude of a multisine is the peak of the sum over its duration. The standard deviation of noise is that of the
filtered signal over its duration; the Butterworth filter starts at rest, so that noise begins without a jump. Noise and
random phases depend on their seed only: a signal inside a `repeat` is the same in each pass, except for `fresh` noise,
whose seed increases by one with every pass. `reference_Hz` emulates a host that is slower than the recording: new
setpoints come at that rate on average, each in the first cycle in which it is due.
"""
# ruff: noqa: N815 (a unit keeps its letter)

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from leactl.protocol.schema import Amount, Driven, Duration, Frequency, Rest, Role, Seed, Setpoint
from leactl.protocol.setpointkeys import Spelling

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

MAX_TERMS = 200_000_000  # samples times frequencies of a multisine: a few seconds of work


class ProtocolSignal(Driven):
    """Keys of every signal."""

    kind: str
    role: Role
    settle_s: Rest = 0.0
    reference_Hz: Frequency | None = None

    def in_pass(self, number: int) -> "ProtocolSignal":
        """Return the signal in a pass of a repeat, counted from 1."""
        return self

    def faults(self, rate_hz: float) -> Iterator[tuple[str, str]]:
        """Yield each key at fault, with the reason, for setpoints at a rate [Hz]."""
        yield from ()

    def values(self, times: "Array", spelling: Spelling) -> "Array":
        """Return setpoints (n,) at times (n,) [s].

        Raises
        ------
        ValueError : no signal exists for these parameters.
        """
        raise NotImplementedError

    def _below_half(self, rate_hz: float, *keys: str) -> Iterator[tuple[str, str]]:
        """Yield each key whose frequency is half the rate or more, with the reason."""
        for key in keys:
            value = getattr(self, key)
            if value is not None and not value < rate_hz / 2:
                yield key, f"{value:g} Hz: {self._less_than_half(rate_hz)}"

    def _less_than_half(self, rate_hz: float) -> str:
        """Return the text that a frequency below half the rate of the setpoints was expected."""
        name = "rate_Hz" if self.reference_Hz is None else "reference_Hz"
        return f"less than half of {name} ({rate_hz / 2:g} Hz) was expected"


class StepSignal(ProtocolSignal):
    """A jump at `at_s`."""

    kind: Literal["step"]
    needs = ("from_setpoint", "to_setpoint")
    from_current_A: Setpoint | None = None
    from_velocity_rad_s: Setpoint | None = None
    from_angle_rad: Setpoint | None = None
    to_current_A: Setpoint | None = None
    to_velocity_rad_s: Setpoint | None = None
    to_angle_rad: Setpoint | None = None
    at_s: Rest
    duration_s: Duration

    def faults(self, rate_hz: float) -> Iterator[tuple[str, str]]:
        """Yield a fault if the jump is not before the end."""
        if not self.at_s < self.duration_s:
            yield "at_s", f"{self.at_s:g} s: less than duration_s ({self.duration_s:g} s) was expected"

    def values(self, times: "Array", spelling: Spelling) -> "Array":
        """Return the first level before the jump and the second from `at_s` on."""
        import numpy as np

        first_level, second_level = self.value_of(spelling, "from_setpoint"), self.value_of(spelling, "to_setpoint")
        values: Array = np.where(times < self.at_s - 1e-9, first_level, second_level)
        return values


class OffsetSignal(ProtocolSignal):
    """A signal around an offset, 0 by default."""

    takes = ("offset",)
    duration_s: Duration
    offset_A: Setpoint | None = None
    offset_rad_s: Setpoint | None = None
    offset_rad: Setpoint | None = None

    def values(self, times: "Array", spelling: Spelling) -> "Array":
        """Return the signal with its offset."""
        values: Array = self.around(times, spelling) + float(self.value_of(spelling, "offset") or 0.0)
        return values

    def around(self, times: "Array", spelling: Spelling) -> "Array":
        """Return the signal without its offset, shape (n,)."""
        raise NotImplementedError


class AmplitudeSignal(OffsetSignal):
    """A signal with an amplitude, its largest deviation from the offset."""

    needs = ("amplitude",)
    amplitude_A: Amount | None = None
    amplitude_rad_s: Amount | None = None
    amplitude_rad: Amount | None = None


class SineSignal(AmplitudeSignal):
    """A sine of one frequency."""

    kind: Literal["sine"]
    frequency_Hz: Frequency
    phase_rad: Setpoint = 0.0

    def faults(self, rate_hz: float) -> Iterator[tuple[str, str]]:
        """Yield a fault for each frequency of half the rate or more."""
        yield from self._below_half(rate_hz, "frequency_Hz")

    def around(self, times: "Array", spelling: Spelling) -> "Array":
        """Return the sine, which starts at `phase_rad`."""
        import numpy as np

        wave: Array = np.sin(2 * math.pi * self.frequency_Hz * times + self.phase_rad)
        return float(self.value_of(spelling, "amplitude")) * wave


class ChirpSignal(AmplitudeSignal):
    """A sine whose frequency changes linearly or exponentially with time."""

    kind: Literal["chirp"]
    from_Hz: Frequency
    to_Hz: Frequency
    spacing: Literal["linear", "log"] = "linear"

    def faults(self, rate_hz: float) -> Iterator[tuple[str, str]]:
        """Yield a fault for each frequency of half the rate or more."""
        yield from self._below_half(rate_hz, "from_Hz", "to_Hz")

    def around(self, times: "Array", spelling: Spelling) -> "Array":
        """Return a sine whose phase is the integral of its frequency."""
        import numpy as np

        start_hz, stop_hz, duration_s = self.from_Hz, self.to_Hz, self.duration_s
        log_ratio = math.log(stop_hz / start_hz)
        if self.spacing == "linear" or abs(log_ratio) < 1e-9:
            cycles = start_hz * times + (stop_hz - start_hz) * times**2 / (2 * duration_s)
        else:
            cycles = start_hz * duration_s / log_ratio * np.expm1(log_ratio * times / duration_s)
        wave: Array = np.sin(2 * math.pi * cycles)
        return float(self.value_of(spelling, "amplitude")) * wave


class MultisineSignal(AmplitudeSignal):
    """A sum of sines of equal amplitude."""

    kind: Literal["multisine"]
    frequencies_Hz: Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=1000)] | None = None
    from_Hz: Frequency | None = None
    to_Hz: Frequency | None = None
    count: Annotated[int, Field(strict=True, ge=2, le=1000)] | None = None
    phases: Literal["schroeder", "random"] = "schroeder"
    seed: Seed = 0

    def faults(self, rate_hz: float) -> Iterator[tuple[str, str]]:
        """Yield faults of the choice of frequencies, and of frequencies of half the rate or more."""
        band_settings = (self.from_Hz, self.to_Hz, self.count)
        if (self.frequencies_Hz is None) == (None in band_settings) and any(item is not None for item in band_settings):
            yield "from_Hz", "from_Hz, to_Hz and count together, or frequencies_Hz alone, were expected"
            return
        if self.frequencies_Hz is None and None in band_settings:
            yield "frequencies_Hz", "frequencies_Hz, or from_Hz, to_Hz and count, were expected"
            return
        yield from self._below_half(rate_hz, "from_Hz", "to_Hz")
        for frequency in self.frequencies_Hz or ():
            if not frequency < rate_hz / 2:
                yield "frequencies_Hz", f"{frequency:g} Hz: {self._less_than_half(rate_hz)}"
        if round(self.duration_s * rate_hz) * len(self._frequencies()) > MAX_TERMS:
            yield (
                "duration_s",
                f"{self.duration_s:g} s of {len(self._frequencies())} frequencies is too much to compute",
            )

    def _frequencies(self) -> list[float]:
        """Return the frequencies [Hz], as listed or evenly spaced."""
        if self.frequencies_Hz is not None:
            return list(self.frequencies_Hz)
        start_hz, stop_hz, count = self.from_Hz, self.to_Hz, self.count
        assert start_hz is not None
        assert stop_hz is not None
        assert count is not None
        return [start_hz + (stop_hz - start_hz) * index / (count - 1) for index in range(count)]

    def around(self, times: "Array", spelling: Spelling) -> "Array":
        """Return the sum, scaled so that its peak is the amplitude; Schroeder's phases (1970) keep the peak low."""
        import numpy as np

        frequencies = self._frequencies()
        if self.phases == "schroeder":
            phases = [-math.pi * index * (index + 1) / len(frequencies) for index in range(len(frequencies))]
        else:
            phases = list(np.random.default_rng(self.seed).uniform(0, 2 * math.pi, len(frequencies)))
        sine_sum: Array = np.zeros(len(times))
        for frequency, phase in zip(frequencies, phases, strict=True):
            sine_sum += np.cos(2 * math.pi * frequency * times + phase)
        peak = float(np.abs(sine_sum).max())
        if not peak > 1e-12:
            raise ValueError("the sum is zero at every sample")
        return float(self.value_of(spelling, "amplitude")) / peak * sine_sum


class NoiseSignal(OffsetSignal):
    """Gaussian noise through a Butterworth low-pass filter."""

    kind: Literal["noise"]
    needs = ("std",)
    std_A: Amount | None = None
    std_rad_s: Amount | None = None
    std_rad: Amount | None = None
    cutoff_Hz: Frequency
    order: Annotated[int, Field(strict=True, ge=1, le=60)]
    seed: Seed
    fresh: Annotated[bool, Field(strict=True)] = False

    def in_pass(self, number: int) -> ProtocolSignal:
        """Return the signal of a pass, with another seed in each pass if `fresh`."""
        return self.model_copy(update={"seed": self.seed + number - 1}) if self.fresh else self

    def faults(self, rate_hz: float) -> Iterator[tuple[str, str]]:
        """Yield a fault for each frequency of half the rate or more."""
        yield from self._below_half(rate_hz, "cutoff_Hz")

    def around(self, times: "Array", spelling: Spelling) -> "Array":
        """Return the noise, filtered in second-order sections: a polynomial of order 35 is numerically unstable."""
        import numpy as np
        from scipy.signal import butter, sosfilt

        if len(times) < 2:
            raise ValueError("two samples or more were expected")
        rate_hz = 1 / float(times[1] - times[0])
        sections = butter(self.order, self.cutoff_Hz, fs=rate_hz, output="sos")
        with np.errstate(all="ignore"):
            filtered: Array = sosfilt(sections, np.random.default_rng(self.seed).standard_normal(len(times)))
            spread = float(filtered.std())
            scaled = filtered * (float(self.value_of(spelling, "std")) / spread) if spread > 0 else filtered
        if not (spread > 1e-12 and np.isfinite(scaled).all()):
            raise ValueError("nothing is left behind the filter; a higher cutoff_Hz, lower order or longer duration_s")
        return scaled


class CsvSignal(ProtocolSignal):
    """A trajectory from a CSV file; its path is relative to the protocol's folder."""

    kind: Literal["csv"]
    path: Annotated[str, Field(min_length=1, max_length=500)]
    column: Annotated[str, Field(min_length=1, max_length=100)] | None = None


SIGNALS: dict[str, TypeAdapter[Any]] = {
    "step": TypeAdapter(StepSignal),
    "sine": TypeAdapter(SineSignal),
    "chirp": TypeAdapter(ChirpSignal),
    "multisine": TypeAdapter(MultisineSignal),
    "noise": TypeAdapter(NoiseSignal),
    "csv": TypeAdapter(CsvSignal),
}
