"""Whether what a set of effects leaves over rings: a line in its spectrum that noise and a sound model do not have.

A part that swings on the bench, a loop that oscillates or a hum leaves little power, so that sums of squares hardly
see it, but leaves it at one frequency. Spectra of all runs are averaged (Welch, 1967) and each bin is compared with its
neighbours, which needs no reference: smoothing and slow model errors bend a spectrum, they put no line in it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from leactl.gap.search.evidence import Evidence
from leactl.gap.search.regression import Fit, Rows, residuals

Array = npt.NDArray[np.float64]
SEGMENT = 64  # rows
FULL = 0.6  # of a segment's rows that must be there
NEIGHBOURS = 5  # bins to either side, the next one left out
LOWEST = 4  # bin; below it there is no neighbourhood on either side, and `unrest` sees what is slow
STEADY = 0.05  # of a speed, by which it varies where it is not steady
FEWEST = 8  # segments
DEVIATIONS = 3.0  # that a mean spectrum of so many segments scatters by
COMMANDED = 3  # samples to either side, in which a command makes a current
LEAP, AROUND = 6.0, 7  # of a moving command's usual bend, that is a leap, and samples around it that are not heard
STILL = 1e-6  # of a command's greatest bend, up to which it stands
COLOURLESS = 10.0  # usual unrest, up to which a sound model leaves a rest even enough to hear a line in


@dataclass(frozen=True)
class Line:
    """The highest line of a spectrum."""

    height: float  # over its neighbourhood, less what chance gives it, in units of what a sound machine shows
    frequency: float  # Hz


def ringing(evidence: Evidence, fit: Fit, heard: Sequence[bool]) -> dict[tuple[str, str, str], Line]:
    """The highest line of what a fit leaves over in each channel, of the rows that are to be heard.

    Keys are equation, quantity and mechanical set-up. Channels with too few rows are left out.
    """
    spectra: dict[tuple[str, str, str], list[Array]] = {}
    rates: dict[tuple[str, str, str], float] = {}
    for index, rows in enumerate(evidence.stack.rows):
        if not heard[index] or not evidence.is_judged(rows) or len(rows.index) < SEGMENT:
            continue
        if evidence.expected(rows) > COLOURLESS:
            continue
        left = uncommanded(rows, residuals(evidence.stack, fit, index)) / rows.white
        step = int(np.min(np.diff(rows.index)))
        place = (rows.index - rows.index[0]) // step
        even = np.full(place[-1] + 1, np.nan)
        even[place] = np.where(steady(rows, place) | by_counts(rows), np.nan, left)
        key = (rows.equation, rows.quantity, rows.mechanical)
        rates[key] = 1.0 / (step * rows.signals.interval)
        spectra.setdefault(key, []).extend(periodograms(even))
    lines = {}
    for key, spectrum in spectra.items():
        if len(spectrum) >= FEWEST:
            at, height = highest_line(spectrum)
            lines[key] = Line(height / max(evidence.lines.get(key, 1.0), 1.0), at * rates[key] / SEGMENT)
    return lines


def steady(rows: Rows, place: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Rows around which the speed stays as it is: an encoder's counts come in a rhythm there."""
    if rows.signals.velocity is None:
        return np.zeros(len(place), bool)
    speed = rows.signals.velocity[rows.index]
    reach = SEGMENT // 4
    first, last = (np.searchsorted(place, place + side * reach) for side in (-1, 1))
    count = np.maximum(last - first, 1)
    sums, squares = (np.concatenate([[0.0], np.cumsum(part)]) for part in (speed, speed**2))
    mean = (sums[last] - sums[first]) / count
    spread = np.sqrt(np.maximum((squares[last] - squares[first]) / count - mean**2, 0.0))
    return np.asarray(spread < STEADY * np.abs(mean), np.bool_)


def uncommanded(rows: Rows, left: Array) -> Array:
    """What a current leaves over beyond what its command makes of it within a few samples; NaN where that leaps.

    A loop, a stamp or a reference between two samples that is a little off leaves the command's own lines.
    """
    following = rows.signals.following
    if rows.equation != "current" or following is None:
        return left
    bend = np.zeros(len(following))
    bend[1:-1] = np.abs(np.diff(following, 2))
    moving = bend[bend > STILL * np.max(bend, initial=0.0)]
    leaps = maximum_filter1d(bend > LEAP * np.median(moving), 2 * AROUND + 1) if len(moving) else bend > 0.0
    calm = ~leaps[rows.index]
    lags = [following[np.clip(rows.index + lag, 0, len(following) - 1)] for lag in range(-COMMANDED, COMMANDED + 1)]
    table = np.stack(lags, axis=1)
    known = np.linalg.lstsq(table[calm], left[calm], rcond=None)[0]
    return np.where(calm, left - table @ known, np.nan)


def by_counts(rows: Rows) -> npt.NDArray[np.bool_]:
    """Rows of speed in which a shaft moves by single counts of its encoder, which have a rhythm of their own."""
    signals = rows.signals
    if signals.velocity is None or rows.quantity != "velocity":
        return np.zeros(len(rows.index), bool)
    return np.asarray(np.abs(signals.velocity[rows.index]) * signals.interval < signals.count, np.bool_)


def periodograms(values: Array) -> list[Array]:
    """Power of half-overlapping segments under a Hann window; missing values (NaN) count as nothing."""
    window, powers = np.hanning(SEGMENT), []
    for start in range(0, len(values) - SEGMENT + 1, SEGMENT // 2):
        part = values[start : start + SEGMENT]
        there = np.isfinite(part)
        if there.mean() >= FULL:
            power = np.abs(np.fft.rfft(np.where(there, part, 0.0) * window)) ** 2
            powers.append(power / np.sum((window * there) ** 2))
    return powers


def highest_line(spectra: Sequence[Array]) -> tuple[int, float]:
    """The highest bin of the mean of periodograms, and how high it stands less what chance gives it.

    Each periodogram counts in its own median power, else a loud run of few segments would be all that is heard.
    """
    own = [power / level for power in spectra if (level := float(np.median(power))) > 0.0]
    if not own:
        return 0, 0.0
    at, over = highest_bin(np.mean(own, axis=0))
    return at, over * (1.0 - DEVIATIONS / math.sqrt(len(own)))


def highest_bin(power: Array) -> tuple[int, float]:
    """The bin that stands highest over the medians of its neighbours on either side; a slope alone makes no line."""
    over = np.zeros(len(power))
    for at in range(LOWEST, len(power) - 2):
        below, above = power[max(1, at - NEIGHBOURS) : at - 1], power[at + 2 : at + NEIGHBOURS + 1]
        around = max(float(np.median(below)), float(np.median(above)))
        over[at] = power[at] / around if around > 0.0 else 0.0  # nothing is known of the noise beside it
    return int(np.argmax(over)), float(np.max(over))
