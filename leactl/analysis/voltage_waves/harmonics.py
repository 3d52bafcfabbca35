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
    """Total harmonic distortion up to the 13th order, then the harmonics that machines have."""
    most = min(len(waves.linkage) for part in parts for waves in part.waves.values())
    relative = {order: relative_to_first(parts, order) for order in range(2, most + 1)}
    return [
        distortion(relative),
        *(row for order in SHOWN if order in relative for row in rows(order, *relative[order])),
    ]


def relative_to_first(parts: Sequence[TurningHold], order: int) -> tuple[complex, float]:
    """A harmonic over the fundamental, phase by the definition above, and the standard uncertainty of either part."""
    found, variance = [], 0.0
    for part in parts:
        for waves in part.waves.values():
            linkage = waves.linkage[:, np.isfinite(waves.offset)]
            first = complex(linkage[0].mean())
            back = np.exp(-1j * order * np.angle(first)) / abs(first)
            each = linkage[order - 1] * back
            found.append(np.conj(each.mean()) if part.shaft.turned < 0.0 else each.mean())
            variance += float(np.mean(np.abs(each - each.mean()) ** 2)) / 2.0 / (len(each) - 1)
            variance += part.resolution**2
    return complex(np.mean(found)), math.sqrt(variance) / len(found)


def rows(order: int, value: complex, std: float) -> list[Estimate]:
    """Amplitude and phase of one harmonic."""
    size, name = abs(value), f"harmonic_{order}"
    clear = size > CLEAR * std
    low, high = (size - 1.96 * std if clear else 0.0), size + 1.96 * std
    amplitude = Estimate(name, size, std, low, high, "1")
    if not clear:
        return [amplitude, Estimate(f"{name}_phase", NAN, NAN, NAN, NAN, "rad")]
    phase, spread = math.atan2(value.imag, value.real), std / size
    return [amplitude, Estimate(f"{name}_phase", phase, spread, phase - 1.96 * spread, phase + 1.96 * spread, "rad")]


def distortion(relative: dict[int, tuple[complex, float]]) -> Estimate:
    """Root of the sum of squares, without what noise adds to them."""
    squares = sum(abs(value) ** 2 - 2.0 * std**2 for value, std in relative.values())
    size = math.sqrt(max(squares, 0.0))
    noise = math.sqrt(sum(2.0 * std**2 for _, std in relative.values()))
    if size <= noise:
        return Estimate("total_harmonic_distortion", size, noise, 0.0, size + 1.96 * noise, "1")
    std = math.sqrt(sum((abs(value) * own) ** 2 for value, own in relative.values())) / size
    return Estimate("total_harmonic_distortion", size, std, max(size - 1.96 * std, 0.0), size + 1.96 * std, "1")
