"""Harmonics of the mean wave over its fundamental: amplitude, phase and total distortion.

Waves are averaged with their phases, so that noise shrinks with their number; a harmonic within noise has an interval
from zero and no phase. Phases are those of cos(x) + r_h cos(h x + phase_h), the same for every pair of an even winding
and either sense of rotation.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.voltage_waves.turning_holds import TurningHold

SHOWN = (2, 3, 5, 7, 11, 13)
CLEAR = 3.5  # standard uncertainties, below which an amplitude may be nothing


def harmonics_of(parts: Sequence[TurningHold]) -> list[Estimate]:
    """Estimate the total harmonic distortion up to the 13th order, then the harmonics that machines have."""
    most = min(len(waves.linkage) for part in parts for waves in part.waves.values())
    relative = {order: relative_to_first(parts, order) for order in range(2, most + 1)}
    return [
        distortion(relative),
        *(row for order in SHOWN if order in relative for row in rows(order, *relative[order])),
    ]


def relative_to_first(parts: Sequence[TurningHold], order: int) -> tuple[complex, float]:
    """Return a harmonic over the fundamental, as defined above, and the standard uncertainty of its parts."""
    values, variance = [], 0.0
    for part in parts:
        for waves in part.waves.values():
            linkage = waves.linkage[:, np.isfinite(waves.offset)]
            first = complex(linkage[0].mean())
            rotation = np.exp(-1j * order * np.angle(first)) / abs(first)
            relative = linkage[order - 1] * rotation
            values.append(np.conj(relative.mean()) if part.shaft.turned < 0.0 else relative.mean())
            variance += float(np.mean(np.abs(relative - relative.mean()) ** 2)) / 2.0 / (len(relative) - 1)
            variance += part.resolution**2
    return complex(np.mean(values)), math.sqrt(variance) / len(values)


def rows(order: int, value: complex, std: float) -> list[Estimate]:
    """Estimate amplitude and phase of one harmonic."""
    size, name = abs(value), f"harmonic_{order}"
    significant = size > CLEAR * std
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
    """Estimate the root of the sum of squares, with the squares that noise adds subtracted."""
    squares = sum(abs(value) ** 2 - 2.0 * std**2 for value, std in relative.values())
    size = math.sqrt(max(squares, 0.0))
    noise = math.sqrt(sum(2.0 * std**2 for _, std in relative.values()))
    if size <= noise:
        return Estimate("total_harmonic_distortion", size, noise, 0.0, size + 1.96 * noise, "1")
    std = math.sqrt(sum((abs(value) * std_of_order) ** 2 for value, std_of_order in relative.values())) / size
    return Estimate("total_harmonic_distortion", size, std, max(size - 1.96 * std, 0.0), size + 1.96 * std, "1")
