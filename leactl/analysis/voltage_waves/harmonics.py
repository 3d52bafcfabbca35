"""Harmonics of the mean wave over its fundamental: amplitude, phase and total distortion.

Waves are averaged with their phases, so that noise shrinks with their number. The interval of a harmonic within noise
begins at zero, and its phase is NaN. Phases are those of cos(x) + r_h cos(h x + phase_h), the same for every pair of
leads of an even winding and for either sense of rotation.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.voltage_waves.turning_holds import TurningHold

RESULT_ORDERS = (2, 3, 5, 7, 11, 13)
SIGNIFICANT_STDS = 3.5  # standard uncertainties of an amplitude; a smaller one may be noise


def harmonics_of(holds: Sequence[TurningHold]) -> list[Estimate]:
    """Estimate the total harmonic distortion up to the 13th order, then amplitude and phase of `RESULT_ORDERS`."""
    highest = min(len(waves.linkage) for hold in holds for waves in hold.waves.values())
    relative = {order: relative_to_first(holds, order) for order in range(2, highest + 1)}
    return [
        distortion(relative),
        *(row for order in RESULT_ORDERS if order in relative for row in harmonic_estimates(order, *relative[order])),
    ]


def relative_to_first(holds: Sequence[TurningHold], order: int) -> tuple[complex, float]:
    """Return a harmonic over the fundamental as r_h exp(j phase_h), and the standard uncertainty of either part."""
    values, variance = [], 0.0
    for hold in holds:
        for waves in hold.waves.values():
            linkage = waves.linkage[:, np.isfinite(waves.offset)]
            fundamental = complex(linkage[0].mean())
            rotation = np.exp(-1j * order * np.angle(fundamental)) / abs(fundamental)
            relative = linkage[order - 1] * rotation
            values.append(np.conj(relative.mean()) if hold.shaft.turned < 0.0 else relative.mean())
            variance += float(np.mean(np.abs(relative - relative.mean()) ** 2)) / 2.0 / (len(relative) - 1)
            variance += hold.resolution**2
    return complex(np.mean(values)), math.sqrt(variance) / len(values)


def harmonic_estimates(order: int, value: complex, std: float) -> list[Estimate]:
    """Estimate amplitude and phase of one harmonic."""
    size, name = abs(value), f"harmonic_{order}"
    significant = size > SIGNIFICANT_STDS * std
    low, high = (size - 1.96 * std if significant else 0.0), size + 1.96 * std
    amplitude = Estimate(name, size, std, low, high, "1")
    if not significant:
        return [amplitude, Estimate(f"{name}_phase", NAN, NAN, NAN, NAN, "rad")]
    phase, phase_std = math.atan2(value.imag, value.real), std / size
    return [
        amplitude,
        Estimate(f"{name}_phase", phase, phase_std, phase - 1.96 * phase_std, phase + 1.96 * phase_std, "rad"),
    ]


def distortion(relative: dict[int, tuple[complex, float]]) -> Estimate:
    """Estimate the total distortion: the root of the sum of squared harmonics, less the squares that noise adds."""
    squares = sum(abs(value) ** 2 - 2.0 * std**2 for value, std in relative.values())
    size = math.sqrt(max(squares, 0.0))
    noise = math.sqrt(sum(2.0 * std**2 for _, std in relative.values()))
    if size <= noise:
        return Estimate("total_harmonic_distortion", size, noise, 0.0, size + 1.96 * noise, "1")
    std = math.sqrt(sum((abs(value) * std_of_order) ** 2 for value, std_of_order in relative.values())) / size
    return Estimate("total_harmonic_distortion", size, std, max(size - 1.96 * std, 0.0), size + 1.96 * std, "1")
