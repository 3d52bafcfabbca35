"""Periodic voltages cut into waves, and the flux linkage of each wave's harmonics, independent of the speed.

A voltage that a turning magnet induces is v = d(lambda)/dt with lambda a function of the electrical angle alone. The
integral of v exp(-j h angle) over the time of one wave then equals an integral over the angle, and its value does not
depend on the speed: a shaft that slows down within a wave changes neither the flux linkage of a wave nor the ratio of
two.
"""

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from leactl.errors import NotIdentifiable

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Numbers = TypeVar("Numbers", npt.NDArray[np.float64], npt.NDArray[np.complex128])

FEWEST_WAVES = 5  # of a hold that can be used
WAVES_LOST_AT_ENDS = 7  # when the phase is followed, at both ends together
LONGEST_BRIDGED_GAP = 0.05  # of a wave; waves near a longer gap do not count
PHASE_REACH = 3.0  # waves to either side, from which the angle at a moment is computed
LEAST_AMPLITUDE = 0.5  # of the median; a smaller smoothed fundamental lies in a gap
FEWEST_SAMPLES_A_WAVE = 6  # with fewer, the phase cannot be followed
LEAST_PEAK_POWER = 0.5  # of the spectrum's power, in its peak and neighbours; with less there is no wave to follow
PEAK_WIDTH = 0.15  # of the peak's frequency, over which a drift of the speed spreads it
MOST_HARMONICS = 13  # the fundamental included


class VoltageRecord(NamedTuple):
    """Samples of one voltage; NaN for missing samples."""

    time: Array  # s
    values: Array  # V


@dataclass(frozen=True, eq=False)
class Angle:
    """The electrical angle over time, from the phase of a voltage's fundamental, smoothed over two waves."""

    time: Array  # s
    values: Array  # rad, increasing
    edges: Array  # s, where whole waves begin and end
    gap_free: npt.NDArray[np.bool_]  # for each wave: no gap lies within `PHASE_REACH` of it

    def at(self, time: Array) -> Array:
        """Return the angle at other times [s]; before and after the followed waves it stays constant."""
        return np.interp(time, self.time, self.values)

    @property
    def frequencies(self) -> Array:
        """Return the frequency of each wave [Hz], shape (waves,)."""
        return np.asarray(1.0 / np.diff(self.edges))


@dataclass(frozen=True, eq=False)
class Waves:
    """The waves of one voltage; NaN for a wave that lacks samples."""

    linkage: Complex  # V*s, (orders, waves): the voltage is the sum over h of d/dt |linkage| / h sin(h angle + phase)
    offset: Array  # V, mean of each wave


def frequency_of(record: VoltageRecord) -> float:
    """Return the frequency of the wave in a record [Hz].

    Raises
    ------
    NotIdentifiable : no frequency has most of the power.
    """
    values = bridge_gaps(record.values)
    values = values - values.mean()
    power = np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2
    power[0] = 0.0
    total_power = float(power.sum())
    peak_bin = int(np.argmax(power))
    is_near_peak = np.abs(np.arange(len(power)) - peak_bin) <= max(2.0, PEAK_WIDTH * peak_bin)
    if not total_power > 0.0 or float(power[is_near_peak].sum()) < LEAST_PEAK_POWER * total_power:
        raise NotIdentifiable("no wave stands out of the noise")
    mean_bin = float(np.average(np.flatnonzero(is_near_peak), weights=power[is_near_peak]))
    return mean_bin / (float(record.time[-1] - record.time[0]) * len(values) / (len(values) - 1))


def follow(record: VoltageRecord) -> Angle:
    """Return the electrical angle and its whole waves, by the phase of a voltage's fundamental.

    The voltage is demodulated with a carrier of constant frequency first, and then again over the resulting angle. Over
    the angle every wave has the same length, and the mean over a wave is free of harmonics even if the speed drifts.

    Raises
    ------
    NotIdentifiable : no wave stands out of the noise, too few waves, or too few samples in each wave.
    """
    time, values = record.time, bridge_gaps(record.values)
    frequency = frequency_of(record)
    samples_per_wave = 1.0 / (frequency * float(np.median(np.diff(time))))
    if samples_per_wave < FEWEST_SAMPLES_A_WAVE:
        raise NotIdentifiable(
            f"{samples_per_wave:.1f} samples a wave of {frequency:.4g} Hz; {FEWEST_SAMPLES_A_WAVE} at least are needed"
        )
    wave_count, fewest_waves = float(time[-1] - time[0]) * frequency, FEWEST_WAVES + WAVES_LOST_AT_ENDS
    if wave_count < fewest_waves:
        raise NotIdentifiable(
            f"{wave_count:.1f} waves of {frequency:.4g} Hz; {fewest_waves} at least are needed: turn longer or faster"
        )
    wave_samples, centred_values = round(samples_per_wave), values - values.mean()
    carrier = 2.0 * np.pi * frequency * (time - time[0])
    coarse_angle = mean_over_two_waves(demodulated_phase(centred_values, carrier, wave_samples), wave_samples)
    coarse_range = slice(2 * (wave_samples - 1), 2 * (wave_samples - 1) + len(coarse_angle))
    grid = np.arange(coarse_angle[0], coarse_angle[-1], 2.0 * np.pi / wave_samples)
    grid_times = np.interp(grid, coarse_angle, time[coarse_range])
    angle = demodulated_phase(np.interp(grid_times, time, centred_values), grid, wave_samples)
    times = grid_times[wave_samples - 1 : wave_samples - 1 + len(angle)]
    if not (np.diff(coarse_angle) > 0.0).all() or not (np.diff(angle) > 0.0).all():
        raise NotIdentifiable(f"the phase of a wave of {frequency:.4g} Hz is lost in noise")
    turns = np.arange(np.ceil(angle[0] / (2.0 * np.pi)), np.floor(angle[-1] / (2.0 * np.pi)) + 1.0)
    edges = np.interp(2.0 * np.pi * turns, angle, times)
    gaps = time[gap_mask(record.values, round(LONGEST_BRIDGED_GAP * samples_per_wave))]
    reach = PHASE_REACH / frequency
    gap_free = np.searchsorted(gaps, edges[1:] + reach) == np.searchsorted(gaps, edges[:-1] - reach)
    return Angle(times, angle, edges, gap_free)


def gap_mask(values: Array, longest_gap: int) -> npt.NDArray[np.bool_]:
    """Return the mask of missing samples in gaps longer than `longest_gap` samples, which a line does not represent."""
    is_missing = ~np.isfinite(values)
    starts = np.flatnonzero(np.diff(is_missing.astype(np.int8), prepend=0) == 1)
    stops = np.flatnonzero(np.diff(is_missing.astype(np.int8), append=0) == -1) + 1
    for start, stop in zip(starts, stops, strict=True):
        if stop - start <= longest_gap:
            is_missing[start:stop] = False
    return is_missing


def demodulated_phase(voltage: Array, carrier: Array, wave_samples: int) -> Array:
    """Return the phase of a voltage's fundamental [rad], shorter than the voltage by one wave at either end.

    `carrier` is the phase to demodulate with [rad], and `wave_samples` the number of samples in a wave. Over gaps the
    phase relative to the carrier is interpolated.
    """
    baseband = mean_over_two_waves(voltage * np.exp(-1j * carrier), wave_samples)
    amplitude = np.abs(baseband)
    is_large_enough = amplitude > LEAST_AMPLITUDE * float(np.median(amplitude))
    indices = np.arange(len(baseband))
    phase = np.interp(indices, indices[is_large_enough], np.unwrap(np.angle(baseband[is_large_enough])))
    return np.asarray(carrier[wave_samples - 1 : wave_samples - 1 + len(baseband)] + phase)


def waves_of(record: VoltageRecord, angle: Angle) -> Waves:
    """Return the flux linkages of a voltage over the waves of an angle, which may come from another pair's voltage."""
    samples_per_wave = len(angle.time) / max(len(angle.edges) - 1, 1)
    orders = max(1, min(MOST_HARMONICS, int(samples_per_wave / 2.5)))
    time, is_missing = record.time, ~np.isfinite(record.values)
    values = np.where(is_missing, 0.0, record.values)
    rotation = np.exp(-1j * angle.at(time))
    edges = angle.edges
    widths, sample_interval, missing_times = np.diff(edges), float(np.median(np.diff(time))), time[is_missing]
    is_incomplete = np.searchsorted(missing_times, edges[1:] + sample_interval) > np.searchsorted(
        missing_times, edges[:-1] - sample_interval
    )
    is_incomplete |= ~angle.gap_free
    offset = np.diff(integral_at(edges, time, values)).real / widths
    centred_values = values - (float(np.mean(offset[~is_incomplete])) if not is_incomplete.all() else 0.0)
    linkage = np.empty((orders, len(widths)), np.complex128)
    integrand: Complex = centred_values.astype(np.complex128)
    for order in range(orders):
        integrand = integrand * rotation
        linkage[order] = np.diff(integral_at(edges, time, integrand)) / np.pi
    linkage[:, is_incomplete] = np.nan
    return Waves(linkage, np.where(is_incomplete, np.nan, offset))


def integral_at(moments: Array, time: Array, values: npt.NDArray[np.complexfloating] | Array) -> Complex:
    """Return the integral of samples from the first sample to each moment [s], with straight lines between samples.

    Over whole waves the error of this trapezium rule cancels (Euler and Maclaurin), since the derivatives at both ends
    are equal.
    """
    steps = np.diff(time)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * steps * (values[1:] + values[:-1]))])
    index = np.clip(np.searchsorted(time, moments, side="right") - 1, 0, len(steps) - 1)
    time_since_sample = moments - time[index]
    slope = (values[index + 1] - values[index]) / steps[index]
    return np.asarray(
        cumulative[index] + time_since_sample * (values[index] + 0.5 * time_since_sample * slope), np.complex128
    )


def mean_over_two_waves(values: Numbers, wave_samples: int) -> Numbers:
    """Return means over two waves of `wave_samples` samples each, with triangular weights."""
    for _ in range(2):
        cumulative = np.concatenate([np.zeros(1, values.dtype), np.cumsum(values)])
        values = (cumulative[wave_samples:] - cumulative[:-wave_samples]) / wave_samples
    return values


def bridge_gaps(values: Array) -> Array:
    """Return values with straight lines over missing samples: the phase is followed over them.

    Waves with gaps do not count later.

    Raises
    ------
    NotIdentifiable : all samples are missing.
    """
    finite = np.isfinite(values)
    if finite.all():
        return values
    if not finite.any():
        raise NotIdentifiable("all samples are missing")
    indices = np.arange(len(values))
    return np.interp(indices, indices[finite], values[finite])
