"""Periodic voltages cut into waves, each worth the flux linkage of its harmonics, whatever the speed does meanwhile.

A voltage that a turning magnet induces is v = d(lambda)/dt with lambda a function of the electrical angle alone. The
integral of v exp(-j h angle) over one wave in time is then one over angle, and its size holds no speed: a shaft that
slows down within a wave changes neither the waves' flux linkage nor their ratio to each other.
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
AT_THE_ENDS = 7  # waves that following the phase takes
GAP = 0.05  # of a wave, that a straight line may stand for
REACH = 3.0  # waves to either side, of which the angle at a moment is made
LEAST_SIZE = 0.5  # of the median, below which a smoothed fundamental is that of a gap
FEWEST_SAMPLES = 6  # a wave
DOMINANT = 0.5  # of the power, in the spectrum's peak and its neighbours: less, and there is no wave to follow
NEIGHBOURS = 0.15  # of the peak's frequency: as far as a speed that drifts spreads it
ORDERS = 13  # harmonics, the fundamental included


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
    sure: npt.NDArray[np.bool_]  # of each wave: it was not followed beside a gap

    def at(self, time: Array) -> Array:
        """The angle at other times within; constant outside, where no wave is."""
        return np.interp(time, self.time, self.values)

    @property
    def frequencies(self) -> Array:
        """Of each wave [Hz]."""
        return np.asarray(1.0 / np.diff(self.edges))


@dataclass(frozen=True, eq=False)
class Waves:
    """The waves of one voltage; NaN for a wave that lacks samples."""

    linkage: Complex  # V*s, (orders, waves): of a voltage d/dt of |linkage| sin(h angle + its phase), per h
    offset: Array  # V, mean of each wave


def frequency_of(record: VoltageRecord) -> float:
    """Frequency of the one wave that a record holds [Hz].

    Raises
    ------
    NotIdentifiable : no frequency stands out.
    """
    values = filled(record.values)
    values = values - values.mean()
    power = np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2
    power[0] = 0.0
    total = float(power.sum())
    peak = int(np.argmax(power))
    near = np.abs(np.arange(len(power)) - peak) <= max(2.0, NEIGHBOURS * peak)
    if not total > 0.0 or float(power[near].sum()) < DOMINANT * total:
        raise NotIdentifiable("no wave stands out of the noise")
    middle = float(np.average(np.flatnonzero(near), weights=power[near]))
    return middle / (float(record.time[-1] - record.time[0]) * len(values) / (len(values) - 1))


def follow(record: VoltageRecord) -> Angle:
    """The angle of a voltage's fundamental, with its whole waves.

    Demodulated with a carrier of one frequency first, then over the angle that this gives: there every wave has the
    same length, and a mean over one is free of harmonics however the speed drifts.

    Raises
    ------
    NotIdentifiable : no wave stands out, or too few of them, or too few samples in each.
    """
    time, values = record.time, filled(record.values)
    frequency = frequency_of(record)
    samples = 1.0 / (frequency * float(np.median(np.diff(time))))
    if samples < FEWEST_SAMPLES:
        raise NotIdentifiable(
            f"{samples:.1f} samples a wave of {frequency:.4g} Hz; {FEWEST_SAMPLES} at least are needed"
        )
    span, least = float(time[-1] - time[0]) * frequency, FEWEST_WAVES + AT_THE_ENDS
    if span < least:
        raise NotIdentifiable(
            f"{span:.1f} waves of {frequency:.4g} Hz; {least} at least are needed: turn longer or faster"
        )
    wave, level = round(samples), values - values.mean()
    carrier = 2.0 * np.pi * frequency * (time - time[0])
    first = over_two_waves(demodulated(level, carrier, wave), wave)
    kept = slice(2 * (wave - 1), 2 * (wave - 1) + len(first))
    grid = np.arange(first[0], first[-1], 2.0 * np.pi / wave)
    moments = np.interp(grid, first, time[kept])
    angle = demodulated(np.interp(moments, time, level), grid, wave)
    inner = moments[wave - 1 : wave - 1 + len(angle)]
    if not (np.diff(first) > 0.0).all() or not (np.diff(angle) > 0.0).all():
        raise NotIdentifiable(f"the phase of a wave of {frequency:.4g} Hz is lost in noise")
    turns = np.arange(np.ceil(angle[0] / (2.0 * np.pi)), np.floor(angle[-1] / (2.0 * np.pi)) + 1.0)
    edges = np.interp(2.0 * np.pi * turns, angle, inner)
    gaps = time[in_gaps(record.values, round(GAP * samples))]
    near = REACH / frequency
    sure = np.searchsorted(gaps, edges[1:] + near) == np.searchsorted(gaps, edges[:-1] - near)
    return Angle(inner, angle, edges, sure)


def in_gaps(values: Array, longest: int) -> npt.NDArray[np.bool_]:
    """Which samples are missing in a row of more than so many: a straight line over it is no wave."""
    missing = ~np.isfinite(values)
    starts = np.flatnonzero(np.diff(missing.astype(np.int8), prepend=0) == 1)
    stops = np.flatnonzero(np.diff(missing.astype(np.int8), append=0) == -1) + 1
    for start, stop in zip(starts, stops, strict=True):
        if stop - start <= longest:
            missing[start:stop] = False
    return missing


def demodulated(level: Array, carrier: Array, wave: int) -> Array:
    """Phase of the fundamental, carrier included, one wave shorter at either end; straight where samples lack."""
    smooth = over_two_waves(level * np.exp(-1j * carrier), wave)
    size = np.abs(smooth)
    there = size > LEAST_SIZE * float(np.median(size))
    places = np.arange(len(smooth))
    phase = np.interp(places, places[there], np.unwrap(np.angle(smooth[there])))
    return np.asarray(carrier[wave - 1 : wave - 1 + len(smooth)] + phase)


def waves_of(record: VoltageRecord, angle: Angle) -> Waves:
    """Flux linkages of a voltage over the waves of an angle that was followed in it or in another one beside it."""
    wave = len(angle.time) / max(len(angle.edges) - 1, 1)
    orders = max(1, min(ORDERS, int(wave / 2.5)))
    time, missing = record.time, ~np.isfinite(record.values)
    values = np.where(missing, 0.0, record.values)
    turn = np.exp(-1j * angle.at(time))
    edges = angle.edges
    widths, step, absent = np.diff(edges), float(np.median(np.diff(time))), time[missing]
    lacking = np.searchsorted(absent, edges[1:] + step) > np.searchsorted(absent, edges[:-1] - step)
    lacking |= ~angle.sure
    offset = np.diff(integral_at(edges, time, values)).real / widths
    level = values - (float(np.mean(offset[~lacking])) if not lacking.all() else 0.0)
    linkage = np.empty((orders, len(widths)), np.complex128)
    integrand: Complex = level.astype(np.complex128)
    for order in range(orders):
        integrand = integrand * turn
        linkage[order] = np.diff(integral_at(edges, time, integrand)) / np.pi
    linkage[:, lacking] = np.nan
    return Waves(linkage, np.where(lacking, np.nan, offset))


def integral_at(moments: Array, time: Array, values: npt.NDArray[np.complexfloating] | Array) -> Complex:
    """Integral of samples from their first to these moments, by trapezia and, within one, its own parabola.

    Over whole waves the trapezia's error cancels (Euler and Maclaurin), since the derivatives at both ends are alike.
    """
    steps = np.diff(time)
    whole = np.concatenate([[0.0], np.cumsum(0.5 * steps * (values[1:] + values[:-1]))])
    place = np.clip(np.searchsorted(time, moments, side="right") - 1, 0, len(steps) - 1)
    part = moments - time[place]
    slope = (values[place + 1] - values[place]) / steps[place]
    return np.asarray(whole[place] + part * (values[place] + 0.5 * part * slope), np.complex128)


def over_two_waves(values: Numbers, wave: int) -> Numbers:
    """Weighted means over two waves of so many samples, a triangle: the mean of means over one."""
    for _ in range(2):
        sums = np.concatenate([np.zeros(1, values.dtype), np.cumsum(values)])
        values = (sums[wave:] - sums[:-wave]) / wave
    return values


def filled(values: Array) -> Array:
    """Samples with a straight line over those that are missing: for the phase alone, such waves count for nothing.

    Raises
    ------
    NotIdentifiable : all are missing.
    """
    good = np.isfinite(values)
    if good.all():
        return values
    if not good.any():
        raise NotIdentifiable("all samples are missing")
    places = np.arange(len(values))
    return np.interp(places, places[good], values[good])
