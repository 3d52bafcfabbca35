"""Harmonics of the mean wave over its fundamental: amplitude, phase and total distortion.

Waves are averaged with their phases, so that noise decreases with their number. If noise may cause a harmonic, its
interval begins at zero and its phase is NaN. Phases are those of cos(x) + r_h cos(h x + phase_h), the same for every
pair of leads of an even winding and for either sense of rotation.
"""

import math
from collections.abc import Sequence

import numpy as np

from leactl.analysis.estimate import NAN, Estimate
from leactl.analysis.voltage_waves.turning_holds import TurningHold

RESULT_ORDERS = (2, 3, 5, 7, 11, 13)
SIGNIFICANT_STDS = 3.5  # standard uncertainties of an amplitude; a smaller amplitude may be noise


def harmonics_of(holds: Sequence[TurningHold]) -> list[Estimate]:
    """Return the total harmonic distortion, then amplitude and phase of the harmonics in `RESULT_ORDERS`."""
    highest_order = min(len(waves.linkage) for hold in holds for waves in hold.waves.values())
    relative_harmonics = {order: relative_to_first(holds, order) for order in range(2, highest_order + 1)}
    return [
        distortion(relative_harmonics),
        *(
            estimate
            for order in RESULT_ORDERS
            if order in relative_harmonics
            for estimate in harmonic_estimates(order, *relative_harmonics[order])
        ),
    ]


def relative_to_first(holds: Sequence[TurningHold], order: int) -> tuple[complex, float]:
    """Return a harmonic over the fundamental as r_h exp(j phase_h), and the standard uncertainty of each part of it."""
    values, variance = [], 0.0
    for hold in holds:
        for waves in hold.waves.values():
            linkage = waves.linkage[:, np.isfinite(waves.offset)]
            fundamental = complex(linkage[0].mean())
            rotation = np.exp(-1j * order * np.angle(fundamental)) / abs(fundamental)
            relative_waves = linkage[order - 1] * rotation
            values.append(np.conj(relative_waves.mean()) if hold.shaft.rotation < 0.0 else relative_waves.mean())
            variance += (
                float(np.mean(np.abs(relative_waves - relative_waves.mean()) ** 2)) / 2.0 / (len(relative_waves) - 1)
            )
            variance += hold.resolution**2
    return complex(np.mean(values)), math.sqrt(variance) / len(values)


def harmonic_estimates(order: int, value: complex, std: float) -> list[Estimate]:
    """Return estimates of amplitude and phase of one harmonic; `value` and `std` are those of `relative_to_first`."""
    magnitude, name = abs(value), f"harmonic_{order}"
    is_significant = magnitude > SIGNIFICANT_STDS * std
    low, high = (magnitude - 1.96 * std if is_significant else 0.0), magnitude + 1.96 * std
    amplitude = Estimate(name, magnitude, std, low, high, "1")
    if not is_significant:
        return [amplitude, Estimate(f"{name}_phase", NAN, NAN, NAN, NAN, "rad")]
    phase, phase_std = math.atan2(value.imag, value.real), std / magnitude
    return [
        amplitude,
        Estimate(f"{name}_phase", phase, phase_std, phase - 1.96 * phase_std, phase + 1.96 * phase_std, "rad"),
    ]


def distortion(relative_harmonics: dict[int, tuple[complex, float]]) -> Estimate:
    """Estimate the total distortion: the root of the sum of squared harmonics, minus the squares that noise adds."""
    squares = sum(abs(value) ** 2 - 2.0 * std**2 for value, std in relative_harmonics.values())
    total = math.sqrt(max(squares, 0.0))
    noise = math.sqrt(sum(2.0 * std**2 for _, std in relative_harmonics.values()))
    if total <= noise:
        return Estimate("total_harmonic_distortion", total, noise, 0.0, total + 1.96 * noise, "1")
    std = (
        math.sqrt(sum((abs(value) * std_of_order) ** 2 for value, std_of_order in relative_harmonics.values())) / total
    )
    return Estimate("total_harmonic_distortion", total, std, max(total - 1.96 * std, 0.0), total + 1.96 * std, "1")
