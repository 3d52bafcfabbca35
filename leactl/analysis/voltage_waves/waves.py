"""Periodic voltages cut into waves, and the flux linkage of each wave's harmonics, independent of the speed.

A voltage that a turning magnet induces is v = d(lambda)/dt with lambda a function of the electrical angle alone. The
integral of v exp(-j h angle) over the time of one wave then equals an integral over the angle, and its size does not
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

FEWEST_WAVES = 5
WAVES_LOST_AT_ENDS = 7  # when the phase is followed, both ends together
LONGEST_BRIDGED_GAP = 0.05  # of a wave, by a straight line
PHASE_REACH = 3.0  # waves to either side, from which the angle at a moment is computed
LEAST_SIZE = 0.5  # of the median; a smaller smoothed fundamental lies in a gap
FEWEST_SAMPLES_A_WAVE = 6
LEAST_PEAK_POWER = 0.5  # of the spectrum's power, in its peak with neighbours; with less there is no wave to follow
PEAK_WIDTH = 0.15  # of the peak's frequency, over which a drift of the speed spreads it
MOST_HARMONICS = 13  # the fundamental included


class VoltageRecord(NamedTuple):
    """Samples of one voltage; NaN where one is missing."""

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

    linkage: Complex  # V*s, (orders, waves): of a voltage d/dt of |linkage| sin(h angle + its phase), per h
    offset: Array  # V, mean of each wave


def frequency_of(record: VoltageRecord) -> float:
    """Find the frequency of the wave in a record [Hz].

    Raises
    ------
    NotIdentifiable : no frequency has most of the power.
    """
    values = bridge_gaps(record.values)
    values = values - values.mean()
    power = np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2
    power[0] = 0.0
    total = float(power.sum())
    peak = int(np.argmax(power))
    around_peak = np.abs(np.arange(len(power)) - peak) <= max(2.0, PEAK_WIDTH * peak)
    if not total > 0.0 or float(power[around_peak].sum()) < LEAST_PEAK_POWER * total:
        raise NotIdentifiable("no wave stands out of the noise")
    mean_bin = float(np.average(np.flatnonzero(around_peak), weights=power[around_peak]))
    return mean_bin / (float(record.time[-1] - record.time[0]) * len(values) / (len(values) - 1))


def follow(record: VoltageRecord) -> Angle:
    """Follow the phase of a voltage's fundamental; return the electrical angle and its whole waves.

    The voltage is demodulated with a carrier of constant frequency first, and then again over the angle that this
    yields. Over the angle every wave has the same length, and the mean over a wave is free of harmonics even if the
    speed drifts.

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
    span, least = float(time[-1] - time[0]) * frequency, FEWEST_WAVES + WAVES_LOST_AT_ENDS
    if span < least:
        raise NotIdentifiable(
            f"{span:.1f} waves of {frequency:.4g} Hz; {least} at least are needed: turn longer or faster"
        )
    wave, centred = round(samples_per_wave), values - values.mean()
    carrier = 2.0 * np.pi * frequency * (time - time[0])
    coarse_angle = mean_over_two_waves(demodulated_phase(centred, carrier, wave), wave)
    coarse_range = slice(2 * (wave - 1), 2 * (wave - 1) + len(coarse_angle))
    grid = np.arange(coarse_angle[0], coarse_angle[-1], 2.0 * np.pi / wave)
    moments = np.interp(grid, coarse_angle, time[coarse_range])
    angle = demodulated_phase(np.interp(moments, time, centred), grid, wave)
    times = moments[wave - 1 : wave - 1 + len(angle)]
    if not (np.diff(coarse_angle) > 0.0).all() or not (np.diff(angle) > 0.0).all():
        raise NotIdentifiable(f"the phase of a wave of {frequency:.4g} Hz is lost in noise")
    turns = np.arange(np.ceil(angle[0] / (2.0 * np.pi)), np.floor(angle[-1] / (2.0 * np.pi)) + 1.0)
    edges = np.interp(2.0 * np.pi * turns, angle, times)
    gaps = time[gap_mask(record.values, round(LONGEST_BRIDGED_GAP * samples_per_wave))]
    reach = PHASE_REACH / frequency
    gap_free = np.searchsorted(gaps, edges[1:] + reach) == np.searchsorted(gaps, edges[:-1] - reach)
    return Angle(times, angle, edges, gap_free)


def gap_mask(values: Array, longest: int) -> npt.NDArray[np.bool_]:
    """Mark missing samples in gaps longer than `longest` samples, which a straight line does not represent."""
    missing = ~np.isfinite(values)
    starts = np.flatnonzero(np.diff(missing.astype(np.int8), prepend=0) == 1)
    stops = np.flatnonzero(np.diff(missing.astype(np.int8), append=0) == -1) + 1
    for start, stop in zip(starts, stops, strict=True):
        if stop - start <= longest:
            missing[start:stop] = False
    return missing


def demodulated_phase(voltage: Array, carrier: Array, wave: int) -> Array:
    """Return the phase of a voltage's fundamental [rad], shorter than the voltage by one wave at either end.

    `carrier` is the phase to demodulate with, and `wave` the number of samples in a wave. Over gaps the phase relative
    to the carrier is interpolated.
    """
    smooth = mean_over_two_waves(voltage * np.exp(-1j * carrier), wave)
    amplitude = np.abs(smooth)
    large_enough = amplitude > LEAST_SIZE * float(np.median(amplitude))
    indices = np.arange(len(smooth))
    phase = np.interp(indices, indices[large_enough], np.unwrap(np.angle(smooth[large_enough])))
    return np.asarray(carrier[wave - 1 : wave - 1 + len(smooth)] + phase)


def waves_of(record: VoltageRecord, angle: Angle) -> Waves:
    """Compute the flux linkages of a voltage over the waves of an angle, which may come from another pair's voltage."""
    samples_per_wave = len(angle.time) / max(len(angle.edges) - 1, 1)
    orders = max(1, min(MOST_HARMONICS, int(samples_per_wave / 2.5)))
    time, missing = record.time, ~np.isfinite(record.values)
    values = np.where(missing, 0.0, record.values)
    rotation = np.exp(-1j * angle.at(time))
    edges = angle.edges
    widths, step, missing_times = np.diff(edges), float(np.median(np.diff(time))), time[missing]
    incomplete = np.searchsorted(missing_times, edges[1:] + step) > np.searchsorted(missing_times, edges[:-1] - step)
    incomplete |= ~angle.gap_free
    offset = np.diff(integral_at(edges, time, values)).real / widths
    centred = values - (float(np.mean(offset[~incomplete])) if not incomplete.all() else 0.0)
    linkage = np.empty((orders, len(widths)), np.complex128)
    integrand: Complex = centred.astype(np.complex128)
    for order in range(orders):
        integrand = integrand * rotation
        linkage[order] = np.diff(integral_at(edges, time, integrand)) / np.pi
    linkage[:, incomplete] = np.nan
    return Waves(linkage, np.where(incomplete, np.nan, offset))


def integral_at(moments: Array, time: Array, values: npt.NDArray[np.complexfloating] | Array) -> Complex:
    """Integrate samples from the first one to these moments [s] by the trapezium rule; between samples they are linear.

    Over whole waves the error of the rule cancels (Euler and Maclaurin), since the derivatives at both ends are equal.
    """
    steps = np.diff(time)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * steps * (values[1:] + values[:-1]))])
    index = np.clip(np.searchsorted(time, moments, side="right") - 1, 0, len(steps) - 1)
    remainder = moments - time[index]
    slope = (values[index + 1] - values[index]) / steps[index]
    return np.asarray(cumulative[index] + remainder * (values[index] + 0.5 * remainder * slope), np.complex128)


def mean_over_two_waves(values: Numbers, wave: int) -> Numbers:
    """Average over two waves of `wave` samples with triangular weights."""
    for _ in range(2):
        cumulative = np.concatenate([np.zeros(1, values.dtype), np.cumsum(values)])
        values = (cumulative[wave:] - cumulative[:-wave]) / wave
    return values


def bridge_gaps(values: Array) -> Array:
    """Bridge missing samples by straight lines; only the phase is followed over them, and waves with gaps do not count.

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
