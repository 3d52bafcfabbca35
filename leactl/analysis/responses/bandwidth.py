"""-3 dB bandwidth from frequency responses that are known at some frequencies only.

A reference that is held from sample to sample changes the gain of the sampled response. The change depends on the
moment within a sample at which the drive acts (Astrom & Wittenmark, Computer-Controlled Systems, 3rd ed., section 2.3:
sampling with a delay). This moment is not known, so that the change counts as a limit of the error: 0.03 % of the gain
at a hundredth of the record's rate and 14 % at a fifth.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate, Noted
from leactl.analysis.responses.blackman_tukey import BlackmanTukey, Mask, Response, Spectra, sum_of_spectra
from leactl.analysis.statistics.jackknife import JackknifedFigure, LevelFigure, jackknife_over_trials, mean_of_levels
from leactl.analysis.statistics.regression import Array

HALF_POWER = math.sqrt(0.5)
ONE_SIDED_STDS = 1.645  # standard errors to a bound at 95 %
LEAST_CYCLES_PER_SAMPLE = 1e-9  # in place of zero, for which sin / sinh is undefined


def bandwidth_of(
    method: BlackmanTukey,
    levels: Mapping[float, Sequence[Spectra]],
    responses: Mapping[float, Response],
    known: Mapping[float, Mask],
) -> Noted[Estimate]:
    """Estimate the mean of the levels' -3 dB frequencies [Hz]; NaN with bounds if one of them is not known.

    Parameters
    ----------
    levels : spectra of the trials at each level.
    responses : response of all trials of a level together.
    known : frequencies at which a level's response is known, shape (frequencies,).
    """
    early_half_power, late_half_power = sampled_half_power(next(iter(responses.values())).frequency * method.interval)
    half_power = np.full(len(early_half_power), HALF_POWER)
    crossings = [
        crossing_bounds(responses[level], known[level], threshold)
        for level in levels
        for threshold in (early_half_power, half_power, late_half_power)
    ]
    if all(low == high for low, high in crossings):
        level_values = [
            _crossing_of_level(method, levels[level], known[level], (half_power, early_half_power, late_half_power))
            for level in levels
        ]
        return Noted(mean_of_levels("bandwidth", "Hz", level_values))
    lows = [crossing_bounds(gain_bound(responses[level], -1), known[level], early_half_power)[0] for level in levels]
    highs = [crossing_bounds(gain_bound(responses[level], 1), known[level], late_half_power)[1] for level in levels]
    low, high = min(lows) if math.inf in highs else float(np.mean(lows)), float(np.mean(highs))
    if math.isinf(high):
        note = (
            f"the gain stays above -3 dB up to {low:.4g} Hz (95 %), whatever sampling does to it, as far as it is "
            "known: bandwidth is above"
        )
    else:
        note = (
            f"the gain passes -3 dB between {low:.4g} and {high:.4g} Hz (95 %), where the response is not known or "
            "sampling may move it"
        )
    return Noted(Estimate("bandwidth", NAN, NAN, low, high, "Hz"), (note,))


def gain_bound(response: Response, side: int) -> Response:
    """Return the response with the lowest gain (`side` -1) or the highest (1) that noise leaves possible at 95 %."""
    return response._replace(
        value=response.value * np.maximum(1.0 + side * ONE_SIDED_STDS * response.relative_std, 0.0)
    )


def sampled_half_power(cycles_per_sample: Array) -> tuple[Array, Array]:
    """Return the highest and lowest gain of the samples of a first-order loop at its own -3 dB frequency.

    The gain is highest if the drive acts at once and lowest if it acts about the middle of a sample.
    `cycles_per_sample` is frequency times sample interval, shape (frequencies,), as are both gains.
    """
    angle = math.pi * np.maximum(cycles_per_sample, LEAST_CYCLES_PER_SAMPLE)
    highest = 1.0 / np.hypot(1.0, np.sin(angle) / np.sinh(angle))
    return highest, highest * np.cos(angle)


def crossing_bounds(response: Response, known: Mask, level: Array) -> tuple[float, float]:
    """Return the frequencies [Hz] between which the gain first falls below a level.

    They are equal if both neighbours on the grid are known; the upper one is infinite if the gain stays above.
    """
    excess = response.gain - level
    known_indices = np.flatnonzero(known)
    below = np.flatnonzero(excess[known_indices] < 0.0)
    if not len(below):
        return float(response.frequency[known_indices[-1]]), math.inf
    index = int(known_indices[below[0]])
    if not below[0]:
        return 0.0, float(response.frequency[index])
    previous_index = int(known_indices[below[0] - 1])
    if index - previous_index > 1:
        return float(response.frequency[previous_index]), float(response.frequency[index])
    step_share = excess[previous_index] / (excess[previous_index] - excess[index])
    frequency = float(
        response.frequency[previous_index]
        + step_share * (response.frequency[index] - response.frequency[previous_index])
    )
    return frequency, frequency


def _crossing_of_level(
    method: BlackmanTukey, spectra: Sequence[Spectra], known: Mask, gains: tuple[Array, Array, Array]
) -> JackknifedFigure:
    """Return the frequency at which one level's gain passes -3 dB, with its scatter over the trials.

    `gains` are the gains that mark the crossing: -3 dB, and those of samples with an early and with a late drive.
    """
    all_spectra = sum_of_spectra(spectra)

    def crossing(trials: Sequence[int]) -> LevelFigure:
        left_out = [spectrum for index, spectrum in enumerate(spectra) if index not in trials]
        response = method.response(all_spectra.plus(sum_of_spectra(left_out), -1) if left_out else all_spectra)
        (low, high), (lowest, _), (_, highest) = (crossing_bounds(response, known, gain) for gain in gains)
        return LevelFigure(low, shared=(max(low - lowest, highest - low),)) if low == high else LevelFigure(NAN)

    return jackknife_over_trials(len(spectra), crossing)
