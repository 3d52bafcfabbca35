"""-3 dB bandwidth from frequency responses that are known in parts."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from leactl.analysis.blackman_tukey import BlackmanTukey, Mask, Response, Spectra, together
from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.jackknife import LevelValue, Reading, mean_of_levels, over_trials

HALF_POWER = math.sqrt(0.5)
ONE_SIDED = 1.645  # standard errors of a bound at 95 %


def bandwidth_of(
    method: BlackmanTukey,
    levels: Mapping[float, Sequence[Spectra]],
    responses: Mapping[float, Response],
    known: Mapping[float, Mask],
    notes: list[str],
) -> Estimate:
    """Mean of the levels' -3 dB frequencies, or what is known of it where one of them is not."""
    bounds = [within(responses[level], known[level]) for level in levels]
    if all(low == high for low, high in bounds):
        values = []
        for level, spectra in levels.items():
            values.append(_crossing_over(method, spectra, known[level]))
        return mean_of_levels("bandwidth", "Hz", values)
    low, high = (float(np.mean(side)) for side in zip(*bounds, strict=True))
    low = min(held(responses[level], known[level]) for level in levels) if math.isinf(high) else low
    if math.isinf(high):
        notes.append(f"the gain stays above -3 dB up to {low:.4g} Hz (95 %), as far as it is known: bandwidth is above")
    else:
        notes.append(f"the gain passes -3 dB where the response is not known, between {low:.4g} and {high:.4g} Hz")
    return Estimate("bandwidth", NAN, NAN, low, high, "Hz")


def within(response: Response, known: Mask) -> tuple[float, float]:
    """Between which frequencies the gain first passes -3 dB; equal where it does so between two known ones."""
    at = np.flatnonzero(known)
    below = np.flatnonzero(response.gain[at] < HALF_POWER)
    if not len(below):
        return float(response.frequency[at[-1]]), math.inf
    index = int(at[below[0]])
    if not below[0]:
        return 0.0, float(response.frequency[index])
    before = int(at[below[0] - 1])
    if index - before > 1:
        return float(response.frequency[before]), float(response.frequency[index])
    value = _between(response, index)
    return value, value


def held(response: Response, known: Mask) -> float:
    """How far from the bottom the gain surely stays above -3 dB [Hz]."""
    surely = ~known | (response.gain * (1.0 - ONE_SIDED * response.relative_std) > HALF_POWER)
    first = int(np.argmax(~surely)) if not surely.all() else len(surely)
    inside = np.flatnonzero(known[:first])
    return float(response.frequency[inside[-1]]) if len(inside) else 0.0


def _crossing_over(method: BlackmanTukey, spectra: Sequence[Spectra], known: Mask) -> LevelValue:
    whole = together(spectra)

    def crossing(kept: Sequence[int]) -> Reading:
        left = [spectrum for k, spectrum in enumerate(spectra) if k not in kept]
        rest = whole.plus(together(left), -1) if left else whole
        low, high = within(method.response(rest), known)
        return Reading(low if low == high else NAN)

    return over_trials(len(spectra), crossing)


def _between(response: Response, index: int) -> float:
    gains, frequency = response.gain[index - 1 : index + 1], response.frequency[index - 1 : index + 1]
    share = (gains[0] - HALF_POWER) / (gains[0] - gains[1])
    return float(frequency[0] + share * (frequency[1] - frequency[0]))
